"""Plug-in Gait's joint centres: published numbers, the laws of its equations, and where they come out on a body."""

from __future__ import annotations

import numpy as np
import pytest
from plug_in_gait import RADIUS_M, Measured, Wearer, chord, hips, joint_centres, seated
from scipy.spatial.transform import Rotation

from cabinpose.core import CABINPOSE, JOINTS, PLUG_IN_GAIT, told_as
from cabinpose.scene.body import BodyModel, Person, Phenotype, load_population

SIZE = Measured(leg=0.90, shoulder=0.05, elbow=0.08, wrist=0.04, hand=0.03, knee=0.11, ankle=0.07)


@pytest.fixture(scope="module")
def person() -> Person:
    rng = np.random.default_rng(4)
    return BodyModel.load().person(Phenotype.of_size(load_population("ansur").draw(rng=rng, sex="female"), rng=rng))


def test_the_chord_function_gives_pycgms_published_numbers() -> None:
    plane, proximal, marker = np.array([(775.41, 788.65, 514.41), (424.57, 46.17, 305.73), (618.98, 848.86, 133.52)])
    np.testing.assert_allclose(chord(plane, proximal, marker, 42.5), (599.66, 843.26, 96.08), atol=0.006)


def test_hips_are_davis_equation() -> None:
    """A level pelvis 0.24 m wide: by the numbers of the paper, in mm."""
    markers = {"LASI": (0, 0.12, 0), "RASI": (0, -0.12, 0), "LPSI": (-0.16, 0.03, 0), "RPSI": (-0.16, -0.03, 0)}
    left, right = hips({name: np.array(at, float) for name, at in markers.items()}, 0.90)
    c, depth = 0.115 * 900 - 15.3, 0.1288 * 900 - 48.56
    x = (-depth - 7) * np.cos(0.314) + c * np.cos(0.5) * np.sin(0.314)
    z = (-depth - 7) * np.sin(0.314) - c * np.cos(0.5) * np.cos(0.314)
    np.testing.assert_allclose(left * 1e3, (x, 120 - c * np.sin(0.5), z), atol=1e-9)
    np.testing.assert_allclose(right, left * (1, -1, 1), atol=1e-12)


def worn(person: Person) -> tuple[dict[str, np.ndarray], dict[str, np.ndarray], Measured]:
    wearer = Wearer(person)
    body = seated(person, rng=np.random.default_rng(1))
    return wearer.markers(body), dict(zip(JOINTS, body.joints, strict=True)), wearer.size


def test_markers_that_lie_true_give_the_joints_back(person: Person) -> None:
    """Beside knee and ankle, at right angles to thigh and shank, half a width and a marker away."""
    markers, _, _ = worn(person)
    hip, knee = hips(markers, SIZE.leg)[0], hips(markers, SIZE.leg)[0] + (0.4, 0.05, -0.1)
    ankle = knee + (0.05, 0.02, -0.42)
    for name, above, proximal, joint, width in (("KNE", "THI", hip, knee, SIZE.knee), ("ANK", "TIB", knee, ankle, SIZE.ankle)):
        out = np.cross(proximal - joint, (1.0, 0.1, 0.3))
        out = out / np.linalg.norm(out)
        markers["L" + name] = joint + (width / 2 + RADIUS_M) * out
        markers["L" + above] = (proximal + joint) / 2 + 0.09 * out
    found = joint_centres(markers, SIZE)
    np.testing.assert_allclose(found["lknee"], knee, atol=1e-12)
    np.testing.assert_allclose(found["lankle"], ankle, atol=1e-12)


def test_centres_obey_their_laws_whichever_way_somebody_faces(person: Person) -> None:
    markers, _, size = worn(person)
    found = joint_centres(markers, size)
    for marker, joint, proximal, width in (
        ("ELB", "elbow", "shoulder", size.elbow), ("FIN", "hand", "wrist", size.hand), ("KNE", "knee", "pelvis", size.knee),
        ("ANK", "ankle", "knee", size.ankle),
    ):  # fmt: skip
        for side in "lr":
            away, along = markers[side.upper() + marker] - found[side + joint], found[side + proximal] - found[side + joint]
            assert np.linalg.norm(away) == pytest.approx(width / 2 + RADIUS_M)
            assert away @ along == pytest.approx(0.0, abs=1e-9)
    turn, shift = Rotation.from_rotvec((0.3, -1.1, 2.0)), np.array((0.4, -2.0, 0.7))
    turned = joint_centres({name: turn.apply(at) + shift for name, at in markers.items()}, size)
    swap = {"L": "R", "R": "L", "l": "r", "r": "l"}
    swapped = {
        (swap.get(name[0], name[0]) if name not in ("C7", "CLAV") else "C") + name[1:]: at * (1, -1, 1)
        for name, at in markers.items()
    }
    mirrored = joint_centres(swapped, size)
    for name, at in found.items():
        np.testing.assert_allclose(turned[name], turn.apply(at) + shift, atol=1e-9)
        other = swap.get(name[0], name[0]) + name[1:]
        np.testing.assert_allclose(mirrored[other if other in found else name], at * (1, -1, 1), atol=1e-9)


def test_they_lie_near_ours_on_a_body_and_nearer_when_told(person: Person) -> None:
    """Davis' hips are 25 mm from CT, with a spread of 7 (Mantovani 2016); told by the weights, no joint is far from ours."""
    markers, ours, size = worn(person)
    found = joint_centres(markers, size)
    off = {name: 1e3 * np.linalg.norm(at - ours[name]) for name, at in found.items()}
    assert 5.0 < off["lpelvis"] < 50.0
    assert max(off[side + name] for side in "lr" for name in ("shoulder", "elbow", "wrist", "knee", "ankle")) < 35.0
    theirs = np.array([found.get(name, np.full(3, np.nan)) for name in JOINTS])
    told = told_as(theirs, JOINTS, PLUG_IN_GAIT, CABINPOSE)
    far = 1e3 * np.linalg.norm(told - np.array([ours[name] for name in JOINTS]), axis=1)
    assert far.max() < 45.0
    assert far.mean() < 0.6 * np.mean(list(off.values()))

"""Harnesses lie on children and not in them, lap parts on boosters below the hip bones; what is not buckled up is said so."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import trimesh
from belt_fit import asis, height_of_lap

from cabinpose.core import CABINPOSE
from cabinpose.scene.contact import FLESH_M
from cabinpose.scene.labels import LABEL_ID
from cabinpose.scene.materials import MATERIAL_ID
from cabinpose.synth.config import SynthConfig
from cabinpose.synth.sample import SceneSampler
from cabinpose.synth.scene import ScenePerson
from cabinpose.synth.streams import frame_rng

STRAPS = ("lap", "left", "right")
RIBBON = 240  # vertices of a strap: two sides of 40 rows of three


def children(kind: str, count: int, **scene: Any) -> list[ScenePerson]:
    """The child of each of some scenes in a child seat of a kind."""
    young = {"infants": 1.0} if kind == "infant" else {"children": 1.0, "toddlers": 0.5}
    data = {"cars": ["suv"], "occupancy": {}, "occupants": {"rear_left": {}}, "right_hand_drive": 0.0, "belted": 1.0,
            "child_seats": {"rear_left": kind}, "clutter": 0.0} | young | scene  # fmt: skip
    sampler = SceneSampler(SynthConfig.parse({"scene": data}), 0)
    return [sampler.sample(i, rng=frame_rng(0, i)).people[0] for i in range(count)]


def strap(child: ScenePerson, name: str) -> np.ndarray:
    """(2, 40, 3, 3) m: outer and inner side of a strap, station by station."""
    start = RIBBON * STRAPS.index(name)
    return child.surfaces[1].vertices[start : start + RIBBON].astype(np.float64).reshape(2, 40, 3, 3)


@pytest.mark.parametrize(("kind", "width_m", "near"), [("toddler", 0.038, 0.6), ("infant", 0.026, 0.9)])
def test_straps_lie_on_the_trunk_and_not_in_it(kind: str, width_m: float, near: float) -> None:
    """From the slot a strap is straight to where it meets the shoulder; from there it lies on the child, all but where it spans
    the hollow before the belly: it is taut.

    near: of the length from there on, the share that lies within 12 mm of the dressed surface, at least.
    """
    for child in children(kind, 3):
        assert child.belt == "harness"
        skin, harness = child.surfaces
        assert set(harness.label) == {LABEL_ID["seat_belt"]}
        laid = (harness.faces < RIBBON * len(STRAPS)).all(axis=1)  # whose stations may fall together
        for faces, merged in ((harness.faces[laid], False), (harness.faces[~laid], True)):
            assert trimesh.Trimesh(harness.vertices.astype(float), faces, process=merged).is_watertight
        body = trimesh.Trimesh(skin.vertices.astype(float), skin.faces, process=False)
        for name in ("left", "right"):
            rows = strap(child, name)
            width = np.linalg.norm(rows[1, :, 2] - rows[1, :, 0], axis=1)
            assert width.max() < 1.35 * width_m, name  # a string that takes another way round widens the webbing
            _, distance, face = trimesh.proximity.closest_point(body, rows[1].reshape(-1, 3))
            off = distance.reshape(40, 3)
            met = int(np.argmax(off[:, 1] < 0.012))
            assert met < 14, name  # of 40: it reaches the child at the shoulder, not below
            assert (off[met:] < 0.012).mean() > near, name
            assert off[met:, 1].max() < 0.045, name  # the depth of the crease between belly and thighs, with a buckle before it
            free = rows[1, : met + 1, 1] - rows[1, 0, 1]
            aside = np.cross(free, free[-1]) / max(float(np.linalg.norm(free[-1])), 1e-9)
            assert np.abs(aside).max() < 1e-3, name
            trunk = np.isin(skin.label[face], [LABEL_ID["torso_left"], LABEL_ID["torso_right"], LABEL_ID["hip_center"]])
            inside = body.contains(rows[1].reshape(-1, 3)) & trunk
            if kind == "toddler":  # an infant's belly, thighs and chin are in each other
                assert distance[inside].max(initial=0.0) < FLESH_M, name


def test_straps_meet_in_a_buckle_between_the_hips() -> None:
    (child,) = children("toddler", 1)
    harness = child.surfaces[1]
    of_buckle = harness.material == MATERIAL_ID["hard_plastic"]
    buckle = harness.vertices[np.unique(harness.faces[of_buckle])].astype(np.float64)
    middle = buckle.mean(axis=0)
    assert np.ptp(buckle, axis=0).max() < 0.09
    for name in ("left", "right"):  # ends at its upper edge
        assert np.linalg.norm(strap(child, name)[1, -1, 1] - middle) < 0.045
    between = harness.vertices[RIBBON * len(STRAPS) : harness.faces[of_buckle].min()].astype(np.float64)
    down = np.linalg.norm(between - middle, axis=1)
    assert down.min() < 0.03
    low = between[down > 0.7 * down.max()]
    knees = child.posed.joints[[CABINPOSE.index["lknee"], CABINPOSE.index["rknee"]]].mean(axis=0)
    assert ((low - middle) @ (knees - middle) > 0.0).all()  # between the legs, not into the belly
    assert (low[:, 2] < middle[2]).all()
    spines = asis(child)
    across = (spines[0] - spines[1]) / np.linalg.norm(spines[0] - spines[1])
    assert abs((middle - spines.mean(axis=0)) @ across) < 0.03
    pelvis = child.posed.vehicle_from_root[:3, :3]
    assert (middle - spines.mean(axis=0)) @ pelvis[:, 2] < 0.01  # no higher than the hip bones


@pytest.mark.parametrize("kind", ["booster", "booster_cushion"])
def test_a_lap_part_on_a_booster_lies_below_the_hip_bones_and_through_its_guides(kind: str) -> None:
    heights = []
    for child in children(kind, 5):
        over, above_femur, before = height_of_lap(child)
        heights.append(over)
        assert before > 0.0
        assert above_femur > -0.09  # on the thighs near the hips, not at the knees
    assert np.median(heights) < -0.01
    assert np.mean(np.less(heights, 0.0)) >= 0.8


def test_who_is_not_belted_has_no_harness_on() -> None:
    worn, loose = children("toddler", 1)[0], children("toddler", 1, belted=0.0)[0]
    assert (worn.belt, loose.belt) == ("harness", "none")
    assert (worn.posed.skin == loose.posed.skin).all()
    hips = worn.posed.joints[[CABINPOSE.index[name] for name in ("lpelvis", "rpelvis")]]
    for child, crosses in ((worn, True), (loose, False)):
        points = child.surfaces[1].vertices.astype(np.float64)
        assert (np.linalg.norm(points[:, None] - hips, axis=2).min() < 0.15) == crosses
    (infant,) = children("infant", 1, belted=0.0)
    assert infant.belt == "none"
    assert len(infant.surfaces) == 1


@pytest.mark.slow
def test_the_share_of_unbuckled_harnesses_is_that_of_belts() -> None:
    worn = [child.belt for child in children("toddler", 60, belted=0.5, motion={"rear_left": {"rest_lap": 1.0}})]
    assert set(worn) == {"harness", "none"}
    count, expected = worn.count("none"), 0.5 * len(worn)
    assert (count - expected) ** 2 / expected * 2.0 < 6.63  # chi-square of one degree of freedom, 1 %

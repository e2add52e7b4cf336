"""Faces: whose they are, and what they do, measured on the mesh and on rendered heads."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_array_equal

from cabinpose.core.camera import Camera
from cabinpose.core.frames import axis_rotation, invert, look_at
from cabinpose.scene import MATERIAL_ID, Surface
from cabinpose.scene.body import BONE_INDEX, DOF_INDEX, DOFS, SUBJECTS, BodyModel, Face, Person, PosedBody, load_chart, load_faces
from cabinpose.scene.body.shape import load_shape_space
from cabinpose.synth.render import Rasteriser

EYE = [MATERIAL_ID[name] for name in ("eye", "iris", "pupil")]
PEOPLE = ("S01", "S02", "S05", "S08", "cdc_male_0y_p50")


def person(name: str, number: int | None = None) -> Person:
    phenotype, outfit = SUBJECTS[name]
    number = phenotype.face if number is None else number
    return BodyModel.load().person(replace(phenotype, face=number), replace(outfit, glasses="none", headwear="none"))


def standing(body: Person) -> PosedBody:
    return body.pose(np.zeros(len(DOFS)), np.eye(4))


def eye_pixels(posed: PosedBody, face: Face, aside: float = 0.0, below: float = 0.0) -> int:
    """Of a camera of 0.4 mm a pixel, half a metre before the eyes."""
    surface, eyes = posed.surface(1, face), posed.eyes_m
    start = eyes + 0.5 * (axis_rotation("z", aside) @ axis_rotation("y", below) @ (1.0, 0.0, 0.0))
    camera = Camera.from_fov(300, 240, 0.24)
    frame = Rasteriser(camera, supersample=1).render(surface, invert(look_at(start, eyes)))
    seen = frame.face_id[frame.face_id >= 0]
    assert len(seen) > 0.5 * frame.face_id.size
    return int(np.isin(surface.material[seen], EYE).sum())


def balls(surface: Surface) -> list[np.ndarray]:
    """The vertices of the left and right eyeball."""
    own = np.unique(surface.faces[np.isin(surface.material, EYE)])
    return list(surface.vertices[own].astype(np.float64).reshape(2, -1, 3))


def iris_normals(surface: Surface) -> list[np.ndarray]:
    """From the middle of each ball, by the sphere through its vertices, to that of its iris."""
    result = []
    iris = np.unique(surface.faces[surface.material == MATERIAL_ID["iris"]])
    for points, own in zip(balls(surface), np.split(surface.vertices[iris].astype(np.float64), 2), strict=True):
        fit = np.linalg.lstsq(np.c_[2.0 * points, np.ones(len(points))], (points**2).sum(axis=1), rcond=None)[0]
        towards = own.mean(axis=0) - fit[:3]
        result.append(towards / np.linalg.norm(towards))
    return result


@pytest.mark.parametrize("name", ["S01", "cdc_male_0y_p50"])
@pytest.mark.parametrize(("yaw", "pitch"), [(0.0, 0.0), (0.9, -0.3), (-0.6, 0.5)])
def test_both_eyes_look_along_the_gaze(name: str, yaw: float, pitch: float) -> None:
    q = np.zeros(len(DOFS))
    q[[DOF_INDEX["neck.rotation"], DOF_INDEX["head.flexion"], DOF_INDEX["lumbar.lateral"]]] = 0.3, -0.2, 0.2
    root = np.eye(4)
    root[:3, :3] = axis_rotation("z", 2.0)
    posed = person(name).pose(q, root)
    gaze = axis_rotation("z", yaw) @ axis_rotation("y", -pitch) @ (1.0, 0.0, 0.0)
    wanted = posed.bones[BONE_INDEX["head"], :3, :3] @ gaze
    for normal in iris_normals(posed.surface(1, Face(gaze=tuple(gaze.tolist())))):
        assert np.degrees(np.arccos(normal @ wanted)) < 0.1


@pytest.mark.parametrize("name", PEOPLE)
def test_closed_lids_cover_the_eyes_and_half_open_ones_half_of_them(name: str) -> None:
    posed = standing(person(name))
    whole, half = (eye_pixels(posed, Face(lids=(o, o))) for o in (1.0, 0.5))
    assert whole > 250
    assert 0.3 < half / whole < 0.7
    left = eye_pixels(posed, Face(lids=(0.0, 1.0)))
    assert 0.3 < left / whole < 0.7
    for aside, below in ((0.0, 0.0), (0.7, 0.0), (-0.7, 0.2), (0.0, 0.5)):
        assert eye_pixels(posed, Face(lids=(0.0, 0.0)), aside, below) == 0


@pytest.mark.parametrize("opening", [0.8, 0.4, 0.0])
def test_lids_slide_over_the_ball(opening: float) -> None:
    """No vertex of the skin that is before the ball's middle when the eye is open comes into the ball."""
    posed = standing(person("S03"))
    still, closed = (posed.surface(1, Face(lids=(o, o))) for o in (1.0, opening))
    for ball in balls(still):
        middle = (ball.max(axis=0) + ball.min(axis=0)) / 2
        radius = np.linalg.norm(ball - middle, axis=1).max()
        moved = np.linalg.norm(still.vertices - closed.vertices, axis=1) > 1e-5
        near = moved & (np.linalg.norm(closed.vertices - middle, axis=1) < 2 * radius)
        assert near.sum() > 100
        assert np.linalg.norm(closed.vertices[near] - middle, axis=1).min() > radius


def test_an_open_face_that_looks_ahead_is_the_one_of_nobody_who_does_anything() -> None:
    posed = standing(person("S01"))
    one, other = posed.surface(1), posed.surface(1, Face())
    np.testing.assert_allclose(other.vertices, one.vertices, atol=1e-6)
    assert_array_equal(other.material, one.material)


def test_units_move_what_they_are_named_after() -> None:
    """And nothing above the brows, nor what others depend on: the bare skin."""
    posed = standing(person("S01"))
    skin = posed.skin.copy()
    still = posed.surface(1, Face()).vertices
    eyes = posed.eyes_m

    def move(**units: float) -> np.ndarray:
        result = posed.surface(1, Face(units=tuple(units.items()))).vertices - still
        assert np.abs(result[still[:, 2] > eyes[2] + 0.06]).max() < 1e-6
        return result

    jaw, smile, brow = move(jawOpen=1.0), move(mouthSmileLeft=1.0), move(browOuterUpLeft=1.0)
    assert -0.05 < jaw[:, 2].min() < -0.03
    assert -0.09 < (still[np.argmin(jaw[:, 2])] - eyes)[2] + 0.02 < -0.04  # the lower lip or the chin
    at = np.argmax(smile[:, 2])
    assert smile[at, 2] > 0.008
    assert (still[at] - eyes)[1] > 0.01
    assert (still[at] - eyes)[2] < -0.03
    at = np.argmax(brow[:, 2])
    assert brow[at, 2] > 0.004
    assert (still[at] - eyes)[1] > 0.01
    assert 0.0 < (still[at] - eyes)[2] < 0.05
    assert_array_equal(posed.skin, skin)


def test_everybody_has_a_face_of_their_own() -> None:
    one, same, other, none = (person("S01", number).rest_skin for number in (7, 7, 8, 0))
    assert_array_equal(one, same)
    for first, second in ((one, other), (one, none)):
        off = np.linalg.norm(first - second, axis=1)
        assert 0.003 < off.max() < 0.02
        assert np.abs(off[load_chart().head < 0.5]).max() < 0.004  # the throat below the chin
    assert len({SUBJECTS[name].phenotype.face for name in SUBJECTS}) == len(SUBJECTS)


def test_sides_of_a_face_differ_a_little() -> None:
    chart, flip = load_chart(), np.array([1.0, -1.0, 1.0], np.float32)
    differ = []
    for number in range(1, 21):
        skin = person("S01", number).rest_skin
        off = np.linalg.norm(skin - (skin * flip)[load_shape_space().mirror], axis=1)[chart.head > 0.5]
        differ.append(off.max())
    assert min(differ) > 0.001
    assert max(differ) < 0.012
    skin = person("S01", 0).rest_skin
    np.testing.assert_allclose(skin, (skin * flip)[load_shape_space().mirror], atol=1e-5)


@pytest.mark.parametrize("name", ["S01", "S02", "S05", "nhanes_female_p95", "cdc_male_3y_p50"])
def test_the_head_keeps_its_measures_and_the_body_its_mass(name: str) -> None:
    """A face moves neither the skull, nor a body's mass by more than what is asked of a mass."""
    without = person(name, 0)
    for number in range(1, 5):
        body = person(name, number)
        for measure in ("head_circumference", "head_breadth", "stature"):
            assert body.dimensions_m[measure] == pytest.approx(without.dimensions_m[measure], rel=2e-3), measure
        assert body.mass_kg == pytest.approx(without.mass_kg, abs=0.12 if without.phenotype.size is None else 0.5)


def test_a_mass_that_is_asked_for_includes_the_face() -> None:
    model = BodyModel.load()
    for number in range(1, 4):
        asked = replace(SUBJECTS["S01"].phenotype, face=number)
        assert model.person(model.with_mass(asked, 75.0)).mass_kg == pytest.approx(75.0, abs=0.1)


def test_the_asset_has_sides_and_units_that_are_mirror_images() -> None:
    units, rest = load_faces().units, load_chart().rest
    for name, left in units.items():
        if name.endswith("Left") and name != "jawLeft":
            right = units[name.removesuffix("Left") + "Right"]
            assert (left.offset[:, 0] @ rest[left.vertex, 1]) * (right.offset[:, 0] @ rest[right.vertex, 1]) <= 0.0
            assert np.linalg.norm(left.offset, axis=1) @ rest[left.vertex, 1] > 0.0, name

"""Visibility of joints: hand-made scenes with known answers, and an independent ray test on people in cars."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import ArrayLike, NDArray
from render_scenes import BARREL, Embree, ball, cabin_view, people_in_cars, person, rod, room, small_camera

from cabinpose.core.camera import Camera
from cabinpose.core.errors import ConfigError
from cabinpose.core.frames import Matrix, apply, invert, look_at
from cabinpose.core.pose import Visibility
from cabinpose.core.skeleton import CABINPOSE, JOINTS
from cabinpose.scene.body import OWN_PARTS
from cabinpose.scene.labels import BODY_PARTS
from cabinpose.scene.labels import LABEL_ID as LABEL
from cabinpose.scene.materials import MATERIAL_ID as MATERIAL
from cabinpose.scene.surface import Surface, merge
from cabinpose.synth.render import Rasteriser

FORWARD = invert(look_at((0, 0, 0), (1, 0, 0)))


def joint_visibility(
    joints: ArrayLike, instances: list[int], scene: Surface, view: Matrix, camera: Camera, *, closed: bool = False
) -> NDArray[np.uint8]:
    """States (P, 20) of joints (P, 20, 3) of the camera frame."""
    return Rasteriser(camera, 1).render(scene, view, closed=closed, joints=joints, instances=instances).visibility


def state(joint: str, at: tuple[float, float, float], parts: list[Surface], instance: int = 1) -> Visibility:
    """The state of one joint of person `instance` at a place of the vehicle frame, the camera at the origin looking along x."""
    joints = np.full((1, len(JOINTS), 3), np.nan)
    joints[0, CABINPOSE.index[joint]] = apply(FORWARD, at)
    result = joint_visibility(joints, [instance], merge(parts), FORWARD, small_camera())
    others = np.delete(result[0], CABINPOSE.index[joint])
    assert (others == Visibility.ABSENT).all()
    return Visibility(result[0, CABINPOSE.index[joint]])


def test_every_joint_has_its_own_parts_and_a_reach() -> None:
    names = {label.name for label in BODY_PARTS}
    assert tuple(OWN_PARTS) == JOINTS == tuple(CABINPOSE.reach_m)
    for joint in JOINTS:
        assert set(OWN_PARTS[joint]) <= names
        if joint[0] in "lr":
            assert not any(part.endswith("_left" if joint[0] == "r" else "_right") for part in OWN_PARTS[joint])


def test_a_joint_beyond_the_fold_of_a_lens_is_outside_the_image() -> None:
    """In a corner of its rays' box, from where the polynomial leads back into the image."""
    lens = Camera(320, 240, 200.0, 200.0, 159.5, 119.5, (-0.3, 0.02, 0.0, 0.0, 0.0))
    inside, beyond = (0.88, 0.65, 1.0), (0.95, 0.7, 1.0)
    assert np.linalg.norm(inside[:2]) < lens.monotonic_radius < np.linalg.norm(beyond[:2])
    assert lens.contains(lens.project([inside, beyond], folded=True)).all()
    joints = np.tile(np.array([[[0.88, 0.65, 1.0]], [[0.95, 0.7, 1.0]]]), (1, len(JOINTS), 1))
    ball_behind = merge([ball((5.0, 0, 0), 0.1, "head_left", instance=1)])
    states = joint_visibility(joints, [1, 2], ball_behind, FORWARD, lens)
    assert (states[0] == Visibility.VISIBLE).all()
    assert (states[1] == Visibility.OUTSIDE_IMAGE).all()


@pytest.mark.parametrize("joint", JOINTS)
def test_a_joint_inside_its_own_part_is_visible(joint: str) -> None:
    assert state(joint, (1.0, 0, 0), [ball((1.0, 0, 0), 0.08, OWN_PARTS[joint][0], instance=1)]) == Visibility.VISIBLE


def test_the_five_states() -> None:
    elbow = ball((1.0, 0, 0), 0.05, "elbow_left", instance=1)
    head = ball((0.6, 0, 0), 0.08, "head_left", instance=1)
    seat = ball((0.5, 0, 0), 0.1, "seat")
    other = ball((0.5, 0, 0), 0.1, "elbow_left", instance=2)
    at = (1.0, 0.0, 0.0)
    assert state("lelbow", at, [elbow]) == Visibility.VISIBLE
    assert state("lelbow", at, [elbow, head]) == Visibility.SELF_OCCLUDED
    assert state("lelbow", at, [elbow, seat]) == Visibility.OCCLUDED
    assert state("lelbow", at, [elbow, other]) == Visibility.OCCLUDED  # the same part, but of another person
    assert state("lelbow", at, [elbow, head, seat]) == Visibility.OCCLUDED  # what the camera sees there decides
    assert state("lelbow", (-1.0, 0, 0), [elbow]) == Visibility.OUTSIDE_IMAGE
    assert state("lelbow", (0.1, 5.0, 0), [elbow]) == Visibility.OUTSIDE_IMAGE
    assert state("lelbow", at, [ball((2.0, 0, 0), 0.1)]) == Visibility.VISIBLE  # nothing in front


def test_the_other_arm_does_not_show_the_joint() -> None:
    elbow, crossed = ball((1.0, 0, 0), 0.05, "elbow_left", instance=1), ball((0.9, 0, 0), 0.05, "forearm_right", instance=1)
    assert state("lelbow", (1.0, 0, 0), [elbow, crossed]) == Visibility.SELF_OCCLUDED


def test_a_knee_behind_the_length_of_its_own_thigh_is_not_visible() -> None:
    for length, expected in ((0.1, Visibility.VISIBLE), (0.45, Visibility.SELF_OCCLUDED)):
        thigh = rod((1.0 - length, 0, 0), (1.05, 0, 0), 0.08, "thigh_left", instance=1)
        assert state("lknee", (1.0, 0, 0), [thigh]) == expected


def test_belts_windows_and_lenses_are_passed_over() -> None:
    chest = ball((1.0, 0, 0), 0.15, "torso_left", instance=1)
    pane = ball((0.5, 0, 0), 0.05)
    at = (1.0, 0.0, 0.0)
    belt = replace(pane, label=np.full(len(pane.faces), LABEL["seat_belt"], np.uint8))
    assert state("chest", at, [chest, belt]) == Visibility.VISIBLE
    for material in ("glass", "spectacle_lens"):
        clear = replace(pane, material=np.full(len(pane.faces), MATERIAL[material], np.uint8))
        assert state("chest", at, [chest, clear]) == Visibility.VISIBLE
    assert state("chest", at, [chest, pane]) == Visibility.OCCLUDED


def test_a_joint_that_the_lens_folds_into_the_image_is_outside() -> None:
    folding = Camera(100, 100, 60.0, 60.0, 49.5, 49.5, (-0.3, 0.0, 0.0, 0.0, 0.0))
    far_out = np.full((1, 20, 3), np.nan)
    far_out[0, 0] = (1.79, 0.0, 1.0)  # distorts to 0.07, near the centre
    assert folding.contains(folding.project(far_out[0, 0], folded=True))
    assert joint_visibility(far_out, [1], room(), np.eye(4), folding)[0, 0] == Visibility.OUTSIDE_IMAGE


def by_rays(joints: NDArray[np.float64], instances: list[int], scene: Surface, view: Matrix, camera: Camera) -> NDArray[np.uint8]:
    """The definition of docs/visibility.md once more, on Embree's first hits."""
    glass = np.isin(scene.material, [MATERIAL["glass"], MATERIAL["spectacle_lens"]])
    keep = ~(glass | (scene.label == LABEL["seat_belt"]))
    solid = replace(
        scene,
        faces=np.ascontiguousarray(scene.faces[keep]),
        label=scene.label[keep],
        material=scene.material[keep],
        instance=scene.instance[keep],
    )
    embree = Embree(solid, view)
    name = {label.id: label.name for label in BODY_PARTS}
    states = np.zeros(joints.shape[:2], np.uint8)
    for p, instance in enumerate(instances):
        for j, joint in enumerate(JOINTS):
            target = joints[p, j]
            if np.isnan(target).any():
                continue
            uv = camera.project(target)
            if not camera.contains(uv) or not np.allclose(camera.unproject(uv, target[2]), target, atol=1e-3):  # folded
                states[p, j] = Visibility.OUTSIDE_IMAGE
                continue
            z, face = embree.cast((target[:2] / target[2])[None])
            if face[0] < 0 or z[0] >= target[2]:
                states[p, j] = Visibility.VISIBLE
            elif solid.instance[face[0]] != instance:
                states[p, j] = Visibility.OCCLUDED
            else:
                distance = np.linalg.norm(target * (1 - z[0] / target[2]))
                own = name.get(int(solid.label[face[0]])) in OWN_PARTS[joint] and distance <= CABINPOSE.reach_m[joint]
                states[p, j] = Visibility.VISIBLE if own else Visibility.SELF_OCCLUDED
    return states


def test_agrees_with_a_ray_test_on_random_points_of_crude_people() -> None:
    rng = np.random.default_rng(7)
    scene = merge([room(subdivide=1), person(1), person(2, (1.9, -0.4, 0.6))])
    view = cabin_view()
    joints = apply(view, rng.uniform((-0.5, -0.6, 0.4), (2.0, 0.7, 1.4), (50, 20, 3)))
    instances = [1, 2] * 25
    for camera in (small_camera(), small_camera(BARREL)):
        ours = joint_visibility(joints, instances, scene, view, camera)
        expected = by_rays(joints, instances, scene, view, camera)
        assert (ours == expected).mean() >= 0.999
        assert all((expected == value).sum() > 10 for value in (1, 2, 3, 4))


def test_agrees_with_a_ray_test_on_people_in_cars() -> None:
    from cabinpose.scene.sensor import SENSORS

    camera = SENSORS["pico_monstar_105"].camera
    agree = total = 0
    for scene, view, joints in people_in_cars():
        ours = joint_visibility(joints, [1, 2], scene, view, camera)
        agree += (ours == by_rays(joints, [1, 2], scene, view, camera)).sum()
        np.testing.assert_array_equal(joint_visibility(joints, [1, 2], scene, view, camera, closed=True), ours)
        total += ours.size
    assert total == 240
    assert agree >= 0.999 * total


def test_joints_without_their_instance_numbers_are_refused() -> None:
    with pytest.raises(ConfigError, match="joints of 2 persons have 1 instance numbers"):
        joint_visibility(np.zeros((2, 20, 3)), [1], room(), FORWARD, small_camera())

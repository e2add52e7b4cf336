"""Augmentation in 3D, held against a scene that is drawn by closed form before and after the motion."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch
import yaml
from scipy import ndimage, stats
from scipy.spatial.transform import Rotation

from cabinpose.core.skeleton import CABINPOSE, JOINTS
from cabinpose.estimate.augment import (
    AugmentConfig,
    Mirror,
    augment,
    draw_motion,
    flip,
    move,
    occlude,
)
from cabinpose.estimate.batch import Batch
from cabinpose.estimate.data import mirrored_labels
from cabinpose.estimate.found import mirrored_slots
from cabinpose.estimate.inputs import InputView
from cabinpose.estimate.training import TrainConfig
from cabinpose.scene.labels import LABEL_ID

VIEW = InputView(64, 48, 51.2)
RAYS = torch.tensor(VIEW.camera.rays.transpose(2, 0, 1), dtype=torch.float32)
WALL_M, PLATE_M = 2.0, 1.2
SLOTS = ("driver", "rear_left", "rear_center", "rear_right")
MIRROR = Mirror(CABINPOSE.mirror, mirrored_slots(SLOTS), torch.from_numpy(mirrored_labels()))
NOTHING = AugmentConfig(shift=0, flip=0, noise_m=0, lost=0, gain=1, occluder=0)


def drawn(shift: tuple[float, float, float] = (0, 0, 0)) -> tuple[np.ndarray, np.ndarray]:
    """Depth (48, 64) of a plate before a wall, both moved by `shift`, and whether the plate is seen."""
    x, y = VIEW.camera.rays[..., 0], VIEW.camera.rays[..., 1]
    z = PLATE_M + shift[2]
    plate = (np.abs(x * z - shift[0]) < 0.3) & (np.abs(y * z - shift[1]) < 0.2)
    return np.where(plate, z, WALL_M + shift[2]), plate


def batch(depth: np.ndarray, joints: np.ndarray | None = None, visibility: int = 4) -> Batch:
    uvz = np.full((1, len(SLOTS), len(JOINTS), 3), np.nan) if joints is None else joints
    return Batch(
        torch.tensor(depth[None], dtype=torch.float32),
        torch.tensor(uvz, dtype=torch.float32),
        torch.full(uvz.shape[:3], visibility, dtype=torch.uint8),
        torch.ones(uvz.shape[:2], dtype=torch.bool),
        torch.arange(depth.size, dtype=torch.float32).reshape(1, *depth.shape),
        torch.full((1, *depth.shape), LABEL_ID["torso_left"], dtype=torch.uint8),
        torch.zeros(1, dtype=torch.bool),
    )


def random_batch(seed: int = 0, frames: int = 3) -> Batch:
    rng = np.random.default_rng(seed)
    shape = (frames, len(SLOTS), len(JOINTS))
    depth = rng.uniform(0.5, 2.5, (frames, 48, 64)) * (rng.random((frames, 48, 64)) > 0.1)
    uvz = np.stack((rng.uniform(-5, 70, shape), rng.uniform(-5, 53, shape), rng.uniform(0.4, 2.4, shape)), -1)
    return Batch(
        torch.tensor(depth, dtype=torch.float32),
        torch.tensor(uvz, dtype=torch.float32),
        torch.tensor(rng.integers(0, 5, shape), dtype=torch.uint8),
        torch.tensor(rng.random(shape[:2]) < 0.7),
        torch.tensor(rng.uniform(0, 400, depth.shape), dtype=torch.float32),
        torch.tensor(rng.integers(0, 34, depth.shape), dtype=torch.uint8),
        torch.tensor(rng.integers(-1, 2, frames), dtype=torch.int8),
        torch.tensor(rng.uniform(0, 255, (frames, 3, *depth.shape[1:])), dtype=torch.float32),
    )


def moved(b: Batch, rotation: np.ndarray, shift: tuple[float, float, float]) -> Batch:
    n = len(b.depth)
    r = torch.tensor(np.broadcast_to(rotation, (n, 3, 3)).copy(), dtype=torch.float32)
    return move(b, r, torch.tensor([shift] * n, dtype=torch.float32), RAYS, VIEW.focal)


@pytest.mark.parametrize("shift", [(0.1, 0, 0), (0, -0.08, 0), (0, 0, 0.1), (0.05, 0.04, -0.1), (-0.2, 0.1, 0.3)])
def test_a_shifted_cloud_is_the_shifted_scene(shift: tuple[float, float, float]) -> None:
    depth, plate = drawn()
    expected, plate_after = drawn(shift)
    got = moved(batch(depth), np.eye(3), shift).depth[0].numpy()
    # What is seen after the shift was seen before it where the same surface lies on the way back: elsewhere nobody can know.
    back = np.concatenate((VIEW.camera.rays, np.ones((48, 64, 1))), -1) * expected[..., None] - shift
    uv = VIEW.camera.project(back)
    inside = (uv > 0).all(-1) & (uv < (63, 47)).all(-1)
    u, v = np.round(np.where(inside[..., None], uv, 0)).astype(int).transpose(2, 0, 1)
    known = inside & (plate[v, u] == plate_after)
    # At the plate's edge the nearest pixel may be either, and a gap there is filled from the nearer.
    edge = ndimage.binary_dilation(plate_after, iterations=2) & ndimage.binary_dilation(~plate_after, iterations=2)
    sure = known & ~edge
    assert sure.mean() > 0.5
    hit = sure & (got > 0)
    assert hit.sum() >= 0.995 * sure.sum()
    assert np.abs(got - expected)[hit].max() < 1e-4


def test_joints_move_as_the_points_do() -> None:
    depth, plate = drawn()
    rows, columns = np.nonzero(plate)
    chosen = np.linspace(0, len(rows) - 1, len(JOINTS)).astype(int)
    uvz = np.stack((columns[chosen], rows[chosen], depth[rows[chosen], columns[chosen]]), -1)
    rotation = Rotation.from_rotvec([0.05, -0.08, 0.1]).as_matrix()
    shift = np.array([0.06, -0.05, 0.1])
    result = moved(batch(depth, np.tile(uvz, (1, len(SLOTS), 1, 1))), rotation, tuple(shift))
    points = VIEW.camera.points(depth)
    middle = points.reshape(-1, 3).mean(0)
    expected = (VIEW.camera.unproject(uvz[:, :2], uvz[:, 2]) - middle) @ rotation.T + middle + shift
    got = result.joints[0, 0].numpy()
    np.testing.assert_allclose(got[:, :2], VIEW.camera.project(expected), atol=2e-3)
    np.testing.assert_allclose(got[:, 2], expected[:, 2], atol=1e-5)
    u, v = np.round(got[:, :2]).astype(int).T
    np.testing.assert_allclose(result.depth[0].numpy()[v, u], got[:, 2], atol=0.02)  # still on the plate's surface


def test_what_leaves_the_image_is_outside_and_what_enters_is_not_known_as_seen() -> None:
    depth, _ = drawn()
    uvz = np.tile([62.0, 24.0, WALL_M], (1, len(SLOTS), len(JOINTS), 1))
    assert (moved(batch(depth, uvz), np.eye(3), (0.3, 0, 0)).visibility == 1).all()
    uvz[..., 0] = 66.0
    assert (moved(batch(depth, uvz, visibility=1), np.eye(3), (-0.3, 0, 0)).visibility == 2).all()


def test_amplitude_and_labels_come_from_where_the_depth_came_from() -> None:
    b = batch(drawn()[0])
    result = moved(b, np.eye(3), (0.15, 0.0, 0.0))
    source = result.amplitude[0].numpy().astype(int)  # each pixel's amplitude is its own number
    hit = result.depth[0].numpy() > 0
    np.testing.assert_allclose(b.depth[0].numpy().ravel()[source][hit], result.depth[0].numpy()[hit], atol=1e-5)
    assert set(np.unique(result.labels.numpy())) == {0, LABEL_ID["torso_left"]}
    assert (result.labels[0].numpy() > 0).tolist() == hit.tolist()


def test_holes_are_filled_only_between_hits() -> None:
    depth = np.full((48, 64), 2.0)
    depth[:, :32] = 0  # nothing is there: no neighbour fills it
    depth[20, 50] = 0  # a lone hole: its nearest neighbour does
    depth[19, 50] = 1.9
    result = moved(batch(depth), np.eye(3), (0, 0, 1e-5)).depth[0].numpy()
    assert (result[:, :32] == 0).all()
    assert result[20, 50] == pytest.approx(1.9, abs=1e-4)
    assert (result[:, 32:] > 0).all()


def test_nothing_drawn_changes_nothing() -> None:
    b = random_batch()
    result = augment(b, NOTHING, RAYS, VIEW.focal, MIRROR, generator=torch.Generator().manual_seed(1))
    for name, before, after in zip(Batch._fields, b, result, strict=True):
        assert torch.equal(before, after), name


def test_the_recipe_of_the_thesis_moves_clouds_as_algorithm_6_2_1_says() -> None:
    path = Path(__file__).parents[2] / "docs" / "models" / "paf-thesis.yaml"
    config = TrainConfig.model_validate(yaml.safe_load(path.read_text(encoding="utf-8")))
    assert (config.optimiser, config.schedule, config.learning_rate, config.weight_decay) == ("adam", "constant", 4e-4, 0.01)
    rotation, shift = draw_motion(20000, config.augment, torch.zeros(20000), torch.Generator().manual_seed(0))
    assert (rotation == torch.eye(3)).all()
    for axis, share in enumerate((0.8 * 0.1, 0.8 * 0.1, 0.8 * 0.8)):
        moved = shift[shift[:, axis] != 0, axis].numpy()
        assert len(moved) / 20000 == pytest.approx(share, abs=4 * np.sqrt(share * (1 - share) / 20000))
        assert stats.kstest(moved, stats.uniform(0, 0.15).cdf).pvalue > 1e-3
    b = random_batch()
    still = config.augment.model_copy(update={"shift": 0.0})
    same = augment(b, still, RAYS, 51.2, MIRROR, generator=torch.Generator().manual_seed(0))
    assert torch.equal(same.depth, b.depth)  # nothing else varies
    assert torch.equal(same.joints.nan_to_num(), b.joints.nan_to_num())


def test_augmentation_follows_its_seed() -> None:
    b = random_batch()
    one, same, other = (
        augment(b, AugmentConfig(), RAYS, VIEW.focal, MIRROR, generator=torch.Generator().manual_seed(seed)) for seed in (3, 3, 4)
    )
    assert torch.equal(one.depth, same.depth)
    assert not torch.equal(one.depth, other.depth)


def test_depths_may_lose_their_scale_while_joints_keep_theirs() -> None:
    b = random_batch()
    config = NOTHING.model_copy(update={"rescale": 1.0, "rescale_sigma": 0.3})
    result = augment(b, config, RAYS, VIEW.focal, MIRROR, generator=torch.Generator().manual_seed(1))
    assert torch.equal(result.joints, b.joints)
    factors = [(result.depth[i] / b.depth[i])[b.depth[i] > 0] for i in range(3)]
    for factor in factors:
        torch.testing.assert_close(factor, factor[:1].expand_as(factor))
    assert len({round(float(factor[0]), 4) for factor in factors}) == 3


def test_images_that_a_method_does_not_read_may_be_absent() -> None:
    b = random_batch()._replace(amplitude=None, labels=None)
    result = augment(b, AugmentConfig(), RAYS, VIEW.focal, MIRROR, generator=torch.Generator().manual_seed(3))
    assert result.amplitude is None
    assert result.labels is None


def test_flip_twice_is_identity_and_once_swaps_sides() -> None:
    b = random_batch()
    every = torch.ones(3, dtype=torch.bool)
    once = flip(b, every, MIRROR, 64)
    for name, before, after in zip(Batch._fields, b, flip(once, every, MIRROR, 64), strict=True):
        torch.testing.assert_close(after, before, msg=name)
    left, right = JOINTS.index("lwrist"), JOINTS.index("rwrist")
    rear_left, rear_right = SLOTS.index("rear_left"), SLOTS.index("rear_right")
    torch.testing.assert_close(once.joints[:, rear_left, left, 0], 63 - b.joints[:, rear_right, right, 0])
    torch.testing.assert_close(once.joints[:, 0, left, 1:], b.joints[:, 0, right, 1:])
    assert torch.equal(once.present[:, rear_left], b.present[:, rear_right])
    hand = b.labels == LABEL_ID["hand_left"]
    assert hand.any()
    assert torch.equal(once.labels.flip(-1) == LABEL_ID["hand_right"], hand)


def test_both_rows_change_sides_and_so_does_the_wheel() -> None:
    slots = ("driver", "front_passenger", "rear_left", "rear_right")  # as many as SLOTS
    b = random_batch()._replace(wheel=torch.tensor([1, -1, 0], dtype=torch.int8))
    once = flip(b, torch.tensor([True, True, False]), MIRROR._replace(slots=mirrored_slots(slots)), 64)
    assert torch.equal(once.present[:2], b.present[:2][:, [1, 0, 3, 2]])
    assert torch.equal(once.present[2], b.present[2])
    neck = JOINTS.index("neck")
    torch.testing.assert_close(once.joints[:2, 0, neck, 0], 63 - b.joints[:2, 1, neck, 0])
    assert once.wheel.tolist() == [-1, 1, 0]


def test_only_chosen_frames_flip() -> None:
    b = random_batch()
    result = flip(b, torch.tensor([False, True, False]), MIRROR, 64)
    assert torch.equal(result.depth[0], b.depth[0])
    assert torch.equal(result.depth[1], b.depth[1].flip(-1))
    assert torch.equal(result.labels[2], b.labels[2])


@pytest.mark.parametrize("seed", range(6))
def test_an_occluder_hides_only_what_is_behind_it(seed: int) -> None:
    b = random_batch(seed, 8)
    chosen = torch.arange(8) % 2 == 0
    result = occlude(b, chosen, generator=torch.Generator().manual_seed(seed))
    plate = result.depth != b.depth
    assert not plate[~chosen].any()
    assert plate[chosen].any()
    assert (result.depth[plate] < torch.where(b.depth == 0, torch.inf, b.depth)[plate]).all()
    assert (result.labels[plate] == 0).all()
    changed = result.visibility != b.visibility
    uv = b.joints[..., :2].round().long()
    inside = ((uv >= 0) & (uv < torch.tensor([64, 48]))).all(-1)
    frame = torch.arange(8)[:, None, None].expand(inside.shape)
    v, u = uv[..., 1].clamp(0, 47), uv[..., 0].clamp(0, 63)
    behind = inside & plate[frame, v, u] & (b.joints[..., 2] > result.depth[frame, v, u])
    assert torch.equal(changed, behind & (b.visibility > 2))
    assert (result.visibility[changed] == 2).all()


def test_what_shows_through_a_surface_is_covered_by_it() -> None:
    depth, plate = drawn()
    depth[24, 32] = WALL_M  # the wall, seen through one pixel of the plate
    result = moved(batch(depth), np.eye(3), (0, 0, 1e-5)).depth[0].numpy()
    assert result[24, 32] == pytest.approx(PLATE_M, abs=1e-4)
    np.testing.assert_allclose(result[~plate], WALL_M, atol=1e-4)

"""Training frames from datasets and from generators."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import small
import torch

from cabinpose.core.errors import DatasetError
from cabinpose.core.skeleton import CABINPOSE, JOINTS
from cabinpose.estimate.augment import Mirror, flip
from cabinpose.estimate.batch import Batch
from cabinpose.estimate.data import FrameSpec, GeneratedFrames, StoredFrames, collate, mirrored_labels, view_frame
from cabinpose.estimate.found import mirrored_slots
from cabinpose.estimate.inputs import InputView

VIEW = InputView(64, 48, 51.2)  # the camera of the sphere people
SPEC = FrameSpec(VIEW, small.PERSONS, labels=True)


def test_a_frame_in_the_cameras_own_view_is_the_frame() -> None:
    made = small.frame(2)
    kept = view_frame(made, SPEC, [0, 1, 2])
    assert np.array_equal(kept.depth, np.round(np.nan_to_num(made["depth"]) / 1e-4).astype(np.uint16))
    assert np.array_equal(kept.amplitude, made["amplitude"])
    assert np.array_equal(kept.labels, made["labels"])
    assert np.array_equal(kept.visibility, made["visibility"])
    point = made["joints_3d"].astype(float)
    expected = np.stack(
        (51.2 * point[..., 0] / point[..., 2] + 31.5, 51.2 * point[..., 1] / point[..., 2] + 23.5, point[..., 2]), -1
    )
    np.testing.assert_allclose(kept.joints, expected, atol=1e-4)


def test_places_and_joints_come_in_the_order_of_the_spec() -> None:
    made = small.frame(2)
    spec = FrameSpec(VIEW, ("rear_left", "driver"), joints=CABINPOSE.sets["upper body"])
    kept = view_frame(made, spec, [2, 0])
    whole = view_frame(made, SPEC, [0, 1, 2])
    columns = [JOINTS.index(name) for name in CABINPOSE.sets["upper body"]]
    np.testing.assert_array_equal(kept.joints, whole.joints[[2, 0]][:, columns])
    np.testing.assert_array_equal(kept.visibility, whole.visibility[[2, 0]][:, columns])


def test_a_joint_beyond_the_view_is_outside() -> None:
    made = small.frame(0)
    kept = view_frame(made, SPEC._replace(view=InputView(16, 16, 51.2)), [0, 1, 2])
    inside = ((kept.joints[..., :2] >= -0.5) & (kept.joints[..., :2] < 15.5)).all(-1)
    seen = made["visibility"] > 1
    assert (seen & ~inside).any()
    assert (kept.visibility[seen & ~inside] == 1).all()
    assert np.array_equal(kept.visibility[inside], made["visibility"][inside])


def wheel_of(made: dict[str, Any]) -> int:
    """What a frame knows of its wheel: 1, or 0 for none; mirrored frames have it on the left."""
    return int(view_frame(made, SPEC, [0, 1, 2]).wheel)


def test_where_the_wheel_is_is_said_or_seen_by_who_sits_where() -> None:
    made = small.frame(2)
    joints = np.full_like(made["joints_3d"], np.nan)
    left, right = JOINTS.index("lpelvis"), JOINTS.index("rpelvis")
    joints[1, left], joints[1, right] = (0.6, 0.2, 1.0), (0.4, 0.2, 1.0)  # the passenger, who looks into the camera
    made["joints_3d"] = joints
    looks_back = np.eye(4)
    looks_back[1, :3] = (1, 0, 0)  # the camera's right is the car's left: there the passenger sits, and the wheel is on the right
    plain = view_frame(made, SPEC, [0, 1, 2])
    assert plain.wheel == 0
    turned = view_frame(made | {"vehicle_from_camera": looks_back}, SPEC, [0, 1, 2])
    assert turned.wheel == 1
    np.testing.assert_array_equal(turned.depth, plain.depth[:, ::-1])
    np.testing.assert_allclose(turned.joints[1, left, 0], SPEC.view.width - 1 - plain.joints[1, right, 0])
    np.testing.assert_allclose(turned.joints[1, left, 1:], plain.joints[1, right, 1:])
    beside = np.eye(4)
    beside[1] = (1, 0, 0, -1.0)  # a camera 1 m to the right of the middle of the car
    assert wheel_of(made | {"vehicle_from_camera": beside}) == 1
    np.testing.assert_array_equal(view_frame(made | {"vehicle_from_camera": beside}, SPEC, [0, 1, 2]).depth, plain.depth)
    faced = made | {"vehicle_from_camera": np.diag([-1.0, 1, 1, 1])[[1, 0, 2, 3]]}  # left hips to the car's right: no wheel
    assert wheel_of(faced) == 0
    assert wheel_of(faced | {"drive_side": "left"}) == 1
    np.testing.assert_array_equal(view_frame(made | {"drive_side": "right"}, SPEC, [0, 1, 2]).depth, turned.depth)


def test_a_frame_with_the_wheel_on_the_right_is_the_mirror_image_of_one_on_the_left() -> None:
    """Augmentation's own mirror image, but for the front row, who stay where their wheel is."""
    made = small.frame(1)
    slots = ("driver", "front_passenger", "rear_left")
    plain, turned = (collate([view_frame(made | {"drive_side": side}, SPEC, [0, 1, 2])]) for side in ("left", "right"))
    order = mirrored_slots(slots, at_wheel=True)
    mirror = Mirror(CABINPOSE.mirror, order, torch.from_numpy(mirrored_labels()))
    flipped = flip(plain, torch.ones(1, dtype=torch.bool), mirror, SPEC.view.width)
    for name, mine, theirs in zip(Batch._fields, flipped, turned, strict=True):
        if name == "wheel":
            assert (mine.tolist(), theirs.tolist()) == ([-1], [1])
        elif mine is not None:
            torch.testing.assert_close(mine, theirs, msg=name, equal_nan=True)


def test_somebody_is_there_who_is_named_and_seen() -> None:
    made = small.frame(2)
    assert view_frame(made, SPEC, [0, 1, 2]).present.tolist() == [True, True, True]
    assert view_frame(made | {"subject": ["A", "", "B"]}, SPEC, [0, 1, 2]).present.tolist() == [True, False, True]
    hidden = made["visibility"].copy()
    hidden[0] = 2
    hidden[0, :2] = 4
    assert view_frame(made | {"visibility": hidden}, SPEC, [0, 1, 2]).present.tolist() == [False, True, True]


def test_a_batch_is_its_frames() -> None:
    frames = StoredFrames(small.dataset(3), SPEC)
    batch = collate([frames[i] for i in range(3)])
    stored = np.nan_to_num(small.dataset(3)["depth"].values)
    np.testing.assert_allclose(batch.depth.numpy(), stored, atol=5.1e-5)
    assert batch.labels.dtype == torch.uint8
    assert frames[1] is frames[1]  # kept in memory


def test_frames_may_come_without_images() -> None:
    bare = small.dataset(2).drop_vars(["depth", "amplitude", "labels"])
    frames = StoredFrames(bare, FrameSpec(VIEW, small.PERSONS, depth=False, amplitude=False))
    batch = collate([frames[0], frames[1]])
    assert batch.depth.shape == (2, 0, 0)
    assert batch.amplitude is None
    assert batch.labels is None
    np.testing.assert_array_equal(batch.visibility.numpy(), bare["visibility"].values)


@pytest.mark.parametrize(
    ("change", "spec", "words"),
    [
        (lambda d: d.isel(frame=[]), SPEC, "no frame"),
        (lambda d: d, SPEC._replace(slots=("driver", "rear_right")), "no place rear_right"),
        (lambda d: d, SPEC._replace(skeleton="itop"), "no itop_joints_3d"),
        (lambda d: d.drop_vars(["labels", "amplitude"]), SPEC, "no amplitude, labels"),
        (lambda d: d.isel(joint=slice(None, None, -1)), SPEC, "another skeleton"),
        (lambda d: d.assign(joints_3d=d["joints_3d"] * np.nan), SPEC._replace(labels=False), "no joint .* has a place in space"),
    ],
)
def test_a_dataset_that_does_not_fit_is_refused(change: Any, spec: FrameSpec, words: str) -> None:
    with pytest.raises(DatasetError, match=words) as caught:
        StoredFrames(change(small.dataset(2)), spec)
    assert caught.value.hint


class Numbered:
    """Frames whose every depth is their number."""

    def __call__(self, index: int) -> dict[str, Any]:
        return small.frame(0) | {"depth": np.full((48, 64), 0.1 + 0.01 * index, np.float32)}


def numbers(frames: GeneratedFrames) -> list[int]:
    return sorted(round((float(kept.depth[0, 0]) * 1e-4 - 0.1) / 0.01) for kept in frames)


def test_each_epoch_makes_other_frames_and_processes_share_them() -> None:
    frames = GeneratedFrames(Numbered(), 7, SPEC, small.PERSONS)
    assert numbers(frames) == list(range(7))
    frames.epoch = 2
    assert numbers(frames) == list(range(14, 21))
    shares = []
    for rank in range(2):
        frames.rank, frames.ranks = rank, 2
        shares.append(numbers(frames))
        assert len(shares[-1]) == len(frames) == 3  # as many each, or one would wait for the other
    assert sorted(shares[0] + shares[1]) == list(range(14, 20))


def test_loader_processes_share_the_frames_too() -> None:
    frames = GeneratedFrames(Numbered(), 6, SPEC, small.PERSONS)
    loader = torch.utils.data.DataLoader(frames, batch_size=2, num_workers=2, collate_fn=collate)
    made = sorted(round((float(z) - 0.1) / 0.01) for batch in loader for z in batch.depth[:, 0, 0])
    assert made == list(range(6))

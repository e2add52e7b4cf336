"""Training frames from datasets and from generators."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import small
import torch

from cabinpose.core.errors import DatasetError
from cabinpose.core.skeleton import CABINPOSE, JOINTS
from cabinpose.estimate.data import FrameSpec, GeneratedFrames, StoredFrames, collate, view_frame
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


def test_a_front_row_that_looks_backwards_is_known_by_its_hips() -> None:
    made = small.frame(2)
    joints = np.full_like(made["joints_3d"], np.nan)
    left, right = JOINTS.index("lpelvis"), JOINTS.index("rpelvis")
    joints[1, left], joints[1, right] = (0.1, 0.2, 1.0), (-0.1, 0.2, 1.0)  # the passenger looks into the camera
    looks_back, looks_ahead = np.eye(4), np.eye(4)
    looks_back[1, :3], looks_ahead[1, :3] = (1, 0, 0), (-1, 0, 0)  # the camera: its right is the car's left, or right
    made["joints_3d"] = joints
    assert not view_frame(made | {"vehicle_from_camera": looks_back}, SPEC, [0, 1, 2]).facing
    ahead = made | {"vehicle_from_camera": looks_ahead}
    assert collate([view_frame(ahead, SPEC, [0, 1, 2])] * 2).facing.tolist() == [True, True]
    assert not view_frame(ahead, SPEC._replace(slots=("driver", "rear_left")), [0, 2]).facing


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

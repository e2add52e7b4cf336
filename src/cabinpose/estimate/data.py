"""Training frames: a dataset's parts, or frames as they are generated, resampled to a model's view.

Frames are read one by one from the Zarr parts. What a view keeps of a frame is small (100 kB at 176x144), so that by
default it stays in memory after the first epoch, as the integers of the disk.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from typing import Any, NamedTuple, TypeAlias

import numpy as np
import psutil
import torch
import xarray as xr
from numpy.typing import NDArray
from torch.utils.data import ConcatDataset, Dataset, IterableDataset

from cabinpose.core import (
    CABINPOSE,
    SIDE_NAMES,
    SKELETONS,
    DatasetError,
    Visibility,
    camera_from,
    has_joint_map,
    told_as,
    wheel_sides,
)
from cabinpose.estimate.batch import NOT_LABELLED, Batch
from cabinpose.estimate.found import mirrored_slots
from cabinpose.estimate.inputs import TICK_M, InputView, Kept, channels_first
from cabinpose.scene import LABEL_ID
from cabinpose.store import dataset_skeleton, frame_ranges, joint_dimension, joints_variable, labelled_joints, merged_ranges

_IMAGES = {"depth": 2, "amplitude": 2, "labels": 1, "rgb": 3}  # bytes of a pixel as it is kept
_SEEN_JOINTS = 3  # of a person, visible or hidden by the body itself, for the person to count as there


class FrameSpec(NamedTuple):
    """What a method takes of a frame: its view, the places, the set of joints with the joints of it, and which images.

    depth_image: the dataset's image that is read as depth. Without depth, joints come in the view's pixels, and none of them
    counts as outside of it. classes: of the pixels, of which the dataset has to have one; a method that learns from them needs no
    joints.
    """

    view: InputView
    slots: tuple[str, ...]
    skeleton: str = CABINPOSE.name
    joints: tuple[str, ...] = CABINPOSE.joints
    depth: bool = True
    amplitude: bool = True
    labels: bool = False
    depth_image: str = "depth"
    classes: tuple[int, ...] = ()
    rgb: bool = False

    @property
    def images(self) -> tuple[str, ...]:
        """The dataset's images that are read."""
        return tuple(self.depth_image if n == "depth" else n for n in _IMAGES if getattr(self, n))

    @property
    def columns(self) -> list[int]:
        """Positions of the joints in the dataset's array."""
        return SKELETONS[self.skeleton].indices(self.joints)


Frames: TypeAlias = Dataset[Kept]  # what trains or validates


class StoredFrames(Dataset[Kept]):
    """The frames of a dataset folder, or of a selection of it."""

    def __init__(self, dataset: xr.Dataset, spec: FrameSpec, *, keep: bool | None = None, taught: Collection[str] = ()) -> None:
        """`keep` frames in memory once they were read; by default where `fits_memory` says so of this dataset alone.

        taught: joints that other frames of the run show; those of them that nobody in this dataset has are not labelled here. A
        joint that no frame of a run shows is learnt to be absent.

        Raises DatasetError for a dataset without frames, of another skeleton, or without one of the places or images.
        """
        self.spec = spec
        self.trained_on = {str(i): frame_ranges(dataset["frame"].values) for i in [dataset.attrs.get("frames_id")] if i}
        self._dataset = dataset
        self._rows = slot_rows(dataset, spec)
        placed, meant = dataset_skeleton(dataset, spec.skeleton), SKELETONS[spec.skeleton]
        self._placed = placed if placed.definition != meant.definition and has_joint_map(placed, meant) else None
        labelled = labelled_joints(dataset, spec.skeleton)
        self._unlabelled = [i for i, joint in enumerate(spec.joints) if joint in taught and joint not in labelled]
        if keep is None:
            keep = fits_memory(dataset.sizes["frame"], spec)
        self._kept: dict[int, Kept] | None = {} if keep else None

    def __len__(self) -> int:
        return int(self._dataset.sizes["frame"])

    def __getitem__(self, index: int) -> Kept:
        if self._kept is not None and index in self._kept:
            return self._kept[index]
        names = [*self.spec.images, joints_variable(self.spec.skeleton), "visibility", "camera_k", "camera_dist", "subject"]
        names += [name for name in ("vehicle_from_camera", "drive_side") if name in self._dataset.variables]
        frame = {name: self._dataset.variables[name][index].values for name in names}  # coordinates would cost two thirds more
        if self._placed is not None:
            frame["joints_3d"] = told_as(frame["joints_3d"], self._placed.joints, self._placed, CABINPOSE)
        kept = view_frame(frame, self.spec, self._rows, self._unlabelled)
        if self._kept is not None:
            self._kept[index] = kept
        return kept


def joined(frames: Sequence[Frames]) -> Frames:
    """Several datasets' frames as one, in their order."""
    return ConcatDataset(frames)


def epoch_order(frames: int, count: int, epoch: int, seed: int) -> list[int]:
    """The `count` frames of an epoch in their order: passes in a row, of which each epoch takes the next stretch."""
    first, last = epoch * count, (epoch + 1) * count
    start = first // frames
    passes = [
        np.random.Generator(np.random.Philox(key=(seed, number))).permutation(frames)
        for number in range(start, -(-last // frames))
    ]
    order: list[int] = np.concatenate(passes)[first - start * frames :][:count].tolist()
    return order


def trained_on(frames: Frames | Sequence[Kept], epochs: int) -> dict[str, str]:
    """Ranges of the frames that so many epochs learn from, by the `frames_id` of their datasets, as far as it is known."""
    if isinstance(frames, ConcatDataset):
        return merged_ranges(*(trained_on(each, epochs) for each in frames.datasets))
    if isinstance(frames, GeneratedFrames):
        return {frames.frames_id: f"0-{epochs * frames.count - 1}"} if frames.frames_id else {}
    return dict(getattr(frames, "trained_on", {}))


def fits_memory(frames: int, spec: FrameSpec) -> bool:
    """Whether that many frames, as they are kept, fill less than half of the memory that is free."""
    bytes_per_pixel = sum(size for name, size in _IMAGES.items() if getattr(spec, name))
    return frames * spec.view.width * spec.view.height * bytes_per_pixel < 0.5 * psutil.virtual_memory().available


class GeneratedFrames(IterableDataset[Kept]):
    """Frames that are made while training: `make(index)` gives the variables of the dataset standard."""

    def __init__(
        self, make: Callable[[int], Mapping[str, Any]], count: int, spec: FrameSpec, persons: Sequence[str], frames_id: str = ""
    ) -> None:
        """`count` frames an epoch, other ones in each; `persons`: the places of the frames; `frames_id`: of a dataset of them."""
        self._make, self.count, self._spec, self.frames_id = make, count, spec, frames_id
        self._rows = [list(persons).index(slot) for slot in spec.slots]
        self.epoch = 0
        self.rank, self.ranks = 0, 1  # which share of an epoch's frames this process makes, and how many share them

    def __len__(self) -> int:
        return self.count // self.ranks

    def __iter__(self) -> Iterator[Kept]:
        worker = torch.utils.data.get_worker_info()
        mine, workers = (worker.id, worker.num_workers) if worker else (0, 1)
        first, step = self.rank + self.ranks * mine, self.ranks * workers
        start = self.epoch * self.count
        for index in range(start + first, start + len(self) * self.ranks, step):
            yield view_frame(self._make(index), self._spec, self._rows)


_WITHOUT = {  # what to do about an image that the dataset does not have
    "rgb": "generate it with images={variables: [rgb]}, or choose a method without it",
    "amplitude": "settings: {amplitude: false} in the file of --config does without, or generate it with this variable",
}


def slot_rows(dataset: xr.Dataset, spec: FrameSpec, *, learnt: bool = True) -> list[int]:
    """Rows of the dataset's `person` that hold the places of a spec. Raises DatasetError where something does not fit.

    learnt: methods learn from joints in space; to be judged by, joints in the image are enough.
    """
    if not dataset.sizes["frame"]:
        raise DatasetError("there is no frame to train on", hint="look at the splits, and at `cabinpose info`")
    persons = [str(name) for name in dataset["person"].values]
    lacking = [slot for slot in spec.slots if slot not in persons]
    if lacking:
        raise DatasetError(f"the dataset has no place {', '.join(lacking)}", hint=f"set slots to some of: {', '.join(persons)}")
    name = joints_variable(spec.skeleton)
    if name not in dataset:
        raise DatasetError(
            f"the dataset has no {name}",
            hint=f"generate it with output.skeletons=[{spec.skeleton}], or set skeleton: cabinpose (rooms have ITOP's joints)",
        )
    absent = [name for name in spec.images if name not in dataset]
    if absent:
        raise DatasetError(f"the dataset has no {', '.join(absent)}", hint=_WITHOUT.get(absent[0], "choose a method without it"))
    whole, found = SKELETONS[spec.skeleton].joints, tuple(dataset[joint_dimension(spec.skeleton)].values)
    if found != whole:
        raise DatasetError(
            f"the dataset has another skeleton: {', '.join(map(str, found))}", hint=f"its joints have to be: {', '.join(whole)}"
        )
    ids = dataset["labels"].attrs.get("flag_values", ()) if spec.classes else ()
    if len(ids) and not set(spec.classes) & set(ids):
        raise DatasetError("the dataset's classes tell no parts of the body apart", hint="set classes: person")
    if not spec.labels and not dataset["visibility"].any():
        raise DatasetError("the dataset has nobody whose joints are known", hint="unet does with pixel classes alone")
    if learnt and not spec.labels and not np.isfinite(dataset[name]).any():
        raise DatasetError(
            f"no joint of the dataset has a place in space ({name} is unknown), which methods learn from",
            hint="labels of images get one by their depth: cabinpose import coco --lift",
        )
    return [persons.index(slot) for slot in spec.slots]


def view_frame(frame: Mapping[str, Any], spec: FrameSpec, rows: Sequence[int], unlabelled: Sequence[int] = ()) -> Kept:
    """One frame of the standard's variables in the view of a spec; `rows` of its persons are the places.

    unlabelled: those of the spec's joints, by position, of which the frame says nothing.

    Places are those of cars with the wheel on the left: of a frame with the wheel on the right it is the mirror image.
    """
    view = spec.view
    joints = np.asarray(frame[joints_variable(spec.skeleton)], dtype=np.float64)[rows]
    uvz = view.to_view(joints)
    states = np.asarray(frame["visibility"])[rows]
    there = [str(frame["subject"][row]) != "" for row in rows]
    seen = np.isin(states, (Visibility.VISIBLE, Visibility.SELF_OCCLUDED)).sum(axis=1) >= _SEEN_JOINTS
    visibility = states if spec.skeleton == CABINPOSE.name else _in_view(uvz, view)
    if spec.depth:  # the camera may see more than the view; a joint whose place is not known is where it is said to be
        beside = np.isfinite(uvz).all(axis=-1) & ~view.camera.contains(uvz[..., :2])
        visibility = np.where((visibility > 1) & beside, Visibility.OUTSIDE_IMAGE, visibility)
    images: dict[str, NDArray[Any]] = {name: np.zeros((0, 0)) for name in _IMAGES}
    for name in spec.images:
        source = camera_from(frame["camera_k"], frame["camera_dist"], *frame[name].shape[1::-1])
        if name == spec.depth_image:
            images["depth"] = np.round(view.depth(frame[name], source) / TICK_M)
        else:
            images[name] = view.resample(channels_first(frame[name]) if name == "rgb" else frame[name], source)
    visibility = visibility[:, spec.columns].astype(np.uint8)
    visibility[np.ix_(there, unlabelled)] = NOT_LABELLED
    wheel = _wheel(frame, spec, joints)
    kept = Kept(
        images["depth"].astype(np.uint16),
        uvz[:, spec.columns].astype(np.float32),
        visibility,
        seen & np.array(there),
        images["amplitude"].astype(np.uint16),
        images["labels"].astype(np.uint8),
        np.array(abs(wheel), np.int8),
        images["rgb"].astype(np.uint8),
    )
    return _mirror_image(kept, spec) if wheel < 0 else kept


def _wheel(frame: Mapping[str, Any], spec: FrameSpec, joints: NDArray[np.float64]) -> int:
    """1 for a wheel on the left, -1 on the right, 0 where there is none or nothing says it. joints: (P, J, 3) m.

    A frame that does not say it has its front row at hand: the driver sits behind the wheel.
    """
    said = SIDE_NAMES.index(str(frame.get("drive_side", "")))
    if said or spec.skeleton != CABINPOSE.name or "vehicle_from_camera" not in frame:
        return -1 if SIDE_NAMES[said] == "right" else said
    hips = joints[:, [CABINPOSE.index["lpelvis"], CABINPOSE.index["rpelvis"]]]
    return int(wheel_sides(hips, np.asarray(frame["vehicle_from_camera"], dtype=np.float64), spec.slots))


def mirrored_labels() -> NDArray[np.uint8]:
    """(256,) the class of the mirrored pixel by the class of the pixel (`scene.labels`): left and right parts change."""
    table = np.arange(256, dtype=np.uint8)
    for name, number in LABEL_ID.items():
        if name.endswith("_left"):
            partner = LABEL_ID[name.removesuffix("left") + "right"]
            table[number], table[partner] = partner, number
    return table


def _mirror_image(kept: Kept, spec: FrameSpec) -> Kept:
    """The mirror image of a frame; the driver stays at the wheel."""
    slots = mirrored_slots(spec.slots, at_wheel=True)
    joints = list(SKELETONS[spec.skeleton].subset(spec.joints).mirror)
    places = kept.joints[slots][:, joints]
    places[..., 0] = spec.view.width - 1 - places[..., 0]
    images = {name: getattr(kept, name)[..., ::-1] for name in ("depth", "amplitude", "rgb")}
    return kept._replace(
        **images,
        joints=places,
        visibility=kept.visibility[slots][:, joints],
        present=kept.present[slots],
        labels=mirrored_labels()[kept.labels[..., ::-1]],
    )


def _in_view(uvz: NDArray[np.float64], view: InputView) -> NDArray[np.uint8]:
    """The standard's states for joints of another set, which carry none of their own: inside the view, outside, or absent."""
    inside = view.camera.contains(uvz[..., :2])
    states = np.where(inside, Visibility.VISIBLE, Visibility.OUTSIDE_IMAGE)
    return np.where(np.isfinite(uvz).all(axis=-1), states, Visibility.ABSENT).astype(np.uint8)


def collate(frames: Sequence[Kept]) -> Batch:
    """Frames in the view as one batch of float tensors."""
    stacked = Kept(*(np.stack(arrays) for arrays in zip(*frames, strict=True)))
    return Batch(
        torch.from_numpy(stacked.depth.astype(np.float32) * np.float32(TICK_M)),
        torch.from_numpy(stacked.joints),
        torch.from_numpy(stacked.visibility),
        torch.from_numpy(stacked.present),
        torch.from_numpy(stacked.amplitude.astype(np.float32)) if stacked.amplitude.size else None,
        torch.from_numpy(stacked.labels) if stacked.labels.size else None,
        torch.from_numpy(stacked.wheel),
        torch.from_numpy(stacked.rgb.astype(np.float32)) if stacked.rgb.size else None,
    )

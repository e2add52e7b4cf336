"""Frames of a dataset one by one, for formats and pages: people in them, tables of classes, PNG files."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from cabinpose.core import (
    ANATOMY,
    CABINPOSE,
    IMAGES,
    JOINT_DEFINITIONS,
    RIG,
    SIDE_NAMES,
    SKELETONS,
    Camera,
    DatasetError,
    Skeleton,
    Visibility,
    camera_from,
    skeleton_with,
    wheel_sides,
)
from cabinpose.store.variables import joint_dimension

if TYPE_CHECKING:
    import xarray as xr

# Who places the joints of datasets that were not generated, by what made them. In a set's own variable they have its names alone.
_PLACED_BY = {
    "cabinpose.align": "those of a suit's or an optical system's model",
    "import coco": "those of the file's annotators",
    "import itop": "those of ITOP's annotators, nearer to the camera",
    "import ntu": "those of Kinect's body tracking",
}


def camera_of(frame: xr.Dataset, width: int, height: int) -> Camera:
    """The checked camera of one frame of a dataset. Raises DatasetError where it cannot be, or is not known."""
    k, dist = frame["camera_k"].values, frame["camera_dist"].values
    return camera_from(k, dist, width, height, whose="the dataset's camera_k", error=DatasetError)


def with_drive_side(dataset: xr.Dataset) -> xr.Dataset:
    """The dataset with its `drive_side`; one without it gets that of the people in front, as far as their places tell it."""
    if "drive_side" in dataset or "vehicle_from_camera" not in dataset or CABINPOSE.joints != tuple(dataset["joint"].values):
        return dataset
    hips = dataset["joints_3d"].sel(joint=["lpelvis", "rpelvis"]).values
    sides = wheel_sides(hips, dataset["vehicle_from_camera"].values, dataset["person"].values.tolist())
    return dataset.assign_coords(drive_side=("frame", np.array(SIDE_NAMES)[sides]))


@dataclass(frozen=True)
class PersonInFrame:
    """One person of one frame. position: index on the person axis · arrays: (J, 3) m, (J, 2) px, (J,) `Visibility`."""

    position: int
    slot: str
    subject: str
    action: str
    joints_3d: NDArray[np.float32]
    joints_2d: NDArray[np.float32]
    visibility: NDArray[np.uint8]


def dataset_skeleton(dataset: xr.Dataset, name: str = CABINPOSE.name) -> Skeleton:
    """The joints of a dataset, or of a frame of it, as a set: the standard's own, or those of another set beside them.

    Where its source placed them itself, they are another set under the same names. Raises DatasetError for one that it lacks.
    """
    dimension = joint_dimension(name)
    if dimension not in dataset.coords:
        known = ", ".join(each for each in SKELETONS if joint_dimension(each) in dataset.coords)
        raise DatasetError(f"the dataset has no joints of the set {name}", hint=f"it has those of {known}")
    found = skeleton_with(tuple(map(str, dataset[dimension].values)), name)
    maker, stated = str(dataset.attrs.get("generator")), str(dataset.attrs.get("joint_definition") or "")
    if name == CABINPOSE.name and maker == "cabinpose.synth" and not stated:
        return found.marked_by(RIG.definition)
    if name == CABINPOSE.name and stated and stated != ANATOMY:
        return found.marked_by(JOINT_DEFINITIONS[stated].definition if stated in JOINT_DEFINITIONS else f"those of {stated}")
    placed_by = _PLACED_BY.get(maker)
    return found if placed_by is None else found.marked_by(placed_by)


def require_variables(dataset: xr.Dataset, format_name: str, names: Sequence[str]) -> None:
    """Raise `DatasetError` for the first variable that a format needs and the dataset does not have."""
    for name in names:
        if name not in dataset:
            raise DatasetError(
                f"{format_name} needs the variable '{name}', which the dataset lacks", hint="export it as png-json"
            )


def frames(dataset: xr.Dataset, images: Sequence[str]) -> Iterator[xr.Dataset]:
    """The frames one after the other, in memory, with the given images and everything that is no image."""
    wanted = [str(n) for n in dataset.data_vars if "y" not in dataset[n].dims] + [n for n in images if n in dataset]
    selected = dataset[wanted]
    small = [name for name in selected.variables if "y" not in selected[name].dims]
    selected[small].load()
    for i in range(dataset.sizes["frame"]):
        yield selected.isel(frame=i).load()


def image_names(dataset: xr.Dataset) -> tuple[str, ...]:
    """The images of a dataset that a detector can be given, of `IMAGES`: a cloud is made of depth."""
    return tuple(name for name in IMAGES if name in dataset or (name == "cloud" and "depth" in dataset))


def frame_images(dataset: xr.Dataset, frames: slice, names: Sequence[str]) -> dict[str, NDArray[Any]]:
    """Images of some frames as a detector gets them.

    Parameters
    ----------
    dataset
        A dataset or a selection of it.
    frames
        Which of its N frames, by position.
    names
        Which images, of `IMAGES`.

    Returns
    -------
    dict
        By name (N, H, W), or (N, H, W, 3) for rgb and cloud, as `FrameBatch` has them.

    Raises
    ------
    DatasetError
        For an image that the dataset does not have; for a cloud also where it does not know its camera.
    """
    part, known = dataset.isel(frame=frames), image_names(dataset)
    for name in names:
        if name not in known:
            raise DatasetError(f"the dataset has no {name}", hint=f"it has {', '.join(known) or 'no images'}")
    return {name: _cloud(part) if name == "cloud" else part[name].values for name in names}


def _cloud(part: xr.Dataset) -> NDArray[np.float32]:
    """(N, H, W, 3) m, each pixel's point in the camera frame."""
    depth = part["depth"].values
    points = np.empty((*depth.shape, 3), np.float32)
    for i, image in enumerate(depth):
        points[i] = camera_of(part.isel(frame=i), depth.shape[2], depth.shape[1]).points(image)
    return points


def people(frame: xr.Dataset, *, named: bool = False) -> list[PersonInFrame]:
    """Everybody in a frame: who has at least one joint that is not absent; named: and who has a subject without joints."""
    visibility = frame["visibility"].values
    there = (visibility != Visibility.ABSENT).any(axis=1) | (named & (frame["subject"].values != ""))
    return [
        PersonInFrame(
            position=i,
            slot=str(frame["person"].values[i]),
            subject=str(frame["subject"].values[i]),
            action=str(frame["action"].values[i]),
            joints_3d=frame["joints_3d"].values[i],
            joints_2d=frame["joints_2d"].values[i],
            visibility=visibility[i],
        )
        for i in np.flatnonzero(there).tolist()
    ]


def file_stem(frame: xr.Dataset) -> str:
    """The name of a frame in files: its index in the dataset."""
    return f"{int(frame['frame']):08d}"


def label_table(dataset: xr.Dataset) -> list[dict[str, Any]]:
    """The pixel classes of a dataset: id, name and colour 0xRRGGBB."""
    attrs = dataset["labels"].attrs
    rows = zip(attrs.get("flag_values", ()), str(attrs.get("flag_meanings", "")).split(), attrs.get("flag_rgb", ()), strict=True)
    return [{"id": int(i), "name": name, "rgb": int(rgb)} for i, name, rgb in rows]


def label_colours(dataset: xr.Dataset) -> NDArray[np.uint8]:
    """(256, 3) RGB by class id; grey for ids without a name."""
    colours = np.full((256, 3), 128, np.uint8)
    for row in label_table(dataset):
        colours[row["id"]] = [row["rgb"] >> 16, row["rgb"] >> 8 & 255, row["rgb"] & 255]
    return colours


def depth_mm(depth_m: NDArray[np.float32]) -> NDArray[np.uint16]:
    """Metres to whole millimetres, 0 where invalid."""
    return np.rint(np.nan_to_num(depth_m) * 1000).astype(np.uint16)


def png(image: NDArray[Any]) -> bytes:
    """As `write_png`, in memory."""
    buffer = BytesIO()
    Image.fromarray(np.ascontiguousarray(image)).save(buffer, "png")
    return buffer.getvalue()


def write_png(path: Path, image: NDArray[Any]) -> None:
    """One PNG: (H, W) uint8 or uint16, or (H, W, 3) uint8 in RGB."""
    path.write_bytes(png(image))

"""What importers of datasets share: sequences, the manifest, filling in frames, reading files."""

from __future__ import annotations

import json
import warnings
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from fnmatch import fnmatchcase
from math import radians
from pathlib import Path
from typing import Any, BinaryIO, NamedTuple

import ijson
import numpy as np
from numpy.typing import NDArray
from PIL import Image

from cabinpose import __version__
from cabinpose.core import (
    CABINPOSE,
    OCCUPANT_SLOTS,
    Camera,
    ConfigError,
    DatasetError,
    Visibility,
    camera_from,
    check_camera,
    surface_depth,
)
from cabinpose.store.convert.camera_file import read_camera
from cabinpose.store.convert.format import ImportOptions
from cabinpose.store.schema import Manifest
from cabinpose.store.source import UNKNOWN
from cabinpose.store.variables import DEPTH_SCALE_M, VARIABLE

_MOST_PX = 20.0  # between the pixels that a file gives and the projection of its points
_LARGEST_PX = 50_000_000  # of an image: every frame is filled up to the largest
_DENSEST = 1032 * 8  # pixels that a byte of a PNG can stand for: deflate's best, of 1 bit each
_FEWEST_BOXES = 5  # from which their order is told
_BETTER, _FITS = 2.0, 0.3  # so many times, and so far, boxes overlap with their people in the order that they are in
_ORDERS: dict[str, Callable[..., tuple[Any, Any, Any, Any]]] = {  # left, top, right and bottom by the order of a box's numbers
    "x, y, width, height": lambda x, y, width, height: (x, y, x + width, y + height),
    "left, top, right, bottom": lambda left, top, right, bottom: (left, top, right, bottom),
    "y, x, height, width": lambda y, x, height, width: (x, y, x + width, y + height),
    "top, left, bottom, right": lambda top, left, bottom, right: (left, top, right, bottom),
    "middle x, middle y, width, height": lambda x, y, width, height: (
        x - width / 2, y - height / 2, x + width / 2, y + height / 2,
    ),
}  # fmt: skip
_DEEPEST = 1000  # brackets within each other; COCO has five. Those in names count, too
_STEPS = np.zeros(256, np.int8)  # in depth, by byte
_STEPS[list(b"[{")], _STEPS[list(b"]}")] = 1, -1
_FRAMES_PER_PART = 10_000  # without images, which are what makes a part large


@dataclass(frozen=True, kw_only=True)
class SequenceOptions(ImportOptions):
    """How a source of several sequences is read."""

    sequences: tuple[str, ...] = ()
    """Only the sequences of these names, in which * stands for anything."""
    every: int = 1
    """Only every Nth frame of a sequence."""

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.every < 1:
            raise ConfigError(f"every {self.every}th frame is none", hint="give --every a number above 0")

    def chosen(self, path: Path, names: list[str]) -> list[str]:
        """Those of the sequences' names that `sequences` asks for; a pattern is of a whole name, or of what follows its `/`."""
        for pattern in self.sequences:
            if not any(_matches(name, pattern) for name in names):
                raise DatasetError(f"{path} has no sequence {pattern}", hint=f"it has {', '.join(names[:8]) or 'none'}")
        return [name for name in names if not self.sequences or any(_matches(name, pattern) for pattern in self.sequences)]


def _matches(name: str, pattern: str) -> bool:
    return fnmatchcase(name, pattern) or fnmatchcase(name.rpartition("/")[2], pattern)


def given_camera(options: ImportOptions, size: tuple[int, int]) -> Camera | None:
    """The camera that the user gave, for images of a size (width, height)."""
    if options.camera is not None:
        return read_camera(options.camera, size)
    if options.fov_deg is not None:
        return check_camera(Camera.from_fov(*size, radians(options.fov_deg)), "--fov-deg")
    if options.intrinsics is None:
        return None
    return check_camera(Camera(*size, *options.intrinsics), "--intrinsics")


class Origin(NamedTuple):
    """Where a dataset comes from: the name of the format, the file or folder, and what the user says of it."""

    format: str
    path: Path
    options: ImportOptions


def make_manifest(
    origin: Origin,
    *,
    frames: int,
    size: tuple[int, int],
    persons: tuple[str, ...] = OCCUPANT_SLOTS,
    variables: tuple[str, ...],
    licence: str = UNKNOWN,
    **values: Any,
) -> Manifest:
    """The manifest of an import; `size` is (width, height), `licence` what the source says of its own."""
    name, path, options = origin
    if not frames:
        raise DatasetError(f"{path} holds no frame to import", hint="check the folder, and what the format leaves out")
    if size[0] * size[1] > _LARGEST_PX:
        raise DatasetError(f"{path} has images of {size[0]}x{size[1]} pixels", hint="no camera has so many; is it damaged?")
    images = [each for each in variables if VARIABLE[each].is_image]
    config = {"format": name, "source": path.name} | values.pop("config", {})
    if (camera := given_camera(options, size)) is not None:
        config["intrinsics_px"] = [camera.fx, camera.fy, camera.cx, camera.cy]
    return Manifest(
        generator=f"import {name}",
        generator_version=__version__,
        seed=0,
        licence=options.licence or licence,
        frames=frames,
        frames_per_part=100 if images else _FRAMES_PER_PART,
        width=size[0],
        height=size[1],
        persons=persons,
        variables=variables,
        config=config,
        **values,
    )


def put_camera(frame: dict[str, Any], camera: Camera) -> None:
    """Give a frame its intrinsics."""
    frame["camera_k"], frame["camera_dist"] = camera.k, np.array(camera.dist)


def lift_visible(frame: dict[str, Any], manifest: Manifest) -> None:
    """Give everybody's visible joints `joints_3d`, where they have none, by the depth (ticks) at their pixels.

    A joint lies on the ray of its pixel, as far behind the surface there as below the skin of an adult of medium size. Raises
    DatasetError without depth or intrinsics.
    """
    if "depth" not in manifest.variables:
        raise DatasetError("there are no images of depth to lift joints by", hint="give 16-bit PNGs in mm with --images")
    if not np.isfinite(frame["camera_k"]).all():
        raise DatasetError("the camera is not known, by which joints are lifted", hint="give its calibration with --camera")
    camera = camera_from(frame["camera_k"], frame["camera_dist"], manifest.width, manifest.height)
    depth = np.where(frame["depth"] > 0, frame["depth"] * DEPTH_SCALE_M, np.nan)
    for person, joint in np.argwhere((frame["visibility"] == Visibility.VISIBLE) & np.isnan(frame["joints_3d"]).any(axis=-1)):
        uv = frame["joints_2d"][person, joint]
        if camera.contains(uv):
            z = surface_depth(depth, uv) + CABINPOSE.skin_m[CABINPOSE.joints[joint]]
            frame["joints_3d"][person, joint] = camera.unproject(uv, z)


def put_person(
    frame: dict[str, Any],
    position: int,
    camera: Camera,
    joints: NDArray[np.integer],
    xyz: NDArray[np.floating],
    visibility: NDArray[np.integer],
) -> None:
    """Fill in somebody's joints, their projections, and their states where they are finite; the other joints are absent.

    What the camera does not have in its image is `OUTSIDE_IMAGE`, whatever the source says of it.

    Parameters
    ----------
    frame
        The frame to fill in.
    position
        The place on the person axis.
    camera
        The camera of the frame.
    joints : (N,)
        Which of our joints the source has, by their indices.
    xyz : (N, 3)
        Where they are, m in our camera frame.
    visibility : (N,)
        What the source says of them.
    """
    known = np.isfinite(xyz).all(axis=-1) & (visibility > Visibility.ABSENT)
    xyz = np.where(known[:, None], xyz, np.nan)
    uv = camera.project(xyz)
    states = np.where(known & ~camera.contains(uv), Visibility.OUTSIDE_IMAGE, visibility)
    frame["joints_3d"][position, joints] = xyz
    frame["joints_2d"][position, joints] = uv
    frame["visibility"][position, joints] = np.where(known, states, Visibility.ABSENT)


def check_projection(
    path: Path, what: tuple[str, str], projected: NDArray[np.floating], given: NDArray[np.floating], *, hint: str
) -> None:
    """Raise `DatasetError` where a file's pixels (..., 2) are not where its points project to, (..., 2) px, in the median.

    what: what the file calls its pixels and its points.
    """
    apart = np.linalg.norm(projected - given, axis=-1)
    if np.isfinite(apart).any() and np.nanmedian(apart) > _MOST_PX:
        raise DatasetError(f"{path}: {what[0]} lie {np.nanmedian(apart):.0f} px from the projection of {what[1]}", hint=hint)


def warn_of_boxes(path: Path, stated: str, boxes: NDArray[np.floating], people: NDArray[np.floating]) -> None:
    """Warn where boxes fit whom they are of much better in another order of their numbers.

    Parameters
    ----------
    path
        The file that they are from.
    stated
        The order that its format has, one of `_ORDERS`.
    boxes : (N, 4)
        As they stand there, px.
    people : (N, 4)
        Left, top, right and bottom of what else is known of each, keypoints or pixels.
    """
    if len(boxes) < _FEWEST_BOXES:
        return
    overlaps = {order: float(np.median(_overlap(np.stack(edges(*boxes.T)), people.T))) for order, edges in _ORDERS.items()}
    best = max(overlaps, key=lambda order: overlaps[order])
    if overlaps[best] > max(_FITS, _BETTER * overlaps[stated]):
        warnings.warn(
            f"{path}: boxes as {stated} overlap with their people by {100 * overlaps[stated]:.0f} % (the median of {len(boxes)}),"
            f" and by {100 * overlaps[best]:.0f} % as {best}: they are in another order than the format's",
            stacklevel=2,
        )


def _overlap(a: NDArray[np.floating], b: NDArray[np.floating]) -> NDArray[np.floating]:
    """(N,) intersection over union of boxes (4, N), left, top, right and bottom."""
    shared = np.maximum(np.minimum(a[2:], b[2:]) - np.maximum(a[:2], b[:2]), 0.0).prod(axis=0)
    both = np.maximum(a[2:] - a[:2], 0.0).prod(axis=0) + np.maximum(b[2:] - b[:2], 0.0).prod(axis=0)
    return np.asarray(shared / np.maximum(both - shared, 1e-9))


def read_image(path: Path, *, floats: bool = False) -> NDArray[Any]:
    """A PNG, JPEG or TIFF as it stands: (H, W) uint8 or uint16, or (H, W, 3) uint8 in RGB. Raises `DatasetError`.

    floats: those of a TIFF are kept, (H, W) float32; else they count as grey.
    """
    try:
        with Image.open(path) as image:
            if (pixels := image.width * image.height) > min(_LARGEST_PX, _DENSEST * path.stat().st_size):
                raise ValueError(f"it claims {pixels} pixels")  # before there is memory for them
            if floats and image.mode == "F":
                return np.asarray(image)
            if image.mode.startswith("I"):  # 16 bits
                grey = np.asarray(image)
                low, high = int(grey.min()), int(grey.max())
                if low < 0 or high > np.iinfo(np.uint16).max:
                    raise DatasetError(f"{path} has values from {low} to {high}", hint="save it with 16 bits, 0 to 65535")
                return grey.astype(np.uint16)
            return np.asarray(image if image.mode == "L" else image.convert("RGB"))
    except (OSError, SyntaxError, ValueError, Image.DecompressionBombError) as error:
        if isinstance(error, OSError) and error.errno is not None:  # of the file system, not of what is in the file
            raise DatasetError(f"cannot read the image {path}: {error}", hint="the source lacks it") from error
        raise DatasetError(f"{path} is no whole image: {error}", hint="it may be cut short; copy it again") from error


def read_grey(path: Path, dtype: type[np.generic], size: tuple[int, int] | None = None) -> NDArray[Any]:
    """(H, W) of a grey image with so many bits to a pixel, of a size (width, height). Raises `DatasetError` for another."""
    image = read_image(path)
    if image.ndim == 3 and (image == image[..., :1]).all():  # saved as grey in colours
        image = image[..., 0]
    if image.ndim != 2 or image.dtype != dtype:
        raise DatasetError(f"{path} is no grey image of {8 * np.dtype(dtype).itemsize} bits", hint="copy the original file")
    if size is not None and image.shape != size[::-1]:
        wrong = f"{path} has {image.shape[1]}x{image.shape[0]} pixels, not {size[0]}x{size[1]}"
        raise DatasetError(wrong, hint="all images of a source have one size")
    return image


def read_json(path: Path) -> Any:
    """The content of a small JSON file; `DatasetError` where it is none."""
    try:
        return json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError, RecursionError) as error:
        raise DatasetError(f"cannot read {path}: {error}", hint="it may be missing or cut short; copy it again") from error


def json_elements(path: Path, keys: Sequence[str], *, hint: str) -> Iterator[tuple[str, Any]]:
    """What a large JSON file has under some keys, as `ijson` calls them, one by one; one element is in memory at a time."""
    try:
        with path.open("rb") as file:
            _check_depth(path, file, hint)
            for key in keys:
                file.seek(0)
                for element in ijson.items(file, key, use_float=True):
                    yield key, element
    except (OSError, ijson.JSONError) as error:
        raise DatasetError(
            f"{path} is no whole JSON object ({str(error).splitlines()[0].strip()})",
            hint="it may be cut short; copy it again, or give another file",
        ) from error


def _check_depth(path: Path, file: BinaryIO, hint: str) -> None:
    """Raise DatasetError where brackets nest deep: ijson's memory grows with the square of the depth."""
    depth = 0
    while block := file.read(1 << 14):
        depths = np.cumsum(_STEPS[np.frombuffer(block, np.uint8)], dtype=np.int32)
        if depth + int(depths.max()) > _DEEPEST:
            raise DatasetError(f"{path} is nested too deep", hint=hint)
        depth += int(depths[-1])

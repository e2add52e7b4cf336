"""Depth images as cameras' tools save them: 16-bit PNG, TIFF of 16 bits or of floats, NumPy's NPY; one, or a folder of them.

A folder holds the images themselves, or `depth/` and beside it `amplitude/` or `ir/` with files of the same names. NPY may hold
a stack (N, H, W). 0, NaN, what is infinite and what a file's type can hold at most are invalid. Frames are numbered in the order
of the names, in which numbers count as numbers. Nobody is labelled.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from cabinpose.core import LENGTHS_M, Camera, ConfigError, DatasetError, units_that_fit
from cabinpose.store.convert.format import DatasetFormat, ImportOptions
from cabinpose.store.convert.reading import Origin, given_camera, make_manifest, put_camera, read_image
from cabinpose.store.schema import Manifest
from cabinpose.store.shard import ticks_of_steps
from cabinpose.store.source import Source, blank_frame

DEPTH_SUFFIXES = (".png", ".tif", ".tiff", ".npy")
_UNITS = ("m", "cm", "mm")  # that --unit knows by name
_AMPLITUDES = ("amplitude", "ir", "infrared", "IR")  # folders beside `depth`
_USUAL_M = (0.2, 10.0)  # median depth of what cameras look at, in cars and in rooms
_LOOKED_AT = 8  # images that tell the unit
_NUMBERS = re.compile(r"(\d+)")
_FORMATS = "16-bit PNG, TIFF of 16 bits or of floats, or NPY"


@dataclass(frozen=True, kw_only=True)
class DepthImageOptions(ImportOptions):
    """How depth images are read."""

    unit: str | None = None
    """Unit of the depth: m, cm, mm, or the metres of one step, such as 0.00025; default: recognised, and told."""
    amplitude: Path | None = None
    """Folder of the amplitude (infrared) images, of the same names; default: `amplitude` or `ir` beside `depth`."""

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.unit is not None:
            step_m(self.unit)


def step_m(unit: str) -> float:
    """The metres of one step of a unit. Raises ConfigError for what is neither a unit nor a length."""
    try:
        step = LENGTHS_M[unit] if unit in _UNITS else float(unit)
    except ValueError:
        step = 0.0
    if not 1e-6 <= step <= 1.0:
        raise ConfigError(f"no unit of depth: {unit}", hint=f"give {', '.join(_UNITS)}, or the metres of one step")
    return step


class DepthImageFormat(DatasetFormat):
    """Depth images of a camera: PNG, TIFF or NPY."""

    import_options = DepthImageOptions

    def read(self, path: Path, options: DepthImageOptions) -> Source:
        """The images of a file or folder in the order of their names.

        Raises `DatasetError` for what holds no depth images, for images of several sizes, and where the unit of the depth is
        neither given nor to be told from its size; `ConfigError` without a camera.
        """
        images = _images(path)
        amplitudes = _amplitudes(path, images, options)
        first = images[0].pixels()
        size = (first.shape[1], first.shape[0])
        camera = given_camera(options, size)
        if camera is None:
            raise ConfigError(
                f"{path}: images do not say what camera took them",
                hint="give --camera FILE (a calibration of OpenCV, ROS, Open3D ...), --intrinsics FX FY CX CY, or --fov-deg",
            )
        step, told = (step_m(options.unit), "") if options.unit else _recognised(path, images)
        manifest = make_manifest(
            Origin("depth-images", path, options), frames=len(images), size=size,
            variables=("depth", *("amplitude",) * bool(amplitudes)), config={"unit_m": step},
        )  # fmt: skip
        return Source(path, manifest, partial(_frames, images, amplitudes, step, camera, manifest), told)


DEPTH_IMAGES = DepthImageFormat()


class _Image(NamedTuple):
    """One image of a file. stacked: its number in a stack · holds: depth, or amplitude, which may have 8 bits."""

    path: Path
    stacked: int | None = None
    holds: str = "depth"

    def pixels(self) -> NDArray[Any]:
        """(H, W) uint16, or another kind of integers or floats. Raises `DatasetError`."""
        if self.path.suffix == ".npy":
            stack = npy_array(self.path)
            return stack if self.stacked is None else stack[self.stacked]
        image = read_image(self.path, floats=True)
        if image.ndim != 2 or (image.dtype == np.uint8 and self.holds == "depth"):
            kind = "colours" if image.ndim == 3 else "8 bits of grey"
            raise DatasetError(f"{self.path} has {kind}, which is no {self.holds}", hint=f"save the {self.holds} as {_FORMATS}")
        return image


def npy_array(path: Path, most_dims: int = 3) -> NDArray[Any]:
    """An NPY of numbers of two dimensions, (H, W), to `most_dims`, (N, H, W), from the disk as it is asked for."""
    try:
        array = np.load(path, mmap_mode="r", allow_pickle=False)
    except Exception as error:  # its header is Python's text, which fails in every way there is
        raise DatasetError(
            f"{path} is no whole NPY: {error}", hint="it may be cut short, or hold objects; save it again"
        ) from error
    if not 2 <= array.ndim <= most_dims or array.dtype.kind not in "uif" or 0 in array.shape:
        raise DatasetError(
            f"{path} holds {array.dtype} of the shape {array.shape}", hint="save numbers of (height, width), or a stack of them"
        )
    return array


def _images(path: Path) -> list[_Image]:
    """The depth images of a file or folder; of a folder with several kinds of files the most frequent."""
    files = [path]
    if path.is_dir():
        folder = path / "depth" if (path / "depth").is_dir() else path
        kinds = [sorted(folder.glob(f"*{suffix}"), key=lambda file: natural_order(file.stem)) for suffix in DEPTH_SUFFIXES]
        files = max(kinds, key=len)
        if not files:
            raise DatasetError(f"{folder} holds no depth images", hint=f"they are {_FORMATS}")
    elif path.suffix not in DEPTH_SUFFIXES:
        raise DatasetError(f"{path} is no depth image", hint=f"depth images are {_FORMATS}")
    return [image for file in files for image in _of_file(file)]


def _of_file(path: Path) -> list[_Image]:
    if path.suffix == ".npy" and (array := npy_array(path)).ndim == 3:
        return [_Image(path, number) for number in range(len(array))]
    return [_Image(path)]


def natural_order(name: str) -> list[tuple[int, str]]:
    """Words and numbers of a name, so that 2 is before 10."""
    return [(int(part), "") if part.isdecimal() else (-1, part) for part in _NUMBERS.split(name)]


def _amplitudes(path: Path, images: Sequence[_Image], options: DepthImageOptions) -> list[_Image]:
    """The amplitude image of each depth image; none where there are none. Raises `DatasetError` where some are missing."""
    beside = [path / name for name in _AMPLITUDES if (path / "depth").is_dir() and (path / name).is_dir()]
    folder = options.amplitude or next(iter(beside), None)
    if folder is None:
        return []
    found = []
    for image in images:
        file = next((f for suffix in DEPTH_SUFFIXES if (f := folder / f"{image.path.stem}{suffix}").exists()), None)
        if file is None:
            raise DatasetError(f"{folder} has no image {image.path.stem}", hint="amplitude images are named as the depth images")
        found.append(_Image(file, image.stacked, "amplitude"))
    return found


def has_depth(pixels: NDArray[Any]) -> NDArray[np.bool_]:
    """Where there is a depth: what is neither 0, below it, NaN, infinite, nor the most that an integer of its kind can be."""
    valid = np.isfinite(pixels) & (pixels > 0)
    if pixels.dtype.kind in "ui":
        valid &= pixels < np.iinfo(pixels.dtype).max
    return valid


def _recognised(path: Path, images: Sequence[_Image]) -> tuple[float, str]:
    """The metres of one step, by the median depth of some images, and what to say of it."""
    chosen = [images[n].pixels() for n in np.unique(np.linspace(0, len(images) - 1, _LOOKED_AT).astype(int))]
    values = np.concatenate([pixels[has_depth(pixels)] for pixels in chosen])
    if not values.size:
        raise DatasetError(f"{path}: no pixel of the images has a depth", hint="are they depth images? 0 and NaN are invalid")
    median = float(np.median(values))
    # Steps of integers are not metres, and cameras deliver no centimetres
    unit = next(iter(units_that_fit(median, _USUAL_M, ("m", "mm"))), None)
    if unit is None or (unit == "m" and values.dtype.kind in "ui"):
        raise DatasetError(
            f"{path}: the unit of the depth cannot be told from its size: the median is {median:.4g}",
            hint="give --unit m, cm, mm, or the metres of one step, such as 0.00025",
        )
    return LENGTHS_M[unit], f"the depth is taken to be in {unit}: its median is {median:.4g} (--unit says otherwise)"


def _frames(
    images: Sequence[_Image], amplitudes: Sequence[_Image], step: float, camera: Camera, manifest: Manifest
) -> Iterator[dict[str, Any]]:
    """The frames, one image in memory at a time."""
    shape = (manifest.height, manifest.width)
    for number, image in enumerate(images):
        frame = blank_frame(manifest)
        pixels = _of_size(image, shape)
        frame["depth"] = ticks_of_steps(np.where(has_depth(pixels), pixels, 0), step)
        if amplitudes:
            frame["amplitude"] = as_amplitude(_of_size(amplitudes[number], shape))
        frame["sequence"] = 0
        put_camera(frame, camera)
        yield frame


def _of_size(image: _Image, shape: tuple[int, int]) -> NDArray[Any]:
    pixels = image.pixels()
    if pixels.shape != shape:
        wrong = f"{image.path} has {pixels.shape[1]}x{pixels.shape[0]} pixels, not {shape[1]}x{shape[0]}"
        raise DatasetError(wrong, hint="all images of a source have one size")
    return pixels


def as_amplitude(pixels: NDArray[Any]) -> NDArray[np.uint16]:
    """(H, W) rounded, and at most what the dataset's integers hold; NaN becomes 0."""
    return np.rint(np.clip(np.nan_to_num(pixels), 0, np.iinfo(np.uint16).max)).astype(np.uint16)

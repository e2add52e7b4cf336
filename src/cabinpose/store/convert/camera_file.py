"""Intrinsics from the files in which the tools of this field keep them.

ROS (`camera_info` and what `camera_calibration` writes), OpenCV's FileStorage as YAML or JSON, Open3D's and RealSense's JSON, and
ours: the fields of a `Camera`, alone or under `camera` or `intrinsics` (as in a sensor, or in what `cabinpose calibrate` writes).
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from numpy.typing import NDArray

from cabinpose.core import Camera, ConfigError, camera_from, parse_yaml

_MATRICES = ("camera_matrix", "K", "k", "camera_k", "intrinsic_matrix", "Camera_Matrix", "M1")
_DISTORTIONS = ("distortion_coefficients", "dist_coeffs", "dist_coefs", "D", "d", "coeffs", "dist", "camera_dist", "D1")
_WIDTHS, _HEIGHTS = ("image_width", "width"), ("image_height", "height")
_WITHIN = ("camera", "intrinsics", "color", "depth")  # what the numbers may lie in
_LARGEST = 1e9  # px; an integer of YAML may be beyond what a float holds
_TAG = re.compile(r"!!opencv-matrix")
_HINT = "a calibration of OpenCV, ROS, Open3D or RealSense, or fx, fy, cx, cy, width and height by name"


def read_camera(path: Path, size: tuple[int, int]) -> Camera:
    """The checked camera of a file, for images of a size (width, height) px.

    Raises
    ------
    ConfigError
        For a file that is missing or says nothing of a camera, has another lens model, or is of images of another size.
    """
    try:
        changed_ns = path.stat().st_mtime_ns
    except OSError as error:
        raise ConfigError(f"cannot read the camera {path}: {error.strerror}", hint=_HINT) from error
    return _read(path, changed_ns, size)


@lru_cache(maxsize=8)  # every frame of an import asks
def _read(path: Path, _changed_ns: int, size: tuple[int, int]) -> Camera:
    try:
        text = path.read_text(encoding="utf-8")
        # OpenCV's directive and its tag are no YAML that others read
        data = parse_yaml(_TAG.sub("", re.sub(r"\A%YAML[^\n]*\n", "", text)).replace("\t", " "))
    except (OSError, UnicodeDecodeError, yaml.YAMLError) as error:
        raise ConfigError(f"cannot read the camera {path}: {error}", hint=_HINT) from error
    found = _mapping_with_camera(data)
    if found is None:
        raise ConfigError(f"{path} says nothing of a camera", hint=_HINT)
    model = str(found.get("distortion_model", found.get("model", "plumb_bob")))
    if model in ("equidistant", "fisheye", "rational_polynomial", "kannala_brandt4"):
        raise ConfigError(f"{path}: the lens model is {model}", hint="calibrate with k1 k2 p1 p2 k3, or undistort the images")
    _check_size(path, found, size)
    return camera_from(_matrix(path, found), _distortion(path, found), *size, whose=str(path))


def _mapping_with_camera(data: Any) -> Mapping[str, Any] | None:
    """The mapping that holds the numbers: the file's own, or one that it names."""
    if not isinstance(data, Mapping):
        return None
    if "fx" in data or any(name in data for name in _MATRICES):
        return data
    return next((found for name in _WITHIN if (found := _mapping_with_camera(data.get(name))) is not None), None)


def _check_size(path: Path, found: Mapping[str, Any], size: tuple[int, int]) -> None:
    stated = tuple(next((found[name] for name in names if name in found), None) for names in (_WIDTHS, _HEIGHTS))
    if None not in stated and stated != size:
        raise ConfigError(
            f"{path} is of images of {stated[0]}x{stated[1]} pixels, and these have {size[0]}x{size[1]}",
            hint="calibrate in the mode that took the images, or give --intrinsics for their size",
        )


def _numbers(path: Path, value: Any, name: str) -> NDArray[np.float64]:
    """Numbers of a list, of rows, or of OpenCV's matrix with its `data`."""
    if isinstance(value, Mapping):
        value = value.get("data")
    try:
        return np.array(value, np.float64).ravel()
    except (TypeError, ValueError, OverflowError) as error:
        raise ConfigError(f"{path}: {name} holds no numbers", hint=_HINT) from error


def _matrix(path: Path, found: Mapping[str, Any]) -> NDArray[np.float64]:
    """(3, 3) px."""
    name = next((name for name in _MATRICES if name in found), None)
    if name is not None:
        numbers = _numbers(path, found[name], name)
        if numbers.size != 9:
            raise ConfigError(f"{path}: {name} has {numbers.size} numbers, not 9", hint="its rows are fx 0 cx, 0 fy cy, 0 0 1")
        columns_first = name == "intrinsic_matrix"  # Open3D writes Eigen's order
        return numbers.reshape(3, 3, order="F" if columns_first else "C")
    values = []
    for names in (("fx",), ("fy",), ("cx", "ppx"), ("cy", "ppy")):
        value = next((found[each] for each in names if each in found), None)
        if not isinstance(value, int | float) or abs(value) > _LARGEST:
            raise ConfigError(f"{path} does not say {names[0]}", hint=_HINT)
        values.append(float(value))
    fx, fy, cx, cy = values
    return np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1]])


def _distortion(path: Path, found: Mapping[str, Any]) -> NDArray[np.float64]:
    """(5,) k1 k2 p1 p2 k3; zeros where the file has none."""
    name = next((name for name in _DISTORTIONS if name in found), None)
    numbers = np.zeros(5) if name is None else _numbers(path, found[name], name)
    numbers = np.pad(numbers, (0, max(0, 5 - numbers.size)))  # OpenCV's shorter forms
    if not numbers[5:].any():
        numbers = numbers[:5]
    if numbers.size != 5:
        raise ConfigError(
            f"{path}: {name} has {numbers.size} coefficients", hint="calibrate with k1 k2 p1 p2 k3, or undistort the images"
        )
    return numbers

"""What importers share: what they found, what a frame says of itself where a source does not, and reading files.

Unknown is said openly: NaN for joints, intrinsics and extrinsics, `ABSENT` for joints that a source does not have,
0 for times and seeds, "unknown" for the names of a frame. Nothing is made up to fill a gap.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from cabinpose import __version__
from cabinpose.core.camera import Camera
from cabinpose.core.errors import ConfigError, DatasetError
from cabinpose.core.pose import Visibility
from cabinpose.store.schema import Manifest

UNKNOWN = "unknown"
_FRAMES_PER_PART = 10_000  # without images, which are what makes a part large


@dataclass(frozen=True)
class ImportOptions:
    """What a user may say about a source.

    keep_invalid: ITOP's frames without valid labels too, their joints absent · intrinsics: (fx, fy, cx, cy) px in place of the
    source's, undistorted · images: folder of COCO's images · licence: of the data, for `dataset.yaml`.
    """

    keep_invalid: bool = False
    intrinsics: tuple[float, float, float, float] | None = None
    images: Path | None = None
    licence: str | None = None

    def __post_init__(self) -> None:
        if self.intrinsics is not None and not (
            all(np.isfinite(self.intrinsics)) and self.intrinsics[0] > 0 and self.intrinsics[1] > 0
        ):
            raise ConfigError(f"no intrinsics: {self.intrinsics}", hint="give fx, fy, cx and cy in px, fx and fy above 0")

    def camera(self, width: int, height: int) -> Camera | None:
        """The camera that the user gave, for images of a size."""
        return Camera(width, height, *self.intrinsics) if self.intrinsics is not None else None


@dataclass(frozen=True)
class Source:
    """A foreign dataset: where it is, the manifest of what becomes of it, and its frames in order, made one by one.

    A frame has a value for each of `manifest.stored`. Iterating raises `DatasetError` where the source is damaged. note: what the
    source has and the dataset will not, for the user to know.
    """

    path: Path
    manifest: Manifest
    frames: Callable[[], Iterator[dict[str, Any]]]
    note: str = ""


def make_manifest(
    format_name: str,
    path: Path,
    options: ImportOptions,
    *,
    frames: int,
    size: tuple[int, int],
    persons: tuple[str, ...],
    variables: tuple[str, ...],
    licence: str = UNKNOWN,
    **values: Any,
) -> Manifest:
    """The manifest of an import; `size` is (width, height), `licence` what the source says of its own."""
    if not frames:
        raise DatasetError(f"{path} holds no frame to import", hint="check the folder, and what the format leaves out")
    images = [name for name in variables if name != "itop_joints_3d"]
    config = {"format": format_name, "source": path.name} | values.pop("config", {})
    if options.intrinsics is not None:
        config["intrinsics_px"] = list(options.intrinsics)
    return Manifest(
        generator=f"import {format_name}",
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


@dataclass(frozen=True)
class BlankFrame:
    """Frames that know nothing yet but their shapes: `new()` gives one to fill in."""

    manifest: Manifest
    _unknown: dict[str, Any] = field(init=False, default_factory=dict)

    def new(self) -> dict[str, Any]:
        """All that is no image: numbers NaN, joints absent, places empty, times 0. Images are the importer's to add."""
        result: dict[str, Any] = {}
        for variable in self.manifest.stored:
            shape = self.manifest.frame_shape(variable)
            if variable.is_image:
                continue
            if variable.dtype == "str":
                result[variable.name] = [""] * shape[0] if shape else UNKNOWN
            elif variable.dtype.startswith("float"):
                result[variable.name] = np.full(shape, np.nan, variable.dtype)
            else:
                result[variable.name] = np.zeros(shape, variable.dtype)
        return result


def put_camera(frame: dict[str, Any], camera: Camera) -> None:
    """Give a frame its intrinsics."""
    frame["camera_k"], frame["camera_dist"] = camera.k, np.array(camera.dist)


def put_person(
    frame: dict[str, Any], position: int, camera: Camera, joints_3d: NDArray[np.floating], visibility: NDArray[np.integer]
) -> None:
    """Fill in somebody's joints (J, 3) m in our camera frame, their projections, and states (J,) where they are finite.

    What the camera does not have in its image is `OUTSIDE_IMAGE`, whatever the source says of it.
    """
    known = np.isfinite(joints_3d).all(axis=-1) & (visibility > Visibility.ABSENT)
    joints = np.where(known[:, None], joints_3d, np.nan)
    uv = camera.project(joints)
    states = np.where(known & ~camera.contains(uv), Visibility.OUTSIDE_IMAGE, visibility)
    frame["joints_3d"][position] = joints
    frame["joints_2d"][position] = uv
    frame["visibility"][position] = np.where(known, states, Visibility.ABSENT)


def read_image(path: Path) -> NDArray[Any]:
    """A PNG or JPEG as it stands: (H, W) uint8 or uint16, or (H, W, 3) uint8 in RGB. Raises `DatasetError`."""
    try:
        with Image.open(path) as image:
            if image.mode.startswith("I"):  # 16 bits
                return np.asarray(image).astype(np.uint16)
            return np.asarray(image if image.mode == "L" else image.convert("RGB"))
    except (OSError, SyntaxError, ValueError, Image.DecompressionBombError) as error:
        if isinstance(error, OSError) and error.errno is not None:  # of the file system, not of what is in the file
            raise DatasetError(f"cannot read the image {path}: {error}", hint="the source lacks it") from error
        raise DatasetError(f"{path} is no whole image: {error}", hint="it may be cut short; copy it again") from error


def read_json(path: Path) -> Any:
    """The content of a small JSON file; `DatasetError` where it is none."""
    try:
        return json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise DatasetError(f"cannot read {path}: {error}", hint="it may be missing or cut short; copy it again") from error


def depth_ticks_of_mm(depth_mm: NDArray[np.uint16]) -> NDArray[np.uint16]:
    """Whole millimetres (0 = invalid) to the ticks of 0.1 mm that a dataset stores; what lies beyond them is invalid."""
    ticks = depth_mm.astype(np.uint32) * 10
    return np.where(ticks < 65536, ticks, 0).astype(np.uint16)

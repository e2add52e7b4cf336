"""The style: a real depth frame with its regions, and the same regions in frames of ours."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from cabinpose.core import Bools, Bytes, ConfigError, Floats32, read_arrays
from cabinpose.scene import FIRST_BODY_ID, LABEL_ID, LAST_BODY_ID
from cabinpose.synth.style.safety import EDGE_M, EDGE_SHARE

REGIONS = ("car", "human", "window")  # by their number in a style frame's masks
NOTHING = 255  # there: the style is not taken from these pixels
_EDGE_PX = 3  # what is as near to an edge is a silhouette
_LEAST_PX = 64
_FAR_M = 50.0  # half of the depths of no camera are farther: they are in mm
_MAKE = "write it with numpy.savez(PATH, depth_m=..., regions=...): see docs/style.md"


@dataclass(frozen=True)
class StyleFrame:
    """A real depth frame. depth_m: (H, W), where invalid that of the nearest valid pixel · valid: (H, W) · guides: (4, H, W), 1
    inside each of `REGIONS` and at silhouettes.
    """

    name: str
    depth_m: Floats32
    valid: Bools
    guides: Floats32

    @classmethod
    def read(cls, path: Path) -> StyleFrame:
        """Of a .npz file with `depth_m` (m, 0 or NaN = invalid) and `regions` (0 car, 1 human, 2 window, 255 not
        to be learnt from); ConfigError otherwise.
        """
        try:
            arrays = read_arrays(path, ("depth_m", "regions"))
        except OSError as error:
            raise ConfigError(f"cannot read {path}: {error.strerror}", hint=_MAKE) from error
        except ValueError as error:
            raise ConfigError(f"{path} is no style frame", hint=_MAKE) from error
        if "depth_m" not in arrays:
            raise ConfigError(f"{path} has no depth", hint=_MAKE)
        if "regions" not in arrays:
            raise ConfigError(f"{path} has no masks of its regions", hint=_MAKE)
        depth, regions = arrays["depth_m"], arrays["regions"]
        if depth.ndim != 2 or min(depth.shape) < _LEAST_PX or not np.issubdtype(depth.dtype, np.floating):
            raise ConfigError(f"{path}: depth_m is no image of metres, {_LEAST_PX} px a side or more", hint=_MAKE)
        if regions.shape != depth.shape or not np.isin(regions, (*range(len(REGIONS)), NOTHING)).all():
            raise ConfigError(f"{path}: regions are not 0 car, 1 human, 2 window or 255 for each pixel of the depth", hint=_MAKE)
        valid = np.isfinite(depth) & (depth > 0)
        if not (regions != NOTHING).any():
            raise ConfigError(f"{path}: all of it is 255, not to be learnt from", hint=_MAKE)
        if valid.any() and np.median(depth[valid]) > _FAR_M:
            raise ConfigError(
                f"{path}: half of its depths are beyond {_FAR_M:g}", hint="depths are metres: divide millimetres by 1000"
            )
        if valid.mean() < 0.1:
            raise ConfigError(f"{path}: fewer than a tenth of its pixels are valid", hint="take a frame with more depth in it")
        at = ndimage.distance_transform_edt(~valid, return_distances=False, return_indices=True)
        whole = depth[tuple(at)].astype(np.float32)
        return cls(path.stem, whole, valid, _guides(regions, whole))


def guides_of(labels: Bytes, depth_clean: Floats32) -> Floats32:
    """(4, H, W) regions of a frame (H, W) by its classes: people, glass, the rest (eq. 5.13 of the thesis), and edges."""
    human = (labels >= FIRST_BODY_ID) & (labels <= LAST_BODY_ID)
    return _guides(np.where(human, 1, np.where(labels == LABEL_ID["glass"], 2, 0)), np.nan_to_num(depth_clean))


def _guides(regions: NDArray[np.integer], depth_m: Floats32) -> Floats32:
    """The insides of the regions, and what of them is near a step of the depth, to which a camera does other things."""
    far, near = ndimage.maximum_filter(depth_m, 3), ndimage.minimum_filter(depth_m, 3)
    edges = ndimage.maximum_filter(far - near > EDGE_M + EDGE_SHARE * near, 2 * _EDGE_PX - 1)
    inside = (regions == np.arange(len(REGIONS))[:, None, None]) & ~edges
    return np.concatenate([inside, (edges & (regions != NOTHING))[None]]).astype(np.float32)

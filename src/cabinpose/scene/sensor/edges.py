"""Abrupt edges of depth, and the rule that takes their pixels out.

Source: Gonçalves (thesis, 2020), equation 5.6.
"""

from __future__ import annotations

import numpy as np
from pydantic import Field

from cabinpose.core import Bools, Floats32
from cabinpose.scene.sensor.buffers import SensorFrame
from cabinpose.scene.sensor.effects import CameraNoise


class EdgeRule(CameraNoise):
    """What is an abrupt edge of depth, and whether its pixels are taken out: of noise models that know edges."""

    edge_threshold_m: float = Field(default=0.10, gt=0, description="Depth step across two pixels that makes an abrupt edge (m).")
    edge_width_px: int = Field(default=1, ge=1, le=8, description="Reach of the central difference that finds edges (px).")
    remove_edges: bool = Field(
        default=False, description="Pixels at abrupt edges of the geometry are invalid, as the thesis sets them to 0."
    )


def edge_pixels(depth: Floats32, rule: EdgeRule) -> Bools:
    """(H, W): where the central difference of depth (m, 0 = nothing) exceeds the threshold; the image's border repeats."""
    reach = rule.edge_width_px
    padded = np.pad(depth, reach, mode="edge")
    across = np.abs(padded[reach:-reach, 2 * reach :] - padded[reach:-reach, : -2 * reach])
    along = np.abs(padded[2 * reach :, reach:-reach] - padded[: -2 * reach, reach:-reach])
    return np.asarray(np.maximum(across, along) > rule.edge_threshold_m)


def invalidate(frame: SensorFrame, where: Bools) -> None:
    """Make pixels (H, W) invalid, in place; their amplitude stays."""
    frame.depth_m[where] = np.nan
    frame.confidence[where] = 0
    frame.noise_m[where] = np.nan

"""Settings of the part affinity fields that are measured on the training frames: places' anchors and skin offsets."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from cabinpose.core import DatasetError, Visibility
from cabinpose.estimate.inputs import TICK_M, Kept
from cabinpose.estimate.paf.config import PafConfig
from cabinpose.estimate.paf.decode import surface_depth

_MOST_M = 0.3  # a surface that far from the joint is not the joint's own skin
_ENOUGH = 20  # joints, for a median to replace the default


def measured(config: PafConfig, frames: Sequence[Kept]) -> PafConfig:
    """The settings with what they leave open measured on some training frames."""
    changes: dict[str, object] = {}
    if config.slot_anchors is None:
        changes["slot_anchors"] = slot_anchors(config, frames)
    if config.skin_offset_m is None:
        changes["skin_offset_m"] = skin_offsets(config, frames)
    return config.model_copy(update=changes)


def slot_anchors(config: PafConfig, frames: Sequence[Kept]) -> dict[str, tuple[float, float]]:
    """Mean (u, v) of the neck in the view, to a tenth of a pixel, of each place where somebody sat in view of the camera.

    Of people whose neck is not known it is the mean of their joints, as in `decode.slots_of`.
    """
    neck = config.joints.index(config.joint_set.spine[0])
    anchors = {}
    for s, slot in enumerate(config.slots):
        people = [f.joints[s] for f in frames if f.present[s]]
        known = [joints[np.isfinite(joints).all(axis=-1)] for joints in people]
        uv = [
            joints[neck, :2] if np.isfinite(joints[neck]).all() else some[:, :2].mean(axis=0)
            for joints, some in zip(people, known, strict=True)
            if len(some)
        ]
        if uv:
            u, v = np.mean(np.asarray(uv, dtype=np.float64), axis=0)
            anchors[slot] = (round(float(u), 1), round(float(v), 1))
    if not anchors:
        raise DatasetError("nobody is seen in the training frames", hint="choose other slots, or frames with people in them")
    return anchors


def skin_offsets(config: PafConfig, frames: Sequence[Kept]) -> dict[str, float]:
    """Median distance along the view between the surface at a visible joint and the joint itself (m, to a millimetre).

    Of joints that too few frames show the default is left.
    """
    found: list[NDArray[np.float64]] = []
    for frame in frames:
        if not frame.depth.size:
            continue
        known = frame.present[:, None] & (frame.visibility == Visibility.VISIBLE)
        uv = np.where(known[..., None], frame.joints[..., :2].astype(np.float64), np.nan)
        surface = surface_depth(frame.depth[None] * TICK_M, uv[None])[0]
        found.append(frame.joints[..., 2] - surface)
    offsets = np.concatenate(found) if found else np.zeros((0, len(config.joints)))
    result = {}
    for j, name in enumerate(config.joints):
        own = offsets[:, j][np.abs(offsets[:, j]) < _MOST_M]
        if len(own) >= _ENOUGH:
            result[name] = round(float(np.median(own)), 3)
    return result

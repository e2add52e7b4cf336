"""How each joint of an aligned skeleton is seen, told from the measured depth alone."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from cabinpose.core import CABINPOSE, JOINTS, Camera, Visibility, surface_depth

F64 = NDArray[np.float64]

_LIMB_M = 0.13  # a surface so near to a bone of the skeleton belongs to its body
_REACH = np.array([*CABINPOSE.reach_m.values()])
_ENDS = np.array(CABINPOSE.limbs)


def visibility(camera: Camera, depth_m: NDArray[np.floating], joints: F64) -> tuple[NDArray[np.uint8], F64]:
    """States (20,) of a person's joints (20, 3) m in the camera frame, and how far (20,) m the surface lies before each.

    depth_m: (H, W), NaN = invalid. The surface at a joint is the median of the valid depths in 5 x 5 pixels. As in generated
    data (docs/visibility.md) a joint is visible where that surface is its own part's: at most `reach_m` before it.
    Otherwise it is hidden: by the body itself where the surface lies within 13 cm of another of its bones, else by something
    else. Where nothing was measured (dark hair, glass) nothing can be said to hide the joint, and it counts as visible. The
    distance is NaN there, and negative where the surface lies behind the joint, as it never does if the alignment is right:
    `align` reports the share.
    """
    uv = camera.project(joints)
    states = np.full(len(JOINTS), Visibility.ABSENT, np.uint8)
    before = np.full(len(JOINTS), np.nan)
    known = np.isfinite(joints).all(axis=-1)
    inside = known & camera.contains(uv)
    states[known & ~inside] = Visibility.OUTSIDE_IMAGE
    ends = joints[_ENDS]
    for joint in np.flatnonzero(inside):
        surface = surface_depth(depth_m, uv[joint])
        states[joint] = Visibility.VISIBLE
        if np.isnan(surface):
            continue
        point = camera.unproject(uv[joint], surface)
        before[joint] = np.linalg.norm(joints[joint]) - np.linalg.norm(point)
        if before[joint] > _REACH[joint]:
            others = (joint != _ENDS).all(axis=1) & np.isfinite(ends).all(axis=(1, 2))
            near = others.any() and _distance(point, ends[others]).min() < _LIMB_M
            states[joint] = Visibility.SELF_OCCLUDED if near else Visibility.OCCLUDED
    return states, before


def _distance(point: F64, ends: F64) -> F64:
    """Distances (B,) m of a point to segments (B, 2, 3)."""
    along = ends[:, 1] - ends[:, 0]
    share = np.einsum("bi,bi->b", point - ends[:, 0], along) / np.maximum(np.einsum("bi,bi->b", along, along), 1e-12)
    nearest: F64 = ends[:, 0] + np.clip(share, 0.0, 1.0)[:, None] * along
    distance: F64 = np.linalg.norm(point - nearest, axis=1)
    return distance

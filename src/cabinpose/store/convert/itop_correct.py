"""Correction of ITOP's labels, some of which lie beside the person: algorithm 6.1.1 of the thesis.

From a seed a region grows over the depth image; the floor is cut off; of what is left, the connected piece that holds the
head is the person, and a joint outside of it goes to its nearest pixel. The thesis' text grows from the torso, its algorithm
from the head. What it leaves open is settled here: a region grows over neighbours (of 4) whose depth is within `REACH_M` of the
seed's, as a limit on steps between neighbours loses arms before the trunk and runs along the floor to the wall; a joint keeps
its depth, since only its place in the image is doubted; and one below the cut, where no mask can be, stays.
"""

from __future__ import annotations

from typing import Any, Literal, NamedTuple

import numpy as np
import scipy
from numpy.typing import NDArray

from cabinpose.core import ITOP, Camera

Seed = Literal["head", "torso"]
REACH_M = 0.8  # an arm's length
FLOOR_ROW, ROWS = 220, 240  # of the thesis, and of ITOP's images; in others the same share of the height
_NEAR_PX = 3  # how far from a label's pixel the nearest measured one may lie, for images of 240 rows

_HEAD = ITOP.joints.index("head")


class Corrected(NamedTuple):
    """joints_3d: (15, 3) m · moved_m: (15,) how far each joint was moved · mask: (H, W) the person, None where none was found."""

    joints_3d: NDArray[np.float64]
    moved_m: NDArray[np.float64]
    mask: NDArray[np.bool_] | None


def corrected(depth: NDArray[np.floating], joints_3d: NDArray[np.floating], camera: Camera, seed: Seed) -> Corrected:
    """ITOP's joints (15, 3), m in our camera frame, on the person that a depth image (H, W) shows, m, 0 or NaN = invalid.

    Parameters
    ----------
    depth, joints_3d
        The frame and its labels.
    camera
        Of the frame.
    seed
        The joint that the region grows from.

    Returns
    -------
    Corrected
        The labels as they were where the image shows nothing at the seed or at the head.
    """
    joints, still = np.array(joints_3d, np.float64), np.zeros(len(ITOP.joints))
    uv = camera.project(joints)
    mask = person_mask(depth, uv[ITOP.joints.index(seed)], uv[_HEAD])
    if mask is None:
        return Corrected(joints, still, None)
    floor = floor_row(len(depth))
    known = np.isfinite(uv).all(axis=1) & camera.contains(uv) & (uv[:, 1] < floor - 0.5)
    column, row = np.where(known[:, None], np.round(uv), 0).astype(int).T
    outside = known & ~mask[row, column]
    rows, columns = scipy.ndimage.distance_transform_edt(~mask, return_distances=False, return_indices=True)
    there = np.stack((columns[row, column], rows[row, column]), axis=-1).astype(np.float64)
    on_mask = np.concatenate(
        (camera.undistort((there - (camera.cx, camera.cy)) / (camera.fx, camera.fy)), np.ones((15, 1))), axis=1
    )
    placed = np.where(outside[:, None], on_mask * joints[:, 2:], joints)
    return Corrected(placed, np.linalg.norm(np.nan_to_num(placed - joints), axis=1), mask)


def person_mask(depth: NDArray[Any], seed: NDArray[np.floating], head: NDArray[np.floating]) -> NDArray[np.bool_] | None:
    """The person in a depth image (H, W), grown from the pixel seed (2,); None where nothing is seen there or at head (2,)."""
    h = len(depth)
    near = _NEAR_PX * h / ROWS
    start = _nearest(np.nan_to_num(depth) > 0, seed, near)
    if start is None:
        return None
    mask = grown(depth, start)
    mask[floor_row(h) :] = False
    top = _nearest(mask, head, near)
    if top is None:
        return None
    pieces, _ = scipy.ndimage.label(mask, np.ones((3, 3)))
    return np.asarray(pieces == pieces[top])


def grown(depth: NDArray[np.floating], start: tuple[int, int]) -> NDArray[np.bool_]:
    """(H, W) the region that grows from a pixel (row, column) over neighbours whose depth is within `REACH_M` of that pixel's."""
    z = np.nan_to_num(depth).astype(np.float64)
    regions, _ = scipy.ndimage.label((z > 0) & (np.abs(z - z[start]) < REACH_M))
    return np.asarray(regions == regions[start])


def floor_row(rows: int) -> int:
    """The first row that counts as floor, in an image of so many rows."""
    return round(FLOOR_ROW * rows / ROWS)


def _nearest(mask: NDArray[np.bool_], uv: NDArray[np.floating], most: float) -> tuple[int, int] | None:
    """(row, column) of the pixel of a mask that is nearest to uv (2,), within `most` px; None without one."""
    rows, columns = np.nonzero(mask)
    if not len(rows) or not np.isfinite(uv).all():
        return None
    apart = np.hypot(columns - uv[0], rows - uv[1])
    best = int(apart.argmin())
    return (int(rows[best]), int(columns[best])) if apart[best] <= most else None

"""Recorded motions as poses: a mocap profile's frames, for a whole body or for the upper body on a seat."""

from __future__ import annotations

from functools import lru_cache
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

from cabinpose.core.errors import MocapError
from cabinpose.core.frames import axis_rotation
from cabinpose.scene.body import DOF_INDEX, DOFS
from cabinpose.scene.body.rig import LOWER, UPPER
from cabinpose.synth.profiles import MocapProfile

if TYPE_CHECKING:
    from cabinpose.store.convert.bvh import UpAxis
    from cabinpose.synth.posture.retarget import Motion

Array = NDArray[np.float64]

_SPINE = tuple(i for i, dof in enumerate(DOFS) if dof.name.split(".")[0] in ("lumbar", "thorax", "neck", "head"))
_ARMS = tuple(
    i for i, dof in enumerate(DOFS) if dof.name[1:].split(".")[0] in ("clavicle", "shoulder", "elbow", "wrist")
)  # fmt: skip


class Recorded(NamedTuple):
    """One frame of a recording: q (D,) rad, and the root's rotation (3, 3) where x is the first pose's heading."""

    q: Array
    root: Array


@lru_cache(maxsize=8)
def _motion(path: str, unit_m: float, up: UpAxis) -> tuple[Motion, float, Array]:
    """A file's retargeted motion, the seconds between frames, and the middle of its spine's angles."""
    from cabinpose.store.convert.bvh import read_bvh  # noqa: PLC0415 - scipy's rotations, for recordings alone
    from cabinpose.synth.posture.retarget import retarget  # noqa: PLC0415 - likewise

    clip = read_bvh(path, unit_m=unit_m, up=up).clip()
    motion = retarget(clip)
    return motion, clip.frame_s, np.median(motion.q, axis=0)


def _frame(profile: MocapProfile, index: int) -> tuple[Motion, int, int, Array]:
    motion, frame_s, middle = _motion(profile.path, profile.unit_m, profile.up)
    count = len(motion.q)
    first = round(profile.start_s / frame_s)
    last = count - 1 if profile.end_s is None else min(round(profile.end_s / frame_s), count - 1)
    if first > last:
        raise MocapError(
            f"the motion begins at {profile.start_s:g} s, but {profile.path} ends after {count * frame_s:.2f} s",
            hint="choose an earlier start_s",
        )
    step = max(1.0 / (profile.rate_hz * frame_s), 1.0)
    poses = int((last - first) / step) + 1
    return motion, first + round((index % poses) * step), first, middle


def recorded_count(profile: MocapProfile) -> int:
    """The number of poses that a mocap profile takes from its recording, before it begins anew."""
    motion, frame_s, _ = _motion(profile.path, profile.unit_m, profile.up)
    last = len(motion.q) - 1 if profile.end_s is None else min(round(profile.end_s / frame_s), len(motion.q) - 1)
    step = max(1.0 / (profile.rate_hz * frame_s), 1.0)
    return int((last - round(profile.start_s / frame_s)) / step) + 1


def recorded_pose(profile: MocapProfile, index: int) -> Recorded:
    """Pose `index` of the recording, from its start again after its end; headings count from the first pose's.

    Raises MocapError for a file that cannot be read or retargeted, or that ends before `start_s`.
    """
    motion, frame, first, _ = _frame(profile, index)
    heading = np.arctan2(motion.root[first, 1, 0], motion.root[first, 0, 0])
    return Recorded(motion.q[frame].copy(), axis_rotation("z", -heading) @ motion.root[frame])


def upper_body_onto(q: Array, profile: MocapProfile, index: int) -> Array:
    """A copy of a seated posture q (D,) rad with the recording's upper body on it.

    Arms are taken as they are, against the chest. The spine keeps the seat's posture and adds the recording's departure
    from its own median, so that a dancer's upright back does not leave the backrest.
    """
    motion, frame, _, middle = _frame(profile, index)
    result = q.copy()
    result[list(_ARMS)] = motion.q[frame][list(_ARMS)]
    spine = list(_SPINE)
    result[spine] += motion.q[frame][spine] - middle[spine]
    for side in "lr":
        result[DOF_INDEX[side + "hand.grip"]] = 0.3
    return np.clip(result, LOWER, UPPER)

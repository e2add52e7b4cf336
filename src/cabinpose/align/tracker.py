"""A mobile tracker on the head in place of the optical system, which is not in a car on the road.

In the head take both see the head: world_from_object(t) = world_from_tracker · tracker_from_body(t) · body_from_object. The first
and the last factor are what is sought; with them the tracker gives what the optical system would have said.
"""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from cabinpose.align.calibration import HeadTracker, KnownDelay, rows
from cabinpose.align.chain import rigid
from cabinpose.align.head import align_head
from cabinpose.align.time import suit_to_optical
from cabinpose.core import AlignmentError, apply, transform
from cabinpose.signals import F64, DelaySearch, product, resample_positions, resample_rotations

Poses = tuple[F64, F64, F64]  # times (T,) s, positions (T, 3) m, orientations (T, 4) wxyz
_GAP_S = 0.05
_MOST_RMS_M = 0.05


def place_tracker(source: str, tracker: Poses, optical: Poses, search: DelaySearch) -> HeadTracker:
    """Where a tracker's world stands in the optical one, and the head object on its body, from a take of the turning head.

    Rotations as `align_head` finds them, then both translations by least squares: R_X R_B t_Y + t_X = t_A - R_X t_B.

    Parameters
    ----------
    source
        What the tracker is called.
    tracker, optical
        Of the body in the tracker's world, of the head object in the optical one; times on the host's axis, NaN = missing.
    search
        Where the delay between both is looked for.

    Raises
    ------
    AlignmentError
        Where the head did not turn about two axes, or the two contradict each other.
    """
    time, position, turned = tracker
    delay = suit_to_optical(time, turned, optical[0], optical[2], search)
    at = delay.to_a(optical[0])
    turned = resample_rotations(time, turned, at, max_gap_s=_GAP_S)
    position = resample_positions(time, position, at, max_gap_s=_GAP_S)
    turn = align_head(turned, optical[2])
    both = np.isfinite(np.concatenate((position, turned, *optical[1:]), axis=1)).all(axis=1)
    x, y = turn.world_from_suit[:3, :3], turn.object_from_head[:3, :3].T
    levers = x @ Rotation.from_quat(turned[both], scalar_first=True).as_matrix()
    a = np.concatenate((levers, np.broadcast_to(np.eye(3), levers.shape)), axis=2).reshape(-1, 6)
    b = (optical[1][both] - position[both] @ x.T).reshape(-1)
    found = np.linalg.lstsq(a, b, rcond=None)[0]
    rms = float(np.sqrt(3 * np.mean((a @ found - b) ** 2)))
    if rms > _MOST_RMS_M:
        raise AlignmentError(
            f"{source} and the optical system see the head {100 * rms:.0f} cm apart",
            hint="check the tracker's unit and that its body is fixed to the cap",
        )
    return HeadTracker(
        source=source,
        world_from_tracker=rows(transform(x, found[3:])),
        body_from_object=rows(transform(y, found[:3])),
        tracker_to_optical=KnownDelay(offset_s=delay.offset_s, interval_s=delay.interval_s, correlation=delay.correlation),
        rms_m=rms,
        rms_rad=turn.rms_rad,
    )


def as_optical(place: HeadTracker, tracker: Poses) -> Poses:
    """What the optical system would have said of the head object, at its stamps, by what the tracker said of its body."""
    time, position, turned = tracker
    world, body = np.array(place.world_from_tracker), np.array(place.body_from_object)
    x, y = (Rotation.from_matrix(m[:3, :3]).as_quat(scalar_first=True) for m in (world, body))
    at = apply(world, (rigid(position, turned) @ body)[:, :3, 3])
    return time + place.tracker_to_optical.offset_s, at, product(product(x, turned), y)

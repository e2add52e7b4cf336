"""A recording of suit, optical system and camera, aligned: the suit's joints in each frame of the camera."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from cabinpose.align.calibration import Calibration
from cabinpose.align.chain import camera_from_suit, joints_in_camera, rigid
from cabinpose.align.head import head_agreement
from cabinpose.align.posture import shifted
from cabinpose.align.streams import frame_times, naming, on_host, seconds
from cabinpose.align.suit import JOINT_POINTS, POINTS, suit_points
from cabinpose.align.surface_fit import fit_surface, fitted_frames, surface_cloud
from cabinpose.align.time import suit_to_optical, trusted
from cabinpose.align.tracker import as_optical
from cabinpose.core import CABINPOSE, AlignmentError, Matrix, UndeterminedError
from cabinpose.signals import Delay, DelaySearch, WindowDelays, resample_positions, resample_rotations
from cabinpose.store.recording import Recording, segment_series, tof_frames

F64 = NDArray[np.float64]
Times = NDArray[np.int64]

OPTICAL_GAP_S = 0.05  # of the optical system: five of its samples at 100 Hz; a head turns by less than 20 degrees meanwhile
SUIT_GAP_S = 0.1  # of the suit: six of its samples at 60 Hz
_DRIFT_FROM_S = 60.0  # on the host's axis no drift is left but the error of its lines, which shorter takes do not tell
REASONS = ("outside the take of the optical system", "no head object", "outside the take of the suit", "a gap of the suit")


@dataclass(frozen=True)
class Aligned:
    """A take in one time and space, T frames of the camera.

    frame_ns (T,): their stamps, on the host's axis · joints (T, 20, 3) m in the camera frame, NaN in frames that are left out ·
    points (T, 25, 4, 4): camera_from_segment of `suit_points`, which the joints are of · pose_corrected: whether the initial pose
    of the suit was corrected · reason (T,): why a frame is left out, "" for those that are not · delay: of the suit against the
    optical system · head_residual (T,): rad, by which the two systems see the head apart (`head_agreement`) · joint_shift
    (T, 20): m, by which depth moved each joint; None where it was not asked.
    """

    subject: str
    frame_ns: Times
    joints: F64
    points: Matrix
    pose_corrected: bool
    reason: tuple[str, ...]
    delay: Delay
    head_residual: F64
    joint_shift: F64 | None = None

    @property
    def kept(self) -> NDArray[np.bool_]:
        """(T,) frames that have the joints."""
        return np.array([not reason for reason in self.reason], np.bool_)

    @property
    def left_out(self) -> dict[str, int]:
        """Frames left out, by reason."""
        return dict(Counter(reason for reason in self.reason if reason))


def align_take(
    recording: Recording, calibration: Calibration, subject: str, *, max_lag_s: float = 2.0, correct_pose: bool = True
) -> Aligned:
    """Put the joints of one person's suit into the camera.

    The camera is master: its images stay as they are, poses are interpolated to them (rotations by SLERP, positions linearly),
    never across gaps. The suit is used relative to its head segment only, so that neither its drift in the world nor its heading
    enters: camera_from_joint = camera_from_world . world_from_object . object_from_head . head_from_joint.

    Parameters
    ----------
    recording, calibration
        The take, and the calibration of its rig.
    subject
        Whose suit.
    max_lag_s
        Greatest difference of the suit's stamps to the optical system's, both on the host's axis.
    correct_pose
        Whether the calibration's correction of the suit's initial pose is applied, where it has one.

    Raises
    ------
    AlignmentError
        Where a stream is lacking, the heads of the two systems do not move alike, or no frame is left.

    References
    ----------
    Gonçalves 2020, section 4.1.2.6.
    """
    names = calibration.names
    head = calibration.head(subject)
    frame_ns = frame_times(recording, names.tof)
    suit = segment_series(recording, head.suit or names.suit, subject)
    source = names.optical if head.tracker is None else head.tracker.source
    optical = segment_series(recording, source, head.head_object or names.head_object)
    suit_ns, optical_ns = on_host(suit), on_host(optical)
    origin = int(frame_ns[0])
    suit_head = CABINPOSE.maps["mvn"]["head"]
    _, suit_orientation = suit.segment(suit_head)
    object_position, object_orientation = optical.segment(names.head_segment)
    since, at = seconds(suit_ns, origin), seconds(optical_ns, origin)
    if head.tracker is not None:
        at, object_position, object_orientation = as_optical(head.tracker, (at, object_position, object_orientation))
    long = since[-1] - since[0] > _DRIFT_FROM_S
    with naming(recording, f"the head of {subject} in the suit (a) against the optical one (b)"):
        try:
            search = DelaySearch(max_lag_s=max_lag_s, drift=long)
            delay = suit_to_optical(since, suit_orientation, at, object_orientation, search)
            delay = trusted(delay, suit.device_ns, optical.device_ns, known=head.suit_to_optical)
        except UndeterminedError:  # a few seconds, or a head that hardly turns: the head take may know
            if head.suit_to_optical is None or head.suit_to_optical.interval_s is None:
                raise
            delay = _as_known(head.suit_to_optical.offset_s, head.suit_to_optical.interval_s, float(since[0]))
    at_optical = seconds(frame_ns, origin) + calibration.tof_to_optical.offset_s
    at_suit = delay.to_a(at_optical)

    object_at = resample_rotations(at, object_orientation, at_optical, max_gap_s=OPTICAL_GAP_S)
    world_from_object = rigid(resample_positions(at, object_position, at_optical, max_gap_s=OPTICAL_GAP_S), object_at)
    orientation = resample_rotations(since, suit.orientation_wxyz, at_suit, max_gap_s=SUIT_GAP_S)
    position = resample_positions(since, suit.position_m, at_suit, max_gap_s=SUIT_GAP_S)
    points = suit_points(suit.names, position, orientation, hands_m=head.hands_m)
    index = suit.names.index(suit_head)
    chain = camera_from_suit(calibration.extrinsics.matrix, world_from_object, head.matrix, points[:, POINTS.index(suit_head)])
    pose_corrected = correct_pose and head.pose_correction is not None
    if correct_pose and head.pose_correction is not None:
        points[..., :3, 3] = shifted(points, head.pose_correction.of_points(POINTS))
    joints = joints_in_camera(chain, points[:, JOINT_POINTS][..., :3, 3])
    points = chain[:, None] @ points
    reason = _reasons(at_optical, at, world_from_object, at_suit, since, joints)
    aligned = Aligned(
        subject, frame_ns, joints, points, pose_corrected, reason, delay,
        head_agreement(orientation[:, index], object_at, head.matrix),
    )  # fmt: skip
    if not aligned.kept.any():
        counted = ", ".join(f"{count} {why}" for why, count in aligned.left_out.items())
        raise AlignmentError(f"{recording.path}: no frame is left: {counted}", hint="look at the take with `cabinpose view`")
    return aligned


def correct_by_depth(recording: Recording, people: Sequence[Aligned], calibration: Calibration) -> list[Aligned]:
    """The people of one take with the errors of each suit's chain corrected by what the camera sees of them (`fit_surface`).

    Joints move by what the fit says, which lies within the suit's stated errors; those of whom nothing is seen stay.
    """
    camera = calibration.intrinsics.camera
    wanted = set(fitted_frames(np.all([each.kept for each in people], axis=0)).tolist())
    clouds = [
        (index, surface_cloud(camera, image.depth_m()))
        for index, (_, image) in enumerate(tof_frames(recording, calibration.names.tof))
        if index in wanted
    ]
    corrected = []
    for each in people:
        shift = fit_surface(each.points, clouds, pose_corrected=each.pose_corrected)
        corrected.append(replace(each, joints=each.joints + shift, joint_shift=np.linalg.norm(shift, axis=2)))
    return corrected


def _as_known(offset_s: float, interval_s: tuple[float, float], reference_s: float) -> Delay:
    """The delay of the head take, as one of this take."""
    nothing = np.zeros(0)
    windows = WindowDelays(nothing, nothing, nothing, nothing)
    return Delay(offset_s, interval_s, 0.0, (0.0, 0.0), reference_s, np.nan, np.nan, windows)


def _reasons(at_optical: F64, optical: F64, world_from_object: F64, at_suit: F64, suit: F64, joints: F64) -> tuple[str, ...]:
    """Why each frame is left out, the first that holds of `REASONS`; "" for those that are not."""
    unmet = np.stack(
        (
            (at_optical < optical[0]) | (at_optical > optical[-1]),
            ~np.isfinite(world_from_object).all(axis=(1, 2)),
            (at_suit < suit[0]) | (at_suit > suit[-1]),
            ~np.isfinite(joints).all(axis=(1, 2)),
        )
    )
    first = np.where(unmet.any(axis=0), unmet.argmax(axis=0), len(REASONS))
    return tuple((*REASONS, "")[index] for index in first)

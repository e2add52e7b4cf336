"""From a rig's calibration takes to its calibration: the file that names them, and the steps from one to the next."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field, model_validator

from cabinpose.align.board import Board, refuse_larger
from cabinpose.align.boardtake import BoardViews, board_views
from cabinpose.align.bundle import BoardSightings, refine_camera_from_world
from cabinpose.align.calibration import (
    Calibration,
    Extrinsics,
    Head,
    HeadTracker,
    Intrinsics,
    KnownDelay,
    Names,
    PoseCorrection,
    Rigid,
    other_equipment,
    rows,
)
from cabinpose.align.chain import rigid
from cabinpose.align.extrinsics import ExtrinsicsResult, camera_from_world, marker_pixels, marker_points
from cabinpose.align.head import HeadAlignment, HeadOffset, align_head, head_offset, measured_offset
from cabinpose.align.intrinsics import IntrinsicsResult, calibrate_from_corners
from cabinpose.align.judge import Placed, believed
from cabinpose.align.pendulum import brightest_blob
from cabinpose.align.posture import n_pose, optical_pose, pose_shifts
from cabinpose.align.streams import camera_identity, equipment, frame_times, naming, on_host, seconds
from cabinpose.align.suit import HANDS_M, JOINT_POINTS, POINTS, Triple, suit_points
from cabinpose.align.time import suit_to_optical, tof_to_optical, trusted
from cabinpose.align.tracker import place_tracker
from cabinpose.core import CABINPOSE, JOINTS, AlignmentError, Camera, Matrix, apply, transform
from cabinpose.signals import Delay, DelaySearch, resample_positions, resample_rotations
from cabinpose.store import read_mapping, validated
from cabinpose.store.recording import Recording, marker_series, segment_series, tof_frames

F64 = NDArray[np.float64]

_GAP_S = 0.05
_HEADING_SPAN_S = 1.0  # in which the suit's heading counts as still
_PIVOT_SPAN_S = 1.5  # in which the trunk of somebody who sits counts as still
_FARTHEST_C1_M, _LONGEST_HAND_M, _LARGEST_ROOM_M = 0.5, 0.25, 50.0  # from the cap; from wrist to finger base; of a laboratory
_GREATEST_LAG_S = 0.5  # on the host's axis: how much the latency of two sources may differ by


class _Model(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid")


class SubjectSession(_Model):
    """A subject's part of a session."""

    take: Annotated[Path, Field(description="recording of suit and optical system while the head nods, tilts and turns")]
    head_offset_m: Annotated[
        Triple | None,
        Field(description="from the head object's origin to C1, measured, in the object's axes, m; left out = fitted"),
    ] = None
    hands_m: Annotated[tuple[Triple, Triple], Field(description="finger bases in the left and right hand segment, m")] = HANDS_M
    suit: Annotated[str | None, Field(description="source of this subject's suit; left out: that of `names`")] = None
    head_object: Annotated[str | None, Field(description="the optical subject on this head; left out: that of `names`")] = None
    pose_take: Annotated[
        Path | None, Field(description="recording of some seconds in a known pose, to correct the suit's calibration by")
    ] = None
    pose_truth: Annotated[
        Literal["n-pose", "optical"],
        Field(description="what the pose is known by: an N-pose, or the optical model of the whole body, named as the subject"),
    ] = "n-pose"
    arms_off_deg: Annotated[float, Field(description="by which the arms of the N-pose hang off the vertical, deg")] = 0.0

    @model_validator(mode="after")
    def _of_a_person(self) -> Self:
        if self.head_offset_m is not None:
            refuse_larger("head_offset_m", math.hypot(*self.head_offset_m), _FARTHEST_C1_M, "cap")
        for hand, side in zip(self.hands_m, (1, -1), strict=True):
            refuse_larger("hands_m", math.hypot(*hand), _LONGEST_HAND_M, "hand")
            if side * hand[1] <= 0:
                raise ValueError("hands_m: the left finger base lies at +y in its hand segment, the right one at -y")
        for key in ("pose_truth", "arms_off_deg"):
            if self.pose_take is None and key in self.model_fields_set:
                raise ValueError(f"{key} says nothing without pose_take, the recording of the pose")
        if self.pose_truth == "optical" and "arms_off_deg" in self.model_fields_set:
            raise ValueError("arms_off_deg is of the N-pose; the optical model of the body knows where the arms are")
        return self


class Session(_Model):
    """What a rig is calibrated from."""

    names: Annotated[Names, Field(description="what the sources and their subjects are called")] = Field(default_factory=Names)
    board: Annotated[Board, Field(description="the checkerboard")] = Field(default_factory=Board)
    intrinsics: Annotated[
        Literal["checkerboard", "camera"], Field(description="fit the lens to the board, or take the camera's own values")
    ] = "checkerboard"
    board_take: Annotated[Path, Field(description="recording of the board, held still here and there before the camera")]
    pendulum_take: Annotated[Path, Field(description="recording of the swinging marker")]
    subjects: Annotated[dict[str, SubjectSession], Field(description="by subject code")] = Field(default_factory=dict)
    vehicle_from_world: Annotated[Rigid | None, Field(description="where the car stands in the optical world, if known")] = None

    @model_validator(mode="after")
    def _in_one_room(self) -> Self:
        if self.vehicle_from_world is not None:
            away = math.hypot(*(row[3] for row in self.vehicle_from_world[:3]))
            refuse_larger("a translation of vehicle_from_world", away, _LARGEST_ROOM_M, "room")
        return self

    @property
    def recordings(self) -> tuple[Path, ...]:
        """All that it names."""
        people = (take for subject in self.subjects.values() for take in (subject.take, subject.pose_take))
        return (self.board_take, self.pendulum_take, *(take for take in people if take is not None))

    @classmethod
    def load(cls, path: Path) -> Session:
        """The session in a YAML file; relative paths are taken from its folder. Raises AlignmentError."""
        hint = "docs/alignment.md has a session to start from"
        session = validated(cls, read_mapping(path, hint=hint, error=AlignmentError), path, hint=hint, error=AlignmentError)
        base = path.parent
        subjects = {
            code: each.model_copy(
                update={"take": base / each.take, "pose_take": None if each.pose_take is None else base / each.pose_take}
            )
            for code, each in session.subjects.items()
        }
        takes = {"board_take": base / session.board_take, "pendulum_take": base / session.pendulum_take}
        return session.model_copy(update={**takes, "subjects": subjects})


@dataclass(frozen=True)
class Calibrated:
    """A calibration and what it was found by: views of the board, both fits of the extrinsics, the delay, each subject's head.

    warnings: what speaks against it.
    """

    calibration: Calibration
    views: BoardViews
    lens: IntrinsicsResult | None
    by_markers: ExtrinsicsResult
    by_corners: ExtrinsicsResult
    delay: Delay
    heads: dict[str, tuple[HeadAlignment, HeadOffset, Delay]]
    warnings: list[str]


def calibrate(session: Session) -> Calibrated:
    """Calibrate a rig: lens, place of the camera, delay of the camera, head of each subject.

    Raises AlignmentError for a step that its take does not determine.
    """
    names = session.names
    with _opened(session.board_take) as recording:
        views = board_views(recording, names, session.board)
        identity, used = camera_identity(recording, names.tof), equipment(recording, names, {})
        with naming(recording, "the camera"):
            found, warnings = believed(
                session.board, views, lambda board, seen: placed(session.model_copy(update={"board": board}), seen)
            )
    lens, camera, by_markers, by_corners = found.lens, found.camera, found.by_markers, found.by_corners
    step = "the marker in the image (a) against the optical one (b)"
    with _opened(session.pendulum_take) as recording, naming(recording, step):
        delay = _pendulum(recording, names, camera, by_corners.camera_from_world)
        if (swung := camera_identity(recording, names.tof)) != identity:
            raise AlignmentError(
                f"the camera is {swung or 'not named'}, that of the board {identity or 'not named'}",
                hint="record board and pendulum with one camera",
            )
        host = recording.head.host
        told = equipment(recording, names, {})
        warnings += [f"{session.pendulum_take.name}: {what}" for what in other_equipment(used, told)]
        used = told | used
    heads, hosts, trackers = {}, {}, {}
    for code, subject in session.subjects.items():
        step = f"the head of {code} in the suit (a) against the optical one (b)"
        with _opened(subject.take) as recording, naming(recording, step):
            heads[code] = _head(recording, names, code, subject)
            trackers[code] = _tracker(recording, names, subject)
            hosts[subject.take.name] = recording.head.host
            told = equipment(recording, names, {code: subject.suit or names.suit})
            warnings += [f"{subject.take.name}: {what}" for what in other_equipment(used, told)]
            used = told | used
    calibration = Calibration(
        names=names,
        intrinsics=Intrinsics(
            width=camera.width, height=camera.height, fx=camera.fx, fy=camera.fy, cx=camera.cx, cy=camera.cy, dist=camera.dist,
            source=session.intrinsics,
            views=sum(view.used for view in lens.views) if lens is not None else 0,
            rms_px=lens.rms_px if lens is not None else None,
            held_out_px=lens.held_out_rms_px if lens is not None else None,
        ),
        extrinsics=_told(by_markers, by_corners),
        tof_to_optical=_plain(delay),
        host=host,
        camera=identity,
        equipment=used,
        heads={
            code: Head(
                suit=session.subjects[code].suit,
                head_object=session.subjects[code].head_object,
                object_from_head=rows(transform(turn.object_from_head[:3, :3], offset.offset)),
                residual_rad=turn.rms_rad,
                suit_to_optical=_plain(late),
                offset=offset.method,
                hands_m=session.subjects[code].hands_m,
                tracker=trackers[code],
                pose_correction=correct_pose(names, code, session.subjects[code], turn.object_from_head),
            )
            for code, (turn, offset, late) in heads.items()
        },
        vehicle_from_world=session.vehicle_from_world,
    )  # fmt: skip
    warnings += [f"{take}: {what}" for take, recorded in hosts.items() for what in calibration.differences(recorded)]
    return Calibrated(calibration, views, lens, by_markers, by_corners, delay, heads, warnings)


def _opened(path: Path) -> Recording:
    if not path.exists():
        raise AlignmentError(f"{path} does not exist", hint="the session names the recordings, relative to its own folder")
    return Recording(path)


def placed(session: Session, views: BoardViews) -> Placed:
    """Lens and place of the camera by the views of the session's board. Raises AlignmentError."""
    lens, camera = _lens(session, views)
    by_markers, by_corners = _extrinsics(session, views, camera)
    return Placed(views, lens, by_corners.camera or camera, by_markers, by_corners)


def _lens(session: Session, views: BoardViews) -> tuple[IntrinsicsResult | None, Camera]:
    """The camera, fitted to the board or as it says of itself."""
    if session.intrinsics == "camera":
        return None, views.camera
    size = (views.camera.width, views.camera.height)
    found = calibrate_from_corners(views.corners, size, session.board, reasons=views.reasons)
    return found, found.camera


def _extrinsics(session: Session, views: BoardViews, camera: Camera) -> tuple[ExtrinsicsResult, ExtrinsicsResult]:
    """camera_from_world by the markers alone (the thesis) and by all corners as well, then with the lens where it is fitted."""
    posed = views.posed(camera, session.board)
    uv = np.stack(
        [marker_pixels(image, camera, pose, session.board) for image, pose in zip(posed.images, posed.poses, strict=True)]
    )
    points = np.stack([marker_points(camera, each, pose, session.board) for each, pose in zip(uv, posed.poses, strict=True)])
    start = camera_from_world(points, posed.p_world, session.board)
    free = session.intrinsics == "checkerboard"
    sightings = BoardSightings(session.board, posed.corners, uv, posed.p_world)
    return start, refine_camera_from_world(camera, sightings, start, lens=free)


def _told(by_markers: ExtrinsicsResult, by_corners: ExtrinsicsResult) -> Extrinsics:
    """What the file says of the extrinsics."""
    deviation = np.sqrt(np.diag(by_corners.covariance))
    with np.errstate(invalid="ignore"):
        each = np.sqrt(np.nanmean(np.where(by_corners.used, by_corners.residual_m, np.nan) ** 2, axis=0))
    return Extrinsics(
        camera_from_world=rows(by_corners.camera_from_world),
        views=int(by_corners.used.any(axis=1).sum()),
        rms_m=by_corners.rms_m,
        held_out_m=by_markers.held_out_rms_m,
        held_out_px=by_corners.held_out_rms_px,
        marker_rms_m={name: float(value) for name, value in zip(by_corners.names, each, strict=True) if np.isfinite(value)},
        sd_m=float(np.linalg.norm(deviation[3:])),
        sd_rad=float(np.linalg.norm(deviation[:3])),
    )


def _pendulum(recording: Recording, names: Names, camera: Camera, camera_from_world: F64) -> Delay:
    """The stamps of the optical system less those of the camera, both on the host's axis."""
    marker = marker_series(recording, names.optical, names.pendulum)
    times = frame_times(recording, names.tof)
    origin = int(times[0])
    seen = np.array([brightest_blob(frame.amplitude) for _, frame in tof_frames(recording, names.tof)])
    place, search = marker.marker(names.pendulum), DelaySearch(max_lag_s=_GREATEST_LAG_S)
    at = seconds(times, origin), seconds(on_host(marker), origin)
    return tof_to_optical(at[0], seen, at[1], place, camera, camera_from_world, search)


def _head(recording: Recording, names: Names, code: str, subject: SubjectSession) -> tuple[HeadAlignment, HeadOffset, Delay]:
    """How the suit's head sits in the optical system's, and the delay between them, from a take of the turning head."""
    rig = CABINPOSE.maps["mvn"]
    suit = segment_series(recording, subject.suit or names.suit, code)
    optical = segment_series(recording, names.optical, subject.head_object or names.head_object)
    position, orientation = optical.segment(names.head_segment)
    origin = int(optical.host_ns[0])
    at = seconds(on_host(optical), origin)
    since = seconds(on_host(suit), origin)
    _, suit_head = suit.segment(rig["head"])
    delay = suit_to_optical(since, suit_head, at, orientation, DelaySearch(max_lag_s=_GREATEST_LAG_S))
    delay = trusted(delay, suit.device_ns, optical.device_ns)
    moments = delay.to_a(at)
    turned = resample_rotations(since, suit_head, moments, max_gap_s=_GAP_S)
    period = float(np.median(np.diff(at)))
    turn = align_head(turned, orientation, span=max(int(_HEADING_SPAN_S / period), 3))
    if subject.head_offset_m is not None:
        return turn, measured_offset(subject.head_offset_m), delay
    trunk, _ = suit.segment(rig["chest"])
    above = resample_positions(since, suit.segment(rig["head"])[0] - trunk, moments, max_gap_s=_GAP_S)
    pivot = apply(turn.world_from_suit, above)
    span = max(int(_PIVOT_SPAN_S / period), 3)
    return turn, head_offset(position, orientation, p_pivot=pivot, spans=span), delay


def _tracker(recording: Recording, names: Names, subject: SubjectSession) -> HeadTracker | None:
    """How the tracker that gives the head in the takes relates to the optical system; None where there is none."""
    if names.tracker is None:
        return None
    both = [
        segment_series(recording, source, subject.head_object or names.head_object) for source in (names.tracker, names.optical)
    ]
    origin = int(both[0].host_ns[0])
    tracker, optical = ((seconds(on_host(series), origin), *series.segment(names.head_segment)) for series in both)
    return place_tracker(names.tracker, tracker, optical, DelaySearch(max_lag_s=_GREATEST_LAG_S))


def correct_pose(names: Names, code: str, subject: SubjectSession, object_from_head: Matrix) -> PoseCorrection | None:
    """The correction of a subject's suit by the take of a known pose; None where there is no such take.

    object_from_head: (4, 4), of which the rotation counts. Raises AlignmentError where the pose was not held, was another one, or
    is not known.
    """
    if subject.pose_take is None:
        return None
    with _opened(subject.pose_take) as recording, naming(recording, f"the pose of {code}"):
        suit = segment_series(recording, subject.suit or names.suit, code)
        points = suit_points(suit.names, suit.position_m, suit.orientation_wxyz, hands_m=subject.hands_m)
        if subject.pose_truth == "n-pose":
            places = n_pose(points, np.radians(subject.arms_off_deg))
        else:
            body = segment_series(recording, names.optical, code)
            rig = CABINPOSE.maps["vicon_kinematic_fit"]
            known = [joint for joint in JOINTS if rig[joint] in body.names]
            joints = np.full((len(body.host_ns), len(POINTS), 3), np.nan)
            for joint in known:
                joints[:, JOINT_POINTS[CABINPOSE.index[joint]]] = body.segment(rig[joint])[0]
            # The person stands still: the delay of some hundredths of a second between the systems does not matter.
            origin = int(suit.host_ns[0])
            at = seconds(on_host(suit), origin)
            joints = resample_positions(seconds(on_host(body), origin), joints, at, max_gap_s=_GAP_S)
            cap = segment_series(recording, names.optical, subject.head_object or names.head_object)
            _, turned = cap.segment(names.head_segment)
            turned = resample_rotations(seconds(on_host(cap), origin), turned, at, max_gap_s=_GAP_S)
            head = rigid(np.zeros((len(at), 3)), turned) @ object_from_head
            places = optical_pose(points, joints, head[:, :3, :3])
        shifts = pose_shifts(points, places)
    return PoseCorrection(
        truth=subject.pose_truth, shifts_m={name: tuple(x) for name, x in zip(POINTS, shifts.tolist(), strict=True) if any(x)}
    )


def _plain(delay: Delay) -> KnownDelay:
    return KnownDelay(offset_s=delay.offset_s, interval_s=delay.interval_s, correlation=delay.correlation)

"""Aligned takes as a dataset of the standard, the same to everything downstream as a generated one."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cabinpose import __version__
from cabinpose.align.calibration import Calibration, other_equipment
from cabinpose.align.judge import judge_head
from cabinpose.align.project import Aligned, align_take, correct_by_depth
from cabinpose.align.streams import camera_identity, equipment, naming
from cabinpose.align.visibility import visibility
from cabinpose.core import JOINTS, OCCUPANT_SLOTS, SIDE_NAMES, STANDING_SLOT, AlignmentError, DriveSide, invert, wheel_sides
from cabinpose.signals import FRAME_IMAGES, ToFFrame
from cabinpose.store import UNKNOWN, Manifest, Source, blank_frame, ticks_of_steps
from cabinpose.store.convert import put_camera, put_person
from cabinpose.store.recording import Recording, Take, files_of_take, tof_frames

POV = "tof"
_ALL = np.arange(len(JOINTS))
FLOATING_M = 0.02  # a joint farther before the surface is not inside the body that it belongs to


@dataclass
class TakeReport:
    """What became of a person in a take.

    Attributes
    ----------
    recording, sequence, subject, person
        File and number of the take, the person's code and place in the dataset.
    frames, kept, left_out
        Frames of the camera in the take, those that the dataset has, and the others by reason.
    suit_delay_ms, suit_delay_interval_ms, correlation, drift_ppm
        Of the suit against the optical system.
    head_deg
        Rms and worst angle between the heads of both systems, in the frames that are kept.
    pose_corrected
        Whether the suit's initial pose was corrected.
    depth_corrected_cm
        Mean distance by which depth moved each joint; empty where it was not asked.
    joints_measured, joints_floating
        Joints in the image whose depth was measured, and those of them that lie more than 2 cm before the measured surface.
    states
        Joints by state.
    """

    recording: str
    sequence: int
    subject: str
    person: str
    frames: int
    kept: int
    left_out: dict[str, int]
    suit_delay_ms: float
    suit_delay_interval_ms: tuple[float, float]
    correlation: float
    drift_ppm: float
    head_deg: tuple[float, float]
    pose_corrected: bool
    depth_corrected_cm: dict[str, float]
    joints_measured: int = 0
    joints_floating: int = 0
    states: Counter[int] = field(default_factory=Counter)

    @property
    def floating(self) -> float:
        """Share of floating joints; NaN where the depth told nothing."""
        return self.joints_floating / self.joints_measured if self.joints_measured else float("nan")


@dataclass(frozen=True)
class SuitCorrections:
    """Which errors of the suits are corrected.

    pose: of the initial pose, where the calibration knows them · depth: of the chain, by what the camera sees of who wears it.
    """

    pose: bool = True
    depth: bool = False


@dataclass(frozen=True)
class AlignedTakes:
    """Takes ready to be written.

    Attributes
    ----------
    source
        The dataset's frames.
    reports
        Of each take and person, filled while the frames are written.
    warnings
        What speaks against the calibration for a take.
    """

    source: Source
    reports: list[TakeReport]
    warnings: list[str]


@dataclass(frozen=True)
class _AlignedTake:
    """A take, its people with the report of each, and the frames (T,) in which the pose of all of them is known."""

    path: Path
    take: Take
    drive_side: str
    people: list[tuple[Aligned, TakeReport]]
    kept: NDArray[np.bool_]

    @property
    def unknown_side(self) -> str:
        """What to say of a take in a car of which nobody knows where its wheel is."""
        if self.drive_side or not {report.person for _, report in self.people} & set(OCCUPANT_SLOTS):
            return ""
        return (
            f"{self.path.name}: on which side the wheel is is not known, and models that tell seats by place (paf, dpm, walks)"
            " take it for the side that they learnt: say it with --drive-side left or right, or `drive_side` in the rig's take"
        )


def align_takes(
    paths: Sequence[Path],
    calibration: Calibration,
    *,
    subject: str | None = None,
    drive_side: DriveSide | None = None,
    max_lag_s: float = 2.0,
    corrections: SuitCorrections = SuitCorrections(),
    licence: str = "private",
) -> AlignedTakes:
    """Align recordings of one rig and make of them the frames of a dataset.

    The frames are those of the camera in which the pose of everybody in the take is known, takes one after another (`sequence`
    counts them), images as recorded.

    Parameters
    ----------
    paths
        The recordings.
    calibration
        Of their rig.
    subject
        The only person whose suit is used; None: everybody whom a take names.
    drive_side
        Where the wheel is in all takes; None: as each take says, else as driver or front passenger sit in a car whose place is
        calibrated.
    max_lag_s
        As in `align_take`.
    corrections
        Of the suits' errors.
    licence
        Of the dataset.

    Raises
    ------
    AlignmentError
        Where a take is named twice or cannot be aligned, or where cameras differ in size or in the images that they give.
    """
    takes, warnings = [], []
    _refuse_twice(paths)
    images = _images(paths, calibration)  # before the first take is aligned, which takes minutes
    for sequence, path in enumerate(paths):
        with Recording(path) as recording:
            codes = [subject] if subject else list(recording.take.codes)
            if not codes:
                raise AlignmentError(f"{path} names no subject", hint="name the people in the rig's `take`, or give --subject")
            people = [
                align_take(recording, calibration, code, max_lag_s=max_lag_s, correct_pose=corrections.pose) for code in codes
            ]
            if corrections.depth:
                people = correct_by_depth(recording, people, calibration)
            with naming(recording, "the camera"):
                doubt = calibration.check_camera(camera_identity(recording, calibration.names.tof))
            told = equipment(recording, calibration.names, calibration.suits(codes))
            doubts = [*([doubt] if doubt else []), *calibration.differences(recording.head.host)]
            doubts += other_equipment(calibration.equipment, told)
            warnings += [f"{path.name}: {what}" for what in doubts]
            take = recording.take if drive_side is None else recording.take.model_copy(update={"drive_side": drive_side})
            takes.append(_joined(path, sequence, take, people, calibration))
            warnings += filter(None, (_other_side(takes[-1], calibration), takes[-1].unknown_side))
            for _, report in takes[-1].people:
                calibrated = calibration.head(report.subject).residual_rad
                with naming(recording, report.subject):
                    doubt = judge_head(report.head_deg[0], None if calibrated is None else float(np.degrees(calibrated)))
                warnings += [f"{path.name}: {report.subject}: {doubt}"] if doubt else []
    reports = [report for each in takes for _, report in each.people]
    places = tuple(dict.fromkeys(report.person for report in reports))
    persons = OCCUPANT_SLOTS if set(places) <= set(OCCUPANT_SLOTS) else places
    lens = calibration.intrinsics
    manifest = Manifest(
        generator="cabinpose.align", generator_version=__version__, seed=0, licence=licence, width=lens.width, height=lens.height,
        frames=sum(int(each.kept.sum()) for each in takes), persons=persons,
        variables=(
            *images, "head_residual", *(("joint_shift",) if corrections.depth else ()),
            *(("drive_side",) if any(each.drive_side for each in takes) else ()),
        ),
        config={
            "calibration": calibration.model_dump(mode="json"),
            "takes": [
                {
                    "recording": report.recording, "subject": report.subject, "frames": report.frames,
                    "left_out": report.left_out, "suit_delay_s": report.suit_delay_ms / 1000,
                    "suit_drift_ppm": report.drift_ppm, "pose_corrected": report.pose_corrected,
                    **({"depth_corrected": True} if corrections.depth else {}),
                }
                for report in reports
            ],
        },
    )  # fmt: skip

    def frames() -> Iterator[dict[str, Any]]:
        for each in takes:
            yield from _frames_of(each, calibration, manifest)

    return AlignedTakes(Source(paths[0], manifest, frames), reports, warnings)


def _refuse_twice(paths: Sequence[Path]) -> None:
    """Raise AlignmentError for a take that is named twice, or a later file of one beside its first, which stands for all."""
    named: dict[Path, int] = {}
    for number, path in enumerate(paths):
        for file in files_of_take(path):
            if (other := named.setdefault(file.resolve(), number)) != number:
                told = f"{path} is named twice" if path == paths[other] else f"{paths[other]} and {path} both hold {file}"
                raise AlignmentError(told, hint="its frames would be twice in the dataset: name the first file of a take, once")


def _joined(path: Path, sequence: int, take: Take, people: list[Aligned], calibration: Calibration) -> _AlignedTake:
    """The people of a take, with the frames in which the pose of all is known."""
    places = [_place(path, take, each.subject) for each in people]
    if len(set(places)) < len(places):
        raise AlignmentError(
            f"{path}: {' and '.join(take.codes)} have one place", hint="give each a `seat` of their own in the rig's take"
        )
    kept = np.all([each.kept for each in people], axis=0)
    if not kept.any():
        raise AlignmentError(
            f"{path}: in no frame is the pose of all of {', '.join(take.codes)} known", hint="align each with --subject"
        )
    reports = []
    for each, place in zip(people, places, strict=True):
        others = int((each.kept & ~kept).sum())
        apart = np.degrees(each.head_residual[kept])
        low, high = each.delay.interval_s
        reports.append(TakeReport(
            recording=path.name, sequence=sequence, subject=each.subject, person=place, frames=len(kept), kept=int(kept.sum()),
            left_out=each.left_out | ({"the pose of somebody else is not known": others} if others else {}),
            suit_delay_ms=1000 * each.delay.offset_s, suit_delay_interval_ms=(1000 * low, 1000 * high),
            correlation=each.delay.correlation, drift_ppm=1e6 * each.delay.drift,
            head_deg=(float(np.sqrt(np.mean(apart**2))), float(apart.max())),
            pose_corrected=each.pose_corrected, depth_corrected_cm=_moved_cm(each, kept),
        ))  # fmt: skip
    drive_side = take.drive_side or _seen_side(people, places, calibration)
    return _AlignedTake(path, take, drive_side, list(zip(people, reports, strict=True)), kept)


def _moved_cm(aligned: Aligned, kept: NDArray[np.bool_]) -> dict[str, float]:
    """By joint, how far depth moved it; empty where it was not asked."""
    if aligned.joint_shift is None:
        return {}
    return {joint: float(100 * moved) for joint, moved in zip(JOINTS, aligned.joint_shift[kept].mean(axis=0), strict=True)}


def _seen_side(people: Sequence[Aligned], places: Sequence[str], calibration: Calibration) -> str:
    """The side of the wheel by where driver or front passenger sit in most frames; "" where neither or no car is known."""
    vehicle_from_camera, sides = _vehicle_from_camera(calibration), 0
    for each, place in zip(people, places, strict=True):
        hips = each.joints[each.kept][:, None, [JOINTS.index("lpelvis"), JOINTS.index("rpelvis")]]
        sides += int(wheel_sides(hips, vehicle_from_camera, [place]).sum(dtype=np.int64))
    return SIDE_NAMES[int(np.sign(sides))]


def _other_side(aligned: _AlignedTake, calibration: Calibration) -> str:
    """What to say of a take whose people sit otherwise than the side of its wheel has it."""
    seen = _seen_side([each for each, _ in aligned.people], [report.person for _, report in aligned.people], calibration)
    if seen in ("", aligned.drive_side):
        return ""
    name, said = aligned.path.name, aligned.drive_side
    return f"{name}: said to have its wheel on the {said}, but as people sit in front it is on the {seen}"


def _vehicle_from_camera(calibration: Calibration) -> NDArray[np.float64]:
    """(4, 4), NaN where the car's place is not known."""
    if calibration.vehicle_from_world is None:
        return np.full((4, 4), np.nan)
    return np.array(calibration.vehicle_from_world) @ invert(calibration.extrinsics.matrix)


def _frames_of(aligned: _AlignedTake, calibration: Calibration, manifest: Manifest) -> Iterator[dict[str, Any]]:
    """The frames of one take that are kept."""
    camera = calibration.intrinsics.camera
    vehicle_from_camera = _vehicle_from_camera(calibration)
    with Recording(aligned.path) as recording:
        for index, (_, image) in enumerate(tof_frames(recording, calibration.names.tof)):
            if not aligned.kept[index]:
                continue
            _check_size(aligned.path, image, calibration)
            depth = image.depth_m()
            frame = blank_frame(manifest)
            frame["depth"] = ticks_of_steps(image.depth, image.depth_unit_m)
            for name in FRAME_IMAGES:
                if name in manifest.variables:
                    frame[name] = getattr(image, name)
            put_camera(frame, camera)
            frame["vehicle_from_camera"] = vehicle_from_camera
            frame["car"], frame["pov"] = aligned.take.car or UNKNOWN, POV
            if "drive_side" in manifest.variables:
                frame["drive_side"] = aligned.drive_side
            for person, report in aligned.people:
                place = manifest.persons.index(report.person)
                joints = person.joints[index]
                states, before = visibility(camera, depth, joints)
                report.joints_measured += int(np.isfinite(before).sum())
                report.joints_floating += int((before < -FLOATING_M).sum())
                report.states.update(states.tolist())
                put_person(frame, place, camera, _ALL, joints, states)
                frame["head_residual"][place] = person.head_residual[index]
                if person.joint_shift is not None:
                    frame["joint_shift"][place] = person.joint_shift[index]
                frame["sync_ns"], frame["sequence"] = person.frame_ns[index], report.sequence
                frame["subject"][place], frame["action"][place] = person.subject, aligned.take.action or UNKNOWN
            yield frame


def _place(path: Path, take: Take, subject: str) -> str:
    """The person coordinate of a subject. Raises AlignmentError for somebody in a car whose seat the take does not name."""
    seat = next((participant.seat for participant in take.subjects if participant.code == subject), None)
    if seat is None and take.car:
        raise AlignmentError(
            f"{path} does not say where {subject} sits in the {take.car}",
            hint="a detector learns seats: give `seat` in the rig's take",
        )
    return seat or STANDING_SLOT


def _images(paths: Sequence[Path], calibration: Calibration) -> tuple[str, ...]:
    """The images that the camera gives, by the first frame of each take. Raises AlignmentError where one lacks some of them."""
    found: dict[tuple[str, ...], Path] = {}
    for path in paths:
        with Recording(path) as recording:
            _, first = next(tof_frames(recording, calibration.names.tof), (None, None))
        if first is None:  # which `align_take` says
            continue
        found.setdefault(("depth", *(name for name in FRAME_IMAGES if getattr(first, name).size)), path)
    if len(found) > 1:
        told = "; ".join(f"{path} has {', '.join(images)}" for images, path in found.items())
        raise AlignmentError(
            f"the camera gives other images in other takes: {told}",
            hint="frames of a dataset have the same: align them apart",
        )
    return next(iter(found), ())


def _check_size(path: Path, image: ToFFrame, calibration: Calibration) -> None:
    lens = calibration.intrinsics
    if image.depth.shape != (lens.height, lens.width):
        height, width = image.depth.shape
        raise AlignmentError(
            f"{path}: the camera has {width}x{height} pixels, the calibration is of {lens.width}x{lens.height}",
            hint="calibrate the camera in the mode that it records in",
        )

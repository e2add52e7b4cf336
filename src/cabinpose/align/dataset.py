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
from cabinpose.align.calibration import Calibration
from cabinpose.align.project import Aligned, align_take
from cabinpose.align.visibility import visibility
from cabinpose.core.errors import AlignmentError
from cabinpose.core.frames import invert
from cabinpose.core.pose import OCCUPANT_SLOTS, STANDING_SLOT
from cabinpose.core.recorded import ToFFrame
from cabinpose.store.recording import Recording, Take, tof_frames
from cabinpose.store.schema import DEPTH_SCALE_M, Manifest
from cabinpose.store.source import UNKNOWN, Source, blank_frame

POV = "tof"
FLOATING_M = 0.02  # a joint farther before the surface is not inside the body that it belongs to


@dataclass
class TakeReport:
    """What became of a take: frames of the camera, those left out by reason, the suit's delay, and how the joints fit the depth.

    head_deg: rms and worst angle between the heads of both systems, in the frames that are kept · floating: share of the
    joints in the image that lie more than 2 cm before the measured surface · states: joints by state.
    """

    recording: str
    subject: str
    frames: int
    kept: int
    left_out: dict[str, int]
    suit_delay_ms: float
    suit_delay_interval_ms: tuple[float, float]
    correlation: float
    drift_ppm: float
    head_deg: tuple[float, float]
    joints_measured: int = 0
    joints_floating: int = 0
    states: Counter[int] = field(default_factory=Counter)

    @property
    def floating(self) -> float:
        """Share of floating joints; NaN where the depth told nothing."""
        return self.joints_floating / self.joints_measured if self.joints_measured else float("nan")


@dataclass(frozen=True)
class AlignedTakes:
    """Takes ready to be written: the source of the dataset's frames, and a report of each take, filled while they are written."""

    source: Source
    reports: list[TakeReport]


def align_takes(
    paths: Sequence[Path],
    calibration: Calibration,
    *,
    subject: str | None = None,
    max_lag_s: float = 2.0,
    licence: str = "private",
) -> AlignedTakes:
    """Align recordings of one rig and make of them the frames of a dataset.

    The frames are those of the camera in which the pose is known, takes one after another (`sequence` counts them), images as
    recorded. Raises AlignmentError where a take cannot be aligned, or where cameras differ in size.
    """
    takes = []
    for path in paths:
        with Recording(path) as recording:
            takes.append((path, recording.take, align_take(recording, calibration, subject=subject, max_lag_s=max_lag_s)))
    reports = [_report(path, aligned) for path, _, aligned in takes]
    places = [_place(path, take, aligned.subject) for path, take, aligned in takes]
    persons = OCCUPANT_SLOTS if set(places) <= set(OCCUPANT_SLOTS) else tuple(dict.fromkeys(places))
    images = _images(paths[0], calibration)
    lens = calibration.intrinsics
    manifest = Manifest(
        generator="cabinpose.align",
        generator_version=__version__,
        seed=0,
        licence=licence,
        frames=sum(report.kept for report in reports),
        width=lens.width,
        height=lens.height,
        persons=persons,
        variables=(*images, "head_residual"),
        config={
            "calibration": calibration.model_dump(mode="json"),
            "takes": [
                {
                    "recording": report.recording,
                    "subject": report.subject,
                    "frames": report.frames,
                    "left_out": report.left_out,
                    "suit_delay_s": report.suit_delay_ms / 1000,
                    "suit_drift_ppm": report.drift_ppm,
                }
                for report in reports
            ],
        },
    )

    def frames() -> Iterator[dict[str, Any]]:
        for number, ((path, take, aligned), place, report) in enumerate(zip(takes, places, reports, strict=True)):
            fixed = {"sequence": number, "car": take.car or UNKNOWN, "action": take.action or UNKNOWN}
            yield from _frames_of(path, aligned, calibration, manifest, fixed, persons.index(place), report)

    return AlignedTakes(Source(paths[0], manifest, frames), reports)


def _frames_of(
    path: Path,
    aligned: Aligned,
    calibration: Calibration,
    manifest: Manifest,
    fixed: dict[str, Any],
    place: int,
    report: TakeReport,
) -> Iterator[dict[str, Any]]:
    """The frames of one take that are kept."""
    camera = calibration.intrinsics.camera
    vehicle_from_camera = np.full((4, 4), np.nan)
    if calibration.vehicle_from_world is not None:
        vehicle_from_camera = np.array(calibration.vehicle_from_world) @ invert(calibration.extrinsics.matrix)
    with Recording(path) as recording:
        for index, (_, image) in enumerate(tof_frames(recording, calibration.names.tof)):
            if not aligned.kept[index]:
                continue
            _check_size(path, image, calibration)
            depth = image.depth * np.float32(image.depth_unit_m)
            depth[image.depth == 0] = np.nan
            joints = aligned.joints[index]
            states, before = visibility(camera, depth, joints)
            report.joints_measured += int(np.isfinite(before).sum())
            report.joints_floating += int((before < -FLOATING_M).sum())
            report.states.update(states.tolist())
            frame = blank_frame(manifest)
            frame["depth"] = _ticks(image)
            for name in ("amplitude", "confidence"):
                if name in manifest.variables:
                    frame[name] = getattr(image, name)
            frame["joints_3d"][place] = joints
            frame["joints_2d"][place] = camera.project(joints)
            frame["visibility"][place] = states
            frame["head_residual"][place] = aligned.head_residual[index]
            frame["camera_k"], frame["camera_dist"] = camera.k, np.array(camera.dist, np.float64)
            frame["vehicle_from_camera"] = vehicle_from_camera
            frame["sync_ns"] = aligned.frame_ns[index]
            frame["sequence"], frame["car"], frame["pov"] = fixed["sequence"], fixed["car"], POV
            frame["subject"][place], frame["action"][place] = aligned.subject, fixed["action"]
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


def _images(path: Path, calibration: Calibration) -> tuple[str, ...]:
    """The images that the camera gives, by its first frame."""
    with Recording(path) as recording:
        _, first = next(tof_frames(recording, calibration.names.tof))
    return ("depth", *(name for name in ("amplitude", "confidence") if getattr(first, name).size))


def _check_size(path: Path, image: ToFFrame, calibration: Calibration) -> None:
    lens = calibration.intrinsics
    if image.depth.shape != (lens.height, lens.width):
        height, width = image.depth.shape
        raise AlignmentError(
            f"{path}: the camera has {width}x{height} pixels, the calibration is of {lens.width}x{lens.height}",
            hint="calibrate the camera in the mode that it records in",
        )


def _ticks(image: ToFFrame) -> NDArray[np.uint16]:
    """The depth in the steps of a dataset, 0 = invalid; what lies beyond them is invalid."""
    if image.depth_unit_m == DEPTH_SCALE_M:
        return image.depth
    ticks = np.rint(image.depth * (image.depth_unit_m / DEPTH_SCALE_M))
    return np.where(ticks <= np.iinfo(np.uint16).max, ticks, 0).astype(np.uint16)


def _report(path: Path, aligned: Aligned) -> TakeReport:
    delay = aligned.delay
    low, high = delay.interval_s
    apart = aligned.head_residual[aligned.kept]
    return TakeReport(
        recording=path.name,
        subject=aligned.subject,
        frames=len(aligned.frame_ns),
        kept=int(aligned.kept.sum()),
        left_out=aligned.left_out,
        suit_delay_ms=1000 * delay.offset_s,
        suit_delay_interval_ms=(1000 * low, 1000 * high),
        correlation=delay.correlation,
        drift_ppm=1e6 * delay.drift,
        head_deg=(float(np.degrees(np.sqrt(np.mean(apart**2)))), float(np.degrees(apart.max()))),
    )

"""`cabinpose evaluate-mocap`: judge a suit's ground truth by the thesis' four evaluations."""

from __future__ import annotations

import sys
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Annotated, Any, Literal

from tyro.conf import Positional

from cabinpose.app.cli.arguments import Maybe, PrintsJson, one_of, refuse, refuse_existing, several
from cabinpose.app.cli.output import print_json, print_table, printable, progress
from cabinpose.app.extras import require
from cabinpose.app.mocap.settings import OpticalSettings, RotationSettings
from cabinpose.core import AlignmentError, ConfigError, RecordingError

if TYPE_CHECKING:
    from cabinpose.app.mocap.figures import Section
    from cabinpose.app.mocap.inputs import PointTracks
    from cabinpose.evaluate.mocap import Bone, Judgement, SfeRun, SseRun
    from cabinpose.signals import F64

_MOTOR_GAP_S = 60.0  # an encoder may speak only when it turns
Outcome = tuple["Judgement", "list[Section]", dict[str, Any]]


@dataclass(frozen=True, kw_only=True)
class MocapReport(PrintsJson):
    """Flags of all four evaluations."""

    out: Maybe[Path] = None
    """Folder for the page (index.html) and its numbers (report.json)."""
    resamples: int = 1000
    """Resamples of the bootstrap for the intervals; 0: no intervals."""
    block_s: Maybe[float] = None
    """Seconds of a block of the bootstrap; default: from the autocorrelation of the errors."""
    seed: int = 0
    """Seed of the bootstrap."""
    overwrite: bool = False
    """Replace the report in the folder."""


@dataclass(frozen=True, kw_only=True)
class EvaluateSse(MocapReport):
    """One sensor, turned in known steps about each of its axes: the error about the axis, mean and deviation."""

    takes: Annotated[Positional[tuple[str, ...]], several("AXIS=FILE")] = ()
    """roll=FILE, pitch=FILE, yaw=FILE: recordings (.mcap) or MVNX files, one axis each."""
    sensor: Maybe[str] = None
    """Name of the sensor (or segment); default: the only one."""
    source: Maybe[str] = None
    """Source of the sensor in a recording."""
    step_deg: float = 11.25
    """Angle of a step of the motor, degrees."""
    steps: int = 33
    """Number of standstills: 33 for a full turn of 32 steps, the start included."""
    samples: int = 300
    """Samples used of each standstill, from its middle; 0: all."""
    still_deg_s: float = 1.5
    """The sensor stands still below this speed, degrees/s."""
    still_s: float = 0.5
    """Least duration of a standstill, s."""
    motor: Maybe[str] = None
    """SOURCE/CHANNEL that recorded the motor's angle in degrees; default: a source of kind stepper, else steps by stillness."""


@dataclass(frozen=True, kw_only=True)
class EvaluateSfe(MocapReport):
    """The whole body: the first N-pose against the last, before and after a drive, joints relative to the pelvis."""

    takes: Annotated[Positional[tuple[str, ...]], several("[DRIVE=]FILE")] = ()
    """Recordings (.mcap), MVNX, BVH or C3D files, one a drive."""
    source: Maybe[str] = None
    """Source of the suit in a recording; default: suit where there is one, else the only one that gives a body."""
    subject: Maybe[str] = None
    """Subject code; default: the only one."""
    first: Maybe[tuple[float, float]] = None
    """Seconds from and to, of the first pose; default: where the person stands still in an N-pose for the first time."""
    last: Maybe[tuple[float, float]] = None
    """Seconds from and to, of the last pose; default: the last time."""
    still_m_s: float = 0.05
    """The person stands still when every segment is below this speed, m/s."""
    any_pose: bool = False
    """Use any pose in which the person stands still, not only the N-pose."""
    fit: Literal["pelvis", "body"] = "pelvis"
    """Align the poses by the pelvis, or by all joints (markers have no pelvis)."""
    pelvis: str = "Pelvis"
    """Name of the pelvis segment."""


@dataclass(frozen=True, kw_only=True)
class EvaluateDse(RotationSettings, MocapReport):
    """Rotations of segments since the first frame, suit against optical system, in up to 17 pairs, by plane of motion."""


@dataclass(frozen=True, kw_only=True)
class EvaluateDfe(OpticalSettings, MocapReport):
    """Joint positions, suit against optical system, in up to 20 pairs: raw, aligned by the pelvis, by pelvis and ICP."""


COMMAND = one_of(sse=EvaluateSse, sfe=EvaluateSfe, dse=EvaluateDse, dfe=EvaluateDfe)


def run(command: EvaluateSse | EvaluateSfe | EvaluateDse | EvaluateDfe) -> None:
    """Evaluate; the table goes to stdout, the page to `out`."""
    require("record")
    from cabinpose.app.cli.evaluate import write_report
    from cabinpose.app.mocap.page import page_html, summary_rows

    if not command.takes:
        raise ConfigError("there is nothing to evaluate", hint="give a recording or a file; --help shows how")
    if command.seed < 0:
        raise ConfigError(f"{command.seed} is no seed", hint="give 0 or more")
    refuse_existing(command.out, "index.html", "report.json", overwrite=command.overwrite)
    with progress() as report:
        report.phase("reading and comparing")
        judgement, drawn, more = _EVALUATIONS[type(command)](command)
    record = judgement.to_dict() | {"takes": list(command.takes)} | more
    if command.out is not None:
        told = ", ".join(Path(word.partition("=")[2] or word).name for word in command.takes)
        write_report(command.out, page_html(judgement, drawn, told), record)
    if command.as_json:
        print_json(record)
        return
    print_table(summary_rows(judgement))
    for note in judgement.notes:
        print(printable(note))
    if command.out is not None:
        print(f"open {command.out / 'index.html'}", file=sys.stderr)


def _sse(command: EvaluateSse) -> Outcome:
    from cabinpose.app.mocap.figures import sse_sections
    from cabinpose.app.mocap.inputs import labelled
    from cabinpose.evaluate.mocap import AXES, sse

    runs: list[SseRun] = []
    for axis, path in labelled(command.takes):
        if axis not in AXES:
            raise ConfigError(f"'{path}' is of no axis", hint=f"write AXIS=FILE, with an axis of {', '.join(AXES)}")
        runs.append(_sse_run(command, axis, path))
    found = _judged(command, sse, runs)
    return found, sse_sections(found, runs, _measures(found)), {}


def _sse_run(command: EvaluateSse, axis: str, path: Path) -> SseRun:
    import numpy as np

    from cabinpose.app.mocap.inputs import read_channels, read_orientations
    from cabinpose.evaluate.mocap import find_steps, sse_run
    from cabinpose.signals import MOTOR_CHANNELS, resample_positions

    time, turned, origin_ns = read_orientations(path, command.sensor, source=command.source)
    source, slash, channel = (command.motor or "").partition("/")
    if command.motor is not None and not slash:
        raise ConfigError(f"'{command.motor}' names no channel", hint="write --motor SOURCE/CHANNEL")
    motor = read_channels(path, (channel,) if slash else MOTOR_CHANNELS, source=source or None)
    samples = command.samples or None
    if slash and motor is None:
        raise RecordingError(f"{path}: {source} gives no channel '{channel}'", hint=f"see cabinpose info {path}")
    angle: F64 | None = None
    if motor is not None:
        at_s, values = (motor[0] - origin_ns) / 1e9, motor[1]
        values = resample_positions(at_s, values, time, max_gap_s=_MOTOR_GAP_S, policy="previous")
        angle = np.radians(values[:, 0])
        if not slash:  # a stepper says itself where it stands
            step = np.nan_to_num(values[:, 1], nan=-1).astype(np.int64)
            return sse_run(time, turned, axis=axis, step=step, reference_rad=angle, samples=samples)
    step = find_steps(time, turned, count=command.steps, limit_rad_s=np.radians(command.still_deg_s), least_s=command.still_s)
    step_rad = np.radians(command.step_deg)
    return sse_run(time, turned, axis=axis, step=step, reference_rad=angle, step_rad=step_rad, samples=samples)


def _sfe(command: EvaluateSfe) -> Outcome:
    from cabinpose.app.mocap.figures import sfe_sections
    from cabinpose.app.mocap.inputs import body_source, labelled, read_motion
    from cabinpose.evaluate.mocap import bone_lengths, mvn_bones, rigid_pairs, sfe

    if (command.first is None) != (command.last is None):
        raise ConfigError("one of the two poses has no time", hint="give --first and --last, or neither")
    if command.first is not None:
        refuse({"--any-pose": command.any_pose}, "{} looks for poses, and --first and --last say when they are")
    if command.fit == "body":
        refuse({"--pelvis": command.pelvis != "Pelvis"}, "{} is not heeded where --fit body lays all points on each other")
    runs: list[SfeRun] = []
    bones: dict[str, tuple[Bone, ...]] = {}
    for label, path in labelled(command.takes):
        motion = read_motion(path, source=command.source or body_source(path), subject=command.subject)
        condition = label or motion.action or path.stem
        if condition in bones:
            raise ConfigError(f"two drives are called '{condition}'", hint="write DRIVE=FILE, each with a name of its own")
        runs.append(_sfe_run(command, motion, condition))
        segments = mvn_bones(motion.names)
        linked = segments if len(segments) >= 3 else rigid_pairs(motion.position_m, motion.names)
        bones[condition] = bone_lengths(motion.position_m, motion.names, linked)
    found = _judged(command, sfe, runs)
    lengths = {name: [asdict(bone) for bone in found_] for name, found_ in bones.items()}
    return found, sfe_sections(found, runs, _measures(found), bones), {"lengths": lengths}


def _sfe_run(command: EvaluateSfe, motion: PointTracks, condition: str) -> SfeRun:
    from cabinpose.evaluate.mocap import Window, find_poses, sfe_run

    if command.first is not None and command.last is not None:
        poses = Window("first", *command.first), Window("last", *command.last)
    else:
        poses = find_poses(motion.time_s, motion.position_m, motion.names, limit_m_s=command.still_m_s, any_pose=command.any_pose)
    if command.fit == "pelvis" and motion.orientation_wxyz is None:
        raise AlignmentError(
            f"{motion.path.name} holds markers, which have no pelvis", hint="--fit body lays whole bodies on each other"
        )
    return sfe_run(
        motion.time_s, motion.position_m, motion.orientation_wxyz, motion.names, poses, condition=condition,
        root=command.pelvis if command.fit == "pelvis" else None,
    )  # fmt: skip


def _dse(command: EvaluateDse) -> Outcome:
    import numpy as np

    from cabinpose.app.mocap.compare import dse_runs
    from cabinpose.app.mocap.figures import dse_sections
    from cabinpose.evaluate.mocap import dse

    runs, judged = _against_optical(command, dse_runs, dse)
    headings = [{"condition": r.condition, "heading_deg": float(np.degrees(r.heading_rad))} for r in runs]
    return judged, dse_sections(judged, runs, _measures(judged)), {"headings": headings}


def _dfe(command: EvaluateDfe) -> Outcome:
    from cabinpose.app.mocap.compare import dfe_runs
    from cabinpose.app.mocap.figures import dfe_sections
    from cabinpose.evaluate.mocap import dfe

    runs, judged = _against_optical(command, dfe_runs, dfe)
    return judged, dfe_sections(judged, runs, _measures(judged)), {}


def _against_optical(
    command: EvaluateDse | EvaluateDfe, read: Callable[..., Any], judge: Callable[..., Judgement]
) -> tuple[list[Any], Judgement]:
    from cabinpose.app.mocap.inputs import labelled

    if command.windows and len(command.takes) > 1:
        raise ConfigError(
            "windows are of one recording", hint="give one recording with --windows, or several with PLANE=RECORDING"
        )
    found = [read(path, label, command) for label, path in labelled(command.takes)]
    runs = [each for some, _ in found for each in some]
    return runs, _judged(command, judge, runs, [note for _, notes in found for note in notes])


def _judged(command: MocapReport, judge: Callable[..., Judgement], runs: Sequence[Any], notes: Sequence[str] = ()) -> Judgement:
    """The judgement of runs, with the command's options as its settings, and with what the reading of the takes had to say."""
    import numpy as np

    rng = np.random.Generator(np.random.Philox(key=command.seed))
    found = judge(runs, rng=rng, resamples=command.resamples, block_s=command.block_s)
    settings = {k: v for k, v in asdict(command).items() if k not in ("out", "overwrite", "as_json")}
    return replace(found, settings=settings, notes=(*dict.fromkeys(notes), *found.notes))


def _measures(found: Judgement) -> list[str]:
    return list(dict.fromkeys(s.measure for s in found.summaries))


_EVALUATIONS: MappingProxyType[type, Callable[[Any], Outcome]] = MappingProxyType(
    {EvaluateSse: _sse, EvaluateSfe: _sfe, EvaluateDse: _dse, EvaluateDfe: _dfe}
)

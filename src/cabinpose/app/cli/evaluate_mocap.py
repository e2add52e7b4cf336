"""`cabinpose evaluate-mocap`: the thesis' evaluations of a suit, as a table, a page and JSON."""

from __future__ import annotations

import json
import sys
from collections.abc import Callable, Sequence
from dataclasses import asdict, replace
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

import numpy as np

from cabinpose.app.cli.mocap_commands import (
    AgainstOptical,
    EvaluateDfe,
    EvaluateDse,
    EvaluateMocap,
    EvaluateSfe,
    EvaluateSse,
    MocapReport,
)
from cabinpose.app.cli.output import print_json, print_table, printable, progress
from cabinpose.app.extras import require
from cabinpose.app.finite import finite
from cabinpose.core.errors import AlignmentError, ConfigError, DatasetError, RecordingError
from cabinpose.core.recorded import MOTOR_CHANNELS
from cabinpose.core.resample import resample_positions
from cabinpose.evaluate.mocap.bones import Bone, bone_lengths, mvn_bones, rigid_pairs
from cabinpose.evaluate.mocap.result import Judgement
from cabinpose.evaluate.mocap.sfe import SfeRun, find_poses, sfe, sfe_run
from cabinpose.evaluate.mocap.sse import AXES, SseRun, find_steps, sse, sse_run
from cabinpose.evaluate.mocap.stillness import Window
from cabinpose.store.part import disk_errors

if TYPE_CHECKING:  # they need the extra `record`, which is asked for first
    from cabinpose.app.mocap.figures import Section
    from cabinpose.app.mocap.inputs import PointTracks

_MOTOR_GAP_S = 60.0  # an encoder may speak only when it turns
Outcome = tuple[Judgement, "list[Section]", dict[str, Any]]


def run(command: EvaluateMocap) -> None:
    """Evaluate; the table goes to stdout, the page to `out`."""
    chosen = command.evaluation
    require("mcap", "mcap_protobuf", "foxglove_schemas_protobuf", extra="record")
    if not chosen.takes:
        raise ConfigError("there is nothing to evaluate", hint="give a recording or a file; --help shows how")
    _check_out(chosen)
    with progress() as report:
        report.phase("reading and comparing")
        judgement, drawn, more = _EVALUATIONS[type(chosen)](chosen)
    record = judgement.to_dict() | {"takes": list(chosen.takes)} | more
    if chosen.out is not None:
        from cabinpose.app.mocap.page import page_html

        told = ", ".join(Path(word.partition("=")[2] or word).name for word in chosen.takes)
        _write(chosen.out, page_html(judgement, drawn, told), record)
    if chosen.as_json:
        print_json(record)
        return
    from cabinpose.app.mocap.page import summary_rows

    print_table(summary_rows(judgement))
    for note in judgement.notes:
        print(printable(note))
    if chosen.out is not None:
        print(f"open {chosen.out / 'index.html'}", file=sys.stderr)


def _sse(command: EvaluateSse) -> Outcome:
    from cabinpose.app.mocap.figures import sse_sections
    from cabinpose.app.mocap.inputs import labelled

    runs: list[SseRun] = []
    for axis, path in labelled(command.takes):
        if axis not in AXES:
            raise ConfigError(f"'{path}' is of no axis", hint=f"write AXIS=FILE, with an axis of {', '.join(AXES)}")
        runs.append(_sse_run(command, axis, path))
    found = _judged(command, sse, runs)
    return found, sse_sections(found, runs, _measures(found)), {}


def _sse_run(command: EvaluateSse, axis: str, path: Path) -> SseRun:
    from cabinpose.app.mocap.inputs import read_channels, read_orientations

    time, turned, origin_ns = read_orientations(path, command.sensor, source=command.source)
    source, slash, channel = (command.motor or "").partition("/")
    if command.motor is not None and not slash:
        raise ConfigError(f"'{command.motor}' names no channel", hint="write --motor SOURCE/CHANNEL")
    motor = read_channels(path, (channel,) if slash else MOTOR_CHANNELS, source=source or None)
    samples = command.samples or None
    if motor is not None:
        at_s, values = (motor[0] - origin_ns) / 1e9, motor[1]
        values = resample_positions(at_s, values, time, max_gap_s=_MOTOR_GAP_S, policy="previous")
        marks = None if slash else np.nan_to_num(values[:, 1], nan=-1).astype(np.int64)
        return sse_run(time, turned, axis=axis, step=marks, reference_rad=np.radians(values[:, 0]), samples=samples)
    if slash:
        raise RecordingError(f"{path}: {source} gives no channel '{channel}'", hint=f"see cabinpose info {path}")
    step = find_steps(time, turned, count=command.steps, limit_rad_s=np.radians(command.still_deg_s), least_s=command.still_s)
    return sse_run(time, turned, axis=axis, step=step, step_rad=np.radians(command.step_deg), samples=samples)


def _sfe(command: EvaluateSfe) -> Outcome:
    from cabinpose.app.mocap.figures import sfe_sections
    from cabinpose.app.mocap.inputs import body_source, labelled, read_motion

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
    if (command.first is None) != (command.last is None):
        raise ConfigError("one of the two poses has no time", hint="give --first and --last, or neither")
    if command.first is not None and command.last is not None:
        first, last = Window("first", *command.first), Window("last", *command.last)
    else:
        first, last = find_poses(
            motion.time_s, motion.position_m, motion.names, limit_m_s=command.still_m_s, any_pose=command.any_pose
        )
    if command.fit == "pelvis" and motion.orientation_wxyz is None:
        raise AlignmentError(
            f"{motion.path.name} holds markers, which have no pelvis", hint="--fit body lays whole bodies on each other"
        )
    return sfe_run(
        motion.time_s, motion.position_m, motion.orientation_wxyz, motion.names, first=first, last=last, condition=condition,
        fit=command.fit, pelvis=command.pelvis,
    )  # fmt: skip


def _dse(command: EvaluateDse) -> Outcome:
    from cabinpose.app.mocap.compare import dse_runs
    from cabinpose.app.mocap.figures import dse_sections
    from cabinpose.evaluate.mocap.dse import dse

    runs, judged = _against_optical(command, dse_runs, dse)
    headings = [{"condition": r.condition, "heading_deg": float(np.degrees(r.heading_rad))} for r in runs]
    return judged, dse_sections(judged, runs, _measures(judged)), {"headings": headings}


def _dfe(command: EvaluateDfe) -> Outcome:
    from cabinpose.app.mocap.compare import dfe_runs
    from cabinpose.app.mocap.figures import dfe_sections
    from cabinpose.evaluate.mocap.dfe import dfe

    runs, judged = _against_optical(command, dfe_runs, dfe)
    return judged, dfe_sections(judged, runs, _measures(judged)), {}


def _against_optical(
    command: AgainstOptical, read: Callable[..., Any], judge: Callable[..., Judgement]
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
    rng = np.random.Generator(np.random.Philox(key=command.seed))
    found = judge(runs, rng=rng, resamples=command.resamples, block_s=command.block_s)
    settings = {k: v for k, v in asdict(command).items() if k not in ("out", "overwrite", "as_json")}
    return replace(found, settings=settings, notes=(*dict.fromkeys(notes), *found.notes))


def _measures(found: Judgement) -> list[str]:
    return list(dict.fromkeys(s.measure for s in found.summaries))


def _check_out(command: MocapReport) -> None:
    if command.out is None or command.overwrite:
        return
    if there := [name for name in ("index.html", "report.json") if (command.out / name).exists()]:
        raise DatasetError(f"{command.out} already has {' and '.join(there)}", hint="--overwrite replaces them")


def _write(folder: Path, page: str, record: dict[str, Any]) -> None:
    with disk_errors(folder):
        folder.mkdir(parents=True, exist_ok=True)
        (folder / "index.html").write_text(page, encoding="utf-8")
        (folder / "report.json").write_text(json.dumps(finite(record), allow_nan=False, indent=1) + "\n", encoding="utf-8")


_EVALUATIONS: MappingProxyType[type, Callable[[Any], Outcome]] = MappingProxyType(
    {EvaluateSse: _sse, EvaluateSfe: _sfe, EvaluateDse: _dse, EvaluateDfe: _dfe}
)

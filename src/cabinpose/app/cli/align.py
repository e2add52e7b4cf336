"""`cabinpose align`: make a dataset of recordings of suit, optical system and camera."""

from __future__ import annotations

import dataclasses
import math
import sys
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from tyro.conf import Positional

from cabinpose.app.cli.arguments import Maybe, PrintsJson, refuse_inputs, several
from cabinpose.app.cli.output import print_json, print_rows, printable, progress
from cabinpose.app.extras import require
from cabinpose.core import ConfigError, DriveSide

if TYPE_CHECKING:
    from cabinpose.align import TakeReport


@dataclass(frozen=True, kw_only=True)
class Align(PrintsJson):
    """Make a dataset of recordings of suit, optical system and camera: the suit's pose in every frame of the camera.

    Frames in which the pose is not known are left out, counted by reason; nothing is interpolated across gaps.
    """

    recordings: Annotated[Positional[tuple[Path, ...]], several("RECORDING [RECORDING ...]")]
    """Recordings of the rig; everybody whom a take names wears a suit of their own."""
    calibration: Path
    """Calibration of the rig (YAML), made by `cabinpose calibrate`."""
    out: Path
    """Folder of the dataset."""
    report: Maybe[Path] = None
    """HTML file to write: how well suit and optical system agree on the head over each take, with its best and worst frame."""
    subject: Maybe[str] = None
    """Subject code, if a take does not name it, or if only one of its people wears a suit."""
    drive_side: Maybe[DriveSide] = None
    """Side of the wheel in the takes; default: as they say, else by where driver or front passenger sit."""
    pose_correction: bool = True
    """Correct the errors of the suit's own calibration, where the rig's calibration knows them."""
    correct_depth: bool = False
    """Correct the errors of the suits' chains by what the depth images show of the people; joints that nothing tells of stay."""
    max_lag: float = 2.0
    """Largest delay between suit and optical system to search, s."""
    licence: str = "private"
    """Licence of the dataset; recordings of people are personal data."""
    overwrite: bool = False
    """Replace the dataset in the folder."""


COMMAND = Align


def run(command: Align) -> None:
    """Align and write, with a progress bar; say what was left out of each take, and how well the joints fit the depth."""
    require("record")
    from cabinpose.align import Calibration, SuitCorrections, align_takes, judge_joints
    from cabinpose.store import check_new_dataset, import_source

    if not command.recordings:
        raise ConfigError("there is nothing to align", hint="name one or more recordings")
    check_new_dataset(command.out, overwrite=command.overwrite)
    refuse_inputs("--report", command.report, command.calibration, *command.recordings)
    if command.report is not None and command.report.exists() and not command.overwrite:
        raise ConfigError(f"{command.report} exists", hint="--overwrite replaces it, or give another file with --report")
    calibration = Calibration.load(command.calibration)
    takes = align_takes(
        command.recordings, calibration, subject=command.subject, drive_side=command.drive_side, max_lag_s=command.max_lag,
        corrections=SuitCorrections(pose=command.pose_correction, depth=command.correct_depth), licence=command.licence,
    )  # fmt: skip
    for warning in takes.warnings:
        print(printable(warning), file=sys.stderr)
    with progress(takes.source.manifest.frames, "frames") as report:
        folder = import_source(takes.source, command.out, overwrite=command.overwrite, report=report)
    if command.report is not None:
        from cabinpose.app.report.heads import write_head_page

        write_head_page(
            folder, [(take.sequence, take.recording, take.subject, take.person) for take in takes.reports], command.report
        )
    doubts = [f"{take.recording}: {doubt}" for take in takes.reports if (doubt := judge_joints(take.floating))]
    for doubt in doubts:
        print(doubt, file=sys.stderr)
    if command.as_json:
        told = {"warnings": [*takes.warnings, *doubts]} if takes.warnings or doubts else {}
        print_json(
            {**told, "out": str(folder), "frames": takes.source.manifest.frames, "takes": [_plain(r) for r in takes.reports]}
        )
        return

    def rows_of(take: TakeReport) -> list[tuple[str, str]]:
        low, high = take.suit_delay_interval_ms
        states = [f"{count} {_words(state)}" for state, count in sorted(take.states.items())]
        told = "as in the head take" if math.isnan(take.correlation) else f"r = {take.correlation:.3f}"
        span = f"{take.suit_delay_ms:+.2f} ms ({low:+.2f} to {high:+.2f})"
        floating = "nothing measured" if math.isnan(take.floating) else f"{100 * take.floating:.1f} % of the joints"
        return [
            (take.recording, f"{take.kept} of {take.frames} frames, {take.subject}"),
            *((f"  {why}", f"{count} frames left out") for why, count in take.left_out.items()),
            ("  suit", f"{span}, {take.drift_ppm:+.1f} ppm, {told}"),
            ("  head", f"{take.head_deg[0]:.2f} deg rms between suit and optical system, at most {take.head_deg[1]:.2f}"),
            *((("  initial pose", "corrected"),) if take.pose_corrected else ()),
            *((("  by depth", _moved(take.depth_corrected_cm)),) if take.depth_corrected_cm else ()),
            ("  joints", ", ".join(states)),
            ("  before the surface", floating),
        ]

    print_rows([row for take in takes.reports for row in rows_of(take)])
    print(f"look at it with: cabinpose view {folder} --out {folder}-view", file=sys.stderr)


def _plain(take: Any) -> dict[str, Any]:
    """A report as plain data, with the share of floating joints."""
    values = dataclasses.asdict(take)
    states = {_words(state): count for state, count in sorted(take.states.items())}
    return values | {"states": states, "floating": take.floating}


def _moved(by_joint_cm: Mapping[str, float]) -> str:
    farthest = max(by_joint_cm, key=by_joint_cm.__getitem__)
    mean = sum(by_joint_cm.values()) / len(by_joint_cm)
    return f"joints moved by {mean:.1f} cm on average, {farthest} by {by_joint_cm[farthest]:.1f}"


def _words(state: int) -> str:
    from cabinpose.core import Visibility

    return Visibility(state).name.lower().replace("_", " ")

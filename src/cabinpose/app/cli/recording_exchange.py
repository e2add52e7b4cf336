"""`cabinpose import` and `export` of recordings. A format of datasets for a recording, or the reverse, is an error."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING

from pydantic import ValidationError

from cabinpose.app.cli.arguments import is_recording, refuse, refuse_selection
from cabinpose.app.cli.output import print_json, print_rows, printable
from cabinpose.app.extras import require
from cabinpose.core import ConfigError
from cabinpose.store.convert import FORMATS, IMPORTS, RECORDING_EXPORTS, RECORDING_IMPORTS, epoch_ns

if TYPE_CHECKING:  # needs the extra `record`, which is asked for first
    from cabinpose.app.cli.export import Export
    from cabinpose.app.cli.import_ import Import
    from cabinpose.store.recording import Take


def import_recording(command: Import) -> bool:
    """Import a recording and say what it holds; False where the format is one of datasets, or of nothing known."""
    of_recording = {
        "--subject": command.subject, "--action": command.action, "--car": command.car, "--take": command.take,
        "--name": command.name, "--begun": command.begun, "--unit-m": command.unit_m, "--up": command.up,
        "--keep-whole-frames": command.keep_whole_frames, "--topic": command.topic,
    }  # fmt: skip
    if command.format not in RECORDING_IMPORTS:
        if command.format not in IMPORTS:
            return False
        refuse(of_recording, f"{command.format} gives a dataset; {{}} is of recordings")
        if command.out.suffix == ".mcap":
            raise ConfigError(
                f"{command.format} gives a dataset, a folder; {command.out.name} is the name of a recording",
                hint=f"recordings are made of {', '.join(RECORDING_IMPORTS)}",
            )
        return False
    name = command.format
    if command.out.suffix != ".mcap":
        raise ConfigError(
            f"{name} gives a recording, one file; {command.out} is no name for it",
            hint=f"--out FILE.mcap; datasets are made of {', '.join(IMPORTS)}",
        )
    of_dataset = {
        "--images": command.images, "--keep-invalid": command.keep_invalid, "--correct": command.correct,
        "--intrinsics": command.intrinsics,
        "--licence": command.licence, "--corrects": command.corrects, "--role": command.role,
        "--sequences": command.sequences, "--every": command.every,
    }  # fmt: skip
    refuse(of_dataset, f"{name} gives a recording; {{}} is of datasets")
    require("record")
    from cabinpose.store.convert import RecordingOptions, import_recording

    take = _take(command)
    options = RecordingOptions(
        take.codes, command.name, _nanoseconds(command.begun), command.unit_m, command.up, command.keep_whole_frames,
        command.topic,
    )  # fmt: skip
    made = import_recording(command.source, name, command.out, take=take, options=options, overwrite=command.overwrite)
    if made.refused:
        print(f"{made.refused} messages could not be kept, the last: {printable(made.reason)}", file=sys.stderr)
    if command.as_json:
        print_json({"out": str(made.path), "format": name, "samples": dict(made.samples), "refused": made.refused})
    else:
        print_rows((source, f"{count} samples") for source, count in made.samples.items())
        print(f"see what it holds with: cabinpose info {made.path}", file=sys.stderr)
    return True


def export_recording(command: Export, path: Path, name: str) -> bool:
    """Export a recording and name what was written; False where `path` is none."""
    of_recording = {
        "--source": command.source, "--subject": command.subject, "--span": command.span, "--rate": command.rate,
        "--angles": command.angles,
    }  # fmt: skip
    if not is_recording(path):
        if name in RECORDING_EXPORTS:
            raise ConfigError(
                f"{name} is a format of recordings, and {path} is no recording", hint=f"datasets go to {', '.join(FORMATS)}"
            )
        refuse(of_recording, f"{{}} is of recordings, and {path} is none")
        return False
    if name in FORMATS:
        raise ConfigError(
            f"{name} is a format of datasets, and {path} is no dataset", hint=f"recordings go to {', '.join(RECORDING_EXPORTS)}"
        )
    refuse_selection(command, "{} is of datasets, and this is a recording")
    refuse({"--images": command.images}, "{} is of datasets, and this is a recording")
    if command.rate is not None and not command.rate > 0:
        raise ConfigError(f"{command.rate:g} frames a second are none", hint="give --rate more than 0")
    if command.out.resolve() == path.resolve():
        raise ConfigError(f"{path} is the recording itself", hint="give another file with --out")
    require("record")
    from cabinpose.store.convert import Selection, export_recording

    selection = Selection(command.source, command.subject, command.span, command.rate, command.angles)
    paths = export_recording(path, name, command.out, selection=selection, overwrite=command.overwrite)
    if command.as_json:
        print_json({"out": str(command.out), "format": name, "files": [str(each) for each in paths]})
    else:
        for each in paths:
            print(f"{each}: {each.stat().st_size / 1e6:.1f} MB")
    return True


def _take(command: Import) -> Take:
    from cabinpose.record import load_take
    from cabinpose.store.recording import Take

    if command.take is not None:
        given = {"--subject": command.subject, "--action": command.action, "--car": command.car}
        refuse(given, f"{{}} is told by {command.take.name} already")
        return load_take(command.take)
    subjects = [{"code": code} for code in command.subject]
    try:
        return Take.model_validate({"action": command.action or "", "car": command.car or "", "subjects": subjects})
    except ValidationError as error:
        first = error.errors()[0]
        message = first["msg"].removeprefix("Value error, ")
        raise ConfigError(
            f"--{str(first['loc'][0]).removesuffix('s')}: {message}", hint="docs/recording.md says what a take is"
        ) from error


def _nanoseconds(moment: str | None) -> int:
    """Since the Unix epoch; 0 where no moment is given."""
    try:
        return 0 if moment is None else epoch_ns(moment)
    except ValueError as error:
        raise ConfigError(f"--begun {moment}: {error}", hint="as in 2026-11-21T14:30:00+01:00") from error

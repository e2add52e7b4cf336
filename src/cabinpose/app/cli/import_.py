"""`cabinpose import`: make a dataset from one in another format, or a recording from another tool's file."""

from __future__ import annotations

import sys
import warnings
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, ClassVar

from tyro.conf import Positional, Suppress, arg

from cabinpose.app.cli.arguments import Maybe, PrintsJson, refuse, several
from cabinpose.app.cli.formats import choices, modern, names_of
from cabinpose.app.cli.output import print_json, print_rows, print_table, printable, progress
from cabinpose.app.extras import require
from cabinpose.core import ConfigError, explained

if TYPE_CHECKING:
    from cabinpose.store.recording import Take  # needs the extra `record`, which is asked for first


@dataclass(frozen=True, kw_only=True)
class _Import(PrintsJson):
    """Flags of every format."""

    form: ClassVar[Any]
    format: ClassVar[str]
    source: Annotated[Positional[Path], arg(metavar="SOURCE")]
    """File or folder to read."""
    settings: Annotated[Any, Suppress] = None


@dataclass(frozen=True, kw_only=True)
class ImportDataset(_Import):
    """Flags of formats of datasets."""

    out: Path
    """Folder of the dataset; it appears when the import is complete."""
    overwrite: bool = False
    """Replace an existing dataset."""


@dataclass(frozen=True, kw_only=True)
class ImportRecording(_Import):
    """Flags of formats of recordings."""

    out: Path
    """Recording (.mcap); it appears when the import is complete."""
    subject: Annotated[tuple[str, ...], several("CODE [CODE ...]")] = ()
    """Codes of the subjects, in the order of the file."""
    action: Maybe[str] = None
    """The action, a short word."""
    car: Maybe[str] = None
    """The car or mock-up."""
    take: Maybe[Path] = None
    """YAML file of the take, in place of --subject, --action and --car."""
    overwrite: bool = False
    """Replace an existing recording."""


@dataclass(frozen=True, kw_only=True)
class ImportLabels(_Import):
    """Flags of formats of corrected labels."""

    corrects: Annotated[Path, arg(metavar="DATASET")]
    """The dataset whose export was corrected; joints that differ are added to its labels."""
    out: Path
    """The labels (.labels.jsonl), new or those of the dataset."""
    role: str = "annotator"
    """Who corrected, as the labels shall say."""


COMMAND = choices("read", {"datasets": ImportDataset, "recordings": ImportRecording, "labels of a dataset": ImportLabels})
modernised = partial(modern, "import")


def run(command: ImportDataset | ImportRecording | ImportLabels) -> None:
    """Import, and print what was written."""
    if isinstance(command, ImportDataset):
        _import_dataset(command)
    elif isinstance(command, ImportRecording):
        _import_recording(command)
    else:
        _correct(command)


def _import_dataset(command: ImportDataset) -> None:
    from cabinpose.store import check_new_dataset, import_source, open_dataset, warn_of_labels
    from cabinpose.store.convert import open_source

    if command.out.suffix == ".mcap":
        raise ConfigError(
            f"{command.format} gives a dataset, a folder; {command.out.name} is the name of a recording",
            hint=f"recordings are made of {', '.join(names_of('read', 'recordings'))}",
        )
    check_new_dataset(command.out, overwrite=command.overwrite)
    source = open_source(command.source, command.format, **vars(command.settings))
    if source.note:
        print(printable(source.note), file=sys.stderr)
    frames = source.manifest.frames
    with progress(frames, "frames") as report:
        folder = import_source(source, command.out, overwrite=command.overwrite, report=report)
    if told := source.outcome():
        print(told, file=sys.stderr)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # what opening doubts was said while it was imported
        made = open_dataset(folder, missing="ignore")
    warn_of_labels(made, str(folder))
    if command.as_json:
        variables = list(source.manifest.variables)
        print_json({"out": str(folder), "format": command.format, "frames": frames, "variables": variables})
    else:
        print(f"{folder}: {frames} frames of {command.format}")
        print(f"see what it holds with: cabinpose info {folder}", file=sys.stderr)


def _import_recording(command: ImportRecording) -> None:
    if command.out.suffix != ".mcap":
        raise ConfigError(
            f"{command.format} gives a recording, one file; {command.out} is no name for it",
            hint=f"--out FILE.mcap; datasets are made of {', '.join(names_of('read', 'datasets'))}",
        )
    require("record")
    from cabinpose.store.convert import import_recording

    options = vars(command.settings)
    made = import_recording(
        command.source, command.format, command.out, take=_take(command), overwrite=command.overwrite, **options
    )
    if made.refused:
        print(f"{made.refused} messages could not be kept, the last: {printable(made.reason)}", file=sys.stderr)
    from cabinpose.app.report.recordings import BODY_WORDS, bodies_as_data, body_rows

    if command.as_json:
        found = {"samples": dict(made.samples), "refused": made.refused, "bodies": bodies_as_data(made.bodies)}
        print_json({"out": str(made.path), "format": command.format, **found})
    else:
        print_rows((source, f"{count} samples") for source, count in made.samples.items())
        if made.bodies:
            print()
            print_table(body_rows(made.bodies), words=BODY_WORDS)
        print(f"see what it holds with: cabinpose info {made.path}", file=sys.stderr)


def _take(command: ImportRecording) -> Take:
    from pydantic import ValidationError

    from cabinpose.record import load_take
    from cabinpose.store.recording import Take

    if command.take is not None:
        given = {"--subject": command.subject, "--action": command.action, "--car": command.car}
        refuse(given, f"{{}} is told by {command.take.name} already")
        return load_take(command.take)
    subjects = [{"code": code} for code in command.subject]
    said = {"action": command.action or "", "car": command.car or "", "subjects": subjects}
    try:
        return Take.model_validate(said)
    except ValidationError as error:
        told = explained(error, Take, said, lists="", written=lambda place: f"--{str(place[0]).removesuffix('s')}")
        raise ConfigError(str(told), hint="docs/recording.md says what a take is") from error


def _correct(command: ImportLabels) -> None:
    """Add what a corrected export says otherwise to the labels of its dataset, and say how much that is."""
    from cabinpose.app.label.corrections import corrections
    from cabinpose.app.label.labelling import Labelling, open_labels
    from cabinpose.app.view.draw import completed
    from cabinpose.store import open_dataset

    new = not command.out.exists()
    dataset = completed(open_dataset(command.corrects))  # of a recording or a scene there are no labels
    labels = open_labels(command.out, dataset)
    try:
        labelling = Labelling(dataset, labels, command.role)
        found = corrections(labelling, command.source, command.form.read(command.source, command.settings))
        labelling.take_in(found.changes)
    except BaseException:
        if new:
            command.out.unlink(missing_ok=True)
        raise
    finally:
        labels.close()
    for note in found.notes():
        print(note, file=sys.stderr)
    count = len(found.changes)
    if command.as_json:
        print_json({"out": str(command.out), "format": command.format, "joints": count, "frames": found.frames})
    else:
        print(f"{command.out}: {count} joints corrected in {found.frames} frames")

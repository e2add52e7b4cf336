"""`cabinpose import`: make a dataset from one in another format, or a recording from another tool's file."""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

from tyro.conf import Positional, arg

from cabinpose.app.cli.arguments import Maybe, PrintsJson, several
from cabinpose.app.cli.output import print_json, printable, progress
from cabinpose.core import unknown_name


@dataclass(frozen=True, kw_only=True)
class Import(PrintsJson):
    """Make a dataset from one in another format, or a recording from another tool's file.

    Datasets: png-json (an export of ours), coco, itop, ntu, ticam. Recordings: mvnx, c3d, bvh, adtfdat, xdf, azure-mkv,
    rosbag2.
    """

    source: Annotated[Positional[Path], arg(metavar="SOURCE")]
    """Folder or file to read."""
    format: str
    """Format of the source; see above and docs."""
    out: Path
    """Folder of the dataset, or recording (.mcap); it appears when the import is complete. Of --corrects: the labels."""
    images: Maybe[Path] = None
    """coco: folder of the images; default: `images` beside `annotations`, else joints only. ntu: of the clips' depth maps."""
    corrects: Annotated[Maybe[Path], arg(metavar="DATASET")] = None
    """coco: the dataset whose export was corrected; joints that differ are added to its labels (--out FILE.labels.jsonl)."""
    role: Maybe[str] = None
    """coco: who corrected, as the labels shall say; default: annotator."""
    keep_invalid: bool = False
    """itop: keep the frames whose labels are marked as not valid, without their joints."""
    sequences: Annotated[tuple[str, ...], several("PATTERN [PATTERN ...]")] = ()
    """ticam, ntu: only the sequences of these names, in which * stands for anything."""
    every: Maybe[int] = None
    """ticam, ntu: only every Nth frame of a sequence."""
    correct: Maybe[Literal["head", "torso"]] = None
    """itop: move joints that lie beside the person onto it; the person grows over the depth from this joint."""
    intrinsics: Maybe[tuple[float, float, float, float]] = None
    """Datasets: fx fy cx cy of the camera in px, in place of those of the source."""
    licence: Maybe[str] = None
    """Datasets: licence of the data; default: that of the source."""
    subject: Annotated[tuple[str, ...], several("CODE [CODE ...]")] = ()
    """Recordings: codes of the subjects, in the order of the file."""
    action: Maybe[str] = None
    """Recordings: the action, a short word."""
    car: Maybe[str] = None
    """Recordings: the car or mock-up."""
    take: Maybe[Path] = None
    """Recordings: YAML file of the take, in place of --subject, --action and --car."""
    name: Maybe[str] = None
    """Recordings: name of the source (mvnx, c3d, bvh, azure-mkv, rosbag2); default: suit, optical, motion or tof."""
    begun: Maybe[str] = None
    """c3d, bvh: when it was recorded (2026-11-21T14:30:00+01:00); default: 1970, since the files do not tell."""
    unit_m: Maybe[float] = None
    """bvh: metres of the unit of length; default: that of the CMU database."""
    up: Maybe[Literal["x", "-x", "y", "-y", "z", "-z"]] = None
    """c3d, bvh (y or z): the axis that points up; default: found from markers or file; bvh: y."""
    keep_whole_frames: bool = False
    """c3d: of a truncated file, import the complete frames, and report how many are lost."""
    topic: Annotated[tuple[str, ...], several("TOPIC [TOPIC]")] = ()
    """rosbag2: topic of the depth images, and of infrared; default: the only ones there are."""
    overwrite: bool = False
    """Replace existing files."""


COMMAND = Import


def run(command: Import) -> None:
    """Import with a progress bar and print what was written."""
    from cabinpose.app.cli.arguments import refuse
    from cabinpose.app.cli.recording_exchange import import_recording
    from cabinpose.store import check_new_dataset, import_source
    from cabinpose.store.convert import IMPORTS, RECORDING_IMPORTS, ImportOptions, open_source

    if import_recording(command):
        return
    if command.format not in IMPORTS:
        raise unknown_name("format", command.format, (*IMPORTS, *RECORDING_IMPORTS))
    belongs: dict[tuple[str, ...], dict[str, object]] = {
        ("coco",): {"--corrects": command.corrects, "--role": command.role},
        ("itop",): {"--keep-invalid": command.keep_invalid, "--correct": command.correct},
        ("coco", "ntu"): {"--images": command.images},
        ("ticam", "ntu"): {"--sequences": command.sequences, "--every": command.every},
    }  # fmt: skip
    for names, flags in belongs.items():
        if command.format not in names:
            refuse(flags, f"{{}} is of the format {' or '.join(names)}, not {command.format}")
    if command.corrects is not None:
        _correct(command, command.corrects)
        return
    refuse({"--role": command.role}, "{} is of --corrects")
    check_new_dataset(command.out, overwrite=command.overwrite)
    options = ImportOptions(
        command.keep_invalid, command.intrinsics, command.images, command.licence, command.sequences,
        1 if command.every is None else command.every, command.correct,
    )  # fmt: skip
    source = open_source(command.source, command.format, options)
    if source.note:
        print(printable(source.note), file=sys.stderr)
    frames = source.manifest.frames
    with progress(frames, "frames") as report:
        folder = import_source(source, command.out, overwrite=command.overwrite, report=report)
    if told := source.outcome():
        print(told, file=sys.stderr)
    if command.as_json:
        variables = list(source.manifest.variables)
        print_json({"out": str(folder), "format": command.format, "frames": frames, "variables": variables})
    else:
        print(f"{folder}: {frames} frames of {command.format}")
        print(f"see what it holds with: cabinpose info {folder}", file=sys.stderr)


def _correct(command: Import, folder: Path) -> None:
    """Add what a corrected export says otherwise to the labels of its dataset, and say how much that is."""
    from cabinpose.app.cli.arguments import refuse
    from cabinpose.app.label.corrections import corrections
    from cabinpose.app.label.labelling import Labelling, open_labels
    from cabinpose.app.view.draw import completed
    from cabinpose.store import open_dataset, read_manifest

    not_here = {
        "--images": command.images, "--intrinsics": command.intrinsics, "--licence": command.licence,
        "--overwrite": command.overwrite,
    }  # fmt: skip
    refuse(not_here, "--corrects adds to the labels of a dataset, without {}")
    manifest = read_manifest(folder)  # of a recording or a scene there are no labels
    new = not command.out.exists()
    dataset = completed(open_dataset(folder))
    labels = open_labels(command.out, dataset, manifest)
    try:
        labelling = Labelling(dataset, labels, command.role or "annotator")
        found = corrections(labelling, command.source)
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
        print_json({"out": str(command.out), "format": "coco", "joints": count, "frames": found.frames})
    else:
        print(f"{command.out}: {count} joints corrected in {found.frames} frames")

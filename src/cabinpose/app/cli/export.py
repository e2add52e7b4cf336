"""`cabinpose export`: write a dataset or a recording in another format, or a model as ONNX."""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

from tyro.conf import Positional

from cabinpose.app.cli.arguments import Maybe, SelectsFrames, several
from cabinpose.app.cli.output import listed, print_json, progress
from cabinpose.app.extras import require
from cabinpose.core import ConfigError

if TYPE_CHECKING:
    import xarray as xr

    from cabinpose.store import Splits


@dataclass(frozen=True, kw_only=True)
class Export(SelectsFrames):
    """Write a dataset or a recording in another format, or a trained model as ONNX.

    Datasets: png-json, coco, yolo, itop, ntu, ply. Recordings: c3d, bvh, trc, sto, csv.
    """

    out: Path
    """Folder to write (a file for --onnx and for recordings other than csv); it appears when the export is complete."""
    dataset: Annotated[Positional[Path | None], several("DATASET|RECORDING")] = None
    """Folder of the dataset, or a recording (.mcap)."""
    format: Maybe[str] = None
    """Format to write; see above and docs."""
    onnx: Maybe[Path] = None
    """Checkpoint of `cabinpose train` to write as an ONNX model, in place of a dataset."""
    name: Maybe[str] = None
    """Name of the ONNX model in reports; default: the file's."""
    card: Maybe[Path] = None
    """YAML file of what is known of the model (data, seeds, metrics, limits), stored in the ONNX file."""
    mirrored: bool = False
    """The ONNX model answers with the mean over a frame and its mirror image: smaller errors, at twice the time."""
    half: bool = False
    """The ONNX file holds its weights in half precision: half the bytes, the same speed."""
    images: Maybe[Literal["depth8", "amplitude8", "rgb", "depth16"]] = None
    """coco, yolo: what the pictures show, in 8 bits of grey, in colour or (coco) 16 bits of millimetres; default: depth8."""
    splits: Annotated[Path | None, several("FILE")] = None
    """YAML file of splits, of which --split names one; coco, yolo: without --split all of them, each by itself."""
    labels: Maybe[Path] = None
    """Datasets: corrected labels, as the studio writes them (.labels.jsonl)."""
    source: Annotated[tuple[str, ...], several("NAME [NAME ...]")] = ()
    """Recordings: sources to export; default: all, or the only one that has what the format holds."""
    subject: Maybe[str] = None
    """Recordings: the subject to export (c3d, bvh, trc, sto); required where there are several."""
    span: Annotated[tuple[float, float] | None, several("FROM TO")] = None
    """Recordings: seconds from the start of the take."""
    rate: Maybe[float] = None
    """Recordings: frames a second (c3d, trc, sto); default: the rate that the device reported, or the median."""
    angles: bool = False
    """sto: joint angles in place of orientations."""
    overwrite: bool = False
    """Replace existing files."""


COMMAND = Export


def run(command: Export) -> None:
    """Export with a progress bar and name what was written."""
    from cabinpose.app.cli.recording_exchange import export_recording
    from cabinpose.store.convert import check_export, export_parts, write_parts

    if command.onnx is not None:
        _export_model(command, command.onnx)
        return
    if command.dataset is None or command.format is None:
        raise ConfigError("there is nothing to export", hint="give DATASET or RECORDING and --format, or --onnx CHECKPOINT")
    if export_recording(command, command.dataset, command.format):
        return
    check_export(command.format, command.images)
    dataset, splits = _frames(command, command.dataset, command.format)
    parts = export_parts(dataset, command.format, splits)
    counts = {name: part.sizes["frame"] for name, part in parts.items()}
    frames = sum(counts.values())
    with progress(frames, "frames") as report:
        folder = write_parts(
            parts, command.format, command.out, images=command.images, overwrite=command.overwrite, report=report
        )
    by_split = {} if "" in counts else {"splits": counts}
    if command.as_json:
        print_json({"out": str(folder), "format": command.format, "frames": frames} | by_split)
        return
    print(f"{folder}: {frames} frames as {command.format}" + (f": {listed(counts)}" if by_split else ""))
    left = dataset.sizes["frame"] - frames
    if left and command.split is None:
        print(f"{left} frames belong to no split and are left out", file=sys.stderr)


def _frames(command: Export, folder: Path, name: str) -> tuple[xr.Dataset, Splits]:
    """The frames to export, and the splits to write them by: one that is named or all, where the format can tell splits apart."""
    from cabinpose.app.cli.selection import frames_with, opened, selected, selection
    from cabinpose.store import read_splits
    from cabinpose.store.convert import IMAGE_KINDS

    dataset = opened(folder, command.labels)
    if command.splits is None or name not in IMAGE_KINDS:
        return selected(dataset, command), {}
    splits = read_splits(command.splits, None if command.split is None else [command.split])
    return frames_with(dataset, [selection(command.select)]), splits


def _export_model(command: Export, checkpoint: Path) -> None:
    if command.dataset is not None or command.format is not None:
        raise ConfigError("a dataset or a model is exported, not both", hint="give DATASET and --format, or --onnx CHECKPOINT")
    if checkpoint.suffix == ".npz":
        raise ConfigError(f"{checkpoint} holds no network", hint="it is the model already: give it to --model")
    require("train")
    from cabinpose.estimate import export_onnx

    name = command.name or command.out.stem
    with progress() as report:
        report.phase("exporting and comparing with torch")
        difference = export_onnx(
            checkpoint, command.out, name=name, card=_card(command.card), mirrored=command.mirrored, half=command.half,
            overwrite=command.overwrite,
        )  # fmt: skip
    if command.as_json:
        print_json({"out": str(command.out), "format": "onnx", "difference": difference})
    else:
        print(f"{command.out}: differs from torch by at most {difference:.1e}")


def _card(path: Path | None) -> dict[str, Any]:
    from cabinpose.store import read_mapping

    return {} if path is None else read_mapping(path, hint="give a YAML file of `key: value` lines with --card")

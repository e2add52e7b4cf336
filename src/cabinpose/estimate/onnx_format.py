"""ONNX as a format of `cabinpose export`; `export` writes the file."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from cabinpose.core import DriveSide
from cabinpose.store import read_mapping
from cabinpose.store.convert import ModelFormat


@dataclass(frozen=True, kw_only=True)
class OnnxExport:
    """How an ONNX file is written."""

    name: str | None = None
    """Name of the model in reports; default: the file's."""
    card: Path | None = None
    """YAML file of what is known of the model (data, seeds, metrics, limits), stored in the file."""
    mirrored: bool = False
    """The model answers with the mean over a frame and its mirror image: smaller errors, at twice the time."""
    drive_side: DriveSide | None = None
    """Side of the wheel in the cars that the model is for, where frames do not say it; for methods that tell seats by place."""
    half: bool = False
    """The file holds its weights in half precision: half the bytes, the same speed."""


class OnnxFormat(ModelFormat):
    """ONNX, for `predict`, `evaluate`, `live` and `serve`."""

    export_options = OnnxExport

    def write(self, checkpoint: Path, out: Path, options: OnnxExport, *, overwrite: bool) -> float:
        """As `export_onnx`."""
        from cabinpose.estimate.export import export_onnx, write_copy  # noqa: PLC0415 - torch
        from cabinpose.estimate.onnx_model import DRIVE_SIDE, OnnxModel  # noqa: PLC0415 - ONNX Runtime

        hint = "give a YAML file of `key: value` lines with --card"
        card = {} if options.card is None else read_mapping(options.card, hint=hint)
        difference = export_onnx(
            checkpoint, out, name=options.name or out.stem, card=card, mirrored=options.mirrored, half=options.half,
            overwrite=overwrite,
        )  # fmt: skip
        if options.drive_side is not None:
            write_copy(OnnxModel(out, threads=1), out, **{DRIVE_SIDE: options.drive_side})
        return difference


ONNX = OnnxFormat()

"""ONNX as a format of `cabinpose export`; `export` writes the file."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

from cabinpose.core import ConfigError, DriveSide, ModelError
from cabinpose.estimate.settings import DepthUnit
from cabinpose.store import open_dataset, read_mapping
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
    int8: Path | None = None
    """Dataset like the training's: its frames give ranges by which convolutions compute in eight bits."""
    whole: DepthUnit | None = None
    """One graph from a camera's images to joints in space, for other programs: depth in m (float32) or mm (uint16)."""


class OnnxFormat(ModelFormat):
    """ONNX, for `predict`, `evaluate`, `live` and `serve`; with `whole` for programs of others."""

    export_options = OnnxExport

    def write(self, checkpoint: Path, out: Path, options: OnnxExport, *, overwrite: bool) -> float:
        """Write a checkpoint, or with `int8` or `whole` what another ONNX file or a packaged model becomes by them.

        Returns
        -------
        float
            The greatest difference from what it was made of: of the answers from torch's, as `export_onnx` has it, and in m of
            the joints of a whole graph from the predictor's. What eight bits lose is not in it, and NaN where they are all there
            is.
        """
        from cabinpose.estimate.export import export_onnx, write_copy  # noqa: PLC0415 - torch
        from cabinpose.estimate.int8 import write_int8  # noqa: PLC0415 - ONNX Runtime
        from cabinpose.estimate.onnx_model import DRIVE_SIDE, OnnxModel, packaged_models  # noqa: PLC0415 - ONNX Runtime
        from cabinpose.estimate.whole_graph import write_whole_graph  # noqa: PLC0415 - torch

        source, difference = packaged_models().get(str(checkpoint), checkpoint), math.nan
        if out.exists() and not overwrite:
            raise ModelError(f"{out} exists", hint="--overwrite replaces it")
        if source.suffix == ".onnx":
            _check_exported(checkpoint, options)
        calibrating = None if options.int8 is None else open_dataset(options.int8)
        with TemporaryDirectory() as folder:
            made = Path(folder) / "model.onnx"
            last = out if calibrating is None and options.whole is None else made
            if source.suffix != ".onnx":
                hint = "give a YAML file of `key: value` lines with --card"
                card = {} if options.card is None else read_mapping(options.card, hint=hint)
                name = options.name or out.stem
                difference = export_onnx(
                    source, last, name=name, card=card, mirrored=options.mirrored, half=options.half, overwrite=overwrite
                )
                source = last
            if options.drive_side is not None:
                write_copy(OnnxModel(source, threads=1), last, **{DRIVE_SIDE: options.drive_side})
                source = last
            if calibrating is not None:
                last = out if options.whole is None else made
                write_int8(OnnxModel(source, threads=1), calibrating, last)
                source = last
            if options.whole is not None:
                apart = write_whole_graph(OnnxModel(source, threads=1), out, options.whole)
                difference = apart if math.isnan(difference) else max(apart, difference)
        return difference


def _check_exported(model: Path, options: OnnxExport) -> None:
    """Raise ConfigError where an exported model is given, and there is nothing to be made of it."""
    asked = [name for name in ("name", "card", "mirrored", "half") if getattr(options, name)]
    if asked:
        raise ConfigError(
            f"{model} is exported already, without --{asked[0].replace('_', '-')}", hint="give the checkpoint of its training"
        )
    if options.int8 is None and options.whole is None and options.drive_side is None:
        hint = "--int8 DATASET, --whole m or --drive-side right makes another of it"
        raise ConfigError(f"{model} is exported already", hint=hint)


ONNX = OnnxFormat()

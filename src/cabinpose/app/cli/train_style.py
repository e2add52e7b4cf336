"""`cabinpose train-style`: train a model that gives generated depth the look of a real camera's frame."""

from __future__ import annotations

import dataclasses
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from tyro.conf import Positional, arg

from cabinpose.app.cli.arguments import DatasetArgument, Maybe, PrintsJson, refuse_existing
from cabinpose.app.cli.output import print_json, print_rows, progress
from cabinpose.app.extras import require
from cabinpose.core import ConfigError

if TYPE_CHECKING:
    from cabinpose.synth.style import Loss


@dataclass(frozen=True, kw_only=True)
class TrainStyle(PrintsJson):
    """Train a model that gives generated depth the look of a real camera's frame: noise, texture and losses at silhouettes.

    `cabinpose synth --style MODEL` then writes depth_styled. Needs the extra `train`.
    """

    style: Annotated[Positional[Path], arg(metavar="STYLE")]
    """Real depth frame with masks of its regions (.npz), see docs/style.md."""
    dataset: DatasetArgument
    out: Path
    """Model to write (.onnx)."""
    steps: int = 600
    """Frames that training looks at, about half a second each."""
    vgg19: Maybe[Path] = None
    """torchvision's weights of VGG-19 (vgg19-*.pth) to judge styles by; default: the package's own encoder."""
    seed: int = 0
    """Seed of all random numbers."""
    overwrite: bool = False
    """Replace the model."""


COMMAND = TrainStyle
_COMPARED = ("style", "generated", "styled")


def run(command: TrainStyle) -> None:
    """Train with a progress bar, and say what the model does to frames that it has not seen."""
    require("train")
    from cabinpose.store import open_dataset
    from cabinpose.synth.style import StyleFrame, fit_style

    if command.out.suffix != ".onnx":
        raise ConfigError(f"{command.out} is no name of a model", hint="let it end in .onnx")
    refuse_existing(command.out.parent, command.out.name, overwrite=command.overwrite)
    style = StyleFrame.read(command.style)
    with progress(command.steps, "steps") as report:

        def show(step: int, loss: Loss) -> None:
            report(step, f"style {float(loss.style):.3f}, content {float(loss.content):.3f}")

        found = fit_style(
            style, open_dataset(command.dataset), command.out, steps=command.steps, seed=command.seed,
            vgg19=None if command.vgg19 is None else str(command.vgg19), report=show,
        )  # fmt: skip
    if command.as_json:
        noise = {n: dict(zip(_COMPARED, (each._asdict() for each in three), strict=True)) for n, three in found.noise.items()}
        print_json({"out": str(command.out), **dataclasses.asdict(found), "noise": noise})
        return
    sigma, grain = (
        ", ".join(f"{n} {was[k]:.3g} to {now[k]:.3g} (style: {theirs[k]:.3g})" for n, (theirs, was, now) in found.noise.items())
        for k in range(2)
    )
    print_rows(
        [
            ("model", f"{command.out}; frames kept from training that judge it: {found.frames}"),
            ("style loss", f"{found.style_loss[0]:.3f} to {found.style_loss[1]:.3f}"),
            ("noise, mm", sigma),
            ("neighbours correlate", grain),
            ("labels", f"edges moved by {found.edge_px:.2f} px at most, mean depths of parts by {found.part_mm:.3f} mm"),
            ("lost", f"{100 * found.lost:.1f} % of the valid pixels"),
        ]
    )
    print(f"use it with: cabinpose synth --frames 10 --out DATASET --style {command.out}", file=sys.stderr)

"""The stage of a generator that styles a frame's depth and holds it to its labels."""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from cabinpose.core import Bools, Bytes, ConfigError, Floats32, ModelError, check_onnx, open_onnx, optional_module, run_onnx
from cabinpose.synth.style.frame import StyleFrame, guides_of
from cabinpose.synth.style.safety import LabelShift, label_shift, parts_of, without_part_means
from cabinpose.synth.style.settings import LEFT, METADATA_KEY, Style

MULTIPLE = 4  # of a network's height and width
_TRAIN = "`cabinpose train-style` makes one of a style frame and a dataset"


class FrameStyler:
    """Styles frames in one thread, by a trained network or by optimisation.

    Raises ConfigError or ModelError for a file that is neither a model nor a style frame, DependencyError where an optimisation
    lacks torch.
    """

    def __init__(self, style: Style) -> None:
        path = Path(style.by)
        if not path.is_file():
            raise ConfigError(f"there is no style {path}", hint=f"give a style frame (.npz) or a model (.onnx); {_TRAIN}")
        self._style = style
        self.name = f"{path.stem} {hashlib.sha256(path.read_bytes()).hexdigest()[:8]}"
        self._transfer: Callable[[dict[str, Floats32]], tuple[Floats32, Bools]]  # to a change (m) and the pixels that are kept
        if path.suffix == ".npz":
            frame = StyleFrame.read(path)
            optional_module("torch", purpose="styling by a frame", hint="pip install 'cabinpose[train]'")
            from cabinpose.synth.style.transfer import FrameOptimiser  # noqa: PLC0415 - torch

            self._transfer = FrameOptimiser(frame, style.vgg19, style.steps)
        else:
            session = open_network(path)
            self._transfer = lambda inputs: run_network(session, path, inputs)

    def take(
        self, depth: Floats32, depth_clean: Floats32, labels: Bytes, instance: Bytes, *, rng: np.random.Generator
    ) -> dict[str, Any]:
        """`depth_styled` of a frame's depth (H, W), m, NaN where invalid, with what was done and how far labels are off.

        A frame that moves farther against its labels than allowed keeps its depth.
        """
        inputs = inputs_of(depth, guides_of(labels, depth_clean), rng=rng)
        change, kept = self._transfer(inputs)
        at = (slice(depth.shape[0]), slice(depth.shape[1]))
        styled, shift = held(depth, change[at], kept[at], labels, instance)
        safe = shift.edge_px <= self._style.most_edge_px and shift.part_mm <= self._style.most_part_mm
        return {
            "depth_styled": styled if safe else depth,
            "style": self.name if safe else LEFT,
            "style_edge_px": shift.edge_px,
            "style_part_mm": shift.part_mm,
            "style_lost": shift.lost,
        }


def inputs_of(depth: Floats32, guides: Floats32, *, rng: np.random.Generator) -> dict[str, Floats32]:
    """What styling looks at, (1, C, H, W) each, H and W rounded up to `MULTIPLE`: depth, valid, guides and unit noise."""
    valid = np.isfinite(depth)
    noise = rng.standard_normal(depth.shape, np.float32)
    images = {"depth": np.nan_to_num(depth)[None], "valid": valid[None], "guides": guides, "noise": noise[None]}
    more = [(0, 0), *((0, -size % MULTIPLE) for size in depth.shape)]
    return {name: np.pad(image.astype(np.float32), more)[None] for name, image in images.items()}


def held(depth: Floats32, change: Floats32, kept: Bools, labels: Bytes, instance: Bytes) -> tuple[Floats32, LabelShift]:
    """The depth with a change and losses (H, W), without what would move the mean of a part, and how far it is off its labels."""
    kept = kept & np.isfinite(depth)
    moved = depth + without_part_means(change, kept, parts_of(labels, instance))
    styled = np.where(kept & (moved > 0), moved, np.nan).astype(np.float32)
    return styled, label_shift(depth, styled, labels, instance)


def open_network(path: Path) -> Any:
    """A model of `cabinpose train-style` on one thread; ModelError for other files."""
    try:
        check_onnx(path)
        session = open_onnx(path, threads=1)  # frames are made in threads already, and the same bytes by any number of them
    except Exception as error:  # ONNX Runtime's own errors share no base class
        raise ModelError(f"{path} cannot be read as a model", hint=_TRAIN) from error
    if METADATA_KEY not in session.get_modelmeta().custom_metadata_map:
        raise ModelError(f"{path} is no model of a style", hint=_TRAIN)
    return session


def run_network(session: Any, path: Path, inputs: dict[str, Floats32]) -> tuple[Floats32, Bools]:
    """The change (H, W), m, and the pixels that are kept."""
    change, logit = run_onnx(session, path, ["change", "logit"], inputs)
    return change[0, 0], logit[0, 0] > 0

"""Detectors with default settings and fresh weights, for figures of speed where no trained model is at hand."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray

from cabinpose.core.pose import OCCUPANT_SLOTS
from cabinpose.estimate.batch import Batch
from cabinpose.estimate.data import collate, view_frame
from cabinpose.estimate.export import write_onnx
from cabinpose.estimate.paf.config import PafConfig
from cabinpose.estimate.paf.fit import in_image, targets
from cabinpose.estimate.paf.model import STRIDE
from cabinpose.estimate.training import Detector, TrainConfig, complete, frame_spec

_SURE = 4.0  # logit of what is known to be there, or not

Answers = Mapping[str, NDArray[np.float32]]


class Fresh(NamedTuple):
    """An untrained detector. answers: what a trained network would say of each frame, where decoding takes as long as what
    it is given asks for; else None.
    """

    path: Path
    parameters: int
    answers: list[Answers] | None


def fresh_detector(method: str, frames: Sequence[Mapping[str, Any]], folder: Path) -> Fresh:
    """Write `method`.onnx with default settings, those that are measured taken from frames of the dataset standard."""
    torch.manual_seed(0)
    base = TrainConfig(method=method)
    spec = frame_spec(base)
    kept = [view_frame(frame, spec, [OCCUPANT_SLOTS.index(slot) for slot in spec.slots]) for frame in frames]
    detector = Detector(complete(base, kept)).eval()
    path = folder / f"{method}.onnx"
    write_onnx(detector, path, name=method, card={"weights": "fresh"})
    answers = None
    if isinstance(detector.method_config, PafConfig):  # without peaks, or with noise for peaks, nothing real is assembled
        answers = [rendered_maps(collate([k]), detector.method_config) for k in kept]
    return Fresh(path, sum(p.numel() for p in detector.network.parameters()), answers)


def rendered_maps(batch: Batch, config: PafConfig) -> Answers:
    """Outputs of the part affinity fields as training asks for them: maps of the true joints, and who of them is there."""
    heat, fields = targets(batch, config, config.height // STRIDE, config.width // STRIDE)
    there = torch.where(in_image(batch).any(dim=1), _SURE, -_SURE)
    presence = torch.stack((-there, there), dim=-1)
    return {"fields": fields.float().numpy(), "heat": heat.float().numpy(), "presence": presence.float().numpy()}

"""From the segmentation's answers to pixel classes; the same for torch and ONNX Runtime."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cabinpose.estimate.unet.config import UnetConfig


def decode(
    outputs: Mapping[str, NDArray[Any]],
    config: UnetConfig,  # noqa: ARG001 - one interface for all methods
    seen: Mapping[str, NDArray[Any]],  # noqa: ARG001
) -> NDArray[np.uint8]:
    """Classes (N, h, w) of the view's pixels: 0 = nobody, else 1 + the position of the part.

    outputs: person (N, h, w) and parts (N, P, h, w) logits.
    """
    parts = 1 + np.argmax(outputs["parts"], axis=1)
    return np.where(outputs["person"] > 0, parts, 0).astype(np.uint8)

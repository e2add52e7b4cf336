"""From the compact network's answers to joints; the same for torch and ONNX Runtime."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cabinpose.estimate.compact.config import CompactConfig
from cabinpose.estimate.found import Found, sigmoid


def decode(outputs: Mapping[str, NDArray[Any]], config: CompactConfig, seen: Mapping[str, NDArray[Any]]) -> Found:  # noqa: ARG001 - depths are learnt, not looked up
    """joints (N, S, J, 3) (u, v, z) of the view, inside and visible (N, S, J) and present (N, S) logits, as joints.

    A joint is present with the probability that its person is there and the joint in the image. spreads (N, S, J, C), m, are
    lacking in models that older versions exported.
    """
    count = outputs["inside"].shape[-1]
    sure = sigmoid(np.concatenate((outputs["present"][..., None], outputs["inside"], outputs["visible"]), axis=-1))
    presence = sure[..., :1] * sure[..., 1 : 1 + count]
    uvz = np.asarray(outputs["joints"], dtype=np.float64)
    return Found(uvz[..., :2], config.view.from_view(uvz), presence * sure[..., 1 + count :], presence, outputs.get("spreads"))

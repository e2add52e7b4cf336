"""The segmentation as a method."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from cabinpose.estimate.methods import Arrays, Layout, NetworkMethod
from cabinpose.estimate.unet.config import UnetConfig

if TYPE_CHECKING:
    from torch import Tensor

    from cabinpose.estimate.batch import Batch
    from cabinpose.estimate.unet.model import Unet


class UnetMethod(NetworkMethod[UnetConfig]):
    """A body part for every pixel by two U-Nets in a row, see `model.py`."""

    name = "unet"
    task = "parts"
    settings_type = UnetConfig
    outputs = ("person", "parts")
    of_places = False
    channels_last = True
    learning_rate = 1e-3
    weight_decay = 0.01

    def network(self, settings: UnetConfig) -> Unet:
        from cabinpose.estimate.unet.model import Unet  # noqa: PLC0415 - torch

        return Unet(settings)

    def layout(self, settings: UnetConfig) -> Layout:
        """Rows of the last layer, one a part."""
        parts = {0: [part.name for part in settings.parts]}
        return {"parts.last.weight": parts, "parts.last.bias": parts}

    def loss(self, network: Unet, batch: Batch) -> dict[str, Tensor]:
        from cabinpose.estimate.unet.fit import loss  # noqa: PLC0415 - torch

        return loss(network, batch)

    def decode(self, outputs: Arrays, settings: UnetConfig, seen: Arrays) -> NDArray[np.uint8]:  # noqa: ARG002
        """Classes (N, h, w) of the view's pixels: 0 = nobody, else 1 + the position of the part.

        outputs: person (N, h, w) and parts (N, P, h, w) logits.
        """
        parts = 1 + np.argmax(outputs["parts"], axis=1)
        return np.where(outputs["person"] > 0, parts, 0).astype(np.uint8)


METHOD = UnetMethod()

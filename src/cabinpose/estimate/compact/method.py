"""The compact detector as a method."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from cabinpose.estimate.compact.config import CompactConfig
from cabinpose.estimate.found import Found, sigmoid
from cabinpose.estimate.methods import Arrays, Layout, NetworkMethod

if TYPE_CHECKING:
    from torch import Tensor

    from cabinpose.estimate.batch import Batch
    from cabinpose.estimate.compact.model import Compact, Mirrored


class CompactMethod(NetworkMethod[CompactConfig]):
    """Every cell of a coarse grid votes for every joint, and each joint is then refined, see `model.py`."""

    name = "compact"
    task = "joints"
    settings_type = CompactConfig
    outputs = ("joints", "inside", "visible", "present", "wheel", "spreads")
    room: ClassVar[Mapping[str, Any]] = MappingProxyType({"looks_px": []})
    reads_onnx = True
    precise = ("votes", "looks", "present", "wheel")

    def network(self, settings: CompactConfig) -> Compact:
        from cabinpose.estimate.compact.model import Compact  # noqa: PLC0415 - torch

        return Compact(settings)

    def loss(self, network: Compact, batch: Batch) -> dict[str, Tensor]:
        from cabinpose.estimate.compact.fit import loss  # noqa: PLC0415 - torch

        return loss(network, batch)

    def layout(self, settings: CompactConfig) -> Layout:
        from cabinpose.estimate.compact.model import layout  # noqa: PLC0415 - torch

        return layout(settings)

    def mirrored(self, network: Compact) -> Mirrored:
        from cabinpose.estimate.compact.model import Mirrored  # noqa: PLC0415 - torch

        return Mirrored(network)

    def decode(self, outputs: Arrays, settings: CompactConfig, seen: Arrays) -> Found:  # noqa: ARG002 - depths are learnt
        """joints (N, S, J, 3) (u, v, z) of the view, inside and visible (N, S, J) and present (N, S) logits, as joints.

        A joint is present with the probability that its person is there and the joint in the image. spreads (N, S, J, C), m, and
        wheel (N,), a logit, are lacking in models that older versions exported; those tell by themselves who drives.
        """
        count = outputs["inside"].shape[-1]
        sure = sigmoid(np.concatenate((outputs["present"][..., None], outputs["inside"], outputs["visible"]), axis=-1))
        presence = sure[..., :1] * sure[..., 1 : 1 + count]
        uvz = np.asarray(outputs["joints"], dtype=np.float64)
        spreads = outputs.get("spreads")
        return Found(
            uvz[..., :2], settings.view.from_view(uvz), presence * sure[..., 1 + count :], presence, spreads, outputs.get("wheel")
        )


METHOD = CompactMethod()

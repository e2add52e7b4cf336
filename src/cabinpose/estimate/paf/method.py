"""Part affinity fields as a method."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, ClassVar

from cabinpose.estimate.found import Found
from cabinpose.estimate.inputs import Kept
from cabinpose.estimate.methods import Arrays, Layout, NetworkMethod
from cabinpose.estimate.paf.config import PafConfig
from cabinpose.estimate.paf.decode import decode
from cabinpose.estimate.paf.measure import measured

if TYPE_CHECKING:
    from torch import Tensor

    from cabinpose.estimate.batch import Batch
    from cabinpose.estimate.paf.model import Paf


class PafMethod(NetworkMethod[PafConfig]):
    """Heat maps of joints, and fields along limbs that tie them to people, see `model.py`."""

    name = "paf"
    task = "joints"
    settings_type = PafConfig
    outputs = ("fields", "heat", "presence")
    of_places = False
    channels_last = True
    learning_rate = 4e-4
    weight_decay = 0.01
    room: ClassVar[Mapping[str, Any]] = MappingProxyType({"channels": 0.25, "depth_scale_m": 6.0})

    def measured(self, settings: PafConfig, some: Callable[[], Sequence[Kept]]) -> PafConfig:
        """Places' anchors and skin offsets."""
        return measured(settings, some())

    def network(self, settings: PafConfig) -> Paf:
        from cabinpose.estimate.paf.model import Paf  # noqa: PLC0415 - torch

        return Paf(settings)

    def layout(self, settings: PafConfig) -> Layout:
        from cabinpose.estimate.paf.model import layout  # noqa: PLC0415 - torch

        return layout(settings)

    def loss(self, network: Paf, batch: Batch) -> dict[str, Tensor]:
        from cabinpose.estimate.paf.fit import loss  # noqa: PLC0415 - torch

        return loss(network, batch)

    def decode(self, outputs: Arrays, settings: PafConfig, seen: Arrays) -> Found:
        return decode(outputs, settings, seen)


METHOD = PafMethod()

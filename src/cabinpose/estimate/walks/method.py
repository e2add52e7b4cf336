"""Random tree walks as a method."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, ClassVar

from numpy.typing import NDArray

from cabinpose.estimate.inputs import Kept
from cabinpose.estimate.methods import ArrayMethod, Progress
from cabinpose.estimate.walks.config import WalksConfig
from cabinpose.estimate.walks.find import check, find

if TYPE_CHECKING:
    from cabinpose.estimate.settings import AugmentConfig


class WalksMethod(ArrayMethod[WalksConfig]):
    """A regression tree a joint, and a walk to it."""

    name = "walks"
    task = "joints"
    settings_type = WalksConfig
    room: ClassVar[Mapping[str, Any]] = MappingProxyType({"width": 320, "height": 240, "focal": 285.7})

    def fit(
        self, settings: WalksConfig, frames: Sequence[Kept], augment: AugmentConfig, progress: Progress, *, seed: int
    ) -> dict[str, NDArray[Any]]:
        from cabinpose.estimate.walks.fit import fit  # noqa: PLC0415 - for training alone

        return fit(settings, frames, progress, seed=seed, mirrored=augment.flip > 0)

    find, check = staticmethod(find), staticmethod(check)


METHOD = WalksMethod()

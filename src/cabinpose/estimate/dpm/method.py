"""Deformable parts as a method."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, ClassVar

from numpy.typing import NDArray

from cabinpose.estimate.dpm.config import DpmConfig
from cabinpose.estimate.dpm.find import check, find
from cabinpose.estimate.inputs import Kept
from cabinpose.estimate.methods import ArrayMethod, Progress

if TYPE_CHECKING:
    from cabinpose.estimate.settings import AugmentConfig


class DpmMethod(ArrayMethod[DpmConfig]):
    """A filter for each type of each part, springs between them, and one search for the best placement of all."""

    name = "dpm"
    task = "joints"
    settings_type = DpmConfig
    room: ClassVar[Mapping[str, Any]] = MappingProxyType({"width": 120, "height": 120, "focal": 142.9, "rounds": 3})

    def fit(
        self, settings: DpmConfig, frames: Sequence[Kept], augment: AugmentConfig, progress: Progress, *, seed: int,  # noqa: ARG002
    ) -> dict[str, NDArray[Any]]:  # fmt: skip
        from cabinpose.estimate.dpm.fit import fit  # noqa: PLC0415 - for training alone

        return fit(settings, frames, progress, seed=seed)

    find, check = staticmethod(find), staticmethod(check)


METHOD = DpmMethod()

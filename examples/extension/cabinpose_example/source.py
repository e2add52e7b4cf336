"""A source: a camera before a flat board, as a stand-in for a vendor's SDK."""

from collections.abc import Sequence
from typing import ClassVar

import numpy as np
from pydantic import BaseModel, ConfigDict, Field

from cabinpose.record.sources import DeviceSource
from cabinpose.signals import Sample, ToFFrame

NONE = np.zeros((0, 0), np.uint8)


class BoardSettings(BaseModel):
    """What a rig, `live --set` and the studio can set."""

    model_config = ConfigDict(extra="forbid", frozen=True)
    distance_m: float = Field(1.0, gt=0.1, lt=6, description="of the board, m")
    rate_hz: float = Field(30.0, gt=0, le=200, description="frames a second")


class BoardCamera(DeviceSource[BoardSettings]):
    """Gives 160 x 120 px of a board at one distance."""

    Settings: ClassVar[type[BoardSettings]] = BoardSettings
    is_camera = True

    def _connect(self) -> None:
        self._next_ns, self._count = self._clock.now_ns(), 0

    def _disconnect(self) -> None:
        pass

    def _read(self, timeout_s: float) -> Sequence[Sample]:
        wait_s = (self._next_ns - self._clock.now_ns()) / 1e9
        self._clock.sleep(min(max(wait_s, 0.0), timeout_s))
        if wait_s > timeout_s:
            return ()
        self._next_ns += round(1e9 / self.settings.rate_hz)
        self._count += 1
        self.counts.received += 1
        k = np.array([[120.0, 0, 79.5], [0, 120.0, 59.5], [0, 0, 1]])
        depth = np.full((120, 160), round(self.settings.distance_m / 1e-3), np.uint16)
        light = np.full(depth.shape, 400, np.uint16)
        frame = ToFFrame(depth, 1e-3, light, NONE, k, np.zeros(5), np.zeros(5))
        return (Sample(self._count, self._clock.now_ns(), None, b"", (frame,)),)

"""The generator as a camera: scenes made while the recorder runs, seen at a camera's frame rate. Kind `synth` of a rig."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from itertools import count
from pathlib import Path
from typing import Any, ClassVar

from pydantic import Field

from cabinpose.core import CabinposeError
from cabinpose.record.sources.tof import SimulatedSettings, SimulatedSource
from cabinpose.signals import HostClock
from cabinpose.synth import FrameMaker, SynthConfig


class SynthCameraSettings(SimulatedSettings):
    """A camera that sees what the generator makes."""

    scenes: Path = Field(description="the generator's configuration, as `cabinpose synth --config` takes it")
    seed: int = Field(0, ge=0, lt=2**63, description="of the scenes: frame n is frame n of the dataset with this seed")


class SynthCameraSource(SimulatedSource):
    """A `FrameSource` of scenes made live; a generator slower than the frame rate slows the camera down."""

    Settings: ClassVar[type[SimulatedSettings]] = SynthCameraSettings

    def __init__(self, name: str, settings: SynthCameraSettings, clock: HostClock) -> None:
        super().__init__(name, settings, clock, self._made)
        self._scenes = settings
        self._maker: FrameMaker | None = None

    def _missing(self) -> Sequence[str]:
        try:
            SynthConfig.load(self._scenes.scenes)
        except CabinposeError as error:
            return [error.in_one_line()]
        return []

    def _connect(self) -> None:
        """The people and cars of the scenes are built before the camera's clock starts."""
        if self._maker is None:
            self._maker = FrameMaker(SynthConfig.load(self._scenes.scenes), self._scenes.seed, pictures=False)
        super()._connect()

    def _made(self) -> Iterator[Mapping[str, Any]]:
        assert self._maker is not None
        for index in count():
            yield self._maker.make(index)[0]

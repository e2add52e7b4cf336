"""A recording played as if its devices were there: at its own pace, faster, or as fast as it is read."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import closing
from typing import ClassVar

from pydantic import Field

from cabinpose.core import RecordingError, unknown_name
from cabinpose.record.sources.base import PlayedSettings, PlayedSource
from cabinpose.record.sources.counting import FrameNumbers
from cabinpose.signals import HostClock, Sample
from cabinpose.store.recording import Recording

_LATE = 4096  # numbers: the samples of a suit come in any order within a second


class ReplaySettings(PlayedSettings):
    """Which recording, and how fast."""

    source: str | None = Field(
        None, description="name of the source in the recording; left out: the only one, or the only ToF camera"
    )
    host_time: bool = Field(False, description="keep the recorded host times; otherwise a sample arrives when it is played")


class ReplaySource(PlayedSource[ReplaySettings]):
    """A `FrameSource` that plays one source of a recording once.

    Numbers and device times are those that were recorded, so gaps are seen as they were then; `counts.lost` are the gaps.
    """

    Settings: ClassVar = ReplaySettings
    plays = ".mcap"

    def __init__(self, name: str, settings: ReplaySettings, clock: HostClock) -> None:
        super().__init__(name, settings, clock)
        self._numbers = FrameNumbers(self.counts, late=_LATE)

    def _missing(self) -> Sequence[str]:
        with closing(self._recording()) as recording:
            self._source_in(recording)
        return []

    def _connect(self) -> None:
        self._file = self._recording()
        name = self._source_in(self._file)
        self._play(sample for _, sample in self._file.samples([name]))

    def _disconnect(self) -> None:
        self._file.close()

    def _recording(self) -> Recording:
        return Recording(self.settings.path, damaged="skip")

    def _source_in(self, recording: Recording) -> str:
        name, there, cameras = self.settings.source, recording.sources, recording.cameras
        for only in (there, cameras):
            if name is None and len(only) == 1:
                return only[0]
        if name is None:
            what, which = (f"{len(cameras)} ToF cameras", cameras) if cameras else (f"{len(there)} sources", there)
            path = self.settings.path
            hint = f"name one, with `source` or as {path.name}:NAME: {', '.join(which)}"
            raise RecordingError(f"{path} has {what}" + ("" if cameras else ", none of them a ToF camera"), hint=hint)
        if name not in there:
            raise RecordingError(str(error := unknown_name("source of the recording", name, there)), hint=error.hint)
        return name

    def _played(self, sample: Sample, now_ns: int) -> Sample:
        if sample.sequence is not None:
            self._numbers.number(sample.sequence)
        return super()._played(sample, sample.host_ns if self.settings.host_time else now_ns)

"""A recording of an Azure Kinect (.mkv) played as a camera, at its own pace or as fast as it is read."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import ClassVar

from cabinpose.core import RecordingError
from cabinpose.record.sources.base import PlayedSettings, PlayedSource
from cabinpose.record.sources.counting import FrameNumbers, FramePeriod
from cabinpose.signals import HostClock, Sample, ToFFrame
from cabinpose.store.convert import AzureFile


class AzureMkvSettings(PlayedSettings):
    """A recording of an Azure Kinect."""


class AzureMkvSource(PlayedSource[AzureMkvSettings]):
    """A `FrameSource` that plays a recording once; frames that the camera dropped are counted from their time stamps."""

    Settings: ClassVar = AzureMkvSettings
    is_camera = True
    plays = ".mkv"
    _at_once = 1  # images are large

    def __init__(self, name: str, settings: AzureMkvSettings, clock: HostClock) -> None:
        super().__init__(name, settings, clock)
        self._numbers = FrameNumbers(self.counts)
        self._period = FramePeriod()

    def _missing(self) -> Sequence[str]:
        AzureFile(self.settings.path).close()
        return []

    def _connect(self) -> None:
        self._file = AzureFile(self.settings.path)
        self._play(self._read_file(self._file))

    def _disconnect(self) -> None:
        self._file.close()

    def _read_file(self, file: AzureFile) -> Iterator[Sample]:
        """The messages of the file; damage ends it, and counts."""
        try:
            for stamp_ns, device_ns, message in file.rows():
                sequence = None
                if isinstance(message, ToFFrame) and device_ns is not None:
                    sequence = self._numbers.forward(self._period.lost_before(device_ns) or 0)
                yield Sample(sequence, stamp_ns, device_ns, b"", (message,))
                self.counts.malformed = file.malformed
        except RecordingError:
            self.counts.malformed = file.malformed + 1
        else:
            self.counts.malformed = file.malformed

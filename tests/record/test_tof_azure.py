"""An Azure Kinect recording played as a camera."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from cabinpose.core.errors import RecordingError, SourceEndedError
from cabinpose.record.sources.tof.azure_mkv import AzureMkvSettings, AzureMkvSource
from cabinpose.signals.clock import HostClock
from cabinpose.signals.recorded import Sample, ToFFrame


@pytest.mark.real_data
def test_the_file_is_played_to_its_end(real_data: Callable[[str], Path]) -> None:
    pytest.importorskip("av")
    clock = HostClock()
    source = AzureMkvSource("tof", AzureMkvSettings(path=real_data("tof/azure_kinect.mkv"), speed=10.0), clock)
    assert source.check() == []
    began = clock.now_ns()
    source.open()
    samples: list[Sample] = []
    while sum(isinstance(m, ToFFrame) for s in samples for m in s.messages) < 1:
        samples += source.read(0.01)
    with pytest.raises(SourceEndedError):
        source.read(0.01)
    source.close()
    source.close()
    (frame,) = [m for s in samples for m in s.messages if isinstance(m, ToFFrame)]
    assert frame.depth.shape == frame.amplitude.shape == (576, 640)
    assert samples[-1].sequence == 0
    assert samples[-1].device_ns == 336_277_000 + 463_945_000
    assert samples[-1].host_ns - began >= 46_394_500  # at ten times its pace
    assert (source.counts.received, source.counts.malformed, source.counts.lost) == (3, 0, 0)


def test_what_cannot_be_played_is_named(tmp_path: Path) -> None:
    pytest.importorskip("av")
    path = tmp_path / "take.mkv"
    path.write_bytes(b"not a Matroska file")
    source = AzureMkvSource("tof", AzureMkvSettings(path=path), HostClock())
    assert "Matroska" in source.check()[0]
    with pytest.raises(RecordingError, match="cannot read"):
        source.open()
    with pytest.raises(RecordingError, match="not open"):
        source.read(0.0)

"""V4L2 cameras: FFmpeg itself, which reads a pipe of raw pixels in a device's place, and a stand-in for PyAV."""

from __future__ import annotations

import os
import sys
import threading
import time
from collections.abc import Iterator
from fractions import Fraction
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any

import numpy as np
import pytest
from camera_samples import frames

from cabinpose.core.errors import ConfigError, DependencyError, RecordingError
from cabinpose.record.config import parse_rig
from cabinpose.record.sources.tof.v4l2 import V4l2Settings, V4l2Source
from cabinpose.signals.clock import HostClock
from cabinpose.signals.recorded import Facts, Sample

LENS = {"fx": 60.0, "fy": 61.0, "cx": 31.5, "cy": 23.0, "dist": (-0.2, 0.05, 0.001, -0.001, 0.01)}
DEPTH = (np.arange(48 * 64, dtype="<u2") + 400).reshape(48, 64)
SIZE = {"width": 64, "height": 48}


def make(device: Path | str, **settings: Any) -> V4l2Source:
    return V4l2Source("tof", V4l2Settings(**{"device": device, "depth_unit_m": 0.0005, "lens": LENS} | settings), HostClock())


def read(source: V4l2Source, count: int) -> list[Sample]:
    """Samples, until so many frames have come."""
    samples: list[Sample] = []
    until = time.monotonic() + 10
    while sum(s.sequence is not None for s in samples) < count and time.monotonic() < until:
        samples += source.read(0.05)
    return samples


def test_pixels_of_a_device(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """Through FFmpeg: pixels as they are sent, unit and lens as stated, no amplitude; its end is a loss of the camera."""
    monkeypatch.setattr("cabinpose.record.sources.tof.v4l2._FORMAT", "rawvideo")
    device = tmp_path / "video0"
    os.mkfifo(device)

    def send() -> None:
        with device.open("wb") as pipe:
            for number in range(3):
                pipe.write((DEPTH + number).tobytes())

    threading.Thread(target=send, daemon=True).start()
    source = make(device, **SIZE, fps=10, reconnect_s=100.0)
    source.open()
    samples = read(source, 3)
    for number, frame in enumerate(frames(samples)):
        np.testing.assert_array_equal(frame.depth, DEPTH + number)
        assert frame.depth_unit_m == 0.0005
        assert frame.amplitude.size == 0
        np.testing.assert_array_equal(frame.camera_k, [[60.0, 0, 31.5], [0, 61.0, 23.0], [0, 0, 1]])
        np.testing.assert_array_equal(frame.camera_dist, LENS["dist"])
    assert [(s.sequence, s.device_ns) for s in samples if s.sequence is not None] == [(i, i * 100_000_000) for i in range(3)]
    (facts,) = [m for s in samples for m in s.messages if isinstance(m, Facts)]
    assert facts.values == {"model": "video0", "profile": "64x48", "unit_m": 0.0005, "amplitude": "none"}
    deadline = time.monotonic() + 30
    while source._alive() and time.monotonic() < deadline:  # the thread that reads the pipe ends after it
        time.sleep(0.005)
    assert not source._alive()
    source.close()


class FakeAv(ModuleType):
    """PyAV, with a device that sends what `sent` holds: packets, or what is raised; then it is silent until `closed`."""

    def __init__(self) -> None:
        super().__init__("av")
        self.sent: list[Any] = []
        self.opened: list[dict[str, str]] = []
        self.pixels, self.size = "gray16le", (64, 48)
        self.gone = False
        self.closed = 0

    def open(self, path: str, format: str, options: dict[str, str]) -> SimpleNamespace:  # noqa: A002 - PyAV's name
        assert format == "v4l2"
        if self.gone:
            raise FileNotFoundError(2, "No such file or directory", path)
        self.opened.append(options)
        stream = SimpleNamespace(codec_context=SimpleNamespace(pix_fmt=self.pixels, width=self.size[0], height=self.size[1]))
        return SimpleNamespace(streams=SimpleNamespace(video=[stream]), demux=self.demux, close=self.close)

    def demux(self, *, video: int) -> Iterator[SimpleNamespace]:
        assert video == 0
        while self.sent:
            found = self.sent.pop(0)
            if isinstance(found, Exception):
                raise found
            yield found
        while not self.gone:
            time.sleep(0.001)
            yield SimpleNamespace(pts=None)

    def close(self) -> None:
        self.closed += 1


class Packet(bytes):
    """A frame of a device: its bytes, and µs of the driver."""

    pts: int
    time_base = Fraction(1, 1_000_000)


def packet(stamp_us: int, pixels: bytes = DEPTH.tobytes()) -> Packet:
    made = Packet(pixels)
    made.pts = stamp_us
    return made


@pytest.fixture
def av(monkeypatch: pytest.MonkeyPatch) -> Iterator[FakeAv]:
    module = FakeAv()
    monkeypatch.setitem(sys.modules, "av", module)
    yield module
    module.gone = True


def test_losses_damage_and_a_device_that_goes_away(av: FakeAv) -> None:
    """A gap of the driver's stamps is a loss; a frame of another size is malformed; a device that comes back goes on."""
    stamps = [3_600_000_000 + 40_000 * i for i in (0, 1, 2, 3, 4, 5, 8, 9)]
    av.sent = [packet(stamp) for stamp in stamps]
    av.sent[3], av.sent[5] = packet(stamps[3], b""), packet(stamps[5], DEPTH.tobytes()[:-1])
    source = make("/dev/video2", **SIZE, fps=25, reconnect_s=0.01)
    source.open()
    samples = [s for s in read(source, 8) if s.sequence is not None]
    assert av.opened == [{"pixel_format": "gray16le", "video_size": "64x48", "framerate": "25"}]
    assert [s.sequence for s in samples] == [0, 1, 2, 3, 4, 5, 8, 9]
    assert [s.device_ns for s in samples] == [stamp * 1000 for stamp in stamps]
    assert [len(s.messages) for s in samples] == [1, 1, 1, 0, 1, 0, 1, 1]
    assert (source.counts.malformed, source.counts.lost, source.counts.restarts) == (2, 2, 0)
    av.gone = True
    while source._alive():
        source.read(0.001)
    for _ in range(5):
        source.read(0.01)
    assert source.counts.restarts == 0
    av.gone, av.sent = False, [packet(50)]
    (sample,) = [s for s in read(source, 1) if s.sequence is not None]
    assert (sample.sequence, sample.device_ns, source.counts.restarts) == (10, 50_000, 1)
    av.sent = [OSError(19, "No such device")]
    source.close()
    assert av.closed == len(av.opened)


def test_a_clock_that_goes_back_is_a_restart(av: FakeAv) -> None:
    av.sent = [packet(100_000), packet(140_000), packet(20)]
    source = make("/dev/video2")
    source.open()
    assert [s.sequence for s in read(source, 3) if s.sequence is not None] == [0, 1, 2]
    assert source.counts.restarts == 1
    source.close()


def test_a_device_that_is_no_depth_camera(av: FakeAv) -> None:
    av.pixels = "yuyv422"
    with pytest.raises(RecordingError, match="/dev/video2 gives yuyv422 of 64x48") as error:
        make("/dev/video2").open()
    assert str(error.value.hint).startswith("depth has 16 bits: is it the colour?")
    av.pixels = "gray16le"
    with pytest.raises(RecordingError, match="gives gray16le of 64x48") as error:
        make("/dev/video2", width=640, height=480).open()
    assert error.value.hint == "leave out width and height"
    assert av.closed == 2
    assert make("/dev/video2").check() == []
    assert av.closed == 3


def test_what_is_missing_is_named(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """By FFmpeg's own V4L2: no device, a file that is none."""
    with pytest.raises(RecordingError, match="there is no /dev/video999") as error:
        make("/dev/video999").open()
    assert str(error.value.hint).startswith("connect the camera; `v4l2-ctl --list-devices`")
    (line,) = make("/dev/null").check()
    assert line.startswith("/dev/null gives no video: Inappropriate ioctl for device (is it in use")
    monkeypatch.setitem(sys.modules, "av", None)
    with pytest.raises(DependencyError, match="a V4L2 camera needs the Python package av") as missing:
        make("/dev/video0").open()
    assert missing.value.hint == "pip install 'cabinpose[record]'"
    for settings in ({"depth_unit_m": 0.001}, {"lens": LENS}):
        absent = ({"depth_unit_m", "lens"} - set(settings)).pop()
        with pytest.raises(ConfigError, match=f"sources.tof.{absent}: .*required"):
            parse_rig({"sources": {"tof": {"kind": "v4l2", "device": "/dev/video0", **settings}}})
    with pytest.raises(ConfigError, match="a width and a height"):
        make("/dev/video0", width=64)

"""Lab Streaming Layer streams of real outlets on this machine, found by loopback alone."""

from __future__ import annotations

import os
import sys
import time
from collections.abc import Iterator
from functools import partial
from types import ModuleType
from typing import Any

import numpy as np
import pytest
from pydantic import ValidationError
from recorded_things import samples_until
from scipy.spatial.transform import Rotation

from cabinpose.core.errors import DependencyError, RecordingError
from cabinpose.record.sources.lsl import LslSettings, LslSource
from cabinpose.signals.clock import HostClock
from cabinpose.signals.recorded import Channels, Facts, Sample, SegmentPoses

PATIENCE_S = 120.0  # of a busy machine
until = partial(samples_until, patience_s=PATIENCE_S)


@pytest.fixture(scope="module")
def pylsl(tmp_path_factory: pytest.TempPathFactory) -> Iterator[ModuleType]:
    """LSL looks no further than this machine: its library reads the file when it is loaded."""
    config = tmp_path_factory.mktemp("lsl") / "lsl_api.cfg"
    config.write_text("[ports]\nIPv6 = disable\n[multicast]\nResolveScope = machine\n[log]\nlevel = -3\n")
    before = os.environ.get("LSLAPICFG")
    os.environ["LSLAPICFG"] = str(config)
    try:
        module = pytest.importorskip("pylsl")
        module.library_version()
        yield module
    finally:
        if before is None:
            del os.environ["LSLAPICFG"]
        else:
            os.environ["LSLAPICFG"] = before


def outlet(pylsl: ModuleType, name: str, form: str = "double64", labels: tuple[str, ...] = ("x", "y", "y")) -> Any:
    info = pylsl.StreamInfo(name, "Test", len(labels), 100, form, f"id-{name}-{os.getpid()}")
    channels = info.desc().append_child("channels")
    for label in labels:
        channels.append_child("channel").append_child_value("label", label)
    return pylsl.StreamOutlet(info)


def make(name: str, **settings: Any) -> LslSource:
    return LslSource("lab", LslSettings(stream=name, source_id=f"id-{name}-{os.getpid()}", **settings), HostClock())


def numbered(samples: list[Sample]) -> list[Sample]:
    return [s for s in samples if s.sequence is not None]


def facts(samples: list[Sample]) -> dict[str, Any]:
    return {m.about: m.values for s in samples for m in s.messages if isinstance(m, Facts)}


def subscribed(out: Any, pylsl: ModuleType) -> None:
    assert out.wait_for_consumers(PATIENCE_S)


def test_numbers_and_their_time_stamps(pylsl: ModuleType) -> None:
    out = outlet(pylsl, "numbers")
    clock = HostClock()
    source = make("numbers")
    source.open()
    subscribed(out, pylsl)
    stamp = pylsl.local_clock()
    for i in range(50):
        out.push_sample([i, i / 2, np.nan], stamp + i / 100)
    samples = until(source, lambda found: len(numbered(found)) >= 50 and "time_correction" in facts(found))
    source.close()
    found = numbered(samples)
    assert [s.sequence for s in found] == list(range(50))
    for i, sample in enumerate(found):
        assert sample.device_ns == pytest.approx((stamp + i / 100) * 1e9, abs=1000)
        (channels,) = sample.messages
        assert isinstance(channels, Channels)
        assert channels.names == ("x", "y", "y_2")
        np.testing.assert_array_equal(channels.values, [i, i / 2, np.nan])
    about = facts(samples)
    assert about["stream"]["rate_hz"] == 100
    assert about["stream"]["type"] == "Test"
    correction = about["time_correction"]
    assert (
        abs(correction["sender_to_lsl_clock_s"]) < 1
    )  # the same clock, asked over a network whose delay a busy machine makes long
    host_ns = stamp * 1e9 + correction["lsl_clock_to_host_ns"]
    assert abs(host_ns - clock.now_ns()) < 60e9
    assert abs(correction["lsl_clock_to_host_ns"] - (time.time() - pylsl.local_clock()) * 1e9) < 5e9  # of 1e18
    assert (source.counts.received, source.counts.restarts, source.counts.malformed) == (50, 0, 0)


@pytest.mark.parametrize("given", [{}, {"pose_up": "y"}])
def test_a_tracker_gives_poses(pylsl: ModuleType, given: dict[str, Any]) -> None:
    """By labels and stated units; the oracle of the turned world is scipy's."""
    info = pylsl.StreamInfo("tracker", "MoCap", 7, 90, "double64", f"id-tracker-{os.getpid()}")
    channels = info.desc().append_child("channels")
    for label in ("QW", "QX", "QY", "QZ", "X", "Y", "Z"):
        channel = channels.append_child("channel").append_child_value("label", label)
        channel.append_child_value("unit", "millimeters" if len(label) == 1 else "")
    out = pylsl.StreamOutlet(info)
    source = make("tracker", **given)
    source.open()
    subscribed(out, pylsl)
    turn = Rotation.from_euler("xyz", (0.3, -0.5, 1.1))
    x, y, z, w = turn.as_quat()
    out.push_sample([w, x, y, z, 100.0, 200.0, -300.0])
    out.push_sample([0.0, 0.0, 0.0, 0.0, 100.0, 200.0, -300.0])
    found = numbered(until(source, lambda samples: len(numbered(samples)) >= 2))
    source.close()
    whole, lost = (next(m for m in s.messages if isinstance(m, SegmentPoses)) for s in found)
    world = Rotation.from_euler("x", 90 if given else 0, degrees=True)
    assert (whole.subject, whole.names) == ("head", ("head",))
    np.testing.assert_allclose(whole.position_m, [world.apply([0.1, 0.2, -0.3])], atol=1e-12)
    assert (Rotation.from_quat(whole.orientation_wxyz[0], scalar_first=True).inv() * world * turn).magnitude() < 1e-7
    assert np.isnan(lost.position_m).all()
    assert np.isnan(lost.orientation_wxyz).all()


def test_a_pose_that_is_named_has_to_be_there(pylsl: ModuleType) -> None:
    out = outlet(pylsl, "named", labels=("a", "b", "c"))
    source = make("named", pose=("a", "b", "c", "i", "j", "k", "r"))
    with pytest.raises(RecordingError, match="has no channel i, j, k, r"):
        source.open()
    del out


def test_markers_become_facts(pylsl: ModuleType) -> None:
    out = outlet(pylsl, "markers", "string", ("marker",))
    source = make("markers")
    source.open()
    subscribed(out, pylsl)
    for text in ("take begins", "Spur wechselt ←"):
        out.push_sample([text])
    found = numbered(until(source, lambda samples: len(numbered(samples)) >= 2))
    source.close()
    assert [m for s in found for m in s.messages] == [
        Facts("markers", {"marker": "take begins"}),
        Facts("markers", {"marker": "Spur wechselt ←"}),
    ]


def test_a_stream_that_dies_is_found_again(pylsl: ModuleType) -> None:
    out = outlet(pylsl, "mortal")
    source = make("mortal", reconnect_s=0.05)
    source.open()
    subscribed(out, pylsl)
    out.push_sample([1.0, 2.0, 3.0])
    until(source, lambda samples: len(numbered(samples)) == 1)
    del out
    for _ in range(5):
        assert numbered(list(source.read(0.05))) == []
    out = outlet(pylsl, "mortal")
    end = time.monotonic() + PATIENCE_S
    while source.counts.restarts == 0:
        assert time.monotonic() < end
        source.read(0.3)
    subscribed(out, pylsl)
    out.push_sample([4.0, 5.0, 6.0])
    (sample,) = numbered(until(source, lambda samples: len(numbered(samples)) == 1))
    assert sample.sequence == 1
    source.close()
    source.close()


def test_what_is_missing_is_named(pylsl: ModuleType, monkeypatch: pytest.MonkeyPatch) -> None:
    absent = make("absent", resolve_s=0.2)
    began = time.monotonic()
    with pytest.raises(RecordingError, match="no LSL stream of name absent"):
        absent.open()
    assert "no LSL stream" in absent.check()[0]
    assert time.monotonic() - began < PATIENCE_S
    with pytest.raises(RecordingError, match="cannot be named"):
        make("o'clock").open()
    with pytest.raises(RecordingError, match="not open"):
        absent.read(0.0)
    with pytest.raises(ValidationError, match="say which stream"):
        LslSettings()
    monkeypatch.setitem(sys.modules, "pylsl", None)
    with pytest.raises(DependencyError, match="pylsl, which is not installed"):
        make("any").open()

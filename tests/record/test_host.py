"""The facts of the recording computer, from files as Linux has them, and on their way into a recording and out of it."""

from __future__ import annotations

import hashlib
import platform
from pathlib import Path

import pytest

from cabinpose.record.session import host_facts
from cabinpose.store.recording import Recording, RecordingWriter, recover


@pytest.fixture
def interfaces(tmp_path: Path) -> Path:
    folder = tmp_path / "net"
    for name, state, mtu, speed in (
        ("eth0", "up", "9000", "1000"), ("wlan0", "up", "1500", "-1"), ("eth1", "down", "1500", "100"),
        ("tun0", "up", "1400", None),
    ):  # fmt: skip
        (folder / name).mkdir(parents=True)
        (folder / name / "operstate").write_text(state + "\n")
        (folder / name / "mtu").write_text(mtu + "\n")
        if speed is not None:
            (folder / name / "speed").write_text(speed + "\n")
    return folder


def test_what_is_up_is_stated_and_the_computers_name_is_not(tmp_path: Path, interfaces: Path) -> None:
    (tmp_path / "clock").write_text("tsc\n")
    facts = host_facts(tmp_path / "clock", interfaces)
    assert facts == {
        "computer": hashlib.sha256(platform.node().encode()).hexdigest()[:12],
        "kernel": f"{platform.system()} {platform.release()}",
        "clock source": "tsc",
        "network eth0": "MTU 9000, 1000 Mb/s",
        "network wlan0": "MTU 1500",
        "network tun0": "MTU 1400",
    }
    assert set(host_facts(tmp_path / "none", tmp_path / "none")) == {"computer", "kernel"}
    assert host_facts() == host_facts()


def test_a_recording_and_what_is_recovered_of_it_keep_the_facts(tmp_path: Path) -> None:
    facts = {"computer": "c0ffee", "network eth0": "MTU 9000"}
    with RecordingWriter(tmp_path / "a.mcap", host=facts):
        pass
    recover(tmp_path / "a.mcap", tmp_path / "b.mcap")
    for name in ("a.mcap", "b.mcap"):
        with Recording(tmp_path / name) as recording:
            assert recording.head.host == facts
    with RecordingWriter(tmp_path / "c.mcap"):
        pass
    with Recording(tmp_path / "c.mcap") as recording:
        assert recording.head.host == {}

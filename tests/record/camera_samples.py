"""What the tests of cameras ask of sources: the frames among samples, all that a stand-in sends, and that one comes back."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

from cabinpose.signals import Sample, ToFFrame


def frames(samples: Iterable[Sample]) -> list[ToFFrame]:
    return [m for s in samples for m in s.messages if isinstance(m, ToFFrame)]


def drained(source: Any, device: Any) -> list[Sample]:
    """Everything that a stand-in's `sent` holds."""
    samples: list[Sample] = []
    while device.sent:
        samples += source.read(0.001)
    return samples


def check_reached_again(source: Any, devices: list[Any], make: Callable[[str], Any], serial: str, first: Any) -> None:
    """A camera that was pulled out: another one in its place is not taken, and it is once it is back, with its first frame."""
    devices.append(make("9999"))  # another one takes its place, and is not meant
    for _ in range(6):
        assert frames(source.read(0.01)) == []
    assert source.counts.restarts == 0
    again = make(serial)
    devices.append(again)
    for _ in range(100):
        source.read(0.005)
        if again.running:
            break
    assert again.running
    again.sent.append(first)
    (sample,) = [s for s in drained(source, again) if s.sequence is not None]
    assert (sample.sequence, source.counts.restarts, source.counts.lost) == (1, 1, 0)
    assert not devices[0].running
    source.close()


def check_quiet_without_a_camera(module: str, name: str, vendor: str, folder: Path) -> None:
    """The SDK itself, asked for a camera that is not there: one line, whatever it logs on stdout."""
    script = (
        "from cabinpose.signals.clock import HostClock\n"
        f"from cabinpose.record.sources.tof.{module} import {name}Settings, {name}Source\n"
        f"print(*{name}Source('tof', {name}Settings(serial='none of these'), HostClock()).check())"
    )
    done = subprocess.run([sys.executable, "-c", script], cwd=folder, capture_output=True, text=True, check=True)
    assert done.stdout.startswith(f"no {vendor} camera ")
    assert done.stdout.count("\n") == 1

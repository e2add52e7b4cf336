"""Makes the tests' own modules importable."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

from cabinpose.signals.clock import HostClock

sys.path.insert(0, str(Path(__file__).parent))


@pytest.fixture
def quick(monkeypatch: pytest.MonkeyPatch) -> None:
    """`cabinpose record` with a clock that passes only while all its threads wait."""
    from virtual_clock import VirtualClock

    monkeypatch.setattr("cabinpose.signals.clock.HostClock", VirtualClock)  # which the command imports when it runs


@pytest.fixture
def one_clock(monkeypatch: pytest.MonkeyPatch) -> HostClock:
    """One such clock for the sources and emulators of a test that are given none."""
    from virtual_clock import VirtualClock

    clock = VirtualClock()
    for room in ("sources", "emulate"):
        monkeypatch.setattr(f"cabinpose.record.{room}.base.HostClock", lambda: clock)
    return clock

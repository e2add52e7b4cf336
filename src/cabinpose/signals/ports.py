"""The interface of devices, and what they send."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

from cabinpose.signals.recorded import Message


@dataclass(frozen=True, slots=True)
class Sample:
    """One thing that a device sent: the bytes as they came, and what they mean.

    sequence: the source's own count of what was sent, without gaps where nothing was lost, rising, starting anywhere; None
    where the device does not count (or for bytes that are not part of the count) · host_ns: when it arrived, `HostClock` ·
    device_ns: the device's time stamp, its own clock, unwrapped; None where it gives none · raw: a datagram, packet or
    vendor frame as it came, b"" where the vendor's library gives arrays only · messages: decoded; empty for bytes that
    make no whole message yet, or none at all.
    """

    sequence: int | None
    host_ns: int
    device_ns: int | None
    raw: bytes
    messages: tuple[Message, ...] = ()


@dataclass
class Counts:
    """What became of what a device sent, so far. `lost` is known from gaps in the device's own count."""

    received: int = 0
    lost: int = 0
    reordered: int = 0
    duplicate: int = 0
    malformed: int = 0
    restarts: int = 0


class FrameSource(Protocol):
    """A device, or something that plays one. One thread uses it: open, read again and again, close."""

    @property
    def name(self) -> str:
        """What the rig's configuration calls it; the first part of its topics."""

    @property
    def counts(self) -> Counts:
        """What became of what was sent; may be read by other threads."""

    def check(self) -> Sequence[str]:
        """What keeps it from working now, one line each, with the remedy; nothing = ready. Leaves it as it was."""

    def open(self) -> None:
        """Connect. Raises RecordingError with a hint where this fails."""

    def read(self, timeout_s: float) -> Sequence[Sample]:
        """What has arrived, in the order of arrival; waits at most `timeout_s` for the first. Empty = nothing came.

        A device that went away is waited for: `read` tries to reach it again and counts a restart. Raises
        SourceEndedError where nothing will ever come again (a file played to its end).
        """

    def close(self) -> None:
        """Disconnect; harmless if it is not open."""

"""What the emulators share: a thread between start and stop, and lines of a log that say what was sent."""

from __future__ import annotations

import json
import threading
from abc import ABC, abstractmethod
from typing import Any, Self

from cabinpose.signals import HostClock


def log_line(sent: Any) -> str:
    """What became of one thing that an emulator sent (a named tuple), as a line of JSON with its end."""
    return json.dumps(sent._asdict()) + "\n"


class Emulator(ABC):
    """Plays a device in a thread of its own between `start` and `stop`; a context manager."""

    def __init__(self, clock: HostClock | None = None) -> None:
        self._clock = clock or HostClock()
        self._stopping = threading.Event()
        self._thread: threading.Thread | None = None

    def start(self) -> None:
        """Begin. Raises RecordingError where the address is taken, not ours, or refuses."""
        self.open()
        self._stopping.clear()
        self._thread = threading.Thread(target=self._run, name=type(self).__name__, daemon=True)
        self._thread.start()

    def open(self) -> None:  # noqa: B027 - a camera has no address
        """Take the address. Raises RecordingError where it is taken, not ours, or refuses."""

    def join(self, timeout_s: float) -> bool:
        """Wait for the end by itself; whether there is one."""
        return self._thread is None or self._clock.join(self._thread, timeout_s)

    def stop(self) -> None:
        """End; harmless if it does not run."""
        self._stopping.set()
        if self.join(10.0):
            self._thread = None

    def __enter__(self) -> Self:
        self.start()
        return self

    def __exit__(self, *_: object) -> None:
        self.stop()

    @abstractmethod
    def _run(self) -> None:
        """Play until `_stopping` is set."""

"""A serial line, as devices on one are reached: by the name that the system gives it."""

from __future__ import annotations

import os
import select
import termios
import tty
from pathlib import Path

from cabinpose.core import RecordingError


class SerialLine:
    """A serial line in raw mode that does not block. What fails on it raises RecordingError, the line's loss in `lost`'s words.

    lost: what is at its other end, and the hint.
    """

    def __init__(self, port: Path, baud: int, *, lost: tuple[str, str]) -> None:
        self._port, self._baud, self._lost = port, baud, lost
        self._fd = -1

    @property
    def is_open(self) -> bool:
        """From `open` to `close`."""
        return self._fd >= 0

    def open(self) -> None:
        """Raises for a speed that the system does not have, and for what is no serial line or may not be used."""
        speed = getattr(termios, f"B{self._baud}", None)
        if speed is None:
            raise RecordingError(f"no serial line runs at {self._baud} baud here", hint="such as 9600, 115200 or 250000")
        try:
            self._fd = os.open(self._port, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
            tty.setraw(self._fd)
            attributes = termios.tcgetattr(self._fd)
            attributes[2] |= termios.CLOCAL | termios.CREAD
            attributes[4] = attributes[5] = speed
            termios.tcsetattr(self._fd, termios.TCSANOW, attributes)
        except (OSError, termios.error) as error:
            self.close()
            raise RecordingError(
                f"cannot open {self._port} as a serial line ({error.args[-1]})",
                hint="check the name, and that you may use it (dialout)",
            ) from error

    def receive(self, wait_s: float) -> bytes:
        """What has come within `wait_s`, and nothing where nothing has."""
        try:
            if not select.select([self._fd], [], [], wait_s)[0]:
                return b""
            data = os.read(self._fd, 65536)
            if not data:
                raise OSError("end of the line")
        except OSError as error:
            raise self._loss(error) from error
        return data

    def send(self, data: bytes) -> None:
        """Send bytes."""
        try:
            os.write(self._fd, data)
        except OSError as error:
            raise self._loss(error) from error

    def close(self) -> None:
        """Close the line, where it is open."""
        fd, self._fd = self._fd, -1
        if fd >= 0:
            os.close(fd)

    def _loss(self, error: OSError) -> RecordingError:
        what, hint = self._lost
        return RecordingError(f"{self._port}: the line to the {what} is lost ({error.strerror or error})", hint=hint)

"""A serial line, as devices on one are reached: by the name that the system gives it."""

from __future__ import annotations

import os
import termios
import tty
from pathlib import Path

from cabinpose.core import RecordingError


def open_serial_line(port: Path, baud: int) -> int:
    """A serial line in raw mode, as a file descriptor that does not block.

    Raises RecordingError for a speed that the system does not have, and for what is no serial line or may not be used.
    """
    speed = getattr(termios, f"B{baud}", None)
    if speed is None:
        raise RecordingError(f"no serial line runs at {baud} baud here", hint="such as 9600, 115200 or 250000")
    try:
        fd = os.open(port, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
        tty.setraw(fd)
        attributes = termios.tcgetattr(fd)
        attributes[2] |= termios.CLOCAL | termios.CREAD
        attributes[4] = attributes[5] = speed
        termios.tcsetattr(fd, termios.TCSANOW, attributes)
    except (OSError, termios.error) as error:
        raise RecordingError(
            f"cannot open {port} as a serial line ({error.args[-1]})", hint="check the name, and that you may use it (dialout)"
        ) from error
    return fd

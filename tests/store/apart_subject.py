"""What test_apart has done in another process, which has to be able to import it."""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path

from cabinpose.core.errors import MocapError


def lines(path: Path) -> Iterator[tuple[int, str]]:
    for line in path.read_text().splitlines():
        if line == "crash":
            os.abort()
        if line == "spin":
            while True:
                pass
        if line == "swell":
            _ = bytearray(1 << 36)
        if line == "refuse":
            raise MocapError("refused", hint="mend it")
        if line == "fail":
            raise KeyError("a defect")
        yield os.getpid(), line

"""Ctrl-C as a request: the work ends as it should, with its file whole."""

from __future__ import annotations

import signal
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager


@contextmanager
def asked_to_stop(told: str) -> Iterator[Callable[[], bool]]:
    """Whether Ctrl-C was pressed, or the process asked to end, since the block began; a second time `told` is printed."""
    asked = False

    def note(*_: object) -> None:
        nonlocal asked
        if asked:
            print(told, file=sys.stderr)
        asked = True

    before = {kind: signal.signal(kind, note) for kind in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield lambda: asked
    finally:
        for kind, handler in before.items():
            signal.signal(kind, handler)

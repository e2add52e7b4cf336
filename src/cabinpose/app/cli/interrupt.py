"""Ctrl-C as a request, and what asks a process to end as Ctrl-C: the work ends as it should, with its file whole."""

from __future__ import annotations

import os
import signal
import sys
import threading
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager


@contextmanager
def asked_to_stop(told: str) -> Iterator[Callable[[], bool]]:
    """Whether Ctrl-C was pressed, or the process asked to end, since the block began; a second time `told` is printed.

    A process asked to end is one whose terminal was closed as well (SIGHUP), unless that is ignored (nohup).
    """
    asked = False

    def note(*_: object) -> None:
        nonlocal asked
        if asked:
            print(told, file=sys.stderr)
        asked = True

    with _handled((signal.SIGINT, *_ENDS), note):
        yield lambda: asked


class Ended(KeyboardInterrupt):
    """The process was asked to end (SIGTERM)."""


@contextmanager
def interruptions() -> Iterator[None]:
    """SIGTERM is an exception within the block, so that work ends as after Ctrl-C; processes begun within end at once by it."""
    mine = os.getpid()

    def end(*_: object) -> None:
        if os.getpid() != mine:
            signal.signal(signal.SIGTERM, signal.SIG_DFL)
            os.kill(os.getpid(), signal.SIGTERM)
        raise Ended

    if threading.current_thread() is threading.main_thread() and signal.getsignal(signal.SIGTERM) == signal.SIG_DFL:
        with _handled((signal.SIGTERM,), end):
            yield
    else:
        yield


@contextmanager
def interrupted_by_all() -> Iterator[None]:
    """What asks the process to end is a KeyboardInterrupt within the block, as Ctrl-C is."""

    def interrupt(*_: object) -> None:
        raise KeyboardInterrupt

    with _handled(_ENDS, interrupt):
        yield


@contextmanager
def _handled(kinds: Iterable[signal.Signals], handler: Callable[..., None]) -> Iterator[None]:
    """Signals go to a handler within the block, but for those that the process ignores."""
    before = {kind: signal.getsignal(kind) for kind in kinds}
    before = {kind: old for kind, old in before.items() if old is not signal.SIG_IGN}
    for kind in before:
        signal.signal(kind, handler)
    try:
        yield
    finally:
        for kind, old in before.items():
            signal.signal(kind, old)


_ENDS = tuple(getattr(signal, name) for name in ("SIGTERM", "SIGHUP") if hasattr(signal, name))  # Windows has no SIGHUP

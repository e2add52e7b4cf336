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
    """SIGTERM is an exception within the block, as Ctrl-C is, and what a library makes of either is that exception again.

    Processes begun within end at once by SIGTERM.
    """
    mine, asked = os.getpid(), list[type[KeyboardInterrupt]]()

    def end(kind: int, _: object) -> None:
        if kind == signal.SIGTERM and os.getpid() != mine:
            signal.signal(signal.SIGTERM, signal.SIG_DFL)
            os.kill(os.getpid(), signal.SIGTERM)
        asked.append(Ended if kind == signal.SIGTERM else KeyboardInterrupt)
        raise asked[-1]

    usual = {signal.SIGINT: signal.default_int_handler, signal.SIGTERM: signal.SIG_DFL}
    main = threading.current_thread() is threading.main_thread()
    with _handled([kind for kind, handler in usual.items() if main and signal.getsignal(kind) == handler], end):
        try:
            yield
        except Exception as error:
            if asked:  # as an extension module that is interrupted while it is loaded
                raise asked[-1] from error
            raise


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

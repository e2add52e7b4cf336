"""Running libraries that may crash on a damaged file in a process of their own.

Compiled readers trust what a file says of itself: a wrong size can end the process, or take all memory. What they find is handed
over piece by piece, and a crash becomes an error like others. What they tell a log of damage that they went past becomes one
warning.
"""

from __future__ import annotations

import faulthandler
import logging
import multiprocessing
import os
import sys
import threading
import warnings
from collections.abc import Callable, Iterable, Iterator
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any, TypeVar

from cabinpose.core import CabinposeError

T = TypeVar("T")

_AT_ONCE = 64  # items handed over together
_SILENCE_S = 600.0  # a library that finds nothing for so long hangs
_ROOM_BYTES = 1 << 30  # of memory, beyond what this process has and what the file's size asks for
_ROOM_PER_BYTE = 40  # of the file: ezc3d keeps an object of 200 bytes for each point of 16
_PROCESSOR_S = 10
_MOST_SAID = 200  # characters of what a library says
_SLOWEST_BYTES_PER_S = 250_000  # with the making of messages


class CrashedError(Exception):
    """The process ended without a result, or hung; the message says how."""


def items_apart(make: Callable[..., Iterable[T]], path: Path) -> Iterator[T]:
    """The items of `make(path)`, made in another process.

    On Linux, that process may take 1 GB and 40 times the file's size more than this one has, and processor time by that size.

    Parameters
    ----------
    make
        What makes the items, which have to be picklable.
    path
        The file.

    Warns
    -----
    UserWarning
        Where the library told a log of something wrong: how often, and what came first.

    Raises
    ------
    CabinposeError
        The one that `make` raises, after the items before it.
    RuntimeError
        For any other error of `make`.
    CrashedError
        Where the process dies, takes too much, or finds nothing for ten minutes.
    """
    alone = threading.active_count() == 1 and sys.platform.startswith("linux")
    context: Any = multiprocessing.get_context("fork" if alone else "spawn")  # forking is quick, and safe without threads
    receiver, sender = context.Pipe(duplex=False)
    process = context.Process(target=_serve, args=(sender, make, path, _PROCESSOR_S), daemon=True)
    process.start()
    sender.close()
    try:
        while True:
            if not receiver.poll(_SILENCE_S):
                raise CrashedError(f"nothing was found for {_SILENCE_S:.0f} s")
            try:
                items, error, ended, said = receiver.recv()
            except EOFError:
                process.join()
                raise CrashedError(f"the reader's process ended with {process.exitcode}") from None
            yield from items
            if said:
                told = f"{path} is damaged, and what could not be read is left out ({len(said)} times); first: {said[0]}"
                warnings.warn(told, stacklevel=2)
            if error is not None:
                raise error
            if ended:
                return
    finally:
        receiver.close()
        if process.is_alive():
            process.kill()
        process.join()


def _serve(sender: Connection, make: Callable[..., Iterable[Any]], path: Path, processor_s: int) -> None:
    faulthandler.disable()  # a crash is told by the exit code, and the last words of the C library help nobody
    os.dup2(os.open(os.devnull, os.O_WRONLY), 2)
    _limit(path, processor_s)
    items: list[Any] = []
    error: Exception | None = None
    said = _Said()
    logging.root.handlers = [said]
    logging.root.setLevel(logging.WARNING)
    warnings.simplefilter("ignore")  # of arithmetic with damaged numbers
    try:
        for item in make(path):
            items.append(item)
            if len(items) >= _AT_ONCE:
                sender.send((items, None, False, ()))
                items = []
    except CabinposeError as problem:
        error = problem
    except Exception as problem:  # noqa: BLE001 - the library's own kinds of errors may not go through a pipe
        error = RuntimeError(f"{type(problem).__name__}: {problem}")
    sender.send((items, error, True, said.lines))


class _Said(logging.Handler):
    """Keeps the first line of what libraries log."""

    def __init__(self) -> None:
        super().__init__(logging.WARNING)
        self.lines: list[str] = []

    def emit(self, record: logging.LogRecord) -> None:
        """Keep a record, without its traceback."""
        self.lines.append(next(iter(record.getMessage().splitlines()), "")[:_MOST_SAID])


def _limit(path: Path, processor_s: int) -> None:
    """Bound this process' memory, and its processor time beyond what the file's size asks for."""
    if not sys.platform.startswith("linux"):
        return
    import resource  # noqa: PLC0415 - not there on Windows

    pages = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[0])
    used = resource.getrusage(resource.RUSAGE_SELF)  # what importing took, in a process that did not begin as a copy
    size = path.stat().st_size
    seconds = int(used.ru_utime + used.ru_stime) + processor_s + int(size / _SLOWEST_BYTES_PER_S)
    room = pages * resource.getpagesize() + _ROOM_BYTES + _ROOM_PER_BYTE * size
    for kind, wanted in ((resource.RLIMIT_AS, room), (resource.RLIMIT_CPU, seconds)):
        _, hard = resource.getrlimit(kind)
        resource.setrlimit(kind, (wanted if hard < 0 else min(wanted, hard), hard))

"""Results that are worked out once, however many threads ask for them."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable, Hashable
from concurrent.futures import Future
from functools import wraps
from threading import Lock
from typing import TypeVar, TypeVarTuple, Unpack

R = TypeVar("R")
Args = TypeVarTuple("Args")


def cached_once(maxsize: int) -> Callable[[Callable[[Unpack[Args]], R]], Callable[[Unpack[Args]], R]]:
    """`functools.lru_cache` for work of seconds: of threads that ask for the same at once, one works and the others wait.

    maxsize: results kept, those used last. The arguments are positional and hashable. An exception is raised to everybody who
    waits, and not kept.
    """

    def decorate(function: Callable[[Unpack[Args]], R]) -> Callable[[Unpack[Args]], R]:
        known: OrderedDict[Hashable, Future[R]] = OrderedDict()
        lock = Lock()

        @wraps(function)
        def remembered(*args: *Args) -> R:
            with lock:
                result = known.get(args)
                mine = result is None
                if result is None:
                    result = known[args] = Future()
                known.move_to_end(args)
                while len(known) > maxsize:
                    known.popitem(last=False)
            if mine:
                try:
                    result.set_result(function(*args))
                except BaseException as error:
                    with lock:
                        if known.get(args) is result:
                            del known[args]
                    result.set_exception(error)
                    raise
            return result.result()

        return remembered

    return decorate

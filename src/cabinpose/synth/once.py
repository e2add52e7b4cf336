"""Results that are worked out once, however many threads ask for them."""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache, wraps
from threading import Lock
from typing import TypeVar, TypeVarTuple, Unpack

R = TypeVar("R")
Args = TypeVarTuple("Args")


def cached_once(maxsize: int) -> Callable[[Callable[[Unpack[Args]], R]], Callable[[Unpack[Args]], R]]:
    """`functools.lru_cache` for work of seconds: of threads that ask for the same at once, one works and the others wait.

    Parameters
    ----------
    maxsize
        How many results are kept: those that were used last.

    Returns
    -------
    Callable
        A decorator of functions of positional, hashable arguments. An exception is not kept: who asks next tries again.
    """

    def decorate(function: Callable[[Unpack[Args]], R]) -> Callable[[Unpack[Args]], R]:
        lock = Lock()

        @lru_cache(maxsize)
        def kept(*args: *Args) -> tuple[Lock, list[R]]:  # noqa: ARG001 - what they stand for is kept
            return Lock(), []

        @wraps(function)
        def remembered(*args: *Args) -> R:
            with lock:  # lru_cache may call its function twice for one key where threads meet
                busy, result = kept(*args)
            with busy:
                if not result:
                    result.append(function(*args))
                return result[0]

        return remembered

    return decorate

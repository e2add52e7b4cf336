"""Results that are worked out once: whatever asks for them, or as long as what they are of is there."""

from __future__ import annotations

from collections.abc import Callable, Hashable
from functools import lru_cache, wraps
from threading import Lock
from typing import Any, TypeVar, TypeVarTuple, Unpack
from weakref import WeakKeyDictionary

R = TypeVar("R")
Owner = TypeVar("Owner")
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


def kept_with(
    most: int, key: Callable[[Any], Any] | None = None
) -> Callable[[Callable[[Owner, Unpack[Args]], R]], Callable[[Owner, Unpack[Args]], R]]:
    """A cache of functions of an object that is released together with it: the object is held by a weak reference only.

    Parameters
    ----------
    most
        How many results are kept for one object: those that were made last.
    key
        What stands for the object, and can be weakly referred to; by default the object itself.

    Returns
    -------
    Callable
        A decorator of functions of the object and hashable positional arguments, whose results do not refer to it.
    """

    def decorate(function: Callable[[Owner, Unpack[Args]], R]) -> Callable[[Owner, Unpack[Args]], R]:
        known: WeakKeyDictionary[Any, dict[Hashable, R]] = WeakKeyDictionary()
        lock = Lock()

        @wraps(function)
        def remembered(owner: Owner, *args: *Args) -> R:
            with lock:
                mine = known.setdefault(owner if key is None else key(owner), {})
                if args in mine:
                    return mine[args]
            result = function(owner, *args)  # two threads may both come here: the results are equal
            with lock:
                mine[args] = result
                while len(mine) > most:
                    del mine[next(iter(mine))]
            return result

        return remembered

    return decorate

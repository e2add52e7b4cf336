"""What is known of a person, kept as long as the person is."""

from __future__ import annotations

from collections.abc import Callable, Hashable
from functools import wraps
from threading import Lock
from typing import TypeVar, TypeVarTuple, Unpack
from weakref import WeakKeyDictionary

from cabinpose.scene.body import Person

R = TypeVar("R")
Args = TypeVarTuple("Args")
_MOST = 96  # results kept of one function for one person: fits at ten reclines in each of seven cars' seats


def kept_with_person(function: Callable[[Person, Unpack[Args]], R]) -> Callable[[Person, Unpack[Args]], R]:
    """A function of a person and hashable positional arguments that is worked out once, and forgotten with the person.

    Unlike an `lru_cache` it keeps nobody alive: random people come and go by the thousand. What it returns must not hold
    the person either.
    """
    known: WeakKeyDictionary[Person, dict[Hashable, R]] = WeakKeyDictionary()
    lock = Lock()

    @wraps(function)
    def remembered(person: Person, *args: *Args) -> R:
        with lock:
            mine = known.setdefault(person, {})
            if args in mine:
                return mine[args]
        result = function(person, *args)  # two threads may both come here: the results are equal
        with lock:
            mine[args] = result
            while len(mine) > _MOST:
                del mine[next(iter(mine))]
        return result

    return remembered

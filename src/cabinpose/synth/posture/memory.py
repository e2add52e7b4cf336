"""A cache of functions of a person that is released together with the person."""

from __future__ import annotations

from collections.abc import Callable, Hashable
from functools import wraps
from threading import Lock
from typing import TypeVar, TypeVarTuple, Unpack
from weakref import WeakKeyDictionary

from cabinpose.scene.body import Build, Person

R = TypeVar("R")
Args = TypeVarTuple("Args")
_MOST = 96  # results kept of one function for one person: fits at ten reclines in each of seven cars' seats


def kept_with_person(function: Callable[[Person, Unpack[Args]], R]) -> Callable[[Person, Unpack[Args]], R]:
    """Decorator: cache the results of a function of a person and hashable positional arguments.

    Unlike `lru_cache` it holds the person by a weak reference only, so that the thousands of random people of a large dataset
    can be freed. The results must not refer to the person either. All outfits of a person with the same soles share them.
    """
    known: WeakKeyDictionary[Build, dict[Hashable, R]] = WeakKeyDictionary()
    lock = Lock()

    @wraps(function)
    def remembered(person: Person, *args: *Args) -> R:
        with lock:
            mine = known.setdefault(person.build, {})
            if args in mine:
                return mine[args]
        result = function(person, *args)  # two threads may both come here: the results are equal
        with lock:
            mine[args] = result
            while len(mine) > _MOST:
                del mine[next(iter(mine))]
        return result

    return remembered

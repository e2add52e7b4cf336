"""A cache of functions of a person that is released together with the person."""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeVar, TypeVarTuple, Unpack

from cabinpose.scene.body import Person
from cabinpose.synth.once import kept_with

R = TypeVar("R")
Args = TypeVarTuple("Args")
_MOST = 96  # results kept of one function for one person: fits at ten reclines in each of seven cars' seats


def kept_with_person(function: Callable[[Person, Unpack[Args]], R]) -> Callable[[Person, Unpack[Args]], R]:
    """Decorator: cache the results of a function of a person and hashable positional arguments, which do not refer to the person.

    The thousands of random people of a large dataset can be freed. All outfits of a person with the same soles share the results.
    """
    return kept_with(_MOST, _build)(function)


def _build(person: Person) -> object:
    return person.build

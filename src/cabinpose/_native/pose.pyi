"""Made by tools/make_stubs.py from the extension."""

from collections.abc import Sequence
from typing import Annotated

import numpy
from numpy.typing import NDArray

def solve_people(
    people: Sequence[tuple[object, ...]],
    car: Sequence[tuple[object, ...]],
    pairs: tuple[object, ...],
    between: float,
    free: bool,
    missed: Sequence[Annotated[NDArray[numpy.float64], dict(shape=(None, 2), order="C", device="cpu")]],
) -> list[tuple[int, int, int, float]]:
    """
    Poses of people in a car; what is left of each: its kind, a solid, the other solid or group, and the excess.
    """

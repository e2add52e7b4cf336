"""The cars that the tests of this folder hold: every preset, and a few drawn at random."""

from __future__ import annotations

import numpy as np

from cabinpose.scene.cabin import PRESET_DIMENSIONS, CabinDimensions, random_dimensions


def random_car(seed: int) -> CabinDimensions:
    """A random car, named C and the seed."""
    return random_dimensions(f"C{seed:04d}", rng=np.random.Generator(np.random.Philox(seed)))


RANDOM = {car.name: car for car in map(random_car, range(6))}
DIMENSIONS = {**PRESET_DIMENSIONS, **RANDOM}

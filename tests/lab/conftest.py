"""One driver in one car for all tests of the laboratory's person: preparing them takes seconds."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest

from cabinpose.app.lab.motion import KeyedMotion, Stage, act, calibrate_head, in_seat
from cabinpose.app.lab.optical import cap_of
from cabinpose.app.lab.suit import put_on
from cabinpose.app.lab.takes import Actor

sys.path.insert(0, str(Path(__file__).parent))


def generator(seed: int) -> np.random.Generator:
    return np.random.Generator(np.random.Philox(seed))


@pytest.fixture(scope="session")
def stage() -> Stage:
    return in_seat("sedan", "S01", rng=generator(1))


@pytest.fixture(scope="session")
def driving(stage: Stage) -> KeyedMotion:
    return act(stage, 5.0, rng=generator(2))


@pytest.fixture(scope="session")
def nodding(stage: Stage) -> KeyedMotion:
    return calibrate_head(stage, rng=generator(3))


@pytest.fixture(scope="session")
def actor(stage: Stage) -> Actor:
    return Actor(stage, put_on(rng=generator(4)), cap_of(stage.person))

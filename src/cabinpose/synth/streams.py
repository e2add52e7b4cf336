"""Where the random numbers of a dataset come from: a seed, and a stream of it for each frame."""

from __future__ import annotations

import zlib
from collections.abc import Mapping
from typing import TypeVar

import numpy as np

from cabinpose.core import ConfigError

Name = TypeVar("Name")
# Streams of the seed that belong to no frame: the keys count down from the top, frames count up from zero.
PEOPLE_STREAM = 2**64 - 1
CAR_STREAM = 2**63 + 2**62
_ROOM_STREAM = 2**63
ORDER_STREAM = 2**62
CHILD_STREAM = 2**61


def check_seed(seed: int) -> None:
    """Raises ConfigError for what cannot be a dataset's seed."""
    if not 0 <= seed < 2**63:
        raise ConfigError(f"seed {seed} is not a 63-bit natural number", hint="choose a seed from 0 to 2**63 - 1")


def frame_rng(seed: int, frame_index: int) -> np.random.Generator:
    """The generator of one frame's scene: the same numbers whatever made the frame, and when."""
    return np.random.Generator(np.random.Philox(key=np.array((seed, frame_index), dtype=np.uint64)))


def noise_rng(seed: int, frame_index: int) -> np.random.Generator:
    """The generator of one frame's noise: the same key with a counter that no scene's draws reach.

    So a scene that is given exactly, instead of drawn, has the same noise.
    """
    return np.random.Generator(np.random.Philox(key=np.array((seed, frame_index), dtype=np.uint64), counter=(0, 0, 0, 1)))


def sequence_rng(seed: int, first_frame: int, stream: int) -> np.random.Generator:
    """A generator of a sequence: the key of its first frame, with a counter that neither scene, noise nor looks reach."""
    return np.random.Generator(np.random.Philox(key=np.array((seed, first_frame), dtype=np.uint64), counter=(0, 0, stream, 3)))


def room_rng(seed: int, number: int) -> np.random.Generator:
    """What the room of this number in the dataset of this seed is drawn with."""
    return frame_rng(seed, _ROOM_STREAM + number)


def own_rng(seed: int, name: str) -> np.random.Generator:
    """The generator of somebody's or something's looks, the same in all frames of a dataset."""
    key = np.array((seed, zlib.crc32(name.encode())), dtype=np.uint64)
    return np.random.Generator(np.random.Philox(key=key, counter=(0, 0, 0, 2)))


def face_rng(seed: int, frame_index: int, slot: str) -> np.random.Generator:
    """The generator of what somebody's face does in a frame, or in the sequence that begins with it."""
    key = np.array((seed, frame_index), dtype=np.uint64)
    return np.random.Generator(np.random.Philox(key=key, counter=(0, 0, zlib.crc32(slot.encode()), 4)))


def sun_rng(seed: int, frame_index: int) -> np.random.Generator:
    """The generator of where the sun stands in a frame, or in the sequence that begins with it."""
    return np.random.Generator(np.random.Philox(key=np.array((seed, frame_index), dtype=np.uint64), counter=(0, 0, 0, 5)))


def light_rng(seed: int, frame_index: int) -> np.random.Generator:
    """The generator of what lights the pictures of a frame, or of the sequence that begins with it."""
    return np.random.Generator(np.random.Philox(key=np.array((seed, frame_index), dtype=np.uint64), counter=(0, 0, 0, 7)))


def clutter_rng(seed: int, frame_index: int) -> np.random.Generator:
    """The generator of what lies about in a frame: the key of its scene with a counter that nothing else of it reaches."""
    return np.random.Generator(np.random.Philox(key=np.array((seed, frame_index), dtype=np.uint64), counter=(0, 0, 0, 6)))


def weighted(weights: Mapping[Name, float], *, rng: np.random.Generator) -> Name:
    """A name drawn by weight."""
    names = list(weights)
    p = np.array([weights[name] for name in names], dtype=np.float64)
    return names[int(rng.choice(len(names), p=p / p.sum()))]

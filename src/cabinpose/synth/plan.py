"""Which cars, people and rooms a frame of a dataset draws from: a function of the configuration, the seed and the frame's number.

Bodies and cars take time and memory to make. Where a dataset has many, frames draw from a small set of them: at a fixed number of
frames one is exchanged for the next, so that each is made once and all are used equally often (decision 0009).
"""

from __future__ import annotations

from collections.abc import Callable, Collection
from typing import NamedTuple

import numpy as np

from cabinpose.core import DriveSide
from cabinpose.scene import Room, furnish_room
from cabinpose.synth.cabins import Cabins
from cabinpose.synth.cars import is_random_car
from cabinpose.synth.config import CabinScene, SynthConfig
from cabinpose.synth.once import cached_once
from cabinpose.synth.streams import CAR_STREAM, ORDER_STREAM, frame_rng, room_rng
from cabinpose.synth.subjects import Subjects

_ROUNDS = 2**32  # of a kind of thing, a stream each
PEOPLE_IN_PLAY, CARS_IN_PLAY = 24, 8
_FRAMES_A_PERSON, _FRAMES_A_CAR = 6, 50  # until one leaves


class Cell(NamedTuple):
    """One combination of a factorial dataset."""

    car: str
    subject: str
    view: str


class Plan:
    """Who and what the frames of one dataset draw from: its people, cars and rooms, and which of them are in play."""

    def __init__(self, config: SynthConfig, seed: int, *, like: Plan | None = None) -> None:
        """like: that of a dataset whose people, cars and rooms are taken over as far as the configuration makes the same ones."""
        self._config, self.seed = config, seed
        self._names = config.people.names
        self.subjects: Subjects = Subjects(config.people, seed, like=None if like is None else like.subjects)
        self.cabins: Cabins = Cabins(config.scene, seed, like=None if like is None else like.cabins)
        self.room: Callable[[int], Room] = cached_once(64)(self._make_room)
        if like is not None and like.seed == seed:
            self.room = like.room
        self._order = cached_once(4)(self._make_order)

    def cell(self, index: int) -> Cell | None:
        """What frame `index` of a factorial dataset combines; None in one that is drawn at random."""
        scene = self._config.scene
        if not isinstance(scene, CabinScene) or scene.factorial is None:
            return None
        views = tuple(self._config.camera.weights)
        rest, view = divmod(index // scene.factorial.poses, len(views))
        car, subject = divmod(rest, len(self._names))
        return Cell(self.cabins.names[car], self._names[subject], views[view])

    def car(self, index: int, *, rng: np.random.Generator) -> tuple[str, DriveSide]:
        """The car of frame `index`, and where its wheel is: one and the same side in all frames of a random car."""
        scene = self._config.scene
        assert isinstance(scene, CabinScene)
        cell = self.cell(index)
        among = self._in_play(0, len(self.cabins.names), CARS_IN_PLAY, _FRAMES_A_CAR, index)
        car = self.cabins.names[among[int(rng.integers(len(among)))]] if cell is None else cell.car
        chance = rng.random()
        if is_random_car(car):
            chance = frame_rng(self.seed, CAR_STREAM - 1 - int(car[1:])).random()
        return car, "right" if chance < scene.right_hand_drive else "left"

    def people(self, index: int, count: int, *, without: Collection[str] = (), rng: np.random.Generator) -> list[str]:
        """So many people of frame `index`: different ones and none of those `without`, as long as there are enough."""
        among = [name for name in self._people_in_play(index) if name not in without] or self._people_in_play(index)
        return [among[i] for i in rng.choice(len(among), size=count, replace=count > len(among))]

    def driver_first(self, index: int, names: list[str], *, without: Collection[str] = (), rng: np.random.Generator) -> list[str]:
        """The same people, the first of whom is old enough to drive; where nobody is, somebody in play takes the first place."""
        old = [name for name in names if self.subjects.drives(name)]
        if not old:
            others = [name for name in self._people_in_play(index) if self.subjects.drives(name) and name not in without]
            return [others[int(rng.integers(len(others)))], *names[1:]] if others else names
        result = list(names)
        at = result.index(old[0])
        result[0], result[at] = result[at], result[0]
        return result

    def outfit(self, index: int, name: str) -> int:
        """The number of the outfit that somebody wears in frame `index`: the same for a round of many people."""
        many = len(self._names) > PEOPLE_IN_PLAY
        return self.subjects.worn(name, index, every=_FRAMES_A_PERSON * len(self._names) if many else 1)

    def _make_room(self, number: int) -> Room:
        return furnish_room(rng=room_rng(self.seed, number))

    def _people_in_play(self, index: int) -> list[str]:
        return [self._names[i] for i in self._in_play(1, len(self._names), PEOPLE_IN_PLAY, _FRAMES_A_PERSON, index)]

    def _in_play(self, kind: int, count: int, most: int, frames: int, index: int) -> list[int]:
        """Numbers below `count` that frame `index` draws from: all, or `most` of them, of which one leaves every few frames."""
        if count <= most:
            return list(range(count))
        turns = range(index // frames, index // frames + most)
        return list(dict.fromkeys(self._order(kind, count, turn // count)[turn % count] for turn in turns))

    def _make_order(self, kind: int, count: int, round_number: int) -> list[int]:
        return frame_rng(self.seed, ORDER_STREAM + kind * _ROUNDS + round_number).permutation(count).tolist()

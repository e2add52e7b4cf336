"""Which cars, people and rooms a frame of a dataset draws from: a function of the configuration, the seed and the frame's number.

Bodies and cars take time and memory to make. Where a dataset has many, frames draw from a small set of them: at a fixed number of
frames one is exchanged for the next, so that each is made once and all are used equally often (decision 0009).
"""

from __future__ import annotations

from collections.abc import Collection
from contextlib import suppress
from dataclasses import replace
from typing import Literal, NamedTuple

import numpy as np

from cabinpose.core import OCCUPANT_SLOTS, STANDING_SLOT, ConfigError, unknown_name
from cabinpose.scene.body import SUBJECTS, YEARS_LIMITS, BodyModel, Outfit, Phenotype, age_of, usual_stature_m
from cabinpose.scene.cabin import CabinDimensions, random_dimensions
from cabinpose.synth.cars import ChangedPreset, is_random_car
from cabinpose.synth.config import CabinScene, RoomScene, SynthConfig
from cabinpose.synth.once import cached_once
from cabinpose.synth.people import CHILD_NAME, OwnPerson
from cabinpose.synth.streams import frame_rng, own_rng

DriveSide = Literal["left", "right"]
# Streams of the seed that belong to no frame: the keys count down from the top, frames count up from zero.
_PEOPLE_STREAM = 2**64 - 1
_CAR_STREAM = 2**63 + 2**62
_ROOM_STREAM = 2**63
_ORDER_STREAM = 2**62
_CHILD_STREAM = 2**61
CHILDREN, _CHILD_YEARS = 24, (3.0, 11.5)  # for child seats, of evenly spread ages
_ROUNDS = 2**32  # of a kind of thing, a stream each
PEOPLE_IN_PLAY, CARS_IN_PLAY = 24, 8
_FRAMES_A_PERSON, _FRAMES_A_CAR = 6, 50  # until one leaves
_MUSCLES = (0.3, 0.2, 0.1, 0.0)  # of own people, the first with which a body can have the mass: heavy ones have less
_WEIGHT = 0.65  # of own people; about the average of S01 .. S18


def person_slots(config: SynthConfig) -> tuple[str, ...]:
    """The entries of the dataset's `person` coordinate."""
    return (STANDING_SLOT,) if config.scene.kind == "room" else OCCUPANT_SLOTS


def brings_things(config: SynthConfig) -> bool:
    """Whether frames may show child seats and objects, so that the dataset says which."""
    return isinstance(config.scene, CabinScene) and config.scene.brings_things


def subject_body(config: SynthConfig, seed: int, subject: str) -> tuple[Phenotype, Outfit]:
    """Shape and clothes of a person of this dataset; a function of the arguments alone, whatever was drawn before."""
    phenotype, outfit = _symmetric_body(config, seed, subject)
    if config.people.asymmetric:  # whoever has a name is the same in all datasets
        named = subject in SUBJECTS or subject in config.people.own
        phenotype = replace(phenotype, asymmetry=int(own_rng(0 if named else seed, subject).integers(1, 1 << 31)))
    return phenotype, outfit


def _symmetric_body(config: SynthConfig, seed: int, subject: str) -> tuple[Phenotype, Outfit]:
    if subject in SUBJECTS:
        return SUBJECTS[subject].phenotype, SUBJECTS[subject].outfit
    if subject in config.people.own:
        try:
            return _own_body(config.people.own[subject])
        except ConfigError as error:
            raise ConfigError(f"{subject}: {error}", hint=error.hint) from None
    if child := CHILD_NAME.fullmatch(subject):
        rng = frame_rng(seed, _CHILD_STREAM + int(child[1]))
        years = np.interp(int(child[1]) + rng.random(), (0, CHILDREN), _CHILD_YEARS)
        body, outfit = Phenotype.random({"years": (years, years)}, rng=rng), Outfit.random(rng=rng)
        return body, replace(outfit, beard=False, hair="short" if outfit.hair == "bald" else outfit.hair)
    crowd = config.people.random
    if crowd is None or not subject.startswith("R"):
        raise unknown_name("subject", subject, config.people.names)
    rng = frame_rng(seed, _PEOPLE_STREAM - int(subject[1:]))
    phenotype = Phenotype.random({name: (r.min, r.max) for name, r in crowd.ranges.items()}, rng=rng)
    return phenotype, Outfit.random(rng=rng)


def drives(config: SynthConfig, seed: int, subject: str) -> bool:
    """Whether somebody is old enough to drive in this dataset."""
    least = config.people.driver_years
    return least <= YEARS_LIMITS[0] or subject_body(config, seed, subject)[0].years >= least


def _own_body(own: OwnPerson) -> tuple[Phenotype, Outfit]:
    """Raises ConfigError where no body has the mass."""
    gender = {"male": 0.0, "female": 1.0}.get(own.gender, 0.5) if isinstance(own.gender, str) else own.gender
    age = age_of(own.years)
    stature = own.stature_cm / 100.0 if own.stature_cm is not None else usual_stature_m(gender, age)[0]
    muscles = _MUSCLES if own.muscle is None else (own.muscle,)
    weight = _WEIGHT if own.weight is None else own.weight
    body = Phenotype(gender, age, muscles[0], weight, own.height, own.proportions, stature)
    if own.mass_kg is None:
        return body, own.outfit
    for muscle in muscles[:-1]:
        with suppress(ConfigError):
            return BodyModel.load().with_mass(replace(body, muscle=muscle), own.mass_kg), own.outfit
    return BodyModel.load().with_mass(replace(body, muscle=muscles[-1]), own.mass_kg), own.outfit


def car_names(config: SynthConfig) -> tuple[str, ...]:
    """Every car of a dataset, those that its configuration names first; none in a room. Own meshes go by their paths."""
    scene = config.scene
    if not isinstance(scene, CabinScene):
        return ()
    named = tuple(car.name if isinstance(car, ChangedPreset) else car for car in scene.cars)
    return (*named, *(car for i in range(scene.random_cars) if (car := f"C{i:04d}") not in named))


def car_dimensions(seed: int, car: str) -> CabinDimensions:
    """The dimensions of a random car, "C0000" ..., of the dataset of this seed, whatever was drawn before."""
    return random_dimensions(car, rng=frame_rng(seed, _CAR_STREAM + int(car[1:])))


class Cell(NamedTuple):
    """One combination of a factorial dataset."""

    car: str
    subject: str
    view: str


class Plan:
    """Who and what the frames of one dataset draw from."""

    def __init__(self, config: SynthConfig, seed: int) -> None:
        self._config = config
        self._seed = seed
        self._subjects = config.people.names
        self.cars = car_names(config)
        self._order = cached_once(4)(self._make_order)
        self._drives = cached_once(1024)(self._old_enough)

    def cell(self, index: int) -> Cell | None:
        """What frame `index` of a factorial dataset combines; None in one that is drawn at random."""
        scene = self._config.scene
        if not isinstance(scene, CabinScene) or scene.factorial is None:
            return None
        views = tuple(self._config.camera.weights)
        rest, view = divmod(index // scene.factorial.poses, len(views))
        car, subject = divmod(rest, len(self._subjects))
        return Cell(self.cars[car], self._subjects[subject], views[view])

    def car(self, index: int, *, rng: np.random.Generator) -> tuple[str, DriveSide]:
        """The car of frame `index`, and where its wheel is: one and the same side in all frames of a random car."""
        scene = self._config.scene
        assert isinstance(scene, CabinScene)
        cell = self.cell(index)
        among = self._in_play(0, len(self.cars), CARS_IN_PLAY, _FRAMES_A_CAR, index)
        car = self.cars[among[int(rng.integers(len(among)))]] if cell is None else cell.car
        chance = rng.random()
        if is_random_car(car):
            chance = frame_rng(self._seed, _CAR_STREAM - 1 - int(car[1:])).random()
        return car, "right" if chance < scene.right_hand_drive else "left"

    def people(self, index: int, count: int, *, without: Collection[str] = (), rng: np.random.Generator) -> list[str]:
        """So many people of frame `index`: different ones and none of those `without`, as long as there are enough."""
        among = [name for name in self._people_in_play(index) if name not in without] or self._people_in_play(index)
        return [among[i] for i in rng.choice(len(among), size=count, replace=count > len(among))]

    def children(self, stature_m: tuple[float, float]) -> list[str]:
        """The children of a dataset whose stature is in a range, m."""
        names = (f"K{number:02d}" for number in range(CHILDREN))
        statures = {name: subject_body(self._config, self._seed, name)[0].stature_m or 0.0 for name in names}
        return [name for name, stature in statures.items() if stature_m[0] <= stature <= stature_m[1]]

    def driver_first(self, index: int, names: list[str], *, without: Collection[str] = (), rng: np.random.Generator) -> list[str]:
        """The same people, the first of whom is old enough to drive; where nobody is, somebody in play takes the first place."""
        old = [name for name in names if self._drives(name)]
        if not old:
            others = [name for name in self._people_in_play(index) if self._drives(name) and name not in without]
            return [others[int(rng.integers(len(others)))], *names[1:]] if others else names
        result = list(names)
        at = result.index(old[0])
        result[0], result[at] = result[at], result[0]
        return result

    def _old_enough(self, name: str) -> bool:
        return drives(self._config, self._seed, name)

    def room(self, *, rng: np.random.Generator) -> int:
        """The number of a frame's room."""
        scene = self._config.scene
        assert isinstance(scene, RoomScene)
        return int(rng.integers(scene.rooms))

    def _people_in_play(self, index: int) -> list[str]:
        return [self._subjects[i] for i in self._in_play(1, len(self._subjects), PEOPLE_IN_PLAY, _FRAMES_A_PERSON, index)]

    def _in_play(self, kind: int, count: int, most: int, frames: int, index: int) -> list[int]:
        """Numbers below `count` that frame `index` draws from: all, or `most` of them, of which one leaves every few frames."""
        if count <= most:
            return list(range(count))
        turns = range(index // frames, index // frames + most)
        return list(dict.fromkeys(self._order(kind, count, turn // count)[turn % count] for turn in turns))

    def _make_order(self, kind: int, count: int, round_number: int) -> list[int]:
        return frame_rng(self._seed, _ORDER_STREAM + kind * _ROUNDS + round_number).permutation(count).tolist()


def room_rng(seed: int, number: int) -> np.random.Generator:
    """What the room of this number in the dataset of this seed is drawn with."""
    return frame_rng(seed, _ROOM_STREAM + number)

"""Who sits in which car: the cast of a scene."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from cabinpose.core import OCCUPANT_SLOTS
from cabinpose.scene.body import DOFS, SUBJECTS, BodyModel, Person, PosedBody
from cabinpose.scene.cabin import PRESETS, Cabin, CabinDimensions, SeatSetting
from cabinpose.scene.things import VARIANTS
from cabinpose.synth.cars import ChangedPreset, is_random_car
from cabinpose.synth.config import CabinScene, SynthConfig
from cabinpose.synth.occupant import ExactPose
from cabinpose.synth.once import cached_once
from cabinpose.synth.plan import DriveSide, Plan, car_dimensions, subject_body
from cabinpose.synth.posing import slimmest_in_the_middle
from cabinpose.synth.posture import choose_setting
from cabinpose.synth.posture.sampling import OccupantPose
from cabinpose.synth.preflight import open_cabin
from cabinpose.synth.scene import ScenePerson
from cabinpose.synth.streams import weighted
from cabinpose.synth.things import Brought, check_size, draw_child_seats, draw_objects, is_cloth, stature_range
from cabinpose.synth.validate import Validator

_FOR_LEGS_M = 0.08  # by which a front passenger's seat is slid forwards for a child behind it


class Cast(NamedTuple):
    """A car and who sits in it: names and people by slot, the seats' settings, and the poses that are given.

    soft: kind and design of what is draped over seats and laps, by slot.
    """

    car: str
    cabin: Cabin
    validator: Validator
    names: Mapping[str, str]
    people: Mapping[str, Person]
    settings: Mapping[str, SeatSetting]
    given: Mapping[str, OccupantPose]
    brought: Brought
    soft: Mapping[str, tuple[str, int]]

    def person(self, slot: str, action: str, body: PosedBody) -> ScenePerson:
        """Whoever sits in a slot, posed and not yet dressed."""
        return ScenePerson(slot, self.names[slot], action, self.people[slot], body)


class Casting:
    """Draws who sits in which car. Holds the bodies and cabins used last, a bounded number of each."""

    def __init__(self, config: SynthConfig, seed: int, plan: Plan, *, like: Casting | None = None) -> None:
        """like: one whose people and cars are taken over as far as configuration and seed make the same ones."""
        self._config, self._seed, self._plan = config, seed, plan
        self._model = BodyModel.load()
        cars = config.scene.cars if isinstance(config.scene, CabinScene) else ()
        self._changed = {car.name: car.dimensions for car in cars if isinstance(car, ChangedPreset)}
        self.person = cached_once(32)(self._make_person)
        self._cabin = cached_once(20)(self._make_cabin)
        if like is not None and like._seed == seed:
            self._cabin = like._cabin
            if like._config.people == config.people:
                self.person = like.person

    def cast(self, scene: CabinScene, index: int, *, rng: np.random.Generator) -> Cast:
        """Which car frame `index` shows, who sits where in it, and how the seats are set."""
        car, drive_side = self._plan.car(index, rng=rng)
        cabin, validator = self._cabin(self._changed.get(car, car), drive_side)
        child_seats = draw_child_seats(scene.child_seats, cabin, rng=rng) if scene.child_seats and not scene.things else {}
        children = self._children(scene, child_seats, rng)
        names = self._who(scene, cabin, index, child_seats, children, rng)
        people = {slot: self.person(name) for slot, name in names.items()}
        exact = {slot: o.pose for slot, o in scene.occupants.items() if o.pose is not None}
        settings = {
            slot: _exact_setting(exact[slot])
            if slot in exact
            else choose_setting(people[slot], seat, cabin, rng=rng, variation=scene.seat_variation)
            if slot in people and slot not in child_seats
            else seat.default
            for slot, seat in cabin.seats.items()
        }
        for slot in children:
            settings |= _moved_forwards(cabin, slot, {s: v for s, v in settings.items() if s not in exact})
        given = {slot: _exact_pose(exact[slot], scene.occupants[slot].action or "given") for slot in names if slot in exact}
        objects = draw_objects(scene.objects, cabin, tuple(names), child_seats, rng=rng) if not scene.things else {}
        soft = {slot: (kind, int(rng.integers(VARIANTS))) for slot, kind in objects.items() if is_cloth(kind)}
        soft |= {thing.slot: (thing.kind, thing.variant) for thing in scene.things if is_cloth(thing.kind)}
        hard = {slot: kind for slot, kind in objects.items() if slot not in soft}
        return Cast(car, cabin, validator, names, people, settings, given, Brought(child_seats, hard), soft)

    def _children(self, scene: CabinScene, child_seats: Mapping[str, str], rng: np.random.Generator) -> dict[str, str]:
        """Who sits in which child seat. Raises ConfigError for somebody who is too tall or too small for it."""
        result: dict[str, str] = {}
        for slot, kind in child_seats.items():
            occupant = scene.occupants.get(slot)
            statures = stature_range(kind)
            if statures is None or (occupant is None and not (scene.children and rng.random() < scene.children)):
                continue
            if occupant is not None and occupant.subject is not None:
                result[slot] = occupant.subject
                check_size(occupant.subject, self.person(occupant.subject).stature_m, kind)
            else:
                able = [name for name in self._plan.children(statures) if name not in result.values()]
                result[slot] = able[int(rng.integers(len(able)))]
        return result

    def _who(
        self,
        scene: CabinScene,
        cabin: Cabin,
        index: int,
        without: Collection[str],
        children: Mapping[str, str],
        rng: np.random.Generator,
    ) -> dict[str, str]:
        """The people of frame `index` by the seats they take, none of those `without`: named ones and children, others drawn."""
        taken = _occupied(scene, cabin, without, children, rng)
        named = {slot: o.subject for slot, o in scene.occupants.items() if o.subject is not None} | dict(children)
        cell = self._plan.cell(index)
        if cell is not None and scene.factorial is not None:
            named[scene.factorial.seat] = cell.subject
        free = [slot for slot in taken if slot not in named]
        drawn = self._plan.people(index, len(free), without=named.values(), rng=rng)
        if free[:1] == ["driver"] and cabin.steering_wheel is not None:
            drawn = self._plan.driver_first(index, drawn, without=named.values(), rng=rng)
        people = named | dict(zip(free, drawn, strict=True))
        return slimmest_in_the_middle({slot: people[slot] for slot in taken}, cabin, self.person, stay=named)

    def _make_person(self, subject: str) -> Person:
        if subject in SUBJECTS and not self._config.people.asymmetric:
            return _named_person(subject)
        return self._model.person(*subject_body(self._config, self._seed, subject))

    def _make_cabin(self, car: str | CabinDimensions, drive_side: DriveSide) -> tuple[Cabin, Validator]:
        if isinstance(car, str) and is_random_car(car):
            car = car_dimensions(self._seed, car)
        return judged_cabin(car, drive_side)


def judged_cabin(car: str | CabinDimensions, drive_side: DriveSide) -> tuple[Cabin, Validator]:
    """A cabin and who judges scenes in it. A preset's are built once a process; a user's mesh may change between calls."""
    if isinstance(car, str) and car in PRESETS:
        return _judged_preset(car, drive_side)
    cabin = open_cabin(car, drive_side)
    return cabin, Validator(cabin)


@cached_once(16)
def _judged_preset(car: str, drive_side: DriveSide) -> tuple[Cabin, Validator]:
    cabin = open_cabin(car, drive_side)
    return cabin, Validator(cabin)


@cached_once(len(SUBJECTS))
def _named_person(subject: str) -> Person:
    return BodyModel.load().person(SUBJECTS[subject].phenotype, SUBJECTS[subject].outfit)


def _moved_forwards(cabin: Cabin, slot: str, settings: Mapping[str, SeatSetting]) -> dict[str, SeatSetting]:
    """The front passenger's seat where it is before a child's: slid forwards, to make room for legs that cannot hang straight."""
    seat, front = cabin.seats[slot], cabin.seats.get("front_passenger")
    if front is None or "front_passenger" not in settings or not slot.startswith("rear"):
        return {}
    if float(front.design_h_point[1] * seat.design_h_point[1]) <= 0.0:
        return {}
    setting = settings["front_passenger"]
    return {"front_passenger": replace(setting, fore_aft_m=min(setting.fore_aft_m + _FOR_LEGS_M, front.ranges[1].fore_aft_m))}


def _exact_setting(pose: ExactPose) -> SeatSetting:
    return SeatSetting(pose.fore_aft_m, pose.height_m, pose.torso_angle_rad)


def _exact_pose(pose: ExactPose, action: str) -> OccupantPose:
    q = np.array([pose.angles_rad.get(dof.name, 0.0) for dof in DOFS])
    fingers = None if pose.fingers is None else np.array(pose.fingers, np.float64)
    return OccupantPose(q, np.array(pose.vehicle_from_root), action, pose.wheel_angle_rad, {}, fingers=fingers)


def _occupied(
    scene: CabinScene, cabin: Cabin, without: Collection[str], sure: Collection[str], rng: np.random.Generator
) -> list[str]:
    """The seats taken, in the standard's order: each by its own probability, at least one; those `sure`, none of `without`."""
    chances = {
        slot: 1.0 if slot in scene.always_taken or slot in sure else 0.0 if slot in without else scene.occupancy.get(slot, 0.0)
        for slot in cabin.seats
    }
    draws = rng.random(len(OCCUPANT_SLOTS))
    taken = [slot for i, slot in enumerate(OCCUPANT_SLOTS) if draws[i] < chances.get(slot, 0.0)]
    return taken or [weighted(chances, rng=rng)]

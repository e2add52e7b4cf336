"""Who sits in which car: the cast of a scene."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from cabinpose.core import OCCUPANT_SLOTS, ConfigError
from cabinpose.scene.body import DOFS, Person, PosedBody
from cabinpose.scene.cabin import Cabin, SeatSetting
from cabinpose.scene.things import VARIANTS, PlacedThing, cushion_frame
from cabinpose.synth.cars import place_name
from cabinpose.synth.config import CabinScene
from cabinpose.synth.occupant import ExactPose
from cabinpose.synth.plan import Plan
from cabinpose.synth.posture import FREE_POSES, WITHOUT_SEAT, choose_setting, with_leg_room
from cabinpose.synth.posture.neighbours import close_seats, half_breadth
from cabinpose.synth.posture.sampling import OccupantPose
from cabinpose.synth.posture.seating import behind, is_before
from cabinpose.synth.scene import ScenePerson, Tongue
from cabinpose.synth.streams import weighted
from cabinpose.synth.things import (
    Brought,
    check_size,
    draw_child_seats,
    draw_objects,
    drawn,
    is_cloth,
    lies_in,
    stature_range,
    weights_of,
)
from cabinpose.synth.validate import Validator

SITS_YEARS = 1.0  # from when on a child sits on a car's own seat (assumed: of those who are there, few do)
_FOR_LEGS_M = 0.08  # by which a front passenger's seat is slid forwards for a child behind it
_TOES_M = 0.68  # of a child in a child seat, from the backrest


@dataclass(frozen=True, eq=False)
class Cast:
    """A car and who sits in it.

    names, people: by slot · settings: of all seats · given: poses that are not solved · brought: kinds of child seats and objects
    by slot · soft: kind and design of what is draped over seats and laps, by slot · doing: what children without a seat do, by
    slot · things: what stands on the seats, once they are furnished · tongues: of the belts of who buckles up in a given pose.
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
    doing: Mapping[str, str] = field(default_factory=dict)
    things: tuple[PlacedThing, ...] = ()
    tongues: Mapping[str, Tongue] = field(default_factory=dict)

    @cached_property
    def child_seats(self) -> Mapping[str, PlacedThing]:
        """The child seats in which somebody can sit or lie, by slot."""
        return {thing.slot: thing for thing in self.things if thing.thing.sitting or thing.thing.lying}

    def person(self, slot: str, action: str, body: PosedBody) -> ScenePerson:
        """Whoever sits in a slot, posed and not yet dressed."""
        return ScenePerson(slot, self.names[slot], action, self.people[slot], body, tongue=self.tongues.get(slot))

    def __str__(self) -> str:
        return f"{place_name(self.car)} ({', '.join(f'{name} as {slot}' for slot, name in self.names.items())})"


class Casting:
    """Draws who sits in which car."""

    def __init__(self, scene: CabinScene, plan: Plan) -> None:
        self._scene, self._plan = scene, plan

    def cast(self, index: int, *, rng: np.random.Generator) -> Cast:
        """Which car frame `index` shows, who sits where in it, and how the seats are set."""
        scene = self._scene
        car, drive_side = self._plan.car(index, rng=rng)
        cabin, validator = self._plan.cabins.judged(car, drive_side)
        child_seats = draw_child_seats(scene.child_seats, cabin, rng=rng) if scene.child_seats and not scene.things else {}
        children = self._children(child_seats, rng)
        loose, doing = self._loose(child_seats, cabin, rng)
        children |= loose
        names = self._who(cabin, index, child_seats, children, rng)
        people = {slot: self._plan.subjects.person(name, self._outfit(index, slot, name)) for slot, name in names.items()}
        exact = {slot: o.pose for slot, o in scene.occupants.items() if o.pose is not None}
        stays = {slot: seat.setting for slot, seat in {**scene.seats, **exact}.items() if slot in cabin.seats}
        for slot in (slot for slot in scene.seats if slot in stays):
            cabin.seats[slot].check(stays[slot])
        settings = {
            slot: stays[slot]
            if slot in stays
            else choose_setting(people[slot], seat, cabin, rng=rng, variation=scene.seat_variation)
            if slot in people and slot not in child_seats
            else seat.default
            for slot, seat in cabin.seats.items()
        }
        seated = {slot: person for slot, person in people.items() if slot not in {**child_seats, **doing, **exact}}
        settings |= {slot: v for slot, v in with_leg_room(settings, seated, cabin).items() if slot not in stays}
        for slot in (slot for slot in children if not lies_in(child_seats.get(slot, ""))):
            settings |= _moved_forwards(cabin, slot, {s: v for s, v in settings.items() if s not in stays})
        for slot, person in people.items():
            if person.phenotype.years < SITS_YEARS and slot not in {**child_seats, **doing, **exact} and not scene.things:
                raise ConfigError(
                    f"{names[slot]} is a child of {person.phenotype.years:.2g} years, who does not sit by itself",
                    hint=f"give scene.child_seats.{slot}: infant, or action: child_lie",
                )
        given = {slot: _exact_pose(exact[slot], scene.occupants[slot].action or "given") for slot in names if slot in exact}
        objects = draw_objects(scene.objects, cabin, tuple(names), child_seats, rng=rng) if not scene.things else {}
        soft = {slot: (kind, int(rng.integers(VARIANTS))) for slot, kind in objects.items() if is_cloth(kind)}
        soft |= {thing.slot: (thing.kind, thing.variant) for thing in scene.things if is_cloth(thing.kind)}
        hard = {slot: kind for slot, kind in objects.items() if slot not in soft}
        tongues = {slot: Tongue(np.array(t.at_m), t.how) for slot, pose in exact.items() if (t := pose.tongue) is not None}
        return Cast(
            car, cabin, validator, names, people, settings, given, Brought(_in_use(child_seats, names), hard), soft, doing,
            tongues=tongues,
        )  # fmt: skip

    def _outfit(self, index: int, slot: str, name: str) -> int:
        """The number of the outfit of whoever sits in a slot: as asked for, or drawn."""
        asked = o.outfit if (o := self._scene.occupants.get(slot)) is not None and o.subject == name else None
        if asked is None:
            return self._plan.outfit(index, name)
        if asked >= (count := self._plan.subjects.outfits(name)):
            raise ConfigError(f"{name} has no outfit {asked}", hint=f"they are numbered from 0 to {count - 1}")
        return asked

    def _children(self, child_seats: Mapping[str, str], rng: np.random.Generator) -> dict[str, str]:
        """Who sits in which child seat. Raises ConfigError for somebody who is too tall or too small for it."""
        scene, subjects = self._scene, self._plan.subjects
        result: dict[str, str] = {}
        for slot, kind in child_seats.items():
            occupant = scene.occupants.get(slot)
            statures = stature_range(kind)
            share = scene.infants if lies_in(kind) else scene.children
            if statures is None or (occupant is None and not (share and rng.random() < share)):
                continue
            if occupant is not None and occupant.subject is not None:
                result[slot] = occupant.subject
                check_size(occupant.subject, subjects.person(occupant.subject).stature_m, kind)
            else:
                young = kind == "toddler" and bool(scene.toddlers) and rng.random() < scene.toddlers
                kinds = "I" if lies_in(kind) else "T" if young else "K"
                able = [name for name in subjects.children(statures, kinds) if name not in result.values()]
                result[slot] = able[int(rng.integers(len(able)))]
        return result

    def _loose(
        self, child_seats: Mapping[str, str], cabin: Cabin, rng: np.random.Generator
    ) -> tuple[dict[str, str], dict[str, str]]:
        """Who is in the car without a seat, and what they do: by slot."""
        scene, subjects = self._scene, self._plan.subjects
        asked: dict[str, Mapping[str, float]] = {
            slot: {o.action: 1.0} for slot, o in scene.occupants.items() if o.action in WITHOUT_SEAT and slot not in child_seats
        }
        asked |= {slot: weights_of(choice, WITHOUT_SEAT) for slot, choice in scene.loose_children.items()}
        names, doing = dict[str, str](), dict[str, str]()
        for slot, weights in asked.items():
            action = drawn(weights, rng=rng)
            if action is None or slot not in cabin.seats:
                continue
            occupant = scene.occupants.get(slot)
            doing[slot] = action
            if occupant is not None and occupant.subject is not None:
                names[slot] = occupant.subject
            else:
                able = [name for name in subjects.children(FREE_POSES[action].stature_m, "TK") if name not in names.values()]
                names[slot] = able[int(rng.integers(len(able)))]
        return names, doing

    def _who(
        self, cabin: Cabin, index: int, without: Collection[str], children: Mapping[str, str], rng: np.random.Generator
    ) -> dict[str, str]:
        """The people of frame `index` by the seats they take, none of those `without`: named ones and children, others drawn."""
        scene = self._scene
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
        return slimmest_in_the_middle({slot: people[slot] for slot in taken}, cabin, self._plan.subjects.person, stay=named)


def slimmest_in_the_middle(
    people: Mapping[str, str], cabin: Cabin, person: Callable[[str], Person], *, stay: Collection[str] = ()
) -> dict[str, str]:
    """Names by slot, exchanged so that of three in a row the slimmest sits between the others; not those in slots that `stay`."""
    result = dict(people)
    for slot in people:
        close = [s for s in close_seats(cabin.seats[slot], cabin, tuple(people)) if s not in stay]
        if slot not in stay and len(close) > 1:
            slimmest = min((slot, *close), key=lambda s: half_breadth(person(people[s])))
            result[slot], result[slimmest] = people[slimmest], people[slot]
    return result


def _in_use(child_seats: Mapping[str, str], names: Collection[str]) -> dict[str, str]:
    """The kinds of child seats, of carriers in which somebody lies as they then stand."""
    return {slot: f"{kind}_in_use" if slot in names and lies_in(kind) else kind for slot, kind in child_seats.items()}


def _moved_forwards(cabin: Cabin, slot: str, settings: Mapping[str, SeatSetting]) -> dict[str, SeatSetting]:
    """The front seat where it is before a child's: slid forwards, to make room for legs that cannot hang straight.

    The front passenger's by all that is given, the driver's by what the child's feet need of it.
    """
    seat = cabin.seats[slot]
    known = (s for s in ("front_passenger", "driver") if s in settings and slot.startswith("rear") and s in cabin.seats)
    name = next((s for s in known if is_before(cabin.seats[s], seat)), None)
    if name is None:
        return {}
    front, setting, moved = cabin.seats[name], settings[name], _FOR_LEGS_M
    if name == "driver":
        toes = float(cushion_frame(seat, settings.get(slot, seat.default))[0, 3]) + _TOES_M
        moved = min(max(toes - behind(front, setting), 0.0), _FOR_LEGS_M)
    return {name: replace(setting, fore_aft_m=min(setting.fore_aft_m + moved, front.ranges[1].fore_aft_m))}


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

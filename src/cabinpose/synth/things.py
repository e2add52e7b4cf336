"""What is brought into a car: which child seats and objects a frame has, and where they come to stand."""

from __future__ import annotations

import math
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from typing import Literal, NamedTuple, TypeVar

import numpy as np

from cabinpose.core import CABINPOSE, OCCUPANT_SLOTS, ConfigError, Matrix, axis_rotation, invert, transform, unknown_name
from cabinpose.core import reproducible as rp
from cabinpose.scene.body import PosedBody
from cabinpose.scene.cabin import Cabin, SeatSetting
from cabinpose.scene.contact import ContactField, PlacedField, PosedSolids
from cabinpose.scene.things import (
    CHILD_SEATS,
    LEANING,
    NOTHING_PLACED,
    OBJECTS,
    PRESSED_M,
    RESTING_M,
    THINGS,
    VARIANTS,
    ChildSeat,
    Cloth,
    Cloud,
    Obstacle,
    PlacedThing,
    Spot,
    Thing,
    felt,
    in_the_way,
    let_down,
    make_thing,
    stand_on_seat,
    stands_free,
    thing_kind,
)
from cabinpose.synth.once import cached_once
from cabinpose.synth.people import Probability
from cabinpose.synth.posture import WITHOUT_SEAT
from cabinpose.synth.posture.sampling import OccupantPose
from cabinpose.synth.validate import Rejection, Seated, Validator, touched_by

Name = TypeVar("Name", bound=str)
Choice = str | Mapping[str, Probability]  # a kind, "any", or how likely each is
ANY_CHILD_SEAT = ("infant", "toddler", "booster")  # what `any` stands for
ON_SEATS = tuple(name for name, kind in OBJECTS.items() if kind.on_seat)  # likewise on seats, and on laps
ON_LAPS = tuple(name for name, kind in OBJECTS.items() if kind.on_lap)
CLOTH = tuple(name for name, kind in OBJECTS.items() if isinstance(kind, Cloth))
HELD = tuple(name for name, kind in OBJECTS.items() if kind.held_at)
CLOTH_LABELS = frozenset(OBJECTS[name].label for name in CLOTH)
EMPTY_CHILD_SEATS = tuple(name for name in CHILD_SEATS if not name.endswith("_in_use"))
_HOLDING_CHILDREN = tuple(name for name in EMPTY_CHILD_SEATS if CHILD_SEATS[name].sitting or CHILD_SEATS[name].lying)
_PLACES = 6  # tried for an object before the scene is drawn anew
_CUSHION_M = 0.40  # of a cushion's length is used, from the backrest
_LAP_PLACES, _FARTHER_M = 8, 0.015  # tried on a lap, each farther from the trunk
_ABOVE_LAP_M = 0.20  # of the femurs' axes
_FORWARDS_M = (0.05, 0.10, 0.15, 0.20)  # an empty front seat is moved for what stands behind it


def weights_of(choice: Choice, among: Sequence[str]) -> Mapping[str, float]:
    """How likely each kind is; what is left to 1 is nothing."""
    if isinstance(choice, str):
        return {kind: 1.0 / len(among) for kind in among} if choice == "any" else {choice: 1.0}
    return choice


def check_choice(where: str, choice: Choice, what: Literal["child seat", "object"], ours: Sequence[str]) -> None:
    """Raises ConfigError for names of no child seat or object, and for probabilities that are more than one together."""
    weights = weights_of(choice, ours)
    for name in weights:
        if name not in ours and _what(name) != what:
            raise unknown_name(what, name, ["any", *ours])
    check_shares(where, weights)


def _what(name: str) -> Literal["child seat", "object"] | None:
    """What may be asked for by the name of a thing; None for what is nowhere but in hands, or in use."""
    if name not in THINGS or name.endswith("_in_use"):
        return None
    kind = THINGS[name]
    return "child seat" if isinstance(kind, ChildSeat) else "object" if kind.on_seat or kind.on_lap or kind.make is None else None


def things_for(what: Literal["child seat", "object"]) -> tuple[str, ...]:
    """What may be asked for, those of extensions as well; one that cannot be loaded is left out, with a warning."""
    return ("any", *(name for name, _ in THINGS.items() if _what(name) == what))


def stature_range(kind: str) -> tuple[float, float] | None:
    """The least and the largest stature (m) of children who sit or lie in a thing of a kind; None where none does."""
    row = THINGS[kind]
    place = row.sitting or row.lying if isinstance(row, ChildSeat) else None
    return None if place is None else place(0).stature_m


def lies_in(kind: str) -> bool:
    """Whether whoever is in a thing of a kind lies; "" is none."""
    row = THINGS[kind] if kind else None
    return isinstance(row, ChildSeat) and row.lying is not None


def check_loose(loose: Mapping[str, Choice], taken: Sequence[str]) -> None:
    """Raises ConfigError for children without a seat where none can be. taken: seats of others, and of child seats."""
    for slot, choice in loose.items():
        if slot not in OCCUPANT_SLOTS:
            raise unknown_name("seat", slot, list(OCCUPANT_SLOTS))
        if not slot.startswith("rear"):
            raise ConfigError(f"no child stands, lies or crouches before the {slot} seat", hint="give it to a rear seat")
        if slot in taken:
            raise ConfigError(
                f"the {slot} seat is taken, and a child without a seat is to be there", hint="leave out one of the two"
            )
        weights = weights_of(choice, WITHOUT_SEAT)
        for name in weights:
            if name not in WITHOUT_SEAT:
                raise unknown_name("place of a child without a seat", name, ["any", *WITHOUT_SEAT])
        check_shares(f"loose_children.{slot}", weights)


def is_cloth(kind: str) -> bool:
    """Whether a kind is draped over seats and laps."""
    return isinstance(thing_kind(kind), Cloth)


def cloth_labels_of(kinds: Iterable[str]) -> frozenset[str]:
    """The classes of cloth and of what hangs, of some kinds."""
    return CLOTH_LABELS & {thing_kind(kind).label for kind in kinds}


def check_shares(where: str, weights: Mapping[Name, float]) -> None:
    """Raises ConfigError for probabilities that are more than one together."""
    if sum(weights.values()) > 1.0 + 1e-9:
        raise ConfigError(
            f"{where}: the probabilities are {sum(weights.values()):g} together",
            hint="give no more than 1 in all; what is left to 1 is nothing",
        )


def check_child_seats(child_seats: Mapping[str, Choice], occupied: Sequence[str], objects: Mapping[str, Choice]) -> None:
    """Raises ConfigError for child seats and objects where none can be. occupied: seats in which somebody sits in every frame."""
    for slot in (*child_seats, *objects):
        if slot not in OCCUPANT_SLOTS:
            raise unknown_name("seat", slot, list(OCCUPANT_SLOTS))
    for slot, choice in child_seats.items():
        check_choice(f"child_seats.{slot}", choice, "child seat", EMPTY_CHILD_SEATS)
        if slot == "driver":
            raise ConfigError("no child seat stands in the driver's seat", hint="give it to another seat")
        empty = [kind for kind, weight in weights_of(choice, ANY_CHILD_SEAT).items() if weight > 0.0 and not stature_range(kind)]
        if slot in occupied and empty:
            raise ConfigError(
                f"the {slot} seat has an occupant and a child seat in which nobody sits: {', '.join(empty)}",
                hint=f"leave out one of the two, or give the child {' or '.join(_HOLDING_CHILDREN)}",
            )
    for slot, choice in objects.items():
        check_choice(f"objects.{slot}", choice, "object", (*ON_SEATS, *CLOTH))
        if slot == "driver" and any(is_cloth(kind) for kind in weights_of(choice, ())):
            raise ConfigError("nothing is draped over the driver", hint="give blanket and jacket to another seat")


def check_held(held: Sequence[str]) -> None:
    """Raises ConfigError for names of no thing, and for things that hands do not hold."""
    for name in held:
        if not THINGS[name].held_at:
            raise ConfigError(f"hands do not hold a {name}", hint=f"they hold: {', '.join(HELD)}")


def check_size(name: str, stature_m: float, kind: str) -> None:
    """Raises ConfigError for somebody whom a kind of child seat cannot hold."""
    holds = stature_range(kind)
    if holds is None or holds[0] <= stature_m <= holds[1]:
        return
    ranges = ((other, stature_range(other)) for other in _HOLDING_CHILDREN)
    others = [other for other, range_m in ranges if range_m is not None and range_m[0] <= stature_m <= range_m[1]]
    what = f"{'an' if kind[0] in 'aeiou' else 'a'} {kind}"
    raise ConfigError(
        f"{name} is {stature_m:.2f} m tall: {what} holds children of {holds[0]:.2f} to {holds[1]:.2f} m",
        hint=f"seat {name} in one that is called {others[0]}" if others else "leave the child seat out, or name a child",
    )


class Brought(NamedTuple):
    """What a frame is to have: kinds of child seats and of objects by seat."""

    child_seats: Mapping[str, str]
    objects: Mapping[str, str]


NOTHING = Brought({}, {})


def drawn(weights: Mapping[Name, float], *, rng: np.random.Generator) -> Name | None:
    """One of the names, by how likely each is; None: none of them."""
    left = rng.random()
    for kind, weight in weights.items():
        left -= weight
        if left < 0.0:
            return kind
    return None


def draw_child_seats(child_seats: Mapping[str, Choice], cabin: Cabin, *, rng: np.random.Generator) -> dict[str, str]:
    """The kinds of child seats of one frame, by seat."""
    asked = {slot: weights_of(child_seats[slot], ANY_CHILD_SEAT) for slot in OCCUPANT_SLOTS if slot in child_seats}
    kinds = {slot: drawn(weights, rng=rng) for slot, weights in asked.items()}
    return {slot: kind for slot, kind in kinds.items() if kind is not None and slot in cabin.seats}


def draw_objects(
    objects: Mapping[str, Choice], cabin: Cabin, taken: Sequence[str], child_seats: Mapping[str, str], *, rng: np.random.Generator
) -> dict[str, str]:
    """The kinds of objects of one frame, by seat: where somebody sits those that lie on a lap.

    Where a child seat stands there are none, but for cloth over an infant in a carrier.
    """
    result = {}
    for slot in OCCUPANT_SLOTS:
        if slot not in objects:
            continue
        kind = drawn(weights_of(objects[slot], ON_LAPS if slot in taken else ON_SEATS), rng=rng)
        covered = kind is not None and is_cloth(kind) and slot in taken and lies_in(child_seats.get(slot, ""))
        if kind is None or slot not in cabin.seats or (slot in child_seats and not covered):
            continue
        if is_cloth(kind) or (THINGS[kind].on_lap if slot in taken else THINGS[kind].on_seat):
            result[slot] = kind
    return result


class Blocked(NamedTuple):
    """A thing for which there is no place: where, which kind, and what it stands in."""

    slot: str
    kind: str
    by: Obstacle

    @property
    def rejection(self) -> Rejection:
        """The same as a code."""
        return Rejection("thing", self.slot, self.kind, self.by.part)


class SeatThings:
    """Puts things onto the seats of one cabin; where child seats come to stand is worked out once."""

    def __init__(self, cabin: Cabin, contact: ContactField) -> None:
        """contact: the fields of this cabin."""
        self._cabin, self._contact = cabin, contact
        self._settled = cached_once(256)(self._settle)

    def _settle(self, slot: str, kind: str, variant: int, torso_angle: float) -> Matrix:
        """seat_from_thing of a child seat that leans on its backrest, wherever the seat is moved to."""
        seat, setting = self._cabin.seats[slot], SeatSetting(torso_angle=torso_angle)
        placed = self._contact.at({slot: setting})
        at = stand_on_seat(make_thing(kind, variant), seat, setting, placed, LEANING, PRESSED_M)
        return rp.matmul(invert(seat.vehicle_from_seat(setting)), at)

    def place(
        self,
        brought: Brought,
        taken: Sequence[str],
        settings: dict[str, SeatSetting],
        *,
        stay: Collection[str] = (),
        rng: np.random.Generator,
    ) -> list[PlacedThing] | Blocked:
        """Put everything onto seats that nobody has taken.

        Parameters
        ----------
        brought
            The kinds.
        taken
            Seats of people, whose objects are left out.
        settings
            Of the seats; an empty front seat that is in the way of what stands behind it is moved forwards, in place.
        stay
            Empty seats that are not moved.
        rng
            Source of the designs and places.
        """
        result: list[PlacedThing] = []
        for slot, kind in brought.child_seats.items():
            found = self._child_seat(slot, kind, (*taken, *stay), settings, result, rng)
            if isinstance(found, Blocked):
                return found
            result.append(found)
        for slot, kind in brought.objects.items():
            if slot in taken:
                continue
            put = self._object(slot, kind, settings, result, rng)
            if isinstance(put, Blocked):
                return put
            result.append(put)
        return result

    def _child_seat(
        self,
        slot: str,
        kind: str,
        stay: Collection[str],
        settings: dict[str, SeatSetting],
        others: Sequence[PlacedThing],
        rng: np.random.Generator,
    ) -> PlacedThing | Blocked:
        blocked = Blocked(slot, kind, Obstacle("", 0.0))
        seat, around = self._cabin.seats[slot], [other.group() for other in others]
        for variant in rng.permutation(VARIANTS).tolist():
            at = rp.matmul(seat.vehicle_from_seat(settings[slot]), self._settled(slot, kind, variant, settings[slot].torso_angle))
            thing = PlacedThing(make_thing(kind, variant), at, slot, "seat")
            for change in self._front_seats(slot, stay, settings):
                obstacle = in_the_way(thing, self._contact.at({**settings, **change}).with_groups(around), PRESSED_M)
                if obstacle is None:
                    settings.update(change)
                    return thing
                blocked = Blocked(slot, kind, obstacle)
                if not any(obstacle.part.startswith(front) for front in ("driver ", "front_passenger ")):
                    break
        return blocked

    def _front_seats(
        self, slot: str, stay: Collection[str], settings: Mapping[str, SeatSetting]
    ) -> Iterator[Mapping[str, SeatSetting]]:
        """Nothing, and then the front seats but those that `stay` ever farther forwards."""
        yield {}
        empty = [s for s in ("driver", "front_passenger") if s in self._cabin.seats and s not in stay and s != slot]
        for forwards in _FORWARDS_M if slot.startswith("rear") and empty else ():
            moved = {s: min(settings[s].fore_aft_m + forwards, self._cabin.seats[s].ranges[1].fore_aft_m) for s in empty}
            yield {s: SeatSetting(x, settings[s].height_m, settings[s].torso_angle) for s, x in moved.items()}

    def _object(
        self, slot: str, kind: str, settings: Mapping[str, SeatSetting], others: Sequence[PlacedThing], rng: np.random.Generator
    ) -> PlacedThing | Blocked:
        placed = self._contact.at(settings)
        around = placed.with_groups([t.group() for t in others])
        obstacle = Obstacle("", 0.0)
        for _ in range(_PLACES):
            thing = make_thing(kind, int(rng.integers(VARIANTS)))
            at = stand_on_seat(thing, self._cabin.seats[slot], settings[slot], placed, _somewhere(thing, rng), RESTING_M)
            put = PlacedThing(thing, at, slot, "seat")
            found = in_the_way(put, around, RESTING_M)
            if found is None:
                return put
            obstacle = found
        return Blocked(slot, kind, obstacle)


def bring_along(
    kind: str | None, slot: str, pose: OccupantPose, posed: PosedBody, validator: Validator, seated: Seated,
    *, rng: np.random.Generator,
) -> tuple[Rejection | None, Seated]:  # fmt: skip
    """Put what somebody holds into the hand, and an object of this kind onto the lap (None: nothing).

    Returns
    -------
    Rejection or None
        Why there is no room.
    Seated
        With those things where there is room, else as it was.
    """
    result = seated
    if pose.hold is not None:
        verdict, result = validator.bring(result, pose.hold.thing(slot, posed))
        if verdict.rejection is not None:
            return verdict.rejection, seated
    if kind is None:
        return None, result
    refused: Rejection | None = None
    for number in range(_LAP_PLACES):
        thing = make_thing(kind, int(rng.integers(VARIANTS)))
        lap, length = lap_frame(posed)
        ahead = rng.uniform(0.42, 0.60) * length - float(thing.box[0, 0]) + _FARTHER_M * number
        turn = axis_rotation("z", math.radians(8.0) * rng.standard_normal())
        lies = stand_on_lap(
            thing, rp.matmul(lap, transform(turn, (ahead, rng.uniform(-0.03, 0.03), 0.0))), seated.bodies[-1].solids
        )
        if lies is None:
            refused = refused or Rejection("thing", slot, kind, "torso")
            continue
        verdict, brought = validator.bring(result, PlacedThing(thing, lies, slot, "lap"))
        if verdict.rejection is None:
            return None, brought
        refused = verdict.rejection
    return refused, seated


def lap_frame(posed: PosedBody) -> tuple[Matrix, float]:
    """vehicle_from_lap, between the femur heads, x to the knees and z off the thighs; and how far the knees are, m."""
    at = {name: posed.joints[CABINPOSE.index[name]] for name in ("lpelvis", "rpelvis", "lknee", "rknee")}
    hips = 0.5 * (at["lpelvis"] + at["rpelvis"])
    to_knees = 0.5 * (at["lknee"] + at["rknee"]) - hips
    length = rp.norm(to_knees)
    x = to_knees / length
    up = np.cross(x, at["lknee"] - at["rknee"] + at["lpelvis"] - at["rpelvis"])
    up /= rp.norm(up)
    return transform(np.column_stack((x, np.cross(up, x), up)), hips), length


def stand_on_lap(thing: Thing, vehicle_from_lap: Matrix, body: PosedSolids) -> Matrix | None:
    """vehicle_from_thing of a thing that is let down along the lap's z onto thighs, hands, arms; None where a trunk stops it."""

    def at(z: float) -> Matrix:
        return np.asarray(rp.matmul(vehicle_from_lap, transform(None, (0.0, 0.0, z))))

    def alone(z: float) -> PlacedField:
        return NOTHING_PLACED.with_groups([PlacedThing(thing, at(z), "", "lap").group()])

    skin, group = Cloud.of(body.skin_points[0]), felt(thing.field, math.inf, RESTING_M)

    def free(z: float) -> bool:
        return stands_free(group, skin, invert(at(z))) and alone(z).deepest_probe(body, RESTING_M) is None

    z = let_down(free, _ABOVE_LAP_M, 0.0)
    below = touched_by(alone(z - RESTING_M), body, RESTING_M)
    return None if not free(z) or below is None or below[1] in ("torso", "head") else at(z)


def _somewhere(thing: Thing, rng: np.random.Generator) -> Spot:
    """Where an object is put down."""
    how, length_m = THINGS[thing.kind].on_seat, float(np.ptp(thing.box, axis=0)[:2].max())
    chance, aside, turn = rng.random(), rng.uniform(-0.06, 0.06), rng.normal()
    ahead = 0.0 if how == "leans" or chance < 0.4 else max(_CUSHION_M - length_m, 0.02) * rng.uniform(0.3, 1.0)
    spread = math.radians(12.0 if how == "leans" else 25.0)
    yaw = spread * turn + (0.0 if how == "leans" else math.pi / 2.0 * int(rng.integers(4)))
    return Spot(
        ahead, aside, rp.matmul(axis_rotation("z", yaw), axis_rotation("x", math.pi / 2.0) if how == "lies" else np.eye(3))
    )

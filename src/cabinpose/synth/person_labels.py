"""Who is in each place of a scene and how: body, clothes, restraints, seat, hands, boxes. Nothing is estimated from images.

Each function gives variables of the dataset standard by name, over places (P, ...). What is not known has the missing value.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np

from cabinpose.core import ConfigError, Floats
from cabinpose.core import reproducible as rp
from cabinpose.scene.body import CHILD_YEARS, Person, load_population, worn_words
from cabinpose.scene.cabin import SteeringWheel
from cabinpose.scene.things import CHILD_SEAT_LABELS, PlacedThing
from cabinpose.store import AXES, BELT_OF_1
from cabinpose.synth.faces import DROWSY_OPENING
from cabinpose.synth.gaze import ASLEEP
from cabinpose.synth.posture import FREE_POSES
from cabinpose.synth.scene import Scene, ScenePerson

INFANT_YEARS = 1.0  # who is younger is an infant: assumed, as Euro NCAP's dummies Q0 and Q1 divide them
_RIM_SLACK_M = 0.03  # of the middle of a palm from the rim's centre line, of a hand that is on it: assumed
_WEARS = AXES["worn"]
_HANDS = 2
_STANCE = {"carrier": "lying", "bench": "lying", "standing": "standing", "footwell": "crouching"}  # of who is where


class _Body(NamedTuple):
    """What is the same of a person in every frame."""

    sex: str
    age: float
    stature: float
    mass: float
    population: str
    percentiles: tuple[float, float]
    outfit: tuple[str, ...]


@lru_cache(maxsize=64)
def _body(person: Person) -> _Body:
    phenotype, size = person.phenotype, person.phenotype.size
    gender = phenotype.gender
    sex = size.sex if size else "female" if gender > 0.5 else "male" if gender < 0.5 else ""
    mass = size.mass_kg if size else person.mass_kg
    population, percentiles = "", (math.nan, math.nan)
    if size:
        population, percentiles = size.population, (size.stature_percentile, size.mass_percentile)
    if not population and sex:
        for name in ("nhanes", "cdc"):
            try:
                percentiles = load_population(name).percentiles(sex, phenotype.years, person.stature_m, mass)
                population = name
                break
            except ConfigError:  # which has nobody of this age
                continue
    wears = worn_words(person.outfit)
    return _Body(
        sex, phenotype.years, person.stature_m, mass, population, percentiles,
        tuple(wears.get(place, "") for place in _WEARS),
    )  # fmt: skip


def body_labels(scene: Scene, slots: tuple[str, ...], worn_reflectance: Mapping[str, tuple[float, ...]]) -> dict[str, Any]:
    """Sex, age, stature, mass and percentiles, clothes and their reflectance (by slot, over the axis `worn`)."""
    there = {slots.index(who.slot): _body(who.person) for who in scene.people}

    def number(of: str) -> Floats:
        return np.array([getattr(there[row], of) if row in there else math.nan for row in range(len(slots))], np.float32)

    def text(of: str) -> list[str]:
        return [getattr(there[row], of) if row in there else "" for row in range(len(slots))]

    nobody = (math.nan, math.nan), ("",) * len(_WEARS)
    rows = [(body.percentiles, body.outfit) if (body := there.get(row)) else nobody for row in range(len(slots))]
    percentiles = np.array([each[0] for each in rows], np.float32)
    return {
        "sex": text("sex"), "age": number("age"), "stature": number("stature"), "mass": number("mass"),
        "population": text("population"), "stature_percentile": percentiles[:, 0], "mass_percentile": percentiles[:, 1],
        "outfit": [list(each[1]) for each in rows],
        "reflectance": np.array([worn_reflectance.get(slot, (math.nan,) * len(_WEARS)) for slot in slots], np.float32),
    }  # fmt: skip


def occupancy_labels(scene: Scene, slots: tuple[str, ...]) -> dict[str, Any]:
    """What is in each place, what is brought along, the belt, the child seat, and how the seat is set."""
    people = {who.slot: who for who in scene.people}
    seats = {t.slot: t for t in scene.things if t.at == "seat" and t.thing.label in CHILD_SEAT_LABELS}
    brought = {slot: sorted(_kind(t) for t in scene.things if t.slot == slot) for slot in slots}
    settings = {} if scene.cabin is None else {s: scene.cabin.setting(scene.settings, s) for s in slots if s in scene.cabin.seats}

    def seat(of: str) -> Floats:
        return np.array([getattr(settings[slot], of) if slot in settings else math.nan for slot in slots], np.float32)

    return {
        "occupancy": [
            _occupancy(people.get(slot), slot in seats, bool(brought[slot])) if scene.cabin is None or slot in settings else ""
            for slot in slots
        ],
        "things": [",".join(brought[slot]) for slot in slots],
        "belt": [BELT_OF_1.get(who.belt, who.belt) if (who := people.get(slot)) else "" for slot in slots],
        "child_seat_kind": [_kind(seats[slot]) if slot in seats else "" for slot in slots],
        "child_seat_facing": [_facing(seats[slot]) if slot in seats else "" for slot in slots],
        "attachment": [(seats[slot].attachment or "") if slot in seats else "" for slot in slots],
        "seat_track": seat("fore_aft_m"), "seat_height": seat("height_m"), "seat_recline": seat("torso_angle"),
        "wheel_angle": np.float32(math.nan if _wheel(scene) is None else scene.wheel_angle),
    }  # fmt: skip


def _kind(thing: PlacedThing) -> str:
    return thing.thing.kind.removesuffix("_in_use")


def _occupancy(who: ScenePerson | None, in_child_seat: bool, thing: bool) -> str:
    if who is None:
        return "child_seat_empty" if in_child_seat else "object" if thing else "empty"
    if who.person.phenotype.years < INFANT_YEARS:
        return "infant"
    if in_child_seat:
        return "child_in_child_seat"
    return "child" if who.person.phenotype.years < CHILD_YEARS else "adult"


def _facing(seat: PlacedThing) -> str:
    """Which way a child in it looks, against the seat that it stands on: infant carriers are made to look back."""
    return "rearward" if seat.thing.label == "infant_seat" else "forward"


def doing_labels(scene: Scene, slots: tuple[str, ...]) -> dict[str, Any]:
    """Stance, alertness and expression, what hands hold, where they are on the wheel, the telephone, the eyelids."""
    people = {who.slot: who for who in scene.people}
    rim = _wheel(scene)
    clock, lids = np.full((len(slots), _HANDS), np.nan, np.float32), np.full((len(slots), 2), np.nan, np.float32)
    hold = [["", ""] for _ in slots]
    for row, slot in enumerate(slots):
        if (who := people.get(slot)) is None:
            continue
        palms = [who.posed.palms[side][:3, 3] for side in "lr"]
        if rim is not None and slot == "driver":
            clock[row] = [clock_on_rim(rim, palm) for palm in palms]
        hold[row] = ["nothing" if math.isnan(hour) else "steering_wheel" for hour in clock[row].tolist()]
        for thing in scene.things:
            if thing.slot == slot and thing.at == "hand":
                off = [rp.norm(palm - np.asarray(thing.vehicle_from_thing)[:3, 3]) for palm in palms]
                hold[row][int(off[1] < off[0])] = _kind(thing)
        lids[row] = who.face.lids
    stance = "standing" if scene.cabin is None else "sitting"
    return {
        "stance": [
            "" if (who := people.get(slot)) is None else _STANCE[pose.where] if (pose := FREE_POSES.get(who.action)) else stance
            for slot in slots
        ],
        "alertness": [_alertness(who) if (who := people.get(slot)) else "" for slot in slots],
        "expression": [who.face.expression if (who := people.get(slot)) else "" for slot in slots],
        "phone": [_phone(people.get(slot), hold[row]) for row, slot in enumerate(slots)],
        "in_hand": hold, "hand_clock": clock, "eyelid_opening": lids,
    }  # fmt: skip


def _alertness(who: ScenePerson) -> str:
    if who.action in ASLEEP:
        return "asleep"
    return "drowsy" if max(who.face.lids) < DROWSY_OPENING else "awake"


def _phone(who: ScenePerson | None, hold: list[str]) -> str:
    if who is None:
        return ""
    if "phone" not in hold:
        return "none"
    return "ear" if who.action.startswith("phone_ear") else "in_hand"


def _wheel(scene: Scene) -> SteeringWheel | None:
    return None if scene.cabin is None else scene.cabin.steering_wheel


def clock_on_rim(wheel: SteeringWheel, palm: Floats) -> float:
    """Hours (0, 12] at which the middle of a palm, (3,) m in the vehicle, is on a wheel's rim, 12 at the top; NaN off the rim."""
    rotation, hub = wheel.vehicle_from_wheel[:3, :3], wheel.vehicle_from_wheel[:3, 3]
    up, left, towards = rp.matmul(rotation.T, palm - hub)
    off = rp.hypot(rp.hypot(up, left) - wheel.rim_radius_m, towards)
    if off > _RIM_SLACK_M:
        return math.nan
    hours = float(-rp.arctan2(left, up)) * 6.0 / math.pi
    return hours if hours > 0.0 else hours + 12.0


def box_labels(scene: Scene, slots: tuple[str, ...]) -> dict[str, Any]:
    """`box_3d` (P, 2, 3) m, vehicle frame, about all of each person with their clothes."""
    solid = np.full((len(slots), 2, 3), np.nan, np.float32)
    for who in scene.people:
        if who.surfaces:
            columns = who.surfaces[0].vertices.T  # one after another: a tenth of the time of all at once
            solid[slots.index(who.slot)] = [each.min() for each in columns], [each.max() for each in columns]
    return {"box_3d": solid}

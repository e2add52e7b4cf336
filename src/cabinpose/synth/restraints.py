"""Clothes, and what holds people, children and child seats: belts, guides and harnesses, the isofix of a seat."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Literal

import numpy as np

from cabinpose.core import CABINPOSE, OCCUPANT_SLOTS, Floats, apply, invert
from cabinpose.scene import Surface, merge
from cabinpose.scene.body import PosedBody
from cabinpose.scene.cabin import BeltWear, Cabin, SeatSetting, Wearer, fastening_surface, loose_belt, loose_straps
from cabinpose.scene.things import THINGS, Attachment, BeltPath, ChildSeat, PlacedThing, Sitting, make_thing
from cabinpose.synth.casting import Cast
from cabinpose.synth.config import CabinScene
from cabinpose.synth.posture import straps_of
from cabinpose.synth.scene import ScenePerson
from cabinpose.synth.things import drawn

# Widths of straps: UN R44 asks for 25 mm at least where they touch children of groups 0 to I, 38 mm beyond.
_STRAP_M, _INFANT_STRAP_M = 0.038, 0.026
_OVER_SHOULDER_M = 0.07  # of loose straps, from where they come out for a child who wears them
_SHELL = (" shell", " padding")
_GUIDE_M = (0.04, 0.020, 0.035)  # before the back, farther aside than the middle of the shoulder, above it
_SLOT_M, _HIP_M = (0.010, 0.055, 0.010), (0.100, 0.125, 0.035)  # likewise; the hips' above the cushion
_BEHIND_HIPS_M, _HIPS_M = 0.040, 0.030  # of the slots beside the hips: behind the hips themselves; before the back, at least


def restrained(
    thing: PlacedThing, attachments: Mapping[Attachment, float], *, taken: bool, rng: np.random.Generator
) -> PlacedThing:
    """A child seat as it is with a child in it, and with what fastens it."""
    kind, variant = thing.thing.kind, thing.thing.variant
    if attachments and _belt_path(thing) is not None:
        thing = thing._replace(attachment=drawn(attachments, rng=rng))
    used = f"{kind}_in_use"
    return thing._replace(thing=make_thing(used, variant)) if taken and used in THINGS else thing


def _belt_path(thing: PlacedThing) -> BeltPath | None:
    kind = THINGS[thing.thing.kind]
    return kind.belt_path if isinstance(kind, ChildSeat) else None


def fastening(thing: PlacedThing, cabin: Cabin, setting: SeatSetting) -> Surface:
    """The belt that holds a child seat, vehicle frame."""
    path = _belt_path(thing)
    assert path is not None
    shell = merge([part.surface for part in thing.thing.parts if part.name.endswith(_SHELL)])
    points, shell = apply(thing.vehicle_from_thing, np.array(path.points)), shell.moved(thing.vehicle_from_thing)
    return fastening_surface(shell, cabin.seats[thing.slot], setting, cabin, points, over=path.over)


def _sitting(on: PlacedThing) -> Sitting:
    assert on.thing.sitting is not None  # of those in which somebody sits
    return on.thing.sitting


def _beside_back(on: PlacedThing, height: float, ahead: float, aside: float) -> Floats:
    """(3,) m, vehicle frame: a point before the back of a child seat, at a height of its frame."""
    back = _sitting(on).back
    assert back is not None
    return np.asarray(apply(on.vehicle_from_thing, np.array([back[0] + back[1] * height + ahead, aside, height])))


def belt_guide(on: PlacedThing, body: PosedBody, anchor: Floats) -> Floats | None:
    """Where a booster leads the belt to the shoulder, (3,) m, vehicle frame; None for one without a back."""
    if _sitting(on).back is None:
        return None
    joints = body.joints[CABINPOSE.indices(("lshoulder", "rshoulder", "neck"))]
    local = apply(invert(on.vehicle_from_thing), np.stack((anchor, *joints)))
    side = float(np.sign(local[0, 1]))
    shoulder = local[1 if side > 0.0 else 2]
    aside = 0.5 * (shoulder[1] + local[3, 1]) + side * _GUIDE_M[1]
    return _beside_back(on, shoulder[2] + _GUIDE_M[2], _GUIDE_M[0], aside)


def lap_guides(on: PlacedThing) -> Floats | None:
    """Where a booster leads the belt's lap part below its armrests, (2, 3) m, vehicle frame; None for one that does not."""
    at = _sitting(on).guide_m
    return None if at is None else np.asarray(apply(on.vehicle_from_thing, np.array(at) * ((1.0, 1.0, 1.0), (1.0, -1.0, 1.0))))


def straps(on: PlacedThing, body: PosedBody) -> tuple[Floats, Floats]:
    """Where a harness comes out of its shell, (2, 3) m each, vehicle frame: behind the shoulders and beside the hips."""
    if on.thing.lying is not None:
        return straps_of({name: body.joints[i] for name, i in CABINPOSE.index.items()}, on.vehicle_from_thing)
    of = ("lshoulder", "rshoulder"), ("lpelvis", "rpelvis")
    shoulders, pelvis = (apply(invert(on.vehicle_from_thing), body.joints[CABINPOSE.indices(pair)]).mean(axis=0) for pair in of)
    low, back = _sitting(on).cushion[0] + _HIP_M[2], _sitting(on).back
    assert back is not None
    behind = pelvis[0] - _BEHIND_HIPS_M - back[0] - back[1] * low  # the lap part runs forwards from there, not up over the belly
    places = ((shoulders[2] + _SLOT_M[2], *_SLOT_M[:2]), (low, float(np.clip(behind, _HIPS_M, _HIP_M[0])), _HIP_M[1]))
    slots, hips = (np.stack([_beside_back(on, z, ahead, s * aside) for s in (1.0, -1.0)]) for z, ahead, aside in places)
    return slots, hips


def dressed(scene: CabinScene, cast: Cast, person: ScenePerson, *, rng: np.random.Generator) -> ScenePerson:
    """The person with clothes on, and with the belt over them for the configured share of people."""
    seat, on = cast.cabin.seats[person.slot], cast.child_seats.get(person.slot)
    clothed = person.posed.surface(1 + OCCUPANT_SLOTS.index(person.slot), person.face)
    how = _belt_wear(scene, person.slot, rng)
    wearer = Wearer.of(clothed, person.posed.joints)
    if on is not None and (on.thing.lying is not None or _sitting(on).harness):
        width = _STRAP_M if on.thing.lying is None else _INFANT_STRAP_M
        slots, hips = straps(on, person.posed)
        if how == "none":  # an infant lies on the straps
            return replace(person, surfaces=(clothed, *(() if on.thing.lying else (_undone(on, slots, width),))))
        return replace(person, surfaces=(clothed, wearer.harness(slots, hips, width_m=width)), belt="harness")
    tongue, setting = person.tongue, cast.settings[person.slot]
    if tongue is not None and tongue.how == "loose":
        return replace(person, surfaces=(clothed, loose_belt(seat, setting, cast.cabin, tongue.at)), belt="none")
    if tongue is not None and tongue.how == "drawn":
        return replace(person, surfaces=(clothed, wearer.belt_in_hand(seat, setting, cast.cabin, tongue.at)), belt="none")
    how = "worn" if tongue is not None and how == "none" else how
    if seat.belt is None or how == "none" or person.slot in cast.doing:
        return replace(person, surfaces=(clothed,))
    guide, lap = (None, None) if on is None else (belt_guide(on, person.posed, seat.belt.upper), lap_guides(on))
    belt = wearer.belt(seat, setting, cast.cabin, worn=how, guide=guide, lap_guides=lap)
    return replace(person, surfaces=(clothed, belt), belt=how)


def _undone(on: PlacedThing, slots: Floats, width_m: float) -> Surface:
    """The straps of a harness that nobody has buckled, vehicle frame."""
    shell = merge([part.surface for part in on.thing.parts if part.name.endswith(_SHELL)]).moved(on.vehicle_from_thing)
    turn = on.vehicle_from_thing[:3, :3]
    return loose_straps(
        shell, slots + _OVER_SHOULDER_M * turn[:, 2], np.stack((turn[:, 1], -turn[:, 1])), -turn[:, 2], width_m=width_m
    )


def _belt_wear(scene: CabinScene, slot: str, rng: np.random.Generator) -> BeltWear | Literal["none"]:
    """How the belt of a seat is worn."""
    given = scene.occupant(slot)
    worn = rng.random() < scene.belted
    misused = drawn(scene.belt_misuse, rng=rng) if scene.belt_misuse else None
    if given.belt is not None:
        return given.belt
    if given.belted is not None:
        return "worn" if given.belted else "none"
    return (misused or "worn") if worn else "none"

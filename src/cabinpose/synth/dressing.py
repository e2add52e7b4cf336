"""Clothes and restraints of people who are posed: the seat belt as it is worn, the harness of a child seat."""

from __future__ import annotations

from dataclasses import replace
from typing import Literal

import numpy as np

from cabinpose.core import OCCUPANT_SLOTS
from cabinpose.scene.cabin import BeltWear, belt_surface, harness_surface
from cabinpose.scene.things import sitting_in
from cabinpose.synth.casting import Cast
from cabinpose.synth.config import CabinScene
from cabinpose.synth.restraints import belt_guide, straps
from cabinpose.synth.scene import ScenePerson
from cabinpose.synth.things import drawn


def dressed(scene: CabinScene, cast: Cast, person: ScenePerson, *, rng: np.random.Generator) -> ScenePerson:
    """The person with clothes on, and with the belt over them for the configured share of people."""
    seat, on = cast.cabin.seats[person.slot], cast.child_seats.get(person.slot)
    clothed = person.posed.surface(1 + OCCUPANT_SLOTS.index(person.slot))
    how = _belt_wear(scene, person.slot, rng)
    body = clothed.vertices, clothed.faces, person.posed.joints
    if on is not None and sitting_in(on.thing).harness:
        harness = harness_surface(*body, *straps(on, person.posed), labels=clothed.label)
        return replace(person, surfaces=(clothed, harness), belt="harness")
    if seat.belt is None or how == "none":
        return replace(person, surfaces=(clothed,))
    guide = None if on is None else belt_guide(on, person.posed, seat.belt.upper)
    setting = cast.settings[person.slot]
    belt = belt_surface(*body, seat, setting, cast.cabin, labels=clothed.label, worn=how, guide=guide)
    return replace(person, surfaces=(clothed, belt), belt=how)


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

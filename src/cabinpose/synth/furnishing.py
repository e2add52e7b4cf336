"""What is brought along: child seats and objects on the seats, in hands and on laps, what is draped, and the belts around it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from cabinpose.scene import Surface
from cabinpose.scene.body import PosedBody
from cabinpose.scene.cabin import Cabin, SeatSetting
from cabinpose.scene.things import PlacedThing
from cabinpose.synth.casting import Cast
from cabinpose.synth.config import CabinScene
from cabinpose.synth.draping import Ground, draped
from cabinpose.synth.once import cached_once
from cabinpose.synth.posture.sampling import OccupantPose
from cabinpose.synth.restraints import fastening, restrained
from cabinpose.synth.scene import ScenePerson
from cabinpose.synth.things import Blocked, SeatThings, bring_along, is_cloth
from cabinpose.synth.validate import Rejection, Seated

_TUB = (" shell", " padding")  # of a carrier, on which cloth may lie


def _seat_surfaces(cabin: Cabin, slot: str, setting: SeatSetting) -> list[Surface]:
    """The parts of a seat on which cloth may lie, vehicle frame."""
    at = cabin.group_transforms({slot: setting})
    parts = [part for part in cabin.parts if part.group.startswith(f"seat:{slot}/") and not part.name.endswith("buckle")]
    return [part.surface.moved(at[part.group]) for part in parts]


class Furnishing:
    """Puts what a cast brings along where it belongs."""

    def __init__(self, scene: CabinScene) -> None:
        self._scene = scene
        self._seat_things = cached_once(20)(SeatThings)

    def furnish(self, cast: Cast, *, rng: np.random.Generator) -> Cast | Blocked:
        """The cast with what stands on the seats, of which empty ones may be moved to make room."""
        if self._scene.things:
            hard = (each for each in self._scene.things if not is_cloth(each.kind))
            return replace(cast, things=tuple(each.placed for each in hard))
        if not any(cast.brought) or cast.validator.contact is None:
            return cast
        settings, attachments = dict(cast.settings), self._scene.attachments
        place = self._seat_things(cast.cabin, cast.validator.contact).place
        found = place(cast.brought, tuple(cast.people), settings, stay=self._scene.seats, rng=rng)
        if isinstance(found, Blocked):
            return found
        things = tuple(restrained(thing, attachments, taken=thing.slot in cast.people, rng=rng) for thing in found)
        return replace(cast, settings=settings, things=things)

    @staticmethod
    def bring(
        cast: Cast, slot: str, pose: OccupantPose, posed: PosedBody, seated: Seated, *, rng: np.random.Generator
    ) -> tuple[Rejection | None, Seated]:
        """Put what somebody holds, and what is for this lap, to the rest; why there is no room for it where there is none."""
        return bring_along(cast.brought.objects.get(slot), slot, pose, posed, cast.validator, seated, rng=rng)

    @staticmethod
    def drape(cast: Cast, people: Sequence[ScenePerson]) -> tuple[PlacedThing, ...]:
        """The blankets and jackets over seats and the laps of these people, who are dressed."""
        cloths = []
        for slot, (kind, variant) in cast.soft.items():
            who = next((p for p in people if p.slot == slot), None)
            seat, setting, carrier = cast.cabin.seats[slot], cast.settings[slot], cast.child_seats.get(slot)
            if carrier is not None and carrier.thing.lying is None:
                carrier = None
            if carrier is None:
                below = _seat_surfaces(cast.cabin, slot, setting)
            else:
                below = [p.surface.moved(carrier.vehicle_from_thing) for p in carrier.thing.parts if p.name.endswith(_TUB)]
            below += () if who is None else who.surfaces
            ground = Ground.of(seat, setting, None if who is None else who.posed, carrier, variant)
            cloths.append(draped(kind, variant, ground, below))
        return tuple(cloth for cloth in cloths if cloth is not None)

    @staticmethod
    def fasten(cast: Cast) -> tuple[Surface, ...]:
        """The belts that hold child seats."""
        return tuple(fastening(t, cast.cabin, cast.settings[t.slot]) for t in cast.things if t.attachment == "belt")

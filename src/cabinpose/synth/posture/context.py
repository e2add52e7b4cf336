"""Somebody in a seat: what a pose starts from, and what its hands, feet and head refer to."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np

from cabinpose.core import Floats, Matrix, invert, rotation_vector, transform
from cabinpose.core import reproducible as rp
from cabinpose.scene.body import Person
from cabinpose.scene.cabin import Cabin, Seat, SeatSetting, SteeringWheel
from cabinpose.scene.things import PlacedThing
from cabinpose.synth.posture.frames import Frames
from cabinpose.synth.posture.neighbours import NOBODY, Neighbours
from cabinpose.synth.posture.seat_fit import SeatFit, fit_child_seat, fit_seat
from cabinpose.synth.posture.seating import CENTRED, SeatOffset


@dataclass(frozen=True, eq=False)
class SeatContext:
    """Somebody in a seat of a car.

    Parameters
    ----------
    person, seat, setting, cabin
        Who sits where, and how the seat is set.
    offset
        Of the pelvis from the seat's place.
    neighbours
        What the people beside and opposite mean for this person.
    on
        The child seat in which the person sits.
    """

    person: Person
    seat: Seat
    setting: SeatSetting
    cabin: Cabin
    offset: SeatOffset = CENTRED
    neighbours: Neighbours = NOBODY
    on: PlacedThing | None = None

    @cached_property
    def fit(self) -> SeatFit:
        """Trunk and thighs of the person in the seat, or in the child seat."""
        if self.on is None or self.on.thing.sitting is None:
            return fit_seat(self.person, self.seat, self.setting.torso_angle)
        seat_from_thing = rp.matmul(invert(self.seat.vehicle_from_seat(self.setting)), self.on.vehicle_from_thing)
        return fit_child_seat(self.person, self.seat, self.setting.torso_angle, self.on.thing.sitting, seat_from_thing)

    @property
    def wheel(self) -> SteeringWheel | None:
        """The steering wheel before this seat."""
        return self.cabin.steering_wheel if self.seat.slot == "driver" else None

    @property
    def forward(self) -> Floats:
        """(3,) vehicle frame, the level direction in which the seat faces."""
        return np.array([rp.cos(self.seat.facing_yaw), rp.sin(self.seat.facing_yaw), 0.0])

    def vehicle_from_root(self, lean: float) -> Matrix:
        """(4, 4) of the pelvis, pitched forward by `lean` (rad), or by more where neighbours leave no room."""
        offset = self.offset._replace(left_m=self.offset.left_m + self.neighbours.aside)
        forwards = transform(rotation_vector((0.0, max(lean, self.neighbours.lean), 0.0)))
        return np.asarray(rp.matmul(self.seat.vehicle_from_seat(self.setting), offset.applied(self.fit.seat_from_root), forwards))


class Trunk(NamedTuple):
    """A trunk as it is in its seat, to which palms and gaze refer before arms, legs and head are solved.

    q: (D,) rad · root: (4, 4) vehicle_from_root · skeleton: of both · wheel_angle: how the wheel before it is turned, rad.
    """

    seated: SeatContext
    q: Floats
    root: Matrix
    skeleton: Frames
    wheel_angle: float = 0.0

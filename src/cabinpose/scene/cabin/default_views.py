"""Camera views for a user's own car without any in its file: in front of and above the seats, in free space inside the car."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from cabinpose.core import OCCUPANT_SLOTS
from cabinpose.scene.cabin.model import Cabin, Seat, ViewAnchor
from cabinpose.scene.contact import ContactField

CLEAR_OF_CAMERA = 0.05  # m from an eye that is chosen here to the nearest surface
_WELL_CLEAR = 0.09  # and what is better: no headlining right above the lens
# Places to try, the best first: m above and ahead of the H-points, and which share of their way from the centre line.
_ABOVE, _AHEAD, _ASIDE = (0.72, 0.66, 0.60, 0.54, 0.48), (0.70, 0.62, 0.78, 0.54, 0.46), (1.0, 0.6, 0.3)
_VIEWS: Mapping[str, tuple[str, ...]] = {
    "driver": ("driver",),
    "front_row": ("driver", "front_passenger"),
    "rear": OCCUPANT_SLOTS[2:],
}


def default_views(cabin: Cabin, given: frozenset[str]) -> tuple[dict[str, ViewAnchor], list[str]]:
    """Views that look at the seats of a cabin, but for those that are given, and notes on the ones that have no free place.

    A place is free by the measure that `synth` judges cameras by: clear of all parts, not inside a closed one, and in the space
    that the seats are in.
    """
    wanted = {name: seats for name, slots in _VIEWS.items() if name not in given and (seats := _seats(cabin, name, slots))}
    if not wanted:
        return {}, []
    settings = {slot: seat.default for slot, seat in cabin.seats.items()}
    placed = ContactField(cabin).at(settings)
    views, notes = {}, []
    for name, seats in wanted.items():
        middle = np.mean([s.design_h_point for s in seats], axis=0)
        forward = seats[0].vehicle_from_seat(seats[0].default)[:3, 0]
        eyes = np.array(
            [middle * (1, aside, 1) + ahead * forward + (0, 0, up) for aside in _ASIDE for up in _ABOVE for ahead in _AHEAD]
        )
        clear = placed.clearance(eyes)
        free = [eye for enough in (_WELL_CLEAR, CLEAR_OF_CAMERA) for eye in eyes[clear >= enough]]
        if free:
            views[name] = ViewAnchor(free[0], middle - 0.10 * forward + (0, 0, 0.32))
        else:
            notes.append(f"view {name}: none of {len(eyes)} places before its seats is free; give one under `views`")
    return views, notes


def _seats(cabin: Cabin, name: str, slots: tuple[str, ...]) -> list[Seat]:
    """The seats that a view looks at; none where it makes no sense in this cabin."""
    there = [cabin.seats[slot] for slot in slots if slot in cabin.seats]
    return [] if name == "front_row" and len(there) < 2 else there

"""The sizes that a car can have, and whether one has them: a wrong unit, axis or origin shows in some of them."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from cabinpose.core import LENGTHS_M, Floats
from cabinpose.scene.cabin.model import Cabin
from cabinpose.scene.contact import first_crossings

UNITS = {name: LENGTHS_M[name] for name in ("m", "cm", "mm", "inch")}  # of a mesh
_FRONT_ROW = ("driver", "front_passenger")
_HEAD_M, _TRUNK_M = 0.63, 0.30  # above the H-point; a sitter's eyes are some 0.63 m over it (SAE J941)
_ROW_M = 0.35  # seats whose H-points are nearer along the car stand in one row
_FAR_M = 6.0  # surfaces farther from a head are not looked for
_EXTENTS = ("length", "width", "height")
_AHEAD = ("heel_before_h_point", "wheel_before_h_point")


class Size(NamedTuple):
    """What a size is, in words and as a drawing calls it, and its limits, m.

    possible: beyond them a car is refused · usual: beyond them it is told.
    """

    words: str
    short: str
    possible: tuple[float, float]
    usual: tuple[float, float]
    why: str


# What cars for the road have, from a two-seater to a minibus, whole or inside. Codes and their limits: SAE J1100.
SIZES: Mapping[str, Size] = {
    "length": Size(
        "the length", "length", (0.8, 12.0), (1.2, 8.0), "12 m is the law's in the EU, 96/53/EC; long vans have 7.4 m"
    ),
    "width": Size("the width", "width", (0.4, 2.8), (1.1, 2.5), "2.55 m is the law's in the EU, 96/53/EC, mirrors beyond"),
    "height": Size("the height", "height", (0.7, 3.3), (0.9, 2.9), "a sports car has 1.1 m inside, a van with a high roof 2.8 m"),
    "h_point_over_heel": Size(
        "the driver's H-point over the heel",
        "H30",
        (0.05, 0.80),
        (0.12, 0.54),
        "H30 is 127 to 405 mm in cars, SAE J3103, up to 530 in trucks, J1517",
    ),
    "passenger_over_heel": Size(
        "the H-point over the heel",
        "H30",
        (0.05, 0.90),
        (0.12, 0.60),
        "as the driver's, on a podium or wheel arch somewhat higher",
    ),
    "heel_before_h_point": Size(
        "the driver's heel before the H-point", "L53", (0.30, 1.15), (0.50, 1.02), "L53 is 600 to 980 mm; legs are no longer"
    ),
    "heel_before_passenger": Size(
        "the heel before the H-point", "L53", (-0.10, 1.20), (0.15, 1.05), "0.45 m behind another seat, 0.9 m with legs stretched"
    ),
    "wheel_before_h_point": Size(
        "the steering wheel before the driver's H-point",
        "wheel ahead",
        (0.15, 0.85),
        (0.25, 0.65),
        "L53 less L11 is 0.3 to 0.55 m",
    ),
    "wheel_over_h_point": Size(
        "the steering wheel above the driver's H-point",
        "wheel above",
        (-0.05, 0.75),
        (0.20, 0.58),
        "H17 less H30 is 0.3 to 0.45 m",
    ),
    "wheel_beside_h_point": Size(
        "the steering wheel beside the driver's H-point",
        "wheel aside",
        (-0.30, 0.30),
        (-0.10, 0.10),
        "W7 is W20 within centimetres",
    ),
    "wheel_diameter": Size(
        "the steering wheel's diameter", "W9", (0.25, 0.60), (0.30, 0.56), "W9 is up to 450 mm in cars, 560 in trucks, J1517"
    ),
    "seat_spacing": Size(
        "from H-point to H-point beside it",
        "spacing",
        (0.20, 2.20),
        (0.28, 1.30),
        "twice W20 is 560 to 960 mm; three share a bench",
    ),
    "seat_pitch": Size(
        "from the rear to the front H-points", "L50", (0.40, 4.00), (0.60, 1.95), "L50 is 640 to 1300 mm, 1900 face to face"
    ),
    "roof_over_h_point": Size(
        "the first surface above the driver's H-point", "roof", (0.55, 2.20), (0.75, 1.45), "H61 less 102 mm is 780 to 1150 mm"
    ),
    "windscreen_before_h_point": Size(
        "the first surface before the driver's eyes",
        "screen",
        (0.25, 3.00),
        (0.35, 1.60),
        "a windscreen's edge is 250 to 800 mm ahead",
    ),
}


class Measure(NamedTuple):
    """One size of a car. name: of `SIZES` · slot: the seat's, empty for the car's own · ends: (2, 3) m, vehicle frame."""

    name: str
    slot: str
    metres: float
    ends: Floats

    @property
    def impossible(self) -> bool:
        """Whether it cannot be right."""
        return not _within(self.metres, SIZES[self.name].possible)

    @property
    def unusual(self) -> bool:
        """Whether it can hardly be right, or cannot."""
        return not _within(self.metres, SIZES[self.name].usual)

    def __str__(self) -> str:
        size = SIZES[self.name]
        low, high = size.possible if self.impossible else size.usual
        whose = f"{self.slot}: " if self.slot not in ("", "driver") else ""
        return f"{whose}{size.words} is {self.metres:.2f} m, in a car {low:g} to {high:g} m ({size.why})"


class SeatPoints(NamedTuple):
    """A seat's points, (3,) m, vehicle frame, and whether its sitter looks backward."""

    h_point: Floats
    heel: Floats
    backward: bool


class SizeVerdict(NamedTuple):
    """What cannot be right of a car, what hardly can, and the cause that would explain it (None: none was found)."""

    errors: tuple[str, ...]
    warnings: tuple[str, ...]
    cause: str | None

    @property
    def hint(self) -> str:
        """What to try."""
        return self.cause or "check the mesh's unit, up and front axis, and the points: docs/own-car.md"

    @property
    def said(self) -> tuple[str, ...]:
        """The warnings, the cause with the first."""
        first = [f"{text} ({self.cause})" if self.cause else text for text in self.warnings[:1]]
        return (*first, *self.warnings[1:])


def measured(cabin: Cabin) -> list[Measure]:
    """The sizes of a car with its seats at their design positions; those of parts that it lacks are left out."""
    surface, wheel = cabin.surface(), cabin.steering_wheel
    places, hub = places_of(cabin), None if wheel is None else wheel.vehicle_from_wheel[:3, 3]
    found = [*extents(*cabin.bounds), *between_points(places, hub)]
    if wheel is not None and hub is not None:
        radius = wheel.rim_radius_m + wheel.rim_section_m
        found.append(_between("wheel_diameter", "", hub - (0.0, radius, 0.0), hub + (0.0, radius, 0.0), 1))
    if "driver" in places:
        found += _to_surfaces(places["driver"], surface.vertices.astype(np.float64)[surface.faces], screen=wheel is not None)
    return found


def places_of(cabin: Cabin) -> dict[str, SeatPoints]:
    """The seats' points at their design positions."""
    return {slot: SeatPoints(s.design_h_point, s.heel_m, s.facing_yaw != 0.0) for slot, s in cabin.seats.items()}


def extents(low: Floats, high: Floats) -> list[Measure]:
    """Length, width and height of the box between two corners (3,) m, along its lower, front and rear edge."""
    return [
        _between("length", "", low, np.array((high[0], low[1], low[2])), 0),
        _between("width", "", np.array((high[0], low[1], low[2])), np.array((high[0], high[1], low[2])), 1),
        _between("height", "", low, np.array((low[0], low[1], high[2])), 2),
    ]


def between_points(places: Mapping[str, SeatPoints], wheel: Floats | None) -> Iterator[Measure]:
    """The sizes between seats, heels and the steering wheel's centre (3,) m."""
    for slot, (h, heel, backward) in places.items():
        foot, whose = np.array((h[0], h[1], heel[2])), "h_point" if slot == "driver" else "passenger"
        yield _between(f"{whose}_over_heel", slot, foot, h, 2)
        yield _between(f"heel_before_{whose}", slot, foot, heel, 0, backward=backward)
    if wheel is not None and "driver" in places:
        h, _, backward = places["driver"]
        level = np.array((wheel[0], h[1], h[2]))
        yield _between("wheel_before_h_point", "driver", h, level, 0, backward=backward)
        yield _between("wheel_over_h_point", "driver", level, level * (1, 1, 0) + (0, 0, wheel[2]), 2)
        yield _between("wheel_beside_h_point", "driver", level, np.array((wheel[0], wheel[1], h[2])), 1)
    rows = [[p.h_point for slot, p in places.items() if (slot in _FRONT_ROW) == front] for front in (True, False)]
    for row in rows:
        for one, other in pairwise(sorted(row, key=lambda h: float(h[1]))):
            if abs(one[0] - other[0]) < _ROW_M:
                yield _between("seat_spacing", "", one, other, 1)
    if all(rows):
        front, rear = (np.mean(row, axis=0) for row in rows)
        yield _between("seat_pitch", "", np.array((rear[0], front[1], front[2])), front, 0)


def _to_surfaces(driver: SeatPoints, corners: Floats, *, screen: bool) -> Iterator[Measure]:
    """What is above the driver, and before the driver's eyes: to the first triangle (F, 3, 3) m on the way."""
    h, _, backward = driver
    trunk, head = h + (0.0, 0.0, _TRUNK_M), h + (0.0, 0.0, _HEAD_M)
    ways = np.array(((0.0, 0.0, _FAR_M), (-_FAR_M if backward else _FAR_M, 0.0, 0.0)))
    (up, ahead), _ = first_crossings(np.stack((trunk, head)), np.stack((trunk, head)) + ways, corners)
    if np.isfinite(up):
        yield _between("roof_over_h_point", "driver", h, trunk + up * ways[0], 2)
    if screen and np.isfinite(ahead):
        yield _between("windscreen_before_h_point", "driver", head, head + ahead * ways[1], 0, backward=backward)


def _between(name: str, slot: str, start: Floats, end: Floats, axis: int, *, backward: bool = False) -> Measure:
    """A size along an axis; backward: it counts against it."""
    return Measure(name, slot, float(end[axis] - start[axis]) * (-1.0 if backward else 1.0), np.stack((start, end)))


def judged(found: Sequence[Measure], places: Mapping[str, SeatPoints], *, steered: bool, unit: str, front: str) -> SizeVerdict:
    """What is wrong with the sizes of a car, and why it may be.

    Parameters
    ----------
    found
        Its sizes.
    places
        Its seats.
    steered
        Whether it has a steering wheel.
    unit, front
        Unit and front axis of its mesh, as they were taken.
    """
    errors = [str(m) for m in found if m.impossible]
    warnings = [str(m) for m in found if m.unusual and not m.impossible]
    backward = [slot for slot, place in places.items() if place.backward]
    if "driver" in backward and steered:
        errors.append("the driver looks backward, and has a steering wheel")
    elif places and len(backward) == len(places):
        warnings.append("all seats look backward")
    return SizeVerdict(
        tuple(errors), tuple(warnings), _cause(found, backward, len(places), unit, front) if errors or warnings else None
    )


def _cause(found: Sequence[Measure], backward: Sequence[str], seats: int, unit: str, front: str) -> str | None:
    """What would explain sizes that are wrong: another unit, the other front axis, an origin on the road."""
    wrong = {m.name: m.metres for m in found if m.unusual}
    box = [m for m in found if m.name in _EXTENTS]
    for other, metres in UNITS.items():
        if wrong.keys() & set(_EXTENTS) and all(_within(m.metres * metres / UNITS[unit], SIZES[m.name].usual) for m in box):
            return f"all sizes fit if the mesh is in {other}: unit {other}"
    if wrong.keys() & set(_EXTENTS) and not _longest_ahead([m.metres for m in box]):
        return "another axis is up or to the front: a car is longest to its front, and lowest upward"
    if "driver" in backward or (seats and len(backward) == seats) or min(wrong.get(name, 0.0) for name in _AHEAD) < 0:
        return f"the seats face backwards: front axis {opposite(front)}"
    if wrong.get("h_point_over_heel", 0.0) > SIZES["h_point_over_heel"].usual[1]:
        return "the origin is on the road: it belongs on the floor, or the seats need a heel_point each"
    return None


def opposite(axis: str) -> str:
    """The axis that points the other way: -x for x."""
    return axis[1:] if axis.startswith("-") else f"-{axis}"


def _longest_ahead(extent: Sequence[float]) -> bool:
    """Whether a box (3,) is longer than wide and wider than high."""
    return extent[0] >= extent[1] >= extent[2]


def _within(value: float, limits: tuple[float, float]) -> bool:
    return limits[0] - 1e-9 <= value <= limits[1] + 1e-9

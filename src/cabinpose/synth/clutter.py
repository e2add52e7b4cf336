"""What lies about in a car, drawn place by place once everybody sits: it is nowhere that anybody, a seat or a lens comes near.

How likely which place has something is assumed; of telephones in holders, the places are those that studies name (windscreen,
dashboard, vent).
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from typing import NamedTuple

import numpy as np

from cabinpose.core import Floats, Matrix, apply, at_rank, axis_rotation, transform
from cabinpose.core import reproducible as rp
from cabinpose.scene.body import PosedBody
from cabinpose.scene.cabin import Cabin, Part
from cabinpose.scene.contact import ContactField, PlacedField
from cabinpose.scene.things import VARIANTS, PlacedThing, Thing, felt, make_thing, stands_free, stands_inside
from cabinpose.synth.casting import Cast
from cabinpose.synth.once import kept_with
from cabinpose.synth.validate import Seated, Validator

CLEAR_M = 0.05  # from the skin of anybody, who has clothes on: nothing is nearer
_LENS_M = 0.15  # nor before a lens
_STEEPEST = rp.cos(math.radians(28.0))  # of what things lie on
_PRESSED_M = 0.010  # into what they lie on, where that is curved
_MIDDLE_VENTS_M, _BESIDE_SCREEN_M = 0.16, 0.21  # from the middle: vents up to there are beside the screen; of a mount
_BAND_M = 0.04  # about the height at which glass is looked for
_FASTENED_TO = {"phone_at_vent": ("vents", "dashboard"), "phone_on_screen": ("windscreen",), "hung_jacket": ("grab handles",)}
_IN_THE_AIR = ("phone_at_vent", "phone_on_screen")  # carried by what they are fastened to
_GAP_M, _STEPS = 0.003, 8  # between a thing and what does not carry it; places that are tried
_SEEN_M = 0.06  # how far the surfaces of a car are looked for: farther than cups stand in their holders
_IN_FRONT, _APART_M = ("gear lever", "screen", "steering column"), 0.006  # of the car, what stands where things may lie
_FLOOR_AHEAD_M = -0.06  # of the heels
_LYING = axis_rotation("x", 0.5 * math.pi)
_KEPT = 512  # things in their places in a car
_SPOTS = 12  # of 36, that they are found again
_SPOTS_M = (-0.03, 0.0, 0.03)  # beside the middle of a place


class ClutterPlace(NamedTuple):
    """A place where something may lie.

    share: how often something does · kinds: how likely what · on: names of the parts that carry it · sunk_m: into them, of a cup
    in its holder · spread: of where it lies (1: all of `_SPOTS_M`) ·
    seat: it is there only while nobody and no child seat is in this seat · held: upright, as it is made, facing back ·
    inwards_m: steps by which it is moved off the glass until it has room, along x.
    """

    share: float
    kinds: Mapping[str, float]
    on: tuple[str, ...] = ()
    sunk_m: float = 0.0
    spread: float = 1.0
    seat: str = ""
    held: bool = False
    inwards_m: float = 0.0


_DRINKS = {"bottle": 0.4, "cup": 0.6}
_ON_FLOOR = {"bottle": 0.4, "papers": 0.2, "bag": 0.25, "tissues": 0.15}
_FLOOR = ("floor mats", "floor")
_CONSOLE = ("centre console", "cup holders")
PLACES_OF_CLUTTER: Mapping[str, ClutterPlace] = {
    "cup_holder_left": ClutterPlace(0.12, _DRINKS, _CONSOLE, sunk_m=0.05, spread=0.0),
    "cup_holder_right": ClutterPlace(0.12, _DRINKS, _CONSOLE, sunk_m=0.05, spread=0.0),
    "console": ClutterPlace(0.15, {"keys": 0.4, "wallet": 0.25, "phone": 0.35}, _CONSOLE, spread=0.4),
    "dashboard": ClutterPlace(
        0.12, {"sunglasses": 0.35, "papers": 0.15, "phone": 0.2, "tissues": 0.15, "wallet": 0.15}, ("dashboard",), inwards_m=-0.03
    ),
    "under_screen": ClutterPlace(0.08, {"ticket": 1.0}, ("dashboard",), inwards_m=-0.03),
    "phone_holder": ClutterPlace(
        0.10, {"phone_at_vent": 0.4, "phone_on_dash": 0.3, "phone_on_screen": 0.3}, ("dashboard",), held=True, inwards_m=-0.03
    ),
    "shelf": ClutterPlace(0.06, {"tissues": 0.5, "papers": 0.2, "pouch": 0.3}, ("parcel shelf",), inwards_m=0.03),
    "floor_front_passenger": ClutterPlace(0.06, _ON_FLOOR, _FLOOR, seat="front_passenger"),
    "floor_rear_left": ClutterPlace(0.05, _ON_FLOOR, _FLOOR, seat="rear_left"),
    "floor_rear_right": ClutterPlace(0.05, _ON_FLOOR, _FLOOR, seat="rear_right"),
    "hook_left": ClutterPlace(0.02, {"hung_jacket": 1.0}, seat="rear_left", held=True),
    "hook_right": ClutterPlace(0.02, {"hung_jacket": 1.0}, seat="rear_right", held=True),
}
"""By name, with how often something is there (assumed)."""
DASHBOARD = "dashboard"
"""The part without which nothing lies about in a car; meshes of a user's own may have none of that name."""
_NEEDED: Mapping[str, tuple[str, ...]] = {  # parts and reach targets, of a place or of a telephone in its holder
    **dict.fromkeys(("cup_holder_left", "cup_holder_right"), ("cup holders",)), "console": ("centre console", "gear_lever"),
    "dashboard": ("glovebox",), "phone_at_vent": ("vents",), "phone_on_dash": ("infotainment",),
    "phone_on_screen": ("windscreen",), "shelf": ("parcel shelf",),
    "hook_left": ("grab handles",), "hook_right": ("grab handles",),
}  # fmt: skip


class _Lying(NamedTuple):
    """A thing where it lies: vehicle_from_thing, the corners (2, 3) m of the box around it, and the parts that carry it."""

    thing: Thing
    at: Matrix
    box: Floats
    on: tuple[str, ...]


class _Carrying(NamedTuple):
    """Triangles on which things may lie: corners (F, 3, 3), and opposite corners (F, 2) of the rectangles around them, m."""

    corners: Floats
    low: Floats
    high: Floats


class LyingAbout:
    """Puts what lies about into cars; where each thing lies in which car is worked out once."""

    def __init__(self, scale: float) -> None:
        """scale: of the shares of `PLACES_OF_CLUTTER`."""
        self._scale = scale

    def about(
        self, cast: Cast, bodies: Sequence[PosedBody], seated: Seated, eye: Floats, *, rng: np.random.Generator
    ) -> tuple[PlacedThing, ...]:
        """What lies about in a car in which people sit: bodies, with `seated` of the same people; eye: (3,) m of the camera."""
        result: list[_Lying] = []
        draws = rng.random((len(PLACES_OF_CLUTTER), 4))
        for (name, place), (chance, which, variant, spot) in zip(PLACES_OF_CLUTTER.items(), draws.tolist(), strict=True):
            if chance >= place.share * self._scale or (place.seat and not _free_seat(cast, place.seat)):
                continue
            chosen = _Drawn(name, at_rank(place.kinds, which), int(variant * VARIANTS), 5 * int(spot * _SPOTS) % 36)
            found = _standing(cast.validator, cast.cabin, chosen)
            if found is not None and _is_clear(found, result, bodies, seated.placed, eye):
                result.append(found)
        return tuple(PlacedThing(one.thing, one.at, "", "car") for one in result)


class _Drawn(NamedTuple):
    """What is to lie where; spot: 0 to 35, which side and which way round."""

    name: str
    kind: str
    variant: int
    spot: int


@kept_with(_KEPT)
def _standing(validator: Validator, cabin: Cabin, chosen: _Drawn) -> _Lying | None:
    """A thing in its place in a car without people, moved inwards until it is in nothing of it; None without room."""
    place = PLACES_OF_CLUTTER[chosen.name]
    for step in range(_STEPS if place.inwards_m and chosen.kind not in _IN_THE_AIR else 1):
        found = _put(cabin, chosen, step)
        if found is not None and (validator.contact is None or _is_in_the_car(found, validator.contact)):
            return found
    return None


def _is_in_the_car(one: _Lying, contact: ContactField) -> bool:
    """Whether a thing is in no part of the car's body, and not beyond it."""
    return all(
        stands_free(felt(group, 0.0, -_GAP_M, one.on), one.thing.cloud, one.at)
        and stands_inside(group, one.thing.cloud, one.at, one.on, _SEEN_M)
        for group in contact.groups
        if group.interior
    )


def _free_seat(cast: Cast, slot: str) -> bool:
    return slot in cast.cabin.seats and slot not in cast.people and all(thing.slot != slot for thing in cast.things)


def _is_clear(
    one: _Lying, others: Iterable[_Lying], bodies: Sequence[PosedBody], placed: PlacedField | None, eye: Floats
) -> bool:
    """Whether nothing that moves, nobody, no other thing and no lens is near."""
    low, high = one.box
    if (np.asarray(eye > low - _LENS_M) & (eye < high + _LENS_M)).all():
        return False
    if any((np.asarray(low < other.box[1]) & (other.box[0] < high)).all() for other in others):
        return False
    for body in bodies:
        near = body.skin
        for axis in range(3):  # few are left after the first
            along = near[:, axis]
            near = near[np.asarray(along > low[axis] - CLEAR_M) & (along < high[axis] + CLEAR_M)]
        if len(near):
            return False
    if placed is None:
        return True
    in_reach = ((placed.low < high) & (placed.high > low)).all(axis=1)
    for n in np.flatnonzero(in_reach).tolist():
        group, _, group_from_vehicle = placed.groups[n]
        if not group.interior and not stands_free(felt(group, 0.0), one.thing.cloud, rp.matmul(group_from_vehicle, one.at)):
            return False
    return True


def _put(cabin: Cabin, chosen: _Drawn, step: int) -> _Lying | None:
    """A thing in its place in a car; None where a car has no such place. step: how often it was moved inwards."""
    name, kind, variant, spot = chosen
    place, thing = PLACES_OF_CLUTTER[name], make_thing(kind, variant)
    parts = _parts(cabin)
    where = _middle(cabin, kind if name == "phone_holder" else name, parts)
    if where is None:
        return None
    where = where + (place.inwards_m * step, 0.0, 0.0)
    if place.on and kind not in _IN_THE_AIR:
        carrying = _carrying(cabin, place.on)
        if not len(carrying.corners):
            return None
        aside = place.spread * np.array((_SPOTS_M[spot % 3], _SPOTS_M[spot // 3 % 3], 0.0))
        yaw = 0.0 if place.held else (2.0 * math.pi / 4.0) * (spot // 9) + 0.35 * (spot % 3 - 1)
        at = _laid(thing, carrying, where + aside, yaw, place)
    else:
        at = transform(None, where)
    if at is None:
        return None
    around = apply(at, thing.surface.vertices.astype(np.float64))
    box = np.stack((around.min(axis=0), around.max(axis=0)))
    before = (parts[part].surface.vertices for part in _IN_FRONT if part in parts)
    if any((np.asarray(v > box[0] - _APART_M) & (v < box[1] + _APART_M)).all(axis=1).any() for v in before):
        return None
    return _Lying(thing, at, box, _FASTENED_TO.get(kind, place.on))


@kept_with(1)
def _parts(cabin: Cabin) -> Mapping[str, Part]:
    """The parts of a car by name."""
    return {part.name: part for part in cabin.parts}


@kept_with(len(PLACES_OF_CLUTTER))
def _carrying(cabin: Cabin, on: tuple[str, ...]) -> _Carrying:
    """The triangles of the parts of these names."""
    parts = _parts(cabin)
    surfaces = [parts[name].surface for name in on if name in parts]
    corners = np.concatenate([np.empty((0, 3, 3)), *(s.vertices[s.faces].astype(np.float64) for s in surfaces)])
    return _Carrying(corners, corners[..., :2].min(axis=1), corners[..., :2].max(axis=1))


def _middle(cabin: Cabin, name: str, parts: Mapping[str, Part]) -> Floats | None:
    """(3,) m: the middle of a place, or of a telephone in a holder; above what carries it; None where a car has none."""
    targets, seats = cabin.reach_targets, cabin.seats
    if "driver" not in seats or not {DASHBOARD, *_NEEDED.get(name, ())} <= {*parts, *targets}:
        return None
    driver = float(np.sign(seats["driver"].design_h_point[1]))
    dash = parts[DASHBOARD].surface.vertices
    high = dash.max(axis=0).astype(np.float64)
    match name:
        case "cup_holder_left" | "cup_holder_right":
            holders = parts["cup holders"].surface.vertices.astype(np.float64)
            low, top = holders.min(axis=0), holders.max(axis=0)
            aside = 0.5 * float((top - low)[1] - (top - low)[0])  # 0 of a single one
            return np.asarray(0.5 * (low + top) + (0.0, aside if name == "cup_holder_left" else -aside, 0.2))
        case "console":
            lever = targets["gear_lever"]
            return np.array((lever[0] - 0.33, 0.0, lever[2] + 0.2))
        case "dashboard":
            glove = targets["glovebox"]
            return np.array((0.5 * (glove[0] + high[0]), glove[1] * 0.9, high[2] + 0.1))
        case "under_screen":
            return np.array((high[0] - 0.17, 0.4 * driver * high[1], high[2] + 0.1))
        case "phone_at_vent":
            vents = parts["vents"].surface.vertices
            outer = vents[driver * vents[:, 1] > _MIDDLE_VENTS_M].astype(np.float64)
            if not len(outer):
                return None
            low, top = outer.min(axis=0), outer.max(axis=0)
            return np.array((low[0] - 0.036, 0.5 * (low[1] + top[1]), 0.5 * (low[2] + top[2]) + 0.02))
        case "phone_on_dash":
            return np.array((targets["infotainment"][0] + 0.10, _BESIDE_SCREEN_M * driver, high[2] + 0.1))
        case "phone_on_screen":
            glass = parts["windscreen"].surface.vertices
            height = float(high[2]) + 0.088  # a telephone upright, clear of the dashboard
            at_height = glass[np.abs(glass[:, 2] - height) < _BAND_M]
            return None if not len(at_height) else np.array((float(at_height[:, 0].min()) - 0.16, 0.20 * driver, height))
        case "shelf":
            shelf = parts["parcel shelf"].surface.vertices.astype(np.float64)
            return np.array(
                (*(0.5 * (shelf.min(axis=0) + shelf.max(axis=0)))[:1], 0.3 * shelf[:, 1].max(), shelf[:, 2].max() + 0.1)
            )
        case "hook_left" | "hook_right":
            handles = parts["grab handles"].surface.vertices.astype(np.float64)
            side = 1.0 if name == "hook_left" else -1.0
            own = handles[side * handles[:, 1] > 0.0]
            return np.array((own[:, 0].max(), side * (np.abs(own[:, 1]).min() - 0.035), own[:, 2].min()))
        case _:
            seat = seats.get(name.removeprefix("floor_"))
            return None if seat is None else seat.heel_m + (_FLOOR_AHEAD_M, 0.0, 0.2)


def _laid(thing: Thing, carrying: _Carrying, where: Floats, yaw: float, place: ClutterPlace) -> Matrix | None:
    """vehicle_from_thing of a thing let down on triangles: tilted as they are; None where they are too steep."""
    lying = _LYING if place.on == _FLOOR and thing.label == "bottle" else np.eye(3)
    turn = rp.matmul(axis_rotation("z", yaw), lying)
    points = apply(transform(turn), thing.surface.vertices.astype(np.float64))
    low, high = points.min(axis=0), points.max(axis=0)
    x, y = (np.linspace(0.97 * low[i], 0.97 * high[i], 5) for i in (0, 1))
    probes = np.stack(np.meshgrid(x, y, indexing="ij"), axis=-1).reshape(-1, 2)
    heights = _heights(carrying, probes + where[:2], float(where[2]))
    if not np.isfinite(heights).all():
        return None
    if place.held or place.sunk_m:
        return transform(turn, np.array((*where[:2], heights[len(heights) // 2] - float(low[2]) - place.sunk_m)))
    columns = np.column_stack((probes, np.ones(len(probes))))
    slope = rp.solve(rp.matmul(columns.T, columns), rp.matmul(columns.T, heights))
    normal = np.array((-slope[0], -slope[1], 1.0))
    normal /= rp.norm(normal)
    if normal[2] < _STEEPEST:
        return None
    above = float((heights - rp.matmul(columns, slope)).max())
    if above > _PRESSED_M:  # it would rock
        return None
    ahead = np.array((1.0, 0.0, 0.0)) - normal[0] * normal
    ahead /= rp.norm(ahead)
    tilt = np.column_stack((ahead, np.cross(normal, ahead), normal))
    return transform(rp.matmul(tilt, turn), np.array((*where[:2], slope[2] + 0.5 * above)) - float(low[2]) * normal)


def _heights(carrying: _Carrying, places: Floats, below: float) -> Floats:
    """(P,) m: of the highest triangle under each place (P, 2) that is below a height; -inf where there is none."""
    low, high = places.min(axis=0), places.max(axis=0)
    over = ((carrying.high >= low) & (carrying.low <= high)).all(axis=1)
    a, b, c = np.moveaxis(carrying.corners[over], 1, 0)
    ab, ac, ap = (b - a)[:, :2], (c - a)[:, :2], places[:, None] - a[None, :, :2]
    area = ab[:, 0] * ac[:, 1] - ab[:, 1] * ac[:, 0]
    across = np.where(np.abs(area) > 1e-12, area, np.inf)  # upright ones are never met
    s = (ap[..., 0] * ac[:, 1] - ap[..., 1] * ac[:, 0]) / across
    t = (ab[:, 0] * ap[..., 1] - ab[:, 1] * ap[..., 0]) / across
    z = a[:, 2] + s * (b - a)[:, 2] + t * (c - a)[:, 2]
    under = np.isfinite(across) & (s >= 0.0) & (t >= 0.0) & (s + t <= 1.0) & (z < below)
    return np.asarray(np.where(under, z, -np.inf).max(axis=1, initial=-np.inf))

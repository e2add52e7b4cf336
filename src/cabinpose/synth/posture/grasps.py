"""How a hand closes around what it holds: where the thing is in the palm, and the curl of each finger.

A grasp is found by trial: the thing is brought into the open hand until it touches it, at several places along the palm; then
each finger closes by itself until it would be pressed in by more than `PRESSED_M`. The place at which most of the hand touches
the thing is taken. A hand that hardly touches it cannot hold it.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

from cabinpose.core import Bools, ConfigError, Floats, Floats32, Ints, Matrix, SceneError, apply, invert, transform
from cabinpose.core import reproducible as rp
from cabinpose.scene.body import BONE_INDEX, DOF_INDEX, LOWER, SEGMENTS, Person, PosedBody
from cabinpose.scene.cabin import SteeringWheel
from cabinpose.scene.contact import TriangleMesh
from cabinpose.scene.things import OBJECTS, THINGS, VARIANTS, Cloud, PlacedThing, Thing, felt, let_down, make_thing, stands_free
from cabinpose.synth.posture.actions import Action
from cabinpose.synth.posture.memory import kept_with_person
from cabinpose.synth.posture.places import GIVE, TAKE, Around, HandPlace, InHand

PRESSED_M = 0.003  # of the skin by what is held; the verdict lets flesh yield by 8 mm
_AT_REST_M = 0.001  # the same while the hand is still open
_TOUCHES_M = 0.005  # skin as near as this touches: fingers are not as smooth as the mesh
_LEAST_TOUCHING = 12  # vertices of the skin, of those that are measured
_CURLS = np.linspace(-0.4, 1.0, 57)  # a thumb opens wider than at rest
OPEN_HAND = np.array((-0.4, 0.0, 0.0, 0.0, 0.0))  # thumb to little finger
_LOOSE = np.array((0.1, 0.35, 0.35, 0.35, 0.35))  # of fingers that meet nothing
_ALONG_M = (-0.015, -0.005, 0.005, 0.015, 0.03)
_FARTHEST_M, _NEAREST_M = 0.075, -0.03  # of the thing's middle before the palm's origin
_ONE_SIDED = 0.85  # length of the mean direction to where a hand touches: 0.64 for half of a cylinder, 1 for one side
_COARSE = 4  # curls at a time
_EVERY = 2  # of the hand's vertices
# Of a full curl around a rim: knuckles of index to little finger, PIP joint, DIP joint beyond that; what share of the way to
# the rim each joint goes, so that knuckles leave some of it to the next ones (assumed).
_MOST_KNUCKLE, _MOST_PIP, _BEYOND_PIP, _OF_CONTACT = (0.6, 0.6, 0.7, 0.85), 0.85, 0.35, (0.8, 1.0, 0.9)
_PULP_FROM = 0.3  # of a phalanx: the skin before that is a web's, or a palm's


class Grasp(NamedTuple):
    """The curl of each finger, thumb to little finger (5,), 1 a fist, and palm_from_thing (4, 4) of a left hand."""

    curl: Floats
    palm_from_thing: Matrix


class Hold(NamedTuple):
    """What somebody is to hold, and in which hand: kind, design, side (0 left, 1 right).

    place: for which it was taken into the hand; `TAKE`: of what was taken from another hand.
    """

    kind: str
    variant: int
    side: int
    grasp: Grasp
    place: HandPlace

    @property
    def fingers(self) -> Floats:
        """(2, 5) curl of this hand's fingers, NaN for the other hand's; as `Person.pose` takes it."""
        curl = np.full((2, 5), np.nan)
        curl[self.side] = self.grasp.curl
        return curl

    def placed(self, vehicle_from_palm: Matrix) -> Matrix:
        """vehicle_from_thing, (4, 4), of the thing in this hand. Things are their own mirror images in y = 0."""
        mirror = np.diag((1.0, 1.0 - 2.0 * self.side, 1.0, 1.0))
        return np.asarray(rp.matmul(vehicle_from_palm, mirror, self.grasp.palm_from_thing, mirror))

    @property
    def in_hand(self) -> InHand:
        """Where it is in this hand."""
        mirror = np.diag((1.0, 1.0 - 2.0 * self.side, 1.0, 1.0))
        height_m = float(make_thing(self.kind, self.variant).box[1, 2])
        return InHand(rp.matmul(mirror, self.grasp.palm_from_thing, mirror), height_m)

    def thing(self, slot: str, body: PosedBody) -> PlacedThing:
        """The thing in the hand of a body that sits in a seat."""
        return PlacedThing(make_thing(self.kind, self.variant), self.placed(body.palms["lr"[self.side]]), slot, "hand")


def inboard_hand(action: Action, held: Hold, inboard: int) -> int | None:
    """Which hand does the inboard part of an action while the other one, or this one, holds a thing.

    None where that hand is needed without it, or another thing is asked for. inboard: the hand that reaches for what is there.
    """
    hands = ((action.inboard, held.side), (action.outboard, 1 - held.side))
    asked = [(place, s) for place, s in hands if place.held is not None]
    found = [s for place, s in asked if serves(held, place)] if asked else [s for place, s in hands if place.spared]
    return next((s for s in found if not action.targets or s == inboard), None)


def serves(held: Hold, place: HandPlace) -> bool:
    """Whether a thing is what a hand needs at a place; a hand that leaves room for another one's is too high or low to drink."""
    return place.name in THINGS[held.kind].held_at and held.place.passes_on == place.passes_on


def handed(place: HandPlace, named: Sequence[str] = (), *, rng: np.random.Generator) -> list[tuple[str, int]]:
    """Every kind and design that hands hold at a place, in random order: of those `named`, or else of our own.

    Raises ConfigError where there is none.
    """
    kinds = [name for name in named if place.name in THINGS[name].held_at]
    kinds = kinds or [name for name, kind in OBJECTS.items() if place.name in kind.held_at]
    if not kinds:
        raise ConfigError(f"hands hold nothing at the place '{place.name}'", hint="name a thing that they do in scene.held")
    designs = [(kind, variant) for kind in kinds for variant in range(VARIANTS)]
    return [designs[n] for n in rng.permutation(len(designs)).tolist()]


def can_hold(person: Person, place: HandPlace, kind: str, variant: int) -> bool:
    """Whether a person's hand closes around a thing."""
    return _grasp(person, place, kind, variant) is not None


def hold(person: Person, place: HandPlace, kind: str, variant: int, side: int) -> Hold:
    """How a person holds a thing; SceneError where the hand cannot."""
    found = _grasp(person, place, kind, variant)
    if found is None:
        size = 1000.0 * np.ptp(make_thing(kind, variant).box, axis=0)
        raise SceneError(
            f"no hand of a person of {person.stature_m:.2f} m closes around a {kind} of {size[0]:.0f} x {size[1]:.0f} x"
            f" {size[2]:.0f} mm",
            hint="let somebody taller hold it, or choose another action",
        )
    return Hold(kind, variant, side, found, place)


class _Hand(NamedTuple):
    """Skin of a left hand and forearm, (N, 3) m of the palm frame, at each of `_CURLS`; finger: (N,) 0 to 4, -1 the rest."""

    skin: Floats32  # (C, N, 3)
    finger: Ints

    def at(self, curl: Floats) -> Floats32:
        """(N, 3) m with each finger at its curl (5,)."""
        of_finger = np.searchsorted(_CURLS, curl - 1e-9)
        rest = int(np.searchsorted(_CURLS, -1e-9))
        which = np.where(self.finger >= 0, of_finger[self.finger], rest)
        return self.skin[which, np.arange(len(self.finger))]


@kept_with_person
def _hand(person: Person) -> _Hand:
    rows = np.flatnonzero(np.isin(person.skin_segment, [SEGMENTS.index(s) for s in ("lhand", "lforearm")]))[::_EVERY]
    part, q = person.skin_part(rows), np.zeros(len(LOWER))
    palm_from_root = invert(person.pose(q, np.eye(4)).palms["l"])
    skin = []
    for curl in _CURLS:
        q[DOF_INDEX["lhand.grip"]] = curl
        skin.append(apply(palm_from_root, part(q, np.eye(4))))
    bone = person.leading_bone[rows]
    finger = np.full(len(rows), -1)
    for number in range(5):
        finger[np.isin(bone, [BONE_INDEX[f"lfinger{number + 1}_{phalanx}"] for phalanx in (1, 2, 3)])] = number
    return _Hand(np.stack(skin).astype(np.float32), finger)


@kept_with_person
def _grasp(person: Person, place: HandPlace, kind: str, variant: int) -> Grasp | None:
    assert place.held is not None
    thing, hand, around = make_thing(kind, variant), _hand(person), isinstance(place.held, Around)
    turned, best, most = place.held.turned(thing.box), None, _LEAST_TOUCHING - 1
    opened = Cloud.of(hand.at(OPEN_HAND))
    for along in _ALONG_M:
        grasp, touching = _closed(thing, hand, _brought_near(thing, turned, opened, along), around=around)
        if touching > most:
            most, best = touching, grasp
    return best


def other_place(held: Hold) -> HandPlace:
    """Where another hand holds what one holds that passes it on."""
    return TAKE if held.place is GIVE else GIVE


def closed_around(person: Person, held: Hold, palm_from_thing: Matrix, side: int) -> Hold | None:
    """How a hand (0 left, 1 right) holds what another one holds, as it is in the palm (4, 4); None where it cannot."""
    mirror = np.diag((1.0, 1.0 - 2.0 * side, 1.0, 1.0))
    at = rp.matmul(mirror, palm_from_thing, mirror)
    grasp, touching = _closed(make_thing(held.kind, held.variant), _hand(person), at, around=True)
    return held._replace(side=side, grasp=grasp, place=other_place(held)) if touching >= _LEAST_TOUCHING else None


def _closed(thing: Thing, hand: _Hand, palm_from_thing: Matrix, *, around: bool) -> tuple[Grasp, int]:
    """Fingers closed around a thing, and how many vertices touch it: none where the hand is in it, or not `around` it."""
    thing_from_palm = invert(palm_from_thing)
    pressed, bound = (felt(thing.field, 0.0, depth) for depth in (PRESSED_M, PRESSED_M + _AT_REST_M))
    curl = OPEN_HAND.copy()
    for finger in range(5):
        mine = hand.skin[:, hand.finger == finger]

        def closed(tried: int, mine: Floats32 = mine) -> bool:
            return stands_free(pressed, Cloud.of(mine[tried]), thing_from_palm)

        last = _last_free(closed, float(curl[finger]))
        curl[finger] = _LOOSE[finger] if last == len(_CURLS) - 1 else _CURLS[last]
    closed_hand = Cloud.of(hand.at(curl))
    skin = apply(thing_from_palm, closed_hand.points)
    touches = _touch(thing, skin)
    touching = int(touches.sum())
    possible = touching >= _LEAST_TOUCHING and stands_free(bound, closed_hand, thing_from_palm)
    possible = possible and (not around or _encloses(skin[touches]))
    return Grasp(curl, palm_from_thing), touching if possible else 0


def _encloses(touching: Floats) -> bool:
    """Whether points (N, 3) that touch a thing lie all around its upright axis, and not on one side of it."""
    around = touching[:, :2] / np.maximum(np.linalg.norm(touching[:, :2], axis=1, keepdims=True), 1e-9)
    return rp.norm(around.mean(axis=0)) < _ONE_SIDED


def fingers_closed_on(
    person: Person, mesh: TriangleMesh, vehicle_from_palm: Matrix, side: int, *, shell_m: float = 0.0
) -> Floats:
    """(5,) curl of fingers that close from the open hand until each touches a surface (vehicle frame); loose where none does.

    side: 0 left, 1 right · vehicle_from_palm: of that hand, (4, 4) · shell_m: thickness of an open surface, felt on both sides.
    """
    hand, curl = _hand(person), _LOOSE.copy()
    mirror = np.diag((1.0, 1.0 - 2.0 * side, 1.0, 1.0))
    from_skin = rp.matmul(vehicle_from_palm, mirror)
    for finger in range(5):
        start = int(np.searchsorted(_CURLS, OPEN_HAND[finger] - 1e-9))
        mine = hand.skin[start:, hand.finger == finger]

        def met(rows: slice, mine: Floats32 = mine) -> Ints:
            points = apply(from_skin, mine[rows].reshape(-1, 3).astype(np.float64))
            distance = mesh.signed_distance(points, _TOUCHES_M + shell_m).reshape(-1, mine.shape[1]).min(axis=1)
            return np.flatnonzero(distance < shell_m)

        coarse = met(slice(0, None, _COARSE))
        if len(coarse):
            last = _COARSE * int(coarse[0])
            first = max(last - _COARSE, 0)
            curl[finger] = _CURLS[start + max(first + int(met(slice(first, last + 1))[0]) - 1, 0)]
    return curl


_Point = tuple[float, float]  # not a complex number: whether a processor rounds twice in their product is its own affair


class _Chain(NamedTuple):
    """A finger of a flat hand in the plane in which it bends; its points are a m along the hand and b m out of the palm.

    aside: m of the plane, x of the hand's bone · joints: MCP, PIP, DIP joint and tip · thick: m from each phalanx's axis to its
    skin · full: rad of each joint at a full curl · most: of that, of the knuckle around a rim.
    """

    aside: float
    joints: tuple[_Point, ...]
    thick: tuple[float, ...]
    full: tuple[float, ...]
    most: float


@kept_with_person
def _chains(person: Person, side: int) -> tuple[_Chain, ...]:
    """Of index to little finger."""
    rest, s, bone = person.rest, 1.0 - 2.0 * side, BONE_INDEX["lr"[side] + "hand"]
    hand = np.flatnonzero(person.skin_segment == SEGMENTS.index("lr"[side] + "hand"))
    leading, every = person.leading_bone[hand], rp.matmul(person.rest_skin[hand] - rest.heads[bone], rest.frames[bone])
    result = []
    for finger, most in enumerate(_MOST_KNUCKLE, 2):
        bones = [BONE_INDEX[f"{'lr'[side]}finger{finger}_{phalanx}"] for phalanx in (1, 2, 3)]
        heads = rp.matmul(rest.heads[bones] - rest.heads[bone], rest.frames[bone])
        joints: list[_Point] = list(zip((-heads[:, 2]).tolist(), (-s * heads[:, 1]).tolist(), strict=True))
        thick = []
        for k, phalanx in enumerate(bones):
            skin = every[leading == phalanx]
            x, y = -skin[:, 2] - joints[k][0], -s * skin[:, 1] - joints[k][1]
            if k == 2:
                joints.append((joints[2][0] + float(x.max()), joints[2][1] + float(y.mean())))
            c, d = _between(joints[k], joints[k + 1])
            length = _length((c, d))
            ahead, out = (x * c + y * d) / length, (y * c - x * d) / length
            thick.append(float(out[ahead > _PULP_FROM * length].max()))
        turns = rest.finger_axes[[b - BONE_INDEX["lfinger1_1"] for b in bones]]
        full = np.abs(rp.matmul(turns, rest.frames[bone][:, 0])) * rest.finger_curl[[b - BONE_INDEX["lfinger1_1"] for b in bones]]
        result.append(_Chain(float(heads[0, 0]), tuple(joints), tuple(thick), tuple(full.tolist()), most))
    return tuple(result)


def fingers_around_rim(person: Person, wheel: SteeringWheel, vehicle_from_hand: Matrix, side: int) -> Floats:
    """(4, 3) curl of the phalanges of index to little finger that close around a wheel's rim, joint after joint from the knuckle.

    Each phalanx bends until it touches the rim, in the plane in which its finger bends, or as far as hands bend it.
    side: 0 left, 1 right · vehicle_from_hand: of that hand's bone, (4, 4).
    """
    s, radius = 1.0 - 2.0 * side, wheel.rim_radius_m
    hand_from_wheel = rp.matmul(invert(vehicle_from_hand), wheel.vehicle_from_wheel)
    one, two, middle = (hand_from_wheel[:3, k].tolist() for k in (0, 1, 3))
    steep, turned = rp.hypot(one[0], two[0]), rp.arctan2(two[0], one[0])
    palm = person.rest.palms[side][:3, 3].tolist()
    sign = 0.0
    curl = []
    for chain in _chains(person, side):
        # The rim's middle line goes through the plane at two places: the one of all fingers is nearer to the palm.
        half = rp.arccos(min(max((chain.aside - middle[0]) / (radius * steep), -1.0), 1.0))
        places = []
        for turn in (sign,) if sign else (1.0, -1.0):
            c, d = radius * rp.cos(turned + turn * half), radius * rp.sin(turned + turn * half)
            y, z = (middle[axis] + c * one[axis] + d * two[axis] for axis in (1, 2))
            places.append(((y - palm[1]) ** 2 + (z - palm[2]) ** 2, turn, (-z, -s * y)))
        _, sign, rim = min(places)
        curl.append(_closed_finger(chain, rim, wheel.rim_section_m))
    return np.array(curl)


def _closed_finger(chain: _Chain, rim: _Point, section_m: float) -> list[float]:
    """The curl of each phalanx of a finger around a rim whose axis goes through its plane at `rim`."""
    bent, turn = [0.0, 0.0, 0.0], (1.0, 0.0)
    joint = chain.joints[0]
    for k, full in enumerate(chain.full):
        phalanx = _turned(_between(chain.joints[k], chain.joints[k + 1]), turn)
        angle = _until_touch(_between(joint, rim), phalanx, section_m + chain.thick[k])
        most = (chain.most, _MOST_PIP, min(bent[1] + _BEYOND_PIP, 1.0))[k]
        bent[k] = min(max(_OF_CONTACT[k] * angle / full, 0.0), most)
        turned = (float(rp.cos(bent[k] * full)), float(rp.sin(bent[k] * full)))
        x, y = _turned(phalanx, turned)
        joint, turn = (joint[0] + x, joint[1] + y), _turned(turn, turned)
    return bent


def _until_touch(rim: _Point, phalanx: _Point, apart: float) -> float:
    """rad by which a phalanx that begins at 0 turns until it is `apart` m from `rim`; inf where it never is."""
    length, far = _length(phalanx), max(_length(rim), apart)
    along, out = _turned(rim, (phalanx[0], -phalanx[1]))
    ahead = float(rp.arctan2(out, along))
    if far * far - apart * apart <= length * length:
        return ahead - float(rp.arcsin(apart / far))
    cosine = (far * far + length * length - apart * apart) / (2.0 * far * length)  # its end touches first
    return ahead - float(rp.arccos(cosine)) if cosine < 1.0 else math.inf


def _turned(a: _Point, turn: _Point) -> _Point:
    """A point turned by the angle of `turn` from the first axis, and longer by its length."""
    return a[0] * turn[0] - a[1] * turn[1], a[0] * turn[1] + a[1] * turn[0]


def _between(a: _Point, b: _Point) -> _Point:
    return b[0] - a[0], b[1] - a[1]


def _length(a: _Point) -> float:
    return math.sqrt(a[0] * a[0] + a[1] * a[1])


def _brought_near(thing: Thing, turned: Matrix, hand: Cloud, along: float) -> Matrix:
    """palm_from_thing of a thing that is brought to the palm of a hand (palm frame) as near as it lets it."""

    def at(off: float) -> Matrix:
        return np.asarray(rp.matmul(transform(None, (along, 0.0, off)), turned))

    untouched = felt(thing.field, 0.0, _AT_REST_M)

    def free(off: float) -> bool:
        return stands_free(untouched, hand, invert(at(off)))

    return at(let_down(free, _FARTHEST_M, _NEAREST_M))


def _last_free(closed: Callable[[int], bool], start: float) -> int:
    """The number of the last of `_CURLS` up to which a finger closes, of those from `start` on."""
    low = int(np.searchsorted(_CURLS, start - 1e-9))
    for coarse in (_COARSE, 1):  # a finger that is beyond a thin thing is free again
        while low + coarse < len(_CURLS) and closed(low + coarse):
            low += coarse
    return low


def _touch(thing: Thing, points: Floats) -> Bools:
    """Which of the points (N, 3), thing frame, are at the surface of a piece."""
    near = [np.abs(part.mesh.signed_distance(points, 2.0 * _TOUCHES_M)) < _TOUCHES_M for part in thing.field.parts]
    return np.asarray(np.any(near, axis=0))

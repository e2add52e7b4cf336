"""Everybody in a car posed at once by `_native.pose.solve_people`: what is sought, what may touch what, and what is left.

The solver works with samples of the skin, the verdict of `synth.validate` with all of it: so the solver asks for a little more
room than the verdict does.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal, NamedTuple

import numpy as np

from cabinpose._native import pose as native
from cabinpose.core import CABINPOSE, Floats, Ints, Ints32, Matrix
from cabinpose.scene.body import Person, RestArrays
from cabinpose.scene.contact import BOTH_YIELD_M, PAIRS, SOLIDS, WHEEL_GROUP, GroupField, PlacedField
from cabinpose.synth.posture.samples import Samples, samples_of

_OF_TOLERANCE = 0.0  # of what the verdict lets a body's own solids overlap
_OF_FOLDS = 1.0  # the same between trunk and thighs: sitting makes folds there
_BETWEEN_M = 0.25 * BOTH_YIELD_M  # the same of two people
_IN_OWN_SEAT_M = -0.012  # trunk and thighs sink in by this less than cushion and backrest give
Stand = Literal["fresh", "settled", "fixed"]
_STANDS: tuple[Stand, ...] = ("fresh", "settled", "fixed")  # as the kernel counts them
_WITH_CAR = 3  # of the kinds of squeeze: none, with oneself, with another person, with the car
_FINE = ("hand", "foot", "forearm", "upper_arm", "head", "shin", "thigh", "torso")  # their samples, the closest first
_MARGIN_M = 0.008  # that limbs keep from what gives no more, for the skin between the samples
_UNDER_FEET_M = 0.003  # shoes stand on floor and pedals
_IN_HAND_M = -0.002  # a hand is closed around the rim
_FEET = [SOLIDS.index(name) for name in ("lfoot", "rfoot")]
_BESIDE = np.where(np.isin(np.arange(len(SOLIDS)), _FEET), _MARGIN_M + _UNDER_FEET_M, 0.0)  # feet, from what they do not stand on
_SITTING = [SOLIDS.index(name) for name in ("torso", "lthigh", "rthigh")]


class Goals(NamedTuple):
    """What one person seeks; D degrees of freedom, T tasks.

    posture, stiffness: (D,) the comfortable posture (rad) and the weight of departing from it · lower, upper: (D,) bounds ·
    root: (4, 4) `vehicle_from_root` sought, root_weight: (6,) along and about its axes · bone: (T,) the main bone that carries a
    tool, tool: (T, 4, 4) bone_from_tool · base, target: (T,) the bone that carries a target (-1: the vehicle) and (T, 4, 4)
    base_from_target · weight: (T, 6) along and about the target's axes, 1/m and 1/rad, 0 where it is free.
    """

    posture: Floats
    stiffness: Floats
    lower: Floats
    upper: Floats
    root: Matrix
    root_weight: Floats
    bone: Ints32
    tool: Floats
    base: Ints32
    target: Floats
    weight: Floats


class Sitter(NamedTuple):
    """Somebody for `solve`: q (D,) and root (4, 4) are where the search begins, and are written in place.

    slot: the seat, middle: y of its middle, m · crossed: whether the legs are crossed on purpose · holds: whether the left and
    right hand are closed around the wheel · stand: whether this one goes to its goals through everything first, has been solved
    and gives way, or stays.
    """

    person: Person
    slot: str
    goals: Goals
    q: Floats
    root: Matrix
    holds: tuple[bool, bool] = (False, False)
    stand: Stand = "fresh"
    middle: float = 0.0
    crossed: bool = False


class _Mover(NamedTuple):
    """A `Sitter` as the kernel takes it; S solids, G groups of the car.

    leave: (S, G) m by which a solid may go deeper into a group · beside: (S,) m that it keeps from what it does not stand on,
    beside that · way: (G, 3) the only way out of a group that is thin and behind or below, 0: any.
    """

    rest: RestArrays
    samples: Samples
    goals: Goals
    leave: Floats
    beside: Floats
    way: Floats
    middle: float
    q: Floats
    root: Matrix
    stand: int


class _PlacedGroup(NamedTuple):
    """A group of the car's parts where it stands; bones stay out of foam that gives by `give` m (0: they are not tested).

    walls: whether it is the body with its thin walls, of which the side next to a person's seat counts.
    """

    field: GroupField
    group_from_vehicle: Matrix
    give: float
    walls: bool


class _TestedPairs(NamedTuple):
    """Which solids of a body are tested with each other: points of the first against the surface of the second.

    pairs: (P, 2) solids, with allowed: (P,) m of overlap, joint_ends: (P, 2) joints or -1 and zones: (P,) of a `Pair` · side:
    (P,) +1, -1 where the first is the left, the right leg against the other one; else 0 · axes: (A, 3) solid and joints of
    each bone that must stay out of foam, axis_from: (A,) the share of it that is left out.
    """

    pairs: Ints
    allowed: Floats
    joint_ends: Ints
    zones: Floats
    side: Ints
    axes: Ints
    axis_from: Floats


class Left(NamedTuple):
    """What a solution leaves of one person: missed (T, 2) m and rad by each task, and the worst squeeze that remains.

    squeeze_m: more than is allowed (0: none) · into: the solid, group or person's solid that does not give way, by name.
    """

    missed: Floats
    squeeze_m: float
    solid: str
    into: str


def _side(solid: str) -> int:
    """+1 for hands, forearms and legs on the left, -1 for those on the right, else 0."""
    return {"l": 1, "r": -1}[solid[0]] if solid[1:] in ("hand", "forearm", "thigh", "shin", "foot") else 0


def _pairs() -> _TestedPairs:
    rank = {name: _FINE.index(name if name in _FINE else name[1:]) for name in SOLIDS}
    folds = {"torso", "lthigh", "rthigh"}
    ordered = [sorted((p.one, p.two), key=rank.__getitem__) for p in PAIRS]
    axes = [
        (SOLIDS.index(s + name), CABINPOSE.index[s + start], CABINPOSE.index[s + end])
        for s in "lr"
        for name, start, end in (("upper_arm", "shoulder", "elbow"), ("forearm", "elbow", "wrist"), ("hand", "wrist", "hand"))
    ]
    return _TestedPairs(
        pairs=np.array([[SOLIDS.index(name) for name in pair] for pair in ordered], np.int64),
        allowed=np.array([(_OF_FOLDS if {p.one, p.two} <= folds else _OF_TOLERANCE) * p.tolerance_m for p in PAIRS]),
        joint_ends=np.array([CABINPOSE.indices((p.joint, p.end)) if p.joint else [-1, -1] for p in PAIRS], np.int64),
        zones=np.array([p.zone for p in PAIRS]),
        side=np.array([_side(one) if _side(one) * _side(two) < 0 else 0 for one, two in ordered], np.int64),
        axes=np.array(axes, np.int64),
        axis_from=np.array([0.4, 0.0, 0.0] * 2),  # shoulders lean into the backrest
    )


_PAIRS = _pairs()
_CROSSED_PAIRS = _PAIRS._replace(side=np.zeros_like(_PAIRS.side))  # no limb is pushed back to its own side


def solve(sitters: Sequence[Sitter], placed: PlacedField | None, *, free: bool = False) -> list[Left]:
    """Pose everybody, in place of their q and root, in the car as `placed` (None: without one); `free`: whatever may touch."""
    groups = () if placed is None else placed.groups
    names = [field.name for field, _, _ in groups]
    car = [
        _PlacedGroup(field, back, field.give_m if field.name.endswith("/back") else 0.0, field.interior)
        for field, _, back in groups
    ]
    people, missed = [], []
    for sitter in sitters:
        leave = np.full((len(SOLIDS), len(names)), -_MARGIN_M)
        leave[_FEET] = _UNDER_FEET_M
        way = np.zeros((len(names), 3))
        for g, name in enumerate(names):
            if name.startswith(f"seat:{sitter.slot}/"):
                leave[_SITTING, g] = _IN_OWN_SEAT_M
                axis = {"back": 0, "base": 2}.get(name.partition("/")[2])
                if axis is not None:
                    way[g] = groups[g][1][:3, axis]
            if name == WHEEL_GROUP:
                for side, holds in zip("lr", sitter.holds, strict=True):
                    if holds:
                        leave[SOLIDS.index(side + "hand"), g] = _IN_HAND_M
        people.append(
            _Mover(
                sitter.person.rest, samples_of(sitter.person), sitter.goals, leave=leave, beside=_BESIDE, way=way,
                middle=sitter.middle, q=sitter.q, root=sitter.root, stand=_STANDS.index(sitter.stand),
            )
        )  # fmt: skip
        missed.append(np.zeros((len(sitter.goals.bone), 2)))
    pairs = _CROSSED_PAIRS if any(sitter.crossed for sitter in sitters) else _PAIRS
    found = native.solve_people(people, car, pairs, between=_BETWEEN_M, free=free, missed=missed)
    result = []
    for off, (kind, solid, other, excess) in zip(missed, found, strict=True):
        into = "" if kind == 0 else names[other] if kind == _WITH_CAR else SOLIDS[other]
        result.append(Left(off, excess, SOLIDS[solid] if kind else "", into))
    return result

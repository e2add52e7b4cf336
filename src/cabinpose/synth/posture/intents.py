"""What hands do: an action's places, and what they hold."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from cabinpose.scene.body import Person
from cabinpose.synth.posture import hands as at
from cabinpose.synth.posture.actions import Action, target_name
from cabinpose.synth.posture.context import SeatContext
from cabinpose.synth.posture.grasps import Hold, can_hold, handed, hold, serves
from cabinpose.synth.posture.places import CARRY, THIGH, Around, Hand, Reach

Hands = tuple[Hand, Hand]  # left, right


def intents(action: Action, seated: SeatContext, inboard: int, given: Reach | None, *, rng: np.random.Generator) -> Hands:
    """What each hand does, left then right.

    inboard: the hand (0 left, 1 right) that does the inboard part · given: where hands reach that have no place of the cabin.
    """
    clock_key = float(rng.random())
    name = target_name(action, seated.seat, seated.cabin)
    target = None if name is None else seated.cabin.reach_targets[name]
    result = []
    for side in (0, 1):
        mine, other = (action.inboard, action.outboard) if side == inboard else (action.outboard, action.inboard)
        place = mine.chosen(seated, other, side == inboard, float(rng.random()))
        a, b, c = (float(v) for v in np.clip(rng.standard_normal(3), -2.0, 2.0))
        result.append(Hand(place, (a, b, c), 0.0, place.reach(seated, target, given, (a, b, c))))
    at_wheel = [hand.place.on_wheel for hand in result]
    left, right = at.clocks(clock_key, alone=sum(at_wheel) == 1).tolist()
    return result[0]._replace(clock=left), result[1]._replace(clock=right)


def with_fingers(hands: Hands, seated: SeatContext) -> Hands:
    """The same hands with fingers as they lie there; those of a palm that is given follow the grip."""
    wheel = seated.wheel
    rim = None if wheel is None else at.rim_grip(seated.person, wheel.rim_section_m).grip
    left, right = (h if h.palm is not None else h._replace(fingers=h.place.fingers(h.noise, rim)) for h in hands)
    return left, right


def holding(person: Person, hands: Hands, named: Sequence[str] = (), *, rng: np.random.Generator) -> tuple[Hands, Hold | None]:
    """What one of the hands holds, the first design that fits into it; a second hand beside it goes to the lap.

    named: kinds, in place of those that hands usually hold.
    """
    able = [side for side in (0, 1) if hands[side].place.held is not None]
    if not able:
        return hands, None
    side = able[int(rng.integers(len(able)))]
    place = hands[side].place
    order = handed(place, named, rng=rng)
    kind, variant = next((d for d in order if can_hold(person, place, *d)), order[0])
    held = hold(person, place, kind, variant, side)
    rest = [h._replace(place=THIGH) if s != side and s in able else h for s, h in enumerate(hands)]
    rest[side] = rest[side]._replace(thing=held.in_hand)
    return (rest[0], rest[1]), held


def carrying(hands: Hands, carried: Hold) -> Hands:
    """The hands of somebody who holds a thing all the time: over the lap, where the action has no use for it."""
    mine, other = hands[carried.side], hands[1 - carried.side]
    if not serves(carried, mine.place):
        below_m = -float(carried.grasp.palm_from_thing[1, 3]) if isinstance(carried.place.held, Around) else None
        mine = mine._replace(place=CARRY, below_m=below_m)
    mine = mine._replace(thing=carried.in_hand)
    other = other._replace(place=THIGH) if other.place.held is not None else other
    return (mine, other) if carried.side == 0 else (other, mine)

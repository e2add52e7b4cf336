"""Activities: short programs of actions, one after the other."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from types import MappingProxyType
from typing import NamedTuple

from cabinpose.scene.cabin import Cabin, Seat
from cabinpose.synth.posture.actions import ACTIONS, HOLDING, IN_CHILD_SEAT, actions_for, inboard_side
from cabinpose.synth.posture.grasps import Hold, inboard_hand
from cabinpose.synth.posture.neighbours import beside_each_other


class Step(NamedTuple):
    """A pose of an activity: the action, how long it is held (s, mean), and whether a driver turns the wheel on the way.

    haste: speed against the person's usual one · at_neighbour: whether the hand goes to the arm of whoever sits beside.
    """

    action: str
    hold_s: float = 0.4
    steers: bool = False
    haste: float = 1.0
    at_neighbour: bool = False


# What takes more than one action; every other action is an activity of one step.
_PROGRAMS: Mapping[str, tuple[Step, ...]] = MappingProxyType(
    {
        "steer": (Step("drive", 0.3, True), Step("drive", 0.2, True), Step("drive", 0.3, True)),
        "check_mirror": (Step("look_mirror", 0.5), Step("drive", 0.4)),
        "operate": (Step("reach_infotainment", 0.6), Step("drive", 0.3)),
        "phone_call": (Step("phone_text", 0.8), Step("phone_ear_outer", 1.5), Step("phone_text", 0.4)),
        "drink": (Step("drink", 1.0), Step("rest_lap", 0.3)),
        "eat": (Step("at_mouth", 0.4), Step("phone_text", 0.5), Step("at_mouth", 0.4), Step("phone_text", 0.5)),
        "read": (Step("read", 3.0),),
        "look_over_shoulder": (Step("look_back", 0.5), Step("rest_lap", 0.3)),
        "turn_to_back_seat": (Step("turn_back", 1.5), Step("rest_lap", 0.3)),
        "hand_over": (Step("hand_over", 0.3), Step("rest_lap", 0.3)),
        "hit": (Step("hit", 0.1, haste=3.0, at_neighbour=True), Step("rest_lap", 0.4)),
        "buckle_up": (Step("belt", 0.3), Step("rest_lap", 0.3)),
        "reach_down": (Step("reach_floor", 0.5), Step("rest_lap", 0.3)),
        "sleep": (Step("sleep", 5.0),),
    }
)
# The place of the hand in activities that need something in it.
HELD_AT: Mapping[str, str] = MappingProxyType({"phone_call": "chest", "drink": "drink", "read": "book", "hand_over": "give"})
_SINGLE_HOLD_S = 0.8
RECORDED = "mocap"  # what people do whom a recording moves: the kind of their profile
RECEIVE = "receive"  # what the other one does in `hand_over`
ACTIVITIES: tuple[str, ...] = (*_PROGRAMS, *(n for n in ACTIONS if n not in HOLDING and n not in _PROGRAMS and n != RECEIVE))


def resting(seat: Seat, cabin: Cabin, hold: Hold | None = None) -> str:
    """The action to which somebody in a seat comes back, who may have something in the hand."""
    drives = seat.slot == "driver" and cabin.steering_wheel is not None
    return "rest_lap" if not drives else "drive" if hold is None else "drive_one_hand"


def steps_of(activity: str, seat: Seat, cabin: Cabin, hold: Hold | None = None) -> tuple[Step, ...]:
    """The steps of an activity of `ACTIVITIES`; who drives goes back to the wheel."""
    steps = _PROGRAMS.get(activity) or (Step(activity, _SINGLE_HOLD_S),)
    if len(steps) == 1:
        return steps
    return tuple(step._replace(action=resting(seat, cabin, hold)) if step.action == "rest_lap" else step for step in steps)


def inboard_neighbour(seat: Seat, cabin: Cabin, taken: Iterable[str]) -> str | None:
    """The seat of whoever sits next to somebody, at the inboard hand; None where nobody does."""
    ahead, left = math.cos(seat.facing_yaw), 1.0 - 2.0 * inboard_side(seat)
    row = [other for other in taken if beside_each_other(seat, cabin.seats[other])]
    away = {other: left * ahead * float(cabin.seats[other].design_h_point[1] - seat.design_h_point[1]) for other in row}
    return min((other for other in row if away[other] > 0.0), key=away.__getitem__, default=None)


def activities_for(
    seat: Seat, cabin: Cabin, hold: Hold | None = None, taken: Iterable[str] = (), *, in_child_seat: bool = False
) -> tuple[str, ...]:
    """The activities that make sense in a seat, with what is held and the seats `taken`, in a fixed order."""
    inboard = inboard_side(seat)
    known = {
        name
        for name in actions_for(seat, cabin)
        if (hold is None or inboard_hand(ACTIONS[name], hold, inboard) is not None)
        and (not in_child_seat or name in IN_CHILD_SEAT or name in HOLDING)
    }
    if hold is not None and hold.side != inboard:  # away from the neighbour
        known -= {"hand_over"}
    alone = inboard_neighbour(seat, cabin, taken) is None
    return tuple(
        name
        for name in ACTIVITIES
        if all(
            s.action in known and not (alone and (s.at_neighbour or s.action == "hand_over"))
            for s in steps_of(name, seat, cabin, hold)
        )
    )

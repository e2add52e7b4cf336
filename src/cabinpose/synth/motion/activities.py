"""Activities: short programs of actions, one after the other."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from types import MappingProxyType
from typing import NamedTuple

from cabinpose.core import reproducible as rp
from cabinpose.core import unknown_name
from cabinpose.scene.cabin import Cabin, Seat
from cabinpose.synth.posture.actions import ACTIONS, IN_CHILD_SEAT, OWN_ACTIONS, inboard_side, suits
from cabinpose.synth.posture.grasps import Hold, inboard_hand
from cabinpose.synth.posture.neighbours import beside_each_other
from cabinpose.synth.posture.places import BITE, BOOK, CHEST, DRINK, GIVE, HandPlace


class Step(NamedTuple):
    """A pose of an activity: the action, how long it is held (s, mean), and whether a driver turns the wheel on the way.

    haste: speed against the person's usual one · at_neighbour: whether the hand goes to the arm of whoever sits beside.
    """

    action: str
    hold_s: float = 0.4
    steers: bool = False
    haste: float = 1.0
    at_neighbour: bool = False


class Program(NamedTuple):
    """An activity: its steps, the place of the hand that needs something in it (None: none does), and what, if not the usual."""

    steps: tuple[Step, ...]
    held_at: HandPlace | None = None
    things: tuple[str, ...] = ()


BUCKLE_UP = "buckle_up"  # before which no belt is worn
# What takes more than one action, or needs something in a hand; every other action is an activity of one step.
_PROGRAMS: Mapping[str, Program] = MappingProxyType(
    {
        "steer": Program((Step("drive", 0.3, True), Step("drive", 0.2, True), Step("drive", 0.3, True))),
        "check_mirror": Program((Step("look_mirror", 0.5), Step("drive", 0.4))),
        "operate": Program((Step("reach_infotainment", 0.6), Step("drive", 0.3))),
        "phone_call": Program((Step("phone_text", 0.8), Step("phone_ear_outer", 1.5), Step("phone_text", 0.4)), CHEST),
        "drink": Program((Step("drink", 1.0), Step("rest_lap", 0.3)), DRINK),
        "eat": Program((Step("bite", 0.6), Step("rest_lap", 1.0), Step("bite", 0.6), Step("rest_lap", 0.6)), BITE),
        "read": Program((Step("read", 3.0),), BOOK),
        "look_over_shoulder": Program((Step("look_back", 0.5), Step("rest_lap", 0.3))),
        "turn_to_back_seat": Program((Step("turn_back", 1.5), Step("rest_lap", 0.3))),
        "hand_over": Program((Step("hand_over", 0.3), Step("rest_lap", 0.3)), GIVE),
        "hit": Program((Step("hit", 0.1, haste=3.0, at_neighbour=True), Step("rest_lap", 0.4))),
        BUCKLE_UP: Program((Step("take_tongue", 0.3), Step("plug_tongue", 0.5), Step("rest_lap", 0.3))),
        "reach_down": Program((Step("reach_floor", 0.5), Step("rest_lap", 0.3))),
        "sleep": Program((Step("sleep", 5.0),)),
    }
)
# Before somebody who drives there is no room to bend forward.
_OF_DRIVERS = MappingProxyType({"reach_floor": "reach_beside"})
_BARE = MappingProxyType({"bite": "at_mouth"})  # with nothing in the hand
_SINGLE_HOLD_S = 0.8
RECORDED = "mocap"  # what people do whom a recording moves: the kind of their profile
RECEIVE = "receive"  # what the other one does in `hand_over`
ACTIVITIES: tuple[str, ...] = (*_PROGRAMS, *(n for n in OWN_ACTIONS if n not in _PROGRAMS and n != RECEIVE))


def program_of(activity: str) -> Program:
    """The steps of an activity: one of ours, or an action by its name.

    Raises ConfigError for a name that does not exist, ExtensionError for an action that cannot be loaded.
    """
    known = _PROGRAMS.get(activity)
    if known is not None:
        return known
    if activity not in ACTIONS or activity == RECEIVE:
        raise unknown_name("activity", activity, list(ACTIVITIES))
    action = ACTIONS[activity]
    always = (place for place in (action.inboard, action.outboard) if place.held is not None and action.in_hand == "always")
    return Program((Step(activity, _SINGLE_HOLD_S),), next(always, None), action.things)


def resting(seat: Seat, cabin: Cabin, hold: Hold | None = None) -> str:
    """The action to which somebody in a seat comes back, who may have something in the hand."""
    drives = seat.slot == "driver" and cabin.steering_wheel is not None
    return "rest_lap" if not drives else "drive" if hold is None else "drive_one_hand"


def steps_of(activity: str, seat: Seat, cabin: Cabin, hold: Hold | None = None) -> tuple[Step, ...]:
    """The steps of an activity; who drives goes back to the wheel, and reaches down beside the seat."""
    steps = program_of(activity).steps
    if len(steps) == 1:
        return steps
    drives = seat.slot == "driver" and cabin.steering_wheel is not None
    instead = {**(_OF_DRIVERS if drives else {}), **(_BARE if hold is None else {}), "rest_lap": resting(seat, cabin, hold)}
    return tuple(step._replace(action=instead.get(step.action, step.action)) for step in steps)


def inboard_neighbour(seat: Seat, cabin: Cabin, taken: Iterable[str]) -> str | None:
    """The seat of whoever sits next to somebody, at the inboard hand; None where nobody does."""
    ahead, left = rp.cos(seat.facing_yaw), 1.0 - 2.0 * inboard_side(seat)
    row = [other for other in taken if beside_each_other(seat, cabin.seats[other])]
    away = {other: left * ahead * float(cabin.seats[other].design_h_point[1] - seat.design_h_point[1]) for other in row}
    return min((other for other in row if away[other] > 0.0), key=away.__getitem__, default=None)


def activities_for(
    seat: Seat, cabin: Cabin, hold: Hold | None = None, taken: Iterable[str] = (), *,
    in_child_seat: bool = False, asked_for: Iterable[str] = (),
) -> tuple[str, ...]:  # fmt: skip
    """The activities that make sense in a seat, with what is held and the seats `taken`, in a fixed order.

    asked_for: by name, which may be actions of other packages.
    """
    inboard = inboard_side(seat)
    alone = inboard_neighbour(seat, cabin, taken) is None

    def possible(step: Step) -> bool:
        action = ACTIONS[step.action]
        return (
            suits(action, seat, cabin)
            and (hold is None or inboard_hand(action, hold, inboard) is not None)
            and (not in_child_seat or step.action in IN_CHILD_SEAT or action.in_hand == "always")
            and not (step.action == "hand_over" and hold is not None and hold.side != inboard)  # away from the neighbour
            and not (alone and (step.at_neighbour or step.action == "hand_over"))
        )

    known = dict.fromkeys((*ACTIVITIES, *asked_for))
    return tuple(name for name in known if all(possible(step) for step in steps_of(name, seat, cabin, hold)))

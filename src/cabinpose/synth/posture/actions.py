"""Named actions: what hands, head and trunk of an occupant do, and in which seats that makes sense.

An action says where each hand goes (by its side of the car: inboard is towards the centre line), what is looked at, and
how the trunk departs from the backrest, all with a spread. `sampling` turns it into a posture.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Literal

import numpy as np

from cabinpose.core import ConfigError, Registry
from cabinpose.scene.cabin import Cabin, Seat
from cabinpose.synth.posture.places import (
    ARMREST,
    BELT,
    BESIDE,
    BITE,
    BOOK,
    BUCKLE,
    CHEST,
    DRINK,
    EAR,
    EITHER,
    GIVE,
    KNOB,
    MIRROR,
    MOUTH,
    REACH,
    SHIN,
    THIGH,
    TONGUE,
    VISOR,
    WHEEL,
    HandPlace,
)

Spread = tuple[float, float]  # mean and sigma, degrees


@dataclass(frozen=True)
class Gaze:
    """Yaw and pitch of the gaze (deg, from straight ahead and level, + left and + up); `at_hand`: what a hand does instead.

    `either_side`: the mean yaw counts towards a random side.
    """

    yaw: Spread = (0.0, 9.0)
    pitch: Spread = (-5.0, 5.0)
    at_hand: bool = False
    either_side: bool = False
    tilt: float = 4.0  # sigma of the head's lateral tilt, deg


@dataclass(frozen=True, eq=False)
class Action:
    """One named action, and all that is known of it.

    Parameters
    ----------
    name
        By which it is asked for.
    inboard, outboard
        The place of each hand, of `PLACES` or one's own.
    gaze
        Where its person looks.
    targets
        Names of `Cabin.reach_targets`, tried in order, for hands that reach ({side}: left or right of the car, {row}: "" or
        "rear_", {slot}, {visor}).
    trunk
        Flexion, lateral and rotation of loins and chest added to the seated ones, by degree of freedom, deg; lateral and rotation
        count towards the side where the busy hand goes, or a random one.
    pelvis
        Its forward pitch, deg.
    weight
        Its share in a random choice of actions.
    seats
        Where it makes sense, if the seat has its places and one of its targets; "front": in a car with a steering wheel.
    in_hand
        Whether a hand holds a thing in it: "sometimes" for the share `scene.in_hand` of people.
    things
        Which, of `THINGS`; () for what hands usually hold at these places.
    most_neighbours
        Within touch, with whom there is room for it in a random choice.
    steers
        Whether it is driving alone: the wheel may then be turned up to its lock.

    Raises
    ------
    ValueError
        For a gaze that follows a hand where neither place is one that gazes go to.
    """

    name: str
    inboard: HandPlace
    outboard: HandPlace
    gaze: Gaze = field(default_factory=Gaze)
    targets: tuple[str, ...] = ()
    trunk: Mapping[str, Spread] = field(default_factory=dict)
    pelvis: Spread = (0.0, 0.0)
    weight: float = 1.0
    seats: Literal["any", "front", "driver", "front_passenger"] = "any"
    in_hand: Literal["never", "sometimes", "always"] = "never"
    things: tuple[str, ...] = ()
    most_neighbours: int = 2
    steers: bool = False

    def __post_init__(self) -> None:
        if self.gaze.at_hand and not (self.inboard.watched or self.outboard.watched):
            raise ValueError(f"the gaze of '{self.name}' follows a hand, but no hand is where gazes go")


# Small spread that is added to every action: people never sit exactly still.
BREATHING: Mapping[str, Spread] = MappingProxyType(
    {
        "lumbar.flexion": (0.0, 1.5), "lumbar.lateral": (0.0, 2.0), "lumbar.rotation": (0.0, 1.5),
        "thorax.flexion": (0.0, 1.5), "thorax.lateral": (0.0, 1.5), "thorax.rotation": (0.0, 2.5),
    }
)  # fmt: skip

_ROAD = Gaze((0.0, 7.0), (-5.0, 4.0))
_FREE = Gaze((0.0, 20.0), (-8.0, 9.0))
_HAND = Gaze(at_hand=True)
_DRIVER = (
    Action("drive", WHEEL, WHEEL, _ROAD, weight=3.4, steers=True),
    Action("drive_one_hand", EITHER, WHEEL, _ROAD, weight=2.6, steers=True),
    Action("look_mirror", WHEEL, WHEEL, Gaze((48.0, 12.0), (-6.0, 5.0), either_side=True)),
)
_REACH_FRONT = (
    Action("reach_infotainment", REACH, EITHER, _HAND, ("infotainment",), seats="front"),
    Action("reach_climate", REACH, EITHER, _HAND, ("climate",), weight=0.5, seats="front"),
    Action("gear", KNOB, EITHER, Gaze((0.0, 10.0), (-8.0, 6.0)), ("gear_lever",), seats="driver"),
    Action("adjust_mirror", MIRROR, EITHER, _HAND, ("mirror",), seats="front"),
    Action("sun_visor", EITHER, VISOR, _HAND, ("{visor}",), weight=0.5, seats="front"),
)
_ANYWHERE = (
    Action("rest_lap", THIGH, THIGH, _FREE, weight=2.5),
    Action("armrest", THIGH, ARMREST, _FREE),
    Action("phone_ear", EAR, EITHER, Gaze((0.0, 18.0), (-5.0, 7.0)), in_hand="sometimes", most_neighbours=0),
    Action("phone_ear_outer", EITHER, EAR, Gaze((0.0, 18.0), (-5.0, 7.0)), in_hand="sometimes", most_neighbours=1),
    Action("phone_text", CHEST, CHEST, _HAND, in_hand="sometimes"),
    Action("window", THIGH, REACH, _HAND, ("{row}window_switch_{side}",), weight=0.5),
    Action("look_around", EITHER, EITHER, Gaze((0.0, 45.0), (-3.0, 12.0))),
    Action(
        "look_back", THIGH, THIGH, Gaze((105.0, 12.0), (-8.0, 6.0), either_side=True),
        trunk={"thorax.rotation": (16.0, 5.0), "lumbar.rotation": (5.0, 2.0), "lumbar.flexion": (2.0, 2.0)}, weight=0.6,
    ),
    Action(
        "lean_forward", THIGH, THIGH, Gaze((0.0, 15.0), (-16.0, 9.0)),
        trunk={"lumbar.flexion": (8.0, 4.0), "thorax.flexion": (6.0, 4.0)}, pelvis=(16.0, 6.0), weight=0.6,
    ),
    Action(
        "lean_side", THIGH, THIGH, _FREE,
        trunk={"lumbar.lateral": (10.0, 4.0), "thorax.lateral": (6.0, 3.0), "lumbar.flexion": (2.0, 2.0)}, most_neighbours=0,
    ),
    Action("belt", BELT, THIGH, _HAND, weight=0.7),
    Action(
        "sleep", THIGH, THIGH, Gaze((0.0, 18.0), (-30.0, 6.0), tilt=13.0),
        trunk={"thorax.flexion": (4.0, 3.0), "lumbar.flexion": (3.0, 2.0), "lumbar.lateral": (0.0, 3.0)},
    ),
)  # fmt: skip
_HOLDING = (
    Action("drink", DRINK, EITHER, Gaze((0.0, 12.0), (16.0, 6.0)), in_hand="always"),
    Action("read", BOOK, THIGH, _HAND, in_hand="always"),
)
_PASSENGER = (Action("reach_glovebox", EITHER, REACH, _HAND, ("glovebox",), seats="front_passenger"),)

# Steps of activities that no still frame shows by itself.
_STEPS = (
    Action("hit", REACH, EITHER, _HAND, trunk={"thorax.rotation": (8.0, 3.0), "lumbar.lateral": (5.0, 2.0)}, weight=0.0),
    Action("hand_over", GIVE, EITHER, _HAND, trunk={"thorax.rotation": (4.0, 2.0)}, weight=0.0),
    Action("receive", REACH, EITHER, _HAND, trunk={"thorax.rotation": (4.0, 2.0)}, weight=0.0),
    Action(
        "turn_back", EITHER, THIGH, Gaze((125.0, 10.0), (-14.0, 6.0), either_side=True),
        trunk={"thorax.rotation": (24.0, 4.0), "lumbar.rotation": (7.0, 2.0), "lumbar.flexion": (3.0, 2.0)}, weight=0.0,
    ),
    Action("at_mouth", MOUTH, EITHER, Gaze((0.0, 8.0), (-4.0, 5.0)), weight=0.0),
    Action(
        "reach_floor", SHIN, THIGH, Gaze((0.0, 10.0), (-40.0, 6.0)),
        trunk={"lumbar.flexion": (14.0, 3.0), "thorax.flexion": (12.0, 3.0)}, pelvis=(20.0, 4.0), weight=0.0,
    ),
    Action(
        "reach_beside", BESIDE, EITHER, Gaze((25.0, 8.0), (-30.0, 6.0), either_side=True),
        trunk={"lumbar.lateral": (12.0, 3.0), "thorax.lateral": (8.0, 2.0), "lumbar.flexion": (3.0, 2.0)}, weight=0.0,
    ),
    Action("take_tongue", TONGUE, EITHER, _HAND, weight=0.0),
    Action("plug_tongue", BUCKLE, EITHER, _HAND, trunk={"lumbar.flexion": (3.0, 2.0)}, weight=0.0),
    Action("bite", BITE, EITHER, Gaze((0.0, 8.0), (-8.0, 5.0)), weight=0.0, in_hand="always"),
)  # fmt: skip

# What occupants do, by name.
OWN_ACTIONS: Mapping[str, Action] = MappingProxyType(
    {a.name: a for a in _DRIVER + _REACH_FRONT + _ANYWHERE + _PASSENGER + _STEPS + _HOLDING}
)
# Those of other packages are done where they are asked for by name.
ACTIONS: Registry[Action] = Registry("cabinpose.actions", "action", Action)
IN_CHILD_SEAT: Mapping[str, float] = MappingProxyType({"rest_lap": 3.0, "look_around": 2.0, "sleep": 2.0, "phone_text": 1.0})


def drawn_angle(spread: Spread, *, rng: np.random.Generator) -> float:
    """An angle (rad) of a normal spread."""
    return math.radians(spread[0] + spread[1] * float(rng.standard_normal()))


def inboard_side(seat: Seat) -> int:
    """The occupant's hand (0 left, 1 right) that is nearer to the centre line; in the middle, the right one."""
    y = float(seat.design_h_point[1])
    if abs(y) < 0.05:
        return 1
    to_left_of_car = y < 0.0
    faces_forward = abs(seat.facing_yaw) < 1e-6
    return 0 if to_left_of_car == faces_forward else 1


def target_name(action: Action, seat: Seat, cabin: Cabin) -> str | None:
    """The first of the action's reach targets that this cabin has for this seat, or None."""
    side = "left" if seat.design_h_point[1] > 0.0 else "right"
    row = "rear_" if seat.slot.startswith("rear") else ""
    visor = "sun_visor" if seat.slot == "driver" else "sun_visor_passenger"
    for pattern in action.targets:
        name = pattern.format(side=side, row=row, slot=seat.slot, visor=visor)
        if name in cabin.reach_targets:
            return name
    return None


def suits(action: Action, seat: Seat, cabin: Cabin) -> bool:
    """Whether an action makes sense in a seat."""
    slot, driven = seat.slot, cabin.steering_wheel is not None
    match action.seats:
        case "front" if not driven or slot.startswith("rear"):
            return False
        case "driver" if not driven or slot != "driver":
            return False
        case "front_passenger" if slot != "front_passenger":
            return False
    places = action.inboard.exists(seat, cabin) and action.outboard.exists(seat, cabin)
    return places and (not action.targets or target_name(action, seat, cabin) is not None)


def actions_for(seat: Seat, cabin: Cabin) -> tuple[str, ...]:
    """Names of our own actions that make sense in a seat, in a fixed order."""
    return tuple(name for name, action in OWN_ACTIONS.items() if suits(action, seat, cabin))


def action_named(name: str, seat: Seat, cabin: Cabin) -> Action:
    """The action of this name; ConfigError where it does not exist or makes no sense in the seat."""
    action = ACTIONS[name]
    if not suits(action, seat, cabin):
        raise ConfigError(
            f"the action '{name}' makes no sense in the {seat.slot} seat of the {cabin.name}",
            hint=f"there: {', '.join(actions_for(seat, cabin))}",
        )
    return action

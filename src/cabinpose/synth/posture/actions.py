"""Named actions: what hands, head and trunk of an occupant do, and in which seats that makes sense.

An action says where each hand goes (by its side of the car: inboard is towards the centre line), what is looked at, and
how the trunk departs from the backrest, all with a spread. `sampling` turns it into a posture.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Literal

from cabinpose.core import ConfigError, unknown_name
from cabinpose.scene.cabin import Cabin, Seat

Place = Literal[
    "wheel", "thigh", "armrest", "ear", "mouth", "shin", "chest", "drink", "book", "carry", "belt", "reach", "give", "either"
]  # fmt: skip
Spread = tuple[float, float]  # mean and sigma, degrees


@dataclass(frozen=True)
class Gaze:
    """Yaw and pitch of the gaze (deg, from straight ahead and level, + left and + up); `at_hand`: what a hand does instead.

    `outward`: the mean yaw counts towards the occupant's own window, and `either_side` takes a random side.
    """

    yaw: Spread = (0.0, 9.0)
    pitch: Spread = (-5.0, 5.0)
    at_hand: bool = False
    outward: bool = False
    either_side: bool = False
    tilt: float = 4.0  # sigma of the head's lateral tilt, deg


@dataclass(frozen=True, eq=False)
class Action:
    """One named action.

    inboard, outboard: the place of each hand · targets: names of `cabin.reach_targets`, tried in order, for hands that
    reach ({side}: left or right of the car, {row}: "" or "rear_", {slot}, {visor}) · trunk: flexion, lateral and
    rotation of loins and chest added to the seated ones, by degree of freedom (deg); lateral and rotation count towards
    the side where the busy hand goes (or the random side) · pelvis: forward pitch of the pelvis, deg ·
    weight: share in a random choice of actions.
    """

    name: str
    inboard: Place
    outboard: Place
    gaze: Gaze = field(default_factory=Gaze)
    targets: tuple[str, ...] = ()
    trunk: Mapping[str, Spread] = field(default_factory=dict)
    pelvis: Spread = (0.0, 0.0)
    weight: float = 1.0


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
    Action("drive", "wheel", "wheel", _ROAD, weight=4.0),
    Action("drive_one_hand", "either", "wheel", _ROAD, weight=2.0),
    Action("look_mirror", "wheel", "wheel", Gaze((48.0, 12.0), (-6.0, 5.0), outward=True, either_side=True)),
)
_REACH_FRONT = (
    Action("reach_infotainment", "reach", "either", _HAND, ("infotainment",)),
    Action("reach_climate", "reach", "either", _HAND, ("climate",), weight=0.5),
    Action("gear", "reach", "either", Gaze((0.0, 10.0), (-8.0, 6.0)), ("gear_lever",)),
    Action("adjust_mirror", "reach", "either", _HAND, ("mirror",)),
    Action("sun_visor", "either", "reach", _HAND, ("{visor}",), weight=0.5),
)
_ANYWHERE = (
    Action("rest_lap", "thigh", "thigh", _FREE, weight=2.5),
    Action("armrest", "thigh", "armrest", _FREE),
    Action("phone_ear", "ear", "either", Gaze((0.0, 18.0), (-5.0, 7.0))),
    Action("phone_ear_outer", "either", "ear", Gaze((0.0, 18.0), (-5.0, 7.0))),
    Action("phone_text", "chest", "chest", _HAND),
    Action("window", "thigh", "reach", _HAND, ("{row}window_switch_{side}",), weight=0.5),
    Action("look_around", "either", "either", Gaze((0.0, 45.0), (-3.0, 12.0))),
    Action(
        "look_back", "thigh", "thigh", Gaze((105.0, 12.0), (-8.0, 6.0), either_side=True),
        trunk={"thorax.rotation": (16.0, 5.0), "lumbar.rotation": (5.0, 2.0), "lumbar.flexion": (2.0, 2.0)},
    ),
    Action(
        "lean_forward", "thigh", "thigh", Gaze((0.0, 15.0), (-16.0, 9.0)),
        trunk={"lumbar.flexion": (8.0, 4.0), "thorax.flexion": (6.0, 4.0)}, pelvis=(16.0, 6.0),
    ),
    Action(
        "lean_side", "thigh", "thigh", _FREE,
        trunk={"lumbar.lateral": (10.0, 4.0), "thorax.lateral": (6.0, 3.0), "lumbar.flexion": (2.0, 2.0)},
    ),
    Action("belt", "belt", "thigh", _HAND, weight=0.7),
    Action(
        "sleep", "thigh", "thigh", Gaze((0.0, 18.0), (-30.0, 6.0), tilt=13.0),
        trunk={"thorax.flexion": (4.0, 3.0), "lumbar.flexion": (3.0, 2.0), "lumbar.lateral": (0.0, 3.0)},
    ),
)  # fmt: skip
_HOLDING = (
    Action("drink", "drink", "either", Gaze((0.0, 12.0), (4.0, 5.0))),
    Action("read", "book", "thigh", _HAND),
)
_PASSENGER = (Action("reach_glovebox", "either", "reach", _HAND, ("glovebox",)),)

# Steps of activities that no still frame shows by itself.
_STEPS = (
    Action("hit", "reach", "either", _HAND, trunk={"thorax.rotation": (8.0, 3.0), "lumbar.lateral": (5.0, 2.0)}, weight=0.0),
    Action("hand_over", "give", "either", _HAND, trunk={"thorax.rotation": (4.0, 2.0)}, weight=0.0),
    Action("receive", "reach", "either", _HAND, trunk={"thorax.rotation": (4.0, 2.0)}, weight=0.0),
    Action(
        "turn_back", "either", "thigh", Gaze((125.0, 10.0), (-14.0, 6.0), either_side=True),
        trunk={"thorax.rotation": (24.0, 4.0), "lumbar.rotation": (7.0, 2.0), "lumbar.flexion": (3.0, 2.0)}, weight=0.0,
    ),
    Action("at_mouth", "mouth", "either", Gaze((0.0, 8.0), (-4.0, 5.0)), weight=0.0),
    Action(
        "reach_floor", "shin", "thigh", Gaze((0.0, 10.0), (-40.0, 6.0)),
        trunk={"lumbar.flexion": (14.0, 3.0), "thorax.flexion": (12.0, 3.0)}, pelvis=(20.0, 4.0), weight=0.0,
    ),
)  # fmt: skip

ACTIONS: Mapping[str, Action] = MappingProxyType(
    {a.name: a for a in _DRIVER + _REACH_FRONT + _ANYWHERE + _PASSENGER + _STEPS + _HOLDING}
)
HOLDING = frozenset(action.name for action in _HOLDING)  # what nobody does without something in the hand
IN_CHILD_SEAT: Mapping[str, float] = MappingProxyType({"rest_lap": 3.0, "look_around": 2.0, "sleep": 2.0, "phone_text": 1.0})
TELEPHONING = frozenset({"phone_ear", "phone_ear_outer", "phone_text"})


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
    driver = seat.slot == "driver" and cabin.steering_wheel is not None
    front = not seat.slot.startswith("rear") and cabin.steering_wheel is not None
    if action in _DRIVER:
        return driver
    if action in _REACH_FRONT:
        return front and target_name(action, seat, cabin) is not None and not (action.name == "gear" and not driver)
    if action in _PASSENGER:
        return seat.slot == "front_passenger" and target_name(action, seat, cabin) is not None
    if action.name == "armrest":
        return armrest_point_name(seat, cabin) is not None
    if action.name == "belt":
        return seat.belt is not None
    return not action.targets or target_name(action, seat, cabin) is not None


def armrest_point_name(seat: Seat, cabin: Cabin) -> str | None:
    """The door armrest beside a seat, or None (middle seats)."""
    if abs(float(seat.design_h_point[1])) < 0.05:
        return None
    name = f"{'rear_' if seat.slot.startswith('rear') else ''}armrest_{'left' if seat.design_h_point[1] > 0 else 'right'}"
    return name if name in cabin.reach_targets else None


def actions_for(seat: Seat, cabin: Cabin) -> tuple[str, ...]:
    """Names of the actions that make sense in a seat, in a fixed order."""
    return tuple(name for name, action in ACTIONS.items() if suits(action, seat, cabin))


def action_named(name: str, seat: Seat, cabin: Cabin) -> Action:
    """The action of this name; ConfigError where it does not exist or makes no sense in the seat."""
    if name not in ACTIONS:
        raise unknown_name("action", name, tuple(ACTIONS))
    if not suits(ACTIONS[name], seat, cabin):
        raise ConfigError(
            f"the action '{name}' makes no sense in the {seat.slot} seat of the {cabin.name}",
            hint=f"there: {', '.join(actions_for(seat, cabin))}",
        )
    return ACTIONS[name]

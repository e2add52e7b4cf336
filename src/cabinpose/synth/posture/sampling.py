"""Sampling of seated poses: an action, then a profile, on top of the posture that is solved for the seat."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from cabinpose.core import Floats, Matrix, SceneError, rotation_vector, transform
from cabinpose.core import reproducible as rp
from cabinpose.scene.body import DOF_INDEX, LOWER, UPPER
from cabinpose.scene.cabin import Cabin, Seat
from cabinpose.scene.contact import PlacedField
from cabinpose.synth.posture import hands as at
from cabinpose.synth.posture.actions import BREATHING, OWN_ACTIONS, Action, action_named, actions_for, drawn_angle, inboard_side
from cabinpose.synth.posture.context import SeatContext, Trunk
from cabinpose.synth.posture.feet import MISS_M, foot_goals
from cabinpose.synth.posture.frames import frames
from cabinpose.synth.posture.gaze import head_goal
from cabinpose.synth.posture.goals import TASKS, HandGoal, as_recorded, at_goals, sitter
from cabinpose.synth.posture.grasps import Hold, inboard_hand
from cabinpose.synth.posture.intents import carrying, holding, intents, with_fingers
from cabinpose.synth.posture.legs import leg_plans
from cabinpose.synth.posture.neighbours import NOBODY, Neighbours
from cabinpose.synth.posture.places import Hand, Reach
from cabinpose.synth.posture.solver import Sitter, solve
from cabinpose.synth.posture.touching import Touch, meet
from cabinpose.synth.profiles import Profile

_UNHELD = 0.3  # of what a wheel is turned by, where no hand holds it
_LEAST_GRIP = 0.01  # with which fingers can still be posed one by one
_GRIP_SIGMA = 0.025
_SLUMPED = 3.0  # of a loin's small spread: how people differ, from upright to slumped (assumed)
_ARM_JITTER = np.radians((5.0, 5.0, 6.0, 5.0, 8.0, 4.0, 3.0))  # of the comfortable arm, so that elbows differ
_HELD_GRIP = 0.5  # stands for the fingers of a hand that holds something: each has a curl of its own
_RECORDED = 0.3  # 1/rad, of departing from a recording's upper body


@dataclass(frozen=True, eq=False)
class OccupantPose:
    """One occupant's pose.

    q: (D,) rad within the limits · vehicle_from_root: (4, 4) · action: its name, or the profile's kind · wheel_angle:
    rad, + left, None where there is no wheel before the seat · residuals_m: by how much feet and hands miss their places, and
    how far the femur heads' middle is from the H-point · refused: which of them is too far from its place, "" where none is ·
    held_up_by: what was most in the way then, "" where nothing was ·
    fingers: (2, 5, 6 or 16) as `Person.pose` takes them, None where all follow the grip · hold: what is in a hand, if anything.
    """

    q: Floats
    vehicle_from_root: Matrix
    action: str
    wheel_angle: float | None
    residuals_m: Mapping[str, float]
    refused: str = ""
    held_up_by: str = ""
    fingers: Floats | None = None
    hold: Hold | None = None


def random_action(
    seat: Seat, cabin: Cabin, *, rng: np.random.Generator, neighbours: Neighbours = NOBODY, in_hand: bool = False
) -> str:
    """One of our actions that makes sense in a seat, drawn by their weights; for which neighbours leave room, unless none is.

    in_hand: also those that need something in the hand.
    """
    everything = tuple(name for name in actions_for(seat, cabin) if in_hand or OWN_ACTIONS[name].in_hand != "always")
    roomy = tuple(name for name in everything if sum(neighbours.close) <= OWN_ACTIONS[name].most_neighbours)
    known = roomy or everything
    return known[int(rng.choice(len(known), p=_shares(known)))]


@lru_cache(maxsize=64)
def _shares(actions: tuple[str, ...]) -> Floats:
    """The probability of each action in a random choice among them."""
    weights = np.array([OWN_ACTIONS[n].weight for n in actions])
    return np.asarray(weights / weights.sum())


@dataclass(frozen=True, eq=False)
class Drawn:
    """The goals of one person, drawn once, and the start of the solver's search: the input of `settled`.

    must: (T,) m that a task may be missed by · h_point: (3,) the seat's, m, vehicle frame · fingers, hold: as in `OccupantPose` ·
    touches: what hands are to touch.
    """

    sitter: Sitter
    action: str
    wheel_angle: float | None
    must: Floats
    h_point: Floats
    fingers: Floats
    hold: Hold | None = None
    touches: tuple[Touch, ...] = ()


class Doing(NamedTuple):
    """What somebody does: an action, and what of it is given in place of a draw.

    action: its name, of `ACTIONS` · wheel_angle: how the wheel is turned, rad, + left · in_hand: whether a hand holds what the
    action speaks of: a telephone, a drink, a book · carried: what a hand holds whatever is done; the action must leave it that
    hand (`inboard_hand`) · reach: where hands reach that have no place of the cabin to reach for · things: what may
    be in the hand, in place of what usually is.
    """

    action: str
    wheel_angle: float | None = None
    in_hand: bool = False
    carried: Hold | None = None
    reach: Reach | None = None
    things: tuple[str, ...] = ()


@dataclass(frozen=True)
class Prescribed:
    """What motion profiles prescribe of a pose.

    profile: on top of the action: the degrees of freedom that it holds are fixed; hands of arms that it does not name stay on the
    rim or in the lap · initial: holds an initial pose, in place of the goals of its degrees of freedom · index: combination of
    an incremental profile, or pose of a recording.
    """

    profile: Profile | None = None
    initial: Profile | None = None
    index: int = 0


UNPRESCRIBED = Prescribed()


def draw_pose(seated: SeatContext, doing: Doing, prescribed: Prescribed = UNPRESCRIBED, *, rng: np.random.Generator) -> Drawn:
    """Draw the goals of a person in a seat: places for hands, head and trunk by the action, feet on pedals or floor.

    Parameters
    ----------
    seated
        Who sits where.
    doing
        What the person does.
    prescribed
        What profiles hold of it.
    rng
        Source of all randomness.

    Returns
    -------
    Drawn

    Raises
    ------
    ConfigError
        For an action that makes no sense in this seat.
    MocapError
        For a recording that cannot be used.
    SceneError
        Where a hand is too small for what it is to hold.
    """
    seat, carried = seated.seat, doing.carried
    action = action_named(doing.action, seat, seated.cabin)
    seat.check(seated.setting)
    inboard = inboard_side(seat)
    if abs(float(seat.design_h_point[1])) < 0.05 and rng.random() < 0.5:
        inboard = 1 - inboard
    spared = doing.reach and doing.reach.side if carried is None else inboard_hand(action, carried, inboard)
    inboard = inboard if spared is None else spared
    hands, held = intents(action, seated, inboard, doing.reach, rng=rng), carried
    if carried is not None:
        hands = carrying(hands, carried)
    elif doing.in_hand:
        hands, held = holding(seated.person, hands, doing.things or action.things, rng=rng)
    hands = with_fingers(hands, seated)
    turned = 1.0 if any(hand.place.on_wheel for hand in hands) else _UNHELD
    wheel_angle = at.turned_wheel(turned * float(rng.standard_normal()), driving=action.steers)
    wheel_angle = wheel_angle if doing.wheel_angle is None else doing.wheel_angle
    root = seated.vehicle_from_root(drawn_angle(action.pelvis, rng=rng))
    comfort = rng.standard_normal((2, 7)) * _ARM_JITTER
    side_sign = _busy_side(action, inboard, rng)  # + left
    feet = foot_goals(seated, root, leg_plans(seated, rng=rng))
    q, slumped = seated.fit.q.copy(), _SLUMPED if seated.on is None else 1.0
    slump = _move_trunk(q, action, side_sign, slumped, rng)
    if seated.on is None:  # a child seat's back leaves no room for it
        root = rp.matmul(root, transform(rotation_vector((0.0, -slump, 0.0))))
    trunk = Trunk(seated, q, root, frames(q, seated.person.rest, root), wheel_angle)
    left, right = (_hand_goal(trunk, hands[side], side, comfort[side], held, rng) for side in (0, 1))
    fingers = np.stack([hand.fingers for hand in hands])
    if held is not None:
        fingers[held.side, :5] = held.grasp.curl
    who, name = sitter(trunk, (left, right), feet, head_goal(trunk, action, hands, side_sign, rng=rng)), doing.action
    for profile in (prescribed.initial, prescribed.profile):
        if profile is not None:
            who = _with_profile(who, profile, prescribed.index, rng)
            fingers[[_names_grip(profile, side) for side in (0, 1)]] = np.nan
    if prescribed.profile is not None and prescribed.profile.followed:
        name = prescribed.profile.kind
    must = [hand.place.miss_m for hand in hands] + [MISS_M if foot.must else math.inf for foot in feet] + [math.inf]
    angle = None if seated.wheel is None else wheel_angle
    touches = tuple(t for side in (0, 1) if (t := _touch(seated, hands[side], side, held)) and who.goals.weight[side].any())
    kept = {side for p in (prescribed.initial, prescribed.profile) if p is not None for side in (0, 1) if _names_grip(p, side)}
    touches = tuple(touch._replace(grasps=touch.grasps and touch.side not in kept) for touch in touches)
    return Drawn(who, name, angle, np.array(must), seat.h_point(seated.setting), fingers, held, touches)


def _touch(seated: SeatContext, hand: Hand, side: int, held: Hold | None) -> Touch | None:
    """What a hand (0 left, 1 right) is to touch; None where nothing is."""
    match hand.place.touches:
        case "car" if hand.reach is not None and hand.reach.touched:
            return Touch(side, hand.reach.point, grasps=hand.place.grasps)
        case "rim" if seated.wheel is not None:
            return Touch(side, rim=(seated.wheel, at.loose_on_rim(hand.noise)), grasps=True)
        case "belt" if seated.on is None:
            return Touch(side, belt=seated)
        case "head" if (held is not None and held.side == side) or hand.place.held is None:
            return Touch(side)
    return None


def _hand_goal(trunk: Trunk, hand: Hand, side: int, comfort: Floats, held: Hold | None, rng: np.random.Generator) -> HandGoal:
    """Where a palm goes (0 left, 1 right), its arm departing from the usual comfortable one by `comfort` (7,) rad.

    The grip is written into the trunk's q.
    """
    task, place = hand.place.task(trunk, hand, side), hand.place
    prior = task.prior + comfort
    prior[1] = max(prior[1], at.elbow_room(trunk.seated.person) + comfort[1])
    grip = place.grip + _GRIP_SIGMA * min(rng.standard_normal(), 1.0)
    if hand.palm is not None:
        grip = _LEAST_GRIP
    elif held is not None and held.side == side:
        grip = _HELD_GRIP
    elif not np.isnan(hand.fingers).any():
        grip = max(float(hand.fingers[1:5].mean()), _LEAST_GRIP)
    trunk.q[DOF_INDEX["lr"[side] + "hand.grip"]] = _clip(grip, 0.0, 1.0)
    return HandGoal(task._replace(prior=prior), place.carried_by.format(side="lr"[side]), place.on_wheel)


def settled(drawn: Sequence[Drawn], around: Sequence[Sitter] = (), placed: PlacedField | None = None) -> list[OccupantPose]:
    """Solve the poses of people who take their seats together.

    Parameters
    ----------
    drawn
        Their goals.
    around
        People whose poses stay as they are.
    placed
        The car's distance fields at the seats' settings; None: without a car.

    Returns
    -------
    list of OccupantPose
        In the order of `drawn`.
    """
    sitters = [d.sitter for d in drawn]
    left = solve((*sitters, *around), placed)
    result = []
    for d, who, found in zip(drawn, sitters, left, strict=False):
        missed = dict(zip(TASKS, found.missed[:, 0].tolist(), strict=True))
        missed["h_point"] = rp.norm(who.root[:3, 3] - d.h_point)
        late = np.flatnonzero((found.missed[:, 0] > d.must) & (who.goals.weight[:, :3] > 0.0).any(axis=1))
        refused, held_up_by = (TASKS[late[0]], found.into) if len(late) else ("", "")
        fingers = d.fingers
        for touch in () if refused else d.touches:
            fingers = meet(who, touch, fingers, d.hold, placed)
        q = who.q.copy()  # the solver begins again with the hand that it knows
        for touch in d.touches:
            if touch.rim is not None and touch.grasps and fingers.shape[1] == 16:
                q[DOF_INDEX["lr"[touch.side] + "hand.grip"]] = max(float(fingers[touch.side, 3:15].mean()), _LEAST_GRIP)
        result.append(OccupantPose(q, who.root, d.action, d.wheel_angle, missed, refused, held_up_by, fingers, d.hold))
    return result


def _with_profile(who: Sitter, profile: Profile, index: int, rng: np.random.Generator) -> Sitter:
    """Who sits with a profile on top: of what is held the bounds close, and arms that it names seek nothing any more."""
    if profile.followed:
        return as_recorded(who, profile.apply(who.q, index=index, rng=rng), [DOF_INDEX[n] for n in profile.followed], _RECORDED)
    q = profile.apply(at_goals(who), index=index, rng=rng)
    lower, upper, weight = who.goals.lower.copy(), who.goals.upper.copy(), who.goals.weight.copy()
    held = [DOF_INDEX[name] for name in profile.held]
    lower[held] = upper[held] = q[held]
    for side in (0, 1):
        if _names_arm(profile, side):
            weight[side] = 0.0
    goals = who.goals._replace(lower=lower, upper=upper, weight=weight)
    return who._replace(goals=goals, q=np.clip(who.q, lower, upper))


def sample_pose(
    seated: SeatContext, action: str, prescribed: Prescribed = UNPRESCRIBED, *,
    car: Callable[[float], PlacedField] | None = None, rng: np.random.Generator,
) -> OccupantPose:  # fmt: skip
    """A pose of somebody alone in a car: `draw_pose`, then `settled`.

    car: its fields at a wheel angle (rad), such as `ContactField.at` gives; left out, hands and feet may go through it.
    Raises what `draw_pose` does, and SceneError where hands or feet do not reach their places.
    """
    drawn = draw_pose(seated, Doing(action), prescribed, rng=rng)
    (pose,) = settled([drawn], placed=None if car is None else car(drawn.wheel_angle or 0.0))
    if pose.refused:
        raise SceneError(
            f"{pose.refused} misses its place by {1e3 * pose.residuals_m[pose.refused]:.0f} mm:"
            f" a person of {seated.person.stature_m:.2f} m, '{action}' in the {seated.seat.slot} seat of the {seated.cabin.name}",
            hint="choose another action, a taller person or a seat setting further forward",
        )
    return pose


def _clip(value: float, low: float, high: float) -> float:
    return min(max(value, low), high)


def _names_grip(profile: Profile, side: int) -> bool:
    return bool(profile.followed) or "lr"[side] + "hand.grip" in profile.held


def _names_arm(profile: Profile, side: int) -> bool:
    joints = tuple("lr"[side] + joint for joint in ("clavicle", "shoulder", "elbow", "wrist"))
    return any(name.split(".")[0] in joints for name in profile.held)


def _busy_side(action: Action, inboard: int, rng: np.random.Generator) -> float:
    """+1 where the action turns or leans to the left: the side of the reaching hand, or a random one."""
    random = 1.0 if rng.random() < 0.5 else -1.0
    for side in (0, 1):
        place = action.inboard if side == inboard else action.outboard
        if place.reaches:
            return 1.0 - 2.0 * side
    return random


def _move_trunk(q: Floats, action: Action, side_sign: float, slumped: float, rng: np.random.Generator) -> float:
    """Bends the trunk, in place; how far the pelvis slumps (rad, + backwards): the loins bend by as much, the chest stays.

    slumped: how much more people differ in that than by breathing.
    """
    slump = 0.0
    for name, spread in BREATHING.items():
        value = drawn_angle(spread, rng=rng)
        if name == "lumbar.flexion":
            value *= slumped
            slump = value
        if name in action.trunk:
            mean, sigma = action.trunk[name]
            sign = 1.0 if name.endswith(".flexion") else side_sign
            value += sign * drawn_angle((mean, sigma), rng=rng)
        d = DOF_INDEX[name]
        q[d] = _clip(q[d] + value, LOWER[d], UPPER[d])
    return slump

"""Sampling of seated poses: an action, then a profile, on top of the posture that is solved for the seat."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from cabinpose.core import Floats, Matrix, SceneError
from cabinpose.scene.body import DOF_INDEX, LOWER, UPPER
from cabinpose.scene.cabin import Cabin, Seat
from cabinpose.scene.contact import PlacedField
from cabinpose.scene.things import sitting_in
from cabinpose.synth.posture import hands as at
from cabinpose.synth.posture.actions import (
    ACTIONS,
    BREATHING,
    HOLDING,
    Action,
    Spread,
    action_named,
    actions_for,
    inboard_side,
)
from cabinpose.synth.posture.context import SeatContext, Trunk
from cabinpose.synth.posture.feet import MISS_M, FootPlan, default_plans, foot_goals
from cabinpose.synth.posture.frames import frames
from cabinpose.synth.posture.gaze import HEAD_SHARE, head_rotation, look_angles
from cabinpose.synth.posture.goals import HAND_MISS_M, TASKS, HandGoal, as_recorded, at_goals, sitter
from cabinpose.synth.posture.grasps import HANDED, Hold, inboard_hand
from cabinpose.synth.posture.hands import LimbTask
from cabinpose.synth.posture.intents import Hand, Reach, carrying, holding, intents
from cabinpose.synth.posture.neighbours import LOW_TUNNEL_M, tunnel_m
from cabinpose.synth.posture.solver import Sitter, solve
from cabinpose.synth.profiles import Profile

_WHEEL_SIGMA, _WHEEL_LIMIT = math.radians(8.0), math.radians(30.0)
_GRIP: Mapping[str, float] = {
    "ear": 0.5, "mouth": 0.5, "shin": 0.06, "chest": 0.5, "drink": 0.4, "book": 0.1, "carry": 0.4, "belt": 0.6,
}  # fmt: skip
_LEAST_GRIP = 0.01  # with which fingers can still be posed one by one
_BESIDE_DOOR_M = 0.04  # of a palm's middle from the door's armrest point, for half a hand's width
_OVER_TUNNEL_M = 0.10  # feet of a middle seat stand on both sides of the tunnel
_ARM_BEFORE = np.array((0.12, 0.03))  # along the thigh and inwards: a hand that brings its arm before the body, beside neighbours
_KNEES_IN_M = 0.02  # of a child, against those of somebody on a wide cushion
_GRIP_SIGMA = 0.025
_LOOSER = 0.055  # of a grip around the rim, so that its spread presses no finger into it
_ARM_JITTER = np.radians((5.0, 5.0, 6.0, 5.0, 8.0, 4.0, 3.0))  # of the comfortable arm, so that elbows differ
_SOFT_MISS_M = 0.12  # a hand that rests or points may stay this short of its place; one on the wheel may not
_HELD_GRIP = 0.5  # stands for the fingers of a hand that holds something: each has a curl of its own
_RECORDED = 0.3  # 1/rad, of departing from a recording's upper body
_CARRIED_BY: Mapping[str, str] = {
    "thigh": "{side}thigh", "ear": "head", "mouth": "head", "drink": "head", "chest": "spine01", "book": "spine01",
    "carry": "{side}thigh", "belt": "spine01",
}  # fmt: skip


@dataclass(frozen=True, eq=False)
class OccupantPose:
    """One occupant's pose.

    q: (D,) rad within the limits · vehicle_from_root: (4, 4) · action: its name, or the profile's kind · wheel_angle:
    rad, + left, None where there is no wheel before the seat · residuals_m: by how much feet and hands miss their places, and
    how far the femur heads' middle is from the H-point · refused: which of them is too far from its place, "" where none is ·
    held_up_by: what was most in the way then, "" where nothing was ·
    fingers: (2, 5 or 6) as `Person.pose` takes them, None where all follow the grip · hold: what is in a hand, if anything.
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
    seat: Seat, cabin: Cabin, *, rng: np.random.Generator, left_out: frozenset[str] = frozenset(), in_hand: bool = False
) -> str:
    """An action that makes sense in a seat, drawn by the actions' weights; none of those `left_out`, unless all are.

    in_hand: also those that need something in the hand.
    """
    everything = tuple(name for name in actions_for(seat, cabin) if in_hand or name not in HOLDING)
    known = tuple(name for name in everything if name not in left_out) or everything
    return known[int(rng.choice(len(known), p=_shares(known)))]


@lru_cache(maxsize=64)
def _shares(actions: tuple[str, ...]) -> Floats:
    """The probability of each action in a random choice among them."""
    weights = np.array([ACTIONS[n].weight for n in actions])
    return np.asarray(weights / weights.sum())


@dataclass(frozen=True, eq=False)
class Drawn:
    """The goals of one person, drawn once, and the start of the solver's search: the input of `settled`.

    must: (T,) m that a task may be missed by · h_point: (3,) the seat's, m, vehicle frame · fingers, hold: as in `OccupantPose`.
    """

    sitter: Sitter
    action: str
    wheel_angle: float | None
    must: Floats
    h_point: Floats
    fingers: Floats
    hold: Hold | None = None


class Doing(NamedTuple):
    """What somebody does: an action, and what of it is given in place of a draw.

    action: its name, of `ACTIONS` · wheel_angle: how the wheel is turned, rad, + left · in_hand: whether a hand holds what the
    action speaks of: a telephone, a drink, a book · carried: what a hand holds whatever is done; the action must leave it that
    hand (`inboard_hand`) · reach: where hands reach that have no place of the cabin to reach for.
    """

    action: str
    wheel_angle: float | None = None
    in_hand: bool = False
    carried: Hold | None = None
    reach: Reach | None = None


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
    person, seat, cabin, wheel, carried = seated.person, seated.seat, seated.cabin, seated.wheel, doing.carried
    chosen = action_named(doing.action, seat, cabin)
    seat.check(seated.setting)
    inboard = inboard_side(seat)
    if abs(float(seat.design_h_point[1])) < 0.05 and rng.random() < 0.5:
        inboard = 1 - inboard
    spared = doing.reach and doing.reach.side if carried is None else inboard_hand(chosen, carried, inboard)
    inboard = inboard if spared is None else spared
    hands = intents(chosen, seat, cabin, inboard, wheel is not None, doing.reach, rng=rng)
    hands = hands if carried is None else carrying(hands, carried)
    hands, holds_it = holding(person, hands, rng=rng) if doing.in_hand and carried is None else (hands, carried)
    rim = None if wheel is None else at.rim_grip(person, wheel.rim_section_m).grip - _LOOSER
    left, right = (
        hand if hand.palm is not None else hand._replace(fingers=at.fingers_at(hand.place, hand.noise, rim)) for hand in hands
    )
    hands = left, right
    steers = any(hand.place == "wheel" for hand in hands)
    turned = _clip(float(rng.normal(0.0, _WHEEL_SIGMA if steers else 0.3 * _WHEEL_SIGMA)), -_WHEEL_LIMIT, _WHEEL_LIMIT)
    turned = turned if doing.wheel_angle is None else doing.wheel_angle
    root = seated.vehicle_from_root(_draw(chosen.pelvis, rng))
    comfort = rng.standard_normal((2, 7)) * _ARM_JITTER
    side_sign = _busy_side(chosen, inboard, rng)  # + left
    plans = _foot_plans(seat, cabin, rng)
    if seated.on is not None:
        rests = not sitting_in(seated.on.thing).harness
        plans = _hanging(plans[0], rests), _hanging(plans[1], rests)
    feet = foot_goals(seated, root, plans)
    q = seated.fit.q.copy()
    _move_trunk(q, chosen, side_sign, rng)
    trunk = Trunk(seated, q, root, frames(q, person.rest, root), turned)
    palms, must = [], []
    for side, hand in enumerate(hands):
        task = _task(trunk, hand, side, carried)
        prior = task.prior + comfort[side]
        prior[1] = max(prior[1], at.elbow_room(person) + comfort[side, 1])
        carried_by, on_wheel = _CARRIED_BY.get(hand.place, "").format(side="lr"[side]), hand.place == "wheel"
        palms.append(HandGoal(task._replace(prior=prior), carried_by, on_wheel))
        must.append(HAND_MISS_M if on_wheel else _SOFT_MISS_M)
        grip = _GRIP.get(hand.place, 0.0) + _GRIP_SIGMA * min(rng.standard_normal(), 1.0)
        if hand.palm is not None:
            grip = _LEAST_GRIP
        elif holds_it is not None and holds_it.side == side:
            grip = _HELD_GRIP
        elif not np.isnan(hand.fingers).any():
            grip = max(float(hand.fingers[1:5].mean()), _LEAST_GRIP)
        q[DOF_INDEX["lr"[side] + "hand.grip"]] = _clip(grip, 0.0, 1.0)
    fingers = np.stack([hand.fingers for hand in hands])
    if holds_it is not None:
        fingers[holds_it.side, :5] = holds_it.grasp.curl
    must += [MISS_M if foot.must else math.inf for foot in feet] + [math.inf]
    head = _gaze(trunk, chosen, hands, side_sign, rng)
    who, action = sitter(trunk, (palms[0], palms[1]), feet, head), doing.action
    if prescribed.initial is not None:
        who = _with_profile(who, prescribed.initial, prescribed.index, rng)
    if (profile := prescribed.profile) is not None:
        who, action = _with_profile(who, profile, prescribed.index, rng), profile.kind if profile.followed else action
    for chosen_profile in (prescribed.initial, profile):
        if chosen_profile is not None:
            fingers[[_names_grip(chosen_profile, side) for side in (0, 1)]] = np.nan
    angle = turned if wheel is not None else None
    return Drawn(who, action, angle, np.array(must), seat.h_point(seated.setting), fingers, holds_it)


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
        missed["h_point"] = float(np.linalg.norm(who.root[:3, 3] - d.h_point))
        late = np.flatnonzero((found.missed[:, 0] > d.must) & (who.goals.weight[:, :3] > 0.0).any(axis=1))
        refused, held_up_by = (TASKS[late[0]], found.into) if len(late) else ("", "")
        result.append(OccupantPose(who.q, who.root, d.action, d.wheel_angle, missed, refused, held_up_by, d.fingers, d.hold))
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


def _draw(spread: Spread, rng: np.random.Generator) -> float:
    return math.radians(spread[0] + spread[1] * float(rng.standard_normal()))


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
        if place in ("reach", "give"):
            return 1.0 - 2.0 * side
    return random


def _move_trunk(q: Floats, action: Action, side_sign: float, rng: np.random.Generator) -> None:
    for name, spread in BREATHING.items():
        value = _draw(spread, rng)
        if name in action.trunk:
            mean, sigma = action.trunk[name]
            sign = 1.0 if name.endswith(".flexion") else side_sign
            value += sign * _draw((mean, sigma), rng)
        d = DOF_INDEX[name]
        q[d] = _clip(q[d] + value, LOWER[d], UPPER[d])


def _foot_plans(seat: Seat, cabin: Cabin, rng: np.random.Generator) -> tuple[FootPlan, FootPlan]:
    """Feet that differ from frame to frame: another pedal, a foot drawn back or put forward, knees apart."""
    plans = list(default_plans(seat, cabin))
    chance, both = float(rng.random()), 0.02 * float(rng.standard_normal())
    apart = max(0.02 * float(rng.standard_normal()), -0.02)
    draws = rng.standard_normal((2, 2))
    if abs(float(seat.design_h_point[1])) < 0.05 and tunnel_m(cabin) > LOW_TUNNEL_M:
        apart += _OVER_TUNNEL_M
    if plans[1].pedal == "accelerator":
        if chance < 0.25 and "brake" in cabin.pedals:
            plans[1] = FootPlan("brake")
        elif chance > 0.85:
            plans[0] = FootPlan("clutch" if "clutch" in cabin.pedals and chance > 0.95 else None, -0.05)
        return plans[0], plans[1]
    for side in (0, 1):
        forward = both + 0.015 * float(draws[side, 0])
        if chance < 0.15:  # one foot drawn back
            forward -= 0.05 if side == 0 else 0.0
        plans[side] = FootPlan(
            None, forward, apart + 0.01 * float(draws[side, 1]), math.radians(7.0 + 4.0 * float(draws[side, 1]))
        )
    return plans[0], plans[1]


def _hanging(plan: FootPlan, rests: bool) -> FootPlan:
    """The foot of a child whose shins hang over a cushion: not drawn back into it, the knees between the `rests` of its seat."""
    return plan._replace(forward=max(plan.forward, 0.0), out=min(plan.out, 0.0) - _KNEES_IN_M if rests else plan.out)


def _gaze(trunk: Trunk, action: Action, hands: tuple[Hand, Hand], side_sign: float, rng: np.random.Generator) -> Matrix:
    """vehicle_from_head (4, 4), its rotation, of somebody who looks where the action says."""
    gaze, heading = action.gaze, trunk.seated.seat.facing_yaw
    yaw, pitch, tilt = _draw(gaze.yaw, rng), _draw(gaze.pitch, rng), _draw((0.0, gaze.tilt), rng)
    if gaze.either_side:
        yaw *= side_sign
    if gaze.at_hand:
        busy = [side for side in (0, 1) if hands[side].place in ("reach", "give", "chest", "book", "belt")]
        point = hands[busy[0]].point
        if point is None:
            point = _task(trunk, hands[busy[0]], busy[0], None).target[:3, 3]
        head = trunk.skeleton.bone("head")
        eye = head[:3, 3] + head[:3, :3] @ np.array([0.09, 0.0, 0.06])
        towards_yaw, towards_pitch = look_angles(eye, point, heading)
        # Eyes do not always stay on the hand; downwards the head lags most.
        yaw, pitch = towards_yaw + 0.5 * yaw, max(towards_pitch, -0.9) + 0.5 * pitch
    return head_rotation(heading + HEAD_SHARE[0] * yaw, HEAD_SHARE[1] * pitch, tilt)


def _task(trunk: Trunk, hand: Hand, side: int, carried: Hold | None) -> LimbTask:
    """The palm's target for the trunk as it is now."""
    s, skeleton = trunk.seated, trunk.skeleton
    (a, b, c), up = hand.noise, np.array([0.0, 0.0, 1.0])
    shoulder = skeleton.bone("lr"[side] + "upperarm")[:3, 3]
    if hand.place == "wheel" and s.wheel is not None:
        return at.on_rim(s.wheel, hand.clock + trunk.wheel_angle, at.rim_grip(s.person, s.wheel.rim_section_m), 0.5 + 0.1 * b)
    if hand.place == "armrest" and hand.point is not None:
        inward = s.seat.design_h_point - hand.point
        beside = _BESIDE_DOOR_M * np.array([0.0, math.copysign(1.0, inward[1]), 0.0])
        lies = at.lying(s.person, hand.fingers)
        return at.on_surface(hand.point + (0.10 + 0.02 * a) * s.forward + beside, s.forward, up, lies)
    if hand.place == "ear":
        return at.at_ear(s.person, skeleton, side, gap=0.048)
    if hand.place == "mouth":
        return at.before_mouth(s.person, skeleton, side, 0.07 + 0.01 * a, 0.03)
    if hand.place == "shin":
        left = np.array([-s.forward[1], s.forward[0], 0.0])
        below = s.seat.heel_point(s.setting) + (0.30 + 0.03 * b) * up + (0.10 - 0.2 * side) * left
        return at.at_point(below + 0.04 * a * s.forward, shoulder, up)
    if hand.place == "chest":
        return at.before_chest(skeleton, side, 0.33 + 0.03 * a, 0.06 + 0.01 * b, -0.07 + 0.03 * c)
    if hand.place == "book":
        return at.before_chest(skeleton, side, 0.38 + 0.02 * a, 0.04 + 0.02 * b, 0.02 * c)
    if hand.place == "drink":
        return at.before_mouth(s.person, skeleton, side, 0.085 + 0.02 * a, 0.13 + 0.02 * c)
    if hand.place == "carry" and carried is not None:
        below_m, upright = -float(carried.grasp.palm_from_thing[1, 3]), carried.kind in HANDED["drink"]
        return at.over_thigh(skeleton, s.fit, s.person.segment_lengths["thigh"], side, upright=upright, below_m=below_m)
    if hand.place == "belt" and s.seat.belt is not None:
        return at.at_belt(s.person, skeleton, side, s.seat.belt.upper)
    if hand.palm is not None:
        return at.at_palm(hand.palm)
    if hand.place in ("reach", "give") and hand.point is not None:
        high = hand.point[2] > shoulder[2]
        return at.at_point(hand.point, shoulder, up, at.UP_ARM if high else at.REACH_ARM)
    along, inward = (_ARM_BEFORE if s.neighbours.close[side] else 0.0) + np.array((0.69 + 0.06 * a, 0.015 + 0.015 * b))
    turn, lies = 0.45 + 0.15 * c, at.lying(s.person, hand.fingers)
    return at.on_thigh(trunk, side, float(along), float(inward), turn, lies)

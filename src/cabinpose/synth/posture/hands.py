"""Where hands go: palm frames on the wheel's rim, the thighs, the body itself and the places to reach in a cabin.

A palm frame has its origin where the axis of a rim of 30 mm would lie in the closed hand, x towards the fingers and z out
of the palm; the thumb points along -y of a right hand and +y of a left one.
"""

from __future__ import annotations

import math
from functools import cache
from typing import NamedTuple

import numpy as np

from cabinpose.core import Floats, Ints, Matrix, apply, axis_rotation, cross, invert, transform
from cabinpose.core import reproducible as rp
from cabinpose.scene.body import BONE_INDEX, DOF_INDEX, LOWER, SEGMENTS, Person, load_shape_space, vertex_segments
from cabinpose.scene.cabin import SteeringWheel
from cabinpose.synth.posture.context import Trunk
from cabinpose.synth.posture.frames import frames
from cabinpose.synth.posture.memory import kept_with_person


class Fingers(NamedTuple):
    """How the fingers of a hand lie: mean curl of each, thumb to little finger, how closed they are, and how often.

    closed: how far they lie side by side, 0 spread to 1.
    """

    curl: tuple[float, float, float, float, float]
    closed: float
    share: float


# Of a hand that rests, at a full curl of 90, 100, 70 deg (MCP, PIP, DIP): flat, slack, slack with bent fingers, spread, a fist.
# Slack fingers are bent more from the index to the little finger (Taylor & Schwarz 1955, Artificial Limbs 2(2)), most at the
# PIP joint, by 20 to 45 deg (Lee & Jung 2014, Int. J. Occup. Saf. Ergon. 20(1)).
RESTING: tuple[Fingers, ...] = (
    Fingers((0.05, 0.05, 0.05, 0.06, 0.08), 0.75, 0.22),
    Fingers((0.20, 0.18, 0.24, 0.30, 0.36), 0.95, 0.40),
    Fingers((0.30, 0.36, 0.44, 0.52, 0.58), 1.0, 0.20),
    Fingers((0.00, 0.04, 0.04, 0.05, 0.06), 0.1, 0.10),
    Fingers((0.60, 0.86, 0.90, 0.92, 0.92), 1.0, 0.08),
)
POINTING: tuple[Fingers, ...] = (
    Fingers((0.30, 0.06, 0.40, 0.48, 0.52), 0.6, 0.5),
    Fingers((0.15, 0.14, 0.20, 0.26, 0.32), 0.6, 0.5),
)
UNDER_WHEEL = tuple(shape for shape in RESTING if max(shape.curl) < 0.1)  # a wheel leaves no room for more
BY_GRIP = np.full(6, np.nan)
# Hours of a left hand at the rim and their shares; the right one's are their mirror images. Drivers with both hands on it seldom
# hold it alike on both sides (6 to 12 %), 55 to 64 % have a hand from 10 to 2 (Jonsson 2011, Traffic Inj. Prev. 12): shares of
# the hours assumed so that this comes out.
_TWO_HANDS = (10.3, 9.8, 9.2, 8.6, 8.0), (0.20, 0.24, 0.24, 0.20, 0.12)
_ONE_HAND = (12.0, 11.0, 10.3, 9.6, 8.8, 8.0), (0.06, 0.06, 0.28, 0.26, 0.22, 0.12)
_CLOCK_SIGMA_DEG = 8.0
# How far a wheel is turned (deg) at so many standard deviations: within 10 deg in 80 %, corners to 270, a manoeuvre to the lock
# in some 4 % (shares assumed).
_TURNED = ((0.0, 0.0), (1.28, 10.0), (1.5, 60.0), (2.0, 270.0), (2.5, 450.0))
# A hand goes along with the rim until it takes hold anew, and no farther down than that; no hand lets go for little (assumed).
_CARRIED, _LOWEST, _LITTLE = math.radians(90.0), math.radians(125.0), math.radians(15.0)
_HAND_SIGMA, _FINGER_SIGMA, _CLOSED_SIGMA = 0.05, 0.035, 0.2


RIM_MISS_M = 0.02  # a palm further than this from the rim does not hold it
_PRESSED_M = 0.001  # of the skin around a rim
_RIM_SLANT = math.radians(20.0)  # of a rim in the hand, from square across the palm: the wrist stays straighter (assumed)
_RIM_REACH_M = 0.09  # half the length of rim that a hand covers, with what slants
_CLOTH_M, _THIGH_RADIUS_M = 0.015, 0.09  # from what is lowest of a hand to the thigh's skin, under trousers; the thigh's own
_SLOPES = np.linspace(-0.2, 0.6, 33)  # of a lying hand
PALM_M = 0.015  # from the palm's skin to the origin of its frame
HAND_M = 0.095  # from the palm's origin to the tip of the middle finger, of an adult
STIFFNESS = np.array([0.006, 0.025, 0.008, 0.001, 0.010, 0.012, 0.016])
_RESTING_STIFFNESS = np.array([0.05, 0.02, 0.008, 0.001, 0.010, 0.012, 0.016])  # elbows before the backrest's bolsters
_STEERING_STIFFNESS = np.array([0.006, 0.05, 0.012, 0.001, 0.006, 0.012, 0.020])
FIRM = np.full(3, 5.0)
STAYS = np.full(3, 20.0)
_GRASP = np.full(3, 5.0)  # a hand around the rim moves along it, not into it


class LimbTask(NamedTuple):
    """A palm's or sole's target: vehicle_from_target (4, 4), weights (3,) of position and rotation (m/rad) along and about
    the target's axes (0: free), and the comfortable posture (7 or 6,) rad with its stiffness.
    """

    target: Floats
    position_weight: Floats
    rotation_weight: Floats
    prior: Floats
    stiffness: Floats

    @staticmethod
    def firm(palm: Matrix, turning: tuple[float, float, float], arm: Floats) -> LimbTask:
        """A palm at vehicle_from_palm (4, 4), kept there firmly.

        turning: weights of turning it about its axes, m/rad · arm: the comfortable one, (7,) rad: flexion, abduction, rotation of
        the shoulder, flexion of the elbow, pronation, flexion and radial deviation of the wrist.
        """
        return LimbTask(palm, FIRM, np.array(turning), arm, STIFFNESS)


# Comfortable arms, deg: shoulder flexion, abduction, rotation; elbow flexion, pronation; wrist flexion, radial.
WHEEL_ARM = np.radians((42.0, 24.0, 14.0, 58.0, 10.0, -8.0, 0.0))
LAP_ARM = np.radians((30.0, 9.0, 26.0, 62.0, 45.0, 0.0, 0.0))
REACH_ARM = np.radians((65.0, 15.0, 10.0, 25.0, 40.0, 0.0, 0.0))
SIDE_ARM = np.radians((10.0, 28.0, 0.0, 70.0, 45.0, 0.0, 0.0))
FACE_ARM = np.radians((45.0, 25.0, 15.0, 125.0, 0.0, 0.0, 0.0))
CROSS_ARM = np.radians((40.0, 0.0, 50.0, 95.0, 20.0, 0.0, 0.0))
CARRY_ARM = np.radians((25.0, 12.0, 15.0, 80.0, 10.0, 0.0, 0.0))
UP_ARM = np.radians((95.0, 25.0, 0.0, 45.0, 20.0, 0.0, 0.0))
ROOF_ARM = np.radians((110.0, 30.0, -20.0, 70.0, 0.0, -20.0, 0.0))
LEVER_ARM = np.radians((35.0, 15.0, 5.0, 50.0, 60.0, -10.0, 0.0))


@kept_with_person
def elbow_room(person: Person) -> float:
    """Abduction (rad) by which a person's upper arms clear the flanks when they hang before them."""
    segment = person.skin_segment
    trunk = np.isin(segment, [SEGMENTS.index(s) for s in ("abdomen", "thorax")])
    skin = person.rest_skin.astype(np.float64)
    upper_arm = person.segment_lengths["upper_arm"]
    shoulder = frames(np.zeros(len(LOWER)), person.rest, np.eye(4)).bone("lupperarm")[:3, 3]
    level = trunk & (skin[:, 2] < shoulder[2] - 0.35 * upper_arm) & (skin[:, 2] > shoulder[2] - 1.1 * upper_arm)
    half = float(np.abs(skin[level, 1]).max())
    return float(np.clip(rp.arctan2(half + 0.2 * upper_arm - shoulder[1], 0.75 * upper_arm), 0.1, 0.9))


def palm_frame(origin: Floats, normal: Floats, fingers: Floats) -> Matrix:
    """A palm at `origin` whose z is `normal` and whose x lies as near to `fingers` as that allows ((3,) each)."""
    z = normal / rp.norm(normal)
    y = cross(z, fingers)
    y = y / rp.norm(y)
    palm = np.eye(4)
    palm[:3, 0], palm[:3, 1], palm[:3, 2], palm[:3, 3] = cross(y, z), y, z, origin
    return palm


def _own_rng(noise: tuple[float, ...]) -> np.random.Generator:
    """The generator of a hand's fingers: the hand's own noise is its key."""
    return np.random.Generator(np.random.Philox(key=np.array(noise[:2]).view(np.uint64)))


def _fingers(curl: Floats, closed: float, rng: np.random.Generator) -> Floats:
    return np.append(np.clip(curl, 0.0, 1.0), np.clip(closed + _CLOSED_SIGMA * rng.standard_normal(), 0.0, 1.0))


def resting_fingers(noise: tuple[float, ...], shapes: tuple[Fingers, ...]) -> Floats:
    """(6,) fingers as `Person.pose` takes them, near one of the shapes.

    noise: the hand's own, of which they are drawn.
    """
    rng, shares = _own_rng(noise), np.array([shape.share for shape in shapes])
    shape = shapes[int(rng.choice(len(shapes), p=shares / shares.sum()))]
    curl = np.array(shape.curl) + _HAND_SIGMA * rng.standard_normal() + _FINGER_SIGMA * rng.standard_normal(5)
    return _fingers(curl, shape.closed, rng)


def clocks(key: float, *, alone: bool) -> Floats:
    """(2,) at which angles (rad from the top, + left) the left and the right hand hold a wheel that stands straight.

    key: 0 to 1, of which they are drawn, each for itself · alone: whether it is one hand that drives.
    """
    rng = np.random.Generator(np.random.Philox(key=np.array((key, 0.0)).view(np.uint64)))
    hours, shares = _ONE_HAND if alone else _TWO_HANDS
    drawn = np.radians(
        30.0 * np.array([12.0 - rng.choice(hours, p=shares) for _ in (0, 1)]) + _CLOCK_SIGMA_DEG * rng.standard_normal(2)
    )
    return np.clip(drawn, _LITTLE - _LOWEST, _LOWEST - _LITTLE) * (1.0, -1.0)


def turned_wheel(normal: float, *, driving: bool) -> float:
    """How a wheel is turned (rad, + left), of a standard normal number: mostly a few degrees, seldom up to its lock.

    driving: whether the hands do nothing but that.
    """
    sigmas, angles = np.array(_TURNED if driving else _TURNED[:2]).T
    return math.copysign(math.radians(float(np.interp(abs(normal), sigmas, angles))), normal)


def regripped(clock: float, wheel_angle: float) -> float:
    """Where a hand is (rad from the top, + left) whose place is `clock` with a wheel that stands straight.

    Hands go along with the rim as far as `_CARRIED`, one of them over the top, and then take hold anew; one that would come below
    `_LOWEST` has done so before the other.
    """
    if abs(wheel_angle) <= _LITTLE:
        return clock + wheel_angle
    carried = clock + math.copysign(abs(wheel_angle) % _CARRIED, wheel_angle)
    return clock if abs(carried) > _LOWEST else carried


def fingers_on_rim(noise: tuple[float, ...], rim: float) -> Floats:
    """The same around a rim, none tighter than the curl `rim` that holds it; some index fingers lie along it."""
    rng = _own_rng(noise)
    return _fingers(rim - _loose(rng), 0.85, rng)


def loose_on_rim(noise: tuple[float, ...]) -> Floats:
    """(5,) how much less the fingers of `fingers_on_rim` are curled than they could be, thumb to little finger."""
    return _loose(_own_rng(noise))


def _loose(rng: np.random.Generator) -> Floats:
    loose = np.abs(rng.standard_normal(5)) * (0.03, 0.05, 0.025, 0.025, 0.04)
    loose[1] += 0.15 * (rng.random() < 0.15)
    return loose


class Lying(NamedTuple):
    """How a hand lies on a thigh: its palm frame's origin is `above` m over it, its fingers are lower by `pitch` rad."""

    above: float
    pitch: float


def lying(person: Person, fingers: Floats) -> Lying:
    """A hand with its fingers (6,) as it lies on a thigh, on the heel of the hand and what is lowest of the fingers."""
    q = np.zeros(len(LOWER))
    q[DOF_INDEX["lhand.grip"]] = 1.0  # the kernel curls by the share of it
    skin = person.skin_part(_hand_rows(), np.stack((fingers, np.full(6, np.nan))))(q, np.eye(4))
    x, y, z = apply(_palm_from_root(person), skin).T
    # The flattest support below the palm's origin: of all planes that no point lies beyond the nearest one.
    reach = (z - y * y / (2.0 * _THIGH_RADIUS_M) - np.outer(_SLOPES, x)).max(axis=1)
    best = int(reach.argmin())
    pitch = rp.arctan(_SLOPES[best])
    return Lying(float(reach[best]) * rp.cos(pitch), pitch)


def fingertip(person: Person, fingers: Floats) -> Floats:
    """(3,) m, palm frame of a left hand: the end of the index finger of a hand with its fingers (6,) like that."""
    q = np.zeros(len(LOWER))
    q[DOF_INDEX["lhand.grip"]] = 1.0  # the kernel curls by the share of it
    skin = person.skin_part(_index_rows(), np.stack((fingers, np.full(6, np.nan))))(q, np.eye(4))
    local = apply(_palm_from_root(person), skin)
    return np.asarray(local[int(np.argmax(local[:, 0]))])


@cache
def _index_rows() -> Ints:
    """Vertices of the last phalanx of a left index finger."""
    return np.flatnonzero(load_shape_space().bone_index[:, 0] == BONE_INDEX["lfinger2_3"])


@cache
def _hand_rows() -> Ints:
    """Vertices of a left hand, one of three."""
    return np.flatnonzero(vertex_segments() == SEGMENTS.index("lhand"))[::3]


@kept_with_person
def _palm_from_root(person: Person) -> Matrix:
    return invert(person.pose(np.zeros(len(LOWER)), np.eye(4)).palms["l"])


class RimGrip(NamedTuple):
    """How a hand closes around a rim: the fingers' curl, and the rim's axis in the palm (m square to it, and along z)."""

    grip: float
    along: float
    off: float


@kept_with_person
def rim_grip(person: Person, section_m: float) -> RimGrip:
    """The tightest grip around a rim of this section radius (m) that presses the skin by no more than `_PRESSED_M`."""
    hand = person.skin_segment == SEGMENTS.index("lhand")
    root, q = np.eye(4), np.zeros(len(LOWER))
    best, best_cost = RimGrip(0.2, 0.0, 0.004), math.inf
    for grip in np.arange(0.15, 0.5, 0.05):
        q[DOF_INDEX["lhand.grip"]] = grip
        posed = person.pose(q, root)
        palm = posed.palms["l"]
        local = rp.matmul(posed.skin[hand] - palm[:3, 3], palm[:3, :3])
        local = local[np.abs(local[:, 1]) < _RIM_REACH_M]
        across = rp.cos(_RIM_SLANT) * local[:, 0] - rp.sin(_RIM_SLANT) * local[:, 1]
        for along in (-0.004, 0.0, 0.004, 0.008, 0.012):
            for off in (0.0, 0.004, 0.008, 0.012):
                clear = float(rp.hypot(across - along, local[:, 2] - off).min()) - section_m
                cost = 60.0 * max(-_PRESSED_M - clear, 0.0) / _PRESSED_M - grip + 20.0 * (abs(along) + off)
                if cost < best_cost:
                    best, best_cost = RimGrip(float(grip), along, off), cost
    return best


def on_rim(wheel: SteeringWheel, angle: float, hold: RimGrip, lean: float, side: int) -> LimbTask:
    """A hand closed around the rim at `angle` (rad from the top, + to the left, as the wheel stands now).

    The rim runs across the palm by `_RIM_SLANT`, thumb upwards at three and nine; the palm lies on it from outside, turned by
    `lean` (rad) towards the driver's side. Rolling around the rim is nearly free, as in a real grip. side: 0 left, 1 right.
    """
    point, tangent = wheel.grip_point(angle), wheel.tangent(angle)
    axis = wheel.vehicle_from_wheel[:3, 2]
    inward = wheel.vehicle_from_wheel[:3, 3] - point
    inward = inward / rp.norm(inward)
    normal = rp.cos(lean) * inward - rp.sin(lean) * axis
    fingers = cross(-tangent, normal)
    target = palm_frame(point - hold.off * normal - hold.along * fingers, normal, fingers)
    target = rp.matmul(target, transform(axis_rotation("z", (1.0 - 2.0 * side) * _RIM_SLANT)))
    return LimbTask(target, _GRASP, np.array([0.22, 0.02, 0.22]), WHEEL_ARM, _STEERING_STIFFNESS)


def on_thigh(trunk: Trunk, side: int, along: float, inward: float, turn: float, lies: Lying) -> LimbTask:
    """A hand that rests on the thigh of its side at the share `along` of its length, `inward` m from its ridge to the middle.

    turn: of the fingers from the leg's direction to the middle, tangent · lies: how the hand lies there.
    """
    bone = trunk.skeleton.bone("lr"[side] + "thigh")
    s, fit, femur = 1.0 - 2.0 * side, trunk.seated.fit, trunk.seated.person.segment_lengths["thigh"]
    up, down_leg, left = bone[:3, 0], -bone[:3, 2], bone[:3, 1]
    stations = np.linspace(0.0, 1.0, len(fit.thigh_top))
    heel_top, top, tip_top = (float(np.interp(along + d, stations, fit.thigh_top)) for d in (-0.2, 0.0, 0.15))
    drop = inward * inward / max(2.0 * top, 0.02)  # a thigh is round
    slope = rp.arctan2(tip_top - heel_top, 0.35 * femur)  # and a cone: the hand lies along its skin
    origin = bone[:3, 3] + along * femur * down_leg
    down_leg, up = rp.cos(slope) * down_leg + rp.sin(slope) * up, rp.cos(slope) * up - rp.sin(slope) * down_leg
    point = origin + (top - drop + lies.above + _CLOTH_M) * up - s * inward * left
    tilt = np.clip(inward / max(top, 0.03), -0.8, 0.8)
    normal = -(rp.cos(tilt) * up - s * rp.sin(tilt) * left)
    fingers = down_leg - s * turn * left
    target = rp.matmul(palm_frame(point, normal, fingers), transform(axis_rotation("y", lies.pitch)))
    return LimbTask(target, FIRM, np.array([0.06, 0.06, 0.02]), LAP_ARM, _RESTING_STIFFNESS)

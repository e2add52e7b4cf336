"""Where hands go: palm frames on the wheel's rim, the thighs, the body itself and the places to reach in a cabin.

A palm frame has its origin where the axis of a rim of 30 mm would lie in the closed hand, x towards the fingers and z out
of the palm; the thumb points along -y of a right hand and +y of a left one.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from cabinpose.core.frames import Matrix, transform
from cabinpose.scene.body import SEGMENTS, Person
from cabinpose.scene.cabin import SteeringWheel
from cabinpose.synth.posture.limbs import Frames, LimbTask
from cabinpose.synth.posture.seat_fit import SeatFit

Array = NDArray[np.float64]

PALM_M = 0.015  # from the palm's skin to the origin of its frame
HAND_M = 0.095  # from the palm's origin to the tip of the middle finger, of an adult
_STIFFNESS = np.array([0.006, 0.012, 0.008, 0.001, 0.003, 0.012, 0.016])
_FIRM = np.full(3, 5.0)

# Comfortable arms, deg: shoulder flexion, abduction, rotation; elbow flexion, pronation; wrist flexion, radial.
WHEEL_ARM = np.radians((42.0, 18.0, 12.0, 58.0, 10.0, -8.0, 0.0))
LAP_ARM = np.radians((12.0, 14.0, 22.0, 62.0, 45.0, 0.0, 0.0))
REACH_ARM = np.radians((65.0, 15.0, 10.0, 25.0, 40.0, 0.0, 0.0))
SIDE_ARM = np.radians((10.0, 28.0, 0.0, 70.0, 45.0, 0.0, 0.0))
FACE_ARM = np.radians((45.0, 25.0, 15.0, 125.0, 0.0, 0.0, 0.0))
CROSS_ARM = np.radians((40.0, 0.0, 50.0, 95.0, 20.0, 0.0, 0.0))
UP_ARM = np.radians((95.0, 25.0, 0.0, 45.0, 20.0, 0.0, 0.0))


def palm_frame(origin: Array, normal: Array, fingers: Array) -> Matrix:
    """A palm at `origin` whose z is `normal` and whose x lies as near to `fingers` as that allows ((3,) each)."""
    z = normal / np.linalg.norm(normal)
    y = np.cross(z, fingers)
    y = y / np.linalg.norm(y)
    return transform(Rotation.from_matrix(np.stack([np.cross(y, z), y, z], axis=1)), origin)


def on_rim(wheel: SteeringWheel, angle: float, lean: float = 0.5) -> LimbTask:
    """A hand closed around the rim at `angle` (rad from the top, + to the left, as the wheel stands now).

    The rim runs across the palm, thumb upwards at three and nine; the palm lies on it from outside, turned by `lean`
    (rad) towards the driver's side. Rolling around the rim and slanting on it are nearly free, as in a real grip.
    """
    point, tangent = wheel.grip_point(angle), wheel.tangent(angle)
    axis = wheel.vehicle_from_wheel[:3, 2]
    inward = wheel.vehicle_from_wheel[:3, 3] - point
    inward = inward / np.linalg.norm(inward)
    normal = np.cos(lean) * inward - np.sin(lean) * axis
    target = palm_frame(point, normal, np.cross(-tangent, normal))
    return LimbTask(target, _FIRM, np.array([0.05, 0.015, 0.03]), WHEEL_ARM, _STIFFNESS)


def on_thigh(frames: Frames, fit: SeatFit, femur: float, side: int, thigh: int, along: float, inward: float) -> LimbTask:
    """A hand that rests on a thigh at the share `along` of its length, `inward` m from its ridge to the middle."""
    bone = frames.bone("lr"[thigh] + "thigh")
    s = 1.0 - 2.0 * thigh
    up, down_leg, left = bone[:3, 0], -bone[:3, 2], bone[:3, 1]
    top = float(np.interp(along, np.linspace(0.0, 1.0, len(fit.thigh_top)), fit.thigh_top))
    drop = inward * inward / max(2.0 * top, 0.02)  # a thigh is round
    point = bone[:3, 3] + along * femur * down_leg + (top - drop - PALM_M + 0.012) * up - s * inward * left
    tilt = np.clip(inward / max(top, 0.03), -0.8, 0.8)
    normal = -(np.cos(tilt) * up - s * np.sin(tilt) * left)
    mine = 1.0 - 2.0 * side
    fingers = down_leg - mine * 0.45 * left
    return LimbTask(palm_frame(point, normal, fingers), _FIRM, np.array([0.03, 0.03, 0.012]), LAP_ARM, _STIFFNESS)


def on_surface(point: Array, fingers: Array, up: Array, prior: Array = SIDE_ARM) -> LimbTask:
    """A hand that rests on something level at `point` (3,) with the palm down, fingers along `fingers`."""
    target = palm_frame(point + (0.012 - PALM_M) * up, -up, fingers)
    return LimbTask(target, _FIRM, np.array([0.03, 0.03, 0.01]), prior, _STIFFNESS)


def at_point(point: Array, shoulder: Array, up: Array, prior: Array = REACH_ARM, finger: float = HAND_M) -> LimbTask:
    """A hand whose fingertips touch `point` (3,), coming from `shoulder` (3,), palm down or inwards as the arm likes."""
    direction = point - shoulder
    direction = direction / np.linalg.norm(direction)
    target = palm_frame(point - finger * direction, -up, direction)
    return LimbTask(target, _FIRM, np.array([0.008, 0.02, 0.02]), prior, _STIFFNESS)


def at_ear(person: Person, frames: Frames, side: int, gap: float = 0.03) -> LimbTask:
    """A hand that holds a telephone `gap` m thick to its own ear."""
    head = frames.bone("head")
    s = 1.0 - 2.0 * side
    skin = person.rest_skin[person.skin_segment == SEGMENTS.index("head")].astype(np.float64)
    half = float(np.abs(skin[:, 1]).max())
    height = float(np.ptp(skin[:, 2]))
    local = np.array([0.02, s * (half + gap - PALM_M), 0.18 * height])
    point = head[:3, :3] @ local + head[:3, 3]
    fingers = head[:3, :3] @ np.array([-0.25, 0.0, 1.0])
    target = palm_frame(point, head[:3, :3] @ np.array([0.15, -s, 0.0]), fingers)
    return LimbTask(target, _FIRM, np.array([0.02, 0.02, 0.02]), FACE_ARM, _STIFFNESS)


def before_chest(frames: Frames, side: int, forward: float, out: float, up: float) -> LimbTask:
    """A hand that holds a telephone before the chest: palm towards the face, at an offset (m) from the upper chest."""
    thorax = frames.bone("spine01")
    s = 1.0 - 2.0 * side
    point = thorax[:3, 3] + thorax[:3, :3] @ np.array([forward, s * out, up])
    to_face = frames.bone("head")[:3, 3] - point
    fingers = thorax[:3, :3] @ np.array([0.75, -s * 0.55, 0.35])
    return LimbTask(palm_frame(point, to_face, fingers), _FIRM, np.array([0.015, 0.015, 0.01]), FACE_ARM, _STIFFNESS)


def at_belt(person: Person, frames: Frames, side: int, upper: Array) -> LimbTask:
    """A hand at the shoulder belt, in front of the opposite shoulder (towards the anchor `upper` (3,))."""
    thorax = frames.bone("spine01")
    local = thorax[:3, :3].T @ (upper - thorax[:3, 3])
    s = 1.0 if local[1] > 0.0 else -1.0
    skin = person.rest_skin[person.skin_segment == SEGMENTS.index("thorax")].astype(np.float64)
    depth = float(skin[:, 0].max()) + 0.045
    point = thorax[:3, 3] + thorax[:3, :3] @ np.array([depth, s * 0.07, 0.03])
    back = thorax[:3, :3] @ np.array([-1.0, 0.0, 0.15])
    fingers = thorax[:3, :3] @ np.array([0.15, s * 0.8, 0.6])
    mine = 1.0 - 2.0 * side
    if mine == s:  # the hand of the same side comes from below, its fingers to the middle
        fingers = thorax[:3, :3] @ np.array([0.1, -s * 0.6, 0.8])
    return LimbTask(palm_frame(point, back, fingers), _FIRM, np.array([0.01, 0.01, 0.006]), CROSS_ARM, _STIFFNESS)

"""Where a person looks, and what of it the head does."""

from __future__ import annotations

import math

import numpy as np

from cabinpose.core import Floats, Matrix, axis_rotation, transform
from cabinpose.core import reproducible as rp
from cabinpose.synth.posture.actions import Action, drawn_angle
from cabinpose.synth.posture.context import Trunk
from cabinpose.synth.posture.intents import Hands

HEAD_SHARE = (0.8, 0.75)  # of a gaze's yaw and pitch that the head does; the eyes do the rest (Stahl 1999)


def head_rotation(vehicle_yaw: float, pitch: float, roll: float = 0.0) -> Floats:
    """A head's frame (4, 4): heading `vehicle_yaw` (rad, + left), pitched up by `pitch`, tilted to the left by `roll`."""
    return transform(rp.matmul(axis_rotation("z", vehicle_yaw), axis_rotation("y", -pitch), axis_rotation("x", -roll)))


def look_angles(eye: Floats, point: Floats, heading: float) -> tuple[float, float]:
    """Yaw (+ left, from `heading`) and pitch (+ up), rad, of the line from an eye to a point."""
    v = point - eye
    yaw = rp.arctan2(v[1], v[0]) - heading
    return (yaw + math.pi) % (2 * math.pi) - math.pi, rp.arctan2(v[2], rp.hypot(v[0], v[1]))


def head_goal(trunk: Trunk, action: Action, hands: Hands, side_sign: float, *, rng: np.random.Generator) -> Matrix:
    """vehicle_from_head (4, 4), its rotation, of somebody who looks where the action says; side_sign: +1 for a busy left side."""
    gaze, heading = action.gaze, trunk.seated.seat.facing_yaw
    yaw, pitch, tilt = (drawn_angle(spread, rng=rng) for spread in (gaze.yaw, gaze.pitch, (0.0, gaze.tilt)))
    if gaze.either_side:
        yaw *= side_sign
    if gaze.at_hand:
        side, hand = next((side, hand) for side, hand in enumerate(hands) if hand.place.watched)
        point = hand.reach.point if hand.reach is not None else hand.place.task(trunk, hand, side).target[:3, 3]
        head = trunk.skeleton.bone("head")
        eye = head[:3, 3] + rp.matmul(head[:3, :3], np.array([0.09, 0.0, 0.06]))
        towards_yaw, towards_pitch = look_angles(eye, point, heading)
        # Eyes do not always stay on the hand; downwards the head lags most.
        yaw, pitch = towards_yaw + 0.5 * yaw, max(towards_pitch, -0.9) + 0.5 * pitch
    return head_rotation(heading + HEAD_SHARE[0] * yaw, HEAD_SHARE[1] * pitch, tilt)

"""Head and trunk towards something: where a person looks, and how the trunk follows a hand that reaches far."""

from __future__ import annotations

import math

import numpy as np

from cabinpose._native import pose as native
from cabinpose.scene.body.kinematics import RestArrays
from cabinpose.synth.posture.chain import Array
from cabinpose.synth.posture.limbs import LOWER, UPPER

HEAD_SHARE = (0.8, 0.75)  # of a gaze's yaw and pitch that the head does; the eyes do the rest (Stahl 1999)


def head_rotation(vehicle_yaw: float, pitch: float, roll: float = 0.0) -> Array:
    """A head's frame (4, 4): heading `vehicle_yaw` (rad, + left), pitched up by `pitch`, tilted to the left by `roll`."""
    cy, sy, cp, sp, cr, sr = (f(a) for a in (vehicle_yaw, -pitch, -roll) for f in (math.cos, math.sin))
    result = np.eye(4)
    yaw = np.array([[cy, -sy, 0.0], [sy, cy, 0.0], [0.0, 0.0, 1.0]])
    tip = np.array([[cp, 0.0, sp], [0.0, 1.0, 0.0], [-sp, 0.0, cp]])
    tilt = np.array([[1.0, 0.0, 0.0], [0.0, cr, -sr], [0.0, sr, cr]])
    result[:3, :3] = yaw @ tip @ tilt
    return result


def turn_head(q: Array, rest: RestArrays, vehicle_from_root: Array, vehicle_from_head: Array) -> float:
    """Turn neck and head in q, in place, so that the head's frame has this rotation; returns what is missed, rad."""
    return float(native.turn_head(q, rest, vehicle_from_root, vehicle_from_head, LOWER, UPPER))


def look_angles(eye: Array, point: Array, heading: float) -> tuple[float, float]:
    """Yaw (+ left, from `heading`) and pitch (+ up), rad, of the line from an eye to a point."""
    v = point - eye
    yaw = math.atan2(v[1], v[0]) - heading
    return (yaw + math.pi) % (2 * math.pi) - math.pi, math.atan2(v[2], math.hypot(v[0], v[1]))


def lean_to_reach(q: Array, rest: RestArrays, vehicle_from_root: Array, side: int, point: Array, reach: float) -> float:
    """Bend and turn the trunk in q, in place, just so far that the shoulder of `side` comes within `reach` m of a point.

    Returns the distance (m) still missing. Flexion and lateral bend of the loins give most, then rotation.
    """
    point = np.ascontiguousarray(point, dtype=np.float64)
    return float(native.lean_to_reach(q, rest, vehicle_from_root, side, point, float(reach), LOWER, UPPER))

"""Where a person looks, and what of it the head does."""

from __future__ import annotations

import math

from cabinpose.core import Floats, axis_rotation, transform

HEAD_SHARE = (0.8, 0.75)  # of a gaze's yaw and pitch that the head does; the eyes do the rest (Stahl 1999)


def head_rotation(vehicle_yaw: float, pitch: float, roll: float = 0.0) -> Floats:
    """A head's frame (4, 4): heading `vehicle_yaw` (rad, + left), pitched up by `pitch`, tilted to the left by `roll`."""
    return transform(axis_rotation("z", vehicle_yaw) @ axis_rotation("y", -pitch) @ axis_rotation("x", -roll))


def look_angles(eye: Floats, point: Floats, heading: float) -> tuple[float, float]:
    """Yaw (+ left, from `heading`) and pitch (+ up), rad, of the line from an eye to a point."""
    v = point - eye
    yaw = math.atan2(v[1], v[0]) - heading
    return (yaw + math.pi) % (2 * math.pi) - math.pi, math.atan2(v[2], math.hypot(v[0], v[1]))

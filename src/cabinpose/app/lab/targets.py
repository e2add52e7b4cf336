"""What the rig's ToF camera sees of the calibration targets: the board in an operator's hands, a marker on a pendulum.

World frame: the optical system's, z up, floor at z = 0. The room is a floor and a wall that the camera faces.
"""

from __future__ import annotations

import numpy as np
from numpy.random import Generator
from numpy.typing import ArrayLike, NDArray

from cabinpose.align import Board
from cabinpose.app.lab.raycast import Plate, PrimitiveScene, cast
from cabinpose.app.lab.rig import VirtualRig
from cabinpose.core import Matrix, apply, invert
from cabinpose.record.sources.tof import tof_frame
from cabinpose.scene.sensor import SensorFrame, simulate
from cabinpose.signals import ToFFrame

F64 = NDArray[np.float64]

# A retro-reflective sphere is a few hundred times brighter than white paper where light and lens are one, and some ten times
# where the light is beside the lens, as in these cameras. At 0.6 m this fills the wells of the default camera to two thirds.
MARKER_REFLECTANCE = 15.0
PENDULUM_RADIUS_M = 0.0125
_WALL_M = 2.4  # from the camera, along its horizontal forward direction
_WALL_REFLECTANCE, _FLOOR_REFLECTANCE, _CLOTHES, _SKIN, _STRING, _BEAM = 0.6, 0.2, 0.5, 0.58, 0.35, 0.3
_STRING_RADIUS_M, _BEAM_RADIUS_M = 0.0008, 0.02
_CLEAR_M = 0.04  # between a limb of the operator and what has to be seen
_MARGIN_M = 0.045  # of the board's plate, around corners and markers


def plate_size(board: Board) -> tuple[float, float, float, float]:
    """x and y (m, board frame) of two opposite corners of the plate that squares and markers are on."""
    squares = board.square_m * np.array(((-1.0, -1.0), (board.columns, board.rows)))
    points = np.concatenate((squares, board.marker_centres[:, :2]))
    low, high = points.min(axis=0) - _MARGIN_M, points.max(axis=0) + _MARGIN_M
    return float(low[0]), float(low[1]), float(high[0]), float(high[1])


def room(rig: VirtualRig) -> F64:
    """(2, 5) planes of the room, as `PrimitiveScene` has them, in the world: the floor and the wall before the camera."""
    world_from_camera = invert(rig.camera_from_world)
    forward = world_from_camera[:3, 2].copy()
    if np.hypot(forward[0], forward[1]) > 0.3:  # otherwise the camera looks at the floor or the ceiling, and the "wall" is there
        forward[2] = 0.0
    forward /= np.linalg.norm(forward)
    distance = forward @ world_from_camera[:3, 3] + _WALL_M
    return np.array(((0.0, 0.0, 1.0, 0.0, _FLOOR_REFLECTANCE), (*forward, distance, _WALL_REFLECTANCE)))


def board_scene(rig: VirtualRig, board: Board, world_from_board: Matrix) -> PrimitiveScene:
    """The board at a pose, held by somebody who stands behind it; in the world."""
    x0, y0, x1, y1 = plate_size(board)
    side = board.square_m
    spheres = apply(world_from_board, board.marker_centres)
    seen = np.concatenate((spheres, apply(world_from_board, board.corners)))
    eye = invert(rig.camera_from_world)[:3, 3]
    limbs = _operator(world_from_board, (x0, y0, x1, y1))
    plate = Plate(world_from_board, (x0, y0, x1, y1), (-side, -side, board.columns + 1, board.rows + 1, side))
    return PrimitiveScene(
        room(rig),
        limbs[[not _hides(limb, seen, eye) for limb in limbs]],
        np.column_stack((spheres, np.tile((board.marker_radius_m, MARKER_REFLECTANCE), (len(spheres), 1)))),
        plate,
    )


def _operator(world_from_board: Matrix, size: tuple[float, float, float, float]) -> F64:
    """(C, 8) capsules of a person behind the board, whose hands hold the middles of its left and right edge."""
    x0, y0, x1, y1 = size
    left, centre, right = apply(world_from_board, [(x, (y0 + y1) / 2, 0.02) for x in (x0, (x0 + x1) / 2, x1)])
    away = world_from_board[:2, 2] / max(float(np.linalg.norm(world_from_board[:2, 2])), 0.2)
    stand = np.array((*(centre[:2] + 0.5 * away), 0.0))
    side = np.array((away[1], -away[0], 0.0))  # of the person who looks back along `away`, towards the viewer's right
    up = np.array((0.0, 0.0, 1.0))
    hands = (left, right) if (right - left) @ side > 0 else (right, left)
    bodies = [(stand + 0.95 * up, stand + 1.35 * up, 0.16, _CLOTHES), (stand + 1.62 * up, stand + 1.68 * up, 0.10, _SKIN)]
    for sign, hand in zip((-1.0, 1.0), hands, strict=True):
        hip, shoulder = stand + 0.1 * sign * side + 0.9 * up, stand + 0.2 * sign * side + 1.42 * up
        elbow = (shoulder + hand) / 2 + 0.08 * sign * side - 0.1 * up
        bodies += [(hip, hip - 0.8 * up, 0.08, _CLOTHES), (shoulder, elbow, 0.05, _CLOTHES), (elbow, hand, 0.035, _SKIN)]
    return np.array([(*a, *b, radius, reflectance) for a, b, radius, reflectance in bodies])


def _hides(limb: F64, points: F64, eye: F64) -> bool:
    """Whether a capsule (8,) comes near the line of sight to one of the points (N, 3): the operator holds it elsewhere then."""
    along = limb[:3] + np.linspace(0, 1, 16)[:, None] * (limb[3:6] - limb[:3])
    sight = points - eye
    share = (along - eye) @ sight.T / (sight**2).sum(axis=-1)  # (16, N), 1 = as far as the point
    beside = np.linalg.norm(along[:, None] - eye - share[..., None] * sight, axis=-1)
    return bool(((beside < limb[6] + _CLEAR_M) & (share < 1.0)).any())


def pendulum_scene(rig: VirtualRig, pivot: ArrayLike, marker: ArrayLike) -> PrimitiveScene:
    """A marker (3,) on a string from the `pivot` (3,) under a beam; in the world, m."""
    top, bob = np.asarray(pivot, np.float64), np.asarray(marker, np.float64)
    across = invert(rig.camera_from_world)[:3, 0]  # the beam runs across the image
    beam = top + (0.0, 0.0, _BEAM_RADIUS_M)
    return PrimitiveScene(
        room(rig),
        np.array(
            ((*top, *bob, _STRING_RADIUS_M, _STRING), (*(beam - 0.6 * across), *(beam + 0.6 * across), _BEAM_RADIUS_M, _BEAM))
        ),
        np.array(((*bob, PENDULUM_RADIUS_M, MARKER_REFLECTANCE),)),
    )


def see(rig: VirtualRig, scene: PrimitiveScene, *, rng: Generator) -> SensorFrame:
    """What the rig's camera delivers of a scene that is given in the world: depth, amplitude, confidence."""
    sensor = rig.tof_sensor
    return simulate(cast(scene.seen_from(rig.camera_from_world), sensor), sensor, rig.noise, rng=rng)


def as_message(rig: VirtualRig, frame: SensorFrame) -> ToFFrame:
    """A frame as the camera's source would decode it."""
    camera = rig.tof_sensor.camera
    return tof_frame(
        {
            "depth": frame.depth_m,
            "amplitude": frame.amplitude,
            "confidence": frame.confidence,
            "camera_k": camera.k,
            "camera_dist": np.array(camera.dist),
        }
    )

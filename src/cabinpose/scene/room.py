"""A room for one standing person: floor, walls with a recess, ceiling, curtain, furniture.

World frame: z up, origin on the floor under the camera, x forward from the camera into the room, y left. The
default ranges follow what the published ITOP frames show (Haque et al. 2016): a camera about 1.3 m above the floor,
nearly level, a person at 2-4 m, a wall close behind with a recess, clutter at both sides; and a camera that looks down
from 2.6 m above the floor on somebody who stands before the wall.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np

from cabinpose.core import FORWARD_FROM_CAMERA, Floats, axis_rotation, transform
from cabinpose.core import reproducible as rp
from cabinpose.scene import labels, materials
from cabinpose.scene.surface import Surface, merge

Interval = tuple[float, float]
_CLUTTER_MATERIALS = ("wood", "painted_wall", "synthetic_fabric", "rubber", "rubber")  # what is dark twice: it makes the holes
ROOM_VIEWS = ("room", "room_top")


# Triangles (F, 3, 3), counter-clockwise from outside: two a side of the box from (0, 0, 0) to (1, 1, 1), and of an icosahedron.
_UNIT_BOX = np.array(list(itertools.product((0.0, 1.0), repeat=3)))[
    [
        (1, 3, 0), (4, 1, 0), (0, 3, 2), (2, 4, 0), (1, 7, 3), (5, 1, 4), (5, 7, 1), (3, 7, 2), (6, 4, 2), (2, 7, 6), (6, 5, 4),
        (7, 5, 6),
    ]
]  # fmt: skip
_GOLDEN = (1 + 5**0.5) / 2
_ICOSAHEDRON = np.array([np.roll((i, j * _GOLDEN, 0.0), turn) for turn in range(3) for j in (1, -1) for i in (-1, 1)])[
    [
        (0, 11, 5), (0, 5, 1), (0, 1, 7), (0, 7, 10), (0, 10, 11), (1, 5, 9), (5, 11, 4), (11, 10, 2), (10, 7, 6), (7, 1, 8),
        (3, 9, 4), (3, 4, 2), (3, 2, 6), (3, 6, 8), (3, 8, 9), (4, 9, 5), (2, 4, 11), (6, 2, 10), (8, 6, 7), (9, 8, 1),
    ]
]  # fmt: skip


@dataclass(frozen=True)
class Room:
    """One furnished room: its triangles and where a person may stand.

    surface: world frame, instance 0 · height: of the ceiling, m · stand_x, stand_y: intervals (m) of the person's place on the
    floor.
    """

    surface: Surface
    height: float
    stand_x: Interval
    stand_y: Interval


def _normals(triangles: Floats) -> Floats:
    normals = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 1])
    return np.asarray(normals / np.linalg.norm(normals, axis=1, keepdims=True))


def _solid(triangles: Floats, normals: Floats, label: str, material: str) -> Surface:
    """A faceted surface of triangles (F, 3, 3) with normals (F, 3): own vertices for every face, so that edges are hard."""
    count = len(triangles)
    return Surface(
        triangles.reshape(-1, 3).astype(np.float32),
        np.repeat(normals, 3, axis=0).astype(np.float32),
        np.arange(3 * count, dtype=np.int32).reshape(-1, 3),
        np.full(count, labels.LABEL_ID[label], np.uint8),
        np.full(count, materials.MATERIAL_ID[material], np.uint8),
        np.zeros(count, np.uint8),
    )


def _box(low: tuple[float, float, float], high: tuple[float, float, float], label: str, material: str) -> Surface:
    """An upright box, which may be flat."""
    return _solid(_UNIT_BOX * np.subtract(high, low) + low, _normals(_UNIT_BOX), label, material)


def _pot(radius: float, height: float) -> Floats:
    """Triangles (F, 3, 3) of a cylinder that stands upright on the origin."""
    sides = 12
    angle = 2 * np.pi * np.arange(sides) / sides
    low = np.stack((radius * rp.cos(angle), radius * rp.sin(angle), np.zeros(sides)), axis=1)
    high = low + (0.0, 0.0, height)
    next_low, next_high = np.roll(low, -1, axis=0), np.roll(high, -1, axis=0)
    bottom, top = (np.broadcast_to((0.0, 0.0, z), low.shape) for z in (0.0, height))
    faces = ((low, bottom, next_low), (low, next_low, high), (high, next_low, next_high), (high, next_high, top))
    return np.stack([np.stack(face, axis=1) for face in faces], axis=1).reshape(-1, 3, 3)


def _ball(radius: float) -> Floats:
    """Triangles (80, 3, 3) of a sphere about the origin: an icosahedron, every face of it cut in four."""
    a, b, c = np.moveaxis(_ICOSAHEDRON, 1, 0)
    ab, bc, ca = (a + b) / 2, (b + c) / 2, (c + a) / 2
    pieces = [np.stack(piece, axis=1) for piece in ((a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca))]
    corners = np.stack(pieces, axis=1).reshape(-1, 3, 3)
    return corners * (radius / np.linalg.norm(corners, axis=-1, keepdims=True))


def _curtain(x: Interval, y: float, height: float, depth: float, folds: float, phase: float) -> Surface:
    """A hanging cloth along x at `y`, with `folds` waves a metre of `depth` metres."""
    columns = max(int((x[1] - x[0]) * folds * 8), 8)
    along = np.linspace(*x, columns + 1)
    wave = y + depth * (rp.sin(2 * np.pi * folds * along + phase) + 0.4 * rp.sin(5.1 * folds * along + 2 * phase))
    low = np.stack((along, wave, np.zeros_like(along)), axis=1)
    high = np.stack((along, wave, np.full_like(along, height)), axis=1)
    vertices = np.concatenate((low, high))
    i = np.arange(columns)
    quads = np.stack((i, i + 1, i + columns + 2, i + columns + 1), axis=1)
    faces = np.concatenate((quads[:, (0, 1, 2)], quads[:, (0, 2, 3)]))
    return _solid(vertices[faces], _normals(vertices[faces]), "wall", "cotton")


def _back_wall(x: float, half_width: float, height: float, rng: np.random.Generator) -> list[Surface]:
    """A wall across the view at `x`, most often with a recess that has jambs and a lintel."""
    thickness = 1.5
    if rng.random() < 0.25:
        return [_box((x, -half_width, 0), (x + thickness, half_width, height), "wall", "painted_wall")]
    recess = rng.uniform(0.15, 0.6)
    right = rng.uniform(-half_width, -0.4)
    left = min(right + rng.uniform(1.2, 3.0), half_width)
    top = min(rng.uniform(1.9, 2.4), height)
    wall = "wall", "painted_wall"
    pieces = [
        _box((x + recess, -half_width, 0), (x + thickness, half_width, height), *wall),
        _box((x, left, 0), (x + recess, half_width, height), *wall),
        _box((x, -half_width, 0), (x + recess, right, height), *wall),
        _box((x, right, top), (x + recess, left, height), *wall),
    ]
    if rng.random() < 0.6:  # a door leaf or a panel inside the recess
        y = rng.uniform(right, max(left - 0.4, right))
        depth = rng.uniform(0.03, 0.12)
        pieces.append(_box((x + recess - depth, y, 0), (x + recess, y + rng.uniform(0.4, 1.0), top), "wall", "wood"))
    return pieces


def _chair(x: float, y: float, rng: np.random.Generator) -> list[Surface]:
    seat, half, back = rng.uniform(0.42, 0.5), rng.uniform(0.2, 0.26), rng.uniform(0.8, 1.05)
    wood = "furniture", "wood"
    legs = [
        _box(
            (x + i * (half - 0.04) - 0.02, y + j * (half - 0.04) - 0.02, 0),
            (x + i * (half - 0.04) + 0.02, y + j * (half - 0.04) + 0.02, seat),
            *wood,
        )
        for i in (-1, 1)
        for j in (-1, 1)
    ]
    turn = rng.integers(4)
    backs = (
        ((x + half - 0.04, y - half, seat), (x + half, y + half, back)),
        ((x - half, y - half, seat), (x - half + 0.04, y + half, back)),
        ((x - half, y + half - 0.04, seat), (x + half, y + half, back)),
        ((x - half, y - half, seat), (x + half, y - half + 0.04, back)),
    )
    return [*legs, _box((x - half, y - half, seat - 0.04), (x + half, y + half, seat), *wood), _box(*backs[turn], *wood)]


def _clutter(x: Interval, side: int, inner: float, rng: np.random.Generator) -> list[Surface]:
    """Furniture along one side of the room, farther from the middle than |y| = `inner` (m)."""
    pieces: list[Surface] = []
    for _ in range(rng.integers(1, 5)):
        px, py = rng.uniform(*x), side * (inner + rng.uniform(0.25, 0.9))
        kind = rng.random()
        # Dark things return nothing to a structured-light camera: real frames have such holes at their sides.
        surface = _CLUTTER_MATERIALS[rng.integers(len(_CLUTTER_MATERIALS))]
        if kind < 0.35:
            pieces += _chair(px, py, rng)
        elif kind < 0.75:  # a cupboard, a box, a desk
            half = rng.uniform(0.12, 0.3, 2)
            top = rng.uniform(0.3, 1.4)
            pieces.append(_box((px - half[0], py - half[1], 0), (px + half[0], py + half[1], top), "furniture", surface))
        else:  # a plant or a heap: spheres of leaves on a pot
            stem = rng.uniform(0.5, 1.2)
            pot = _pot(0.14, 0.4) + (px, py, 0.0)
            pieces.append(_solid(pot, _normals(pot), "furniture", "hard_plastic"))
            for _ in range(8):
                ball = _ball(rng.uniform(0.06, 0.16)) + ((px, py, stem) + rng.normal(0, 0.16, 3))
                pieces.append(_solid(ball, _normals(ball), "furniture", surface))
    return pieces


def _near(side: int, rng: np.random.Generator) -> Surface:
    """Something that stands between the camera and the person, at the edge of the image."""
    x, half = rng.uniform(0.9, 1.7), rng.uniform(0.08, 0.3, 2)
    y = side * (0.36 * x + half[1] + rng.uniform(0.0, 0.25))
    low, high = (x - half[0], y - half[1], 0.0), (x + half[0], y + half[1], rng.uniform(0.6, 1.3))
    return _box(low, high, "furniture", _CLUTTER_MATERIALS[rng.integers(len(_CLUTTER_MATERIALS))])


def furnish_room(*, rng: np.random.Generator) -> Room:
    """A room drawn at random; the middle stays free for a person who moves."""
    half_width, height = rng.uniform(1.8, 3.2), rng.uniform(2.5, 3.2)
    wall_x = rng.uniform(3.5, 5.0)
    shell = 0.3
    pieces = [
        _box((-2.0, -half_width - 1, -shell), (wall_x + 1, half_width + 1, 0), "floor", "carpet"),
        _box((-2.0, -half_width - 1, height), (wall_x + 1, half_width + 1, height + shell), "wall", "painted_wall"),
        _box((-2.0, half_width, 0), (wall_x + 1, half_width + shell, height), "wall", "painted_wall"),
        _box((-2.0, -half_width - shell, 0), (wall_x + 1, -half_width, height), "wall", "painted_wall"),
        *_back_wall(wall_x, half_width, height, rng),
    ]
    free = 0.85
    for side in (-1, 1):
        if rng.random() < 0.5:
            start = rng.uniform(2.0, 2.8)
            inner = side * rng.uniform(free + 0.1, max(half_width - 0.1, free + 0.2))
            pieces.append(
                _curtain(
                    (start, wall_x),
                    inner,
                    rng.uniform(2.0, height),
                    rng.uniform(0.02, 0.07),
                    rng.uniform(2, 5),
                    rng.uniform(0, 6),
                )
            )
        if rng.random() < 0.8:
            pieces += _clutter((1.6, wall_x - 0.2), side, free, rng)
        if rng.random() < 0.35:
            pieces.append(_near(side, rng))
    return Room(merge(pieces), height, (2.3, max(wall_x - 0.75, 2.6)), (-0.4, 0.4))


def place_room_camera(view: str, room: Room, *, rng: np.random.Generator) -> tuple[Floats, Floats]:
    """`world_from_camera` (4, 4) of one of ROOM_VIEWS, and the point (3,), m, of the floor on which the person stands.

    room: on a tripod or shelf, 1.1-1.6 m high, pitched from 2 degrees up to 6 degrees down, nearly level. room_top: 2.4-2.75 m
    above the floor, within 0.28 m of the person and 1.1 m of the wall behind, looking down to a few degrees; the wall is at the
    top of its image.
    """
    yaw, roll = np.radians((rng.normal(0, 2.0), rng.normal(0, 1.0)))
    if view == "room_top":
        low = (room.stand_x[1] - 0.35, -0.15, 2.4)
        eye = rng.uniform(low, (room.stand_x[1] + 0.15, 0.15, min(2.75, room.height - 0.05)))
        pitch = np.pi / 2 + np.radians(rng.normal(0, 3.0))
        spot = eye * (1.0, 1.0, 0.0) + (*rng.uniform(-0.28, 0.28, 2), 0.0)
    else:
        spot = np.array((rng.uniform(*room.stand_x), rng.uniform(*room.stand_y), 0.0))
        eye = np.array((0.0, rng.normal(0, 0.05), rng.uniform(1.1, 1.6)))
        pitch = np.radians(rng.uniform(-2.0, 6.0))
    # A positive turn about y (left) looks down.
    turn = rp.matmul(axis_rotation("z", yaw), axis_rotation("y", pitch), axis_rotation("x", roll))
    return transform(rp.matmul(turn, FORWARD_FROM_CAMERA), eye), spot

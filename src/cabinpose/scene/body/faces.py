"""Faces: whose they are (`with_face`), and what they do: eyes that turn, lids that close, brows, mouths (`Face`, `FaceRig`).

Shapes and units are MakeHuman's, see `tools/export_faces.py`. Shapes leave the skull above the brows, by whose measures bodies
are made; units move what is seen alone, so that nothing else depends on them.
"""

from __future__ import annotations

import zipfile
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from importlib.resources import files
from types import MappingProxyType
from typing import Literal, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from cabinpose.core import AssetError, Floats, Floats32, Ints, Ints32, axis_rotation
from cabinpose.core import reproducible as rp
from cabinpose.scene.body.chart import load_chart
from cabinpose.scene.body.parts import Blend, cut_skin
from cabinpose.scene.body.shape import load_shape_space

FACES = "faces.npz"  # beside the body's assets

# Standard deviation of a key's coefficient: as much as moves what it moves most by so much, and no more than this (assumed; the
# keys' limits are 1). How much of a variance of one side both sides have in common, and of the keys that make faces crooked.
_TYPICAL_M, _MOST_SD, _BOTH_SIDES, _CROOKED = 0.0022, 0.45, 0.85, 0.5
_MOST = 2.0  # standard deviations

# Eyes, of the data's oversized balls: the radius where lids lie on them, as a share of the rims' least distance from the middle.
_BALL, _SOCKET = 0.965, 0.15
# Edges of pupil and iris as angles from the line of sight: an iris of 11.7 mm and a pupil of 4 mm (both assumed) on the ball of
# the average adult, whose rims leave as much of it open as is usual. Then the ball, to its back.
_RINGS_DEG = (7.5, 22.0, 40.0, 65.0, 100.0)
_RING_MATERIALS = ("pupil", "iris", "eye")  # of the first bands; the rest is as the last
_ROUND = 12
_LID_M, _OVERLAP_M = 0.0007, 0.0003  # thickness of a lid on the ball; how far the upper closes over the lower
_HOLLOW_M = (0.035, 0.0, 0.006)  # by which the middle of the mouth goes back and down when it is wide open (assumed)
_LIPS_CLOSE = 0.8  # of the gap between them that the data have

Side: TypeAlias = Literal["l", "r"]


@dataclass(frozen=True)
class Face:
    """What a face does.

    gaze: unit vector of the line of sight, of both eyes, in the head's frame · lids: opening of the left and of the right eye, 0
    closed to 1 open · expression: its name · units: shares of face units by name (`jawOpen`, `mouthSmileLeft`, ...), 0 to 1.
    """

    gaze: tuple[float, float, float] = (1.0, 0.0, 0.0)
    lids: tuple[float, float] = (1.0, 1.0)
    expression: str = "neutral"
    units: tuple[tuple[str, float], ...] = ()


class Move(NamedTuple):
    """By how much (N, 3) m some vertices (N,) move."""

    vertex: Ints
    offset: Floats32


class FaceShapes(NamedTuple):
    """The asset: by name, moves of the skin's vertices, on the average adult. Of both sides where a key has one.

    keys: of shape, midline and crooked ones by name, those of a side as (left, right) · units: of expressions.
    """

    keys: Mapping[str, Move | tuple[Move, Move]]
    units: Mapping[str, Move]


@cache
def load_faces() -> FaceShapes:
    """The packaged asset, read once per process. Raises AssetError where it is missing or damaged."""
    try:
        with (files("cabinpose.scene.body") / "assets" / FACES).open("rb") as stream, np.load(stream) as data:
            names, first = data["names"].tolist(), data["first"].tolist()
            vertex, offset = data["vertex"].astype(np.int64), (data["offset"] * data["step"]).astype(np.float32)
            count = int(data["keys"])
    except (OSError, KeyError, ValueError, zipfile.BadZipFile) as error:
        raise AssetError(f"the asset {FACES} cannot be read: {error}", hint="install the package again") from error
    moves = {n: Move(vertex[a:b], offset[a:b]) for n, a, b in zip(names, first[:-1], first[1:], strict=True)}
    keys = {n: (moves[n], _mirrored(moves[n])) if n.startswith("l-") else moves[n] for n in names[:count]}
    units = {n: moves[n] for n in names[count:]}
    units["jawOpen"] = _hollow(units["jawOpen"])
    units |= {n.removesuffix("Left") + "Right": _mirrored(move) for n, move in units.items() if n.endswith("Left")}
    return FaceShapes(MappingProxyType(keys), MappingProxyType(units))


def _mirrored(move: Move) -> Move:
    return Move(load_shape_space().mirror[move.vertex].astype(np.int64), move.offset * np.array((1.0, -1.0, 1.0), np.float32))


def _hollow(jaw_open: Move) -> Move:
    """The unit with which the lid of the mouth becomes a hollow."""
    offset = jaw_open.offset.copy()
    offset[jaw_open.vertex == _lid_centres()[0]] -= np.array(_HOLLOW_M, np.float32)
    return Move(jaw_open.vertex, offset)


@cache
def _usual_eye_distance_m() -> float:
    heads = load_chart().heads
    return float(rp.norm(heads["leye"] - heads["reye"]))


@cache
def _key_moves() -> tuple[tuple[Move, ...], ...]:
    """Of each key, of its one or two sides, the move that a standard deviation makes."""
    result = []
    for name, key in load_faces().keys.items():
        sides = (key,) if isinstance(key, Move) else key
        sd = min(_TYPICAL_M / float(np.abs(sides[0].offset).max()), _MOST_SD) * (_CROOKED if name.startswith("asym") else 1.0)
        result.append(tuple(Move(side.vertex, np.float32(sd) * side.offset) for side in sides))
    return tuple(result)


def with_face(skin: Floats32, heads: Floats, named: Mapping[str, int], number: int) -> Floats32:
    """A body's skin (V, 3), m, with the face of this number; its keys are as large as the eyes are far apart.

    heads: (H, 3) m, bone heads by the index that `named` gives them.
    """
    rng = np.random.Generator(np.random.Philox(key=number))
    size = float(rp.norm(heads[named["leye"]] - heads[named["reye"]])) / _usual_eye_distance_m()
    keys, result = _key_moves(), skin.copy()
    z = size * np.clip(rng.standard_normal((len(keys), 3)), -_MOST, _MOST)  # of both sides, of the left, of the right
    sides = np.sqrt(_BOTH_SIDES) * z[:, :1] + np.sqrt(1.0 - _BOTH_SIDES) * z[:, 1:]
    for moves, both, own in zip(keys, z[:, 0].astype(np.float32), sides.astype(np.float32), strict=True):
        for move, share in zip(moves, own if len(moves) == 2 else (both,), strict=True):
            result[move.vertex] += share * move.offset
    return result


class _Lids(NamedTuple):
    """The topology of one eye's lids.

    rim: (28,) vertices around the opening · upper, lower: those of its halves, from right to left, the lower with the corners ·
    moved: as in the unit · near, follows: (M,) the one of the upper vertices that each of these is nearest to, and how much of
    its way it goes.
    """

    rim: Ints
    upper: Ints
    lower: Ints
    moved: Move
    near: Ints
    follows: Floats


@cache
def _lid_centres() -> tuple[int, int, int]:
    """The vertices in the middle of the mouth's lid and of the left and right eye's: the last ones of the skin."""
    count = load_shape_space().vertex_count
    rest = load_chart().rest
    mouth, *eyes = sorted(range(count - 3, count), key=lambda i: abs(rest[i, 1]))
    left, right = sorted(eyes, key=lambda i: -rest[i, 1])
    return mouth, left, right


@cache
def _fan(centre: int) -> Ints:
    """The rim (N,) of the fan of faces about a vertex, in order."""
    faces = load_shape_space().faces
    of_fan, at = np.nonzero(faces == centre)
    following = dict(zip(faces[of_fan, (at + 1) % 3].tolist(), faces[of_fan, (at + 2) % 3].tolist(), strict=True))
    loop = [min(following)]
    while (after := following[loop[-1]]) != loop[0]:
        loop.append(after)
    return np.array(loop)


def _halves(rim: Ints) -> tuple[Ints, Ints]:
    """The upper half of a rim, without its corners, and the lower one with them, each from right to left."""
    rest = load_chart().rest
    rim = np.roll(rim, -int(np.argmin(rest[rim, 1])))
    corner = int(np.argmax(rest[rim, 1]))
    one, other = rim[: corner + 1], np.roll(rim, -1)[: corner - 1 : -1]
    upper, lower = sorted((one, other), key=lambda half: -float(rest[half, 2].mean()))
    return upper[1:-1], lower


def _beside(these: Ints, others: Ints, points: NDArray[np.floating]) -> Floats:
    """What lies beside the vertices `these` (N,), above or below, on the line through others (M,) that are at points (M, 3)."""
    aside = load_chart().rest[:, 1]
    return np.stack([np.interp(aside[these], aside[others], points[:, k]) for k in range(3)], axis=1)


def close_lips(vertices: Floats32, rows: Ints) -> None:
    """Bring the lips together, in place; rows: the first of `vertices` on the cut skin."""
    upper, lower = _halves(_fan(_lid_centres()[0]))
    lips = np.concatenate([lower[:1], upper, lower[-1:]]), lower
    at = [vertices[np.searchsorted(rows, lip)] for lip in lips]
    for this, other, own, points in zip(lips, lips[::-1], at, at[::-1], strict=True):
        vertices[np.searchsorted(rows, this)] = own + _LIPS_CLOSE / 2.0 * (_beside(this, other, points) - own)


@cache
def _lids(side: Side) -> _Lids:
    rest, middle = load_chart().rest, _lid_centres()["lr".index(side) + 1]
    rim = _fan(middle)
    upper, lower = _halves(rim)
    blink = load_faces().units[f"eyeBlink{'Left' if side == 'l' else 'Right'}"]
    blink = Move(blink.vertex[blink.vertex != middle], blink.offset[blink.vertex != middle])  # which is in the ball
    down = np.zeros(len(rest))
    down[blink.vertex] = -blink.offset[:, 2]
    near = np.argmin(np.abs(rest[blink.vertex, None, 1] - rest[None, upper, 1]), axis=1)
    follows = np.clip(down[blink.vertex] / np.maximum(down[upper[near]], 1e-4), 0.0, 1.0)
    return _Lids(rim, upper, lower, blink, near, follows)


def _closing(skin: Floats32, centre: Floats, side: Side, size: float) -> Floats:
    """(V, 3) m, how an eye's lids move until they meet, on a person's skin (V, 3): as in the unit, and on by what is left."""
    lids = _lids(side)
    way = np.zeros((len(skin), 3))
    way[lids.moved.vertex] = size * lids.moved.offset
    meet = _beside(lids.upper, lids.lower, skin[lids.lower] + way[lids.lower])
    outwards = meet - centre
    meet = meet + _OVERLAP_M * (outwards / np.linalg.norm(outwards, axis=1)[:, None] - (0.0, 0.0, 1.0))
    lacks = meet - (skin[lids.upper] + way[lids.upper])
    way[lids.moved.vertex] += lids.follows[:, None] * lacks[lids.near]
    way[lids.upper] = meet - skin[lids.upper]
    return way


class Eyes(NamedTuple):
    """Where a person's eyes are, left and right: centres (2, 3) and radii (2,), m."""

    centre: Floats
    radius: Floats

    @classmethod
    def of(cls, skin: Floats32, centre: Floats) -> Eyes:
        """Of a skin (V, 3) at rest, with the balls' centres (2, 3): as large as the lids leave room for."""
        least = [np.linalg.norm(skin[_lids(side).rim] - c, axis=1).min() for side, c in zip(_SIDES, centre, strict=True)]
        return cls(centre, _BALL * np.array(least))

    def make_sockets(self, vertices: Floats32, rows: Ints) -> None:
        """Draw back the middles of the lids' fans into the balls, in place; rows: the first of `vertices` on the cut skin."""
        for side, middle in enumerate(_lid_centres()[1:]):
            vertices[np.searchsorted(rows, middle)] = self.centre[side] + (_SOCKET * self.radius[side], 0.0, 0.0)

    def balls(self) -> Floats:
        """(2, N, 3) m, vertices of both, looking ahead."""
        return self.centre[:, None] + self.radius[:, None, None] * ball()[0]


_SIDES: tuple[Side, Side] = ("l", "r")


@cache
def ball() -> tuple[Floats, Ints32, tuple[str, ...]]:
    """Vertices (N, 3) of an eyeball of radius 1 that looks along x, its faces (F, 3), and the material of each."""
    turn = np.arange(_ROUND) * (2.0 * np.pi / _ROUND)
    angle = np.radians(_RINGS_DEG)
    rings = np.stack(
        [
            np.repeat(rp.cos(angle)[:, None], _ROUND, axis=1),
            rp.sin(angle)[:, None] * rp.cos(turn),
            rp.sin(angle)[:, None] * rp.sin(turn),
        ],
        axis=2,
    )
    vertices = np.concatenate([[(1.0, 0.0, 0.0)], rings.reshape(-1, 3), [(-1.0, 0.0, 0.0)]])
    j = np.arange(_ROUND)
    after, last = (j + 1) % _ROUND, len(vertices) - 1
    bands = [np.stack([np.zeros_like(j), 1 + j, 1 + after], axis=1)]
    for ring in range(len(angle) - 1):
        a, b = 1 + ring * _ROUND, 1 + (ring + 1) * _ROUND
        bands.append(np.concatenate([np.stack([a + j, b + j, b + after], 1), np.stack([a + j, b + after, a + after], 1)]))
    end = 1 + (len(angle) - 1) * _ROUND
    bands.append(np.stack([end + j, np.full_like(j, last), end + after], axis=1))
    of_band = (*_RING_MATERIALS, *[_RING_MATERIALS[-1]] * (len(bands) - len(_RING_MATERIALS)))
    materials = tuple(name for name, band in zip(of_band, bands, strict=True) for _ in range(len(band)))
    return vertices, np.concatenate(bands).astype(np.int32), materials


@cache
def mouth_faces() -> Ints:
    """The faces of the cut skin that close the mouth."""
    return np.flatnonzero((load_shape_space().faces == _lid_centres()[0]).any(axis=1)[cut_skin().source])


class FaceMesh(NamedTuple):
    """Where a face is on a mesh that is seen.

    units: moves of its vertices · lids: of the left and right eye, the vertices that closing moves, as blends of the skin's ·
    balls: the first of the eyeballs' vertices.
    """

    units: Mapping[str, Move]
    lids: tuple[tuple[Ints, Blend], tuple[Ints, Blend]]
    balls: int

    @classmethod
    def of(cls, rows: Ints) -> FaceMesh:
        """Of the mesh whose vertices are these (R,) of the cut skin, then the eyeballs'."""
        cut, count = cut_skin(), load_shape_space().vertex_count
        own = np.repeat(np.arange(count)[:, None], 3, axis=1)
        blend = Blend(
            np.concatenate([own, cut.blend.parents])[rows].astype(np.int32),
            np.concatenate([np.tile((1.0, 0.0, 0.0), (count, 1)), cut.blend.weights])[rows],
        )
        units = {}
        for name, move in load_faces().units.items():
            every = np.zeros((count, 3))
            every[move.vertex] = move.offset
            moved = blend.of(every).astype(np.float32)
            at = np.flatnonzero(moved.any(axis=1))
            units[name] = Move(at, moved[at])

        def lid(side: Side) -> tuple[Ints, Blend]:
            moves = np.zeros(count)
            moves[[*_lids(side).moved.vertex, *_lids(side).upper]] = 1.0
            at = np.flatnonzero(blend.of(moves))
            return at, blend[at]

        return cls(MappingProxyType(units), (lid("l"), lid("r")), len(rows))


class FaceRig:
    """What moves in a person's face, on the mesh that is seen."""

    def __init__(self, skin: Floats32, eyes: Eyes, mesh: FaceMesh) -> None:
        """skin: (V, 3) at rest, m."""
        self._eyes, self._mesh = eyes, mesh
        self._size = float(rp.norm(eyes.centre[0] - eyes.centre[1])) / _usual_eye_distance_m()
        self._closing = [
            Move(at, blend.of(_closing(skin, centre, side, self._size)).astype(np.float32))
            for side, centre, (at, blend) in zip(_SIDES, eyes.centre, mesh.lids, strict=True)
        ]

    def move(self, vertices: Floats32, face: Face) -> None:
        """Make the face on vertices (N, 3) of the mesh at rest, in place."""
        for name, share in sorted(face.units):
            unit = self._mesh.units[name]
            vertices[unit.vertex] += np.float32(self._size * share) * unit.offset
        for side, opening in enumerate(face.lids):
            if opening < 1.0:
                self._close(vertices, side, 1.0 - opening)
        yaw, pitch = rp.arctan2(face.gaze[1], face.gaze[0]), rp.arcsin(min(max(face.gaze[2], -1.0), 1.0))
        turned = rp.matmul(ball()[0], rp.matmul(axis_rotation("z", yaw), axis_rotation("y", -pitch)).T)
        balls = self._eyes.centre[:, None] + self._eyes.radius[:, None, None] * turned
        vertices[self._mesh.balls : self._mesh.balls + 2 * len(turned)] = balls.reshape(-1, 3)

    def _close(self, vertices: Floats32, side: int, share: float) -> None:
        """The lids slide over the ball, not through it."""
        closing = self._closing[side]
        at = vertices[closing.vertex] + np.float32(share) * closing.offset - self._eyes.centre[side]
        away = np.sqrt((at * at).sum(axis=1))
        least = self._eyes.radius[side] + _LID_M
        vertices[closing.vertex] = self._eyes.centre[side] + at * np.maximum(least / away, 1.0)[:, None]

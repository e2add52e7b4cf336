"""Meshes of things worn that are not a layer off the skin: grids, tubes, closed sheets, and cloth draped about an axis."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from typing import NamedTuple

import numpy as np

from cabinpose._native import body
from cabinpose.core import Bools, Bytes, Floats, Ints, Ints32
from cabinpose.core import reproducible as rp
from cabinpose.scene import labels, materials
from cabinpose.scene.body.outfit import Garment
from cabinpose.scene.body.parts import cut_skin
from cabinpose.scene.body.rig import BONES

PLACES = ("", "hair", "top", "bottom", "socks", "headwear", "inner", "scarf", "gloves", "mask")
"""Whose colour and dye triangles have where their material does not tell; "inner" is the shirt under an open jacket."""
_TURNS = 48  # directions of a section's hull


@dataclass(frozen=True)
class Accessory:
    """A mesh at rest (N, 3) m in root axes with faces (F, 3), bound to `bones` with weights (N, len(bones)).

    worn: the place of `PLACES` whose colour and dye it has, "" where its material says so · seated: (N, 3) m, by which it is
    moved at rest where both hips are bent, None where it is not.
    """

    vertices: Floats
    faces: Ints32
    bones: tuple[str, ...]
    weights: Floats
    label: Bytes
    material: Bytes
    worn: str = ""
    seated: Floats | None = None


def rigid(vertices: Floats, faces: Ints32, bone: str, label: str, material: str, worn: str = "") -> Accessory:
    """A mesh that moves with one bone."""
    count = len(faces)
    return Accessory(
        vertices, faces, (bone,), np.ones((len(vertices), 1)), np.full(count, labels.LABEL_ID[label], np.uint8),
        np.full(count, materials.MATERIAL_ID[material], np.uint8), worn,
    )  # fmt: skip


@cache
def grid_faces(rows: int, columns: int, *, closed: bool) -> Ints32:
    """Triangles of a grid of vertices in row order; `closed`: the last column joins the first."""
    i, j = np.mgrid[: rows - 1, : columns if closed else columns - 1].reshape(2, -1)
    a, b = i * columns + j, i * columns + (j + 1) % columns
    return np.stack([a, b, b + columns, a, b + columns, a + columns], axis=1).reshape(-1, 3).astype(np.int32)


def closing_faces(rows: int, columns: int) -> Ints32:
    """Triangles between the last row of a closed grid and its first, which make it a ring."""
    j = np.arange(columns)
    last, first, step = (rows - 1) * columns + j, j, (j + 1) % columns
    return np.concatenate(
        [np.stack([last, (rows - 1) * columns + step, step], axis=1), np.stack([last, step, first], axis=1)]
    ).astype(np.int32)


@cache
def tube_faces(n: int, m: int) -> Ints32:
    """Triangles of a closed grid (n, m), and of lids about two vertices after it."""
    j = np.arange(m)
    first = np.stack([(j + 1) % m, j, np.full(m, n * m)], axis=1)
    last = np.stack([(n - 1) * m + j, (n - 1) * m + (j + 1) % m, np.full(m, n * m + 1)], axis=1)
    return np.concatenate([grid_faces(n, m, closed=True), first, last]).astype(np.int32)


def tube(sections: Floats) -> tuple[Floats, Ints32]:
    """Closed surface through sections (n, m, 3), with a lid at both ends."""
    n, m, _ = sections.shape
    return np.concatenate([sections.reshape(-1, 3), sections[[0, -1]].mean(axis=1)]), tube_faces(n, m)


def sheet(outer: Floats, inner: Floats) -> tuple[Floats, Ints32]:
    """Closed thin surface between two grids (n, m, 3), with strips along the four borders."""
    n, m, _ = outer.shape
    faces = grid_faces(n, m, closed=False)
    index = np.arange(n * m).reshape(n, m)
    border = np.concatenate([index[0, :-1], index[:-1, -1], index[-1, :0:-1], index[:0:-1, 0]])
    following = np.roll(border, -1)
    strips = [(a, b, a + n * m) for a, b in zip(border, following, strict=True)]
    strips += [(b, b + n * m, a + n * m) for a, b in zip(border, following, strict=True)]
    vertices = np.concatenate([outer.reshape(-1, 3), inner.reshape(-1, 3)])
    return vertices, np.concatenate([faces[:, ::-1], faces + n * m, strips]).astype(np.int32)


def outward(vertices: Floats, faces: Ints32) -> Ints32:
    """The faces of a closed mesh, turned so that its volume is positive."""
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    return faces if np.einsum("ij,ij->", a, np.cross(b, c)) > 0 else np.ascontiguousarray(faces[:, ::-1])


def rod(a: Floats, b: Floats, radius: float, label: str = "glasses", material: str = "hard_plastic") -> Accessory:
    """A square bar from a to b, on the head."""
    along = (b - a) / rp.norm(b - a)
    side = np.cross(along, (0.0, 0.0, 1.0))
    side /= rp.norm(side)
    up = np.cross(side, along)
    corners = [side + up, side - up, -side - up, -side + up]
    vertices, faces = tube(np.array([[end + radius * k for k in corners] for end in (a, b)]))
    return rigid(vertices, outward(vertices - vertices.mean(axis=0), faces), "head", label, material)


def shell(outer: Floats, inner: Floats) -> tuple[Floats, Ints32]:
    """Closed thin surface between two tubes (n, m, 3) whose last column joins the first, with a rim at both ends."""
    n, m, _ = outer.shape
    faces, j = grid_faces(n, m, closed=True), np.arange(m)
    rims = []
    for start, turn in ((0, 1), ((n - 1) * m, -1)):
        a, b = start + j, start + (j + 1) % m
        rim = np.concatenate([np.stack([a, b, b + n * m], axis=1), np.stack([a, b + n * m, a + n * m], axis=1)])
        rims.append(rim[:, ::-turn])
    both = np.concatenate([outer.reshape(-1, 3), inner.reshape(-1, 3)])
    return both, np.concatenate([faces, faces[:, ::-1] + n * m, *rims]).astype(np.int32)


class Cloud(NamedTuple):
    """What cloth is draped over: points (P, 3) m, and the seen vertex (P,) of which each has bones and label."""

    points: Floats
    vertex: Ints

    def where(self, chosen: Bools) -> Cloud:
        """Those chosen (P,)."""
        return Cloud(self.points[chosen], self.vertex[chosen])


class Draped(NamedTuple):
    """Cloth on a grid: points (n, m, 3) m, unit directions outwards (n, m, 3), weights (n, m, B) of all bones, label (n, m)."""

    points: Floats
    outwards: Floats
    weights: Floats
    label: Bytes

    def cloth(self, thick: Floats | float, of: Garment, *, closed: bool) -> Accessory:
        """The cloth of a garment, `thick` m inwards; closed: the last column joins the first."""
        inner = self.points - self.outwards * (np.zeros(self.points.shape[:2]) + thick)[..., None]
        vertices, faces = (shell if closed else sheet)(self.points, inner)
        return self._made(vertices, faces, 2, of)

    def solid(self, of: Garment) -> Accessory:
        """What the points enclose, whose last row and column join the first."""
        n, m = self.label.shape
        faces = np.concatenate([grid_faces(n, m, closed=True), closing_faces(n, m)])
        return self._made(self.points.reshape(-1, 3), faces, 1, of)

    def _made(self, vertices: Floats, faces: Ints32, times: int, of: Garment) -> Accessory:
        under = np.tile(self.label.ravel(), times)[faces[:, 0]]
        return Accessory(
            vertices, outward(vertices - vertices.mean(axis=0), faces), BONES,
            np.tile(self.weights.reshape(-1, len(BONES)), (times, 1)),
            np.full(len(faces), labels.LABEL_ID[of.label], np.uint8) if of.label else under,
            np.full(len(faces), materials.MATERIAL_ID[of.material], np.uint8), of.coat,
        )  # fmt: skip


@cache
def seen_labels() -> Bytes:
    """(V + N,) label of a face at each seen vertex."""
    cut = cut_skin()
    result = np.zeros(int(cut.faces.max()) + 1, np.uint8)
    result[cut.faces.ravel()] = np.repeat(cut.label, 3)
    return result


def bound(vertex: Ints, shape: tuple[int, int], sweeps: int, *, closed: bool) -> tuple[Floats, Bytes]:
    """Weights (n, m, B) of all bones, evened, and labels (n, m) of cloth that touches seen vertices (n * m,)."""
    cut = cut_skin()
    dense = np.zeros((len(vertex), len(BONES)))
    for k in range(cut.bone_index.shape[1]):
        np.add.at(dense, (np.arange(len(vertex)), cut.bone_index[vertex, k]), cut.bone_weight[vertex, k])
    weights = dense.reshape(*shape, -1)
    for _ in range(sweeps):
        weights = _evened(weights, closed=closed)
    return weights / weights.sum(axis=2, keepdims=True), seen_labels()[vertex].reshape(shape)


def _evened(values: Floats, *, closed: bool) -> Floats:
    """Each of a grid (n, m, ...) half way to the mean of its four neighbours; borders have themselves beyond."""
    up, down = np.concatenate([values[:1], values[:-1]]), np.concatenate([values[1:], values[-1:]])
    if closed:
        left, right = np.roll(values, 1, axis=1), np.roll(values, -1, axis=1)
    else:
        left = np.concatenate([values[:, :1], values[:, :-1]], axis=1)
        right = np.concatenate([values[:, 1:], values[:, -1:]], axis=1)
    return np.asarray(0.5 * values + 0.125 * (up + down + left + right))


def drape(
    cloud: Cloud, origin: Floats, direction: Floats, *, ball: float, off: Floats | float, sweeps: int, closed: bool
) -> Draped:
    """Cloth (n, m) on rays from `origin` along `direction` (n, m, 3), stretched over a cloud.

    ball: radius, m, of one that rolls on the cloud and bridges what lies between its points · off: distance from it, m,
    (n, m) or one number · sweeps: how far it is pulled taut.
    """
    length = rp.power(np.einsum("ijk,ijk->ij", direction, direction), 0.5)
    direction = direction / length[..., None]
    radius, touched = np.empty(length.shape), np.empty(length.shape, np.int64)
    body.roll_ball(
        np.ascontiguousarray(cloud.points),
        origin=np.ascontiguousarray(np.broadcast_to(origin, direction.shape)), direction=direction, ball=ball,
        radius=radius, touched=touched,
    )  # fmt: skip
    inside = radius < 0.0  # rays that meet nothing take the shortest of the others
    radius[inside] = radius[~inside].min()
    least = radius.copy()
    for _ in range(sweeps):
        radius = np.maximum(least, _evened(radius[..., None], closed=closed)[..., 0])
    radius = radius + off
    weights, label = bound(cloud.vertex[touched.ravel()], radius.shape, max(sweeps, 8), closed=closed)
    return Draped(origin + direction * radius[..., None], direction, weights, label)


def hull_radius(points: Floats, angle: Floats) -> Floats:
    """Distance (m,) from the origin to the convex hull of points (P, 2), which has it inside, along `angle` (m,) rad."""
    turn = np.arange(_TURNS) * (2 * np.pi / _TURNS)
    support = (points[:, :1] * rp.cos(turn) + points[:, 1:] * rp.sin(turn)).max(axis=0)
    slant = rp.cos(angle[:, None] - turn)
    return np.asarray(np.where(slant > 0.05, support / np.maximum(slant, 0.05), np.inf).min(axis=1))

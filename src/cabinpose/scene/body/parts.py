"""The mesh that is seen: the skin refined where clothes lie, and cut along the borders of body parts and of things worn.

A border so runs smoothly across the faces, and folds of cloth find vertices enough to show.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray

from cabinpose.core import Bools, Bytes, Floats, Floats32, Ints, Ints32
from cabinpose.core import reproducible as rp
from cabinpose.scene import labels
from cabinpose.scene.body.chart import load_chart
from cabinpose.scene.body.coverage import BOTTOM_ENDS, HEM_M, TOP_ENDS, borders
from cabinpose.scene.body.shape import load_shape_space

_SNAP = 0.15  # a border that passes this near to a vertex (share of an edge) goes through it: no slivers

# Borders, in the units of the chart: along the arm and the leg, up the trunk, and shares.
_ARM = ((0.36, "upper_arm"), (0.84, "elbow"), (1.15, "forearm"), (1.86, "wrist"), (2.12, "hand"))
_LEG = ((0.22, "thigh"), (0.85, "knee"), (1.15, "shin"), (1.85, "ankle"), (2.25, "foot"))
_LONGEST_EDGE_M = 0.036  # on the clothed body of the average adult: folds are two to four edges long
_WAIST, _HIP_CENTRE, _SHOULDER_Y, _SHOULDER_REACH = 0.16, 0.55, 0.84, 0.45


@dataclass(frozen=True)
class Blend:
    """Points (M,) on the skin's faces as blends of its vertices: parents, weights (M, 3), weight 0 where fewer than 3 are needed.

    `blend.of(values)` are the values (M, ...) there of what has values (V, ...) at the vertices.
    """

    parents: Ints32
    weights: NDArray[np.floating]

    def of(self, values: Floats) -> Floats:
        first, second, third = (
            self.weights[:, k].reshape(-1, *[1] * (values.ndim - 1)) * values[self.parents[:, k]] for k in range(3)
        )
        return np.asarray(first + second + third)

    def __getitem__(self, rows: slice | Ints) -> Blend:
        return Blend(self.parents[rows], self.weights[rows])

    def __len__(self) -> int:
        return len(self.parents)

    def and_between(self, a: Ints, b: Ints, share: Floats) -> Blend:
        """These points, and those `share` (N,) of the way from points a (N,) to points b (N,) of the same face."""
        parents = np.concatenate([self.parents[a], self.parents[b]], axis=1)
        weights = np.concatenate([(1 - share)[:, None] * self.weights[a], share[:, None] * self.weights[b]], axis=1)
        # What both ends have of one vertex is added up; three vertices, those of the face, are left.
        order = np.argsort(parents, axis=1, kind="stable")
        parents, weights = np.take_along_axis(parents, order, axis=1), np.take_along_axis(weights, order, axis=1)
        for k in range(5):
            same = parents[:, k] == parents[:, k + 1]
            weights[same, k + 1] += weights[same, k]
            weights[same, k] = 0.0
        order = np.argsort(weights == 0.0, axis=1, kind="stable")[:, :3]
        parents, weights = np.take_along_axis(parents, order, axis=1), np.take_along_axis(weights, order, axis=1)
        return Blend(np.concatenate([self.parents, parents]), np.concatenate([self.weights, weights]))


@dataclass(frozen=True)
class CutSkin:
    """The skin's faces, refined and cut.

    faces: (F, 3); vertices from V on are on edges · source: (F,) the skin's face that each is a piece of · blend:
    the new vertices (N,) as blends of the skin's · bone_index, bone_weight: (V + N, 8) · label: (F,) ids · inside: (F,)
    by the name of what can be worn (`coverage.borders`).
    """

    faces: Ints32
    source: Ints
    blend: Blend
    bone_index: Bytes
    bone_weight: Floats32
    label: Bytes
    inside: Mapping[str, Bools]


class _Cutter:
    """Faces while they are being cut; `every` blends the skin's vertices into all so far."""

    def __init__(self, faces: Ints32, count: int) -> None:
        self.faces = faces.astype(np.int64)
        self.source = np.arange(len(faces))
        self.every = Blend(np.repeat(np.arange(count, dtype=np.int32)[:, None], 3, axis=1), np.tile([1.0, 0.0, 0.0], (count, 1)))

    def refine(self, rest: Floats, longest: float, where: Bools) -> None:
        """Halve the edges that are longer than `longest` on rest (V, 3) and have both ends in `where` (V,)."""
        points = self.every.of(rest)
        inside = self.every.of(where.astype(np.float64)) > 0.99
        corner, following = self.faces, np.roll(self.faces, -1, axis=1)
        long = (np.linalg.norm(points[corner] - points[following], axis=2) > longest) & inside[corner] & inside[following]
        count = len(self.every)
        key = np.minimum(corner, following) * count + np.maximum(corner, following)
        halved, at = np.unique(key[long], return_inverse=True)
        middle = np.full(self.faces.shape, -1)
        middle[long] = count + at
        self.every = self.every.and_between(*np.divmod(halved, count), np.full(len(halved), 0.5))
        number = long.sum(axis=1)
        # Turned so that a lone halved edge comes first, and a lone whole one last.
        turn = np.where(number == 1, long.argmax(axis=1), np.where(number == 2, (~long).argmax(axis=1) + 1, 0))
        order = (turn[:, None] + np.arange(3)) % 3
        (a, b, c), (m, n, o) = np.take_along_axis(self.faces, order, 1).T, np.take_along_axis(middle, order, 1).T
        pieces = {
            0: ((a, b, c),), 1: ((a, m, c), (m, b, c)), 2: ((m, b, n), (a, m, n), (a, n, c)),
            3: ((a, m, o), (m, b, n), (o, n, c), (m, n, o)),
        }  # fmt: skip
        made = [(number == k, np.stack(piece, axis=1)) for k, several in pieces.items() for piece in several]
        self.faces = np.concatenate([faces[chosen] for chosen, faces in made])
        self.source = np.concatenate([self.source[chosen] for chosen, _ in made])

    def cut(self, field: Floats, where: Bools) -> None:
        """Cut along field = 0 (field (V,) on the skin's vertices), in faces whose corners are all in `where` (V,)."""
        value = self.every.of(field)
        near = np.flatnonzero(~_all((value >= 0)[self.faces]) & ~_all((value <= 0)[self.faces]))  # faces on both sides
        faces = self.faces[near]
        inside = _all((self.every.of(where.astype(np.float64)) > 0.99)[faces])
        value = _snapped(value, faces[inside])
        count = len(self.every)
        corner, following = faces, np.roll(faces, -1, axis=1)  # edge k from corner k to the next
        crossing = value[corner] * value[following] < 0
        # A face outside that shares a cut edge is split as well, or a crack would open there.
        key = (np.minimum(corner, following) * count + np.maximum(corner, following))[crossing]
        parted = np.zeros(faces.shape, bool)
        parted[crossing] = np.isin(key, key[np.broadcast_to(inside[:, None], crossing.shape)[crossing]])
        crossed = ~_all(~parted)
        if not crossed.any():
            return
        cut = parted[crossed]
        twice = np.count_nonzero(cut, axis=1) == 2
        # Turn the face so that its first corner is alone on its side, or opposite the only cut edge.
        alone = np.where(twice, (~cut).argmax(axis=1), cut.argmax(axis=1)) + 2
        a, b, c = np.take_along_axis(faces[crossed], (alone[:, None] + np.arange(3)) % 3, axis=1).T
        # The ends of the edges that get a vertex; vertices are numbered as faces first need them.
        ends = np.stack([np.where(twice, a, b), np.where(twice, b, c), a, c], axis=1).reshape(-1, 2)
        needed = np.stack([np.ones_like(twice), twice], axis=1).ravel()
        low, high = np.sort(ends[needed], axis=1).T
        edges, first, which = np.unique(low * count + high, return_index=True, return_inverse=True)
        order = np.argsort(first, kind="stable")
        pairs = np.stack(np.divmod(edges[order], count), axis=1)
        made = np.zeros(len(needed), np.int64)
        made[needed] = count + np.argsort(order, kind="stable")[which]
        m, n = made.reshape(-1, 2).T
        # Two pieces of a face that is cut once, three of one that is cut twice.
        two, three = np.stack([a, b, m, a, m, c, m, m, m], axis=1), np.stack([a, m, n, m, b, c, m, c, n], axis=1)
        pieces = np.where(twice[:, None], three, two).reshape(-1, 3)
        valid = np.stack([np.ones_like(twice), np.ones_like(twice), twice], axis=1).ravel()
        t = value[pairs[:, 0]] / (value[pairs[:, 0]] - value[pairs[:, 1]])
        self.every = self.every.and_between(pairs[:, 0], pairs[:, 1], t)
        whole = np.ones(len(self.faces), bool)
        whole[near[crossed]] = False
        self.faces = np.concatenate([self.faces[whole], pieces[valid]])
        self.source = np.concatenate([self.source[whole], np.repeat(self.source[near[crossed]], 3)[valid]])


def _all(each: Bools) -> Bools:
    """Whether all three (F, 3) hold; numpy is slow along short axes."""
    return np.asarray(each[:, 0] & each[:, 1] & each[:, 2])


def _snapped(value: Floats, faces: Ints) -> Floats:
    """Values set to 0 at vertices that a border passes by closely."""
    edges = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    a, b = value[edges[:, 0]], value[edges[:, 1]]
    crossing = a * b < 0
    edges, share = edges[crossing], a[crossing] / (a[crossing] - b[crossing])
    result = value.copy()
    result[edges[share < _SNAP, 0]] = 0
    result[edges[share > 1 - _SNAP, 1]] = 0
    return result


def _fields() -> tuple[dict[str, Floats], float]:
    """Chart values (V,) by name, and half the distance between the hip joints (m)."""
    c = load_chart()
    shoulder = c.heads["lupperarm01"]
    mirrored = c.rest * np.where(c.rest[:, 1:2] < 0, (1, -1, 1), (1, 1, 1))
    length = rp.norm(c.heads["llowerarm01"] - shoulder)
    fields = {
        "arm": c.arm, "leg": c.leg, "neck": c.neck, "head": c.head, "along_arm": c.along_arm, "along_leg": c.along_leg,
        "up": c.up, "y": c.rest[:, 1], "x": c.rest[:, 0], "aside": mirrored[:, 1] / shoulder[1],
        "reach": np.linalg.norm(mirrored - shoulder, axis=1) / length,
    }  # fmt: skip
    return fields, float(c.heads["lupperleg01"][1])


def _labels(value: dict[str, Floats], hip: float) -> Bytes:
    """Part of each point, by its chart values."""
    left = value["y"] > 0
    result = np.zeros(len(left), np.uint8)

    def put(mask: Bools, name: str) -> None:
        for side, own in (("left", left), ("right", ~left)):
            result[mask & own] = labels.LABEL_ID[f"{name}_{side}"]

    arm, leg, up = value["arm"], value["leg"], value["up"]
    put(np.ones(len(left), bool), "torso")
    on_leg = leg > 0.5
    put(((up < _WAIST) & (arm < 0.5)) | on_leg, "hip")
    on_thigh = on_leg & (value["along_leg"] >= _LEG[0][0])
    result[(up < _WAIST) & (np.abs(value["y"]) < _HIP_CENTRE * hip) & ~on_thigh & (arm < 0.5)] = labels.LABEL_ID["hip_center"]
    put(((value["aside"] > _SHOULDER_Y) & (value["reach"] < _SHOULDER_REACH) & (value["neck"] < 0.3)) | (arm > 0.5), "shoulder")
    for low, name in _ARM:
        put((arm > 0.5) & (value["along_arm"] >= low), name)
    for low, name in _LEG:
        put(on_leg & (value["along_leg"] >= low), name)
    put(on_leg & (value["along_leg"] > 1.8) & (value["x"] > load_chart().heads["lfoot"][0] + 0.06), "foot")
    result[value["neck"] > 0.5] = labels.LABEL_ID["neck"]
    put(value["head"] >= 0.5, "head")
    return result


@cache
def cut_skin() -> CutSkin:
    """The packaged skin, cut and labelled; once per process."""
    space = load_shape_space()
    value, hip = _fields()
    cutter = _Cutter(space.faces, space.vertex_count)
    clothed = np.max([borders()[name] for name in ("jacket", "trousers")], axis=0) > -0.02
    for _ in range(2):
        cutter.refine(load_chart().rest, _LONGEST_EDGE_M, clothed)
    trunk, on_arm, on_leg = value["arm"] < 0.5, value["arm"] > 0.5, value["leg"] > 0.5
    cutter.cut(value["head"] - 0.5, np.ones_like(trunk))
    cutter.cut(value["neck"] - 0.5, np.ones_like(trunk))
    cutter.cut(value["up"] - _WAIST, trunk & (value["leg"] < 0.9))
    cutter.cut(np.abs(value["y"]) - _HIP_CENTRE * hip, (value["up"] < _WAIST + 0.05) & (value["along_leg"] < 0.5) & trunk)
    cutter.cut(value["aside"] - _SHOULDER_Y, (value["reach"] < _SHOULDER_REACH + 0.1) & (value["arm"] < 0.9))
    cutter.cut(value["reach"] - _SHOULDER_REACH, (value["aside"] > _SHOULDER_Y - 0.1) & (value["arm"] < 0.9))
    cutter.cut(value["arm"] - 0.5, (value["aside"] < _SHOULDER_Y + 0.2) | (value["reach"] > _SHOULDER_REACH - 0.15))
    for low, _ in _ARM:
        cutter.cut(value["along_arm"] - low, on_arm)
    for low, _ in _LEG:
        cutter.cut(value["along_leg"] - low, on_leg)
    cutter.cut(value["leg"] - 0.5, (value["along_leg"] > 0) & (value["up"] < 0.2))
    # A garment ends over a narrow strip of its own material.
    hemmed = (*TOP_ENDS, *BOTTOM_ENDS, "cap")
    edges = {name: field + HEM_M if name in hemmed else field for name, field in borders().items()}
    for name, field in borders().items():
        cutter.cut(field, np.ones_like(trunk))
        if edges[name] is not field:
            cutter.cut(edges[name], np.ones_like(trunk))
    count = space.vertex_count
    blend = cutter.every[count:]
    dense = np.zeros((count, int(space.bone_index.max()) + 1))
    for k in range(space.bone_index.shape[1]):
        np.add.at(dense, (np.arange(count), space.bone_index[:, k]), space.bone_weight[:, k])
    mixed = blend.of(dense)
    width = space.bone_index.shape[1]
    order = np.argsort(-mixed.round(9), axis=1, kind="stable")[:, :width]
    weight = np.take_along_axis(mixed, order, axis=1)
    weight /= weight.sum(axis=1, keepdims=True)
    at = {name: cutter.every.of(field)[cutter.faces].mean(axis=1) for name, field in value.items()}
    return CutSkin(
        cutter.faces.astype(np.int32), cutter.source, Blend(blend.parents, blend.weights.astype(np.float32)),
        np.concatenate([space.bone_index, np.where(weight > 0, order, 0).astype(np.uint8)]),
        np.concatenate([space.bone_weight, weight.astype(np.float32)]), _labels(at, hip),
        MappingProxyType({name: cutter.every.of(field)[cutter.faces].mean(axis=1) > 0 for name, field in edges.items()}),
    )  # fmt: skip

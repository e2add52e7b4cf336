"""A body as closed solids, one per segment group, for contact with itself, with others and with thin cabin parts.

The skin's triangles of a segment are closed by a fan over each open ring (to the ring's centre of mass), so that
"inside" is the winding number along a vertical ray, exact for the posed triangles. Depth is the distance to the
nearest triangle of the solid's own skin, the fans left out: it can only be overstated, so nothing too deep passes.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from cabinpose._native import contact as native
from cabinpose.core import CABINPOSE, Bools, Bytes, Floats, Floats32, Ints, Ints32
from cabinpose.scene.contact.pairs import BOTH_YIELD_M, PAIRS, SOLID_OF_SEGMENT, SOLIDS, Pair

SPACING_M = 0.025  # torso and thighs have edges up to 75 mm
LEAF = 32  # triangles to a box in the search for the nearest, as the kernels have it


@dataclass(frozen=True)
class SolidTopology:
    """How a skin mesh is cut into `SOLIDS`; rows of (start, end) per solid.

    faces: (F, 3) int32 of all solids, their skin first, then their fans · skin_rows, all_rows: (S, 2) into faces ·
    vertices: skin vertices of each solid (for its box), vertex_rows (S, 2) · own: vertices that belong to one solid each,
    own_rows (S, 2) · ring_vertices, ring_rows (C, 2): rings whose centres are vertices V, V+1, ... ·
    edges: (E, 2) of the skin, each once · order: (V,) skin vertices, neighbours near each other ·
    leaf_rows: (S, 2) into the boxes around every `LEAF` faces of a solid
    """

    faces: Ints32
    skin_rows: Ints
    all_rows: Ints
    vertices: Ints32
    vertex_rows: Ints
    own: Ints32
    own_rows: Ints
    ring_vertices: Ints32
    ring_rows: Ints
    edges: Ints32
    order: Ints32
    leaf_rows: Ints


def _rows(parts: Sequence[NDArray[Any]]) -> Ints:
    ends = np.cumsum([len(p) for p in parts])
    return np.stack((ends - [len(p) for p in parts], ends), axis=1).astype(np.int64)


def open_edges(faces: Ints32) -> Ints32:
    """(E, 2) directed edges (u, v) of faces (F, 3) whose opposite (v, u) is missing."""
    edges = np.stack((faces, np.roll(faces, -1, axis=1)), axis=2).reshape(-1, 2)
    count = int(faces.max()) + 1
    forward = edges[:, 0].astype(np.int64) * count + edges[:, 1]
    backward = edges[:, 1].astype(np.int64) * count + edges[:, 0]
    return np.asarray(edges[~np.isin(forward, backward)])


def _edges(faces: Ints32) -> Ints32:
    corner, following = faces.astype(np.int64), np.roll(faces, -1, axis=1)
    count = int(faces.max()) + 1
    keys = np.unique(np.minimum(corner, following) * count + np.maximum(corner, following))
    return np.stack(np.divmod(keys, count), axis=1).astype(np.int32)


def _components(edges: Ints32) -> list[Ints32]:
    """The edges of each connected ring."""
    label = {int(v): int(v) for v in np.unique(edges)}

    def root(v: int) -> int:
        while label[v] != v:
            label[v] = label[label[v]]
            v = label[v]
        return v

    for u, v in edges:
        label[root(int(u))] = root(int(v))
    roots = np.array([root(int(u)) for u in edges[:, 0]])
    return [edges[roots == r] for r in np.unique(roots)]


def _by_place(points: NDArray[np.floating]) -> Ints:
    """An order of points (N, 3) in which every `LEAF` of them are close together."""
    order = np.empty(len(points), np.int64)
    native.by_place(np.ascontiguousarray(points, np.float64), LEAF, order)
    return order


def solid_topology(faces: Ints32, segment: Bytes, segments: Sequence[str], skin: NDArray[np.floating]) -> SolidTopology:
    """Cuts a skin (faces (F, 3), segment (V,) as index into `segments`) into `SOLIDS`, each closed by fans.

    skin: (V, 3) m, the vertices of any pose, to list triangles near each other together; results do not depend on it.
    """
    solid = np.array([SOLIDS.index(SOLID_OF_SEGMENT[name]) for name in segments])[segment]
    corner = solid[faces]
    # A face belongs where most of its corners do, one with three homes to the first.
    of_face = np.where(corner[:, 1] == corner[:, 2], corner[:, 1], corner[:, 0])
    skins, alls, vertices, owns, rings = [], [], [], [], []
    centre = len(segment)
    for s in range(len(SOLIDS)):
        own = faces[of_face == s]
        own = own[_by_place(skin[own].mean(axis=1))]
        closed = [own]
        if len(own):
            for ring in _components(open_edges(own)):
                fan = np.column_stack((ring[:, 1], ring[:, 0], np.full(len(ring), centre)))
                closed.append(fan.astype(np.int32))
                rings.append(np.unique(ring).astype(np.int32))
                centre += 1
        skins.append(own)
        alls.append(np.concatenate(closed))
        vertices.append(np.unique(own).astype(np.int32))
        owns.append(np.flatnonzero(solid == s).astype(np.int32))
    all_rows, edges = _rows(alls), _edges(faces)
    skin_rows = np.stack((all_rows[:, 0], all_rows[:, 0] + np.array([len(p) for p in skins], np.int64)), axis=1)
    return SolidTopology(
        np.ascontiguousarray(np.concatenate(alls), np.int32), skin_rows, all_rows,
        np.concatenate(vertices), _rows(vertices), np.concatenate(owns), _rows(owns),
        np.concatenate(rings) if rings else np.empty(0, np.int32), _rows(rings) if rings else np.empty((0, 2), np.int64),
        edges[_by_place(skin[edges].mean(axis=1))], _by_place(skin).astype(np.int32),
        _rows([p[::LEAF] for p in alls]),
    )  # fmt: skip


class SolidContact(NamedTuple):
    """A point in a solid: which solid, depth (m) and excess over what is allowed (m), number and place of the point."""

    solid: str
    depth_m: float
    excess_m: float
    point: int
    where: Floats


class SolidArrays(NamedTuple):
    """A posed body for the kernels; S solids, rows of (start, end).

    vertices: (V, 3) float32 m · boxes: (S, 2, 3) · faces, all_rows, skin_rows, own, own_rows: of `SolidTopology` ·
    leaf_rows: (S, 2) into leaves (L, 2, 3), boxes around every `LEAF` faces of a solid, made when they are first asked
    for: ready (S,).
    """

    vertices: Floats32
    boxes: Floats32
    faces: Ints32
    all_rows: Ints
    skin_rows: Ints
    own: Ints32
    own_rows: Ints
    leaf_rows: Ints
    leaves: Floats
    ready: Bools


_NOWHERE = np.zeros(3)


@dataclass(frozen=True)
class PosedSolids:
    """The solids of one posed body, vehicle frame. vertices: (V + C, 3) float32 · box: (2, 3) · arrays: for the kernels."""

    topology: SolidTopology
    arrays: SolidArrays
    box: Floats32

    @classmethod
    def of(cls, topology: SolidTopology, skin: Floats32) -> PosedSolids:
        """The solids of a skin (V, 3) m."""
        t = topology
        vertices = np.empty((len(skin) + len(t.ring_rows), 3), np.float32)
        boxes, box = np.empty((len(t.vertex_rows), 2, 3), np.float32), np.empty((2, 3), np.float32)
        native.close_solids(
            skin, ring_vertices=t.ring_vertices, ring_rows=t.ring_rows, vertices=t.vertices, vertex_rows=t.vertex_rows,
            closed=vertices, boxes=boxes, box=box,
        )  # fmt: skip
        leaves, ready = np.empty((t.leaf_rows[-1, 1], 2, 3)), np.zeros(len(boxes), np.bool_)
        arrays = SolidArrays(vertices, boxes, t.faces, t.all_rows, t.skin_rows, t.own, t.own_rows, t.leaf_rows, leaves, ready)
        return cls(topology, arrays, box)

    @property
    def vertices(self) -> Floats32:
        """(V + C, 3) m: the skin's vertices, then the centres of the rings."""
        return self.arrays.vertices

    def deepest(self, solid: int, points: Floats32, index: Ints32, limits: Floats) -> SolidContact | None:
        """The indexed point of (N, 3) that goes farthest beyond its limit into a solid; None where none does."""
        excess, point, depth = native.deepest_in(
            points, index, solid=solid, centre=_NOWHERE, radius=0.0, limits=limits, body=self.arrays
        )
        if point < 0:
            return None
        return SolidContact(SOLIDS[solid], depth, excess, point, points[point].astype(np.float64))

    def solid_of(self, vertex: int) -> str:
        """The solid that a skin vertex belongs to."""
        t = self.topology
        at = int(np.flatnonzero(t.own == vertex)[0])
        return SOLIDS[int(np.searchsorted(t.own_rows[:, 1], at, side="right"))]

    @cached_property
    def skin_points(self) -> tuple[Floats32, Ints32]:
        """Points (N, 3) of the skin no farther apart than `SPACING_M` along its edges, and a vertex (N,) near each."""
        points, vertex = native.sampled_skin(self.vertices, self.topology.order, self.topology.edges, SPACING_M)
        return points, vertex

    def own(self, solid: int) -> Ints32:
        """The skin vertices that belong to a solid."""
        start, end = self.topology.own_rows[solid]
        return self.topology.own[start:end]


def self_contact(body: PosedSolids, joints: Floats) -> tuple[Pair, SolidContact] | None:
    """The first pair of `PAIRS` whose solids overlap beyond its tolerance, and where; None where none does.

    joints: (20, 3) m of the same body in the order of `core.skeleton.JOINTS`.
    """
    pair, into, excess, point, depth = native.first_of_pairs(
        body.arrays, pairs=_PAIRED, tolerances=_TOLERANCES, joint_ends=_JOINT_ENDS, zones=_ZONES, joints=joints
    )
    if pair < 0:
        return None
    return PAIRS[pair], SolidContact(SOLIDS[into], depth, excess, point, body.vertices[point].astype(np.float64))


_PAIRED = np.array([(SOLIDS.index(p.one), SOLIDS.index(p.two)) for p in PAIRS])
_TOLERANCES = np.array([p.tolerance_m for p in PAIRS])
_JOINT_ENDS = np.array([CABINPOSE.indices((p.joint, p.end)) if p.joint else [-1, -1] for p in PAIRS])
_ZONES = np.array([p.zone for p in PAIRS])
_FLESH = np.array([BOTH_YIELD_M])


def person_contact(one: PosedSolids, two: PosedSolids) -> tuple[str, SolidContact] | None:
    """Where two bodies overlap deeper than `BOTH_YIELD_M`: the solid that goes in and the contact; None where they do not."""
    if not ((one.box[0] < two.box[1]) & (two.box[0] < one.box[1])).all():
        return None
    for body, other in ((one, two), (two, one)):
        into, of, excess, point, depth = native.first_between(body=body.arrays, other=other.arrays, limit=_FLESH)
        if into >= 0:
            return SOLIDS[of], SolidContact(SOLIDS[into], depth, excess, point, other.vertices[point].astype(np.float64))
    return None

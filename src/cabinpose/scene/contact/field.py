"""Clearance of points to the parts of a cabin: distance fields on grids, one per group that moves as one.

A group's field holds, at the nodes of a regular grid in the group's own frame, the least over its parts of "signed
distance + give": how far a point may still move before a part gives way no more. Negative means too deep. A seat
that slides or reclines takes its field along; only the transform changes.

Nodes hold one byte (clearance cut at ±95 mm), interpolation is trilinear. Distances are exact next to the surface and
inherit the nearest triangle of a neighbour farther away (Danielsson 1980), which can only overstate a distance. The
field therefore sorts points into "clear" and "look closer": `ContactField.deepest` evaluates the few points that the
interpolation bound leaves open against the triangles themselves.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numba import njit
from numpy.typing import NDArray

from cabinpose.core.frames import Matrix, apply, invert
from cabinpose.scene.contact.solids import SOLIDS, PosedSolids, SolidContact
from cabinpose.scene.contact.triangles import (
    TriangleMesh,
    closest_on_triangle,
    crossing,
    edge_keys,
    height_over,
    triangle_mesh,
)
from cabinpose.scene.surface import Surface

STEP_M = 0.010  # grid step of static parts and seats
FINE_STEP_M = 0.005  # grid step of the wheel, whose rim is 30 mm thick
QUANTUM_M = 0.00075
BAND_M = 127 * QUANTUM_M
SEAL_M = 0.020  # gaps of the interior narrower than twice this count as closed
SHARP = math.cos(math.radians(30.0))  # edges that bend more than this are probed as edges
PROBE_M = 0.015  # spacing of probes along sharp edges
SEARCH_M = 0.3  # how deep a depth is still measured
STATIC_GROUP = "body"
WHEEL_GROUP = "wheel"


class ContactPart(Protocol):
    """What contact needs to know of a part of the cabin; lengths in m."""

    @property
    def name(self) -> str: ...
    @property
    def surface(self) -> Surface: ...
    @property
    def group(self) -> str: ...
    @property
    def give_m(self) -> float: ...
    @property
    def solid(self) -> bool: ...


class ContactScene(Protocol):
    """Parts in groups, and where the groups are: a cabin, or a room."""

    @property
    def parts(self) -> Sequence[Any]: ...
    @property
    def seats(self) -> Mapping[str, Any]: ...
    def group_transforms(self, settings: Mapping[str, Any], *, wheel_angle: float = 0.0) -> Mapping[str, Matrix]: ...


@njit(cache=True, nogil=True)
def _splat(corners, origin, step, reach, distance, nearest):  # type: ignore[no-untyped-def]
    """Exact distance at the nodes within `reach` of each triangle."""
    dims = distance.shape
    low = np.empty(3, np.int64)
    high = np.empty(3, np.int64)
    for t in range(len(corners)):
        a, b, c = corners[t, 0], corners[t, 1], corners[t, 2]
        for axis in range(3):
            x = corners[t, :, axis]
            low[axis] = max(math.ceil((x.min() - reach - origin[axis]) / step), 0)
            high[axis] = min(math.floor((x.max() + reach - origin[axis]) / step), dims[axis] - 1)
        nx = (b[1] - a[1]) * (c[2] - a[2]) - (b[2] - a[2]) * (c[1] - a[1])
        ny = (b[2] - a[2]) * (c[0] - a[0]) - (b[0] - a[0]) * (c[2] - a[2])
        nz = (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])
        limit = reach * math.sqrt(nx * nx + ny * ny + nz * nz)
        for i in range(low[0], high[0] + 1):
            px = origin[0] + i * step
            for j in range(low[1], high[1] + 1):
                py = origin[1] + j * step
                for k in range(low[2], high[2] + 1):
                    pz = origin[2] + k * step
                    if abs(nx * (px - a[0]) + ny * (py - a[1]) + nz * (pz - a[2])) > limit:
                        continue
                    d2 = closest_on_triangle(px, py, pz, a, b, c)[0]
                    if d2 < distance[i, j, k]:
                        distance[i, j, k] = d2
                        nearest[i, j, k] = t


@njit(cache=True, nogil=True, inline="always")
def _inherit(i, j, k, di, dj, dk, origin, step, corners, distance, nearest):  # type: ignore[no-untyped-def]
    t = nearest[i + di, j + dj, k + dk]
    if t >= 0 and t != nearest[i, j, k]:
        d2 = closest_on_triangle(
            origin[0] + i * step, origin[1] + j * step, origin[2] + k * step, corners[t, 0], corners[t, 1], corners[t, 2]
        )[0]
        if d2 < distance[i, j, k]:
            distance[i, j, k] = d2
            nearest[i, j, k] = t


@njit(cache=True, nogil=True)
def _propagate(corners, origin, step, band, near, distance, nearest):  # type: ignore[no-untyped-def]
    """Nearest triangles handed on to neighbours in eight sweeps, up to `band`; nodes within `near` are exact already."""
    ni, nj, nk = distance.shape
    hand_on, keep = (band - step) ** 2, near * near
    for sweep in range(8):
        di, dj, dk = 1 - 2 * (sweep & 1), 1 - (sweep & 2), 1 - (sweep & 4) // 2
        for i in range(ni) if di > 0 else range(ni - 1, -1, -1):
            for j in range(nj) if dj > 0 else range(nj - 1, -1, -1):
                for k in range(nk) if dk > 0 else range(nk - 1, -1, -1):
                    if distance[i, j, k] <= keep:
                        continue
                    if 0 <= i - di < ni and distance[i - di, j, k] < hand_on:
                        _inherit(i, j, k, -di, 0, 0, origin, step, corners, distance, nearest)
                    if 0 <= j - dj < nj and distance[i, j - dj, k] < hand_on:
                        _inherit(i, j, k, 0, -dj, 0, origin, step, corners, distance, nearest)
                    if 0 <= k - dk < nk and distance[i, j, k - dk] < hand_on:
                        _inherit(i, j, k, 0, 0, -dk, origin, step, corners, distance, nearest)


@njit(cache=True, nogil=True)
def _winding(corners, origin, step, dims):  # type: ignore[no-untyped-def]
    """How often the surface winds around each node, from its crossings with the vertical grid lines."""
    winding = np.zeros((dims[0], dims[1], dims[2]), np.int8)
    for t in range(len(corners)):
        a, b, c = corners[t, 0], corners[t, 1], corners[t, 2]
        i0 = max(math.ceil((corners[t, :, 0].min() - origin[0]) / step), 0)
        i1 = min(math.floor((corners[t, :, 0].max() - origin[0]) / step), dims[0] - 1)
        j0 = max(math.ceil((corners[t, :, 1].min() - origin[1]) / step), 0)
        j1 = min(math.floor((corners[t, :, 1].max() - origin[1]) / step), dims[1] - 1)
        for i in range(i0, i1 + 1):
            for j in range(j0, j1 + 1):
                px, py = origin[0] + i * step, origin[1] + j * step
                sense = crossing(px, py, a, b, c)
                if sense != 0:
                    top = min(math.floor((height_over(px, py, a, b, c) - origin[2]) / step), dims[2] - 1)
                    if top >= 0:
                        winding[i, j, top] += sense
    for i in range(dims[0]):
        for j in range(dims[1]):
            for k in range(dims[2] - 2, -1, -1):
                winding[i, j, k] += winding[i, j, k + 1]
    return winding


@njit(cache=True, nogil=True)
def _merge(distance, winding, closed, offset, give, band, quantum, values):  # type: ignore[no-untyped-def]
    """The lesser of the group's clearance so far and that of one part, in quanta, rounded down."""
    ni, nj, nk = distance.shape
    for i in range(ni):
        for j in range(nj):
            for k in range(nk):
                d = min(math.sqrt(distance[i, j, k]), band)
                if closed and winding[i, j, k] > 0:
                    d = -d
                level = math.floor((d + give) / quantum)
                level = min(max(level, -127), 127)
                at = (i + offset[0], j + offset[1], k + offset[2])
                if level < values[at]:
                    values[at] = level


@njit(cache=True, nogil=True)
def _reach_free(values, seeds, free_level, pass_level, steps):  # type: ignore[no-untyped-def]
    """Nodes reached from the seeds through the clear, and `steps` nodes on; and whether the grid's border was reached."""
    ni, nj, nk = values.shape
    free = np.zeros(values.shape, np.bool_)
    queue = [(0, 0, 0)]
    queue.pop()
    for s in range(len(seeds)):
        i, j, k = seeds[s]
        if 0 <= i < ni and 0 <= j < nj and 0 <= k < nk and values[i, j, k] >= free_level and not free[i, j, k]:
            free[i, j, k] = True
            queue.append((i, j, k))
    open_border = False
    head = 0
    while head < len(queue):
        i, j, k = queue[head]
        head += 1
        open_border = open_border or i == 0 or j == 0 or k == 0 or i == ni - 1 or j == nj - 1 or k == nk - 1
        for axis in range(3):
            for d in (-1, 1):
                a = i + (d if axis == 0 else 0)
                b = j + (d if axis == 1 else 0)
                c = k + (d if axis == 2 else 0)
                if 0 <= a < ni and 0 <= b < nj and 0 <= c < nk and not free[a, b, c] and values[a, b, c] >= free_level:
                    free[a, b, c] = True
                    queue.append((a, b, c))
    first, last = 0, len(queue)
    for _ in range(steps):
        for n in range(first, last):
            i, j, k = queue[n]
            for a in range(max(i - 1, 0), min(i + 2, ni)):
                for b in range(max(j - 1, 0), min(j + 2, nj)):
                    for c in range(max(k - 1, 0), min(k + 2, nk)):
                        if not free[a, b, c] and values[a, b, c] >= pass_level:
                            free[a, b, c] = True
                            queue.append((a, b, c))
        first, last = last, len(queue)
    return free, open_border


@njit(cache=True, nogil=True)
def _sample(points, group_from_vehicle, origin, step, quantum, outside, values, clearance):  # type: ignore[no-untyped-def]
    """Lowers `clearance` (N,) at points (N, 3) to the field's trilinear value; `outside` beyond the grid."""
    ni, nj, nk = values.shape
    m = group_from_vehicle
    for n in range(len(points)):
        x, y, z = points[n, 0], points[n, 1], points[n, 2]
        u = (m[0, 0] * x + m[0, 1] * y + m[0, 2] * z + m[0, 3] - origin[0]) / step
        v = (m[1, 0] * x + m[1, 1] * y + m[1, 2] * z + m[1, 3] - origin[1]) / step
        w = (m[2, 0] * x + m[2, 1] * y + m[2, 2] * z + m[2, 3] - origin[2]) / step
        if not (0.0 <= u < ni - 1 and 0.0 <= v < nj - 1 and 0.0 <= w < nk - 1):
            clearance[n] = min(clearance[n], outside)
            continue
        i, j, k = int(u), int(v), int(w)
        fu, fv, fw = u - i, v - j, w - k
        low = (values[i, j, k] * (1.0 - fu) + values[i + 1, j, k] * fu) * (1.0 - fv)
        low += (values[i, j + 1, k] * (1.0 - fu) + values[i + 1, j + 1, k] * fu) * fv
        high = (values[i, j, k + 1] * (1.0 - fu) + values[i + 1, j, k + 1] * fu) * (1.0 - fv)
        high += (values[i, j + 1, k + 1] * (1.0 - fu) + values[i + 1, j + 1, k + 1] * fu) * fv
        clearance[n] = min(clearance[n], (low * (1.0 - fw) + high * fw) * quantum)


@dataclass(frozen=True)
class GroupPart:
    """One part of a group, for exact queries: its triangles, the depth to which it gives way, and points to probe with."""

    name: str
    mesh: TriangleMesh
    give_m: float
    shell_m: float


@dataclass(frozen=True)
class GroupField:
    """The clearance field of a group and its parts, in the group's frame.

    values: (ni, nj, nk) int8, quanta of clearance · origin: (3,) m of node 0 · bound_m: by how much an interpolated
    value can exceed the true clearance · probes: (P, 3) m, vertices and points of sharp edges, with their part ·
    interior: what the occupants cannot reach counts as too deep ·
    sealed: and nothing leads out, so that what is beyond the grid is outside the car.
    """

    name: str
    parts: tuple[GroupPart, ...]
    values: NDArray[np.int8]
    origin: NDArray[np.float64]
    step: float
    probes: NDArray[np.float64]
    probe_part: NDArray[np.int32]
    interior: bool
    sealed: bool

    @property
    def give_m(self) -> float:
        """The greatest give of the group's parts, m."""
        return max(p.give_m for p in self.parts)

    @property
    def probe_give(self) -> NDArray[np.float64]:
        """(P,) m, the give of the part that a probe belongs to."""
        return np.array([p.give_m for p in self.parts])[self.probe_part]

    @property
    def bound_m(self) -> float:
        """A distance changes by no more than the way to it, so interpolation is off by at most half a cell's diagonal."""
        return self.step * math.sqrt(3.0) / 2.0 + QUANTUM_M

    @property
    def nbytes(self) -> int:
        """Memory of the grid and the triangles, bytes."""
        meshes = sum(p.mesh.corners.nbytes + p.mesh.normals.nbytes + p.mesh.vertices.nbytes for p in self.parts)
        return self.values.nbytes + self.probes.nbytes + meshes

    def lower(self, points: NDArray[np.floating], group_from_vehicle: Matrix, clearance: NDArray[np.float64]) -> None:
        """Lowers `clearance` (N,) m to this group's where it is less, at points (N, 3) m in the vehicle frame."""
        outside = -BAND_M if self.sealed else BAND_M
        _sample(points, group_from_vehicle, self.origin, self.step, QUANTUM_M, outside, self.values, clearance)


def _probes(mesh: TriangleMesh) -> NDArray[np.float64]:
    """The vertices, and points every `PROBE_M` along the edges that bend outwards sharply."""
    keys = edge_keys(mesh.faces, len(mesh.vertices)).reshape(-1)
    order = np.argsort(keys, kind="stable")
    paired = np.flatnonzero(keys[order][1:] == keys[order][:-1])
    one, two = order[paired], order[paired + 1]
    face = mesh.normals[:, 0]
    apex = mesh.corners[two // 3, (two % 3 + 2) % 3]
    a, b = mesh.corners[one // 3, one % 3], mesh.corners[one // 3, (one % 3 + 1) % 3]
    bend = (face[one // 3] * face[two // 3]).sum(axis=1)
    convex = (face[one // 3] * (apex - a)).sum(axis=1) < 0.0
    length = np.linalg.norm(b - a, axis=1)
    chosen = np.flatnonzero((bend < SHARP) & convex & (length > PROBE_M))
    points = [mesh.vertices]
    for e in chosen:
        t = np.arange(1, math.ceil(length[e] / PROBE_M)) / math.ceil(length[e] / PROBE_M)
        points.append(a[e] + t[:, None] * (b[e] - a[e]))
    return np.concatenate(points)


def _part_levels(part: GroupPart, origin: NDArray[np.float64], step: float, values: NDArray[np.int8]) -> None:
    pad = BAND_M + step
    first = np.maximum(np.floor((part.mesh.low - pad - origin) / step), 0).astype(np.int64)
    last = np.minimum(np.ceil((part.mesh.high + pad - origin) / step), np.array(values.shape) - 1).astype(np.int64)
    dims = tuple(int(n) for n in last - first + 1)
    corner = origin + first * step
    near = 2.0 * step
    distance = np.full(dims, np.inf, np.float32)
    nearest = np.full(dims, -1, np.int32)
    _splat(part.mesh.corners, corner, step, near, distance, nearest)
    _propagate(part.mesh.corners, corner, step, BAND_M + part.give_m, near, distance, nearest)
    winding = _winding(part.mesh.corners, corner, step, np.array(dims)) if part.mesh.closed else np.zeros((1, 1, 1), np.int8)
    _merge(distance, winding, part.mesh.closed, first, part.give_m - part.shell_m / 2.0, BAND_M + part.give_m, QUANTUM_M, values)


def group_field(
    name: str, parts: Sequence[ContactPart], *, step: float = STEP_M, seeds: NDArray[np.float64] | None = None
) -> GroupField:
    """The field of the parts of one group.

    `seeds` (S, 3) m, points that are inside the interior: where given, all that cannot be reached from them, such as
    what is behind a window pane or a door panel, counts as too deep.
    """
    ready = []
    for part in parts:
        mesh = triangle_mesh(part.surface.vertices, part.surface.faces, closed=part.solid)
        ready.append(GroupPart(part.name, mesh, float(part.give_m), float(getattr(part, "shell_m", 0.0))))
    low = np.min([p.mesh.low for p in ready], axis=0) - 2.0 * step
    high = np.max([p.mesh.high for p in ready], axis=0) + 2.0 * step
    if seeds is None:
        low, high = low - BAND_M, high + BAND_M
    values = np.full(tuple(np.ceil((high - low) / step).astype(int) + 1), 127, np.int8)
    for part_ready in ready:
        _part_levels(part_ready, low, step, values)
    sealed = False
    if seeds is not None:
        nodes = np.round((seeds - low) / step).astype(np.int64)
        levels = math.ceil(SEAL_M / QUANTUM_M), math.ceil(0.5 * step / QUANTUM_M)
        free, open_border = _reach_free(values, nodes, *levels, math.ceil(SEAL_M / step) + 2)
        if free.any():
            sealed = not open_border
            beyond = ~free & (values >= levels[1])
            values[beyond] = -values[beyond]
    probes = [_probes(p.mesh) for p in ready]
    owner = np.repeat(np.arange(len(ready), dtype=np.int32), [len(p) for p in probes])
    return GroupField(name, tuple(ready), values, low, step, np.concatenate(probes), owner, seeds is not None, sealed)


@dataclass(frozen=True)
class Contact:
    """A point of a body in a part: depth beyond the surface and beyond what may give way (m), where (3,) in vehicle frame."""

    part: str
    depth_m: float
    excess_m: float
    where: NDArray[np.float64]
    point: int


OUTSIDE = "outside the cabin"


class ContactField:
    """The clearance fields of all groups of a cabin, built once."""

    def __init__(self, cabin: ContactScene) -> None:
        """Builds the fields of the cabin's parts that take part in contact (`solid`, or open with a `shell_m`)."""
        groups: dict[str, list[Any]] = {}
        for part in cabin.parts:
            if part.solid or getattr(part, "shell_m", 0.0) > 0.0:
                groups.setdefault(part.group, []).append(part)
        chest = np.array((0.0, 0.0, 0.35))
        seeds = [np.asarray(seat.h_point(seat.default)) + chest for seat in cabin.seats.values()]
        self._cabin = cabin
        self.groups: tuple[GroupField, ...] = tuple(
            group_field(
                name, parts,
                step=FINE_STEP_M if name == WHEEL_GROUP else STEP_M,
                seeds=np.array(seeds) if seeds and name == STATIC_GROUP else None,
            )
            for name, parts in groups.items()
        )  # fmt: skip

    @property
    def nbytes(self) -> int:
        """Memory of the fields, bytes."""
        return sum(g.nbytes for g in self.groups)

    def at(self, settings: Mapping[str, Any], wheel_angle: float = 0.0) -> PlacedField:
        """The fields where these seat settings and this wheel angle (rad) put them."""
        transforms = self._cabin.group_transforms(settings, wheel_angle=wheel_angle)
        return PlacedField(tuple((g, transforms[g.name], invert(transforms[g.name])) for g in self.groups))

    def clearance(
        self, points: NDArray[np.floating], settings: Mapping[str, Any], wheel_angle: float = 0.0
    ) -> NDArray[np.float64]:
        """`PlacedField.clearance` for one call; who asks often keeps what `at` returns."""
        return self.at(settings, wheel_angle).clearance(points)


@dataclass(frozen=True)
class PlacedField:
    """The groups of a cabin in one arrangement: field, vehicle_from_group, group_from_vehicle."""

    groups: tuple[tuple[GroupField, Matrix, Matrix], ...]

    def clearance(self, points: NDArray[np.floating]) -> NDArray[np.float64]:
        """(N,) m that points (N, 3) m of the vehicle frame may still move before a part gives way no more.

        Signed distance to the nearest part plus that part's give, cut at ±`BAND_M` and good to a few millimetres:
        to steer a posture with, not to decide on one. Behind the interior's surfaces it stays negative.
        """
        result = np.full(len(points), BAND_M)
        for group, _, group_from_vehicle in self.groups:
            group.lower(points, group_from_vehicle, result)
        return result

    def deepest(self, points: NDArray[np.float32], tolerance_m: float, *, give: bool = True) -> Contact | None:
        """The point of (N, 3) m, vehicle frame, that goes farthest beyond give + `tolerance_m`; None where none does.

        Exact at the points: those within the interpolation bound of the tolerance are measured on the triangles.
        `give=False` takes soft parts for hard ones.
        """
        worst: Contact | None = None
        for group, _, group_from_vehicle in self.groups:
            yielding = 0.0 if give else group.give_m
            clearance = np.full(len(points), BAND_M)
            group.lower(points, group_from_vehicle, clearance)
            open_ = np.flatnonzero(clearance < group.bound_m - tolerance_m + yielding)
            if len(open_):
                found = _measure(group, points, open_, clearance[open_], group_from_vehicle, tolerance_m, give)
                if found is not None and (worst is None or found.excess_m > worst.excess_m):
                    worst = found
        return worst

    def deepest_probe(self, body: PosedSolids, tolerance_m: float) -> tuple[str, SolidContact] | None:
        """The part whose vertex or edge goes deeper than give + `tolerance_m` into a solid of a body; None where none does.

        Finds what passes between the skin's vertices: the wheel's rim in a forearm, a console's edge in a calf.
        """
        for group, vehicle_from_group, _ in self.groups:
            points, chosen = _probes_in(group.probes, vehicle_from_group, body.box)
            if not len(chosen):
                continue
            limits = group.probe_give[chosen] + tolerance_m
            index = np.arange(len(chosen), dtype=np.int32)
            for solid in range(len(SOLIDS)):
                found = body.deepest(solid, points, index, limits)
                if found is not None:
                    return group.parts[group.probe_part[chosen[found.point]]].name, found
        return None


@njit(cache=True, nogil=True)
def _probes_in(probes, vehicle_from_group, box):  # type: ignore[no-untyped-def]
    """The probes that lie in a box of the vehicle frame, as (n, 3) float32 of that frame and by number."""
    m = vehicle_from_group
    points = np.empty((len(probes), 3), np.float32)
    chosen = np.empty(len(probes), np.int32)
    n = 0
    for p in range(len(probes)):
        x, y, z = probes[p, 0], probes[p, 1], probes[p, 2]
        u = m[0, 0] * x + m[0, 1] * y + m[0, 2] * z + m[0, 3]
        v = m[1, 0] * x + m[1, 1] * y + m[1, 2] * z + m[1, 3]
        w = m[2, 0] * x + m[2, 1] * y + m[2, 2] * z + m[2, 3]
        if box[0, 0] < u < box[1, 0] and box[0, 1] < v < box[1, 1] and box[0, 2] < w < box[1, 2]:
            points[n, 0], points[n, 1], points[n, 2] = u, v, w
            chosen[n] = p
            n += 1
    return points[:n], chosen[:n]


def _measure(
    group: GroupField,
    points: NDArray[np.float32],
    index: NDArray[np.intp],
    clearance: NDArray[np.float64],
    group_from_vehicle: Matrix,
    tolerance: float,
    give: bool,
) -> Contact | None:
    """The worst of the points that the grid left open, measured on the triangles."""
    local = apply(group_from_vehicle, points[index])
    depth = np.full((len(group.parts), len(index)), -np.inf)
    for row, part in zip(depth, group.parts, strict=True):
        near = np.flatnonzero(((local > part.mesh.low) & (local < part.mesh.high)).all(axis=1))
        if len(near):
            radius = part.give_m + tolerance + 2.0 * group.bound_m
            distance = part.mesh.signed_distance(local[near], radius)
            beyond = np.flatnonzero((distance == radius) & (clearance[near] < -tolerance - group.bound_m))
            distance[beyond] = part.mesh.signed_distance(local[near[beyond]], SEARCH_M)
            row[near] = part.shell_m / 2.0 - distance
    allowed = np.array([p.give_m if give else 0.0 for p in group.parts]) + tolerance
    excess = depth - allowed[:, None]
    which, n = np.unravel_index(np.argmax(excess), excess.shape)
    if excess[which, n] > 0.0:
        where = points[index[n]].astype(np.float64)
        return Contact(group.parts[which].name, float(depth[which, n]), float(excess[which, n]), where, int(index[n]))
    lost = np.where(depth.max(axis=0) < 0.0, clearance, np.inf)
    n = np.argmin(lost)
    if group.interior and lost[n] < -tolerance:
        where = points[index[n]].astype(np.float64)
        return Contact(OUTSIDE, float(-lost[n]), float(-lost[n]) - tolerance, where, int(index[n]))
    return None

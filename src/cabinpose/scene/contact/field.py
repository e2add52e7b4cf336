"""Clearance of points to the parts of a cabin: distance fields on grids, one per group that moves as one.

A group's field holds, at the nodes of a regular grid in the group's own frame, the least over its parts of "signed
distance + give": how far a point may still move before a part gives way no more. Negative means too deep. A seat
that slides or reclines takes its field along; only the transform changes.

Nodes hold one byte (clearance cut at ±95 mm), interpolation is trilinear. Distances are exact as far as a verdict can
depend on them and approximate beyond. The field sorts points into "clear" and "look closer": `PlacedField.deepest`
measures the few points that the interpolation bound leaves open on the triangles themselves.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
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
def _splat(corners, origin, step, reach, distance):  # type: ignore[no-untyped-def]
    """Squared distance at the nodes within `reach` of each triangle."""
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
                    if d2 <= reach * reach and d2 < distance[i, j, k]:
                        distance[i, j, k] = d2


@njit(cache=True, nogil=True)
def _fill(values, exact, step, band):  # type: ignore[no-untyped-def]
    """Clearance at the nodes that are not exact, summed up step by step from those that are (chamfer, Borgefors 1986).

    Two passes over half of the 26 neighbours each. A path over neighbours is never shorter than the straight way.
    """
    ni, nj, nk = values.shape
    ways = np.empty((13, 3), np.int64)
    length = np.empty(13, np.float32)
    for n in range(13):
        ways[n, 0], ways[n, 1], ways[n, 2] = n // 9 - 1, n // 3 % 3 - 1, n % 3 - 1
        length[n] = step * math.sqrt((ways[n] ** 2).sum())
    for direction in (1, -1):
        for i in range(ni) if direction > 0 else range(ni - 1, -1, -1):
            for j in range(nj) if direction > 0 else range(nj - 1, -1, -1):
                border = i in (0, ni - 1) or j in (0, nj - 1)
                for k in range(nk) if direction > 0 else range(nk - 1, -1, -1):
                    if exact[i, j, k]:
                        continue
                    size = min(abs(values[i, j, k]), band)
                    checked = border or k in (0, nk - 1)
                    for n in range(13):
                        u, v, w = i + direction * ways[n, 0], j + direction * ways[n, 1], k + direction * ways[n, 2]
                        if not checked or (0 <= u < ni and 0 <= v < nj and 0 <= w < nk):
                            size = min(size, abs(values[u, v, w]) + length[n])
                    values[i, j, k] = math.copysign(size, values[i, j, k])


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
def _merge(distance, winding, closed, offset, give, values, exact):  # type: ignore[no-untyped-def]
    """Lowers the group's clearance to that of one part: its distance where one was measured, else far outside or inside."""
    ni, nj, nk = distance.shape
    for i in range(ni):
        for j in range(nj):
            for k in range(nk):
                measured = distance[i, j, k] < np.inf
                inside = closed and winding[i, j, k] > 0
                if not measured and not inside:
                    continue
                d = math.sqrt(distance[i, j, k])
                value = (-d if inside else d) + give
                at = (i + offset[0], j + offset[1], k + offset[2])
                if value < values[at]:
                    values[at] = value
                    exact[at] = measured


@njit(cache=True, nogil=True)
def _reach_free(values, seeds, free_level, pass_level, steps):  # type: ignore[no-untyped-def]
    """Nodes reached from the seeds through the clear, and `steps` nodes on; and whether the grid's border was reached."""
    ni, nj, nk = values.shape
    free = np.zeros(values.shape, np.bool_)
    queue = np.empty((values.size, 3), np.int16)
    last = 0
    for s in range(len(seeds)):
        i, j, k = seeds[s]
        if 0 <= i < ni and 0 <= j < nj and 0 <= k < nk and values[i, j, k] >= free_level and not free[i, j, k]:
            free[i, j, k] = True
            queue[last, 0], queue[last, 1], queue[last, 2] = i, j, k
            last += 1
    open_border = False
    head = 0
    while head < last:
        i, j, k = np.int64(queue[head, 0]), np.int64(queue[head, 1]), np.int64(queue[head, 2])
        head += 1
        open_border = open_border or i == 0 or j == 0 or k == 0 or i == ni - 1 or j == nj - 1 or k == nk - 1
        for n in range(6):
            a, b, c = i, j, k
            d = 1 - 2 * (n & 1)
            if n < 2:
                a += d
            elif n < 4:
                b += d
            else:
                c += d
            if 0 <= a < ni and 0 <= b < nj and 0 <= c < nk and not free[a, b, c] and values[a, b, c] >= free_level:
                free[a, b, c] = True
                queue[last, 0], queue[last, 1], queue[last, 2] = a, b, c
                last += 1
    first = 0
    for _ in range(steps):
        start = last
        for n in range(first, start):
            i, j, k = np.int64(queue[n, 0]), np.int64(queue[n, 1]), np.int64(queue[n, 2])
            for a in range(max(i - 1, 0), min(i + 2, ni)):
                for b in range(max(j - 1, 0), min(j + 2, nj)):
                    for c in range(max(k - 1, 0), min(k + 2, nk)):
                        if not free[a, b, c] and values[a, b, c] >= pass_level:
                            free[a, b, c] = True
                            queue[last, 0], queue[last, 1], queue[last, 2] = a, b, c
                            last += 1
        first = start
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
    """One part of a group, for exact queries: its triangles and the depth to which it gives way.

    shell_m: an open surface is felt this far on both sides (m); 0 for closed ones.
    """

    name: str
    mesh: TriangleMesh
    give_m: float
    shell_m: float


@dataclass(frozen=True)
class GroupField:
    """The clearance field of a group and its parts, in the group's frame.

    values: (ni, nj, nk) int8, quanta of clearance · origin: (3,) m of node 0 · bound_m: by how much an interpolated
    value can exceed the true clearance · probes: (P, 3) m, vertices and points of sharp edges, with
    their part and its give ·
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
    probe_give: NDArray[np.float64]
    interior: bool
    sealed: bool

    @property
    def give_m(self) -> float:
        """The greatest give of the group's parts, m."""
        return max(p.give_m for p in self.parts)

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


def _lower_to_part(
    part: GroupPart, origin: NDArray[np.float64], step: float, values: NDArray[np.float32], exact: NDArray[np.bool_]
) -> None:
    """Exact as far as a verdict can depend on it: to the part's give, flesh and the interpolation bound below the surface."""
    reach = part.give_m + part.shell_m + 2.0 * step
    first = np.maximum(np.floor((part.mesh.low - reach - origin) / step), 0).astype(np.int64)
    last = np.minimum(np.ceil((part.mesh.high + reach - origin) / step), np.array(values.shape) - 1).astype(np.int64)
    dims = tuple(int(n) for n in last - first + 1)
    corner = origin + first * step
    distance = np.full(dims, np.inf, np.float32)
    _splat(part.mesh.corners, corner, step, reach, distance)
    winding = _winding(part.mesh.corners, corner, step, np.array(dims)) if part.mesh.closed else np.zeros((1, 1, 1), np.int8)
    _merge(distance, winding, part.mesh.closed, first, part.give_m - part.shell_m, values, exact)


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
    pad = 2.0 * step if seeds is not None else BAND_M
    low = np.min([p.mesh.low for p in ready], axis=0) - pad
    high = np.max([p.mesh.high for p in ready], axis=0) + pad
    shape = tuple(np.ceil((high - low) / step).astype(int) + 1)
    values = np.full(shape, np.inf, np.float32)
    exact = np.zeros(shape, np.bool_)
    for part_ready in ready:
        _lower_to_part(part_ready, low, step, values, exact)
    _fill(values, exact, step, BAND_M)
    sealed = False
    if seeds is not None:
        nodes = np.round((seeds - low) / step).astype(np.int64)
        free, open_border = _reach_free(values, nodes, SEAL_M, 0.5 * step, math.ceil(SEAL_M / step) + 2)
        if free.any():
            sealed = not open_border
            values[~free & (values >= 0.5 * step)] *= -1.0
    levels = np.clip(np.floor(values / QUANTUM_M), -127, 127).astype(np.int8)
    probes = [_probes(p.mesh) for p in ready]
    owner = np.repeat(np.arange(len(ready), dtype=np.int32), [len(p) for p in probes])
    give = np.array([p.give_m for p in ready])[owner]
    return GroupField(
        name, tuple(ready), levels, low, step, np.concatenate(probes), owner, give, interior=seeds is not None, sealed=sealed
    )


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
        built: dict[Any, GroupField] = {}
        fields = []
        for name, members in groups.items():
            # Seats of one row are copies of each other, in frames of their own: one field serves them all.
            shape = tuple((p.surface.vertices.tobytes(), p.surface.faces.tobytes(), p.give_m, p.solid) for p in members)
            key = (shape, name == STATIC_GROUP)
            if key not in built:
                step = FINE_STEP_M if name == WHEEL_GROUP else STEP_M
                inside = np.array(seeds) if seeds and name == STATIC_GROUP else None
                built[key] = group_field(name, members, step=step, seeds=inside)
            parts = tuple(replace(g, name=p.name) for g, p in zip(built[key].parts, members, strict=True))
            fields.append(replace(built[key], name=name, parts=parts))
        self.groups: tuple[GroupField, ...] = tuple(fields)

    @property
    def nbytes(self) -> int:
        """Memory of the fields, bytes."""
        return sum(g.nbytes for g in {id(g.values): g for g in self.groups}.values())

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
        near = np.flatnonzero(((local > part.mesh.low - part.shell_m) & (local < part.mesh.high + part.shell_m)).all(axis=1))
        if len(near):
            radius = part.give_m + part.shell_m + tolerance + 2.0 * group.bound_m
            distance = part.mesh.signed_distance(local[near], radius)
            beyond = np.flatnonzero((distance == radius) & (clearance[near] < -tolerance - group.bound_m))
            distance[beyond] = part.mesh.signed_distance(local[near[beyond]], SEARCH_M)
            row[near] = part.shell_m - distance
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

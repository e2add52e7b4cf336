"""Clearance of points to the parts of a cabin: distance fields on grids, one per group that moves as one.

A group's field holds, at the nodes of a regular grid in the group's own frame, the least over its parts of "signed
distance + give": how far a point may still move before a part gives way no more. Negative means too deep. A seat
that slides or reclines takes its field along; only the transform changes.

Nodes hold one byte (clearance cut at ±95 mm), interpolation is trilinear. Distances are exact in the range that can decide a
verdict and approximate beyond it. By the field a point is surely clear, or it has to be measured: `PlacedField.deepest` measures
the few points within the interpolation bound on the triangles themselves.
"""

from __future__ import annotations

import hashlib
import math
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any, Protocol
from weakref import WeakValueDictionary

import numpy as np
from numpy.typing import NDArray

from cabinpose._native import contact as native
from cabinpose.core import Bools, ConfigError, Floats, Floats32, Ints, Ints32, Matrix, apply, invert
from cabinpose.core import reproducible as rp
from cabinpose.scene.contact.pairs import SOLIDS
from cabinpose.scene.contact.solids import PosedSolids, SolidContact
from cabinpose.scene.contact.triangles import TriangleMesh, edge_keys, sampled_surface, triangle_mesh

if TYPE_CHECKING:  # a cabin places its cameras by contact
    from cabinpose.scene.cabin.model import Part

STEP_M = 0.010  # grid step of static parts and seats
FINE_STEP_M = 0.005  # grid step of the wheel, whose rim is 30 mm thick
QUANTUM_M = 0.00075
BAND_M = 127 * QUANTUM_M
SEAL_M = 0.020  # gaps of the interior narrower than twice this count as closed
SHARP = rp.cos(math.radians(30.0))  # edges that bend more than this are probed as edges
PROBE_M = 0.015  # spacing of probes along sharp edges of hard parts
SOFT_PROBE_M = 0.040  # and over soft ones
FEW = 16  # points measured of a contact that is certain
SEARCH_M = 0.3  # how deep a depth is still measured
_BYTES_A_NODE = 12  # while a field is built: clearance, exactness, and the same of one part
STATIC_GROUP = "body"
WHEEL_GROUP = "wheel"


class ContactScene(Protocol):
    """Parts in groups, and where the groups are: a cabin, or a room."""

    @property
    def parts(self) -> Sequence[Part]: ...
    @property
    def seats(self) -> Mapping[str, Any]: ...
    def group_transforms(self, settings: Mapping[str, Any], *, wheel_angle: float = 0.0) -> Mapping[str, Matrix]: ...


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
    value can exceed the true clearance · probes: (P, 3) m, points that `_probes` takes of the parts,
    with their part and its give · part_low, part_high: (n, 3) m, the box of each part and its shell ·
    interior: what the occupants cannot reach counts as too deep ·
    sealed: and nothing leads out, so that what is beyond the grid is outside the car.
    """

    name: str
    parts: tuple[GroupPart, ...]
    values: NDArray[np.int8]
    origin: Floats
    step: float
    probes: Floats
    probe_part: Ints32
    probe_give: Floats
    part_low: Floats
    part_high: Floats
    interior: bool
    sealed: bool

    @cached_property
    def give_m(self) -> float:
        """The greatest give of the group's parts, m."""
        return max(p.give_m for p in self.parts)

    @cached_property
    def bound_m(self) -> float:
        """A distance changes by no more than the way to it, so interpolation is off by at most half a cell's diagonal."""
        return self.step * math.sqrt(3.0) / 2.0 + QUANTUM_M

    @cached_property
    def probe_balls(self) -> Floats:
        """`balls_of` the probes."""
        return balls_of(self.probes)

    @property
    def quantum_m(self) -> float:
        """The clearance that one quantum of the values stands for, m."""
        return QUANTUM_M

    @property
    def outside_m(self) -> float:
        """The clearance that stands for every point beyond the grid, m."""
        return -BAND_M if self.sealed else BAND_M


def balls_of(points: NDArray[np.floating]) -> Floats:
    """Centre and radius (ceil(N / 32), 4) of balls around every 32 consecutive points of (N, 3), m."""
    balls = np.empty((-(-len(points) // 32), 4))
    native.balls_of(points, balls)
    return balls


def _probes(part: GroupPart) -> Floats:
    """Points of a part that may go into a body unseen by the skin's own points.

    Of hard parts the vertices, and points every `PROBE_M` along the edges that bend outwards sharply. Of soft parts the
    whole surface: foam no thicker than twice its give has no depth beyond the give, but goes that deep into the body.
    """
    mesh = part.mesh
    if part.give_m > 0.0:
        return sampled_surface(mesh.corners, SOFT_PROBE_M)
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
    edges = np.flatnonzero((bend < SHARP) & convex & (length > PROBE_M))
    pieces = np.ceil(length[edges] / PROBE_M).astype(int)
    edge = np.repeat(edges, pieces - 1)
    number = np.arange(len(edge)) - np.repeat(np.cumsum(pieces - 1) - pieces + 1, pieces - 1) + 1
    t = (number / np.repeat(pieces, pieces - 1))[:, None]
    return np.concatenate((mesh.vertices, a[edge] + t * (b[edge] - a[edge])))


def _lower_to_part(part: GroupPart, origin: Floats, step: float, values: Floats32, exact: Bools) -> None:
    """Exact as far as a verdict can depend on it: to the part's give, flesh and the interpolation bound below the surface."""
    above = part.shell_m + 2.0 * step
    reach = part.give_m + above
    first = np.maximum(np.floor((part.mesh.low - reach - origin) / step), 0).astype(np.int64)
    last = np.minimum(np.ceil((part.mesh.high + reach - origin) / step), np.array(values.shape) - 1).astype(np.int64)
    dims = tuple(int(n) for n in last - first + 1)
    corner = origin + first * step
    distance = np.full(dims, np.inf, np.float32)
    before = above if part.mesh.closed else reach
    native.splat(part.mesh.corners, corner, step=step, below=reach, above=before, distance=distance)
    winding = np.zeros(dims if part.mesh.closed else (1, 1, 1), np.int8)
    if part.mesh.closed:
        native.winding_at_nodes(part.mesh.corners, corner, step, winding)
    native.merge_part(
        distance, winding,
        closed=part.mesh.closed, offset=first, give=part.give_m - part.shell_m, above=above, values=values, exact=exact,
    )  # fmt: skip


def bit_rows(values: Floats32, level: float) -> NDArray[np.uint64]:
    """Which nodes of (ni, nj, nk) are at least `level`: (ni, nj, ceil(nk / 64)) words of 64 nodes along the last axis."""
    bits = np.empty((*values.shape[:2], -(-values.shape[2] // 64)), np.uint64)
    native.bit_rows(values, level, bits)
    return bits


def grow(reached: NDArray[np.uint64], allowed: NDArray[np.uint64]) -> NDArray[np.uint64]:
    """Nodes of `bit_rows`, and those allowed ones that touch them over a face, edge or corner."""
    wide = reached | reached << np.uint64(1) | reached >> np.uint64(1)
    wide[..., 1:] |= reached[..., :-1] >> np.uint64(63)
    wide[..., :-1] |= reached[..., 1:] << np.uint64(63)
    for axis in (0, 1):
        rows = np.moveaxis(wide, axis, 0)
        before = rows.copy()
        rows[1:] |= before[:-1]
        rows[:-1] |= before[1:]
    return np.asarray(reached | wide & allowed)


def _check_memory(name: str, steps: NDArray[np.floating]) -> None:
    """ConfigError where the field of a group of so many steps (3,) would not fit into the memory that is free."""
    needed, free = float(np.prod(steps, dtype=np.float64)) * _BYTES_A_NODE, _free_bytes()
    if needed > free:
        raise ConfigError(
            f"the contact field of '{name}' takes {needed / 1e9:.1f} GB of memory, and {free / 1e9:.1f} GB are free",
            hint="give the mesh in metres, and only the parts that people can touch",
        )


def _free_bytes() -> int:
    return os.sysconf("SC_AVPHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")


def group_field(name: str, parts: Sequence[Part], *, step: float = STEP_M, seeds: Floats | None = None) -> GroupField:
    """The clearance field of the parts of one group.

    Parameters
    ----------
    name
        Of the group.
    parts
        In the group's frame.
    step
        Of the grid, m.
    seeds
        (S, 3) m, points inside the interior. Where given, all that cannot be reached from them, such as the space behind a
        window pane or a door panel, counts as too deep.

    Raises
    ------
    ConfigError
        Where the grid would not fit into the free memory.
    """
    vertices = np.concatenate([part.surface.vertices for part in parts])
    _check_memory(name, np.ptp(vertices, axis=0) / step)
    ready = []
    for part in parts:
        mesh = triangle_mesh(part.surface.vertices, part.surface.faces, closed=part.solid)
        ready.append(GroupPart(part.name, mesh, float(part.give_m), float(part.shell_m)))
    pad = 2.0 * step if seeds is not None else BAND_M
    low = np.min([p.mesh.low for p in ready], axis=0) - pad
    high = np.max([p.mesh.high for p in ready], axis=0) + pad
    shape = tuple(np.ceil((high - low) / step).astype(int) + 1)
    values = np.full(shape, np.inf, np.float32)
    exact = np.zeros(shape, np.bool_)
    for part_ready in ready:
        _lower_to_part(part_ready, low, step, values, exact)
    native.fill(values, exact, step=step, band=BAND_M)
    sealed = False
    if seeds is not None:
        nodes = np.round((seeds - low) / step).astype(np.int64)
        passable = bit_rows(values, 0.5 * step)
        free = np.empty_like(passable)
        open_border = native.flood(bit_rows(values, SEAL_M), nodes, shape[2], free)
        if free.any():
            sealed = not open_border
            for _ in range(math.ceil(SEAL_M / step) + 2):
                free = grow(free, passable)
            native.shut_off(values, free, 0.5 * step)
    probes = [_probes(p) for p in ready]
    owner = np.repeat(np.arange(len(ready), dtype=np.int32), [len(p) for p in probes])
    levels = np.empty(shape, np.int8)
    native.quantise(values, QUANTUM_M, levels)
    return GroupField(
        name,
        tuple(ready),
        levels,
        low,
        step,
        probes=np.concatenate(probes),
        probe_part=owner,
        probe_give=np.array([p.give_m for p in ready])[owner],
        part_low=np.array([p.mesh.low - p.shell_m for p in ready]),
        part_high=np.array([p.mesh.high + p.shell_m for p in ready]),
        interior=seeds is not None,
        sealed=sealed,
    )


@dataclass(frozen=True)
class Contact:
    """A point of a body in a part: depth beyond the surface and beyond what may give way (m), where (3,) in vehicle frame."""

    part: str
    depth_m: float
    excess_m: float
    where: Floats
    point: int


OUTSIDE = "outside the cabin"
_BUILT: WeakValueDictionary[bytes, GroupField] = WeakValueDictionary()  # by `_shape_key`, as long as a cabin has them


def _shape_key(parts: Sequence[Part], step: float, seeds: Floats | None) -> bytes:
    """A digest of all that a group's field depends on but the names."""
    digest = hashlib.blake2b(digest_size=32)
    for part in parts:
        vertices, faces = part.surface.vertices, part.surface.faces
        facts = (vertices.shape, vertices.dtype.str, faces.shape, faces.dtype.str, part.give_m, part.shell_m, part.solid)
        for piece in (repr(facts).encode(), vertices.tobytes(), faces.tobytes()):
            digest.update(piece)
    digest.update(repr((step, None if seeds is None else seeds.tolist())).encode())
    return digest.digest()


class ContactField:
    """The clearance fields of all groups of a cabin, built once."""

    def __init__(self, cabin: ContactScene) -> None:
        """Builds the fields of the cabin's parts that take part in contact (`solid`, or open with a `shell_m`)."""
        groups: dict[str, list[Part]] = {}
        for part in cabin.parts:
            if part.solid or part.shell_m > 0.0:
                groups.setdefault(part.group, []).append(part)
        chest = np.array((0.0, 0.0, 0.35))
        seeds = [np.asarray(seat.h_point(seat.default)) + chest for seat in cabin.seats.values()]
        self._cabin = cabin
        self._built: list[GroupField] = []
        fields = []
        for name, members in groups.items():
            step = FINE_STEP_M if name == WHEEL_GROUP else STEP_M
            inside = np.array(seeds) if seeds and name == STATIC_GROUP else None
            # Seats of one row are copies of each other, in frames of their own, as are those of a car with the wheel on the
            # other side: one field serves them all.
            key = _shape_key(members, step, inside)
            built = _BUILT.get(key)
            if built is None:
                built = _BUILT[key] = group_field(name, members, step=step, seeds=inside)
            self._built.append(built)
            parts = tuple(replace(g, name=p.name) for g, p in zip(built.parts, members, strict=True))
            fields.append(replace(built, name=name, parts=parts))
        self.groups: tuple[GroupField, ...] = tuple(fields)
        self._half = np.array([(np.array(g.values.shape) - 1) * g.step / 2.0 for g in fields])
        self._centre = np.array([g.origin for g in fields]) + self._half

    def at(self, settings: Mapping[str, Any], wheel_angle: float = 0.0) -> PlacedField:
        """The fields where these seat settings and this wheel angle (rad) put them."""
        transforms = self._cabin.group_transforms(settings, wheel_angle=wheel_angle)
        vehicle_from_group = np.array([transforms[g.name] for g in self.groups])
        centre = np.einsum("gij,gj->gi", vehicle_from_group[:, :3, :3], self._centre) + vehicle_from_group[:, :3, 3]
        half = np.einsum("gij,gj->gi", np.abs(vehicle_from_group[:, :3, :3]), self._half)
        groups = tuple(zip(self.groups, vehicle_from_group, invert(vehicle_from_group), strict=True))
        return PlacedField(groups, centre - half, centre + half)

    def clearance(self, points: NDArray[np.floating], settings: Mapping[str, Any], wheel_angle: float = 0.0) -> Floats:
        """`PlacedField.clearance` for one call; who asks often keeps what `at` returns."""
        return self.at(settings, wheel_angle).clearance(points)


@dataclass(frozen=True)
class PlacedField:
    """The groups of a cabin in one arrangement: field, vehicle_from_group, group_from_vehicle; the boxes of their grids.

    low, high: (G, 3) m, vehicle frame.
    """

    groups: tuple[tuple[GroupField, Matrix, Matrix], ...]
    low: Floats
    high: Floats

    def with_groups(self, added: Sequence[tuple[GroupField, Matrix]]) -> PlacedField:
        """The same with more groups, each with its `vehicle_from_group`: what was brought into the car."""
        if not added:
            return self
        low, high, groups = [], [], []
        for field, vehicle_from_group in added:
            half = (np.array(field.values.shape) - 1) * field.step / 2.0
            centre = apply(vehicle_from_group, (field.origin + half)[None])[0]
            reach = rp.matmul(np.abs(vehicle_from_group[:3, :3]), half)
            low.append(centre - reach)
            high.append(centre + reach)
            groups.append((field, vehicle_from_group, invert(vehicle_from_group)))
        return PlacedField((*self.groups, *groups), np.vstack((self.low, *low)), np.vstack((self.high, *high)))

    def clearance(self, points: NDArray[np.floating]) -> Floats:
        """(N,) m that points (N, 3) m of the vehicle frame may still move before a part gives way no more.

        Signed distance to the nearest part plus that part's give, cut at ±`BAND_M` and good to a few millimetres:
        to steer a posture with, not to decide on one. Behind the interior's surfaces it stays negative.
        """
        result, there = np.full(len(points), BAND_M), np.ascontiguousarray(points)
        for group, _, group_from_vehicle in self.groups:
            native.sample(there, group_from_vehicle, group, result)
        return result

    def deepest(self, points: Floats32, tolerance_m: float, *, give: bool = True) -> Contact | None:
        """The point of (N, 3) m, vehicle frame, that goes farthest beyond give + `tolerance_m`; None where none does.

        Exact at the points: those within the interpolation bound of the tolerance are measured on the triangles.
        `give=False` takes soft parts for hard ones.
        """
        worst: Contact | None = None
        balls = balls_of(points)
        low, high = (balls[:, :3] - balls[:, 3:]).min(axis=0), (balls[:, :3] + balls[:, 3:]).max(axis=0)
        in_reach = ((self.low < high) & (self.high > low)).all(axis=1)
        for (group, _, group_from_vehicle), near in zip(self.groups, in_reach, strict=True):
            if not (near or group.interior):
                continue
            yielding = 0.0 if give else group.give_m
            threshold = group.bound_m - tolerance_m + yielding
            index, clearance = native.points_below(points, balls, group_from_vehicle, group, threshold=threshold, seal=SEAL_M)
            if len(index):
                found = _measure(group, points, index, clearance, group_from_vehicle, tolerance_m, give)
                if found is not None and (worst is None or found.excess_m > worst.excess_m):
                    worst = found
        return worst

    def deepest_probe(self, body: PosedSolids, tolerance_m: float) -> tuple[str, SolidContact] | None:
        """The part whose vertex or edge goes deeper than give + `tolerance_m` into a solid of a body; None where none does.

        Finds what passes between the skin's vertices: the wheel's rim in a forearm, a console's edge in a calf.
        """
        in_reach = ((self.low < body.box[1]) & (self.high > body.box[0])).all(axis=1)
        for (group, vehicle_from_group, _), near in zip(self.groups, in_reach, strict=True):
            if near:
                where = np.zeros(3)
                solid, _, excess, probe, depth = native.first_probe(
                    group.probes,
                    group.probe_balls,
                    group.probe_give,
                    vehicle_from_group,
                    body.box,
                    tolerance_m,
                    body.arrays,
                    where,
                )
                if solid >= 0:
                    name = group.parts[group.probe_part[probe]].name
                    return name, SolidContact(SOLIDS[solid], depth, excess, probe, where)
        return None


def _measure(
    group: GroupField, points: Floats32, index: Ints, clearance: Floats, group_from_vehicle: Matrix, tolerance: float, give: bool
) -> Contact | None:
    """The worst of the points that the grid left open, measured on the triangles."""
    if clearance.min() < -tolerance - group.bound_m:
        # Surely too deep somewhere: the deepest few tell which part, and the rest need no measuring.
        deepest = np.argsort(clearance, kind="stable")[:FEW]
        index, clearance = index[deepest], clearance[deepest]
    local = apply(group_from_vehicle, points[index])
    depth = np.full((len(group.parts), len(index)), -np.inf)
    beside = (local <= group.part_low[:, None]) | (local >= group.part_high[:, None])
    inside_box = np.logical_not(np.asarray(beside).any(axis=2))
    for row in np.flatnonzero(inside_box.any(axis=1)):
        part, near = group.parts[row], np.flatnonzero(inside_box[row])
        radius = part.give_m + part.shell_m + tolerance + 2.0 * group.bound_m
        # What is nearer than allowed to a closed part is not too deep, on whichever side; to a sheet, near is deep.
        enough = tolerance + (part.give_m if give else 0.0) if part.mesh.closed else 0.0
        distance = part.mesh.signed_distance(local[near], radius, enough)
        beyond = np.flatnonzero((distance == radius) & (clearance[near] < -tolerance - group.bound_m))
        distance[beyond] = part.mesh.signed_distance(local[near[beyond]], SEARCH_M)
        touching = part.mesh.closed & (np.abs(distance) <= enough)
        depth[row, near] = np.where(touching, 0.0, part.shell_m - distance)
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

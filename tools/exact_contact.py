"""Exact penetration of whole scenes, by trimesh: slow, and independent of the kernels it is held against.

Needs the extra `bench` (trimesh measures distances through rtree). Every vertex of the skin is measured against every
solid part, every vertex of a part against the bodies, and bodies against themselves and each other in both directions.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
import trimesh
from numpy.typing import NDArray

from cabinpose.core.frames import apply
from cabinpose.core.skeleton import CABINPOSE
from cabinpose.scene.contact.field import ContactScene
from cabinpose.scene.contact.pairs import BOTH_YIELD_M, FLESH_M, PAIRS, SOLIDS
from cabinpose.scene.contact.solids import PosedSolids, SolidTopology
from cabinpose.scene.things import PlacedThing


class Penetration(NamedTuple):
    """One overlap: cause "self", "person", "car" or "thing", who and what, depth (m), the depth allowed (m), where (3,) m."""

    cause: str
    detail: str
    depth_m: float
    allowed_m: float
    where: NDArray[np.float64]

    @property
    def excess_m(self) -> float:
        """How far it goes beyond what is allowed, m; negative where it does not."""
        return self.depth_m - self.allowed_m


def _closed(vertices: NDArray[np.floating], faces: NDArray[np.integer]) -> trimesh.Trimesh:
    mesh = trimesh.Trimesh(np.asarray(vertices, np.float64), faces, process=False)
    mesh.merge_vertices(merge_norm=True, merge_tex=True)
    return mesh


def winding_number(mesh: trimesh.Trimesh, points: NDArray[np.float64]) -> NDArray[np.float64]:
    """(N,) how often a mesh winds around points (N, 3): the sum of signed solid angles (van Oosterom & Strackee 1983)."""
    result = np.empty(len(points))
    for n, point in enumerate(points):
        a, b, c = np.moveaxis(mesh.triangles - point, 1, 0)
        la, lb, lc = (np.linalg.norm(v, axis=1) for v in (a, b, c))
        volume = (a * np.cross(b, c)).sum(axis=1)
        length = la * lb * lc + (a * b).sum(axis=1) * lc + (b * c).sum(axis=1) * la + (c * a).sum(axis=1) * lb
        result[n] = np.arctan2(volume, length).sum() / (2.0 * np.pi)
    return result


def _depths(mesh: trimesh.Trimesh, points: NDArray[np.float64], allowed: float) -> NDArray[np.float64]:
    """(N,) m below the surface of a closed mesh; -inf for points (N, 3) outside.

    trimesh tells the side from the nearest triangle's normal or from one ray; either fails at sharp edges now and
    then. What either calls inside and too deep is settled by the winding number.
    """
    result = np.full(len(points), -np.inf)
    near = np.flatnonzero(((points > mesh.bounds[0]) & (points < mesh.bounds[1])).all(axis=1))
    if not len(near):
        return result
    signed = trimesh.proximity.signed_distance(mesh, points[near])
    inside = (signed > 0.0) | mesh.contains(points[near])
    deep = np.flatnonzero(inside & (np.abs(signed) > allowed))
    inside[deep] = winding_number(mesh, points[near[deep]]) > 0.5
    result[near[inside]] = np.abs(signed[inside])
    return result


def _worst(cause: str, detail: str, mesh: trimesh.Trimesh, points: NDArray[np.floating], allowed: float) -> list[Penetration]:
    at: NDArray[np.float64] = np.asarray(points, np.float64)
    depth = _depths(mesh, at, allowed)
    n = int(np.argmax(depth)) if len(depth) else -1
    return [Penetration(cause, detail, float(depth[n]), allowed, at[n])] if n >= 0 and depth[n] > 0.0 else []


def solid_mesh(body: PosedSolids, solid: str) -> trimesh.Trimesh:
    """The closed triangles of one of a body's solids, vehicle frame."""
    start, end = body.topology.all_rows[SOLIDS.index(solid)]
    return _closed(body.vertices, body.topology.faces[start:end])


def self_penetrations(slot: str, body: PosedSolids, joints: NDArray[np.float64]) -> list[Penetration]:
    """The deepest overlap of each pair of `PAIRS`, both ways, without the zones that joint limits answer for."""
    meshes = {name: solid_mesh(body, name) for name in SOLIDS}
    found = []
    for pair in PAIRS:
        for into, of in ((pair.one, pair.two), (pair.two, pair.one)):
            points = body.vertices[body.own(SOLIDS.index(of))]
            if pair.joint:
                centre = joints[CABINPOSE.index[pair.joint]]
                radius = pair.zone * np.linalg.norm(joints[CABINPOSE.index[pair.end]] - centre)
                points = points[np.linalg.norm(points - centre, axis=1) >= radius]
            found += _worst("self", f"{slot}: {of} in {into}", meshes[into], points, pair.tolerance_m)
    return found


def thing_penetrations(occupants: Sequence[tuple[str, Any, Any]], things: Sequence[PlacedThing]) -> list[Penetration]:
    """The deepest overlap of each part of a thing with each occupant (slot, person, posed body), both ways."""
    found: list[Penetration] = []
    for thing in things:
        for part in thing.thing.parts:
            mesh = _closed(apply(thing.vehicle_from_thing, part.surface.vertices), part.surface.faces)
            for slot, person, posed in occupants:
                body = _closed(posed.skin, person.skin_faces)
                found += _worst("thing", f"{slot} in {thing.slot} {part.name}", mesh, posed.skin, part.give_m + FLESH_M)
                found += _worst("thing", f"{thing.slot} {part.name} in {slot}", body, mesh.vertices, part.give_m + FLESH_M)
    return found


def exact_penetrations(
    cabin: ContactScene | None,
    occupants: Sequence[tuple[str, Any, Any]],
    topology: SolidTopology,
    settings: Mapping[str, Any],
    wheel_angle: float = 0.0,
    things: Sequence[PlacedThing] = (),
) -> list[Penetration]:
    """Every overlap of a scene of occupants (slot, person, posed body), deepest point of each; takes seconds.

    The scene holds to what is stated when no `excess_m` is above rounding. Parts that are open are left out: they
    have no inside to be exact about.
    """
    found: list[Penetration] = []
    skins = []
    for slot, person, posed in occupants:
        body = PosedSolids.of(topology, posed.skin)
        found += self_penetrations(slot, body, posed.joints)
        skins.append((slot, posed.skin, _closed(posed.skin, person.skin_faces)))
    for i, (slot, skin, mesh) in enumerate(skins):
        for other_slot, other_skin, other in skins[:i]:
            found += _worst("person", f"{slot} in {other_slot}", other, skin, BOTH_YIELD_M)
            found += _worst("person", f"{other_slot} in {slot}", mesh, other_skin, BOTH_YIELD_M)
    found += thing_penetrations(occupants, things)
    if cabin is None:
        return found
    transforms = cabin.group_transforms(settings, wheel_angle=wheel_angle)
    for part in cabin.parts:
        if not part.solid:
            continue
        at = apply(transforms[part.group], part.surface.vertices)
        mesh = _closed(at, part.surface.faces)
        for slot, skin, body_mesh in skins:
            found += _worst("car", f"{slot} in {part.name}", mesh, skin, part.give_m + FLESH_M)
            found += _worst("car", f"{part.name} in {slot}", body_mesh, mesh.vertices, part.give_m + FLESH_M)
    return found

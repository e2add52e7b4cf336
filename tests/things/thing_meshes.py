"""Meshes of cars and things for trimesh, which the tests ask how deep one is in the other."""

from __future__ import annotations

import numpy as np
import trimesh

from cabinpose.core.frames import apply
from cabinpose.scene.cabin import Cabin, SeatSetting
from cabinpose.scene.things import PlacedThing


def mesh_of(vertices: np.ndarray, faces: np.ndarray) -> trimesh.Trimesh:
    """A closed mesh in float64, equal positions merged."""
    mesh = trimesh.Trimesh(np.asarray(vertices, np.float64), faces, process=False)
    mesh.merge_vertices(merge_norm=True, merge_tex=True)
    return mesh


def cabin_mesh(cabin: Cabin, name: str, settings: dict[str, SeatSetting] | None = None) -> trimesh.Trimesh:
    """A part of a car, vehicle frame."""
    (part,) = (part for part in cabin.parts if part.name == name)
    at = cabin.group_transforms(settings or {})[part.group]
    return mesh_of(apply(at, part.surface.vertices), part.surface.faces)


def depth_in(thing: PlacedThing, mesh: trimesh.Trimesh) -> float:
    """How deep the deepest of many points of a thing is in a closed mesh, m, by trimesh; negative: the distance, up to 0.05."""
    surfaces = [trimesh.Trimesh(piece.solid.vertices, piece.solid.faces) for piece in thing.thing.pieces]
    points = np.concatenate(
        [*(trimesh.sample.sample_surface_even(s, 600, seed=1)[0] for s in surfaces), *(s.vertices for s in surfaces)]
    )
    points = apply(thing.vehicle_from_thing, points)
    near = points[((points > mesh.bounds[0] - 0.05) & (points < mesh.bounds[1] + 0.05)).all(axis=1)]
    return float(trimesh.proximity.signed_distance(mesh, near).max(initial=-0.05)) if len(near) else -0.05

"""From solids to the triangles a camera sees: vertex normals, smooth within a crease angle and split beyond it."""

from __future__ import annotations

import numpy as np

from cabinpose.core import Floats
from cabinpose.core import reproducible as rp
from cabinpose.scene.cabin.shapes import Solid
from cabinpose.scene.labels import LABEL_ID as LABEL
from cabinpose.scene.materials import MATERIAL_ID as MATERIAL
from cabinpose.scene.surface import Surface

_ROUNDING = 1e-9
CREASE = np.deg2rad(50.0)  # two faces that meet at more than this are an edge, not a curve


def face_normals(vertices: Floats, faces: np.ndarray) -> tuple[Floats, Floats]:
    """Unit normals (F, 3) and areas (F,) in m^2; the normal of a face without area is zero."""
    a, b, c = (vertices[faces[:, i]] for i in range(3))
    cross = np.cross(b - a, c - a)
    length = np.linalg.norm(cross, axis=1)
    return cross / np.maximum(length, 1e-30)[:, None], length / 2


def to_surface(solid: Solid, label: str, material: str, crease: float = CREASE) -> Surface:
    """The solid as a `Surface` of one class and material.

    Each corner of a face takes the angle-weighted mean normal of those faces around its vertex that bend away by
    less than `crease` (radians); corners of one vertex that agree share it. A vertex split this way keeps its exact
    position, so merging equal positions gives the closed mesh back.
    """
    vertices = solid.vertices.astype(np.float32).astype(np.float64)
    faces = solid.faces
    unit, _ = face_normals(vertices, faces)
    corner_vertex = faces.reshape(-1).astype(np.int64)
    corner_face = np.repeat(np.arange(len(faces)), 3)
    points = vertices[faces]
    to_next = np.roll(points, -1, axis=1) - points
    to_last = np.roll(points, 1, axis=1) - points
    cosine = np.sum(to_next * to_last, axis=-1) / np.maximum(
        np.linalg.norm(to_next, axis=-1) * np.linalg.norm(to_last, axis=-1), 1e-30
    )
    weight = rp.arccos(np.clip(cosine, -1, 1)).reshape(-1)

    # By axes, as rows of three are slow to gather.
    normal = np.ascontiguousarray(unit.T[:, corner_face])  # (3, corners)
    pull = normal * weight
    around = np.stack([np.bincount(corner_vertex, each, minlength=len(vertices)) for each in pull])  # (3, V), of all corners
    middle = around / np.maximum(np.linalg.norm(around, axis=0), 1e-30)
    # Around a vertex of which every normal is within half the crease of their middle, all pairs of corners agree.
    apart = (normal * middle[:, corner_vertex]).sum(axis=0) < rp.cos(0.5 * crease) + _ROUNDING
    creased = np.bincount(corner_vertex, apart, minlength=len(vertices)) > 0.0
    total = around.T[corner_vertex]
    corners = np.flatnonzero(creased[corner_vertex])
    of_creased = corner_vertex[corners]
    order = corners[np.argsort(of_creased, kind="stable")]
    counts = np.bincount(of_creased, minlength=len(vertices))
    starts = np.cumsum(counts) - counts
    # All ordered pairs of corners at one vertex.
    repeats = counts[corner_vertex[order]]
    first = np.repeat(order, repeats)
    within = np.arange(len(first)) - np.repeat(np.cumsum(repeats) - repeats, repeats)
    second = order[np.repeat(starts[corner_vertex[order]], repeats) + within]
    x, y, z = (axis[first] * axis[second] for axis in normal)
    near = x + y + z > rp.cos(crease)
    at, of = first[near], second[near]
    total[corners] = np.stack([np.bincount(at, each[of], minlength=len(corner_vertex)) for each in pull], axis=1)[corners]
    length = np.linalg.norm(total, axis=1, keepdims=True)
    normals = np.where(length > 1e-12, total / np.maximum(length, 1e-30), unit[corner_face])

    step = np.round(normals * 512).astype(np.int64) + 1024  # 11 bits each
    key = ((corner_vertex << 11 | step[:, 0]) << 11 | step[:, 1]) << 11 | step[:, 2]
    _, chosen, inverse = np.unique(key, return_index=True, return_inverse=True)
    count = len(faces)
    return Surface(
        np.ascontiguousarray(vertices[corner_vertex[chosen]], dtype=np.float32),
        np.ascontiguousarray(normals[chosen], dtype=np.float32),
        inverse.reshape(-1, 3).astype(np.int32),
        np.full(count, LABEL[label], np.uint8),
        np.full(count, MATERIAL[material], np.uint8),
        np.zeros(count, np.uint8),
    )

"""Exact distances against trimesh and closed forms."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh

from cabinpose.scene.contact.triangles import triangle_mesh


def _meshes() -> dict[str, trimesh.Trimesh]:
    return {
        "box": trimesh.creation.box((0.4, 0.3, 0.2)),
        "sphere": trimesh.creation.icosphere(3, 0.2),
        "torus": trimesh.creation.torus(0.185, 0.015, 48, 16),
        "capsule": trimesh.creation.capsule(0.3, 0.05),
    }


@pytest.mark.parametrize("name", _meshes())
def test_signed_distance_equals_trimesh(name: str) -> None:
    mesh = _meshes()[name]
    points = np.random.default_rng(1).uniform(mesh.bounds[0] - 0.05, mesh.bounds[1] + 0.05, (1500, 3))
    ours = triangle_mesh(mesh.vertices, mesh.faces, closed=True).signed_distance(points, 0.5)
    np.testing.assert_allclose(ours, -trimesh.proximity.signed_distance(mesh, points), atol=2e-6)


@pytest.mark.parametrize("cell_m", [0.01, 0.08, 2.0])
def test_cells_of_any_width_find_the_same(cell_m: float) -> None:
    mesh = _meshes()["torus"]
    points = np.random.default_rng(2).uniform(-0.6, 0.6, (200, 3))
    ours = triangle_mesh(mesh.vertices, mesh.faces, closed=False, cell_m=cell_m).signed_distance(points, 3.0)
    _, expected, _ = trimesh.proximity.closest_point(mesh, points)
    np.testing.assert_allclose(ours, expected, atol=2e-6)


def test_faces_with_their_own_vertices_are_welded() -> None:
    mesh = trimesh.creation.box((0.4, 0.3, 0.2))
    apart = triangle_mesh(mesh.triangles.reshape(-1, 3), np.arange(36).reshape(-1, 3), closed=True)
    assert len(apart.vertices) == 8
    corner_region = np.array([[0.21, 0.16, 0.11], [0.19, 0.14, 0.09]])
    np.testing.assert_allclose(apart.signed_distance(corner_region, 0.5), [np.sqrt(3e-4), -0.01], atol=1e-12)


def test_distance_is_cut_at_the_radius_and_unsigned_where_open() -> None:
    sheet = triangle_mesh(np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0]], float), np.array([[0, 1, 2]]), closed=False)
    np.testing.assert_allclose(sheet.signed_distance(np.array([[0.2, 0.2, -0.03], [0.2, 0.2, 0.5]]), 0.1), [0.03, 0.1])

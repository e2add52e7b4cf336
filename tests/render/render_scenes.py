"""Hand-made surfaces and an Embree oracle for the renderer's tests."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
import trimesh
from embreex import rtcore_scene
from embreex.mesh_construction import TriangleMesh
from numpy.typing import NDArray

from cabinpose.core.camera import Camera
from cabinpose.core.frames import Matrix, apply, invert, look_at
from cabinpose.scene.labels import LABEL_ID as LABEL
from cabinpose.scene.materials import MATERIAL_ID as MATERIAL
from cabinpose.scene.surface import Surface, merge

BARREL = (-0.18, 0.03, 0.001, -0.0015, -0.002)  # a wide lens; its corners see nothing


def surface(mesh: trimesh.Trimesh, label: str = "seat", material: str = "seat_fabric", instance: int = 0) -> Surface:
    n = len(mesh.faces)
    return Surface(
        np.ascontiguousarray(mesh.vertices, np.float32),
        np.ascontiguousarray(mesh.vertex_normals, np.float32),
        np.ascontiguousarray(mesh.faces, np.int32),
        np.full(n, LABEL[label], np.uint8),
        np.full(n, MATERIAL[material], np.uint8),
        np.full(n, instance, np.uint8),
    )


def ball(
    centre: tuple[float, float, float], radius: float, label: str = "seat", *, instance: int = 0, subdivisions: int = 3
) -> Surface:
    mesh = trimesh.creation.icosphere(subdivisions=subdivisions, radius=radius)
    mesh.apply_translation(centre)
    return surface(mesh, label, "cotton", instance)


def rod(
    start: tuple[float, float, float], end: tuple[float, float, float], radius: float, label: str, *, instance: int = 0
) -> Surface:
    mesh = trimesh.creation.cylinder(radius=radius, segment=np.array([start, end]), sections=24)
    return surface(mesh, label, "cotton", instance)


def room(*, subdivide: int = 0) -> Surface:
    """A box of 3 x 1.6 x 1.4 m around the camera, seen from inside."""
    mesh = trimesh.creation.box(extents=(3.0, 1.6, 1.4))
    for _ in range(subdivide):
        mesh = mesh.subdivide()
    mesh.apply_translation((1.2, 0.0, 0.7))
    mesh.invert()
    return surface(mesh, "trim", "headliner")


def person(instance: int = 1, at: tuple[float, float, float] = (1.2, 0.3, 0.6)) -> Surface:
    """A crude seated person of balls and rods: trunk, head, arms stretched forward and thighs."""
    x, y, z = at
    parts = [
        ball((x, y, z + 0.3), 0.2, "torso_left", instance=instance, subdivisions=4),
        ball((x, y, z), 0.18, "hip_center", instance=instance),
        ball((x, y, z + 0.62), 0.11, "head_left", instance=instance, subdivisions=4),
    ]
    for side, sign in (("left", 1), ("right", -1)):
        parts += [
            rod((x, y + 0.2 * sign, z + 0.4), (x - 0.1, y + 0.25 * sign, z + 0.15), 0.05, f"upper_arm_{side}", instance=instance),
            rod((x - 0.1, y + 0.25 * sign, z + 0.15), (x - 0.35, y + 0.2 * sign, z + 0.25), 0.04, f"forearm_{side}",
                instance=instance),
            rod((x, y + 0.1 * sign, z), (x - 0.4, y + 0.12 * sign, z + 0.02), 0.08, f"thigh_{side}", instance=instance),
        ]  # fmt: skip
    return merge(parts)


def cabin_view(distance: float = 0.0) -> Matrix:
    """`camera_from_vehicle` of a camera under the roof that looks at the seats."""
    return invert(look_at((0.05 - distance, 0.1, 1.0), (1.2, 0.2, 0.6)))


def small_camera(dist: tuple[float, float, float, float, float] = (0.0, 0.0, 0.0, 0.0, 0.0)) -> Camera:
    return Camera.from_fov(176, 143, np.deg2rad(100), np.deg2rad(85), dist)


def people_in_cars() -> Iterator[tuple[Surface, Matrix, NDArray[np.float64]]]:
    """Three cars with two people each, seen from two places: surface, camera from vehicle, joints (2, 20, 3) in the camera."""
    from cabinpose.scene.body import DOF_INDEX, DOFS, SUBJECTS, BodyModel
    from cabinpose.scene.cabin import build_cabin

    rng = np.random.default_rng(3)
    model = BodyModel.load()
    people = [model.person(s.phenotype, s.outfit) for s in list(SUBJECTS.values())[:3]]
    for preset in ("city_car", "sedan", "van"):
        cabin = build_cabin(preset)
        settings = {slot: seat.default for slot, seat in cabin.seats.items()}
        for view_name in ("driver", "front_row"):
            parts, joints = [cabin.surface(settings)], []
            for k, slot in enumerate(("driver", "front_passenger")):
                q = np.zeros(len(DOFS))
                for side in "lr":
                    for dof, low, high in (
                        ("hip.flexion", 70, 100), ("knee.flexion", 60, 90), ("shoulder.flexion", 0, 80),
                        ("elbow.flexion", 10, 100), ("shoulder.rotation", 0, 40),
                    ):  # fmt: skip
                        q[DOF_INDEX[f"{side}{dof}"]] = np.deg2rad(rng.uniform(low, high))
                body = people[(k + len(preset)) % 3].pose(q, cabin.seats[slot].vehicle_from_seat(settings[slot]))
                parts.append(body.surface(k + 1))
                joints.append(body.joints)
            anchor = cabin.view(view_name)
            view = invert(look_at(anchor.eye, anchor.target))
            yield merge(parts), view, apply(view, np.array(joints))


class Embree:
    """Ray casts from the camera's centre against a surface, in the camera frame."""

    def __init__(self, shape: Surface, camera_from_vehicle: Matrix) -> None:
        self.surface = shape
        self.vertices = apply(camera_from_vehicle, shape.vertices)
        self._scene = rtcore_scene.EmbreeScene(robust=True)
        self._mesh = TriangleMesh(self._scene, self.vertices.astype(np.float32), shape.faces)

    def cast(self, xy: NDArray[np.float64], start_z: float = 0.01) -> tuple[NDArray[np.float64], NDArray[np.int32]]:
        """Depth z and face (-1: none) of the first hit of rays (n, 2) beyond the plane z = start_z; z is refined in float64."""
        rays = np.concatenate((xy, np.ones((len(xy), 1))), axis=1)
        good = np.isfinite(rays).all(axis=1)
        safe = np.where(good[:, None], rays, (0.0, 0.0, 1.0))
        hits: Any = self._scene.run(
            (safe * start_z).astype(np.float32), safe.astype(np.float32), output=1, dists=np.full(len(rays), 1e9, np.float32)
        )
        face = np.where(good, hits["primID"], -1)
        return self.plane_depth(safe, face), face

    def plane_depth(self, rays: NDArray[np.float64], face: NDArray[np.int32]) -> NDArray[np.float64]:
        """Z at which rays (n, 3) meet the planes of faces (n,), 0 for face -1."""
        a, b, c = (self.vertices[self.surface.faces[face, k]] for k in range(3))
        normal = np.cross(b - a, c - a)
        z = np.einsum("ij,ij->i", normal, a) / np.einsum("ij,ij->i", normal, rays)
        return np.where(face >= 0, z, 0.0)

"""Presets as mesh files, as a modelling tool exports them: part by part, or all in one mesh."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import trimesh

from cabinpose.core.frames import apply
from cabinpose.scene.cabin import Cabin

GLTF_FROM_VEHICLE = np.array([[0.0, 1, 0], [0, 0, 1], [1, 0, 0]])  # glTF: x left, y up, z forward


def write_car(cabin: Cabin, path: Path, *, fused: bool, factor: float = 1.0) -> Path:
    """The cabin as a GLB file in the axes of glTF, a metre `factor` units long; fused: one mesh without telling names."""
    transforms = cabin.group_transforms({})
    scene, meshes = trimesh.Scene(), []
    for part in cabin.parts:
        vertices = apply(transforms[part.group], part.surface.vertices) @ GLTF_FROM_VEHICLE.T * factor
        mesh = trimesh.Trimesh(vertices, part.surface.faces, process=False)
        meshes.append(mesh)
        if not fused:
            name = part.name.replace(" ", "_")
            scene.add_geometry(mesh, geom_name=name, node_name=name)
    if fused:
        scene.add_geometry(trimesh.util.concatenate(meshes), geom_name="Object_1", node_name="Object_1")
    scene.export(path)
    return path

"""Cabins and people for the browser's 3D view, as binary glTF."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import trimesh
from numpy.typing import NDArray

from cabinpose.app.studio.clouds import person_colour
from cabinpose.scene import LABEL_ID, MATERIAL_ID, Surface

_GAMMA = 2.2  # glTF's colours are linear
_SKIN, _HAIR = "#d9a987", "#3a2a20"
_CABIN = {
    "seat": "#7d8694", "trim": "#9aa0a8", "steering_wheel": "#2c2f36", "floor": "#4c4f55", "pedal": "#d0c040", "glass": "#b9d4e4",
    "wall": "#a8a8a0", "furniture": "#8c643c",
}  # fmt: skip
_HIDING = ("trim", "glass", "floor", "wall")  # what stands between the people and who looks in from outside


def cabin_glb(surface: Surface) -> bytes:
    """A cabin or room into which one looks from every side: of walls and roof only the faces that look inwards."""
    middle = surface.vertices.mean(axis=0)
    corners = surface.vertices[surface.faces]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    inwards = ((middle - corners[:, 0]) * normals).sum(axis=1) > 0
    shown = inwards | ~np.isin(surface.label, [LABEL_ID[name] for name in _HIDING])
    names = {LABEL_ID[name]: name for name in _CABIN}
    opaque = shown & (surface.label != LABEL_ID["glass"])
    return _glb([(surface, surface.label, opaque)], lambda label: _CABIN[names.get(label, "trim")])


def person_glb(surfaces: tuple[Surface, ...], slot: int) -> bytes:
    """Somebody with clothes in the colour of the seat's slot, and the belt."""
    colours = {MATERIAL_ID["skin"]: _SKIN, MATERIAL_ID["hair"]: _HAIR, MATERIAL_ID["belt_webbing"]: "#d03030"}
    colours |= {MATERIAL_ID["leather_shoe"]: "#30343a", MATERIAL_ID["denim"]: "#46628c", MATERIAL_ID["spectacle_lens"]: "#8fb0c0"}
    everything = [(surface, surface.material, np.ones(len(surface.faces), bool)) for surface in surfaces]
    return _glb(everything, lambda material: colours.get(material, person_colour(slot)))


def _glb(parts: list[tuple[Surface, NDArray[np.uint8], NDArray[np.bool_]]], colour: Callable[[int], str]) -> bytes:
    """The faces of surfaces that are shown, coloured by their kinds: for each surface the kinds (F,), and which faces (F,)."""
    scene = trimesh.Scene()
    for surface, kinds, shown in parts:
        for kind in np.unique(kinds[shown]).tolist():
            used, faces = np.unique(surface.faces[shown & (kinds == kind)], return_inverse=True)
            linear = [(int(colour(kind)[i : i + 2], 16) / 255) ** _GAMMA for i in (1, 3, 5)]
            look = trimesh.visual.material.PBRMaterial(baseColorFactor=[*linear, 1.0], metallicFactor=0.0, roughnessFactor=0.9)
            mesh = trimesh.Trimesh(
                surface.vertices[used], faces.reshape(-1, 3), vertex_normals=surface.normals[used], process=False,
                visual=trimesh.visual.TextureVisuals(material=look),
            )  # fmt: skip
            scene.add_geometry(mesh)
    data: bytes = scene.export(file_type="glb")
    return data

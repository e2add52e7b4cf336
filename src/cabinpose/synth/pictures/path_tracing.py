"""Radiance of a surface as a pinhole sees it, path traced with Mitsuba 3 (extra `rgb`).

The variant is `scalar_rgb`, which needs nothing but the package. Its numbers do not depend on the number of threads: the size
of its blocks, from which it seeds, is fixed here.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from cabinpose.core import Bools, Camera, Floats, Floats32, Matrix, optional_module
from cabinpose.core import reproducible as rp
from cabinpose.scene import MATERIALS, Surface
from cabinpose.synth.pictures.grid import without_panes
from cabinpose.synth.pictures.light import Light

HINT = "pip install 'cabinpose[rgb]', or choose images.renderer raster, a shaded preview"
_NEAREST_M = 0.01  # as the rasteriser has it
_BOUNCES = 5


def mitsuba() -> Any:
    """Mitsuba in the variant that is used here; raises DependencyError that names what is missing."""
    module = optional_module("mitsuba", purpose="path tracing", hint=HINT)
    if module.variant() != "scalar_rgb":
        module.set_variant("scalar_rgb")
    return module


def trace(
    surface: Surface, colours: Floats32, pinhole: Camera, world_from_camera: Matrix, light: Light, *, samples: int, seed: int
) -> Floats:  # fmt: skip
    """Radiance (N, 3) of a surface on the rays of a pinhole with square pixels, each the mean over the pixel.

    Parameters
    ----------
    surface
        In the scene's frame; light passes through its panes and lenses.
    colours
        Diffuse reflectance (F, 3) of its triangles.
    pinhole, world_from_camera
        Which rays, from where.
    light
        All light.
    samples
        Paths through a pixel.
    seed
        Of the paths, 32 bits.

    Raises
    ------
    DependencyError
        Without Mitsuba.
    """
    mi = mitsuba()
    described: dict[str, Any] = {
        "type": "scene",
        "integrator": {"type": "path", "max_depth": _BOUNCES, "rr_depth": 64, "block_size": 16},
        "camera": _sensor(mi, pinhole, world_from_camera, samples),
        **_emitters(mi, light),
    }
    if light.own > 0.0:
        place = np.asarray(world_from_camera)[:3, 3].tolist()
        described["own_light"] = {
            "type": "point", "position": place, "intensity": {"type": "rgb", "value": [np.pi * light.own] * 3}
        }  # fmt: skip
    for number, (roughness, where) in enumerate(_finishes(surface, without_panes(surface))):
        described[f"surface{number}"] = _mesh(mi, surface, colours, where, roughness)
    scene = mi.load_dict(described)
    image = scene.integrator().render(scene, scene.sensors()[0], seed=seed)
    return np.asarray(image, np.float64).reshape(-1, 3)


def _sensor(mi: Any, pinhole: Camera, world_from_camera: Matrix, paths: int) -> dict[str, Any]:
    # Mitsuba's cameras look along z with x to the left and y up.
    to_world = rp.matmul(np.asarray(world_from_camera, np.float64), np.diag((-1.0, -1.0, 1.0, 1.0)))
    return {
        "type": "perspective",
        "fov_axis": "x",
        "fov": float(np.degrees(2 * rp.arctan(pinhole.width / 2 / pinhole.fx))),
        "principal_point_offset_x": 0.5 - (pinhole.cx + 0.5) / pinhole.width,
        "principal_point_offset_y": 0.5 - (pinhole.cy + 0.5) / pinhole.height,
        "near_clip": _NEAREST_M,
        "far_clip": 1e4,
        "to_world": mi.ScalarTransform4f(to_world),
        "sampler": {"type": "independent", "sample_count": paths},
        "film": {
            "type": "hdrfilm", "width": pinhole.width, "height": pinhole.height, "rfilter": {"type": "box"},
            "pixel_format": "rgb", "component_format": "float32",
        },
    }  # fmt: skip


def _emitters(mi: Any, light: Light) -> dict[str, Any]:
    # Mitsuba's domes have their pole at y and begin at -z: x to -y, y to z, z to -x.
    turn = np.array([(0, 0, -1, 0), (-1, 0, 0, 0), (0, 1, 0, 0), (0, 0, 0, 1)], np.float64)
    found: dict[str, Any] = {}
    if light.dome.any():  # every light takes its share of the paths
        found["dome"] = {"type": "envmap", "bitmap": mi.Bitmap(light.dome), "to_world": mi.ScalarTransform4f(turn)}
    if light.sun is not None:
        towards, irradiance = light.sun
        found["sun"] = {
            "type": "directional", "direction": (-towards).tolist(), "irradiance": {"type": "rgb", "value": irradiance.tolist()}
        }  # fmt: skip
    for number, (place, intensity) in enumerate(light.lamps):
        found[f"lamp{number}"] = {
            "type": "point", "position": place.tolist(), "intensity": {"type": "rgb", "value": intensity.tolist()}
        }  # fmt: skip
    return found


def _finishes(surface: Surface, shown: Bools) -> list[tuple[float | None, Bools]]:
    """Roughness (None: matte) and the triangles (F,) that have it."""
    table = np.zeros(256)
    for material in MATERIALS:
        table[material.id] = material.roughness or 0.0
    roughness = table[surface.material]
    found = [(alpha or None, shown & (roughness == alpha)) for alpha in np.unique(roughness).tolist()]
    return [(alpha, where) for alpha, where in found if where.any()]


def _mesh(mi: Any, surface: Surface, colours: Floats32, where: Bools, roughness: float | None) -> Any:
    vertex, faces = np.unique(surface.faces[where], return_inverse=True)
    colour = {"type": "mesh_attribute", "name": "face_colour"}
    finish = (
        {"type": "diffuse", "reflectance": colour}
        if roughness is None
        else {"type": "principled", "base_color": colour, "roughness": roughness, "specular": 0.5}
    )
    properties = mi.Properties()
    properties["finish"] = mi.load_dict({"type": "twosided", "bsdf": finish})
    mesh = mi.Mesh("surface", len(vertex), int(where.sum()), has_vertex_normals=True, props=properties)
    mesh.add_attribute("face_colour", 3, np.ascontiguousarray(colours[where], np.float32).reshape(-1))
    values = mi.traverse(mesh)
    values["vertex_positions"] = surface.vertices[vertex].reshape(-1)
    values["vertex_normals"] = surface.normals[vertex].reshape(-1)
    values["faces"] = faces.reshape(-1).astype(np.uint32)
    values.update()
    return mesh

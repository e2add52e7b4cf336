"""What lies between the light source, the scene and the pixel: lens, light profile, materials at 850 nm."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from cabinpose.core import Bools, Camera, Floats32
from cabinpose.core import reproducible as rp
from cabinpose.scene.materials import MATERIALS
from cabinpose.scene.sensor.buffers import in_parts
from cabinpose.scene.sensor.presets import Sensor

# A pane sends back towards a source beside the lens what dust and scratches scatter, and a mirror image where it
# stands square to the ray. The mirror image (8 % from two surfaces) is smaller than a pixel and a thousand times brighter
# than white; a peak of 300 over a lobe of two degrees saturates a spot of a few pixels, as it does in real images.
_PANE_DIFFUSE = 0.004
_PANE_SPECULAR = 300.0
GLOSS_WIDTH = float(1.0 - rp.cos(np.radians(2.0)))
# Mean reflectance of what lies outside a window, seen by daylight alone.
_OUTSIDE_REFLECTANCE = 0.3


@lru_cache(maxsize=8)
def material_table(reflectance: bool, glass: bool, ambient: float, daylight: float) -> Floats32:
    """(256, 3) float32 by material id: diffuse reflectance, specular peak, ambient light returned.

    `reflectance` False: everything is white. `glass` False: transmissive materials are plain diffuse surfaces.
    `ambient` and `daylight` are the irradiances inside and outside, which the last column holds times the reflectance.
    """
    outside = daylight * _OUTSIDE_REFLECTANCE
    table = np.zeros((256, 3), np.float32)
    table[:, 2] = outside
    for material in MATERIALS[1:]:
        value = material.reflectance if reflectance else 1.0
        pane = glass and material.transmissive
        table[material.id] = (_PANE_DIFFUSE, _PANE_SPECULAR, outside) if pane else (value, 0.0, ambient * value)
    table.setflags(write=False)
    return table


@dataclass(frozen=True)
class LensMaps:
    """What depends on the pixel alone.

    range_over_depth: (H, W) · parts_range_over_depth: (H * W, s * s), see `in_parts` ·
    vignetting, illumination: (H, W), 1 on the axis ·
    field: (H, W) bool, inside the image circle. float32.
    """

    range_over_depth: Floats32
    parts_range_over_depth: Floats32
    vignetting: Floats32
    illumination: Floats32
    field: Bools


def _factor(camera: Camera) -> Floats32:
    # A pixel outside the lens model has no ray; it stays NaN and so invalid.
    return np.ascontiguousarray(camera.range_over_depth, dtype=np.float32)


@lru_cache(maxsize=8)
def lens_maps(sensor: Sensor, supersample: int) -> LensMaps:
    """The maps of a sensor's lens, computed once."""
    camera = sensor.camera
    centre = _factor(camera)
    cosine = 1.0 / centre.astype(np.float64)
    rows, columns = np.mgrid[: camera.height, : camera.width]
    field = np.isfinite(centre)
    if sensor.field_radius_px is not None:
        field &= rp.hypot(columns - camera.cx, rows - camera.cy) < sensor.field_radius_px
    return LensMaps(
        centre,
        in_parts(centre if supersample == 1 else _factor(camera.scaled(supersample)), supersample),
        rp.power(cosine, sensor.vignetting_exponent).astype(np.float32),
        rp.power(cosine, sensor.illumination_exponent).astype(np.float32),
        field,
    )


class SurfaceOptics(NamedTuple):
    """What frames of noise models that see one surface a pixel have in common, (H, W) each.

    range_over_depth, field: of `LensMaps` · amplitude_scale: amplitude (electrons) of a white surface that faces the camera at 1
    m, 0 outside the field · table: `material_table`.
    """

    range_over_depth: Floats32
    amplitude_scale: Floats32
    field: Bools
    table: Floats32


@lru_cache(maxsize=8)
def surface_optics(sensor: Sensor) -> SurfaceOptics:
    """Those of a sensor."""
    maps = lens_maps(sensor, 1)
    scale = np.float32(sensor.signal_e * sensor.contrast) * maps.vignetting * maps.illumination
    scale = np.where(maps.field, scale, np.float32(0.0))
    return SurfaceOptics(maps.range_over_depth, scale, maps.field, material_table(True, True, 0.0, 0.0))

"""What lies between the light source, the scene and the pixel: lens, light profile, and how materials return light.

Source of the lobe of smooth surfaces: Walter et al., "Microfacet Models for Refraction through Rough Surfaces", EGSR 2007.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from types import MappingProxyType
from typing import NamedTuple

import numpy as np

from cabinpose.core import Bools, Camera, Floats32
from cabinpose.core import reproducible as rp
from cabinpose.scene.materials import MATERIALS, Coat, Wavelength
from cabinpose.scene.sensor.buffers import in_parts
from cabinpose.scene.sensor.presets import Sensor

# A pane sends back towards a source beside the lens what dust and scratches scatter, and a mirror image where it
# stands square to the ray. The mirror image (8 % from two surfaces) is smaller than a pixel and a thousand times brighter
# than white; a peak of 300 over a lobe of two degrees saturates a spot of a few pixels, as it does in real images.
_PANE_DIFFUSE = 0.004
_PANE_SPECULAR = 300.0
_PANE_NARROWNESS = float(1.0 / (1.0 - rp.cos(np.radians(2.0))))
# Light that a surface sends back at once where it faces the source: of an index of 1.5, of skin's 1.4 and of chromium.
_FRESNEL, _FRESNEL_OF = 0.04, MappingProxyType({"skin": 0.028, "metal": 0.64})
PANES = np.isin(np.arange(256), [material.id for material in MATERIALS if material.transmissive])
"""(256,) whether a material is seen through, by id."""
_BY_ID = MappingProxyType({material.id: material for material in MATERIALS})
# Mean reflectance of what lies outside a window, seen by daylight alone.
_OUTSIDE_REFLECTANCE = 0.3


@lru_cache(maxsize=16)
def material_table(
    reflectance: bool,
    glass: bool,
    ambient: float,
    daylight: float,
    wavelength_nm: Wavelength = 850,
    coats: tuple[Coat, ...] = (),
) -> Floats32:
    """How surfaces return light.

    The lobe of a smooth surface is that of Beckmann's facets about the direction that light comes from: with roughness a, F / (4
    a^2) of a white surface's light where it faces the source, and (1 - (1 - cos) / a^2)^2 of that beside, to first order.

    Parameters
    ----------
    reflectance
        False: everything is white and matt.
    glass
        False: transmissive materials are plain diffuse surfaces.
    ambient, daylight
        Irradiances inside and outside.
    wavelength_nm
        Of the camera's light.
    coats
        What a scene's own surfaces reflect, in place of their materials.

    Returns
    -------
    (256, 4) float32
        By material or code of a coat: diffuse reflectance, specular peak, ambient light returned, 1 / width of the lobe.
    """
    outside = daylight * _OUTSIDE_REFLECTANCE
    table = np.zeros((256, 4), np.float32)
    table[:, 2] = outside
    own = [Coat(material.id, material.id, material.at(wavelength_nm)) for material in MATERIALS[1:]]
    for code, of, value in (*own, *coats):
        material = _BY_ID[of]
        if glass and material.transmissive:
            table[code] = _PANE_DIFFUSE, _PANE_SPECULAR, outside, _PANE_NARROWNESS
        elif not reflectance:
            table[code] = 1.0, 0.0, ambient, 0.0
        elif material.roughness is None:
            table[code] = value, 0.0, ambient * value, 0.0
        else:
            facets = material.roughness**2
            table[code] = value, _FRESNEL_OF.get(material.name, _FRESNEL) / (4 * facets), ambient * value, 1 / facets
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
    m, 0 outside the field · table: `material_table` · panes: (256,) which materials are panes.
    """

    range_over_depth: Floats32
    amplitude_scale: Floats32
    field: Bools
    table: Floats32
    panes: Bools


def surface_optics(sensor: Sensor, coats: tuple[Coat, ...] = ()) -> SurfaceOptics:
    """Those of a sensor, and of a scene with these coats."""
    table = material_table(True, True, 0.0, 0.0, sensor.wavelength_nm, coats)
    return SurfaceOptics(*_images(sensor), table, PANES)


@lru_cache(maxsize=8)
def _images(sensor: Sensor) -> tuple[Floats32, Floats32, Bools]:
    """Those of `SurfaceOptics`."""
    maps = lens_maps(sensor, 1)
    scale = np.float32(sensor.signal_e * sensor.contrast) * maps.vignetting * maps.illumination
    scale = np.where(maps.field, scale, np.float32(0.0))
    return maps.range_over_depth, scale, maps.field

"""Indirect light (multipath): what surfaces that the camera lights send on to others, by virtual point lights.

Sources: Keller, "Instant Radiosity", SIGGRAPH 1997 (virtual point lights); Dachsbacher and Stamminger, "Reflective Shadow Maps",
I3D 2005 (the light's own view says where they are); Meister et al., "Simulation of Time-of-Flight Sensors using Global
Illumination", VMV 2013 (phasors of indirect light by their whole path).
"""

from __future__ import annotations

from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from cabinpose._native import sensor as native
from cabinpose.core import Floats32
from cabinpose.core import reproducible as rp
from cabinpose.scene.sensor.buffers import GeometryBuffers
from cabinpose.scene.sensor.optics import lens_maps
from cabinpose.scene.sensor.presets import Sensor

CELLS = 500  # about as many are there in an image; what is in the middle of a cell stands for all of it
BOUNCES = 3  # between the light and the camera's surface
# Of a car's cabin: area of what a camera does not see, and length of the way by it.
UNSEEN_M2 = 8.0
UNSEEN_PATH_M = 1.0


class _LitScene(NamedTuple):
    """The light of a camera and what it falls on, as the kernel takes it: sensor/indirect.cpp."""

    rays: Floats32
    flux: Floats32
    illumination: Floats32
    table: Floats32
    frequencies: NDArray[np.float64]
    step: int
    bounces: int
    unseen: float
    unseen_area: float
    unseen_path: float


@lru_cache(maxsize=4)
def _light(sensor: Sensor, falloff: bool) -> tuple[Floats32, Floats32, Floats32, int]:
    """Rays (H, W, 2), flux of the light into the cells (h, w), its intensity along the rays (H, W), and the cells' side."""
    maps, rays = lens_maps(sensor, 1), sensor.camera.rays
    illumination = maps.illumination if falloff else np.ones_like(maps.illumination)
    (xv, yv), (xu, yu) = (np.moveaxis(np.gradient(rays, axis=axis), -1, 0) for axis in (0, 1))
    solid_angle = np.abs(xu * yv - xv * yu) / rp.power(maps.range_over_depth.astype(np.float64), 3)
    step = max(1, round(np.sqrt(solid_angle.size / CELLS)))
    padding = [(0, -n % step) for n in solid_angle.shape]
    flux = np.pad(np.nan_to_num(illumination * solid_angle), padding)
    cells = flux.reshape(flux.shape[0] // step, step, -1, step).sum(axis=(1, 3))
    return np.ascontiguousarray(rays, np.float32), cells.astype(np.float32), np.nan_to_num(illumination, nan=1.0), step


def indirect_light(
    buffers: GeometryBuffers,
    sensor: Sensor,
    table: Floats32,
    frequencies: NDArray[np.float64],
    *,
    falloff: bool,
    unseen: float = 0.0,
) -> Floats32:
    """Light that reaches what the camera sees by way of other surfaces, as it comes back to the camera.

    Parameters
    ----------
    buffers
        Geometry of the view: all that is known of the scene.
    sensor
        Its lens and light.
    table
        (256, 3) by material, diffuse reflectance first.
    frequencies
        (F,) modulation frequencies, Hz.
    falloff
        Whether the light falls off as the sensor says; even in all directions otherwise.
    unseen
        Reflectance of the rest of a car's cabin; 0 where there is none.

    Returns
    -------
    (H, 1 + 2 F, W) float32
        Energy and (cos, sin) a frequency, relative to a white surface that faces the camera at 1 m, as direct energy is.
    """
    height, width = buffers.shape
    light = np.empty((height, 1 + 2 * len(frequencies), width), np.float32)
    rays, flux, illumination, step = _light(sensor, falloff)
    lit = _LitScene(
        rays, flux, illumination, table, frequencies, step,
        bounces=BOUNCES, unseen=unseen, unseen_area=UNSEEN_M2, unseen_path=UNSEEN_PATH_M,
    )  # fmt: skip
    native.indirect_light(buffers, lit, light)
    return light

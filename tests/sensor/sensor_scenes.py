"""Geometry with known answers, built without the renderer."""

from __future__ import annotations

import numpy as np

from cabinpose.core.camera import Camera
from cabinpose.scene.materials import MATERIAL_ID
from cabinpose.scene.sensor import SENSORS, GeometryBuffers, Sensor

WHITE = "painted_wall"


def generator(*key: int) -> np.random.Generator:
    """The package's generator for a frame."""
    return np.random.Generator(np.random.Philox(key=key))


def small_sensor(**fields: object) -> Sensor:
    """A Time-of-Flight camera of few pixels, without falloff, crop or floor, at one frequency of 50 MHz."""
    base: dict[str, object] = {
        "name": "small",
        "camera": Camera.from_fov(96, 72, 0.6),
        "range_m": (0.05, 10.0),
        "integration_s": 7e-4,
        "fps": 15,
        "frequencies_hz": (50e6,),
        "min_amplitude_e": 0.0,
    }
    return Sensor.model_validate(base | fields)


def samples(buffers: GeometryBuffers) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Depth, incidence and material (H * s, W * s) of every part; a pixel without parts is all like its centre."""
    s, (height, width) = buffers.supersample, buffers.shape
    result = []
    for whole, parts in (
        (buffers.depth_m, buffers.parts_depth_m),
        (buffers.cos_incidence, buffers.parts_cos_incidence),
        (buffers.material, buffers.parts_material),
    ):
        every = np.repeat(whole.reshape(-1, 1), s * s, axis=1)
        every[buffers.mixed] = parts
        result.append(every.reshape(height, width, s, s).transpose(0, 2, 1, 3).reshape(height * s, width * s))
    return result[0], result[1], result[2]


def wall(sensor: Sensor, depth: float, supersample: int = 2, material: str = WHITE) -> GeometryBuffers:
    """A wall at one depth, square to the axis."""
    factor = sensor.camera.scaled(supersample).range_over_depth
    return GeometryBuffers.dense(
        supersample,
        np.full(factor.shape, depth, np.float32),
        (1 / factor).astype(np.float32),
        np.full(factor.shape, MATERIAL_ID[material], np.uint8),
    )


def sphere_of_range(sensor: Sensor, ranges: np.ndarray, supersample: int = 1) -> GeometryBuffers:
    """Surfaces that face the camera everywhere, at a range (m) for each pixel (H, W)."""
    factor = sensor.camera.scaled(supersample).range_over_depth
    wide = np.kron(ranges, np.ones((supersample, supersample)))
    return GeometryBuffers.dense(
        supersample,
        (wide / factor).astype(np.float32),
        np.ones(factor.shape, np.float32),
        np.full(factor.shape, MATERIAL_ID[WHITE], np.uint8),
    )


def step_edge(sensor: Sensor, near: float, far: float, split: int, supersample: int = 2) -> GeometryBuffers:
    """Two walls, the nearer one in the sample columns left of `split`."""
    flat = wall(sensor, far, supersample)
    depth, cosine, material = samples(flat)
    depth[:, :split] = near
    return GeometryBuffers.dense(supersample, depth, cosine, material)


def use_case(number: int) -> Sensor:
    """A use case of the Pico Monstar."""
    return SENSORS[f"pico_monstar_105/{number}"]

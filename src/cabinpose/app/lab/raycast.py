"""What a ToF camera's pixels see of a few simple bodies: rays cast analytically, many to a pixel where it sees an edge.

The renderer of `synth.render` draws triangles at 2 x 2 samples a pixel. Calibration needs edges and markers to hundredths of a
pixel. So the light of hundreds of rays is summed up for each surface in a pixel, and handed to the sensor model as one part a
surface: it averages energies and phasors of parts, and this is the same average.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from cabinpose._native import lab
from cabinpose.core import Camera, Floats32, Matrix, apply
from cabinpose.scene import MATERIAL_ID, MATERIALS
from cabinpose.scene.sensor import GeometryBuffers, Sensor, lens_maps

F64 = NDArray[np.float64]

_SUPERSAMPLE = 2  # parts of the sensor model: 2 x 2, one for each kind of surface
# Surfaces are of one material; their reflectance relative to it is in the cosine, by which the sensor model multiplies it.
_MATERIAL = MATERIAL_ID["painted_wall"]
_REFLECTANCE = MATERIALS[_MATERIAL].reflectance


@dataclass(frozen=True)
class Plate:
    """A flat rectangle with a checkerboard on it, which is printed on the side that faces -z.

    frame: (4, 4) from the plate's frame (x, y in its plane) to the scene's · size: x and y of two opposite corners (m) ·
    squares: x and y of the checkerboard's first corner, its squares along x and along y, their side (m); the first is black ·
    reflectances: of paper, ink and the back.
    """

    frame: Matrix
    size: tuple[float, float, float, float]
    squares: tuple[float, float, int, int, float]
    reflectances: tuple[float, float, float] = (0.75, 0.06, 0.3)


@dataclass(frozen=True)
class PrimitiveScene:
    """Bodies in one frame, metres; reflectances are relative to a white Lambertian surface, and may be above 1.

    planes: (P, 5) unit normal, distance d of n p = d, reflectance · capsules: (C, 8) two ends, radius, reflectance ·
    spheres: (S, 5) centre, radius, reflectance at its middle · plate: at most one.
    """

    planes: F64
    capsules: F64
    spheres: F64
    plate: Plate | None = None

    def seen_from(self, b_from_a: Matrix) -> PrimitiveScene:
        """The scene in another frame."""
        normals = self.planes[:, :3] @ b_from_a[:3, :3].T
        planes = np.column_stack((normals, self.planes[:, 3] + normals @ b_from_a[:3, 3], self.planes[:, 4]))
        ends = apply(b_from_a, self.capsules[:, :6].reshape(-1, 3)).reshape(-1, 6)
        return PrimitiveScene(
            planes,
            np.column_stack((ends, self.capsules[:, 6:])),
            np.column_stack((apply(b_from_a, self.spheres[:, :3]), self.spheres[:, 3:])),
            None if self.plate is None else replace(self.plate, frame=b_from_a @ self.plate.frame),
        )


@lru_cache(maxsize=4)
def _rays(camera: Camera) -> tuple[F64, F64]:
    """Ideal coordinates of the pixels' centres (H, W, 2) and corners (H + 1, W + 1, 2)."""
    corners = replace(camera, width=camera.width + 1, height=camera.height + 1, cx=camera.cx + 0.5, cy=camera.cy + 0.5)
    return camera.rays, corners.rays


class _PixelRays(NamedTuple):
    """Ideal coordinates of the pixels' centres (H, W, 2) and corners (H + 1, W + 1, 2); factors: `parts_range_over_depth`."""

    centres: F64
    corners: F64
    factors: Floats32


class _Scene(NamedTuple):
    """Planes (P, 5), capsules (C, 8), spheres (S, 5) and plates (0 or 1, 24), as `lab.cast` reads them."""

    planes: F64
    capsules: F64
    spheres: F64
    plates: F64


def _arrays(scene: PrimitiveScene) -> _Scene:
    plates = np.zeros((0, 24))
    if scene.plate is not None:
        turn, origin = scene.plate.frame[:3, :3], scene.plate.frame[:3, 3]
        plates = np.array([(*origin, *turn.T.ravel(), *scene.plate.size, *scene.plate.squares, *scene.plate.reflectances)])
    planes, capsules, spheres = (np.ascontiguousarray(a, np.float64) for a in (scene.planes, scene.capsules, scene.spheres))
    return _Scene(planes, capsules, spheres, plates)


def cast(scene: PrimitiveScene, sensor: Sensor) -> GeometryBuffers:
    """What the camera sees of a scene in its own frame: geometry for `simulate`, with the noise model's incidence left on."""
    shape = (sensor.camera.height, sensor.camera.width)
    pixels = _PixelRays(*_rays(sensor.camera), lens_maps(sensor, _SUPERSAMPLE).parts_range_over_depth)
    depth, cosine = np.empty(shape, np.float32), np.empty(shape, np.float32)
    mixed, parts_depth, parts_cosine = lab.cast(pixels, _arrays(scene), _REFLECTANCE, depth=depth, cosine=cosine)
    return GeometryBuffers(
        _SUPERSAMPLE, depth, cosine, np.where(depth > 0, np.uint8(_MATERIAL), np.uint8(0)),
        mixed, parts_depth, parts_cosine, np.where(parts_depth > 0, np.uint8(_MATERIAL), np.uint8(0)),
    )  # fmt: skip

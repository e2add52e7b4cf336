"""What goes into a noise model and what comes out: rendered geometry, and the frame that a camera delivers."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from cabinpose.core.errors import ConfigError


@dataclass(frozen=True)
class GeometryBuffers:
    """Geometry of a view, `supersample` x `supersample` samples a pixel: the view of `camera.scaled(supersample)`.

    depth_m: (H * s, W * s) float32, z along the optical axis in metres, 0 where nothing was hit ·
    cos_incidence: (H * s, W * s) float32, cosine of the angle between the ray and the surface normal, 0..1 ·
    material: (H * s, W * s) uint8, ids of `scene.materials`.
    """

    supersample: int
    depth_m: NDArray[np.float32]
    cos_incidence: NDArray[np.float32]
    material: NDArray[np.uint8]

    def __post_init__(self) -> None:
        shape = self.depth_m.shape
        if self.supersample < 1 or len(shape) != 2 or shape[0] % self.supersample or shape[1] % self.supersample:
            raise ConfigError(
                f"geometry of shape {shape} is not {self.supersample} samples a pixel side",
                hint="render with camera.scaled(supersample)",
            )
        if self.cos_incidence.shape != shape or self.material.shape != shape:
            raise ConfigError("depth, incidence and material of a view differ in shape", hint="fill all three at one resolution")

    @property
    def shape(self) -> tuple[int, int]:
        """(H, W): the image in pixels."""
        return self.depth_m.shape[0] // self.supersample, self.depth_m.shape[1] // self.supersample

    def one_sample(self) -> GeometryBuffers:
        """The geometry with one sample a pixel: that beside the pixel's centre, or at it where the number is odd."""
        half, s = self.supersample // 2, self.supersample
        every = (slice(half, None, s), slice(half, None, s))
        return GeometryBuffers(
            1,
            np.ascontiguousarray(self.depth_m[every]),
            np.ascontiguousarray(self.cos_incidence[every]),
            np.ascontiguousarray(self.material[every]),
        )

    def pixels(self) -> tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.uint8]]:
        """Depth, incidence and material (H, W) of one surface a pixel.

        The depth is the mean of a pixel's samples where they lie on one surface, and one of them where they do not:
        depths of two surfaces are never mixed.
        """
        depth = np.empty(self.shape, np.float32)
        _pixel_depth(self.depth_m, self.supersample, depth)
        sample = self.one_sample()
        return depth, sample.cos_incidence, sample.material


# Samples of one pixel that differ by more than this share of the depth are of different surfaces.
_ONE_SURFACE = np.float32(0.02)


@njit(cache=True, nogil=True)
def _pixel_depth(depth: NDArray[np.float32], s: int, out: NDArray[np.float32]) -> None:
    for v in range(out.shape[0]):
        for u in range(out.shape[1]):
            centre = depth[v * s + s // 2, u * s + s // 2]
            if not centre > 0:
                out[v, u] = 0.0
                continue
            total, agree = np.float32(0.0), True
            for i in range(s):
                for j in range(s):
                    z = depth[v * s + i, u * s + j]
                    total += z
                    agree &= abs(z - centre) <= _ONE_SURFACE * centre
            out[v, u] = total / np.float32(s * s) if agree else centre


@dataclass(frozen=True)
class SensorFrame:
    """What a camera delivers.

    depth_m: (H, W) float32, along the optical axis, NaN where invalid · amplitude: (H, W) uint16, active light in
    electrons of tap difference, also where the depth is invalid · confidence: (H, W) uint8, 0 where invalid and
    255 c / (c + sigma) elsewhere, with sigma the noise that the sensor estimates from its own samples, c = 10 mm.
    """

    depth_m: NDArray[np.float32]
    amplitude: NDArray[np.uint16]
    confidence: NDArray[np.uint8]


CONFIDENCE_SIGMA_M = 0.010  # the sigma at which confidence is half of its scale

"""What goes into a noise model and what comes out: rendered geometry, and the frame that a camera delivers."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from cabinpose.core import Bytes, ConfigError, Floats32, Ints32
from cabinpose.scene.materials import Coat


def centre_part(supersample: int) -> int:
    """Which of a pixel's parts is at its centre or, where their number is even, beside it."""
    return supersample // 2 * (supersample + 1)


def in_parts(dense: NDArray[Any], supersample: int) -> NDArray[Any]:
    """An image (H * s, W * s) of `camera.scaled(s)` as (H * W, s * s): the parts of each pixel, row by row."""
    s = supersample
    height, width = dense.shape[0] // s, dense.shape[1] // s
    return dense.reshape(height, s, width, s).swapaxes(1, 2).reshape(height * width, s * s)


_OF_PIXELS = "depth_m", "cos_incidence", "material"
_OF_MIXED = "mixed", "parts_depth_m", "parts_cos_incidence", "parts_material"
_DTYPES = tuple(np.dtype(t) for t in (np.float32, np.float32, np.uint8, np.int32, np.float32, np.float32, np.uint8))


@dataclass(frozen=True)
class GeometryBuffers:
    """Geometry of a view: one sample a pixel, and `supersample` x `supersample` parts of the pixels that need them.

    depth_m: (H, W) float32, z along the optical axis in metres at the pixel's centre, 0 where nothing was hit ·
    cos_incidence: (H, W) float32, cosine of the angle between the ray and the surface normal, 0..1 ·
    material: (H, W) uint8, ids of `scene.materials`, or codes of `coats` ·
    mixed: (M,) int32, flat indices, in any order, of the pixels whose light is the mean of their parts': those that see an edge,
    a crease or a steep surface. The other pixels see one smooth surface, whose centre stands for all of it ·
    parts_depth_m, parts_cos_incidence, parts_material: (M, s * s), the same at the centres of the parts of these pixels, row by
    row: pixels of `camera.scaled(s)` ·
    coats: what surfaces of the scene's own codes reflect, in place of materials ·
    sunlight: (H, W) float32, light of sun and sky on each pixel's surface (at 850 nm; `SUNLIGHT` has what is left at 940),
    relative to the camera's own light at 1 m; None where there is none.
    """

    supersample: int
    depth_m: Floats32
    cos_incidence: Floats32
    material: Bytes
    mixed: Ints32
    parts_depth_m: Floats32
    parts_cos_incidence: Floats32
    parts_material: Bytes
    coats: tuple[Coat, ...] = ()
    sunlight: Floats32 | None = None

    def __post_init__(self) -> None:
        shape, parts = self.depth_m.shape, (len(self.mixed), self.supersample**2)
        if self.cos_incidence.shape != shape or self.material.shape != shape:
            raise ConfigError("depth, incidence and material of a view differ in shape", hint="fill all three at one resolution")
        if self.sunlight is not None and self.sunlight.shape != shape:
            raise ConfigError("the sunlight of a view is not of its shape", hint="give one number for each pixel")
        if any(a.shape != parts for a in (self.parts_depth_m, self.parts_cos_incidence, self.parts_material)):
            raise ConfigError(
                f"the parts of {parts[0]} pixels are not {parts[0]} x {parts[1]} samples",
                hint="give supersample x supersample samples for every mixed pixel",
            )
        if any(a.dtype != dtype or not a.flags.c_contiguous for a, dtype in zip(self.arrays, _DTYPES, strict=True)):
            raise ConfigError(
                "the geometry of a view is not in the arrays that the compiled noise models take",
                hint="give C-contiguous arrays: depth and incidence float32, material uint8, mixed int32",
            )

    @classmethod
    def dense(cls, supersample: int, depth_m: Floats32, cos_incidence: Floats32, material: Bytes) -> GeometryBuffers:
        """The geometry (H * s, W * s) that `camera.scaled(s)` sees, all parts of all pixels."""
        shape, s = depth_m.shape, supersample
        if s < 1 or len(shape) != 2 or shape[0] % s or shape[1] % s:
            raise ConfigError(
                f"geometry of shape {shape} is not {s} samples a pixel side", hint="render with camera.scaled(supersample)"
            )
        if cos_incidence.shape != shape or material.shape != shape:
            raise ConfigError("depth, incidence and material of a view differ in shape", hint="fill all three at one resolution")
        pixels, centre = (shape[0] // s, shape[1] // s), centre_part(s)
        depth = np.ascontiguousarray(in_parts(depth_m, s), np.float32)
        cosine = np.ascontiguousarray(in_parts(cos_incidence, s), np.float32)
        materials = np.ascontiguousarray(in_parts(material, s), np.uint8)
        mixed = np.arange(len(depth) if s > 1 else 0, dtype=np.int32)
        return cls(
            s, depth[:, centre].copy().reshape(pixels), cosine[:, centre].copy().reshape(pixels),
            materials[:, centre].copy().reshape(pixels),
            mixed, depth[: len(mixed)], cosine[: len(mixed)], materials[: len(mixed)],
        )  # fmt: skip

    @classmethod
    def room(cls, supersample: int, pixels: tuple[int, int]) -> GeometryBuffers:
        """Memory for any view of H x W pixels, as a renderer fills it: it writes one mixed pixel more than there can be."""
        count = pixels[0] * pixels[1] + 1
        shapes = pixels, pixels, pixels, count, *[(count, supersample**2)] * 3
        return cls(supersample, *(np.empty(shape, dtype) for shape, dtype in zip(shapes, _DTYPES, strict=True)))

    def first(self, number: int) -> GeometryBuffers:
        """The same with only so many mixed pixels."""
        return replace(self, **{field: getattr(self, field)[:number] for field in _OF_MIXED})

    @property
    def shape(self) -> tuple[int, int]:
        """(H, W): the image in pixels."""
        return self.depth_m.shape[0], self.depth_m.shape[1]

    @property
    def arrays(self) -> tuple[NDArray[Any], ...]:
        """All arrays, in the order of the fields."""
        return tuple(getattr(self, field) for field in (*_OF_PIXELS, *_OF_MIXED))

    def copy(self) -> GeometryBuffers:
        """The same in memory of its own."""
        return replace(self, **{field: getattr(self, field).copy() for field in (*_OF_PIXELS, *_OF_MIXED)})

    def slots(self) -> Ints32:
        """(H, W): where in `mixed` each pixel is; -1 where it is not."""
        slots = np.full(self.depth_m.size, -1, np.int32)
        slots[self.mixed] = np.arange(len(self.mixed), dtype=np.int32)
        return slots.reshape(self.shape)


class SensorFrame(NamedTuple):
    """What a camera delivers.

    depth_m: (H, W) float32, along the optical axis, NaN where invalid · amplitude: (H, W) uint16, active light in
    electrons of tap difference, also where the depth is invalid · confidence: (H, W) uint8, 0 where invalid and
    255 c / (c + sigma) elsewhere, with sigma the noise that the sensor estimates from its own samples, c = 10 mm ·
    noise_m: (H, W) float32, that sigma along the optical axis, NaN where invalid, infinite where a tap is full.
    """

    depth_m: Floats32
    amplitude: NDArray[np.uint16]
    confidence: Bytes
    noise_m: Floats32

    @classmethod
    def empty(cls, shape: tuple[int, int]) -> SensorFrame:
        """Memory for a frame of a camera of H x W pixels."""
        return cls(*(np.empty(shape, dtype) for dtype in (np.float32, np.uint16, np.uint8, np.float32)))

"""`Surface`: triangles with everything a renderer needs to know of them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from cabinpose.core import Bytes, Floats32, Ints32, Matrix
from cabinpose.core import reproducible as rp


@dataclass(frozen=True)
class Surface:
    """Triangles of a scene, counter-clockwise seen from outside.

    vertices: (V, 3) float32 m · normals: (V, 3) float32 unit, outward, for shading · faces: (F, 3) int32 ·
    label, material, instance: (F,) uint8 (instance: 0 = nobody, else 1 + occupant slot).
    """

    vertices: Floats32
    normals: Floats32
    faces: Ints32
    label: Bytes
    material: Bytes
    instance: Bytes

    def moved(self, a_from_b: Matrix) -> Surface:
        """The surface in frame a, rigidly moved."""
        r = a_from_b[:3, :3].astype(np.float32)
        t = a_from_b[:3, 3].astype(np.float32)
        return replace(self, vertices=rp.matmul(self.vertices, r.T) + t, normals=rp.matmul(self.normals, r.T))


def merge(surfaces: Sequence[Surface]) -> Surface:
    """One surface of many, faces in the given order."""
    offsets = np.cumsum([0] + [len(s.vertices) for s in surfaces[:-1]])
    return Surface(
        np.concatenate([s.vertices for s in surfaces]),
        np.concatenate([s.normals for s in surfaces]),
        np.concatenate([s.faces + np.int32(o) for s, o in zip(surfaces, offsets, strict=True)]).astype(np.int32),
        np.concatenate([s.label for s in surfaces]),
        np.concatenate([s.material for s in surfaces]),
        np.concatenate([s.instance for s in surfaces]),
    )

"""Kernels that turn nearest faces into what a camera and its sensor model read: depth, incidence, material, labels."""

from __future__ import annotations

import numpy as np
from numba import njit

from cabinpose.synth.render.lanes import BLOCK, FACE, INVERSE_Z, LANES, first_lane, incidence, index, lanes_that_see
from cabinpose.synth.render.projection import F32, F64, U8
from cabinpose.synth.render.zbuffer import I32, U32, Lattice


@njit(cache=True, nogil=True, error_model="numpy")
def shade(
    sub: Lattice, p_camera: F32, normals: F32, rotation: F64, faces: U32, material: U8, matrices: F32, slots: I32,
    depth: F32, cosine: F32, out_material: U8,
) -> None:  # fmt: skip
    """Depth z (m), |cos| of incidence and material (H, W) at every sub-pixel; 0 where nothing is hit.

    The normal at a hit is sum(b_i n_i) with barycentric b_i proportional to r . (v_j x v_k): a 3x3 matrix times the ray. Those
    of the faces that are seen are kept one after the other in `matrices` (F, 9), close together in memory; slots: (F,) where
    that of each face lies. Both are work space.
    normals: (V, 3) of the vehicle frame · rotation: camera from vehicle.
    """
    height, width = depth.shape
    samples, numbers, row_blocks = sub.samples, sub.faces, sub.row_blocks
    squared, product = np.zeros(row_blocks * LANES, np.float32), np.zeros(row_blocks * LANES, np.float32)
    inverse = np.empty(row_blocks * LANES, np.float32)
    seen = np.empty(row_blocks * LANES, np.uint8)
    slots[: len(faces)] = -1
    used = 0
    for r in range(height):
        squared[:] = 0.0
        for b in range(row_blocks):
            block, at = r * row_blocks + b, b * LANES
            for k in range(LANES):
                f = numbers[block * BLOCK + FACE + k]
                inverse[at + k] = samples[block * BLOCK + INVERSE_Z + k]
                seen[at + k] = material[max(f, 0)] if f >= 0 else 0
            lanes = lanes_that_see(samples, block)
            while lanes:  # neighbours often see the same face
                f = numbers[block * BLOCK + FACE + first_lane(lanes)]
                slot = slots[f]
                if slot < 0:
                    slot = slots[f] = used
                    used += 1
                    _normal_matrix(p_camera, normals, rotation, faces, f, matrices[slot])
                lanes &= ~incidence(samples, block, f, matrices, slot, squared, product, at)
        for c in range(width):
            out_material[r, c] = seen[c]
        for c in range(width):
            w = inverse[c]
            depth[r, c] = np.float32(1.0) / w if w > np.float32(0.0) else np.float32(0.0)
        for c in range(width):
            q = squared[c]
            cosine[r, c] = min(product[c] / np.sqrt(q), np.float32(1.0)) if q > np.float32(0.0) else np.float32(0.0)


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def _cross(a: tuple[float, float, float], b: tuple[float, float, float]) -> tuple[float, float, float]:
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def _point(p: F32, i: int) -> tuple[float, float, float]:
    return np.float64(p[i, 0]), np.float64(p[i, 1]), np.float64(p[i, 2])


@njit(cache=True, nogil=True, error_model="numpy")
def _normal_matrix(p_camera: F32, normals: F32, rotation: F64, faces: U32, f: int, out: F32) -> None:
    """Row-major 3x3 matrix out (9,) that takes a ray of the image to the interpolated normal of face f, times any scale."""
    i0, i1, i2 = faces[f, 0], faces[f, 1], faces[f, 2]
    v0, v1, v2 = _point(p_camera, i0), _point(p_camera, i1), _point(p_camera, i2)
    n0, n1, n2 = _point(normals, i0), _point(normals, i1), _point(normals, i2)
    e0, e1, e2 = _cross(v1, v2), _cross(v2, v0), _cross(v0, v1)
    for k in range(3):
        x, y, z = rotation[k, 0], rotation[k, 1], rotation[k, 2]
        a = x * n0[0] + y * n0[1] + z * n0[2]
        b = x * n1[0] + y * n1[1] + z * n1[2]
        c = x * n2[0] + y * n2[1] + z * n2[2]
        out[3 * k] = np.float32(a * e0[0]) + np.float32(b * e1[0]) + np.float32(c * e2[0])
        out[3 * k + 1] = np.float32(a * e0[1]) + np.float32(b * e1[1]) + np.float32(c * e2[1])
        out[3 * k + 2] = np.float32(a * e0[2]) + np.float32(b * e1[2]) + np.float32(c * e2[2])


@njit(cache=True, nogil=True, error_model="numpy")
def classify(centre: Lattice, label: U8, instance: U8, face_id: I32, depth: F32, out_label: U8, out_instance: U8) -> None:
    """Face, depth z (m), label and instance (H, W) at every pixel; -1 and 0 where nothing is hit."""
    samples, numbers = centre.samples, centre.faces
    for r in range(centre.height):
        for c in range(centre.width):
            i = index(r, c, centre.row_blocks)
            f = numbers[i + FACE]
            face_id[r, c] = f
            if f < 0:
                depth[r, c] = 0.0
                out_label[r, c] = 0
                out_instance[r, c] = 0
            else:
                depth[r, c] = np.float32(1.0) / samples[i + INVERSE_Z]
                out_label[r, c] = label[f]
                out_instance[r, c] = instance[f]

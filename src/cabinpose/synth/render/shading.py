"""Kernels that turn nearest faces into what a camera and its sensor model read: depth, incidence, material, labels."""

from __future__ import annotations

import numpy as np
from numba import njit

from cabinpose.synth.render.lanes import FACE, INVERSE_Z, X, Y, index
from cabinpose.synth.render.projection import F32, F64, U8
from cabinpose.synth.render.zbuffer import I32, U32, Lattice


@njit(cache=True, nogil=True, error_model="numpy")
def shade(
    sub: Lattice, p_camera: F32, normals: F32, rotation: F64, faces: U32, material: U8, coefficients: F32, shaded: I32,
    frame: int, depth: F32, cosine: F32, out_material: U8,
) -> None:  # fmt: skip
    """Depth z (m), |cos| of incidence and material (H, W) at every sub-pixel; 0 where nothing is hit.

    The normal at a hit is sum(b_i n_i) with barycentric b_i proportional to r . (v_j x v_k): a 3x3 matrix times the ray,
    kept per face in `coefficients` (F, 9), filled for the faces that are seen (`shaded[f] == frame`).
    normals: (V, 3) of the vehicle frame · rotation: camera from vehicle.
    """
    height, width = depth.shape
    samples, numbers = sub.samples, sub.faces
    squared = np.empty(width, np.float32)
    for r in range(height):
        for c in range(width):
            i = index(r, c, sub.row_blocks)
            f = numbers[i + FACE]
            if f < 0:
                squared[c] = 0.0
                cosine[r, c] = 0.0
                depth[r, c] = 0.0
                out_material[r, c] = 0
                continue
            if shaded[f] != frame:
                shaded[f] = frame
                _normal_matrix(p_camera, normals, rotation, faces, f, coefficients)
            x, y = samples[i + X], samples[i + Y]
            nx = coefficients[f, 0] * x + coefficients[f, 1] * y + coefficients[f, 2]
            ny = coefficients[f, 3] * x + coefficients[f, 4] * y + coefficients[f, 5]
            nz = coefficients[f, 6] * x + coefficients[f, 7] * y + coefficients[f, 8]
            squared[c] = (nx * nx + ny * ny + nz * nz) * (x * x + y * y + np.float32(1.0))
            cosine[r, c] = abs(nx * x + ny * y + nz)
            out_material[r, c] = material[f]
            depth[r, c] = samples[i + INVERSE_Z]
        for c in range(width):  # apart from the gather above, so that the divisions run as vectors
            w = depth[r, c]
            depth[r, c] = np.float32(1.0) / w if w > np.float32(0.0) else np.float32(0.0)
        for c in range(width):
            q = squared[c]
            cosine[r, c] = min(cosine[r, c] / np.sqrt(q), np.float32(1.0)) if q > np.float32(0.0) else np.float32(0.0)


@njit(cache=True, nogil=True, error_model="numpy")
def _normal_matrix(p_camera: F32, normals: F32, rotation: F64, faces: U32, f: int, out: F32) -> None:
    """Row-major 3x3 matrix out[f] that takes a ray of the image to the interpolated normal of face f, times any scale."""
    for k in range(9):
        out[f, k] = 0.0
    for i in range(3):
        a, b, c = faces[f, (i + 1) % 3], faces[f, (i + 2) % 3], faces[f, i]
        ax, ay, az = np.float64(p_camera[a, 0]), np.float64(p_camera[a, 1]), np.float64(p_camera[a, 2])
        bx, by, bz = np.float64(p_camera[b, 0]), np.float64(p_camera[b, 1]), np.float64(p_camera[b, 2])
        ex, ey, ez = ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx
        for k in range(3):
            n = rotation[k, 0] * normals[c, 0] + rotation[k, 1] * normals[c, 1] + rotation[k, 2] * normals[c, 2]
            out[f, 3 * k] += np.float32(n * ex)
            out[f, 3 * k + 1] += np.float32(n * ey)
            out[f, 3 * k + 2] += np.float32(n * ez)


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

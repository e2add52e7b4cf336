"""Kernels that turn nearest faces into what a camera and its sensor model read: depth, incidence, material, labels.

They also decide which pixels have to be seen in parts.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from cabinpose.synth.render.lanes import BLOCK, FACE, INVERSE_Z, LANES, X, Y, first_lane, incidence, lanes_that_see
from cabinpose.synth.render.projection import F32, F64, U8
from cabinpose.synth.render.zbuffer import I32, STRIP, U32, Lattice

# Which pixels are seen in parts.
NONE, SOME, ALL = 0, 1, 2

# A pixel is left whole where, from its neighbours, z bends by no more than this share of itself from pixel to pixel, slopes by
# no more than that, and the cosine of incidence bends by no more than the third.
_BEND = np.float32(0.003)
_SLOPE = np.float32(0.04)
_COSINE_BEND = np.float32(0.06)


@njit(cache=True, nogil=True, error_model="numpy")
def shade(
    lattice: Lattice, p_camera: F32, normals: F32, rotation: F64, faces: U32, material: U8, matrices: F32, slots: I32, used: int,
    depth: F32, cosine: F32, out_material: U8,
) -> int:  # fmt: skip
    """Depth z (m), |cos| of incidence and material (rows, columns) at every sample; 0 where nothing is hit.

    The normal at a hit is sum(b_i n_i) with barycentric b_i proportional to r . (v_j x v_k): a 3x3 matrix times the ray. Those
    of the faces that are seen are kept one after the other in `matrices` (F, 9), close together in memory; slots: (F,) where
    that of each face lies, -1 at first; used: how many do, at first 0. Returns how many do now, for the frame's other samples.
    normals: (V, 3) of the vehicle frame · rotation: camera from vehicle.
    """
    height, width = depth.shape
    samples, numbers, row_blocks = lattice.samples, lattice.faces, lattice.row_blocks
    squared, product = np.zeros(row_blocks * LANES, np.float32), np.zeros(row_blocks * LANES, np.float32)
    inverse = np.empty(row_blocks * LANES, np.float32)
    seen = np.empty(row_blocks * LANES, np.uint8)
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
    return used


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
def classify(centre: Lattice, label: U8, instance: U8, face_id: I32, out_label: U8, out_instance: U8) -> None:
    """Face, label and instance (H, W) at every pixel; -1 and 0 where nothing is hit."""
    numbers = centre.faces
    for r in range(centre.height):
        for b in range(centre.row_blocks):
            first = (r * centre.row_blocks + b) * BLOCK + FACE
            for k in range(min(LANES, centre.width - b * LANES)):
                face_id[r, b * LANES + k] = numbers[first + k]
        for c in range(centre.width):
            f = face_id[r, c]
            out_label[r, c] = label[f] if f >= 0 else 0
            out_instance[r, c] = instance[f] if f >= 0 else 0


@njit(cache=True, nogil=True, error_model="numpy")
def _bent_row(depth: F32, cosine: F32, material: U8, r: int, bent: U8) -> None:
    """Where row r of an image may show more than one smooth surface to a pixel: bent (W,), without first and last column."""
    two = np.float32(2.0)
    for c in range(1, depth.shape[1] - 1):
        z, left, right, up, down = depth[r, c], depth[r, c - 1], depth[r, c + 1], depth[r - 1, c], depth[r + 1, c]
        smooth = max(abs(left + right - two * z), abs(up + down - two * z)) <= _BEND * z
        smooth &= max(abs(left - right), abs(up - down)) <= two * _SLOPE * z
        cos = cosine[r, c]
        across, along = cosine[r, c - 1] + cosine[r, c + 1] - two * cos, cosine[r - 1, c] + cosine[r + 1, c] - two * cos
        smooth &= max(abs(across), abs(along)) <= _COSINE_BEND * cos
        bent[c] = not smooth
    for c in range(1, depth.shape[1] - 1):
        m = material[r, c]
        differ = (material[r, c - 1] ^ m) | (material[r, c + 1] ^ m) | (material[r - 1, c] ^ m) | (material[r + 1, c] ^ m)
        bent[c] |= differ


@njit(cache=True, nogil=True, error_model="numpy")
def find_mixed(depth: F32, cosine: F32, material: U8, passed: U8, which: int, before: I32, mixed: I32) -> int:
    """The pixels that have to be seen in parts: their number M, and mixed[:M] their flat indices, strip by strip.

    depth, cosine, material: (H, W) at the pixels' centres · passed: (256,) bit 1 of the materials that parts look through;
    pixels that show them always count · which: NONE of the others, ALL, or SOME: those on the image's border, and those where
    a neighbour above, below, left or right is of another material or not on one smooth surface with it · before: set to the
    number of such pixels before each, see `Parts`.
    """
    height, width = depth.shape
    bent = np.empty((STRIP, width), np.uint8)
    count = at = 0
    for top in range(0, height, STRIP):
        for k in range(STRIP):
            r = top + k
            bent[k] = 0 if which == NONE or r >= height else 1
            if r >= height:
                continue
            if which == SOME and 0 < r < height - 1:
                _bent_row(depth, cosine, material, r, bent[k])
            for c in range(width):
                bent[k, c] |= passed[material[r, c]] & 1
        for c in range(width):
            for k in range(STRIP):
                before[at] = count
                at += 1
                if bent[k, c]:
                    mixed[count] = (top + k) * width + c
                    count += 1
    before[at] = count
    return count


@njit(cache=True, nogil=True, error_model="numpy")
def take_rays(mixed: I32, number: int, rays_x: F32, rays_y: F32, lattice: Lattice) -> None:
    """Put the rays (H * W, n) of the parts of the first `number` pixels of `mixed` into a lattice, and NaN behind them."""
    samples = lattice.samples
    count = rays_x.shape[1]
    at = 0
    if count == LANES // 2:
        for k in range(number):
            i = mixed[k]
            place = k // 2 * BLOCK + k % 2 * (LANES // 2)
            for j in range(LANES // 2):
                samples[place + X + j] = rays_x[i, j]
            for j in range(LANES // 2):
                samples[place + Y + j] = rays_y[i, j]
        at = number * count
    else:
        for k in range(number):
            for j in range(count):
                place = at // LANES * BLOCK + at % LANES
                samples[place + X], samples[place + Y] = rays_x[mixed[k], j], rays_y[mixed[k], j]
                at += 1
    for rest in range(at, lattice.height * lattice.row_blocks * LANES):
        place = rest // LANES * BLOCK + rest % LANES
        samples[place + X], samples[place + Y] = np.float32(np.nan), np.float32(np.nan)


@njit(cache=True, nogil=True, error_model="numpy")
def look_through(
    mixed: I32, passed: U8, part: int, depth: F32, cosine: F32, material: U8, parts_depth: F32, parts_cosine: F32,
    parts_material: U8,
) -> None:  # fmt: skip
    """Give pixels (H * W,) whose centre shows a material that is looked through what one of their parts (M, n) sees."""
    for k in range(len(mixed)):
        i = mixed[k]
        if passed[material[i]] & 1:
            depth[i], cosine[i], material[i] = parts_depth[k, part], parts_cosine[k, part], parts_material[k, part]

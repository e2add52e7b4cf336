"""Linear blend skinning and vertex normals."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

Array32 = NDArray[np.float32]


@njit(cache=True, nogil=True, fastmath={"contract", "nsz", "arcp"})
def skin_layers(transforms: Array32, index: NDArray[np.uint8], weight: Array32, layers: Array32, out: Array32) -> None:
    """Every layer (L, V, 3) at rest, posed into `out` (L, V, 3) m: the blend of a vertex is worked out once for all layers.

    transforms: (B, 3, 4) float32 · index, weight: (V, K), strongest first, 0 after the last one in use.
    """
    for v in range(len(index)):
        m00 = m01 = m02 = m03 = m10 = m11 = m12 = m13 = m20 = m21 = m22 = m23 = np.float32(0)
        for k in range(index.shape[1]):
            w = weight[v, k]
            if w == 0:
                break
            t = transforms[index[v, k]]
            m00 += w * t[0, 0]
            m01 += w * t[0, 1]
            m02 += w * t[0, 2]
            m03 += w * t[0, 3]
            m10 += w * t[1, 0]
            m11 += w * t[1, 1]
            m12 += w * t[1, 2]
            m13 += w * t[1, 3]
            m20 += w * t[2, 0]
            m21 += w * t[2, 1]
            m22 += w * t[2, 2]
            m23 += w * t[2, 3]
        for layer in range(len(layers)):
            x, y, z = layers[layer, v, 0], layers[layer, v, 1], layers[layer, v, 2]
            out[layer, v, 0] = m00 * x + m01 * y + m02 * z + m03
            out[layer, v, 1] = m10 * x + m11 * y + m12 * z + m13
            out[layer, v, 2] = m20 * x + m21 * y + m22 * z + m23


@njit(cache=True, nogil=True)
def vertex_normals(vertices: Array32, faces: NDArray[np.int32], out: Array32) -> None:
    """Unit normals (V, 3), outward, weighted by the area of the faces around; zero where a vertex has no face."""
    out[:] = 0
    for f in range(len(faces)):
        a, b, c = faces[f, 0], faces[f, 1], faces[f, 2]
        ux, uy, uz = vertices[b, 0] - vertices[a, 0], vertices[b, 1] - vertices[a, 1], vertices[b, 2] - vertices[a, 2]
        vx, vy, vz = vertices[c, 0] - vertices[a, 0], vertices[c, 1] - vertices[a, 1], vertices[c, 2] - vertices[a, 2]
        nx, ny, nz = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
        for i in (a, b, c):
            out[i, 0] += nx
            out[i, 1] += ny
            out[i, 2] += nz
    for i in range(len(out)):
        length = np.sqrt(out[i, 0] ** 2 + out[i, 1] ** 2 + out[i, 2] ** 2)
        if length > 0:
            out[i, 0] /= length
            out[i, 1] /= length
            out[i, 2] /= length

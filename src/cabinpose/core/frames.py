"""Rigid transforms: 4x4 float64 matrices named `a_from_b`, so that neighbours cancel.

`p_camera = apply(camera_from_vehicle, p_vehicle)`. Frames: vehicle (ISO 8855: x forward, y left, z up, origin on
the floor on the centre line under the front heel point), camera (OpenCV: x right, y down, z forward), world (z up).
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cabinpose.core import reproducible as rp

if TYPE_CHECKING:  # whoever has one has imported it
    from scipy.spatial.transform import Rotation

Matrix = NDArray[np.float64]  # (4, 4) or (..., 4, 4)

# World axes of systems whose y axis is up, turned upright: x stays, y becomes z.
ZUP_FROM_YUP = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])

# Axes of an OpenCV camera that looks along a body's x axis with z up: right = -y, down = -z, forward = x.
FORWARD_FROM_CAMERA = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])


_NEWTON_STEPS = 14  # 12 are enough to the last bit where mixing has left a hundredth of a rotation
_IDENTITY = np.eye(4)


def transform(rotation: Rotation | NDArray[np.float64] | None = None, translation: ArrayLike = (0.0, 0.0, 0.0)) -> Matrix:
    """The transform that rotates (by a `Rotation` or a matrix (3, 3)) and then translates (m); identity by default."""
    result = np.eye(4)
    if rotation is not None:
        result[:3, :3] = rotation if isinstance(rotation, np.ndarray) else rotation.as_matrix()
    result[:3, 3] = translation
    return result


def axis_rotation(axis: str, angle: float) -> NDArray[np.float64]:
    """The (3, 3) rotation about 'x', 'y' or 'z', right-handed, radians."""
    c, s = rp.cos(angle), rp.sin(angle)
    i, j = {"x": (1, 2), "y": (2, 0), "z": (0, 1)}[axis]
    matrix = np.eye(3)
    matrix[i, i] = matrix[j, j] = c
    matrix[i, j], matrix[j, i] = -s, s
    return matrix


def rotation_vector(vector: ArrayLike) -> NDArray[np.float64]:
    """The (3, 3) rotation by |vector| rad about a vector (3,), after Rodrigues; for one, a tenth of the time of scipy's."""
    x, y, z = np.asarray(vector, dtype=np.float64).tolist()
    angle = math.sqrt(x * x + y * y + z * z)
    # sin(a) / a and (1 - cos(a)) / a^2, whose series need no more terms where the angle is small
    s = rp.sin(angle) / angle if angle > 1e-8 else 1.0
    t = 0.5 * (rp.sin(0.5 * angle) / (0.5 * angle)) ** 2 if angle > 1e-8 else 0.5
    c = rp.cos(angle)
    return np.array(
        (
            (c + t * x * x, t * x * y - s * z, t * x * z + s * y),
            (t * x * y + s * z, c + t * y * y, t * y * z - s * x),
            (t * x * z - s * y, t * y * z + s * x, c + t * z * z),
        )
    )


def invert(a_from_b: Matrix) -> Matrix:
    """`b_from_a` of one or more rigid transforms (..., 4, 4)."""
    result = np.zeros_like(a_from_b)
    rotation_t = np.swapaxes(a_from_b[..., :3, :3], -1, -2)
    result[..., :3, :3] = rotation_t
    result[..., :3, 3] = -rp.matmul(rotation_t, a_from_b[..., :3, 3, None])[..., 0]
    result[..., 3, 3] = 1.0
    return result


def cross(a: NDArray[np.float64], b: NDArray[np.float64]) -> NDArray[np.float64]:
    """The cross product of two vectors (3,): a tenth of the time of `numpy.cross`, which is made for stacks of them."""
    (ax, ay, az), (bx, by, bz) = a.tolist(), b.tolist()
    return np.array((ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx))


def apply(a_from_b: Matrix, p_b: ArrayLike) -> NDArray[np.float64]:
    """Points (..., 3) of frame b, expressed in frame a."""
    p = np.asarray(p_b, dtype=np.float64)
    return rp.matmul(p, a_from_b[:3, :3].T) + a_from_b[:3, 3]


def look_at(eye: ArrayLike, target: ArrayLike, up: ArrayLike = (0.0, 0.0, 1.0)) -> Matrix:
    """`frame_from_camera` of a camera (OpenCV axes) at `eye` that looks at `target` with `up` upwards in the image.

    Raises ValueError where `target` equals `eye` or lies along `up`.
    """
    eye_, target_, up_ = (np.asarray(v, dtype=np.float64) for v in (eye, target, up))
    forward = target_ - eye_
    length = rp.norm(forward)
    if length < 1e-9:
        raise ValueError("look_at needs a target away from the eye")
    forward = forward / length
    right = cross(forward, up_)
    norm = rp.norm(right)
    if norm < 1e-9:
        raise ValueError("look_at needs an up direction that is not the viewing direction")
    right = right / norm
    result = np.eye(4)
    result[:3, 0], result[:3, 1], result[:3, 2] = right, cross(forward, right), forward
    result[:3, 3] = eye_
    return result


def is_rigid(matrix: ArrayLike, atol: float = 1e-6) -> bool:
    """Whether a 4x4 matrix is a rotation (right-handed) and a translation."""
    m = np.asarray(matrix, dtype=np.float64)
    if m.shape != (4, 4):
        return False
    # The product with its own transpose is the identity, and the last row 0 0 0 1.
    wrong = rp.matmul(m[:3, :3], m[:3, :3].T) - _IDENTITY[:3, :3]
    x, y, z = m[:3, :3]
    return bool((np.abs(wrong) <= atol).all() and (np.abs(m[3] - _IDENTITY[3]) <= atol).all() and rp.matmul(cross(x, y), z) > 0)


def nearest_rigid(matrix: Matrix) -> Matrix:
    """The rigid transform (4, 4) nearest to a matrix that is almost one, such as a product or a mixture of several.

    Its rotation is the orthogonal factor of the polar decomposition, by Newton's iteration (Higham 1986, eq. 3.1).
    """
    result, rotation = matrix.copy(), matrix[:3, :3]
    for _ in range(_NEWTON_STEPS):
        x, y, z = rotation
        cofactors = np.stack((cross(y, z), cross(z, x), cross(x, y)))  # the inverse's transpose is these over the determinant
        rotation = 0.5 * (rotation + cofactors / rp.matmul(x, cofactors[0]))
    result[:3, :3], result[3] = rotation, (0.0, 0.0, 0.0, 1.0)
    return result

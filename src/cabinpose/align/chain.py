"""From the suit's joints to the camera: camera_from_world · world_from_object · object_from_head · head_from_joint.

The suit is used relative to its own head, so that where its world is, and where that drifts to, drops out (Gonçalves 2020, eq.
4.12).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial.transform import Rotation

from cabinpose.core import AlignmentError, Matrix, invert

F64 = NDArray[np.float64]


def camera_from_suit(
    camera_from_world: Matrix, world_from_object: Matrix, object_from_head: Matrix, world_from_head: Matrix
) -> Matrix:
    """(T, 4, 4), of each moment: where the suit's own world is, seen from the camera.

    camera_from_world (4, 4) and world_from_object (T, 4, 4) of the optical system, object_from_head (4, 4), and of the suit
    world_from_head (T, 4, 4). A moment with NaN in a pose is NaN throughout. Raises AlignmentError where shapes do not fit.
    """
    count = len(world_from_head)
    for name, matrix, shape in (
        ("camera_from_world", camera_from_world, (4, 4)),
        ("world_from_object", world_from_object, (count, 4, 4)),
        ("object_from_head", object_from_head, (4, 4)),
        ("world_from_head", world_from_head, (count, 4, 4)),
    ):
        if np.shape(matrix) != shape:
            raise AlignmentError(
                f"{name} is {np.shape(matrix)}, not {shape}", hint="resample all streams to the camera's frames first"
            )
    # One NaN in a pose spreads through the products to the whole of its moment.
    return np.asarray(camera_from_world @ world_from_object @ object_from_head @ invert(world_from_head))


def joints_in_camera(chain: Matrix, p_joints: ArrayLike) -> F64:
    """(T, J, 3) m: joints of the suit's world (T, J, 3) m in the camera frame, by (T, 4, 4) of `camera_from_suit`.

    A joint with NaN is NaN by itself. Raises AlignmentError where there are not as many moments of both.
    """
    joints = np.asarray(p_joints, np.float64)
    if joints.shape != (len(chain), *joints.shape[1:2], 3):
        raise AlignmentError(
            f"p_joints is {joints.shape}, not {(len(chain), *joints.shape[1:2], 3)}",
            hint="resample all streams to the camera's frames first",
        )
    result = joints @ np.swapaxes(chain[:, :3, :3], -1, -2) + chain[:, None, :3, 3]
    return np.asarray(result)


def rigid(position: ArrayLike, quaternion_wxyz: ArrayLike) -> Matrix:
    """(..., 4, 4) transforms of positions (..., 3), m, and orientations (..., 4); all NaN where one of the two is missing."""
    p, q = np.asarray(position, np.float64), np.asarray(quaternion_wxyz, np.float64)
    known = np.isfinite(p).all(axis=-1) & (np.linalg.norm(q, axis=-1) > 0.5)  # False for NaN, and for the 0 0 0 0 of no tracking
    result = np.full((*p.shape[:-1], 4, 4), np.nan)
    some = np.zeros((int(known.sum()), 4, 4))
    if len(some):
        some[:, :3, :3] = Rotation.from_quat(q[known], scalar_first=True).as_matrix()
        some[:, :3, 3], some[:, 3, 3] = p[known], 1.0
    result[known] = some
    return result

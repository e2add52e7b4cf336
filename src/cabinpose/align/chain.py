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


def joints_in_camera(
    camera_from_world: Matrix, world_from_object: Matrix, object_from_head: Matrix, world_from_head: Matrix, p_joints: ArrayLike
) -> F64:
    """(T, J, 3) joints in the camera frame, m.

    camera_from_world (4, 4) and world_from_object (T, 4, 4) of the optical system, object_from_head (4, 4), and of the suit, in
    its own world, world_from_head (T, 4, 4) and the joints p_joints (T, J, 3). A moment with NaN in a pose is NaN throughout, a
    joint with NaN is NaN by itself.
    """
    joints = np.asarray(p_joints, np.float64)
    count = len(joints)
    for name, matrix, shape in (
        ("camera_from_world", camera_from_world, (4, 4)),
        ("world_from_object", world_from_object, (count, 4, 4)),
        ("object_from_head", object_from_head, (4, 4)),
        ("world_from_head", world_from_head, (count, 4, 4)),
        ("p_joints", joints, (count, *joints.shape[1:2], 3)),
    ):
        if np.shape(matrix) != shape:
            raise AlignmentError(
                f"{name} is {np.shape(matrix)}, not {shape}", hint="resample all streams to the camera's frames first"
            )
    # One NaN in a pose spreads through the products to the whole of its moment.
    camera_from_suit = camera_from_world @ world_from_object @ object_from_head @ invert(world_from_head)
    result = joints @ np.swapaxes(camera_from_suit[:, :3, :3], -1, -2) + camera_from_suit[:, None, :3, 3]
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

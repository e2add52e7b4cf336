"""One person's skeleton for the kernels of `cabinpose._native.body`, which pose it; axes, signs and orders are those of `rig`."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from cabinpose._native import body as native
from cabinpose.core import Floats, Ints
from cabinpose.scene.body.rig import N_MAIN


class RestArrays(NamedTuple):
    """One person's skeleton at rest, packed for the kernels (float64, m, rad).

    Mesh axes are those of the root in the zero pose, its origin the root's.
    """

    offsets: Floats  # (23, 3) a main bone's origin in its parent's frame
    frames: Floats  # (23, 3, 3) mesh_from_bone rotation of the mesh at rest
    heads: Floats  # (73, 3) origins of all bones in the mesh at rest
    joint_bone: Ints  # (20,) the main bone that carries a joint
    joint_offset: Floats  # (20, 3) the joint in that bone's frame
    palms: Floats  # (2, 4, 4) hand_from_palm, left and right
    soles: Floats  # (2, 4, 4) foot_from_sole
    pronation: Floats  # (2,) elbow.pronation of the mesh at rest
    finger_axes: Floats  # (30, 3) axis of curl in mesh axes
    finger_curl: Floats  # (30,) rad at grip 1


def main_frames(q: Floats, rest: RestArrays, vehicle_from_root: Floats) -> tuple[Floats, Floats]:
    """Frames of the main bones in the vehicle frame: rotation (23, 3, 3) and position (23, 3) m. Limits are not applied.

    q: (D,) rad in the order of `rig.DOFS` · vehicle_from_root: (4, 4).
    """
    rotation, position = np.empty((N_MAIN, 3, 3)), np.empty((N_MAIN, 3))
    native.bone_frames(q, rest, vehicle_from_root, rotation, position)
    return rotation, position

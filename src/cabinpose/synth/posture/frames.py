"""Where the bones of a posture are."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from cabinpose._native import body as native
from cabinpose.core import Floats
from cabinpose.scene.body import BONE_INDEX, RestArrays, main_frames


class Frames(NamedTuple):
    """The skeleton in the vehicle frame: rotation (23, 3, 3) and position (23, 3) of the main bones, palms, soles (2, 4, 4)."""

    rotation: Floats
    position: Floats
    palms: Floats
    soles: Floats

    def bone(self, name: str) -> Floats:
        """vehicle_from_bone (4, 4)."""
        b = BONE_INDEX[name]
        result = np.eye(4)
        result[:3, :3], result[:3, 3] = self.rotation[b], self.position[b]
        return result


def frames(q: Floats, rest: RestArrays, vehicle_from_root: Floats) -> Frames:
    """Forward kinematics of a posture q (D,) rad."""
    rotation, position = main_frames(q, rest, vehicle_from_root)
    palms, soles = np.empty((2, 4, 4)), np.empty((2, 4, 4))
    native.end_frames(rest, rotation, position, palms=palms, soles=soles)
    return Frames(rotation, position, palms, soles)

"""Body dimensions measured on a mesh, as an anthropometrist takes them on a person: `measure`.

Sitting ones are taken with the trunk upright and hips, knees and elbows at right angles. A mesh has no bones under its skin, and
no seat presses it flat: `populations.DIMENSIONS` says what stands for each landmark.
"""

from __future__ import annotations

from functools import cache
from types import MappingProxyType
from typing import NamedTuple

import numpy as np

from cabinpose._native import body as native
from cabinpose.core import Bytes, Floats, Floats32, Ints, axis_rotation
from cabinpose.core import reproducible as rp
from cabinpose.scene.body.chart import load_chart
from cabinpose.scene.body.kinematics import RestArrays, main_frames
from cabinpose.scene.body.rig import BONE_INDEX, BONES, DOF_INDEX, DOFS
from cabinpose.scene.body.shape import load_shape_space

# The acromion from the shoulder joint, outwards and up: the joints are 0.88 of the biacromial breadth apart (`anatomy`), and lie
# 34.5 mm below (de Leva 1996). The radiale is 15.5 mm below the elbow joint (de Leva). Of a person of 1.75 m; shares of stature.
_ACROMION, _RADIALE = (0.025 / 1.75, 0.0345 / 1.75), 0.0155 / 1.75
# Who sits erect has 15 deg less of lumbar lordosis than who stands (Lord 1997): the pelvis leans back by as much. A seat presses
# flat what is below the seat bones; here nothing does, by so much (share of stature, assumed: it is what is left over dummies').
_LEANS_RAD, _NOT_PRESSED = np.radians(15.0), 0.02
_ABOVE_BROWS_M, _ABOVE_EARS_M = (0.025, 0.075), 0.037  # above the eyes of the average adult
# How far the upper arms are from the trunk (assumed): at half their length, of this radius, flesh yields by so much; at 1.75 m.
_BELOW_SHOULDER_M, _ARM_RADIUS_M, _FLESH_YIELDS_M, _FARTHEST_APART = 0.15, 0.049, 0.025, 0.4
_DIRECTIONS = 36  # in which the head's breadth is measured: Cauchy's formula for the hull's circumference


class MeasuredRows(NamedTuple):
    """The vertices that matter, and where in them each region's stand."""

    vertex: Ints
    bone_index: Bytes
    bone_weight: Floats32
    region: MappingProxyType[str, Ints]


@cache
def measured_rows() -> MeasuredRows:
    """Of the packaged topology; once per process."""
    c, space = load_chart(), load_shape_space()
    left, eyes = c.side >= 0, (c.heads["leye"] + c.heads["reye"]) / 2
    height, head = c.rest[:, 2] - eyes[2], c.head > 0.99
    on_leg = c.leg > 0.5
    sat_on = (c.arm < 0.5) & (c.up < 0.16) & (~on_leg | (c.along_leg < 0.6))
    regions = {
        "trunk": (c.arm < 0.15) & ~on_leg & (c.up > 0.5) & (c.up < 0.62),
        "top": head & (height > 0.08),
        "soles": on_leg & (c.along_leg > 2.6),
        "sat_on": sat_on,
        "knee": on_leg & left & (c.along_leg > 0.93) & (c.along_leg < 1.05) & (c.rest[:, 0] > c.heads["llowerleg01"][0]),
        "foot": on_leg & left & (c.along_leg > 2.0),
        "upper_arms": (c.arm > 0.3) & (c.along_arm < 0.6),
        "hand": (c.arm > 0.5) & left & (c.along_arm > 2.0),
        "brows": head & (height > _ABOVE_BROWS_M[0]) & (height < _ABOVE_BROWS_M[1]),
        "skull": head & (height > _ABOVE_EARS_M),
    }
    vertex = np.flatnonzero(np.any(list(regions.values()), axis=0))
    at = {name: np.flatnonzero(mask[vertex]) for name, mask in regions.items()}
    return MeasuredRows(vertex, space.bone_index[vertex], space.bone_weight[vertex], MappingProxyType(at))


def sitting_posture(skin: Floats32, rest: RestArrays, stature_m: float) -> Floats:
    """Joint angles (D,) of who is measured sitting: the arms hang as near to the trunk as its flesh lets them.

    skin: as in `measure`.
    """
    q = np.zeros(len(DOFS))
    size = stature_m / 1.75
    trunk = float(abs(skin[measured_rows().region["trunk"], 1]).max())
    shoulder = float(rest.heads[BONE_INDEX["lupperarm"], 1])
    apart = (trunk + (_ARM_RADIUS_M - _FLESH_YIELDS_M) * size - shoulder) / (_BELOW_SHOULDER_M * size)
    for side in "lr":
        for axis in ("hip.flexion", "knee.flexion", "elbow.flexion"):
            q[DOF_INDEX[f"{side}{axis}"]] = np.pi / 2
        q[DOF_INDEX[f"{side}hip.flexion"]] -= _LEANS_RAD
        q[DOF_INDEX[f"{side}shoulder.abduction"]] = rp.arcsin(min(max(apart, 0.0), _FARTHEST_APART))
    q[DOF_INDEX["lumbar.flexion"]] = _LEANS_RAD
    return q


def measure(skin: Floats32, rest: RestArrays) -> Floats:
    """Stature standing upright, then the dimensions in the order of `DIMENSIONS`, m.

    skin: (R, 3) at rest, root axes, m: the vertices of `measured_rows` alone.
    """
    rows = measured_rows()
    region, bare = rows.region, np.ascontiguousarray(skin)[None]

    def posed(q: Floats, root: Floats) -> tuple[Floats, Floats]:
        transforms, out = np.empty((len(BONES), 3, 4)), np.empty_like(bare)
        frames = main_frames(q, rest, root)
        native.skin_transforms(q, rest, *frames, transforms)
        native.skin_layers(transforms, rows.bone_index, rows.bone_weight, bare, out)
        return out[0].astype(np.float64), frames[1]

    stand, bones = posed(np.zeros(len(DOFS)), np.eye(4))
    stature = float(stand[region["top"], 2].max() - stand[region["soles"], 2].min())
    leaning = np.eye(4)
    leaning[:3, :3] = axis_rotation("y", -_LEANS_RAD)
    sit, _ = posed(sitting_posture(skin, rest, stature), leaning)
    outwards, up = (share * stature for share in _ACROMION)
    shoulder, elbow, wrist = (bones[BONE_INDEX[name]] for name in ("lupperarm", "lforearm", "lhand"))
    hand = stand[region["hand"]] - wrist
    knee, seat, head = sit[region["knee"]], sit[region["sat_on"]], sit[region["brows"]]
    turn = np.arange(_DIRECTIONS) * (np.pi / _DIRECTIONS)
    across = rp.matmul(head[:, :2], np.stack([rp.cos(turn), rp.sin(turn)]))
    return np.array(
        [
            stature,
            sit[region["top"], 2].max() - seat[:, 2].min() - _NOT_PRESSED * stature,
            knee[:, 0].max() - seat[:, 0].min(),
            knee[:, 2].max() - sit[region["foot"], 2].min(),
            2.0 * (shoulder[1] + outwards),
            np.ptp(sit[region["upper_arms"], 1]),
            np.ptp(seat[:, 1]),
            rp.norm(shoulder + (0.0, outwards, up) - elbow) + _RADIALE * stature,
            rp.norm(elbow - wrist),
            np.sqrt((hand * hand).sum(axis=1).max()),
            np.ptp(stand[region["foot"], 0]),
            np.ptp(sit[region["skull"], 1]),
            rp.matmul(np.ptp(across, axis=0), np.full(_DIRECTIONS, np.pi / _DIRECTIONS)),
        ],
        np.float64,
    )

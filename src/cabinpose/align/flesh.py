"""The flesh about the suit's segments: the packaged body's bare skin, made to the suit's lengths and carried by its segments."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from cabinpose._native import body as native
from cabinpose.align.suit import CARRIER, POINTS
from cabinpose.core import CABINPOSE, MVN_SEGMENTS, Matrix
from cabinpose.scene.body import BONES, DOF_INDEX, DOFS, BodyModel, Phenotype

F64 = NDArray[np.float64]
Ints = NDArray[np.int64]

# Regions, each with a thickness of flesh and clothes of its own; to the last one nothing is fitted: hair, caps, collars.
REGIONS: Final = ("belly", "chest", "shoulders", "upper arms", "forearms", "hands", "thighs", "shins", "feet", "head and neck")
_REGION_OF: Final = {
    "Pelvis": 0, "L5": 0, "L3": 0, "T12": 1, "T8": 1, "Shoulder": 2, "UpperArm": 3, "Forearm": 4, "Hand": 5, "UpperLeg": 6,
    "LowerLeg": 7, "Foot": 8, "Toe": 8, "Neck": 9, "Head": 9,
}  # fmt: skip
# Bones by the segment that they turn with, of the trunk, and of a side's limbs by the beginning of their names.
_TRUNK: Final = {
    "pelvis": "Pelvis", "spine04": "L5", "spine03": "L3", "spine02": "T12", "spine01": "T8", "neck01": "Neck", "neck02": "Neck",
    "neck03": "Neck", "head": "Head",
}  # fmt: skip
_LIMBS: Final = {
    "clavicle": "Shoulder", "scapula": "Shoulder", "shoulder": "UpperArm", "upperarm": "UpperArm", "elbow": "Forearm",
    "forearm": "Forearm", "wrist": "Hand", "hand": "Hand", "finger": "Hand", "hip": "UpperLeg", "thigh": "UpperLeg",
    "knee": "LowerLeg", "shank": "LowerLeg", "ankle": "Foot", "foot": "Foot",
}  # fmt: skip
_JOINT_ORIGINS: Final = {"L5": "hip", "Neck": "neck", "LeftToe": "lfoot", "RightToe": "rfoot"}  # others begin where a bone does
_CELL_M: Final = 0.025  # of the vertices one in each such cube is kept
_STATURE_M: Final = 1.7


def _segment_of(bone: str) -> int:
    """The suit's segment with which a bone of the packaged body turns."""
    if bone in _TRUNK:
        return MVN_SEGMENTS.index(_TRUNK[bone])
    limb = next(name for start, name in _LIMBS.items() if bone[1:].startswith(start))
    return MVN_SEGMENTS.index({"l": "Left", "r": "Right"}[bone[0]] + limb)


def _region_of(segment: str) -> int:
    return next(number for name, number in _REGION_OF.items() if segment.removeprefix("Left").removeprefix("Right") == name)


_SEGMENT_OF = np.array([_segment_of(bone) for bone in BONES])
_REGIONS = np.array([_region_of(segment) for segment in MVN_SEGMENTS])
# Segments of the limbs and the point at their far end: flesh is stretched along them.
_FAR: Final = {
    int(carrier): point
    for point, carrier in enumerate(CARRIER)
    if carrier >= 0 and POINTS[carrier].endswith(("UpperArm", "Forearm", "UpperLeg", "LowerLeg"))
}


class _TPose(NamedTuple):
    """The adult in the T-pose: points (25, 3), skin (V, 3), normals (V, 3), shares (V, 23) of the segments that carry each."""

    points: F64
    skin: F64
    normals: F64
    weights: F64


@cache
def _t_pose() -> _TPose:
    """An adult between man and woman, of medium build, 1.7 m tall, without the skin of fingers, which bend as they like."""
    person = BodyModel.load().person(Phenotype(muscle=0.4, weight=0.65, height=0.45, stature_m=_STATURE_M))
    q = np.zeros(len(DOFS))
    for side in "lr":
        q[DOF_INDEX[side + "shoulder.abduction"]] = np.pi / 2
    posed = person.pose(q, np.eye(4))
    first = {int(segment): bone for bone, segment in reversed(list(enumerate(_SEGMENT_OF)))}
    origins = np.array([posed.bones[first.get(s, 0), :3, 3] for s in range(len(MVN_SEGMENTS))])
    for segment, joint in _JOINT_ORIGINS.items():
        origins[MVN_SEGMENTS.index(segment)] = posed.joints[CABINPOSE.index[joint]]
    points = np.concatenate((origins, posed.joints[CABINPOSE.indices(["lhand", "rhand"])]))

    skin, normals = posed.skin.astype(np.float64), np.empty_like(posed.skin)
    native.vertex_normals(posed.skin, person.skin_faces, normals)
    bones, shares, _ = person.skin_weights(np.arange(len(skin)))
    weights = np.zeros((len(skin), len(MVN_SEGMENTS)))
    for bone, share in zip(bones.T, shares.T, strict=True):
        np.add.at(weights, (np.arange(len(skin)), _SEGMENT_OF[bone]), share)
    finger = np.array(["finger" in bone for bone in BONES])
    chosen = np.flatnonzero((shares * finger[bones]).sum(axis=1) < 0.5)
    _, one = np.unique(np.floor(skin[chosen] / _CELL_M), axis=0, return_index=True)
    rows = chosen[one]
    return _TPose(points, skin[rows], normals[rows].astype(np.float64), weights[rows])


@dataclass(frozen=True, eq=False)
class Flesh:
    """Skin of somebody in a suit, V points.

    local (V, 23, 3): place in the axes of each of MVN's segments, m · normal (V, 3): outwards, in the T-pose · weight (V, 23):
    share of each segment in carrying the point · region (V,): of `REGIONS`.
    """

    local: F64
    normal: F64
    weight: F64
    region: Ints

    def posed(self, turns: F64, origins: F64) -> tuple[F64, F64]:
        """Places and outward normals (V, 3) of the skin for segments turned by `turns` (23, 3, 3), at `origins` (23, 3) m."""
        carried = origins + np.einsum("sij,vsj->vsi", turns, self.local)
        places = np.einsum("vs,vsi->vi", self.weight, carried)
        blended = (self.weight @ turns.reshape(-1, 9)).reshape(-1, 3, 3)
        normals = np.einsum("vij,vj->vi", blended, self.normal)
        return places, normals / np.linalg.norm(normals, axis=1)[:, None]


def flesh_of(points: Matrix) -> Flesh:
    """The flesh of somebody whose suit says so of its points (T, 25, 4, 4).

    An adult of medium build and of the size that the limbs' lengths say, each limb stretched to its own. Who wears the suit is
    thinner or fatter and wears clothes: by how much is for the fit to find, by region.
    """
    body = _t_pose()
    places = points[..., :3, 3]
    long = {s: float(np.linalg.norm(places[:, far] - places[:, s], axis=1).mean()) for s, far in _FAR.items()}
    drawn = {s: float(np.linalg.norm(body.points[far] - body.points[s])) for s, far in _FAR.items()}
    size = sum(long.values()) / sum(drawn.values())
    local = size * (body.skin[:, None] - body.points[None, : len(MVN_SEGMENTS)])
    for s, far in _FAR.items():
        along = (body.points[far] - body.points[s]) / drawn[s]
        reach = np.clip(local[:, s] @ along, 0.0, size * drawn[s])
        local[:, s] += ((long[s] / (size * drawn[s]) - 1.0) * reach)[:, None] * along
    return Flesh(local, body.normals, body.weights, _REGIONS[body.weights.argmax(axis=1)])

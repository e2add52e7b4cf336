"""A person as a few hundred points of the skin with normals, solid by solid: what clearance is solved with."""

from __future__ import annotations

from functools import cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from cabinpose._native import body as native
from cabinpose.scene.body import SEGMENTS, Person
from cabinpose.scene.body.chart import load_chart, vertex_segments
from cabinpose.scene.body.rig import BONE_INDEX, BONES, MAIN_BONES
from cabinpose.scene.body.shape import load_shape_space
from cabinpose.scene.contact.pairs import SOLID_OF_SEGMENT, SOLIDS
from cabinpose.synth.posture.memory import kept_with_person

Array = NDArray[np.float64]

# Points of each solid: the median way to the next one is 24 to 28 mm on hands, forearms and feet, up to 54 mm elsewhere.
_COUNTS = {"torso": 192, "head": 40, "upper_arm": 64, "forearm": 64, "hand": 40, "thigh": 96, "shin": 56, "foot": 72}
_MAIN_OF_HELPER = {
    "scapula": "clavicle", "shoulder_half": "upperarm", "upperarm_twist": "upperarm", "elbow_half": "forearm",
    "forearm_near": "forearm", "forearm_far": "forearm", "wrist_half": "hand", "hip_half": "thigh", "thigh_twist": "thigh",
    "knee_half": "shank", "ankle_half": "foot",
}  # fmt: skip


class Samples(NamedTuple):
    """Points of a person's skin for the solver, S solids in the order of `SOLIDS`.

    rest, normal: (N, 3) of the mesh at rest, m, outward · skin_index, skin_weight: (N, K) · bone: (N,) the main bone that moves a
    point most · rows: (S, 2) first and last-but-one of each solid, whose
    first quarter lies all over it: no sample is farther than `cover` (S,) m from one of these.
    """

    rest: Array
    normal: Array
    skin_index: NDArray[np.uint8]
    skin_weight: NDArray[np.float32]
    bone: NDArray[np.int32]
    rows: NDArray[np.int64]
    cover: Array


def _main_bone(bone: int) -> int:
    name = BONES[bone]
    if name in MAIN_BONES:
        return bone
    side, stem = name[0], name[1:]
    return BONE_INDEX[side + _MAIN_OF_HELPER.get(stem, "hand")]  # the rest are fingers


def spread(points: Array, count: int) -> NDArray[np.int64]:
    """Numbers of `count` of the points (N, 3) that lie far from each other: each next one furthest from those before it."""
    chosen = [int(np.argmax(points[:, 0]))]
    distance = np.full(len(points), np.inf)
    for _ in range(count - 1):
        distance = np.minimum(distance, ((points - points[chosen[-1]]) ** 2).sum(axis=1))
        chosen.append(int(np.argmax(distance)))
    return np.array(chosen)


@cache
def _vertices() -> tuple[NDArray[np.int64], NDArray[np.int32], NDArray[np.int64]]:
    """Vertices (N,), the main bone of each, and the rows of each solid; the same for everybody."""
    rest, segment, space = load_chart().rest, vertex_segments(), load_shape_space()
    chosen = []
    for solid in SOLIDS:
        own = np.flatnonzero(np.isin(segment, [i for i, name in enumerate(SEGMENTS) if SOLID_OF_SEGMENT[name] == solid]))
        count = _COUNTS.get(solid) or _COUNTS[solid[1:]]
        chosen.append(own[spread(rest[own], count)])
    vertices, ends = np.concatenate(chosen), np.cumsum([len(rows) for rows in chosen])
    bone = np.array([_main_bone(int(b)) for b in space.bone_index[vertices, 0]], np.int32)
    return vertices, bone, np.stack((np.concatenate(([0], ends[:-1])), ends), axis=1)


def _cover(points: Array) -> float:
    """How far the points (N, 3) are from the nearest of their first quarter, at most, with a reserve for bending."""
    first = points[: (len(points) + 3) // 4]
    return 1.2 * float(np.sqrt(((points[:, None] - first) ** 2).sum(axis=2).min(axis=1).max()))


@kept_with_person
def samples_of(person: Person) -> Samples:
    """The samples of a person."""
    vertices, bone, rows = _vertices()
    space = load_shape_space()
    normals = np.empty_like(person.rest_skin)
    native.vertex_normals(person.rest_skin, person.skin_faces, normals)
    rest = person.rest_skin[vertices].astype(np.float64)
    return Samples(
        rest, normals[vertices].astype(np.float64), space.bone_index[vertices],
        space.bone_weight[vertices], bone, rows,
        np.array([_cover(rest[first:end]) for first, end in rows]),
    )  # fmt: skip

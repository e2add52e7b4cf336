"""A person as about a thousand points of the skin with normals, solid by solid: what clearance is solved with."""

from __future__ import annotations

from functools import cache
from typing import NamedTuple

import numpy as np

from cabinpose._native import body as native
from cabinpose.core import Bytes, Floats, Floats32, Ints, Ints32
from cabinpose.scene.body import BONE_INDEX, BONES, MAIN_BONES, SEGMENTS, Person, load_chart, load_shape_space, vertex_segments
from cabinpose.scene.contact import SOLID_OF_SEGMENT, SOLIDS
from cabinpose.synth.posture.memory import kept_with_person

# Points of each solid: the median way to the next one is 24 to 28 mm on hands, forearms and feet, up to 54 mm elsewhere.
_COUNTS = {"torso": 192, "head": 40, "upper_arm": 64, "forearm": 64, "hand": 40, "thigh": 96, "shin": 56, "foot": 72}
_BENDING = 1.2  # by which samples may move apart from those at rest
_MAIN_OF_HELPER = {
    "scapula": "clavicle", "shoulder_half": "upperarm", "upperarm_twist": "upperarm", "elbow_half": "forearm",
    "forearm_near": "forearm", "forearm_far": "forearm", "wrist_half": "hand", "hip_half": "thigh", "thigh_twist": "thigh",
    "knee_half": "shank", "ankle_half": "foot",
}  # fmt: skip


class Samples(NamedTuple):
    """Points of a person's skin for the solver, S solids in the order of `SOLIDS`.

    rest, normal: (N, 3) of the mesh at rest, m, outward · skin_index, skin_weight: (N, K) · bone: (N,) the main bone that moves a
    point most · rows: (S, 2) first and last-but-one of each solid, whose first quarter lies all over it · around, reach: (N, 2)
    and (N,) m, of these: from and before which sample the others are nearest to it, and how far the farthest is.
    """

    rest: Floats
    normal: Floats
    skin_index: Bytes
    skin_weight: Floats32
    bone: Ints32
    rows: Ints
    around: Ints
    reach: Floats


def _main_bone(bone: int) -> int:
    name = BONES[bone]
    if name in MAIN_BONES:
        return bone
    side, stem = name[0], name[1:]
    return BONE_INDEX[side + _MAIN_OF_HELPER.get(stem, "hand")]  # the rest are fingers


def spread(points: Floats, count: int) -> Ints:
    """Numbers of `count` of the points (N, 3) that lie far from each other: each next one furthest from those before it."""
    chosen = [int(np.argmax(points[:, 0]))]
    distance = np.full(len(points), np.inf)
    for _ in range(count - 1):
        distance = np.minimum(distance, ((points - points[chosen[-1]]) ** 2).sum(axis=1))
        chosen.append(int(np.argmax(distance)))
    return np.array(chosen)


class _Chosen(NamedTuple):
    """What is the same for everybody: vertices (N,), and bone, rows and around of `Samples`."""

    vertices: Ints
    bone: Ints32
    rows: Ints
    around: Ints


@cache
def _chosen() -> _Chosen:
    rest, segment, space = load_chart().rest, vertex_segments(), load_shape_space()
    chosen, around, total = [], [], 0
    for solid in SOLIDS:
        own = np.flatnonzero(np.isin(segment, [i for i, name in enumerate(SEGMENTS) if SOLID_OF_SEGMENT[name] == solid]))
        count = _COUNTS.get(solid) or _COUNTS[solid[1:]]
        mine = own[spread(rest[own], count)]
        heads = (count + 3) // 4
        others = mine[heads:]
        of = ((rest[others][:, None] - rest[mine[:heads]]) ** 2).sum(axis=2).argmin(axis=1)
        chosen.append(np.concatenate((mine[:heads], others[np.argsort(of, kind="stable")])))
        ends = total + heads + np.cumsum(np.bincount(of, minlength=heads))
        rows = np.full((count, 2), total, np.int64)  # nothing is around the others
        rows[:heads] = np.stack((ends - np.bincount(of, minlength=heads), ends), axis=1)
        around.append(rows)
        total += count
    vertices, ends = np.concatenate(chosen), np.cumsum([len(rows) for rows in chosen])
    bone = np.array([_main_bone(int(b)) for b in space.bone_index[vertices, 0]], np.int32)
    return _Chosen(vertices, bone, np.stack((np.concatenate(([0], ends[:-1])), ends), axis=1), np.concatenate(around))


@kept_with_person
def samples_of(person: Person) -> Samples:
    """The samples of a person."""
    chosen, space = _chosen(), load_shape_space()
    normals = np.empty_like(person.rest_skin)
    native.vertex_normals(person.rest_skin, person.skin_faces, normals)
    rest = person.rest_skin[chosen.vertices].astype(np.float64)
    reach = np.zeros(len(rest))
    for head in np.flatnonzero(chosen.around[:, 1] > chosen.around[:, 0]):
        first, end = chosen.around[head]
        reach[head] = _BENDING * np.linalg.norm(rest[first:end] - rest[head], axis=1).max()
    return Samples(
        rest, normals[chosen.vertices].astype(np.float64), space.bone_index[chosen.vertices],
        space.bone_weight[chosen.vertices], chosen.bone, chosen.rows, chosen.around, reach,
    )  # fmt: skip

"""The surface that the camera sees: dressed skin and accessories in one mesh at rest."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from typing import NamedTuple

import numpy as np

from cabinpose.core import Bools, Bytes, Floats, Floats32, Ints, Ints32
from cabinpose.scene import labels, materials
from cabinpose.scene.body.accessories import accessories, foot_faces_hidden, head_box
from cabinpose.scene.body.faces import Eyes, FaceMesh, FaceRig, ball, close_lips, mouth_faces
from cabinpose.scene.body.garments import Bend, layer
from cabinpose.scene.body.kinematics import RestArrays
from cabinpose.scene.body.outfit import Outfit
from cabinpose.scene.body.parts import cut_skin
from cabinpose.scene.body.rig import BONE_INDEX, DOF_INDEX
from cabinpose.scene.body.shape import ShapeSpace
from cabinpose.scene.body.sheets import PLACES, Accessory
from cabinpose.scene.body.wardrobe import draped

_SEATED_RAD = 1.2  # flexion of the hips from which on cloth lies on the thighs (assumed)


@dataclass(frozen=True)
class Dressed:
    """What the camera sees at rest: `rest` (N, 3) m are the dressed skin's vertices that a face uses, then accessories'.

    bone_index, bone_weight: (N, 8) · faces: (F, 3) · label, material: (F,) uint8 · worn: (F,) index in `PLACES` ·
    is_lip: (F,) whether it is of the lips · face_rig: what moves in the face.
    """

    rest: Floats32
    bone_index: Bytes
    bone_weight: Floats32
    faces: Ints32
    label: Bytes
    material: Bytes
    worn: Bytes
    is_lip: Bools
    face_rig: FaceRig
    bends: tuple[Bend, ...]

    def bent(self, q: Floats) -> Floats32:
        """`rest` with the folds of a posture q (D,) rad, a copy."""
        rest = self.rest.copy()
        for bend in self.bends:
            share = min(max(float(q[DOF_INDEX[bend.dof]]) / bend.full_rad, 0.0), 1.0)
            rest[bend.rows] += bend.offsets * np.float32(share)
        return rest


class _Seen(NamedTuple):
    """What is seen of the cut skin: its faces, the vertices that they use, with bones, and the faces in numbers of these."""

    face: Ints
    vertex: Ints
    faces: Ints32
    bone_index: Bytes
    bone_weight: Floats32


@cache
def _seen(*, shod: bool) -> _Seen:
    """Of bare feet or of feet in shoes."""
    cut = cut_skin()
    face = np.flatnonzero(~foot_faces_hidden()[cut.source]) if shod else np.arange(len(cut.faces))
    vertex, faces = np.unique(cut.faces[face], return_inverse=True)
    return _Seen(
        face, vertex.astype(np.int64), faces.reshape(-1, 3).astype(np.int32), cut.bone_index[vertex], cut.bone_weight[vertex]
    )  # fmt: skip


@cache
def _face_mesh(*, shod: bool) -> FaceMesh:
    return FaceMesh.of(_seen(shod=shod).vertex)


def _eyeballs(eyes: Eyes) -> Accessory:
    vertices, faces, material = ball()
    both = np.concatenate([faces, faces + np.int32(len(vertices))])
    label = np.repeat([labels.LABEL_ID["head_left"], labels.LABEL_ID["head_right"]], len(faces)).astype(np.uint8)
    return Accessory(
        eyes.balls().reshape(-1, 3), both, ("head",), np.ones((2 * len(vertices), 1)), label,
        np.tile(np.array([materials.MATERIAL_ID[name] for name in material], np.uint8), 2),
    )  # fmt: skip


def dress(space: ShapeSpace, skin: Floats32, rest: RestArrays, eye_centres: Floats, outfit: Outfit, size: float) -> Dressed:
    """The outfit on a person's skin (V, 3) at rest, root axes.

    eye_centres: (2, 3) m, left and right · size: stature over the average adult's.
    """
    clothes = layer(skin, rest, outfit, size)
    cut = cut_skin()
    label = cut.label.copy()
    material = np.full(len(label), materials.MATERIAL_ID["skin"], np.uint8)
    place = np.zeros(len(label), np.uint8)
    for region in clothes.regions:
        material[region.faces] = materials.MATERIAL_ID[region.of.material]
        place[region.faces] = PLACES.index(region.of.coat)
        if region.of.label:
            label[region.faces] = labels.LABEL_ID[region.of.label]
    material[mouth_faces()], place[mouth_faces()] = materials.MATERIAL_ID["mouth"], PLACES.index("")
    shod = outfit.shoes != "none"
    seen, eyes = _seen(shod=shod), Eyes.of(skin, eye_centres)
    surface = clothes.vertices[seen.vertex]
    eyes.make_sockets(surface, seen.vertex)
    close_lips(surface, seen.vertex)
    vertices, index, weight = [surface], [seen.bone_index], [seen.bone_weight]
    all_faces, all_labels, all_materials, all_worn = [seen.faces], [label[seen.face]], [material[seen.face]], [place[seen.face]]
    count, bends = len(seen.vertex), list(_numbered(clothes.bends, seen.vertex))
    middle, bare = eye_centres.mean(axis=0), skin.astype(np.float64)
    of_cloth = draped(clothes.vertices, clothes.bare, rest, middle, head_box(bare, middle), outfit)
    for part in (_eyeballs(eyes), *accessories(bare, rest, middle, outfit), *of_cloth):
        rows = np.zeros((len(part.vertices), space.bone_index.shape[1]), np.uint8)
        shares = np.zeros(rows.shape, np.float32)
        order = np.argsort(-part.weights, axis=1, kind="stable")[:, : rows.shape[1]]
        bones = np.array([BONE_INDEX[b] for b in part.bones], np.uint8)
        most = np.take_along_axis(part.weights, order, axis=1)
        rows[:, : order.shape[1]] = bones[order]
        shares[:, : order.shape[1]] = most / most.sum(axis=1, keepdims=True)
        vertices.append(part.vertices.astype(np.float32))
        index.append(rows)
        weight.append(shares)
        all_faces.append(part.faces + np.int32(count))
        all_labels.append(part.label)
        all_materials.append(part.material)
        all_worn.append(np.full(len(part.faces), PLACES.index(part.worn), np.uint8))
        if part.seated is not None:  # half of it by each hip
            rows_of, half = count + np.arange(len(part.vertices)), (0.5 * part.seated).astype(np.float32)
            bends += [Bend(f"{side}hip.flexion", rows_of, half, _SEATED_RAD) for side in "lr"]
        count += len(part.vertices)
    is_lip = np.zeros(sum(map(len, all_faces)), np.bool_)
    is_lip[: len(seen.face)] = cut.inside["lips"][seen.face]
    return Dressed(
        np.concatenate(vertices), np.concatenate(index), np.concatenate(weight), np.concatenate(all_faces),
        np.concatenate(all_labels), np.concatenate(all_materials), np.concatenate(all_worn), is_lip,
        FaceRig(skin, eyes, _face_mesh(shod=shod)), tuple(bends),
    )  # fmt: skip


def _numbered(bends: tuple[Bend, ...], vertex: Ints) -> tuple[Bend, ...]:
    """The same with the numbers that the seen vertices (n,) have among those that are used."""
    number = np.full(int(max(vertex.max(), *(bend.rows.max(initial=0) for bend in bends))) + 1, -1)
    number[vertex] = np.arange(len(vertex))
    return tuple(b._replace(rows=number[b.rows][used], offsets=b.offsets[used]) for b in bends for used in (number[b.rows] >= 0,))

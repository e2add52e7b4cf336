"""How each joint is seen: the five states of `core.pose.Visibility`, decided on the ray through the joint.

A joint lies inside its body, so it is never the first thing on its ray. It counts as visible where the first thing is the
skin or clothing of the joint's own part, close to the joint. In full, for joint j of a person with instance number k:

- ABSENT: no position (NaN).
- OUTSIDE_IMAGE: at or behind the camera plane, or projected outside the image.
- Otherwise take the first surface h on the ray from the camera through j, beyond `NEAR_M` and nearer than j, leaving out
  what the eye passes over: transmissive materials (glass, spectacle lenses) and seat belts, which are 5 cm wide and lie on
  their wearer as clothing does. Then
  - no such h, or h of instance k, of a label in `OWN_PARTS[j]` and at most `REACH_M[j]` from j: VISIBLE;
  - any other h of instance k: SELF_OCCLUDED;
  - h of another person or of nobody (seat, wheel, trim): OCCLUDED.

Clothing, hair and headwear carry the instance of their wearer; clothing carries the label of the part under it. The
distance rules out a joint seen along its own limb, such as a knee behind the length of its own thigh.
The ray is exact (no pixel grid), so the answer does not depend on the resolution.
"""

from __future__ import annotations

from functools import cache
from types import MappingProxyType

import numpy as np
from numba import njit
from numpy.typing import ArrayLike, NDArray

from cabinpose.core.camera import Camera
from cabinpose.core.frames import Matrix
from cabinpose.core.pose import Visibility
from cabinpose.core.skeleton import JOINTS, REACH_M
from cabinpose.scene.labels import ID as LABEL
from cabinpose.scene.materials import MATERIALS
from cabinpose.scene.surface import Surface
from cabinpose.synth.render.projection import NEAR_M, Lens, project, ray_box, to_camera

_WORN_ON_HEAD = ("hair", "headwear", "glasses")
_SIDED_PARTS = {
    "shoulder": ("shoulder", "upper_arm", "torso"),
    "elbow": ("elbow", "upper_arm", "forearm"),
    "wrist": ("wrist", "forearm", "hand"),
    "hand": ("hand", "wrist"),
    "pelvis": ("hip", "thigh"),
    "knee": ("knee", "thigh", "shin"),
    "ankle": ("ankle", "shin", "foot"),
    "foot": ("foot", "ankle"),
}
_CENTRE_PARTS = {
    "head": ("head_left", "head_right", "neck", *_WORN_ON_HEAD),
    "neck": ("neck", "torso_left", "torso_right", "shoulder_left", "shoulder_right", "hair"),
    "chest": ("torso_left", "torso_right", "hair"),
    "hip": ("hip_left", "hip_right", "hip_center", "torso_left", "torso_right"),
}
_SHARED_PARTS = {"pelvis": ("hip_center",), "shoulder": ("hair",)}


def _own_parts() -> dict[str, tuple[str, ...]]:
    parts = dict(_CENTRE_PARTS)
    for letter, side in (("l", "left"), ("r", "right")):
        for joint, names in _SIDED_PARTS.items():
            parts[letter + joint] = tuple(f"{name}_{side}" for name in names) + _SHARED_PARTS.get(joint, ())
    return {joint: parts[joint] for joint in JOINTS}


# The labels whose surface is the joint's own: its part and the two that meet there.
OWN_PARTS = MappingProxyType(_own_parts())

_TILES = 64  # the index of rays: tiles a side
_SLACK = 1e-5  # ideal coordinates around the rays, so that each lies inside a tile


@cache
def visibility_tables() -> tuple[NDArray[np.bool_], NDArray[np.float64], NDArray[np.bool_], NDArray[np.bool_]]:
    """(own (20, 256) by joint and label, reach (20,) m, passed-over labels (256,), passed-over materials (256,))."""
    own = np.zeros((len(JOINTS), 256), np.bool_)
    for j, joint in enumerate(JOINTS):
        own[j, [LABEL[name] for name in OWN_PARTS[joint]]] = True
    labels, materials = np.zeros(256, np.bool_), np.zeros(256, np.bool_)
    labels[LABEL["seat_belt"]] = True
    materials[[m.id for m in MATERIALS if m.transmissive]] = True
    return own, np.array([REACH_M[joint] for joint in JOINTS]), labels, materials


def joint_visibility(
    joints_camera: ArrayLike, instances: ArrayLike, surface: Surface, camera_from_vehicle: Matrix, camera: Camera
) -> NDArray[np.uint8]:
    """States (P, 20) of the joints (P, 20, 3) m, camera frame, of the persons with instance numbers (P,).

    surface: everything in the scene, vehicle frame, the one that was rendered.
    """
    joints = np.asarray(joints_camera, dtype=np.float64)
    flat = joints.reshape(-1, 3)
    state = np.full(len(flat), Visibility.OUTSIDE_IMAGE, np.uint8)
    present = np.isfinite(flat).all(axis=1)
    state[~present] = Visibility.ABSENT
    inside = present & _in_image(flat, camera)
    rays = np.flatnonzero(inside)
    if len(rays):
        own, reach, labels, materials = visibility_tables()
        p_camera = np.empty((len(surface.vertices), 3), np.float32)
        to_camera(surface.vertices, np.ascontiguousarray(camera_from_vehicle, dtype=np.float64), p_camera)
        hit_z, hit_face = _first_hits(
            flat[rays], p_camera, surface.faces.view(np.uint32), surface.label, surface.material, labels, materials
        )
        hit = hit_face >= 0
        face = np.where(hit, hit_face, 0)
        joint = rays % joints.shape[-2]
        distance = np.linalg.norm(flat[rays], axis=1) * (1 - hit_z / flat[rays, 2])
        same = surface.instance[face] == np.repeat(np.asarray(instances), joints.shape[-2])[rays]
        near_own = own[joint, surface.label[face]] & (distance <= reach[joint])
        state[rays] = np.select(
            [~hit | (same & near_own), same], [Visibility.VISIBLE, Visibility.SELF_OCCLUDED], Visibility.OCCLUDED
        )
    return state.reshape(joints.shape[:-1])


def _in_image(p_camera: NDArray[np.float64], camera: Camera) -> NDArray[np.bool_]:
    """Whether points (n, 3) project into the image.

    A distorting lens must also be able to see them: beyond the rays of the image its polynomial may fold back into it.
    """
    with np.errstate(invalid="ignore"):
        inside = (p_camera[:, 2] > 0) & camera.contains(camera.project(p_camera))
        if camera.is_distorted:
            box = ray_box(camera)
            xy = p_camera[:, :2] / p_camera[:, 2:]
            inside &= ((xy >= box[:2]) & (xy <= box[2:])).all(axis=1)
    return np.asarray(inside)


@njit(cache=True, nogil=True, error_model="numpy")
def _first_hits(
    targets: NDArray[np.float64], p_camera: NDArray[np.float32], faces: NDArray[np.uint32], label: NDArray[np.uint8],
    material: NDArray[np.uint8], passed_labels: NDArray[np.bool_], passed_materials: NDArray[np.bool_],
) -> tuple[NDArray[np.float64], NDArray[np.int64]]:  # fmt: skip
    """Depth z and index of the first face on each segment from the camera to a target (n, 3); -1 where there is none.

    label, material: (F,) · passed_labels, passed_materials: (256,) of what the segments pass through.

    Faces are tested against the rays of the tiles of the image plane that they touch; the test is that of the z-buffer
    (`zbuffer`).
    """
    n = len(targets)
    x, y = targets[:, 0] / targets[:, 2], targets[:, 1] / targets[:, 2]
    box = np.array([x.min() - _SLACK, y.min() - _SLACK, x.max() + _SLACK, y.max() + _SLACK])
    per_x, per_y = _TILES / (box[2] - box[0]), _TILES / (box[3] - box[1])
    tiles = Lens(per_x, per_y, -box[0] * per_x, -box[1] * per_y, np.zeros(5), box, 0.0)  # projects to tiles
    projected, outside = np.empty((len(p_camera), 5), np.float32), np.empty(len(p_camera), np.uint8)
    project(p_camera, tiles, projected, outside)
    words = (n + 63) // 64
    columns, rows = np.zeros((_TILES, words), np.uint64), np.zeros((_TILES, words), np.uint64)
    for i in range(n):
        bit = np.uint64(1) << np.uint64(i % 64)
        columns[int((x[i] - box[0]) * per_x), i // 64] |= bit
        rows[int((y[i] - box[1]) * per_y), i // 64] |= bit
    best, face = np.full(n, np.inf), np.full(n, -1)
    for f in range(len(faces)):
        i0, i1, i2 = faces[f, 0], faces[f, 1], faces[f, 2]
        if outside[i0] & outside[i1] & outside[i2]:
            continue
        c0, c1, r0, r1 = 0, _TILES - 1, 0, _TILES - 1  # cut by the near limit: perhaps everywhere
        if (outside[i0] | outside[i1] | outside[i2]) & 1 == 0:
            # A hundredth of a tile covers float32.
            left = min(projected[i0, 3], projected[i1, 3], projected[i2, 3]) - 0.01
            right = max(projected[i0, 3], projected[i1, 3], projected[i2, 3]) + 0.01
            top = min(projected[i0, 4], projected[i1, 4], projected[i2, 4]) - 0.01
            bottom = max(projected[i0, 4], projected[i1, 4], projected[i2, 4]) + 0.01
            if right < 0.0 or bottom < 0.0:
                continue
            c0, c1 = int(max(left, 0.0)), int(min(right, _TILES - 1.0))
            r0, r1 = int(max(top, 0.0)), int(min(bottom, _TILES - 1.0))
        for word in range(words):
            in_columns, in_rows = np.uint64(0), np.uint64(0)
            for c in range(c0, c1 + 1):
                in_columns |= columns[c, word]
            for r in range(r0, r1 + 1):
                in_rows |= rows[r, word]
            bits = in_columns & in_rows
            if bits and (passed_labels[label[f]] or passed_materials[material[f]]):
                break
            i = word * 64
            while bits:
                if bits & np.uint64(1):
                    z = np.float64(_hit(p_camera, i0, i1, i2, x[i], y[i]))
                    if NEAR_M <= z < targets[i, 2] and z < best[i]:
                        best[i] = z
                        face[i] = f
                bits >>= np.uint64(1)
                i += 1
    return best, face


@njit(cache=True, nogil=True, error_model="numpy")
def _hit(p_camera: NDArray[np.float32], i0: int, i1: int, i2: int, x: float, y: float) -> float:
    """Depth z where the ray (x, y, 1) meets a triangle; 0 where it does not."""
    ax, ay, az = np.float64(p_camera[i0, 0]), np.float64(p_camera[i0, 1]), np.float64(p_camera[i0, 2])
    bx, by, bz = np.float64(p_camera[i1, 0]), np.float64(p_camera[i1, 1]), np.float64(p_camera[i1, 2])
    cx, cy, cz = np.float64(p_camera[i2, 0]), np.float64(p_camera[i2, 1]), np.float64(p_camera[i2, 2])
    e0 = (by * cz - bz * cy) * x + (bz * cx - bx * cz) * y + (bx * cy - by * cx)
    e1 = (cy * az - cz * ay) * x + (cz * ax - cx * az) * y + (cx * ay - cy * ax)
    e2 = (ay * bz - az * by) * x + (az * bx - ax * bz) * y + (ax * by - ay * bx)
    if not ((e0 >= 0.0 and e1 >= 0.0 and e2 >= 0.0) or (e0 <= 0.0 and e1 <= 0.0 and e2 <= 0.0)):
        return 0.0
    total = e0 + e1 + e2
    if total == 0.0:
        return 0.0
    det = ax * (by * cz - bz * cy) + ay * (bz * cx - bx * cz) + az * (bx * cy - by * cx)
    return det / total

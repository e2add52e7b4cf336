"""Gaze and head pose of everybody in a scene, as labels.

The head does a known share of a gaze's yaw and pitch from straight ahead (`posture.gaze.HEAD_SHARE`, after Stahl 1999), the eyes
the rest, as far as they turn: so the gaze follows from the head, as it was solved, and the seat's heading. In sequences it is
that of the head a moment later: the eyes lead. Labelled is where the drawn eyes look (`faces`), and what that meets first.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from cabinpose.core import Floats
from cabinpose.core import reproducible as rp
from cabinpose.scene.body import BONE_INDEX, SEGMENTS
from cabinpose.scene.cabin import STATIC_GROUP
from cabinpose.scene.contact import first_crossings
from cabinpose.synth.posture import FREE_POSES
from cabinpose.synth.posture.gaze import HEAD_SHARE
from cabinpose.synth.scene import Scene, ScenePerson

GAZE_VARIABLES = ("gaze", "gaze_target", "vehicle_from_head")
ASLEEP = frozenset({"sleep", *(name for name, pose in FREE_POSES.items() if pose.asleep)})  # actions in which eyes are closed
_FAR_M = 10.0
_BODY_M = 0.35  # of a person's surface from the nearest joint, at the most
_HANDS = [SEGMENTS.index(side + "hand") for side in "lr"]


def gaze_labels(scene: Scene, slots: tuple[str, ...], *, target: bool) -> dict[str, Any]:
    """The variables `GAZE_VARIABLES` of a frame, by slots (P,).

    gaze: (P, 3) unit vectors of the lines of sight, vehicle frame, NaN where nobody looks · gaze_target: (P,) what they meet
    first: a part of the car, the slot of somebody else, "hand" for an own one, "outside"; "nothing" of who sleeps; not
    looked for, and empty, without `target` ·
    vehicle_from_head: (P, 4, 4), x to the front of the face, y left, origin at C1.
    """
    count = len(slots)
    gaze, heads, targets = np.full((count, 3), np.nan), np.full((count, 4, 4), np.nan), [""] * count
    for person in scene.people:
        row = slots.index(person.slot)
        heads[row] = person.posed.bones[BONE_INDEX["head"]]
        if person.action in ASLEEP:
            targets[row] = "nothing" if target else ""
            continue
        gaze[row] = rp.matmul(heads[row, :3, :3], np.array(person.face.gaze))
        if target:
            targets[row] = _target(scene, person, gaze[row])
    return {"gaze": gaze.astype(np.float32), "gaze_target": targets, "vehicle_from_head": heads}


def line_of_sight(head: Floats, heading: float) -> Floats:
    """(3,) where somebody looks whose head has the rotation (3, 3), and who faces `heading` (rad, + left) when looking ahead."""
    face = head[:, 0]
    yaw = (rp.arctan2(face[1], face[0]) - heading + math.pi) % (2.0 * math.pi) - math.pi
    pitch = rp.arcsin(min(max(float(face[2]), -1.0), 1.0))
    yaw, pitch = heading + yaw / HEAD_SHARE[0], min(max(pitch / HEAD_SHARE[1], -math.pi / 2), math.pi / 2)
    return np.array((rp.cos(yaw) * rp.cos(pitch), rp.sin(yaw) * rp.cos(pitch), rp.sin(pitch)))


def _target(scene: Scene, person: ScenePerson, gaze: Floats) -> str:
    eyes = person.posed.eyes_m
    backdrop = scene.backdrop
    nearest, target = _met(eyes, gaze, backdrop.vertices, backdrop.faces)
    name = "outside" if target < 0 else _part_of_face(scene, target)
    skin_faces = person.person.skin_faces
    hands = np.isin(person.person.skin_segment[skin_faces], _HANDS).all(axis=1)
    candidates = [("hand", person, skin_faces[hands])]
    candidates += [(p.slot, p, p.person.skin_faces) for p in scene.people if p is not person]
    for label, whose, faces in candidates:
        off = whose.posed.joints - eyes
        ahead = np.maximum(rp.matmul(off, gaze), 0.0)
        if float(np.linalg.norm(off - ahead[:, None] * gaze, axis=1).min()) < _BODY_M:
            away, which = _met(eyes, gaze, whose.posed.skin, faces)
            if which >= 0 and away < nearest:
                nearest, name = away, label
    return name


def _met(eyes: Floats, gaze: Floats, vertices: Any, faces: Any) -> tuple[float, int]:
    """The share of the line of sight at which it first meets a surface, and the face; inf and -1 where it does not."""
    share, which = first_crossings(eyes[None], (eyes + _FAR_M * gaze)[None], vertices[faces].astype(np.float64))
    return float(share[0]), int(which[0])


def _part_of_face(scene: Scene, face: int) -> str:
    """The name of the part that a face of the backdrop belongs to: the surface has the parts by groups, the static one first."""
    if scene.cabin is None:
        return "room"
    parts = sorted(scene.cabin.parts, key=lambda part: (part.group != STATIC_GROUP, part.group))
    ends = np.cumsum([len(part.surface.faces) for part in parts])
    return parts[int(np.searchsorted(ends, face, side="right"))].name

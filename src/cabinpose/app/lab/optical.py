"""The optical system: a cap with markers on the person's head, cameras around the car, and what hides one from the others."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product

import numpy as np
from numpy.typing import NDArray
from scipy.signal import lfilter
from scipy.spatial.transform import Rotation

from cabinpose._native import lab
from cabinpose.app.lab.motion import PersonMotion
from cabinpose.app.lab.rig import Tracker
from cabinpose.core import CABINPOSE, Matrix, apply, invert, transform
from cabinpose.scene import LABEL_ID as LABEL
from cabinpose.scene import MATERIALS
from cabinpose.scene.body import BONE_INDEX, SEGMENTS, Person
from cabinpose.signals import kabsch

F64 = NDArray[np.float64]

HEAD_SUBJECT = HEAD_SEGMENT = "head"
LEAST_MARKERS, LEAST_CAMERAS = 3, 2  # of a rigid body; that see a marker
LOOK_HZ = 10.0  # how often occlusion is computed; it holds until the next time
# Cameras about a driver on the left, m from C1 along the vehicle's axes: five on stands around the car,
# which see through its windows, and three in it, before the windscreen and under the roof.
CAMERAS_M: F64 = np.array(
    [
        (2.6, 1.3, 0.7), (2.6, 0.3, 0.5), (2.6, -1.6, 0.7), (0.3, 2.4, 0.3), (0.2, -2.8, 0.25),
        (0.75, -0.75, 0.08), (0.25, -0.85, 0.12), (-0.55, -0.9, 0.1),
    ]
)  # fmt: skip
# What an optical system loses without anything in between: ghosts, merged images, labels. How often (1/s) and how long (s, mean):
# a single marker; all at once.
_LOST_MARKER, _LOST_OBJECT = (0.1, 0.1), (0.05, 0.2)
# The cap's markers as seen from the middle of the head (x ahead, y left, z up), on stalks; no two distances are equal.
_DIRECTIONS: F64 = np.array(
    [(0.85, 0.15, 0.55), (0.25, 0.85, 0.60), (0.10, -0.90, 0.45), (-0.75, 0.30, 0.65), (-0.35, -0.45, 1.00)]
)
_STALK_M = 0.03
_CONE = 0.97  # cosine of the cone about a direction in which the head's surface is sought
# The object's axes, as an operator draws them up, against the head's.
_OBJECT_TURN = Rotation.from_euler("ZYX", (23.0, -14.0, 8.0), degrees=True)
# A mobile tracker stands on the dashboard, its body on the cap's back; it is off by the same for so many seconds.
_TRACKER_FROM_WORLD = transform(Rotation.from_euler("ZYX", (130.0, 3.0, -2.0), degrees=True), (0.4, -0.7, 0.9))
_BODY_FROM_OBJECT = transform(Rotation.from_euler("ZYX", (-40.0, 25.0, 10.0), degrees=True), (0.02, -0.03, 0.06))
_WANDER_S = 5.0
_ENDS_M = 0.004  # a ray ends this far before its marker, the radius of which it is
_MOVED_M = 0.1  # by which a head may leave the places where it was looked for
_TRANSMISSIVE = np.array([m.id for m in MATERIALS if m.transmissive], np.uint8)

# The optical model's segments, in our joints' order, and the bone that turns with each where it is not the joint's own: the
# model's head is one piece from neck to crown, its loins begin at L5.
MODEL_SEGMENTS: tuple[str, ...] = tuple(CABINPOSE.maps["vicon_kinematic_fit"].values())
_MODEL_JOINTS = np.array([CABINPOSE.index[joint] for joint in CABINPOSE.maps["vicon_kinematic_fit"]])
_MODEL_BONE = {"neck": "head", "hip": "spine04"}
# A model's joint lies between several markers on skin: its noise is so many times a marker's, its turn that over 0.1 m.
_MODEL_NOISE, _MODEL_LEVER_M = 5.0, 0.1


@dataclass(frozen=True)
class Cap:
    """The marker cap of a person: names (M,), markers_m (M, 3) in the object's frame, object_from_head (4, 4).

    head: MVN's head segment, whose origin is C1. The object's origin is the middle of its markers.
    """

    names: tuple[str, ...]
    markers_m: F64
    object_from_head: Matrix


def cap_of(person: Person) -> Cap:
    """The cap on a person's head: five markers 3 cm above the skin."""
    head = BONE_INDEX["head"]
    skin = person.rest_skin[person.skin_segment == SEGMENTS.index("head")] - person.rest.heads[head]
    middle = skin.mean(axis=0, dtype=np.float64)
    out = skin - middle
    length = np.linalg.norm(out, axis=1)
    markers = []
    for direction in _DIRECTIONS / np.linalg.norm(_DIRECTIONS, axis=1, keepdims=True):
        within = out @ direction > _CONE * length
        markers.append(middle + direction * (float(length[within].max()) + _STALK_M))
    at = np.stack(markers)
    head_from_object = transform(_OBJECT_TURN, at.mean(axis=0))
    object_from_head = invert(head_from_object)
    return Cap(tuple(f"cap{k + 1}" for k in range(len(at))), apply(object_from_head, at), object_from_head)


def seen_by(eyes: F64, markers: F64, vertices: NDArray[np.float32], faces: NDArray[np.int32]) -> NDArray[np.bool_]:
    """(N, M): which cameras (N, 3) see which markers (M, 3): no triangle of (F, 3) lies between. All in one frame, m."""
    seen = np.empty((len(eyes), len(markers)), np.bool_)
    lab.see_markers(
        eyes=np.ascontiguousarray(eyes, np.float64), markers=np.ascontiguousarray(markers, np.float64),
        vertices=np.ascontiguousarray(vertices, np.float32), faces=np.ascontiguousarray(faces, np.int32), ends=_ENDS_M, seen=seen,
    )  # fmt: skip
    return seen


class Watch:
    """What hides a person's cap from cameras: their own body, and the car without its panes; other people are left out."""

    def __init__(self, motion: PersonMotion, cap: Cap, eyes: F64 | None = None) -> None:
        """eyes: (N, 3) m in the scene's frame; left out: `CAMERAS_M` about the head's place at the start."""
        self._motion, self._cap = motion, cap
        heads = motion.joints(np.arange(0.0, motion.duration_s + 0.2, 0.2))[:, CABINPOSE.index["head"]]
        self.eyes = apply(transform(translation=heads[0]), CAMERAS_M) if eyes is None else np.asarray(eyes, np.float64)
        # Of the car only what can come between: in a pyramid from a camera about all places of the head.
        reach = float(np.linalg.norm(apply(invert(cap.object_from_head), cap.markers_m), axis=1).max()) + _MOVED_M
        low, high = heads.min(axis=0) - reach, heads.max(axis=0) + reach
        corners = np.array(list(product(*zip(low, high, strict=True))))
        self._rows, self._faces = np.zeros(0, np.int64), np.zeros((0, 3), np.int32)
        if motion.cabin is not None:
            surface = motion.cabin.surface(motion.settings, wheel_angle=float(motion.pose_at(0.0)[2][0]))
            between = np.empty(len(surface.faces), np.bool_)
            lab.faces_between(
                eyes=np.ascontiguousarray(self.eyes),
                points=corners,
                vertices=surface.vertices,
                faces=surface.faces,
                possible=between,
            )
            kept = (between | (surface.label == LABEL["steering_wheel"])) & ~np.isin(surface.material, _TRANSMISSIVE)
            self._rows, faces = np.unique(surface.faces[kept], return_inverse=True)
            self._faces = faces.reshape(-1, 3).astype(np.int32)

    def at(self, time_s: float) -> NDArray[np.bool_]:
        """(N, M): which camera sees which marker."""
        motion = self._motion
        body = motion.body(time_s)
        markers = apply(body.bones[BONE_INDEX["head"]] @ invert(self._cap.object_from_head), self._cap.markers_m)
        vertices, faces = [body.skin], [motion.person.skin_faces]
        if motion.cabin is not None:
            surface = motion.cabin.surface(motion.settings, wheel_angle=float(motion.pose_at(time_s)[2][0]))
            vertices.append(surface.vertices[self._rows])
            faces.append(self._faces + np.int32(len(body.skin)))
        return seen_by(self.eyes, markers, np.concatenate(vertices), np.concatenate(faces))

    def over(self, time_s: F64) -> NDArray[np.bool_]:
        """(T, M): whether enough cameras see each marker at rising times (T,), looked at `LOOK_HZ` times a second."""
        looks = np.floor((time_s - time_s[0]) * LOOK_HZ + 1e-9).astype(np.int64)
        first, inverse = np.unique(looks, return_index=True, return_inverse=True)[1:]
        each = np.stack([self.at(float(time_s[k])).sum(axis=0) >= LEAST_CAMERAS for k in first])
        return each[inverse]


def kept(time_s: F64, markers: int, *, rng: np.random.Generator) -> NDArray[np.bool_]:
    """(T, M): false where a marker is lost for a moment although nothing hides it, at rising times (T,)."""
    rate, lasts = np.array([_LOST_MARKER] * markers + [_LOST_OBJECT]).T
    drawn = rng.random((len(time_s), markers + 1))
    steps = np.diff(time_s, prepend=time_s[0])[:, None]
    stays, starts = drawn > steps / lasts, drawn < steps * rate  # what becomes of a marker that was lost, and of one that was not
    stays[0] = starts[0] = False
    # A Markov chain of two states, lost and seen, without a loop. Where `stays` and `starts` agree, the state does not depend on
    # the one before; from there on it is inverted at each step with `starts` and without `stays`.
    known = np.maximum.accumulate(np.where(stays == starts, np.arange(len(time_s))[:, None], 0), axis=0)
    turns = np.cumsum(starts & ~stays, axis=0)
    since = turns - np.take_along_axis(turns, known, axis=0)
    lost = np.take_along_axis(starts, known, axis=0) ^ (since % 2 == 1)
    return ~(lost[:, :-1] | lost[:, -1:])


def true_object(head: Matrix, cap: Cap) -> Matrix:
    """(T, 4, 4) world_from_object from world_from_head (T, 4, 4)."""
    return head @ invert(cap.object_from_head)


def measured_object(
    world_from_object: Matrix, cap: Cap, visible: NDArray[np.bool_] | None, noise_m: float, *, rng: np.random.Generator
) -> tuple[F64, F64]:
    """Position (T, 3) m and orientation (T, 4) wxyz of the object, NaN where fewer than three markers are seen.

    Each marker is off by `noise_m` along each axis, independently; the pose is that of the markers seen (Kabsch).
    visible: (T, M), None: all. The same numbers are drawn whatever is seen.
    """
    count = len(world_from_object)
    position, orientation = np.full((count, 3), np.nan), np.full((count, 4), np.nan)
    noise = noise_m * rng.standard_normal((count, *cap.markers_m.shape))
    seen = np.ones(noise.shape[:2], np.bool_) if visible is None else visible
    enough = seen.sum(axis=1) >= LEAST_MARKERS
    if enough.any():
        true = world_from_object[enough]
        measured = cap.markers_m @ np.swapaxes(true[:, :3, :3], 1, 2) + true[:, None, :3, 3] + noise[enough]
        fitted = kabsch(measured, np.broadcast_to(cap.markers_m, measured.shape), seen[enough])
        position[enough] = fitted[:, :3, 3]
        orientation[enough] = Rotation.from_matrix(fitted[:, :3, :3]).as_quat(scalar_first=True)
    return position, orientation


def measured_tracker(world_from_object: Matrix, time_s: F64, errors: Tracker, *, rng: np.random.Generator) -> tuple[F64, F64]:
    """Position (T, 3) m and orientation (T, 4) wxyz of a tracker's body, fixed to the cap, in the tracker's own world.

    It is off from sample to sample, and slowly: a first-order process of `_WANDER_S`.
    """
    true = _TRACKER_FROM_WORLD @ world_from_object @ invert(_BODY_FROM_OBJECT)
    fast, drawn = rng.standard_normal((2, 2, len(true), 3))
    stays = np.exp(-float(np.median(np.diff(time_s))) / _WANDER_S)
    drawn[:, 1:] *= np.sqrt(1 - stays**2)
    slow = lfilter([1.0], [1.0, -stays], drawn, axis=1)
    position = true[:, :3, 3] + errors.noise_m * fast[0] + errors.wander_m * slow[0]
    turned = np.radians(errors.noise_deg * fast[1] + errors.wander_deg * slow[1])
    return position, (Rotation.from_matrix(true[:, :3, :3]) * Rotation.from_rotvec(turned)).as_quat(scalar_first=True)


def measured_model(
    motion: PersonMotion, time_s: F64, world_from_scene: Matrix, noise_m: float, *, rng: np.random.Generator
) -> tuple[F64, F64]:
    """Positions (T, S, 3) m and orientations (T, S, 4) wxyz of `MODEL_SEGMENTS` in the world: the full-body optical model.

    Every joint is off by five times a marker's `noise_m` along each axis, every segment turned by that over 0.1 m. A segment's
    frame is aligned with the world in the rig's zero pose (arms hanging) of a person who looks along its x.
    """
    rotation, position = motion.bones(time_s)
    rest = motion.person.rest
    bone = rest.joint_bone[_MODEL_JOINTS]
    at = position[:, bone] + np.einsum("tsij,sj->tsi", rotation[:, bone], rest.joint_offset[_MODEL_JOINTS])
    joints = tuple(CABINPOSE.maps["vicon_kinematic_fit"])
    turning = np.array([BONE_INDEX[_MODEL_BONE[j]] if j in _MODEL_BONE else b for j, b in zip(joints, bone, strict=True)])
    off, turned = rng.standard_normal((2, *at.shape)) * _MODEL_NOISE * noise_m
    exact = Rotation.from_matrix((world_from_scene[:3, :3] @ rotation[:, turning]).reshape(-1, 3, 3))
    noisy = exact * Rotation.from_rotvec(turned.reshape(-1, 3) / _MODEL_LEVER_M)
    return apply(world_from_scene, at) + off, noisy.as_quat(scalar_first=True).reshape(*at.shape[:2], 4)

"""The suit of inertial sensors: the body as 23 segments of MVN, and what such a suit gets wrong about them.

A segment's frame is aligned with the world in the T-pose of a person who looks along +x: its orientation is the rotation since
that pose. Its origin is the joint to its parent. Positions of a suit are no measurement: they follow from orientations and from
lengths by forward kinematics, from a pelvis that drifts.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.signal import lfilter
from scipy.spatial import KDTree
from scipy.spatial.transform import Rotation

from cabinpose.app.lab.motion import PersonMotion
from cabinpose.app.lab.rig import SuitErrors
from cabinpose.core import CABINPOSE, MVN_JOINTS, MVN_SEGMENTS, Matrix, apply, transform
from cabinpose.scene import MATERIAL_ID as MATERIAL
from cabinpose.scene.body import BONE_INDEX, DOF_INDEX, DOFS, N_MAIN, Person, main_frames
from cabinpose.scene.cabin import Cabin, SeatSetting

F64 = NDArray[np.float64]

_COUNT = len(MVN_SEGMENTS)
SEGMENT = {name: i for i, name in enumerate(MVN_SEGMENTS)}
_PARENT_NAME = {child: parent for _, parent, child in MVN_JOINTS}
PARENTS = np.array([-1 if name == "Pelvis" else SEGMENT[_PARENT_NAME[name]] for name in MVN_SEGMENTS])
# The bone that turns with a segment. The lower neck bends along its length: its middle stands for it.
_TRUNK_BONE = {
    "Pelvis": "pelvis", "L5": "spine04", "L3": "spine03", "T12": "spine02", "T8": "spine01", "Neck": "neck02", "Head": "head",
}  # fmt: skip
_LIMB_BONE = {
    "Shoulder": "clavicle", "UpperArm": "upperarm", "Forearm": "forearm", "Hand": "hand", "UpperLeg": "thigh",
    "LowerLeg": "shank", "Foot": "foot", "Toe": "foot",
}  # fmt: skip
# Segments that begin at a joint of ours; all others begin where their bone does.
_JOINT = {"L5": "hip", "Neck": "neck", "LeftToe": "lfoot", "RightToe": "rfoot"}

# Steel of a car's body, which trim hides: by the names of parts before it, and whatever is of metal itself.
_STEEL_BEHIND = ("door trim", "sill", "pillar", "roof rail", "headlining", "seat rails", "seat base", "floor")
_STEEL_REACH_M = 0.12  # the distance at which its disturbance has fallen to 1/e
_MAGNETIC_S = 3.0  # how slowly a fusion of sensors follows the field
_NOISE_S = 0.3  # correlation of the slower half of a segment's noise
_FLEXED, _FAST = 1.0, 3.0  # rad and rad/s at which soft tissue has moved by its sigma
_WALK = 0.3  # of the heading, against its steady drift over a minute


def _bone(segment: str) -> int:
    side = next((side for side in ("Left", "Right") if segment.startswith(side)), "")
    return BONE_INDEX[_TRUNK_BONE[segment] if not side else side[0].lower() + _LIMB_BONE[segment.removeprefix(side)]]


_BONES = np.array([_bone(name) for name in MVN_SEGMENTS])
_JOINT_ROWS = np.array([SEGMENT[name] for name in _JOINT])
_JOINTS = np.array([CABINPOSE.index[name] for name in _JOINT.values()])


@dataclass(frozen=True)
class Segments:
    """MVN's 23 segments over time: position_m (T, 23, 3) and rotation (T, 23, 3, 3), world_from_segment; time_s (T,)."""

    time_s: F64
    position_m: F64
    rotation: F64

    def moved(self, a_from_b: Matrix) -> Segments:
        """The segments in another world."""
        return Segments(self.time_s, apply(a_from_b, self.position_m), a_from_b[:3, :3] @ self.rotation)

    @cached_property
    def orientation_wxyz(self) -> F64:
        """(T, 23, 4)."""
        quaternion: F64 = Rotation.from_matrix(self.rotation.reshape(-1, 3, 3)).as_quat(scalar_first=True)
        return quaternion.reshape(*self.rotation.shape[:2], 4)

    def pose(self, segment: str) -> Matrix:
        """(T, 4, 4): world_from_segment."""
        result = np.tile(np.eye(4), (len(self.time_s), 1, 1))
        result[:, :3, :3], result[:, :3, 3] = self.rotation[:, SEGMENT[segment]], self.position_m[:, SEGMENT[segment]]
        return result

    def offsets(self) -> F64:
        """(T, 23, 3) m: each origin in its parent's frame; the pelvis' in the world."""
        between = self.position_m - self.position_m[:, PARENTS]
        result: F64 = np.einsum("tsji,tsj->tsi", self.rotation[:, PARENTS], between)
        result[:, 0] = self.position_m[:, 0]
        return result


def true_segments(motion: PersonMotion, time_s: NDArray[np.floating]) -> Segments:
    """The segments of a moving person at times (T,), in the scene's frame, without any error."""
    time = np.atleast_1d(np.asarray(time_s, np.float64))
    rotation, position = motion.bones(time)
    return _segments(motion.person, time, rotation, position)


def _segments(person: Person, time: F64, rotation: F64, position: F64) -> Segments:
    rest = person.rest
    origins = position[:, _BONES].copy()
    bone = rest.joint_bone[_JOINTS]
    origins[:, _JOINT_ROWS] = position[:, bone] + np.einsum("tsij,sj->tsi", rotation[:, bone], rest.joint_offset[_JOINTS])
    since = np.einsum("tbij,bkj->tbik", rotation, _t_pose(person)[0])
    return Segments(time, origins, since[:, _BONES])


def _t_pose(person: Person) -> tuple[F64, F64]:
    q = np.zeros(len(DOFS))
    for side in "lr":
        q[DOF_INDEX[side + "shoulder.abduction"]] = np.pi / 2
    return main_frames(q, person.rest, np.eye(4))


def model_offsets(person: Person) -> F64:
    """(23, 3) m: each segment's origin in its parent's frame, as a suit that measures the person in the T-pose has it."""
    rotation, position = _t_pose(person)
    return _segments(person, np.zeros(1), rotation[None, :N_MAIN], position[None, :N_MAIN]).offsets()[0]


def hand_offset(person: Person, side: str) -> F64:
    """(3,) m: the joint lhand or rhand (side l, r) in MVN's hand segment, which begins at the wrist."""
    rotation, _ = _t_pose(person)
    k = CABINPOSE.index[side + "hand"]
    return np.asarray(rotation[person.rest.joint_bone[k]] @ person.rest.joint_offset[k])


def forward(rotation: F64, offsets: F64) -> F64:
    """Positions (T, 23, 3) m of segments turned by rotation (T, 23, 3, 3), from offsets (T, 23, 3) as of `Segments.offsets`."""
    position = offsets.copy()
    for s in range(1, _COUNT):
        parent = PARENTS[s]
        position[:, s] = position[:, parent] + np.einsum("tij,tj->ti", rotation[:, parent], offsets[:, s])
    return position


def steel_of(cabin: Cabin, settings: Mapping[str, SeatSetting]) -> F64:
    """(N, 3) m: points of a car's steel, vehicle frame: what is of metal, and what trim of door, roof and floor hides."""
    groups = cabin.group_transforms(settings)
    points = []
    for part in cabin.parts:
        surface = part.surface
        steel = any(name in part.name for name in _STEEL_BEHIND)
        faces = surface.faces if steel else surface.faces[surface.material == MATERIAL["metal"]]
        corners = surface.vertices[faces]
        points.append(apply(groups[part.group], np.concatenate((corners.reshape(-1, 3), corners.mean(axis=1)))))
    return np.unique(np.concatenate(points).round(3), axis=0)


@dataclass(frozen=True)
class Wear:
    """What stays the same while one person wears a suit: unit normal numbers, which `SuitErrors` scale, and the suit's world.

    offset: (23, 3), tissue: (2, 23, 3) by angle and rate, magnetic: (23,), length: (23,) · suit_from_world: (4, 4), z up in both;
    the suit's origin and x are where the person stood, and looked, when it was calibrated.
    """

    offset: F64
    tissue: F64
    magnetic: F64
    length: F64
    suit_from_world: Matrix


def put_on(*, rng: np.random.Generator) -> Wear:
    """A suit put on and calibrated somewhere: heading and place of its world are anywhere."""
    world = transform(Rotation.from_euler("z", rng.uniform(-np.pi, np.pi)), (*rng.uniform(-2.0, 2.0, 2), 0.0))
    normal = rng.standard_normal
    return Wear(normal((_COUNT, 3)), normal((2, _COUNT, 3)), normal(_COUNT), normal(_COUNT), world)


def as_worn(
    true: Segments, errors: SuitErrors, wear: Wear, person: Person, steel: F64 | None = None, *, rng: np.random.Generator
) -> Segments:
    """What the suit says of segments, in its own world.

    true: in a world with z up, at a steady rate · steel: (N, 3) m in that world, None where there is none. Errors, each of them
    none where its setting is 0:
    segment_noise: a turn of every segment about each axis, half of its variance white, half correlated over 0.3 s ·
    calibration_offset: a constant turn of each segment about each axis · soft_tissue: a turn that grows with the angle to the
    parent since the T-pose and with its rate, as large as its setting at 1 rad or 3 rad/s ·
    heading_drift: of the whole suit, steady and with a random walk · magnetic: of single segments, e^-1 at 12 cm from steel,
    followed over 3 s · length_error: of each segment; and with it a body of rigid segments, as measured in the T-pose ·
    root_drift: of the pelvis, steady and with a random walk. Positions follow by forward kinematics from turned segments.
    The same numbers are drawn whatever is switched on.
    """
    time, count = true.time_s, len(true.time_s)
    step = float(np.median(np.diff(time))) if count > 1 else 1.0
    minutes = (time - time[0]) / 60.0
    white, slow = rng.standard_normal((2, count, _COUNT, 3))
    drift, walk = rng.standard_normal(), rng.standard_normal(count)
    reckoned, wandered = rng.standard_normal(3), rng.standard_normal((count, 3))

    sigma = np.radians(errors.segment_noise_deg) / np.sqrt(2.0)
    wrong = sigma * (white + _correlated(slow, step / _NOISE_S))
    wrong += np.radians(errors.soft_tissue_deg) * _soft_tissue(true, wear.tissue)
    turned = true.rotation @ _matrices(wrong) @ _matrices(np.radians(errors.calibration_offset_deg) * wear.offset)
    heading = np.radians(errors.heading_drift_deg_per_min) * (drift * minutes + _WALK * _wander(walk, step))
    about = np.zeros((count, _COUNT, 3))
    about[..., 2] = heading[:, None]
    if steel is not None:
        about[..., 2] += np.radians(errors.magnetic_deg) * wear.magnetic * _near(true.position_m, steel, step)
    rotation = _matrices(about) @ turned

    offsets = true.offsets()
    if errors.length_error > 0:
        offsets[:, 1:] = (model_offsets(person) * (1.0 + errors.length_error * wear.length)[:, None])[1:]
    walked = _matrices(np.stack((np.zeros(count), np.zeros(count), heading), axis=-1))
    offsets[:, 0] = true.position_m[0, 0] + np.einsum("tij,tj->ti", walked, true.position_m[:, 0] - true.position_m[0, 0])
    offsets[:, 0] += errors.root_drift_m_per_min * (reckoned * minutes[:, None] + _WALK * _wander(wandered, step))
    return Segments(time, forward(rotation, offsets), rotation).moved(wear.suit_from_world)


def _matrices(rotation_vectors: F64) -> F64:
    flat = Rotation.from_rotvec(rotation_vectors.reshape(-1, 3)).as_matrix()
    return np.asarray(flat.reshape(*rotation_vectors.shape, 3))


def _correlated(white: F64, steps: float) -> F64:
    """A Gauss-Markov process of unit variance along axis 0 from white noise; steps: samples over its correlation time."""
    keep = np.exp(-steps)
    driven = np.sqrt(1.0 - keep**2) * white
    driven[0] = white[0]
    return np.asarray(lfilter([1.0], [1.0, -keep], driven, axis=0))


def _wander(white: F64, step_s: float) -> F64:
    """A random walk along axis 0 that starts at 0 and whose variance after a minute is 1."""
    steps = np.sqrt(step_s / 60.0) * white
    steps[0] = 0.0
    return np.cumsum(steps, axis=0)


def _soft_tissue(true: Segments, gains: F64) -> F64:
    """(T, 23, 3): turns that grow with the angle to the parent and its rate, in units of their sigma; gains: (2, 23, 3)."""
    parents = true.rotation[:, PARENTS]
    relative = np.einsum("tsji,tsjk->tsik", parents, true.rotation)
    relative[:, 0] = np.eye(3)
    shape = relative.shape[:2]
    angle = Rotation.from_matrix(relative.reshape(-1, 3, 3)).magnitude().reshape(shape)
    speed = np.zeros(shape)
    if len(true.time_s) > 1:
        change = np.einsum("tsji,tsjk->tsik", relative[:-1], relative[1:])
        by = Rotation.from_matrix(change.reshape(-1, 3, 3)).magnitude().reshape(len(change), -1)
        rate = by / np.diff(true.time_s)[:, None]
        speed[1:-1] = (rate[:-1] + rate[1:]) / 2
    return np.asarray(angle[..., None] / _FLEXED * gains[0] + speed[..., None] / _FAST * gains[1])


def _near(position_m: F64, steel: F64, step_s: float) -> F64:
    """(T, 23): how much each segment's heading gives way to steel, 1 at its surface, followed slowly."""
    distance, _ = KDTree(steel).query(position_m)
    strength = np.exp(-distance / _STEEL_REACH_M)
    keep = np.exp(-step_s / _MAGNETIC_S)
    slow, _ = lfilter([1.0 - keep], [1.0, -keep], strength, axis=0, zi=keep * strength[:1])
    return np.asarray(slow)

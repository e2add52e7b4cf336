"""A person who moves: key poses of the generator, joined so that joints stay within their limits and the body clear of the car.

Between keys each degree of freedom follows a minimum-jerk course (Flash & Hogan 1985, eq. 2: 10 t³ - 15 t⁴ + 6 t⁵) and the
pelvis the same by slerp. Angles are interpolated as joint coordinates and not as rotations of bones: limits of joints are a
box in them, so what lies between two keys within the limits is within them too.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial.transform import Rotation

from cabinpose._native import body as native
from cabinpose.core import JOINTS, STANDING_SLOT, Matrix, SceneError, unknown_name
from cabinpose.scene.body import (
    DOF_INDEX,
    LOWER,
    SEGMENTS,
    SUBJECTS,
    UPPER,
    BodyModel,
    Person,
    PosedBody,
    every_finger,
    main_frames,
)
from cabinpose.scene.cabin import Cabin, Seat, SeatSetting
from cabinpose.scene.contact import FLESH_M, PosedSolids, SolidTopology, person_contact, self_contact, solid_topology
from cabinpose.synth import Validator, judged_cabin
from cabinpose.synth.posture import (
    HEAD_SHARE,
    SeatContext,
    SeatOffset,
    choose_setting,
    draw_offset,
    head_rotation,
    random_action,
    sample_pose,
    turn_head,
)

F64 = NDArray[np.float64]

# Deeper than what yields anyway, in passing from one key to the next: a hand that leaves the rim opens late.
PASS_M = 0.01
CHECK_HZ = 8.0  # how often a move is looked at
PAIR_HZ = 4.0  # how often it is looked at whether two people touch
_TRIES = 60  # keys drawn before giving up
_MOVE_S, _HOLD_S, _GLANCE_HOLD_S = (0.8, 2.0), (0.1, 0.6), (0.2, 0.6)
_FASTEST = 2.5  # rad/s at the peak, of an unhurried joint
_PEAK = 1.875  # greatest speed of a minimum-jerk course, in parts of its mean
_GLANCE = 0.7  # how often a key is followed by a look elsewhere
# Yaw (+ left) and pitch (+ up).
_LOOKS_DEG = {"left": (55.0, -5.0), "right": (-60.0, -5.0), "mirror": (-28.0, 8.0), "down": (-12.0, -38.0)}
_LOOK_SIGMA_DEG = 8.0


@dataclass(frozen=True)
class Window:
    """A named span of a motion: from start_s to end_s."""

    name: str
    start_s: float
    end_s: float


class PersonMotion(ABC):
    """One person's motion in the scene's frame (the vehicle's, or a room's with z up and the floor at 0), by times in s.

    slot, cabin, settings: the seat and the car, None in a room · windows: labelled spans.
    """

    person: Person
    windows: tuple[Window, ...]
    slot: str
    cabin: Cabin | None
    settings: Mapping[str, SeatSetting]

    @property
    @abstractmethod
    def duration_s(self) -> float:
        """When it ends."""

    @abstractmethod
    def key_at(self, time_s: float) -> str:
        """What the person does at a time."""

    @abstractmethod
    def pose_at(self, time_s: ArrayLike) -> tuple[F64, Matrix, F64]:
        """q (T, D) rad, scene_from_root (T, 4, 4) and wheel angle (T,) rad at times (T,)."""

    @abstractmethod
    def body(self, time_s: float) -> PosedBody:
        """The posed, skinned body at a time."""

    def bones(self, time_s: ArrayLike) -> tuple[F64, F64]:
        """Rotation (T, 23, 3, 3) and origin (T, 23, 3) m of the main bones of `rig.MAIN_BONES`, scene frame."""
        q, root, _ = self.pose_at(time_s)
        frames = [main_frames(q[k], self.person.rest, root[k]) for k in range(len(q))]
        return np.stack([rotation for rotation, _ in frames]), np.stack([position for _, position in frames])

    def joints(self, time_s: ArrayLike) -> F64:
        """(T, 20, 3) m: the joints of `core.skeleton.JOINTS`, scene frame."""
        rotation, position = self.bones(time_s)
        out = np.empty((len(rotation), len(JOINTS), 3))
        for k in range(len(out)):
            native.joint_positions(self.person.rest, rotation[k], position[k], out[k])
        return out


@dataclass(frozen=True, eq=False)
class KeyedMotion(PersonMotion):
    """One person's motion in the scene's frame (the vehicle's, or a room's with z up and the floor at 0).

    Key k is held from arrive_s[k] to leave_s[k] (K,), rising · q: (K, D) rad in the order of `DOFS` · root: (K, 4, 4)
    scene_from_root · wheel_angle: (K,) rad · keys: (K,) what each is · windows: labelled spans · slot, cabin, settings: the
    seat and the car, None in a room · fingers: (K, 2, 16) as `Person.pose` takes them, None where all follow the grip. Before the
    first key and after the last one the person holds still.
    """

    person: Person
    arrive_s: F64
    leave_s: F64
    q: F64
    root: Matrix
    wheel_angle: F64
    keys: tuple[str, ...]
    windows: tuple[Window, ...] = ()
    slot: str = STANDING_SLOT
    cabin: Cabin | None = None
    settings: Mapping[str, SeatSetting] = field(default_factory=dict)
    fingers: F64 | None = None

    @property
    def duration_s(self) -> float:
        """The time at which the last key is left."""
        return float(self.leave_s[-1])

    def key_at(self, time_s: float) -> str:
        """What the person does: the key that is held, or the next one."""
        return self.keys[min(int(np.searchsorted(self.leave_s, time_s)), len(self.keys) - 1)]

    def pose_at(self, time_s: ArrayLike) -> tuple[F64, Matrix, F64]:
        """q (T, D) rad, scene_from_root (T, 4, 4) and wheel angle (T,) rad at times (T,)."""
        before, after, s = self._between_keys(time_s)
        q = self.q[before] + s[:, None] * (self.q[after] - self.q[before])
        first, second = Rotation.from_matrix(self.root[before, :3, :3]), Rotation.from_matrix(self.root[after, :3, :3])
        root = np.tile(np.eye(4), (len(s), 1, 1))
        root[:, :3, :3] = (first * Rotation.from_rotvec(s[:, None] * (first.inv() * second).as_rotvec())).as_matrix()
        root[:, :3, 3] = self.root[before, :3, 3] + s[:, None] * (self.root[after, :3, 3] - self.root[before, :3, 3])
        return q, root, self.wheel_angle[before] + s * (self.wheel_angle[after] - self.wheel_angle[before])

    def fingers_at(self, time_s: ArrayLike) -> F64 | None:
        """(T, 2, 16) fingers at times (T,), None where all follow the grip."""
        if self.fingers is None:
            return None
        before, after, s = self._between_keys(time_s)
        return np.asarray(self.fingers[before] + s[:, None, None] * (self.fingers[after] - self.fingers[before]))

    def body(self, time_s: float) -> PosedBody:
        """The posed, skinned body at a time."""
        q, root, _ = self.pose_at(time_s)
        fingers = self.fingers_at(time_s)
        return self.person.pose(q[0], root[0], None if fingers is None else fingers[0])

    def _between_keys(self, time_s: ArrayLike) -> tuple[NDArray[np.int64], NDArray[np.int64], F64]:
        """Numbers (T,) of the keys before and after times (T,), and the share (T,) of the way from the one to the other."""
        t = np.atleast_1d(np.asarray(time_s, np.float64))
        before = np.clip(np.searchsorted(self.arrive_s, t, side="right") - 1, 0, len(self.keys) - 1)
        after = np.minimum(before + 1, len(self.keys) - 1)
        span = np.maximum(self.arrive_s[after] - self.leave_s[before], 1e-12)
        x = np.clip((t - self.leave_s[before]) / span, 0.0, 1.0)
        s = x**3 * (10.0 + x * (6.0 * x - 15.0))
        s[after == before] = 0.0
        return before, after, s


@dataclass(frozen=True, eq=False)
class Stage:
    """A person in a seat of a car: the car, its validator, who, where, how the seats are set, how the pelvis sits."""

    car: str
    cabin: Cabin
    validator: Validator
    person: Person
    slot: str
    settings: Mapping[str, SeatSetting]
    offset: SeatOffset

    @property
    def seat(self) -> Seat:
        """The person's."""
        return self.cabin.seats[self.slot]


@lru_cache(maxsize=8)
def named_person(subject: str) -> Person:
    """One of the package's people, prepared once. Raises ConfigError for a name that does not exist."""
    if subject not in SUBJECTS:
        raise unknown_name("subject", subject, list(SUBJECTS))
    return BodyModel.load().person(SUBJECTS[subject].phenotype, SUBJECTS[subject].outfit)


def in_seat(car: str = "sedan", subject: str = "S01", slot: str = "driver", *, rng: np.random.Generator) -> Stage:
    """A person of the package in a seat of a preset car, the seat set as people differ in setting it."""
    cabin, validator = judged_cabin(car, "left")
    person = named_person(subject)
    settings = {name: seat.default for name, seat in cabin.seats.items()}
    settings[slot] = choose_setting(person, cabin.seats[slot], cabin, rng=rng, variation=1.0)
    return Stage(car, cabin, validator, person, slot, settings, draw_offset(0.015, math.radians(3.0), rng=rng))


def act(stage: Stage, seconds: float, *, rng: np.random.Generator) -> KeyedMotion:
    """At least `seconds` of an occupant's actions, ending at rest: the generator's, with looks to mirrors and sides between.

    Keys hold as the generator's frames do (`Validator.check`). Between them the body goes no deeper than `PASS_M` beyond what
    yields, looked at `CHECK_HZ` times a second: a key that cannot be reached so is drawn again. Raises SceneError where none
    is found.
    """
    course = _Course(stage)
    course.add(_first(stage, rng), _resting(stage), 0.0, rng.uniform(*_HOLD_S))
    while course.end_s < seconds:
        for _ in range(_TRIES):
            action = random_action(stage.seat, stage.cabin, rng=rng)
            try:
                key = _key(stage, action, rng)
            except SceneError:
                continue
            if course.try_move(key, action, rng.uniform(0.9, 1.1), rng.uniform(*_HOLD_S)):
                break
        else:
            raise SceneError(
                f"no way from '{course.names[-1]}' to any other key in {_TRIES} draws", hint="try another seed, person or car"
            )
        if rng.random() < _GLANCE:
            name = str(rng.choice(list(_LOOKS_DEG)))
            course.try_move(_look(stage, course.last, name, rng), f"look_{name}", 0.8, rng.uniform(*_GLANCE_HOLD_S))
    return course.motion()


def keep_apart(one: KeyedMotion, two: KeyedMotion) -> bool:
    """Whether two people of one car never touch deeper than flesh yields, looked at `PAIR_HZ` times a second."""
    seconds = min(one.duration_s, two.duration_s)
    topologies: list[SolidTopology] = []
    for time_s in np.arange(0.0, seconds, 1 / PAIR_HZ):
        posed = [motion.body(float(time_s)) for motion in (one, two)]
        if not topologies:
            topologies = [
                solid_topology(motion.person.skin_faces, motion.person.skin_segment, SEGMENTS, body.skin)
                for motion, body in zip((one, two), posed, strict=True)
            ]
        first, second = (PosedSolids.of(topology, body.skin) for topology, body in zip(topologies, posed, strict=True))
        if person_contact(first, second) is not None:
            return False
    return True


_SHARE = {"flexion": 0.7, "lateral": 0.8, "rotation": 0.5}  # of a turn that the neck does; the head does the rest
_CALIBRATION_LIMIT_DEG = {"flexion": 30.0, "lateral": 30.0, "rotation": 40.0}
_LEAST_DEG = 15.0
_SWING_S = 1.3


def calibrate_head(stage: Stage, *, rng: np.random.Generator) -> KeyedMotion:
    """Flexion and extension, lateral flexion and rotation of the head, each twice, on a still trunk: about 20 s.

    The head goes as far as its joints and the headrest let it, at most 30 deg (rotation: 40). Windows: flexion, lateral,
    rotation. Raises SceneError where it can turn less than 15 deg to a side.
    """
    for _ in range(_TRIES):
        start = _first(stage, rng)
        course = _Course(stage)
        course.add(start, "rest", 0.0, 1.0)
        windows = []
        for axis, limit in _CALIBRATION_LIMIT_DEG.items():
            begun = course.end_s
            ends = [_farthest(course, axis, sign * limit) for sign in (1.0, -1.0)]
            if any(end is None for end in ends):
                break
            for end in (*ends, *ends):
                assert end is not None  # looked at above
                course.add(end, axis, _SWING_S, 0.05)
            course.add(start, "rest", _SWING_S, 0.5)
            windows.append(Window(axis, begun, course.end_s))
        else:
            return course.motion(tuple(windows))
    raise SceneError("the head has no room to turn in this seat", hint="try another seed, person or car")


class Key(NamedTuple):
    """A key pose: q (D,) rad, scene_from_root (4, 4), wheel angle (rad), fingers (2, 16) as `Person.pose` takes them."""

    q: F64
    root: Matrix
    wheel_angle: float
    fingers: F64


class _Course:
    """A motion in the making: its keys and their times."""

    def __init__(self, stage: Stage) -> None:
        self._stage = stage
        self._topology: SolidTopology | None = None
        self._keys: list[Key] = []
        self._arrive: list[float] = []
        self._leave: list[float] = []
        self.names: list[str] = []

    @property
    def end_s(self) -> float:
        return self._leave[-1]

    @property
    def last(self) -> Key:
        return self._keys[-1]

    def add(self, key: Key, name: str, move_s: float, hold_s: float) -> None:
        arrive = (self._leave[-1] if self._leave else 0.0) + move_s
        self._keys.append(key)
        self._arrive.append(arrive)
        self._leave.append(arrive + hold_s)
        self.names.append(name)

    def try_move(self, key: Key, name: str, pace: float, hold_s: float) -> bool:
        """Add a key if the way there is free; pace: how long it takes, in parts of the unhurried time."""
        farthest = float(np.abs(key.q - self.last.q)[_TURNING].max())
        move_s = float(np.clip(pace * _PEAK * farthest / _FASTEST, *_MOVE_S))
        if not self.free(key, move_s):
            return False
        self.add(key, name, move_s, hold_s)
        return True

    def free(self, key: Key, move_s: float) -> bool:
        """Whether nothing goes deeper than `PASS_M` beyond what yields on the way to a key, the key included."""
        steps = max(math.ceil(move_s * CHECK_HZ), 2)
        way = _between(self.last, key, np.arange(1, steps + 1) / steps)
        return all(self.depth(at) <= PASS_M for at in way)

    def motion(self, windows: tuple[Window, ...] = ()) -> KeyedMotion:
        return KeyedMotion(
            self._stage.person, np.array(self._arrive), np.array(self._leave), np.stack([k.q for k in self._keys]),
            np.stack([k.root for k in self._keys]), np.array([k.wheel_angle for k in self._keys]), tuple(self.names), windows,
            self._stage.slot, self._stage.cabin, self._stage.settings, np.stack([k.fingers for k in self._keys]),
        )  # fmt: skip

    def depth(self, at: Key) -> float:
        """By how much (m) a pose goes deeper than flesh and foam yield: into itself or the car."""
        stage = self._stage
        posed = stage.person.pose(at.q, at.root, at.fingers)
        if self._topology is None:
            self._topology = solid_topology(stage.person.skin_faces, stage.person.skin_segment, SEGMENTS, posed.skin)
        body = PosedSolids.of(self._topology, posed.skin)
        found = self_contact(body, posed.joints)
        contact = stage.validator.contact
        assert contact is not None  # a car's validator has the car's fields
        touched = contact.at(stage.settings, at.wheel_angle).deepest(body.skin_points[0], FLESH_M)
        return max(0.0 if found is None else found[1].excess_m, 0.0 if touched is None else touched.excess_m)


_TURNING = np.array([not name.endswith("grip") for name in DOF_INDEX])


def _between(one: Key, two: Key, share: F64) -> list[Key]:
    """Poses at shares (N,) of the way's time from one key to another."""
    way = KeyedMotion(
        None, np.array([0.0, 1.0]), np.array([0.0, 1.0]), np.stack((one.q, two.q)), np.stack((one.root, two.root)),  # type: ignore[arg-type]
        np.array((one.wheel_angle, two.wheel_angle)), ("", ""), fingers=np.stack((one.fingers, two.fingers)),
    )  # fmt: skip
    fingers = way.fingers_at(share)
    assert fingers is not None  # both keys have them
    return [Key(q, root, float(wheel), curl) for q, root, wheel, curl in zip(*way.pose_at(share), fingers, strict=True)]


def _resting(stage: Stage) -> str:
    return "drive" if stage.slot == "driver" else "rest_lap"


def _key(stage: Stage, action: str, rng: np.random.Generator) -> Key:
    """A valid key pose of an action, as the generator draws it. Raises SceneError where the draw does not hold."""
    contact = stage.validator.contact
    assert contact is not None  # a car's validator has the car's fields
    seated = SeatContext(stage.person, stage.seat, stage.settings[stage.slot], stage.cabin, stage.offset)
    pose = sample_pose(seated, action, car=lambda angle: contact.at(stage.settings, angle), rng=rng)
    wheel = pose.wheel_angle or 0.0
    fingers = every_finger(pose.q, pose.fingers)
    posed = stage.person.pose(pose.q, pose.vehicle_from_root, fingers)
    verdict = stage.validator.check([(stage.slot, stage.person, posed)], stage.settings, wheel)
    if not verdict.ok:
        raise SceneError(f"{action}: {verdict.rejection}", hint="draw again")
    return Key(pose.q, pose.vehicle_from_root, wheel, fingers)


def _first(stage: Stage, rng: np.random.Generator) -> Key:
    """The action that a motion begins with. Raises SceneError where no draw holds."""
    for _ in range(_TRIES):
        try:
            return _key(stage, _resting(stage), rng)
        except SceneError as error:
            last = error
    raise SceneError(f"none of {_TRIES} draws: {last}", hint="try another seed, person or car")


def _look(stage: Stage, key: Key, where: str, rng: np.random.Generator) -> Key:
    """A key with the head turned elsewhere."""
    yaw, pitch = np.radians(np.array(_LOOKS_DEG[where]) + _LOOK_SIGMA_DEG * np.clip(rng.standard_normal(2), -2.0, 2.0))
    q = key.q.copy()
    heading = stage.seat.facing_yaw
    turn_head(stage.person, q, key.root, head_rotation(heading + HEAD_SHARE[0] * yaw, HEAD_SHARE[1] * pitch))
    return key._replace(q=q)


def _farthest(course: _Course, axis: str, degrees: float) -> Key | None:
    """The key with the head turned about an axis as far as joints and headrest allow, up to `degrees`; None: not 15 deg."""
    neck, head = DOF_INDEX[f"neck.{axis}"], DOF_INDEX[f"head.{axis}"]
    start = course.last
    for share in np.arange(1.0, 0.2, -0.1):
        q = start.q.copy()
        turn = math.radians(share * degrees)
        q[neck] = np.clip(q[neck] + _SHARE[axis] * turn, LOWER[neck], UPPER[neck])
        q[head] = np.clip(start.q[head] + turn - (q[neck] - start.q[neck]), LOWER[head], UPPER[head])
        turned = abs(float(q[neck] + q[head] - start.q[neck] - start.q[head]))
        if turned < math.radians(_LEAST_DEG):
            return None
        key = start._replace(q=q)
        if course.free(key, _SWING_S):
            return key
    return None

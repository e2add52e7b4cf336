"""Takes of the virtual laboratory: recordings as a rig would make them of a person, each with its truth beside it."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path
from types import MappingProxyType
from typing import Any, NamedTuple, Self

import numpy as np
from numpy.typing import NDArray

from cabinpose.app.lab.exercises import exercises, stand
from cabinpose.app.lab.motion import KeyedMotion, PersonMotion, Stage, act, calibrate_head, in_seat, keep_apart, named_person
from cabinpose.app.lab.optical import (
    HEAD_SEGMENT,
    HEAD_SUBJECT,
    LEAST_MARKERS,
    MODEL_SEGMENTS,
    Cap,
    Watch,
    cap_of,
    kept,
    measured_model,
    measured_object,
    measured_tracker,
    true_object,
)
from cabinpose.app.lab.rig import Device, Source, VirtualRig
from cabinpose.app.lab.scene import SceneCamera, message_of, world_from_room, world_from_vehicle
from cabinpose.app.lab.suit import Wear, as_worn, hand_offset, put_on, steel_of, true_segments
from cabinpose.app.lab.writing import samples, write_recording
from cabinpose.core import JOINTS, MVN_SEGMENTS, ConfigError, Matrix, SceneError, apply, read_arrays, whole_file
from cabinpose.scene import furnish_room
from cabinpose.scene.body import Person
from cabinpose.scene.sensor import Sensor
from cabinpose.signals import Message, Sample, SegmentPoses
from cabinpose.store.recording import Participant, Take, whole_recording

F64 = NDArray[np.float64]
Times = NDArray[np.int64]

CODE = "S01"
POSE_S = 4.0  # length of the take of the N-pose
_AGAIN = "`cabinpose lab` writes it beside each take; record the session again"
_SEEN = 0.1  # of the turns of a head that the optical system has to see
_TRIES = 10  # motions of a passenger that are drawn before giving up


@dataclass(frozen=True, eq=False)
class Actor:
    """Somebody in a suit and with a cap on, for all takes of a session: what is wrong with both stays the same.

    suit: the source by which it is recorded · head: what the optical system calls the cap.
    """

    stage: Stage
    wear: Wear
    cap: Cap
    code: str = CODE
    suit: Source = "suit"
    head: str = HEAD_SUBJECT

    @property
    def person(self) -> Person:
        return self.stage.person

    def moved_to(self, slot: str, *, rng: np.random.Generator) -> Actor:
        """The same person in another seat of the car."""
        return replace(self, stage=in_seat(self.stage.car, self.code, slot, rng=rng))


def dress_up(
    car: str = "sedan", subject: str = CODE, *, suit: Source = "suit", head: str = HEAD_SUBJECT, rng: np.random.Generator
) -> Actor:
    """A person of the package at the wheel of a preset car, with suit and cap put on."""
    wear = put_on(rng=rng)
    return Actor(in_seat(car, subject, rng=rng), wear, cap_of(named_person(subject)), subject, suit, head)


class Performance(NamedTuple):
    """What a take is of: who moves how, in one car or one in a room, what it is called, and how long it takes."""

    people: Sequence[tuple[Actor, KeyedMotion]]
    action: str
    seconds: float


@dataclass(frozen=True, eq=False)
class Truth:
    """What is true of a take. World: the optical system's. Times are true (host) nanoseconds; empty arrays where nothing was.

    suit_ns (T,), optical_ns (O,), tof_ns (N,): when samples were taken · suit_position (T, 23, 3) m and suit_orientation_wxyz
    (T, 23, 4): segments in the world, without the suit's errors · world_from_object (O, 4, 4), object_seen (O, M): the cap, and
    which of its markers enough cameras saw · joints_3d (N, 20, 3) m, camera frame, joints_2d (N, 20, 2) px, visibility (N, 20) ·
    camera_from_world, world_from_scene (vehicle or room), suit_from_world, object_from_head (4, 4) · hands (2, 3) m: our joints
    lhand, rhand in MVN's hand segments · windows (W,): names; window_ns (W, 2) · actions (N,): what the person
    does · rig: as JSON; its clocks tell the stamps.
    """

    suit_ns: Times
    optical_ns: Times
    tof_ns: Times
    suit_position: F64
    suit_orientation_wxyz: F64
    world_from_object: Matrix
    object_seen: NDArray[np.bool_]
    joints_3d: F64
    joints_2d: F64
    visibility: NDArray[np.uint8]
    camera_from_world: Matrix
    world_from_scene: Matrix
    suit_from_world: Matrix
    object_from_head: Matrix
    hands: F64
    windows: NDArray[np.str_]
    window_ns: Times
    actions: NDArray[np.str_]
    rig: str

    def save(self, path: Path) -> None:
        """Write it as one .npz."""
        values: dict[str, Any] = {f.name: np.asarray(getattr(self, f.name)) for f in fields(self)}
        with whole_file(path) as partial:
            np.savez_compressed(partial, **values)

    @classmethod
    def load(cls, path: Path) -> Self:
        """Read what `save` wrote. Raises ConfigError where the file is no such truth."""
        try:
            values: dict[str, Any] = read_arrays(path, [f.name for f in fields(cls)])
            _check_shapes(values)
        except OSError as error:
            raise ConfigError(f"cannot read {path}: {error.strerror}", hint=_AGAIN) from error
        except ValueError as error:
            raise ConfigError(f"{path} is no truth of a take: {error}", hint=_AGAIN) from error
        return cls(**{**values, "rig": str(values["rig"])})


# Shapes of a truth's arrays: a letter stands for the same number everywhere.
_SHAPES: Mapping[str, tuple[int | str, ...]] = MappingProxyType(
    {
        "suit_ns": ("T",), "optical_ns": ("O",), "tof_ns": ("N",), "suit_position": ("T", 23, 3),
        "suit_orientation_wxyz": ("T", 23, 4), "world_from_object": ("O", 4, 4), "object_seen": ("O", "M"),
        "joints_3d": ("N", len(JOINTS), 3), "joints_2d": ("N", len(JOINTS), 2), "visibility": ("N", len(JOINTS)),
        "camera_from_world": (4, 4), "world_from_scene": (4, 4), "suit_from_world": (4, 4), "object_from_head": (4, 4),
        "hands": (2, 3), "windows": ("W",), "window_ns": ("W", 2), "actions": ("N",), "rig": (),
    }
)  # fmt: skip


def _check_shapes(values: Mapping[str, NDArray[Any]]) -> None:
    """Raise ValueError for an array that is missing, holds another kind of values, or does not fit the others."""
    sizes: dict[int | str, int] = {}
    for name, wanted in _SHAPES.items():
        if name not in values:
            raise ValueError(f"it has no {name}")
        kinds, array = "U" if name in ("windows", "actions", "rig") else "iufb", values[name]
        found = [sizes.setdefault(letter, size) for letter, size in zip(wanted, array.shape, strict=False)]
        expected = [letter if isinstance(letter, int) else size for letter, size in zip(wanted, found, strict=False)]
        if array.dtype.kind not in kinds or len(array.shape) != len(wanted) or list(array.shape) != expected:
            raise ValueError(f"{name} is {array.dtype} {array.shape}, which does not fit")


def truth_path(take: Path, code: str = "") -> Path:
    """Where the truth of a take lies: take.mcap -> take.truth.npz, or, of one of several people, take.S01.truth.npz."""
    return take.with_suffix(f".{code}.truth.npz" if code else ".truth.npz")


def write_head_take(path: Path, rig: VirtualRig, actor: Actor, *, rng: np.random.Generator) -> Truth:
    """The head turned about each axis, twice, on a still trunk in the car: suit and cap. Windows: flexion, lateral, rotation.

    Raises SceneError where the optical system hardly sees the cap.
    """
    motion = calibrate_head(actor.stage, rng=rng)
    truth = _write(path, rig, Performance([(actor, motion)], "head calibration", motion.duration_s), rng=rng)[0]
    seen = truth.object_seen.sum(axis=1) >= LEAST_MARKERS
    if seen.size and seen.mean() < _SEEN:
        raise SceneError(
            f"the optical system does not see the cap of {actor.code}: the roof of {actor.stage.car} is in between",
            hint="take a car with a higher roof, or somebody smaller; optical_occlusion: false sees through it",
        )
    return truth


def write_action_take(
    path: Path, rig: VirtualRig, actor: Actor, seconds: float, *, rate_hz: float | None = None, sensor: Sensor | None = None,
    rng: np.random.Generator,
) -> Truth:  # fmt: skip
    """A driver's actions: suit, cap and camera. rate_hz: of the camera, where not the rig's · sensor: in place of the rig's."""
    motion = act(actor.stage, seconds, rng=rng)
    played = Performance([(actor, motion)], "drive", seconds)
    return _write(path, rig, played, rate_hz=rate_hz or rig.tof.rate_hz, sensor=sensor, rng=rng)[0]


def write_pair_take(
    path: Path, rig: VirtualRig, actors: tuple[Actor, Actor], seconds: float, *, rate_hz: float | None = None,
    sensor: Sensor | None = None, rng: np.random.Generator,
) -> list[Truth]:  # fmt: skip
    """Two people in one car, each in a seat and a suit of their own; otherwise as `write_action_take`.

    Raises SceneError where no motion of the second person keeps clear of the first one's.
    """
    first = act(actors[0].stage, seconds, rng=rng)
    for _ in range(_TRIES):
        second = act(actors[1].stage, seconds, rng=rng)
        if keep_apart(first, second):
            played = Performance(list(zip(actors, (first, second), strict=True)), "drive", seconds)
            return _write(path, rig, played, rate_hz=rate_hz or rig.tof.rate_hz, sensor=sensor, rng=rng)
    raise SceneError(f"two people touch in each of {_TRIES} draws", hint="try another seed, other people or a wider car")


def write_motion_take(
    path: Path, rig: VirtualRig, actor: Actor, *, rate_hz: float = 0.0, sensor: Sensor | None = None, rng: np.random.Generator
) -> Truth:
    """Movements in each anatomical plane outside the car, between two N-poses: suit, cap and full-body optical model.

    rate_hz: above 0, a camera sees it too, in a room · sensor: in place of the rig's.
    Windows: neutral_first, coronal, sagittal, transversal, neutral_last.
    """
    motion = exercises(actor.person, at_m=(2.6, 0.0), heading=np.pi, rng=rng)
    played = Performance([(actor, motion)], "planes of motion", motion.duration_s)
    return _write(path, rig, played, rate_hz=rate_hz, sensor=sensor, rng=rng)[0]


def write_pose_take(path: Path, rig: VirtualRig, actor: Actor, *, rng: np.random.Generator) -> Truth:
    """The N-pose outside the car, held for some seconds: suit, cap and full-body optical model."""
    motion = stand(actor.person, POSE_S, at_m=(2.6, 0.0), heading=np.pi)
    return _write(path, rig, Performance([(actor, motion)], "initial pose", POSE_S), rng=rng)[0]


def _write(
    path: Path, rig: VirtualRig, played: Performance, *, rate_hz: float = 0.0, sensor: Sensor | None = None,
    rng: np.random.Generator,
) -> list[Truth]:  # fmt: skip
    """Write a take, and the truth of each of its people beside it.

    rate_hz: of the camera; 0 = none sees it. In a room the optical system gives a model of the whole body too.
    """
    people, seconds = played.people, played.seconds
    motion = people[0][1]
    room = motion.cabin is None
    world = world_from_room(rig) if room else world_from_vehicle(rig, motion)
    streams: dict[str, Iterator[Sample]] = {}
    truths: list[dict[str, Any]] = [{} for _ in people]
    for (actor, moves), truth in zip(people, truths, strict=True):
        streams[actor.suit] = suit_samples(rig, actor, moves, world, seconds, truth, rng=rng)
    streams["optical"] = optical_samples(rig, people, world, seconds, truths, rng=rng)
    if rig.tracker is not None:
        streams["tracker"] = _tracker(rig, people, world, seconds, rng=rng.spawn(1)[0])  # all else is drawn as without it
    if rate_hz:
        camera = SceneCamera(rig, [m for _, m in people], world, furnish_room(rng=rng) if room else None, sensor=sensor)
        streams["tof"] = _tof(rig, camera, people, rate_hz, seconds, truths, rng=rng)
    car = "" if room else people[0][0].stage.car
    subjects = tuple(Participant(code=actor.code, seat=None if room else moves.slot) for actor, moves in people)
    with whole_recording(path) as partial:
        write_recording(partial, rig, Take(action=played.action, car=car, subjects=subjects), streams)
    result = []
    for (actor, moves), values in zip(people, truths, strict=True):
        result.append(_truth(rig, actor, moves, world, values))
        result[-1].save(truth_path(path, actor.code if len(people) > 1 else ""))
    return result


def _ticks(
    rig: VirtualRig, source: Source, seconds: float, rate_hz: float = 0.0, *, rng: np.random.Generator
) -> tuple[Times, Times, F64]:
    """True times and arrivals (T,) ns of a source's samples, and the times (T,) s in the motion; rate_hz: not the rig's."""
    device: Device = getattr(rig, source)
    true_ns = rig.clock(source).ticks(rate_hz or device.rate_hz, 0.0, seconds)
    return true_ns, rig.clock(source).arrivals(true_ns, rng=rng), (true_ns - rig.start_ns) / 1e9


def suit_samples(
    rig: VirtualRig, actor: Actor, motion: PersonMotion, world: Matrix, seconds: float, truth: dict[str, Any], *,
    rng: np.random.Generator,
) -> Iterator[Sample]:  # fmt: skip
    """The samples of a suit; what is true goes into `truth`, here and below."""
    true_ns, host_ns, time = _ticks(rig, actor.suit, seconds, rng=rng)
    true = true_segments(motion, time).moved(world)
    steel = None if motion.cabin is None else apply(world, steel_of(motion.cabin, motion.settings))
    worn = as_worn(true, rig.suit_errors, actor.wear, actor.person, steel, rng=rng)
    truth |= {"suit_ns": true_ns, "suit_position": true.position_m, "suit_orientation_wxyz": true.orientation_wxyz}

    def messages(k: int) -> tuple[Message, ...]:
        return (SegmentPoses(actor.code, MVN_SEGMENTS, worn.position_m[k], worn.orientation_wxyz[k]),)

    return samples(rig.clock(actor.suit), true_ns, host_ns, messages)


def optical_samples(
    rig: VirtualRig, people: Sequence[tuple[Actor, PersonMotion]], world: Matrix, seconds: float, truths: list[dict[str, Any]], *,
    rng: np.random.Generator,
) -> Iterator[Sample]:  # fmt: skip
    """The samples of the optical system: all caps, and in a room the full-body models."""
    true_ns, host_ns, time = _ticks(rig, "optical", seconds, rng=rng)
    tracked: list[tuple[str, tuple[str, ...], F64, F64]] = []
    for (actor, motion), truth in zip(people, truths, strict=True):
        cap = actor.cap
        true = true_object(world @ true_segments(motion, time).pose("Head"), cap)
        seen = kept(time, len(cap.names), rng=rng) | (not rig.optical_occlusion)
        if rig.optical_occlusion and motion.cabin is not None:
            seen &= Watch(motion, cap).over(time)
        position, turned = measured_object(true, cap, seen, rig.optical_noise_m, rng=rng)
        tracked.append((actor.head, (HEAD_SEGMENT,), position[:, None], turned[:, None]))
        if motion.cabin is None:
            at, about = measured_model(motion, time, world, rig.optical_noise_m, rng=rng)
            tracked.append((actor.code, MODEL_SEGMENTS, at, about))
        truth |= {"optical_ns": true_ns, "world_from_object": true, "object_seen": seen}

    def messages(k: int) -> tuple[Message, ...]:
        return tuple(SegmentPoses(subject, names, at[k], about[k]) for subject, names, at, about in tracked)

    return samples(rig.clock("optical"), true_ns, host_ns, messages)


def _tracker(
    rig: VirtualRig, people: Sequence[tuple[Actor, KeyedMotion]], world: Matrix, seconds: float, *, rng: np.random.Generator
) -> Iterator[Sample]:
    """The samples of the mobile tracker: a body on each cap."""
    assert rig.tracker is not None
    true_ns, host_ns, time = _ticks(rig, "tracker", seconds, rng=rng)
    bodies = []
    for actor, motion in people:
        true = true_object(world @ true_segments(motion, time).pose("Head"), actor.cap)
        bodies.append((actor.head, *measured_tracker(true, time, rig.tracker, rng=rng)))

    def messages(k: int) -> tuple[Message, ...]:
        return tuple(SegmentPoses(name, (HEAD_SEGMENT,), at[k, None], turned[k, None]) for name, at, turned in bodies)

    return samples(rig.clock("tracker"), true_ns, host_ns, messages)


def _tof(
    rig: VirtualRig, camera: SceneCamera, people: Sequence[tuple[Actor, KeyedMotion]], rate_hz: float, seconds: float,
    truths: list[dict[str, Any]], *, rng: np.random.Generator,
) -> Iterator[Sample]:  # fmt: skip
    """The camera's frames, rendered one by one while they are written."""
    true_ns, host_ns, time = _ticks(rig, "tof", seconds, rate_hz, rng=rng)
    names = ("joints_3d", "joints_2d", "visibility")
    for truth in truths:
        truth |= {"tof_ns": true_ns, "actions": [], **{name: [] for name in names}}

    def messages(k: int) -> tuple[Message, ...]:
        frame = camera.frame(float(time[k]), rng=rng)
        for person, ((_, motion), truth) in enumerate(zip(people, truths, strict=True)):
            for name in names:
                truth[name].append(frame[name][person])
            truth["actions"].append(motion.key_at(float(time[k])))
        return (message_of(frame),)

    return samples(rig.clock("tof"), true_ns, host_ns, messages)


def _truth(rig: VirtualRig, actor: Actor, motion: KeyedMotion, world: Matrix, values: dict[str, Any]) -> Truth:
    joints = len(JOINTS)
    nothing: dict[str, Any] = {
        "tof_ns": np.zeros(0, np.int64), "joints_3d": np.zeros((0, joints, 3)), "joints_2d": np.zeros((0, joints, 2)),
        "visibility": np.zeros((0, joints), np.uint8), "actions": np.zeros(0, np.str_),
    }  # fmt: skip
    spans = np.array([(w.start_s, w.end_s) for w in motion.windows]).reshape(-1, 2)
    return Truth(
        **nothing | {name: np.asarray(value) for name, value in values.items() if len(value)},
        camera_from_world=rig.camera_from_world,
        world_from_scene=world,
        suit_from_world=actor.wear.suit_from_world,
        object_from_head=actor.cap.object_from_head,
        hands=np.stack([hand_offset(actor.person, side) for side in "lr"]),
        windows=np.array([w.name for w in motion.windows], np.str_),
        window_ns=rig.start_ns + np.rint(spans * 1e9).astype(np.int64),
        rig=rig.model_dump_json(exclude_none=True),
    )

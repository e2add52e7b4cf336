"""Takes of the virtual laboratory: recordings as a rig would make them of a person, each with its truth beside it."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from cabinpose.app.lab.exercises import exercises
from cabinpose.app.lab.motion import KeyedMotion, Stage, at_the_wheel, calibrate_head, drive, named_person
from cabinpose.app.lab.optical import (
    HEAD_SEGMENT,
    HEAD_SUBJECT,
    MODEL_SEGMENTS,
    Cap,
    Watch,
    cap_of,
    kept,
    measured_model,
    measured_object,
    true_object,
)
from cabinpose.app.lab.rig import SOURCES, Source, VirtualRig
from cabinpose.app.lab.scene import Stagehand, message_of, world_from_room, world_from_vehicle
from cabinpose.app.lab.suit import Wear, as_worn, hand_offset, put_on, steel_of, true_segments
from cabinpose.core.frames import Matrix, apply
from cabinpose.core.ports import Sample
from cabinpose.core.recorded import Message, SegmentPoses
from cabinpose.core.skeleton import JOINTS, MVN_SEGMENTS
from cabinpose.scene.body import Person
from cabinpose.scene.room import Room, furnish_room
from cabinpose.scene.sensor import Sensor
from cabinpose.store.recording import Participant, RecordingWriter, Take

F64 = NDArray[np.float64]
Times = NDArray[np.int64]

CODE = "S01"


@dataclass(frozen=True, eq=False)
class Actor:
    """Somebody in a suit and with a cap on, for all takes of a session: what is wrong with both stays the same."""

    stage: Stage
    wear: Wear
    cap: Cap
    code: str = CODE

    @property
    def person(self) -> Person:
        return self.stage.person


def dress_up(car: str = "sedan", subject: str = "S01", *, code: str = CODE, rng: np.random.Generator) -> Actor:
    """A person of the package in a preset car, with suit and cap put on. code: by which recordings name the person."""
    wear = put_on(rng=rng)
    return Actor(at_the_wheel(car, subject, rng=rng), wear, cap_of(named_person(subject)), code)


@dataclass(frozen=True, eq=False)
class Truth:
    """What is true of a take. World: the optical system's. Times are true (host) nanoseconds; empty arrays where nothing was.

    suit_ns (T,), optical_ns (O,), tof_ns (N,): when samples were taken · suit_position (T, 23, 3) m and suit_orientation_wxyz
    (T, 23, 4): segments in the world, without the suit's errors · world_from_object (O, 4, 4), object_seen (O, M): the cap, and
    which of its markers enough cameras saw · joints_3d (N, 20, 3) m, camera frame, joints_2d (N, 20, 2) px, visibility (N, 20) ·
    camera_from_world, world_from_scene (vehicle or room), suit_from_world, object_from_head (4, 4) · hands (2, 3) m: our joints
    lhand, rhand in MVN's hand segments · windows (W,): names; window_ns (W, 2) · actions (N,): what the person is
    about · rig: as JSON; its clocks tell the stamps.
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
        np.savez_compressed(path, **values)

    @classmethod
    def load(cls, path: Path) -> Self:
        """Read what `save` wrote."""
        with np.load(path) as file:
            values: dict[str, Any] = {f.name: file[f.name] for f in fields(cls)}
        return cls(**{**values, "rig": str(values["rig"])})


def truth_path(take: Path) -> Path:
    """Where the truth of a take lies: take.mcap -> take.truth.npz."""
    return take.with_suffix(".truth.npz")


def write_head_take(path: Path, rig: VirtualRig, actor: Actor, *, rng: np.random.Generator) -> Truth:
    """The head turned about each axis, twice, on a still trunk in the car: suit and cap. Windows: flexion, lateral, rotation."""
    return _in_car(path, rig, actor, calibrate_head(actor.stage, rng=rng), "head calibration", None, 0.0, None, rng)


def write_action_take(
    path: Path, rig: VirtualRig, actor: Actor, seconds: float, *, rate_hz: float | None = None, sensor: Sensor | None = None,
    rng: np.random.Generator,
) -> Truth:  # fmt: skip
    """A driver's doings: suit, cap and camera. rate_hz: of the camera, where not the rig's · sensor: in place of the rig's."""
    motion = drive(actor.stage, seconds, rng=rng)
    return _in_car(path, rig, actor, motion, "drive", seconds, rate_hz or rig.tof.rate_hz, sensor, rng)


def write_motion_take(
    path: Path, rig: VirtualRig, actor: Actor, *, rate_hz: float = 0.0, sensor: Sensor | None = None, rng: np.random.Generator
) -> Truth:
    """Movements in each anatomical plane outside the car, between two N-poses: suit, cap and full-body optical model.

    rate_hz: above 0, a camera sees it too, in a room · sensor: in place of the rig's.
    Windows: neutral_first, coronal, sagittal, transversal, neutral_last.
    """
    world = world_from_room(rig)
    motion = exercises(actor.person, at_m=(2.6, 0.0), heading=np.pi, rng=rng)
    session = _Session(path, rig, actor, motion, world, motion.duration_s, rng)
    session.add_suit(None)
    session.add_optical(whole_body=True)
    if rate_hz:
        session.add_tof(rate_hz, furnish_room(rng=rng), sensor)
    return session.write("planes of motion", "")


def _in_car(
    path: Path, rig: VirtualRig, actor: Actor, motion: KeyedMotion, action: str, seconds: float | None, tof_hz: float,
    sensor: Sensor | None, rng: np.random.Generator,
) -> Truth:  # fmt: skip
    world = world_from_vehicle(rig, motion)
    session = _Session(path, rig, actor, motion, world, seconds or motion.duration_s, rng)
    session.add_suit(apply(world, steel_of(actor.stage.cabin, actor.stage.settings)))
    session.add_optical(whole_body=False)
    if tof_hz:
        session.add_tof(tof_hz, None, sensor)
    return session.write(action, actor.stage.car)


@dataclass
class _Stream:
    """One source's samples: true, device and host times (T,), and the messages of each, made in their order."""

    true_ns: Times
    device_ns: Times
    host_ns: Times
    messages: Callable[[int], tuple[Message, ...]]


@dataclass
class _Session:
    """A take in the making: streams are added, then all is written in the order of arrival."""

    path: Path
    rig: VirtualRig
    actor: Actor
    motion: KeyedMotion
    world_from_scene: Matrix
    seconds: float
    rng: np.random.Generator
    streams: dict[Source, _Stream] = field(default_factory=dict)
    truth: dict[str, Any] = field(default_factory=dict)

    def add_suit(self, steel: F64 | None) -> None:
        """Steel: (N, 3) m in the world."""
        time = self._clock("suit", self.rig.suit.rate_hz)
        true = true_segments(self.motion, time).moved(self.world_from_scene)
        worn = as_worn(true, self.rig.suit_errors, self.actor.wear, self.actor.person, steel, rng=self.rng)
        self._say("suit", lambda k: (_poses(self.actor.code, MVN_SEGMENTS, worn.position_m[k], worn.orientation_wxyz[k]),))
        self.truth |= {"suit_position": true.position_m, "suit_orientation_wxyz": true.orientation_wxyz}

    def add_optical(self, *, whole_body: bool) -> None:
        """The cap, and the full-body model where it is asked for."""
        cap, rig = self.actor.cap, self.rig
        time = self._clock("optical", rig.optical.rate_hz)
        head = self.world_from_scene @ true_segments(self.motion, time).pose("Head")
        true = true_object(head, cap)
        seen = kept(time, len(cap.names), rng=self.rng) | (not rig.optical_occlusion)
        if rig.optical_occlusion and self.motion.cabin is not None:
            seen &= Watch(self.motion, cap).over(time)
        position, turned = measured_object(true, cap, seen, rig.optical_noise_m, rng=self.rng)
        if not whole_body:
            self._say("optical", lambda k: (_poses(HEAD_SUBJECT, (HEAD_SEGMENT,), position[k, None], turned[k, None]),))
        else:
            at, about = measured_model(self.motion, time, self.world_from_scene, rig.optical_noise_m, rng=self.rng)
            self._say(
                "optical",
                lambda k: (
                    _poses(HEAD_SUBJECT, (HEAD_SEGMENT,), position[k, None], turned[k, None]),
                    _poses(self.actor.code, MODEL_SEGMENTS, at[k], about[k]),
                ),
            )
        self.truth |= {"world_from_object": true, "object_seen": seen}

    def add_tof(self, rate_hz: float, room: Room | None, sensor: Sensor | None) -> None:
        """The camera's frames, rendered one by one while they are written."""
        time = self._clock("tof", rate_hz)
        hand = Stagehand(self.rig, self.motion, self.world_from_scene, room, sensor=sensor)
        frames: dict[str, list[Any]] = {"joints_3d": [], "joints_2d": [], "visibility": [], "actions": []}

        def messages(k: int) -> tuple[Message, ...]:
            frame = hand.frame(float(time[k]), rng=self.rng)
            for name in ("joints_3d", "joints_2d", "visibility"):
                frames[name].append(frame[name])
            frames["actions"].append(self.motion.key_at(float(time[k])))
            return (message_of(frame),)

        self._say("tof", messages)
        self.truth |= frames

    def write(self, action: str, car: str) -> Truth:
        """Write recording and truth."""
        seat = "driver" if car else None
        take = Take(action=action, car=car, subjects=(Participant(code=self.actor.code, seat=seat),))
        with RecordingWriter(self.path, take, started_ns=self.rig.start_ns, flush_s=np.inf, sync_s=0.0) as writer:
            for source, k in _in_order(self.streams):
                stream = self.streams[source]
                sample = Sample(k, int(stream.host_ns[k]), int(stream.device_ns[k]), b"", stream.messages(k))
                writer.write(source, sample)
        truth = self._truth()
        truth.save(truth_path(self.path))
        return truth

    def _clock(self, source: Source, rate_hz: float) -> F64:
        """Times (T,) s of a source's samples in the motion; their stamps are noted."""
        clock = self.rig.clock(source)
        true_ns = clock.ticks(rate_hz, 0.0, self.seconds)
        host_ns = clock.arrivals(true_ns, rng=self.rng)
        self.streams[source] = _Stream(true_ns, clock.stamps(true_ns), host_ns, lambda _: ())
        return (true_ns - self.rig.start_ns) / 1e9

    def _say(self, source: Source, messages: Callable[[int], tuple[Message, ...]]) -> None:
        self.streams[source].messages = messages

    def _truth(self) -> Truth:
        joints = len(JOINTS)
        values: dict[str, Any] = {
            "joints_3d": np.zeros((0, joints, 3)), "joints_2d": np.zeros((0, joints, 2)),
            "visibility": np.zeros((0, joints), np.uint8), "actions": np.zeros(0, np.str_),
        }  # fmt: skip
        values |= {name: np.asarray(value) for name, value in self.truth.items() if len(value)}
        for source in SOURCES:
            values[f"{source}_ns"] = self.streams[source].true_ns if source in self.streams else np.zeros(0, np.int64)
        windows = self.motion.windows
        spans = np.array([(w.start_s, w.end_s) for w in windows]).reshape(-1, 2)
        return Truth(
            **values,
            camera_from_world=self.rig.camera_from_world,
            world_from_scene=self.world_from_scene,
            suit_from_world=self.actor.wear.suit_from_world,
            object_from_head=self.actor.cap.object_from_head,
            hands=np.stack([hand_offset(self.actor.person, side) for side in "lr"]),
            windows=np.array([w.name for w in windows], np.str_),
            window_ns=self.rig.start_ns + np.rint(spans * 1e9).astype(np.int64),
            rig=self.rig.model_dump_json(),
        )


def _poses(subject: str, names: tuple[str, ...], position: F64, orientation: F64) -> SegmentPoses:
    return SegmentPoses(subject, names, position, orientation)


def _in_order(streams: Mapping[Source, _Stream]) -> Iterable[tuple[Source, int]]:
    """Source and number of all samples by arrival; those of one instant in the order of the streams."""
    sources = list(streams)
    host = np.concatenate([streams[source].host_ns for source in sources])
    which = np.repeat(np.arange(len(sources)), [len(streams[source].host_ns) for source in sources])
    number = np.concatenate([np.arange(len(streams[source].host_ns)) for source in sources])
    for k in np.argsort(host, kind="stable"):
        yield sources[which[k]], int(number[k])

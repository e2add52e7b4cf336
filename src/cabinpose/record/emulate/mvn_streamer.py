"""What MVN would stream of a motion: the datagrams of each sample, of all types, without a socket."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Annotated, Any, Literal, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field, model_validator

from cabinpose.core import MVN_JOINTS, MVN_SEGMENTS
from cabinpose.record.emulate.mvn_motion import SuitMotion, offset_m
from cabinpose.record.sources import mvn_protocol as mvn
from cabinpose.record.sources.mvn_messages import (
    CM,
    FINGER_SEGMENTS,
    GRAVITY,
    UNITY_SEGMENTS,
    Z_UP_FROM_UNITY,
    Z_UP_FROM_Y_UP,
    rotate_wxyz,
    rotated_frame_wxyz,
    wxyz_to_euler,
)
from cabinpose.record.sources.mvn_protocol import Header, ScalePoint
from cabinpose.signals import F64, conjugate, product

Probability = Annotated[float, Field(ge=0, le=1)]
_INDEX = {name: i for i, name in enumerate(MVN_SEGMENTS)}
_PARENT = {child: parent for _, parent, child in MVN_JOINTS}
# The suit's 17 trackers, and how the emulator mounts each: turned about x, so that sensor and segment differ.
_TRACKED = tuple(n for n in MVN_SEGMENTS if n not in ("L5", "L3", "T12", "Neck", "RightToe", "LeftToe"))
_MOUNT_WXYZ: F64 = np.array([np.cos(0.4), np.sin(0.4), 0.0, 0.0])
NORTH: F64 = np.array([0.4, 0.0, -0.9])  # the magnetic field in the world, of about unit length
_SIDE_BY_SIDE_M = 1.0  # between characters


class MvnEmulatorSettings(BaseModel):
    """What is streamed, where to, and what the network does to it."""

    model_config = ConfigDict(extra="forbid", frozen=True, use_attribute_docstrings=True)

    host: str = "127.0.0.1"
    """Where to send to (`listen`: where to be reached)."""
    port: Annotated[int, Field(ge=0, le=65535)] = mvn.DEFAULT_PORT
    """Port; 0 with `listen` takes a free one."""
    transport: Literal["udp", "tcp", "listen"] = "udp"
    """udp, or tcp by connecting as MVN does, or tcp by waiting for a connection."""
    rate_hz: Annotated[float, Field(gt=0, le=100_000)] = 60.0
    """Samples a second that are sent."""
    capture_rate_hz: Annotated[float | None, Field(gt=0)] = None
    """Samples a second that are counted, at least rate_hz; default: the same."""
    kinds: tuple[Literal[1, 2, 3, 5, 20, 21, 22, 23, 24, 25], ...] = (2,)
    """Types of datagrams with each sample."""
    meta_every_s: Annotated[float, Field(ge=0)] = 1.0
    """Seconds between names and scales (types 12 and 13); 0 leaves them out."""
    characters: Annotated[int, Field(ge=1, le=255)] = 1
    """People, side by side, with the same motion at other phases."""
    props: Annotated[int, Field(ge=0, le=4)] = 0
    """Props that each holds in the right hand (types 01, 02, 21 and 22)."""
    fingers: bool = False
    """40 finger segments each (types 01, 02, 21 and 22), which split a sample over several datagrams in a network."""
    long_trackers: bool = True
    """Trackers of 68 bytes, with acceleration and angular velocity; else of 44."""
    centimetres: bool = False
    """Positions of type 02 in centimetres, as the specification has it; else in metres, as MVN sends them."""
    items_per_datagram: Annotated[int | None, Field(ge=1)] = None
    """Items that one datagram carries; more split a sample."""
    start_counter: Annotated[int, Field(ge=0, lt=1 << 32)] = 0
    """Sample counter at the start; it wraps after 32 bits."""
    latency_s: Annotated[float, Field(ge=0)] = 0.0
    """From when a sample is taken to when it is sent."""
    clock_offset_s: Annotated[float, Field(ge=0)] = 0.0
    """What the sender's clock shows at the start."""
    clock_drift_ppm: Annotated[float, Field(gt=-1e6)] = 0.0
    """How much faster than true time the sender's clock runs, millionths."""
    loss: Probability = 0.0
    """Share of datagrams that never arrive."""
    duplicate: Probability = 0.0
    """Share of datagrams that arrive twice."""
    reorder: Probability = 0.0
    """Share of datagrams that arrive after later ones."""
    reorder_by: Annotated[int, Field(ge=1)] = 3
    """By how many datagrams those are late."""
    seed: int = 0
    """Seed of what the network does."""

    @model_validator(mode="after")
    def _possible(self) -> Self:
        if self.capture_rate_hz is not None and self.capture_rate_hz < self.rate_hz:
            raise ValueError("capture_rate_hz is lower than rate_hz")
        if self.transport != "udp" and (self.loss or self.duplicate or self.reorder):
            raise ValueError("tcp neither loses nor doubles nor reorders")
        return self


@dataclass(frozen=True)
class Datagram:
    """Bytes to send, and where they belong."""

    kind: int
    character: int
    counter: int
    piece: int
    pieces: int
    time_ms: int
    data: bytes


class Streamer:
    """Makes the datagrams of each sample."""

    def __init__(self, settings: MvnEmulatorSettings, motion: SuitMotion) -> None:
        self.settings, self.motion = settings, motion
        self._step = (settings.capture_rate_hz or settings.rate_hz) / settings.rate_hz
        self._meta_step = round(settings.meta_every_s * settings.rate_hz)

    def sample(self, number: int) -> Iterator[Datagram]:
        """The datagrams of the sample with this number, from 0, of all characters and types."""
        settings = self.settings
        time_s = number / settings.rate_hz
        shown_s = settings.clock_offset_s + time_s * (1 + settings.clock_drift_ppm * 1e-6)
        counter = (settings.start_counter + round(number * self._step)) % (1 << 32)
        time_ms = round(shown_s * 1000) % (1 << 32)
        fingers = len(FINGER_SEGMENTS) if settings.fingers else 0
        for character in range(settings.characters):
            header = Header(0, counter, 0, True, 1, time_ms, character, len(MVN_SEGMENTS), settings.props, fingers, 0)
            frame = self.motion.frame(time_s + 0.37 * character)
            if self._meta_step and number % self._meta_step == 0:
                yield from self._meta(header)
            for kind in settings.kinds:
                payload, items = self._payload(kind, frame, character, time_ms)
                pieces = mvn.build_sample(header._replace(kind=kind, items=items), payload, pieces_of=settings.items_per_datagram)
                for i, data in enumerate(pieces):
                    yield Datagram(kind, character, counter, i, len(pieces), time_ms, data)

    def poses(self, frame: int, character: int) -> tuple[F64, F64]:
        """Positions (N, 3) m and orientations (N, 4) of a character's segments, props and fingers, as they are streamed."""
        position = self.motion.position_m[frame] + (0.0, character * _SIDE_BY_SIDE_M, 0.0)
        held = self._held()
        return position[held], self.motion.orientation_wxyz[frame][held]

    def _held(self) -> list[int]:
        """The segment that each item moves with: itself, or the hand that holds a prop or has the finger."""
        settings = self.settings
        fingers = FINGER_SEGMENTS if settings.fingers else ()
        hands = ["RightHand"] * settings.props + ["LeftHand" if name.startswith("Left") else "RightHand" for name in fingers]
        return [*range(len(MVN_SEGMENTS)), *(_INDEX[hand] for hand in hands)]

    def _payload(self, kind: int, frame: int, character: int, time_ms: int) -> tuple[bytes, int]:
        """The payload of one type, and the number of its items."""
        if kind == mvn.CENTRE_OF_MASS:
            position, _ = self.poses(frame, character)
            return position[: len(MVN_SEGMENTS)].mean(axis=0).astype(">f4").tobytes(), 1
        if kind == mvn.TIME_CODE:
            seconds, rest = divmod(time_ms, 1000)
            code = f"{seconds // 3600 % 24:02d}:{seconds // 60 % 60:02d}:{seconds % 60:02d}.{rest:03d}"
            return mvn.build_text(code), 1
        fields = _FIELDS[kind](self, frame, character)
        return mvn.build_items(kind, fields, long_trackers=self.settings.long_trackers), len(fields["id"])

    def _euler(self, frame: int, character: int) -> dict[str, Any]:
        position, orientation = self.poses(frame, character)
        euler = wxyz_to_euler(rotated_frame_wxyz(orientation, Z_UP_FROM_Y_UP.T))
        return {"id": _ids(position), "position": position @ Z_UP_FROM_Y_UP / CM, "euler_deg": euler}

    def _quaternion(self, frame: int, character: int) -> dict[str, Any]:
        position, orientation = self.poses(frame, character)
        unit = CM if self.settings.centimetres else 1.0
        return {"id": _ids(position), "position": position / unit, "orientation_wxyz": orientation}

    def _points(self, frame: int, character: int) -> dict[str, Any]:
        """The origin of each segment, as its first point."""
        position = self.poses(frame, character)[0][: len(MVN_SEGMENTS)]
        return {"id": _ids(position) * mvn.SEGMENT_STRIDE + 1, "position": position @ Z_UP_FROM_Y_UP / CM}

    def _unity(self, frame: int, character: int) -> dict[str, Any]:
        position, orientation = self.poses(frame, character)
        at, turn = [], []
        for name in UNITY_SEGMENTS:
            own = slice(_INDEX[name], _INDEX[name] + 1)
            p, q = position[own], orientation[own]
            if name in _PARENT:
                up = slice(_INDEX[_PARENT[name]], _INDEX[_PARENT[name]] + 1)
                p = rotate_wxyz(orientation[up], p - position[up], inverse=True)
                q = product(conjugate(orientation[up]), q)
            at.append(p)
            turn.append(q)
        positions = np.concatenate(at) @ Z_UP_FROM_UNITY
        orientations = rotated_frame_wxyz(np.concatenate(turn), Z_UP_FROM_UNITY.T)
        return {"id": _ids(positions), "position": positions, "orientation_wxyz": orientations}

    def _angles(self, frame: int, _: int) -> dict[str, Any]:
        ends = np.array([[_INDEX[parent] + 1, _INDEX[child] + 1] for _, parent, child in MVN_JOINTS]) * mvn.SEGMENT_STRIDE + 1
        return {"id": ends[:, 0], "child": ends[:, 1], "angles_deg": np.degrees(self.motion.joint_angles[frame])}

    def _linear(self, frame: int, character: int) -> dict[str, Any]:
        position, _ = self.poses(frame, character)
        held, motion = self._held(), self.motion
        speed, acceleration = motion.velocity[frame][held], motion.acceleration[frame][held]
        return {"id": _ids(position), "position": position, "velocity": speed, "acceleration": acceleration}

    def _angular(self, frame: int, character: int) -> dict[str, Any]:
        _, orientation = self.poses(frame, character)
        held, motion = self._held(), self.motion
        speed, change = motion.angular_velocity[frame][held], motion.angular_acceleration[frame][held]
        return {
            "id": _ids(orientation),
            "orientation_wxyz": orientation,
            "angular_velocity": speed,
            "angular_acceleration": change,
        }

    def _trackers(self, frame: int, _: int) -> dict[str, Any]:
        tracked = [_INDEX[name] for name in _TRACKED]
        orientation = product(self.motion.orientation_wxyz[frame][tracked], _MOUNT_WXYZ)
        free = self.motion.acceleration[frame][tracked]
        return {
            "id": np.array(tracked) + 1,
            "orientation_wxyz": orientation,
            "free_acceleration": free,
            "acceleration": rotate_wxyz(orientation, free + GRAVITY, inverse=True),
            "angular_velocity": rotate_wxyz(orientation, self.motion.angular_velocity[frame][tracked], inverse=True),
            "magnetic_field": rotate_wxyz(orientation, np.tile(NORTH, (len(tracked), 1)), inverse=True),
        }

    def _meta(self, header: Header) -> Iterator[Datagram]:
        """Name and scale; the points of the scale in a datagram of their own, as MVN sends them."""
        tags = {"name": f"Character {header.character}", "xmid": f"{header.character:08X}", "color": "E96417"}
        origins = {"Pelvis": offset_m("Pelvis")}
        for name in MVN_SEGMENTS[1:]:
            x, y, z = (a + b for a, b in zip(origins[_PARENT[name]], offset_m(name), strict=True))
            origins[name] = (x, y, z)
        points = [ScalePoint(i, 1, f"j{name}", 0, (0.0, 0.0, 0.0)) for i, name in enumerate(MVN_SEGMENTS, 1)]
        payloads = [(mvn.META, mvn.build_meta(tags)), (mvn.SCALE, mvn.build_scale(origins, []))]
        payloads.append((mvn.SCALE, mvn.build_scale({}, points)))
        for kind, payload in payloads:
            (data,) = mvn.build_sample(header._replace(kind=kind), payload)
            yield Datagram(kind, header.character, header.sample, 0, 1, header.time_ms, data)


def _ids(items: F64) -> NDArray[np.int64]:
    return np.arange(1, len(items) + 1, dtype=np.int64)


_FIELDS = {
    mvn.EULER: Streamer._euler,
    mvn.QUATERNION: Streamer._quaternion,
    mvn.POINTS: Streamer._points,
    mvn.UNITY: Streamer._unity,
    mvn.JOINT_ANGLES: Streamer._angles,
    mvn.LINEAR: Streamer._linear,
    mvn.ANGULAR: Streamer._angular,
    mvn.TRACKERS: Streamer._trackers,
}

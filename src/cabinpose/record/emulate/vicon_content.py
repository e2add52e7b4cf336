"""What an emulated DataStream server says: the packet of a frame number, from a motion and a seed alone."""

from __future__ import annotations

from typing import Annotated, Literal, NamedTuple

import numpy as np
from pydantic import BaseModel, ConfigDict, Field

from cabinpose.core import ZUP_FROM_YUP
from cabinpose.record.emulate.vicon_motion import MarkerMotion, SubjectMotion
from cabinpose.record.sources import vicon_protocol as vicon
from cabinpose.record.sources.vicon_protocol import STATIC, Contents, Packet, Rows, SegmentInfo, SubjectInfo, Type
from cabinpose.signals import F64

OFFERED = frozenset(Type) - {Type.OBJECT_ENUMS, Type.REQUEST_FRAME, Type.REQUEST_NEXT_FRAME}
_ANSWERS = frozenset({Type.PING, Type.CONTENTS})  # of no frame
_LATENCY_PARTS = (("Camera", 0.5), ("Reconstruct", 0.3), ("Label", 0.2))  # what a latency consists of
_MARKER_RADIUS_MM = 7.0


class Outage(NamedTuple):
    """The server is dead from `after_s` after its start, for `for_s`; `anew`: it then counts frames from the first again."""

    after_s: float
    for_s: float
    anew: bool = False


class ViconEmulatorSettings(BaseModel):
    """How the emulated server behaves."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    host: str = "127.0.0.1"
    """Address to listen on; loopback, unless others shall connect."""
    port: Annotated[int, Field(ge=0, le=65535)] = 0
    """Port to listen on; 0 takes a free one. The vendor's is 801, which most systems keep for the administrator."""
    rate_hz: Annotated[float | None, Field(gt=0, le=20_000)] = None
    """Frames a second; default: the motion's (generated: 100)."""
    first_frame: Annotated[int, Field(ge=1, lt=vicon.FRAME_COUNTER)] = 1
    """Number of the first frame, as the SDK tells it: how far the server's frame clock was when we came."""
    drift_ppm: Annotated[float, Field(ge=-100_000, le=100_000)] = 0.0
    """By how much the server's clock runs fast, in millionths."""
    latency_s: Annotated[float, Field(ge=0, le=10)] = 0.0
    """From a frame's capture to its sending, as the server reports it too."""
    drop: Annotated[float, Field(ge=0, le=1)] = 0.0
    """Share of frames that are never sent."""
    occlude_markers: Annotated[float, Field(ge=0, le=1)] = 0.0
    """Share of markers not seen, drawn for each frame."""
    occlude_segments: Annotated[float, Field(ge=0, le=1)] = 0.0
    """Share of segments not solved, drawn for each frame."""
    up: Literal["z", "y"] = "z"
    """The server's vertical axis."""
    outages: tuple[Outage, ...] = ()
    """When it dies and returns."""
    seed: Annotated[int, Field(ge=0)] = 0
    """Seed of what is dropped and occluded."""


class ViconContent:
    """Frames of a motion, as the settings say."""

    def __init__(self, motion: MarkerMotion, settings: ViconEmulatorSettings) -> None:
        self.motion, self._settings = motion, settings
        self._subjects = [_Subject(i + 1, subject) for i, subject in enumerate(motion.subjects)]
        self._rate_hz = settings.rate_hz or motion.rate_hz
        self._latency = tuple((name, share * settings.latency_s) for name, share in _LATENCY_PARTS)
        self._server = ZUP_FROM_YUP.T if settings.up == "y" else np.eye(3)

    def frame(self, number: int) -> Packet:
        """Everything but the statics; number: the SDK's, which begins with 1."""
        rng = np.random.Generator(np.random.Philox(key=(self._settings.seed, number)))
        index = (number - 1) % self.motion.frames
        packet = Packet(frame=number, hardware_frame=number, rates={"Camera": self._rate_hz}, latency=self._latency)
        labeled = [np.empty(0, vicon.LABELED)]
        for subject in self._subjects:
            solved = rng.random(len(subject.motion.segments)) >= self._settings.occlude_segments
            packet.global_segments[subject.identity] = subject.global_rows(index, self._server, solved)
            packet.local_segments[subject.identity] = subject.local_rows(index, self._server, solved)
            draw = rng.random(len(subject.motion.markers))
            labeled.append(subject.marker_rows(index, self._server, draw, self._settings.occlude_markers))
        packet.labeled = np.concatenate(labeled)
        packet.unlabeled = _loose_rows(self.motion.loose_m[index] @ self._server.T)
        return packet

    def packet(self, number: int, wanted: frozenset[int], *, statics: bool) -> Packet:
        """Of a frame, what a client wants; with a table of contents, if it wants that."""
        packet = self.frame(number)
        if statics:
            packet.period = round(vicon.TICKS_PER_SECOND / self._rate_hz)
            packet.y_up = self._settings.up == "y"
            packet.subjects = [subject.info for subject in self._subjects]
            for subject in self._subjects:
                every = np.ones(len(subject.motion.segments), bool)
                packet.neutral[subject.identity] = subject.local_rows(0, self._server, every)
        return _selected(packet, wanted, frozenset() if statics else STATIC & wanted)

    def dropped(self, number: int) -> bool:
        """Whether the frame is never sent."""
        rng = np.random.Generator(np.random.Philox(key=(self._settings.seed + 1, number)))
        return bool(rng.random() < self._settings.drop)


class _Subject:
    """A subject's motion as the server tells it: ids from 1, since 0 is no parent."""

    def __init__(self, identity: int, motion: SubjectMotion) -> None:
        self.identity, self.motion = identity, motion
        segments = (
            SegmentInfo(parent + 1, i + 1, name)
            for i, (name, parent) in enumerate(zip(motion.segments, motion.parents, strict=True))
        )
        markers = tuple((i + 1, name) for i, name in enumerate(motion.markers))
        attachments = tuple((i + 1, segment + 1) for i, segment in enumerate(motion.attached))
        self.info = SubjectInfo(identity, motion.name, tuple(segments), markers, attachments)

    def global_rows(self, index: int, server: F64, solved: Rows) -> Rows:
        return _segment_rows(self.motion.position_m[index], self.motion.rotation[index], server, solved)

    def local_rows(self, index: int, server: F64, solved: Rows) -> Rows:
        """In the parent's frame; the root in the world's."""
        position, rotation = self.motion.position_m[index], self.motion.rotation[index]
        parents = np.array(self.motion.parents)
        root = (parents < 0)[:, None, None]
        back = np.where(root, np.eye(3), rotation[parents]).transpose(0, 2, 1)
        from_parent = position - np.where(root[..., 0], 0.0, position[parents])
        return _segment_rows((back @ from_parent[..., None])[..., 0], back @ rotation, server, solved)

    def marker_rows(self, index: int, server: F64, draw: F64, occlude: float) -> Rows:
        points = self.motion.marker_m[index]
        seen = (draw >= occlude) & np.isfinite(points).all(axis=1)
        rows = np.zeros(int(seen.sum()), vicon.LABELED)
        rows["subject"], rows["marker"] = self.identity, np.flatnonzero(seen) + 1
        rows["trajectory"] = rows["marker"]
        rows["radius"], rows["position"] = _MARKER_RADIUS_MM, points[seen] @ server.T * 1e3
        return rows


def _segment_rows(position_m: F64, rotation: F64, server: F64, solved: Rows) -> Rows:
    """Poses on the axes of the server, which both the world and the frames of the segments have."""
    solved = solved & np.isfinite(position_m).all(axis=1)
    rows = np.zeros(int(solved.sum()), vicon.SEGMENT)
    rows["segment"] = np.flatnonzero(solved) + 1
    rows["translation"] = position_m[solved] @ server.T * 1e3
    rows["rotation"] = (server @ rotation[solved] @ server.T).reshape(-1, 9)
    return rows


def _loose_rows(points_m: F64) -> Rows:
    seen = np.isfinite(points_m).all(axis=1)
    rows = np.zeros(int(seen.sum()), vicon.UNLABELED)
    rows["radius"], rows["position"], rows["trajectory"] = _MARKER_RADIUS_MM, points_m[seen] * 1e3, np.flatnonzero(seen) + 1
    return rows


def _selected(packet: Packet, wanted: frozenset[int], unchanged: frozenset[int]) -> Packet:
    """Of a packet, what a client wants; with the table of contents, if it wants that."""
    chosen, counts = Packet(), {}
    for kind, block in vicon.BLOCKS.items():
        if kind in wanted & OFFERED - _ANSWERS:
            value = getattr(packet, block.field)
            setattr(chosen, block.field, value)
            counts[int(kind)] = len(value) if block.each else int(value is not None)
    if Type.CONTENTS in wanted:
        chosen.contents = Contents(counts, frozenset(int(kind) for kind in unchanged))
    return chosen

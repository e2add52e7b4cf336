"""What an emulated DataStream server says: the packet of a frame number, from a motion and a seed alone."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from cabinpose.core.frames import ZUP_FROM_YUP
from cabinpose.core.recorded import F64
from cabinpose.record.emulate.vicon_motion import Motion, SubjectMotion
from cabinpose.record.sources import vicon_protocol as vicon
from cabinpose.record.sources.vicon_protocol import STATIC, Contents, Packet, Rows, SegmentInfo, SubjectInfo, Type

OFFERED = frozenset(Type) - {Type.OBJECT_ENUMS, Type.REQUEST_FRAME, Type.REQUEST_NEXT_FRAME}
_LATENCY_PARTS = (("Camera", 0.5), ("Reconstruct", 0.3), ("Label", 0.2))  # what a latency consists of
_MARKER_RADIUS_MM = 7.0


class ViconContent:
    """Frames of a motion, as `emulate.vicon.ViconEmulatorSettings` says."""

    def __init__(
        self,
        motion: Motion,
        *,
        rate_hz: float,
        latency_s: float = 0.0,
        drop: float = 0.0,
        occlude_markers: float = 0.0,
        occlude_segments: float = 0.0,
        y_up: bool = False,
        seed: int = 0,
    ) -> None:
        self.motion = motion
        self._subjects = [_Subject(i + 1, subject) for i, subject in enumerate(motion.subjects)]
        self._rate_hz, self._drop, self._seed = rate_hz, drop, seed
        self._occlude_markers, self._occlude_segments = occlude_markers, occlude_segments
        self._latency = tuple((name, share * latency_s) for name, share in _LATENCY_PARTS)
        self._y_up, self._server = y_up, ZUP_FROM_YUP.T if y_up else np.eye(3)

    def frame(self, number: int) -> Packet:
        """Everything but the statics; number: the SDK's, which begins with 1."""
        rng = np.random.Generator(np.random.Philox(key=(self._seed, number)))
        index = (number - 1) % self.motion.frames
        packet = Packet(frame=number, hardware_frame=number, rates={"Camera": self._rate_hz}, latency=self._latency)
        labeled = [np.empty(0, vicon.LABELED)]
        for subject in self._subjects:
            solved = rng.random(len(subject.motion.segments)) >= self._occlude_segments
            packet.global_segments[subject.identity] = subject.global_rows(index, self._server, solved)
            packet.local_segments[subject.identity] = subject.local_rows(index, self._server, solved)
            draw = rng.random(len(subject.motion.markers))
            labeled.append(subject.marker_rows(index, self._server, draw, self._occlude_markers))
        packet.labeled = np.concatenate(labeled)
        packet.unlabeled = _loose_rows(self.motion.loose_m[index] @ self._server.T)
        return packet

    def packet(self, number: int, wanted: frozenset[int], *, statics: bool) -> Packet:
        """Of a frame, what a client wants; with a table of contents, if it wants that."""
        packet = self.frame(number)
        if statics:
            packet.period = round(vicon.TICKS_PER_SECOND / self._rate_hz)
            packet.y_up = self._y_up
            packet.subjects = [subject.info for subject in self._subjects]
            for subject in self._subjects:
                every = np.ones(len(subject.motion.segments), bool)
                packet.neutral[subject.identity] = subject.local_rows(0, self._server, every)
        return _selected(packet, wanted, frozenset() if statics else STATIC & wanted)

    def dropped(self, number: int) -> bool:
        """Whether the frame is never sent."""
        rng = np.random.Generator(np.random.Philox(key=(self._seed + 1, number)))
        return bool(rng.random() < self._drop)


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


_FIELDS: Sequence[tuple[Type, str]] = (
    (Type.STREAM_INFO, "period"), (Type.SUBJECT_INFO, "subjects"), (Type.SUBJECT_TOPOLOGY, "neutral"),
    (Type.APPLICATION_INFO, "y_up"), (Type.FRAME_INFO, "frame"), (Type.HARDWARE_FRAME_INFO, "hardware_frame"),
    (Type.FRAME_RATE_INFO, "rates"), (Type.LATENCY_INFO, "latency"), (Type.LABELED_RECONS, "labeled"),
    (Type.UNLABELED_RECONS, "unlabeled"), (Type.GLOBAL_SEGMENTS, "global_segments"), (Type.LOCAL_SEGMENTS, "local_segments"),
)  # fmt: skip


def _selected(packet: Packet, wanted: frozenset[int], unchanged: frozenset[int]) -> Packet:
    """Of a packet, what a client wants; with the table of contents, if it wants that."""
    chosen, counts = Packet(), {}
    for kind, name in _FIELDS:
        if kind in wanted:
            value = getattr(packet, name)
            setattr(chosen, name, value)
            counts[int(kind)] = len(value) if isinstance(value, (list, dict)) and name != "rates" else int(value is not None)
    if Type.CONTENTS in wanted:
        chosen.contents = Contents(counts, frozenset(int(kind) for kind in unchanged))
    return chosen

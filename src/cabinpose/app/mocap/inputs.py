"""Motions as arrays, from a recording of ours or from a file of a suit or an optical system."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from itertools import islice
from pathlib import Path
from typing import Any, Literal, Protocol

import numpy as np
from numpy.typing import NDArray

from cabinpose.align import on_host
from cabinpose.core import AlignmentError, ConfigError, RecordingError, unknown_name
from cabinpose.evaluate.mocap import HAND_ENDS, JOINT_PAIRS, SEGMENT_PAIRS, Window, segment_poses
from cabinpose.signals import Channels, Facts, Markers, Message, SegmentPoses, SensorReadings, conjugate, product
from cabinpose.store.convert import motion_rows, of_one_subject
from cabinpose.store.recording import Recording, marker_series, segment_series

F64 = NDArray[np.float64]
_LOOK = 50  # samples that tell what a source gives
_FACTS_NS = 10_000_000_000  # of a take, within which MVN has said where its landmarks lie


@dataclass(frozen=True)
class PointTracks:
    """Named points of one subject over T samples: position_m (T, N, 3), orientation_wxyz (T, N, 4), None where points have none.

    time_s (T,): on the host's clock, since `origin_ns` · action: what the take says it is of, "" where it says nothing ·
    points: how many of the first names are points of which segments were made (`evaluate.mocap.landmarks`), which follow them;
    0 where none were.
    """

    path: Path
    subject: str
    names: tuple[str, ...]
    time_s: F64
    origin_ns: int
    position_m: F64
    orientation_wxyz: F64 | None
    action: str = ""
    points: int = 0

    def known(self, what: Literal["position", "orientation"]) -> tuple[str, ...]:
        """The names but for segments made of points of which this is never known."""
        values = self.position_m if what == "position" else self.orientations()
        if not self.points:
            return self.names
        return tuple(n for i, n in enumerate(self.names) if i < self.points or np.isfinite(values[:, i]).all(axis=1).any())

    def orientations(self) -> F64:
        """orientation_wxyz. Raises AlignmentError where there are points alone."""
        if self.orientation_wxyz is None:
            raise AlignmentError(
                f"{self.path.name} has points alone, and none of MVN's landmarks or Plug-in Gait's bones to make segments of",
                hint=f"it has: {', '.join(self.names) or 'none'}",
            )
        return self.orientation_wxyz

    @property
    def rate_hz(self) -> float:
        """Samples a second: by the median time between two."""
        return float(1 / np.median(np.diff(self.time_s))) if len(self.time_s) > 1 else float("nan")


def read_motion(
    path: Path, *, source: str | None = None, subject: str | None = None, origin_ns: int | None = None
) -> PointTracks:
    """The segments of a subject, or its markers where a source gives no segments; from a recording or an MVNX, C3D or BVH
    file.

    Beside markers stand the segments that can be made of them, beside MVN's segments the ends of the hands, where the landmarks
    of the hand are known. source: of a recording, None: the only one that gives either. Times count from `origin_ns`, None: the
    first sample. Raises RecordingError or MocapError where there is nothing of that name, or the file cannot be read.
    """
    if path.suffix.lower() == ".mcap":
        with Recording(path) as recording:
            return _recorded(recording, source, subject, origin_ns)
    return _from_rows(path, subject, origin_ns)


def read_orientations(path: Path, name: str | None, *, source: str | None = None) -> tuple[F64, F64, int]:
    """Times (T,) s, orientations (T, 4) wxyz of one inertial sensor (None: the only one) and the clock's origin; of a recording
    or an MVNX file. Where no sensor has that name, a segment may. Raises RecordingError where neither has.
    """
    rows = [row for row in _messages(path, source) if isinstance(row[1], SensorReadings)]
    names = tuple(dict.fromkeys(n for _, m in rows if isinstance(m, SensorReadings) and len(m.orientation_wxyz) for n in m.names))
    if name is None and len(names) == 1:
        name = names[0]
    if name not in names:
        with suppress(RecordingError):  # then there are no segments either
            motion = read_motion(path, source=source)
            if name in motion.names and motion.orientation_wxyz is not None:
                return motion.time_s, motion.orientation_wxyz[:, motion.names.index(name)], motion.origin_ns
            names += motion.names
        raise RecordingError(
            f"{path} has no orientations of {f'a sensor {name!r}' if name else 'a single sensor'}",
            hint=f"name one with --sensor: {', '.join(names) or 'there is none'}",
        )
    found = [(ns, m) for ns, m in rows if isinstance(m, SensorReadings) and name in m.names]
    if len(worn := dict.fromkeys(m.subject for _, m in found)) > 1:
        raise RecordingError(
            f"{path}: {' and '.join(worn)} have a sensor {name!r} each",
            hint="name the source of one with --source; of two in one source, give a recording or an MVNX file of one alone",
        )
    kept = [(ns, m.orientation_wxyz[m.names.index(name)]) for ns, m in found]
    time_ns, rising = np.unique(np.array([ns for ns, _ in kept], np.int64), return_index=True)
    return (time_ns - time_ns[0]) / 1e9, np.stack([q for _, q in kept])[rising], int(time_ns[0])


def read_sensors(
    path: Path, *, source: str | None = None, subject: str | None = None, origin_ns: int | None = None
) -> PointTracks:
    """The inertial sensors of a subject as a motion without positions (NaN): orientations under the sensors' names."""
    rows = [(ns, m) for ns, m in _messages(path, source) if isinstance(m, SensorReadings) and len(m.orientation_wxyz)]
    time_ns, messages = of_one_subject(path, rows, subject, "orientations of sensors")
    turned = np.stack([m.orientation_wxyz for m in messages])
    position = np.full((*turned.shape[:2], 3), np.nan)
    return _motion(path, messages[0], time_ns, origin_ns, position, turned)


def read_channels(path: Path, channels: Sequence[str], *, source: str | None = None) -> tuple[NDArray[np.int64], F64] | None:
    """Host times (T,) ns and values (T, C) of channels that come together, of a source (None: any); None where none has them."""
    kept = [
        (ns, [m.values[m.names.index(channel)] for channel in channels])
        for ns, m in _messages(path, source)
        if isinstance(m, Channels) and set(channels) <= set(m.names)
    ]
    if not kept:
        return None
    time_ns, rising = np.unique(np.array([ns for ns, _ in kept], np.int64), return_index=True)
    return time_ns, np.array([values for _, values in kept])[rising]


def _recorded(recording: Recording, source: str | None, subject: str | None, origin_ns: int | None) -> PointTracks:
    action = recording.take.action or ""
    source = _only_source(recording) if source is None else source
    if source in recording.sources and "segments" not in _kinds(recording, source):
        markers = marker_series(recording, source, subject)
        return _motion(recording.path, markers, on_host(markers), origin_ns, markers.position_m, None, action)
    series = segment_series(recording, source, subject)
    position, turned = series.position_m, series.orientation_wxyz
    motion = _motion(recording.path, series, on_host(series), origin_ns, position, turned, action)
    until_ns = int(series.host_ns[0]) + _FACTS_NS
    return _with_hand_ends(motion, (m for _, s in recording.samples([source], end_ns=until_ns) for m in s.messages))


class _OfSubject(Protocol):
    """Whose points, or segments, these are, and what they are called: a message, or a series of a recording."""

    @property
    def subject(self) -> str: ...
    @property
    def names(self) -> tuple[str, ...]: ...


def _motion(
    path: Path, of: _OfSubject, time_ns: NDArray[np.int64], origin_ns: int | None, position: F64, orientation: F64 | None,
    action: str = "",
) -> PointTracks:  # fmt: skip
    """The host's times of a device rise as the device's do, but for rounding: equal ones are left out."""
    points, names = 0, of.names
    if orientation is None:
        segments, placed, turned = segment_poses(position, names)
        if segments:
            points, nothing = len(names), np.full((*position.shape[:2], 4), np.nan)
            names, position = (*names, *segments), np.concatenate((position, placed), axis=1)
            orientation = np.concatenate((nothing, turned), axis=1)
    time_ns, rising = np.unique(time_ns, return_index=True)
    origin = int(time_ns[0]) if origin_ns is None else origin_ns
    orientation = None if orientation is None else orientation[rising]
    time_s = (time_ns - origin) / 1e9
    return PointTracks(path, of.subject, names, time_s, origin, position[rising], orientation, action, points)


def _with_hand_ends(motion: PointTracks, messages: Iterable[Message]) -> PointTracks:
    """Beside MVN's segments the landmarks at the ends of its hands, where facts say how they lie in the hands."""
    points: dict[str, Any] = {}
    for message in messages:
        if (
            isinstance(message, Facts)
            and message.about == motion.subject
            and isinstance(told := message.values.get("points"), list)
        ):
            points |= {point["name"]: point for point in told}
    for name in HAND_ENDS.values():
        point = points.get(name)
        if motion.orientation_wxyz is None or point is None or point["segment"] not in motion.names:
            continue
        hand = motion.names.index(point["segment"])
        turn, offset = motion.orientation_wxyz[:, hand], np.array([0.0, *point["offset"]])
        end = motion.position_m[:, hand] + product(product(turn, offset), conjugate(turn))[:, 1:]
        position = np.concatenate((motion.position_m, end[:, None]), axis=1)
        orientation = np.concatenate((motion.orientation_wxyz, turn[:, None]), axis=1)
        motion = replace(motion, names=(*motion.names, name), position_m=position, orientation_wxyz=orientation)
    return motion


def _only_source(recording: Recording) -> str:
    found = [source for source in recording.sources if _kinds(recording, source)]
    if len(found) != 1:
        raise RecordingError(
            f"{recording.path} has {len(found)} sources of segments or markers",
            hint=f"name one with --source: {', '.join(found or recording.sources)}",
        )
    return found[0]


def _kinds(recording: Recording, source: str) -> set[str]:
    """Of segments and markers, which a source gives in its first samples."""
    first = [sample for _, sample in islice(recording.samples([source]), _LOOK)]
    kinds = {"segments": SegmentPoses, "markers": Markers}
    return {name for name, kind in kinds.items() if any(isinstance(m, kind) for sample in first for m in sample.messages)}


def _from_rows(path: Path, subject: str | None, origin_ns: int | None) -> PointTracks:
    rows = _messages(path, None)
    segments = [(ns, m) for ns, m in rows if isinstance(m, SegmentPoses)]
    markers = [(ns, m) for ns, m in rows if isinstance(m, Markers)]
    if segments:
        time_ns, poses = of_one_subject(path, segments, subject, "motion")
        turned: F64 | None = np.stack([m.orientation_wxyz for m in poses])
        named: SegmentPoses | Markers = poses[0]
        position = np.stack([m.position_m for m in poses])
    else:
        time_ns, points = of_one_subject(path, markers, subject, "motion")
        named, position, turned = points[0], np.stack([m.position_m for m in points]), None
    motion = _motion(path, named, time_ns, origin_ns, position, turned)
    return _with_hand_ends(motion, (m for _, m in rows))


def _messages(path: Path, source: str | None) -> list[tuple[int, Message]]:
    """Times and messages of a file, on its device's clock, or of a recording or one source of it, on the host's."""
    recorded = path.suffix.lower() == ".mcap"
    return [(host if recorded or device is None else device, m) for host, device, m in motion_rows(path, source)]


def labelled(words: Sequence[str]) -> list[tuple[str, Path]]:
    """LABEL=FILE or FILE (then the label is "")."""
    found = []
    for word in words:
        label, equals, path = word.partition("=")
        found.append((label, Path(path)) if equals and path and "/" not in label else ("", Path(word)))
    return found


def windows(words: Sequence[str]) -> tuple[Window, ...]:
    """Windows of NAME=START:END, s. Raises ConfigError for what is none."""
    found = []
    for word in words:
        name, _, span = word.partition("=")
        start, colon, end = span.partition(":")
        try:
            window = Window(name, float(start), float(end))
        except ValueError:
            window = Window("", 0.0, 0.0)
        if not (name and colon and window.start_s < window.end_s):
            raise ConfigError(f"'{word}' is no window", hint="write NAME=START:END in seconds, such as coronal=3:21.5")
        found.append(window)
    return tuple(found)


def pairs_of(words: Sequence[str]) -> dict[str, str]:
    """NAME=SEGMENT as a mapping. Raises ConfigError for what is none, and for names of no pair."""
    known = {name for p in (*SEGMENT_PAIRS, *JOINT_PAIRS) for name in (p.name, p.suit)}
    found = {}
    for word in words:
        name, equals, segment = word.partition("=")
        if not (equals and segment):
            raise ConfigError(f"'{word}' is no pair", hint="write NAME=SEGMENT, such as pelvis=Hips")
        if name not in known:
            raise unknown_name("pair", name, sorted(known))
        found[name] = segment
    return found


def body_source(path: Path) -> str | None:
    """The source `suit` of a recording that has one; else none, which leaves it to `read_motion`."""
    if path.suffix.lower() != ".mcap":
        return None
    with Recording(path) as recording:
        return "suit" if "suit" in recording.sources else None

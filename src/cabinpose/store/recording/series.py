"""Recordings as series: what one source said of one subject, over time, in arrays; and the frames of a camera, one by one."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from cabinpose.core.errors import RecordingError
from cabinpose.core.ports import Sample
from cabinpose.core.recorded import Markers, SegmentPoses, ToFFrame
from cabinpose.store.recording.reader import Recording

F64 = NDArray[np.float64]
Times = NDArray[np.int64]
M = TypeVar("M", SegmentPoses, Markers)


@dataclass(frozen=True)
class SegmentSeries:
    """Segments of a subject over T samples: position_m (T, S, 3), orientation_wxyz (T, S, 4), NaN where one was not seen.

    host_ns (T,): arrival · device_ns (T,): the device's clock; the host's where the device gives none (`device_clock` False).
    """

    source: str
    subject: str
    names: tuple[str, ...]
    host_ns: Times
    device_ns: Times
    device_clock: bool
    position_m: F64
    orientation_wxyz: F64

    def segment(self, name: str) -> tuple[F64, F64]:
        """Position (T, 3) and orientation (T, 4) wxyz of a segment. Raises RecordingError for a name that was not recorded."""
        if name not in self.names:
            raise RecordingError(
                f"{self.source} gives no segment '{name}' of {self.subject}", hint=f"it gives: {', '.join(self.names)}"
            )
        index = self.names.index(name)
        return self.position_m[:, index], self.orientation_wxyz[:, index]


@dataclass(frozen=True)
class MarkerSeries:
    """Markers over T samples: position_m (T, M, 3), NaN = occluded; times as in `SegmentSeries`."""

    source: str
    subject: str
    names: tuple[str, ...]
    host_ns: Times
    device_ns: Times
    device_clock: bool
    position_m: F64

    def marker(self, name: str) -> F64:
        """Position (T, 3) of a marker. Raises RecordingError for a name that was not recorded."""
        if name not in self.names:
            raise RecordingError(f"{self.source} gives no marker '{name}'", hint=f"it gives: {', '.join(self.names)}")
        return self.position_m[:, self.names.index(name)]


def segment_series(recording: Recording, source: str, subject: str | None = None) -> SegmentSeries:
    """The segments of a subject (None: the only one) as a source gave them.

    A subject's names may change in a take (a prop added): the series has all of them. Samples go by the device's clock, late
    ones in their place, the second of two with one time left out. Raises RecordingError where there are none.
    """
    rows = _rows(recording, source, subject, SegmentPoses)
    names = tuple(dict.fromkeys(name for _, message in rows for name in message.names))
    position = np.full((len(rows), len(names), 3), np.nan)
    orientation = np.full((len(rows), len(names), 4), np.nan)
    column = {name: index for index, name in enumerate(names)}
    for row, (_, message) in enumerate(rows):
        at = [column[name] for name in message.names]
        position[row, at], orientation[row, at] = message.position_m, message.orientation_wxyz
    host, device, own = _times(rows)
    return SegmentSeries(source, rows[0][1].subject, names, host, device, own, position, orientation)


def marker_series(recording: Recording, source: str, subject: str | None = None) -> MarkerSeries:
    """The markers of a subject (None: the only one; "": those without a label) as a source gave them; as `segment_series`."""
    rows = _rows(recording, source, subject, Markers)
    names = tuple(dict.fromkeys(name for _, message in rows for name in message.names))
    position = np.full((len(rows), len(names), 3), np.nan)
    column = {name: index for index, name in enumerate(names)}
    for row, (_, message) in enumerate(rows):
        position[row, [column[name] for name in message.names]] = message.position_m
    host, device, own = _times(rows)
    return MarkerSeries(source, rows[0][1].subject, names, host, device, own, position)


def tof_frames(recording: Recording, source: str) -> Iterator[tuple[Sample, ToFFrame]]:
    """The frames of a camera, one in memory at a time, in the order of arrival."""
    for _, sample in recording.samples([source]):
        for message in sample.messages:
            if isinstance(message, ToFFrame):
                yield sample, message


def _rows(recording: Recording, source: str, subject: str | None, kind: type[M]) -> list[tuple[Sample, M]]:
    """Samples and messages of a kind and subject, by the device's time."""
    if source not in recording.sources:
        raise RecordingError(
            f"{recording.path} has no source '{source}'", hint=f"it has: {', '.join(recording.sources) or 'none'}"
        )
    found: list[tuple[Sample, M]] = []
    for _, sample in recording.samples([source]):
        found += [(sample, message) for message in sample.messages if isinstance(message, kind)]
    subjects = tuple(dict.fromkeys(message.subject for _, message in found))
    if subject is None and len(subjects) == 1:
        subject = subjects[0]
    chosen = [row for row in found if row[1].subject == subject]
    if not chosen:
        what = (
            f"no {kind.__name__} of '{subject}'"
            if subject is not None
            else "several subjects"
            if subjects
            else f"no {kind.__name__}"
        )
        raise RecordingError(f"{source} gives {what}", hint=f"subjects that it gives: {', '.join(map(repr, subjects)) or 'none'}")
    key = [row[0].device_ns if row[0].device_ns is not None else row[0].host_ns for row in chosen]
    order = sorted(range(len(key)), key=key.__getitem__)
    return [chosen[n] for k, n in enumerate(order) if k == 0 or key[n] != key[order[k - 1]]]


def _times(rows: list[tuple[Sample, M]]) -> tuple[Times, Times, bool]:
    host = np.array([sample.host_ns for sample, _ in rows], np.int64)
    own = all(sample.device_ns is not None for sample, _ in rows)
    device = np.array([sample.device_ns for sample, _ in rows], np.int64) if own else host
    return host, device, own

"""Recordings as series: what one source said of one subject, over time, in arrays; and the frames of a camera, one by one."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from cabinpose.core import RecordingError
from cabinpose.signals import ARRAYS, F64, LATEST_NS, Markers, Sample, SegmentPoses, ToFFrame
from cabinpose.store.recording.reader import Recording

Times = NDArray[np.int64]
M = TypeVar("M", SegmentPoses, Markers)


@dataclass(frozen=True)
class MarkerSeries:
    """Markers over T samples: position_m (T, M, 3), NaN = occluded.

    host_ns (T,): arrival · device_ns (T,): the device's clock; the host's where the device gives none (`device_clock` False).
    """

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


@dataclass(frozen=True)
class SegmentSeries:
    """Segments of a subject over T samples: position_m (T, S, 3), orientation_wxyz (T, S, 4), NaN where one was not seen.

    Times as in `MarkerSeries`.
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


def segment_series(recording: Recording, source: str, subject: str | None = None) -> SegmentSeries:
    """The segments of a subject as a source gave them.

    Parameters
    ----------
    recording
        The recording.
    source
        The name of the source.
    subject
        Whose; None: of the only one.

    Returns
    -------
    SegmentSeries
        A subject's names may change in a take (a prop added): the series has all of them. Samples go by the device's clock, late
        ones in their place, the second of two with one time left out. What a device says after it was started anew follows what
        it said before, so that `device_ns` falls there.

    Raises
    ------
    RecordingError
        Where there are none, or of several subjects while none is named.
    """
    rows = _rows(recording, source, subject, SegmentPoses)
    return SegmentSeries(*_columns(source, rows, "position_m", "orientation_wxyz"))


def marker_series(recording: Recording, source: str, subject: str | None = None) -> MarkerSeries:
    """The markers of a subject ("": those without a label) as a source gave them; everything else as in `segment_series`."""
    return MarkerSeries(*_columns(source, _rows(recording, source, subject, Markers), "position_m"))


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
        several = subject is None and subjects
        what = "several subjects" if several else f"no {kind.__name__}" + (f" of '{subject}'" if subject is not None else "")
        raise RecordingError(f"{source} gives {what}", hint=f"subjects that it gives: {', '.join(map(repr, subjects)) or 'none'}")
    key = _with_starts([row[0].device_ns if row[0].device_ns is not None else row[0].host_ns for row in chosen])
    order = sorted(range(len(key)), key=key.__getitem__)
    return [chosen[n] for k, n in enumerate(order) if k == 0 or key[n] != key[order[k - 1]]]


def _with_starts(time_ns: list[int]) -> list[tuple[int, int]]:
    """How often a clock had begun anew by each sample, in the order of arrival, and its time."""
    found: list[tuple[int, int]] = []
    starts, latest = 0, time_ns[0]
    for time in time_ns:
        starts, latest = (starts + 1, time) if latest - time > LATEST_NS else (starts, max(latest, time))
        found.append((starts, time))
    return found


def _columns(source: str, rows: list[tuple[Sample, M]], *arrays: str) -> Any:
    """The fields of a series: source, subject, names, times, and the arrays of the messages."""
    names = tuple(dict.fromkeys(name for _, message in rows for name in message.names))
    column = {name: index for index, name in enumerate(names)}
    stacked: list[F64] = [np.full((len(rows), len(names), ARRAYS[type(rows[0][1])][array]), np.nan) for array in arrays]
    for row, (_, message) in enumerate(rows):
        at = [column[name] for name in message.names]
        for array, values in zip(arrays, stacked, strict=True):
            values[row, at] = getattr(message, array)
    host = np.array([sample.host_ns for sample, _ in rows], np.int64)
    device_clock = all(sample.device_ns is not None for sample, _ in rows)
    device = np.array([sample.device_ns for sample, _ in rows], np.int64) if device_clock else host
    return source, rows[0][1].subject, names, host, device, device_clock, *stacked

"""What a recording holds: topics, rates, gaps, counts."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from cabinpose.store.recording.messages import decode_status
from cabinpose.store.recording.reader import Recording
from cabinpose.store.recording.scan import Damage
from cabinpose.store.recording.schemas import RAW, STATUS, SourceStatus
from cabinpose.store.recording.take import Take

_GAP = 3.0  # median intervals; a longer silence is a gap
_SHORTEST_GAP_S = 0.1  # bursts of a busy machine are none


@dataclass(frozen=True)
class TopicSurvey:
    """A topic: messages, their bytes, messages a second."""

    topic: str
    schema: str
    messages: int
    bytes: int
    rate_hz: float


@dataclass(frozen=True)
class SourceSurvey:
    """A source: samples in the file, and what is missing.

    arrival_ns: (samples,) int64, host time · rate_hz: samples a second · missing: numbers that the device used and the file
    lacks · gaps: (G, 2) s since the first sample of the take, silences of more than three usual intervals and 0.1 s ·
    jitter_ms: standard deviation of the intervals between arrivals · status: the last counts that were written, if any.
    """

    name: str
    samples: int
    arrival_ns: NDArray[np.int64]
    rate_hz: float
    jitter_ms: float
    missing: int
    gaps: NDArray[np.float64]
    status: SourceStatus | None


@dataclass(frozen=True)
class Survey:
    """A whole recording; times from the first to the last sample."""

    path: Path
    take: Take
    bytes: int
    started_ns: int
    seconds: float
    sources: tuple[SourceSurvey, ...]
    topics: tuple[TopicSurvey, ...]
    damage: Damage


def survey(path: Path) -> Survey:
    """Go through a recording, in whatever state it is. Raises RecordingError where it is none."""
    times: dict[str, list[int]] = {}
    numbers: dict[str, list[int]] = {}
    statuses: dict[str, SourceStatus] = {}
    topics: dict[str, tuple[str, list[int], list[int]]] = {}
    with Recording(path, damaged="skip") as recording:
        for place, schema, channel, data in recording.records():
            _, at, sizes = topics.setdefault(channel.topic, (schema, [], []))
            at.append(place.host_ns)
            sizes.append(len(data))
            if place.topic == RAW:
                times.setdefault(place.source, []).append(place.host_ns)
                if place.sequence is not None:
                    numbers.setdefault(place.source, []).append(place.sequence)
            elif place.topic == STATUS:
                statuses[place.source] = decode_status(data)
        take, started, damage, names = recording.take, recording.head.started_ns, recording.damage, recording.sources
    first = min((min(series) for series in times.values()), default=started)
    last = max((max(series) for series in times.values()), default=started)
    sources = tuple(_source(name, times.get(name, []), numbers.get(name, []), statuses.get(name), first) for name in names)
    listed = tuple(TopicSurvey(t, schema, len(at), sum(sizes), _rate(at)) for t, (schema, at, sizes) in sorted(topics.items()))
    return Survey(path, take, path.stat().st_size, first, (last - first) / 1e9, sources, listed, damage)


def _source(name: str, times: list[int], numbers: list[int], status: SourceStatus | None, first: int) -> SourceSurvey:
    arrival = np.sort(np.array(times, np.int64))
    intervals = np.diff(arrival) / 1e9
    usual = float(np.median(intervals)) if len(intervals) else 0.0
    silent = np.flatnonzero(intervals > max(_GAP * usual, _SHORTEST_GAP_S))
    unique = np.unique(np.array(numbers, np.int64))
    return SourceSurvey(
        name=name,
        samples=len(times),
        arrival_ns=arrival,
        rate_hz=_rate(times),
        jitter_ms=float(np.std(intervals)) * 1e3 if len(intervals) else 0.0,
        missing=int(unique[-1] - unique[0]) + 1 - len(unique) if len(unique) else 0,
        gaps=np.column_stack((arrival[silent] - first, arrival[silent + 1] - first)) / 1e9,
        status=status,
    )


def _rate(times: list[int]) -> float:
    span = (max(times) - min(times)) / 1e9 if times else 0.0
    return (len(times) - 1) / span if span > 0 else 0.0

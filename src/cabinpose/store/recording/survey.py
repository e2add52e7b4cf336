"""What a recording holds: topics, rates, gaps, counts."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass, replace
from itertools import groupby
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cabinpose.core import RecordingError
from cabinpose.signals import DOUBTS, SETUP, TOPICS, Facts, Markers, SegmentPoses, TakeCheck, TakenBody
from cabinpose.store.recording.messages import Decoder, decode_facts, decode_status
from cabinpose.store.recording.reader import Place, Recording
from cabinpose.store.recording.scan import Damage
from cabinpose.store.recording.schemas import FACTS, RAW, STATUS, SourceStatus
from cabinpose.store.recording.take import Take

_GAP = 3.0  # median intervals; a longer silence is a gap
_SHORTEST_GAP_S = 0.1  # bursts of a busy machine are none
_LOOKED_AT = (TOPICS[SegmentPoses], TOPICS[Markers], FACTS)
_SUBJECT_BYTES = 1024  # of a record on markers, within which it says whose they are


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

    arrival_ns: (samples,) int64, host time · first_ns, last_ns: of its data, None where there are none · rate_hz: samples a
    second · missing: numbers that the device used and the file lacks · gaps: (G, 2) s since the take's start, silences of more
    than three usual intervals and 0.1 s, from the take's start to its end (of a source that says that it has ended, to its last
    data) · jitter_ms: standard deviation of the intervals between arrivals · status: the last counts that were written, if any ·
    setups: what a camera was set to, as its facts say, and anew whenever it changed · doubts: what the recorder doubted of it.
    """

    name: str
    samples: int
    arrival_ns: NDArray[np.int64]
    first_ns: int | None
    last_ns: int | None
    rate_hz: float
    jitter_ms: float
    missing: int
    gaps: NDArray[np.float64]
    status: SourceStatus | None
    setups: tuple[Mapping[str, Any], ...] = ()
    doubts: tuple[str, ...] = ()


@dataclass(frozen=True)
class Survey:
    """A whole recording, from its first sample or counts (which a take begins and ends with) to its last.

    bodies: whose positions are in it, and what speaks against them.
    """

    path: Path
    take: Take
    bytes: int
    started_ns: int
    seconds: float
    sources: tuple[SourceSurvey, ...]
    topics: tuple[TopicSurvey, ...]
    damage: Damage
    bodies: tuple[TakenBody, ...] = ()


def survey(path: Path) -> Survey:
    """Go through a recording, in whatever state it is. Raises RecordingError where it is none."""
    times: dict[str, list[int]] = {}
    numbers: dict[str, list[int]] = {}
    data_times: dict[str, list[int]] = {}
    statuses: dict[str, SourceStatus] = {}
    counted: list[int] = []
    told: dict[tuple[str, str], list[Mapping[str, Any]]] = {}
    topics: dict[str, tuple[str, list[int], list[int]]] = {}
    check = TakeCheck()
    with Recording(path, damaged="skip") as recording:
        for place, schema, channel, data in recording.records():
            _, at, sizes = topics.setdefault(channel.topic, (schema, [], []))
            at.append(place.host_ns)
            sizes.append(len(data))
            _look(check, place, schema, channel.metadata, data)
            if place.topic == RAW:
                times.setdefault(place.source, []).append(place.host_ns)
                if place.sequence is not None:
                    numbers.setdefault(place.source, []).append(place.sequence)
            elif place.topic == STATUS:
                statuses[place.source] = decode_status(data)
                counted.append(place.host_ns)
            elif place.topic == FACTS and (facts := decode_facts(data)) is not None:
                told.setdefault((place.source, facts.about), []).append(facts.values)
            if place.topic not in (STATUS, RAW, FACTS) or (place.topic == RAW and place.sequence is not None):
                data_times.setdefault(place.source, []).append(place.host_ns)
        take, started, damage, names = recording.take, recording.head.started_ns, recording.damage, recording.sources
        size = sum(file.stat().st_size for file in recording.files)
    first = min((min(series) for series in times.values()), default=started)
    last = max((max(series) for series in times.values()), default=started)
    if (
        counted and min(counted) <= last and max(counted) >= first
    ):  # else the samples are of another day: replayed with their times
        first, last = min(first, *counted), max(last, *counted)
    sources = []
    for name in names:
        status, came = statuses.get(name), times.get(name, [])
        data_came = data_times.get(name, came if status is None else [])  # of a file of other tools, events may be all there is
        of_it = _source(name, came, data_came, numbers.get(name, []), status, (first, last))
        changes = tuple(values for values, _ in groupby(told.get((name, SETUP), ())))
        doubts = tuple(str(words) for values in told.get((name, DOUBTS), ()) for words in values.get("words") or ())
        sources.append(replace(of_it, setups=changes, doubts=doubts))
    listed = tuple(TopicSurvey(t, schema, len(at), sum(sizes), _rate(at)) for t, (schema, at, sizes) in sorted(topics.items()))
    return Survey(path, take, size, first, (last - first) / 1e9, tuple(sources), listed, damage, check.bodies())


def _look(check: TakeCheck, place: Place, schema: str, about: Mapping[str, str], data: memoryview) -> None:
    """Give a record on bodies, or facts on them, to what looks at them; of many poses only those that it wants are decoded."""
    if place.topic not in _LOOKED_AT:
        return
    time_ns = place.host_ns if place.device_ns is None else place.device_ns
    whose = about.get("subject") or bytes(data[:_SUBJECT_BYTES]).partition(b',"names"')[0].decode(errors="replace")
    if place.topic != FACTS and not check.wants(place.source, place.topic, whose, time_ns):
        return
    with suppress(RecordingError):  # what is damaged is counted elsewhere
        message = Decoder()(place.topic, schema, about, data)
        if isinstance(message, Facts):
            check.told(place.source, message)
        elif isinstance(message, SegmentPoses | Markers):
            check.keep(place.source, place.topic, whose, message)


def _source(
    name: str, times: list[int], data: list[int], numbers: list[int], status: SourceStatus | None, span: tuple[int, int]
) -> SourceSurvey:
    arrival, came = np.sort(np.array(times, np.int64)), np.unique(np.array(data, np.int64))
    intervals = np.diff(arrival) / 1e9
    ended = status is not None and status.state == "ended"
    unique = np.unique(np.array(numbers, np.int64))
    return SourceSurvey(
        name=name,
        samples=len(times),
        arrival_ns=arrival,
        first_ns=int(came[0]) if len(came) else None,
        last_ns=int(came[-1]) if len(came) else None,
        rate_hz=_rate(times),
        jitter_ms=float(np.std(intervals)) * 1e3 if len(intervals) else 0.0,
        missing=int(unique[-1] - unique[0]) + 1 - len(unique) if len(unique) else 0,
        gaps=_gaps(came, span[0], None if ended else span[1]),
        status=status,
    )


def _gaps(came: NDArray[np.int64], start: int, end: int | None) -> NDArray[np.float64]:
    """Silences between the start of the take, arrivals in their order, and the take's end, if it counts: (G, 2) s."""
    usual = float(np.median(np.diff(came))) / 1e9 if len(came) > 1 else 0.0
    edges = np.array([start, *came, *([] if end is None else [end])], np.int64)
    at = np.flatnonzero(np.diff(edges) / 1e9 > max(_GAP * usual, _SHORTEST_GAP_S))
    return np.column_stack((edges[at] - start, edges[at + 1] - start)) / 1e9


def _rate(times: list[int]) -> float:
    span = (max(times) - min(times)) / 1e9 if times else 0.0
    return (len(times) - 1) / span if span > 0 else 0.0

"""What a take says of its bodies and clocks, from messages as they come: of each body a few frames are kept, and all stamps."""

from __future__ import annotations

from array import array
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Final, NamedTuple, TypeAlias

import numpy as np

from cabinpose.signals.body_check import BodySize, BodyTrack, Doubt, body_doubts, body_size, stamp_doubts
from cabinpose.signals.recorded import F64, TOPICS, Channels, Facts, Markers, Message, SegmentPoses

FRAMES: Final = 64  # of a body that are kept at least, where there are so many

_Placed: TypeAlias = SegmentPoses | Markers
_RATES: Final = ("frame_rate_hz", "rate_hz")  # of facts


class TakenBody(NamedTuple):
    """A body, or a thing, of a take, in metres with z up.

    kind: the name of its messages in `TOPICS` · frames: how many there are of it · unit, up: of the file that it was in, and what
    told the unit; "" where nothing says it.
    """

    source: str
    subject: str
    kind: str
    frames: int
    size: BodySize
    unit: str
    up: str
    doubts: tuple[Doubt, ...]


@dataclass
class _Looked:
    """Of one subject: all stamps, and every `stride`-th message with the one that followed it, for its speed."""

    time_ns: array[int] = field(default_factory=lambda: array("q"))
    stride: int = 2
    pairs: list[tuple[int, _Placed, int, _Placed | None]] = field(default_factory=list)

    def wants(self, time_ns: int) -> bool:
        """Count a stamp; whether its message is to be kept: called once for each."""
        self.time_ns.append(time_ns)
        return (len(self.time_ns) - 1) % self.stride in (0, 1)

    def keep(self, message: _Placed) -> None:
        """Keep the message of the last stamp."""
        time_ns, at = self.time_ns[-1], len(self.time_ns) - 1
        if at % self.stride == 0:
            if len(self.pairs) == 2 * FRAMES:
                self.pairs = self.pairs[::2]
                self.stride *= 2
            if at % self.stride == 0:
                self.pairs.append((time_ns, message, time_ns, None))
        elif self.pairs:
            before_ns, before, *_ = self.pairs[-1]
            self.pairs[-1] = before_ns, before, time_ns, message


class TakeCheck:
    """Looks at messages as they come, by source; `bodies` says what they tell."""

    def __init__(self) -> None:
        self._kept: dict[tuple[str, str, str], _Looked] = {}
        self._facts: dict[tuple[str, str], dict[str, object]] = {}
        self._streams: dict[str, array[int]] = {}

    def wants(self, source: str, kind: str, key: str, time_ns: int) -> bool:
        """Whether a message of a kind of body is to be given to `keep`; its stamp is counted. key: a subject's own."""
        return self._kept.setdefault((source, kind, key), _Looked()).wants(time_ns)

    def keep(self, source: str, kind: str, key: str, message: _Placed) -> None:
        """Keep the message that was wanted."""
        self._kept[source, kind, key].keep(message)

    def told(self, source: str, facts: Facts) -> None:
        """What facts say of units, axes, rates and hierarchies."""
        self._facts.setdefault((source, facts.about), {}).update(facts.values)

    def add(self, source: str, time_ns: int, message: Message) -> None:
        """A message of any kind."""
        if isinstance(message, Facts):
            self.told(source, message)
        elif isinstance(message, SegmentPoses | Markers):
            kind = TOPICS[type(message)]
            if self.wants(source, kind, message.subject, time_ns):
                self.keep(source, kind, message.subject, message)
        elif isinstance(message, Channels) and (source, "stream") in self._facts:
            self._streams.setdefault(source, array("q")).append(time_ns)

    def bodies(self, *, stamps: bool = True) -> tuple[TakenBody, ...]:
        """Each body and thing, with what speaks against it; stamps: whether times, and speeds by them, are to be judged."""
        kept = [(source, kind, looked) for (source, kind, _), looked in self._kept.items() if looked.pairs]
        return tuple(self._body(source, kind, looked, stamps=stamps) for source, kind, looked in kept)

    def renewed(self) -> TakeCheck:
        """One that has seen no message and knows the same facts."""
        other = TakeCheck()
        other._facts = self._facts
        return other

    def streams(self) -> tuple[tuple[str, Doubt], ...]:
        """What speaks against the stamps of streams of channels, by source."""
        return tuple(
            (source, doubt)
            for source, times in self._streams.items()
            if (rate := self._rate(source, "stream")) is not None  # others send when something happens
            for doubt in stamp_doubts(times, rate)
        )

    def _body(self, source: str, kind: str, kept: _Looked, *, stamps: bool) -> TakenBody:
        subject = kept.pairs[0][1].subject
        track = _track(kept, self._parents(source, subject))
        facts = self._about(source, subject)
        if stamps:
            doubts = (*body_doubts(track), *stamp_doubts(kept.time_ns, self._rate(source, subject)))
        else:
            doubts = (*body_doubts(track._replace(speed_m_s=float("nan"))),)
        unit, up = (str(facts.get(name) or "") for name in ("unit_because", "up"))
        return TakenBody(source, subject, kind, len(kept.time_ns), body_size(track), unit, up, doubts)

    def _about(self, source: str, subject: str) -> dict[str, object]:
        """Facts on a subject, and on all points of its source."""
        found: dict[str, object] = {}
        for about in ("points", "stream", subject, f"subject {subject}"):
            found |= self._facts.get((source, about), {})
        return found

    def _rate(self, source: str, subject: str) -> float | None:
        facts = self._about(source, subject)
        rates = (facts.get(name) for name in _RATES)
        return next((float(rate) for rate in rates if isinstance(rate, int | float) and rate > 0), None)

    def _parents(self, source: str, subject: str) -> dict[str, str]:
        segments = self._about(source, subject).get("segments")
        listed = segments if isinstance(segments, Sequence) else ()
        named = [(each.get("name"), each.get("parent")) for each in listed if isinstance(each, Mapping)]
        return {str(name): str(parent) for name, parent in named if parent}


def _track(kept: _Looked, parents: Mapping[str, str]) -> BodyTrack:
    """The frames that have the points of the first."""
    names = kept.pairs[0][1].names
    pairs = [pair for pair in kept.pairs if pair[1].names == names]
    position = np.stack([message.position_m for _, message, _, _ in pairs])
    first = pairs[0][1]
    turned = np.stack([m.orientation_wxyz for _, m, _, _ in pairs if isinstance(m, SegmentPoses)]) if isinstance(
        first, SegmentPoses
    ) else None  # fmt: skip
    return BodyTrack(names, position, turned, parents, _speed(pairs, names))


def _speed(pairs: Iterable[tuple[int, _Placed, int, _Placed | None]], names: tuple[str, ...]) -> float:
    """Of points, m/s, the 95th of a hundred; NaN where no two frames follow each other."""
    found: list[F64] = []
    for before_ns, before, after_ns, after in pairs:
        if after is not None and after.names == names and after_ns > before_ns:
            found.append(np.linalg.norm(after.position_m - before.position_m, axis=1) * 1e9 / (after_ns - before_ns))
    speeds = np.concatenate(found) if found else np.empty(0)
    speeds = speeds[np.isfinite(speeds)]
    return float(np.quantile(speeds, 0.95)) if speeds.size else float("nan")

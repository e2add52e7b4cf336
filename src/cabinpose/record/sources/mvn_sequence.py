"""What became of each sample that MVN senders sent: received, lost, late, twice, or in pieces; and whether one restarted.

MVN counts samples; every type of every character of a sender is a stream of its own that carries the count. `received` and
`lost` count whole samples of a stream (one that came in pieces is lost while a piece is missing); `reordered` and `duplicate`
count datagrams. What was sent before the first and after the last sample that came cannot be known.
"""

from __future__ import annotations

from bisect import bisect_right
from collections import OrderedDict
from collections.abc import Hashable
from dataclasses import dataclass
from typing import NamedTuple

from cabinpose.record.sources.mvn_protocol import MAX_PAYLOAD, Header, MalformedError
from cabinpose.signals import Counts

_COUNTER = 1 << 32
_FIRST = 1 << 10  # sequences start here, which leaves room for samples that precede the first
_LEARN = 16  # rises of the counter that settle its step
_SHARPEN = 8  # steps: a longer rise says more of what was lost than of the step
# Bounds that no rig comes near: what a sender of nonsense may make us remember.
_STREAMS = 256
_EARLY = 64  # samples by which one may precede the first that came: earlier ones are of a sender that restarted
_OPEN = 64  # samples of a stream that lack pieces


@dataclass(slots=True)
class _Sample:
    """A sample that has come, at least in part."""

    sequence: int
    seen_ns: int
    digests: dict[int, int]  # piece -> digest of its datagram
    pieces: dict[int, bytes] | None = None  # while pieces are lacking
    items: int = 0
    size: int = 0
    last: int | None = None


class Arrival(NamedTuple):
    """What a datagram did: it made the sample `sequence` whole, whose `payload` of `items` is complete, or not (None).

    A sample that precedes the first has no sequence. `restarted`: the sender restarted with it.
    """

    sequence: int | None = None
    items: int = 0
    payload: bytes | None = None
    restarted: bool = False


class SequenceTracker:
    """Counts what comes to one address in `counts`. `incomplete` is the part of `lost` of which some pieces came.

    `step`: by how much the sample counter rises from one sample sent to the next, more than 1 where MVN streams at a lower
    rate than it captures (it may be a fraction); None: 1, until 16 rises show that it is at least 2. `window_s`: what
    is older when it comes belongs to a sender that restarted; pieces are waited for as long. `restart_gap`: a larger leap of
    the counter is a new beginning, not a loss.
    """

    def __init__(
        self, counts: Counts, *, step: float | None = None, window_s: float = 1.0, restart_gap: int = 100_000, memory: int = 4096
    ) -> None:
        self.counts = counts
        self.incomplete = 0
        self.step, self.restart_gap, self.memory = step, restart_gap, memory
        self.window_ns = round(window_s * 1e9)
        self._streams: dict[tuple[Hashable, int, int], _Stream] = {}
        self._next = _FIRST
        self._restarted_ns: int | None = None

    def arrive(self, header: Header, payload: bytes, digest: int, host_ns: int, sender: Hashable = None) -> Arrival:
        """Take note of a datagram of a counted type, which came from `sender`: two may use one id for their characters. Raises
        MalformedError where it contradicts earlier pieces.
        """
        key = (sender, header.kind, header.character)
        stream = self._streams.get(key) or self._moved(key, host_ns)
        if stream is None:
            if len(self._streams) >= _STREAMS:
                self._drop_idle(host_ns)
            stream = self._streams[key] = _Stream(self, header.sample, host_ns)
        arrival = stream.arrive(header, payload, digest, host_ns)
        if arrival is not None:
            return arrival
        stream.settle()
        restarted = self.restarted(host_ns)  # the other streams of the sender restart with it: one restart
        self._streams[key] = stream = _Stream(self, header.sample, host_ns)
        again = stream.arrive(header, payload, digest, host_ns)
        assert again is not None  # nothing precedes it
        return again._replace(restarted=restarted)

    def _moved(self, key: tuple[Hashable, int, int], host_ns: int) -> _Stream | None:
        """The stream of a sender that has fallen silent: one that restarts mostly has another port."""
        for other, stream in self._streams.items():
            if other[1:] == key[1:] and host_ns - stream.arrived_ns > self.window_ns:
                self._streams[key] = self._streams.pop(other)
                return stream
        return None

    def restarted(self, host_ns: int) -> bool:
        """Count a restart, unless one was counted within the window before: it is the same one."""
        new = self._restarted_ns is None or host_ns - self._restarted_ns > self.window_ns
        if new:
            self.counts.restarts += 1
            self._restarted_ns = host_ns
        return new

    def reconnected(self, host_ns: int) -> None:
        """The sender came back after its connection broke: a restart. It may go on counting; what came does not come again."""
        self.restarted(host_ns)
        for stream in self._streams.values():
            stream.forget()

    def settle(self) -> None:
        """Give up waiting: samples that lack pieces are lost."""
        for stream in self._streams.values():
            stream.settle()

    def _drop_idle(self, host_ns: int) -> None:
        idle = [key for key, stream in self._streams.items() if host_ns - stream.arrived_ns > self.window_ns]
        for key in idle:
            self._streams.pop(key).settle()
        if not idle:
            raise MalformedError(f"more than {_STREAMS} streams at a time")

    def take(self, number: int) -> int:
        """The first of `number` sequences."""
        self._next += number
        return self._next - number


class _Stream:
    """One type of one character."""

    def __init__(self, tracker: SequenceTracker, first: int, host_ns: int) -> None:
        self._tracker, self._counts = tracker, tracker.counts
        self._step = tracker.step or 1.0
        self._steps: list[tuple[int, int]] | None = None if tracker.step else []  # (counter, rise to the next), while learning
        self._risen = self._taken = 0  # by how much the counter rose in so many steps
        self._first, self._began_ns = first, host_ns
        self.arrived_ns = host_ns
        self._highest: int | None = None
        self._newest = first << 7
        self._seen: OrderedDict[int, _Sample] = OrderedDict()
        self._open: dict[int, _Sample] = {}
        self._missing: OrderedDict[int, tuple[int | None, int]] = OrderedDict()  # counter -> (sequence, when it was missed)

    def arrive(self, header: Header, payload: bytes, digest: int, host_ns: int) -> Arrival | None:
        """As `arrive` of the tracker; None: the sender restarted."""
        self.arrived_ns = host_ns
        self._forget(host_ns)
        highest = self._highest
        counter = header.sample
        if highest is not None:  # continuous, where the 32 bits wrap
            counter = highest + (counter - highest + _COUNTER // 2) % _COUNTER - _COUNTER // 2
        sample = self._seen.get(counter)
        if sample is None:
            sequence = self._place(counter, host_ns)
            if sequence is None:
                return None
            if header.last and not header.piece:  # whole in one, as nearly all are
                self._seen[counter] = _Sample(sequence, host_ns, {0: digest})
                self._order(counter, 0)
                self._counts.received += 1
                return Arrival(None if sequence < 0 else sequence, header.items, payload)
            sample = self._seen[counter] = self._open[counter] = _Sample(sequence, host_ns, {}, {})
        else:
            known = sample.digests.get(header.piece)
            if known is not None:
                if known != digest:
                    return None
                self._counts.duplicate += 1
                return Arrival()
        return self._fit(counter, sample, header, payload, digest)

    def _order(self, counter: int, piece: int) -> None:
        key = counter << 7 | piece
        if key < self._newest:
            self._counts.reordered += 1
        else:
            self._newest = key

    def settle(self) -> None:
        """Count the samples that lack pieces as lost."""
        for sample in self._open.values():
            sample.pieces = None
        self._counts.lost += len(self._open)
        self._tracker.incomplete += len(self._open)
        self._open.clear()

    def forget(self) -> None:
        """Expect nothing more of what came before."""
        self.settle()
        self._seen.clear()
        self._missing.clear()

    def _place(self, counter: int, host_ns: int) -> int | None:
        """The sequence of a sample that had not come before, and counts of the gap that it opens or fills."""
        if self._highest is None:
            self._highest = counter
            return self._tracker.take(1)
        rise = counter - self._highest
        if rise > 0:
            if rise > self._tracker.restart_gap:
                return None
            if rise != self._step:
                self._miss(self._highest, rise, host_ns, reserve=True)
            self._highest = counter
            if self._tracker.step is None and (self._steps is not None or self._step != 1):
                self._learn(counter - rise, rise)
            return self._tracker.take(1)
        if counter < self._first:
            if host_ns - self._began_ns > self._tracker.window_ns or self._first - counter > _EARLY * self._step:
                return None
            self._miss(counter, self._first - counter, host_ns, reserve=False)
            self._first = counter
            return -1
        found = self._missed_as(counter)
        if found is None:
            return None
        self._counts.lost -= 1
        sequence, _ = self._missing.pop(found)
        return -1 if sequence is None else sequence

    def _miss(self, counter: int, rise: int, host_ns: int, *, reserve: bool) -> None:
        """Count the samples between `counter` and `counter + rise` as lost, until they come."""
        missed = max(0, round(rise / self._step) - 1)
        if missed:
            self._counts.lost += missed
            sequence = self._tracker.take(missed) if reserve else None
            for k in range(max(1, missed - self._tracker.memory + 1), missed + 1):  # the newest, if they are too many
                self._missing[round(counter + k * self._step)] = (None if sequence is None else sequence + k - 1, host_ns)
            while len(self._missing) > self._tracker.memory:
                self._missing.popitem(last=False)

    def _missed_as(self, counter: int) -> int | None:
        """The missing counter that this one is: with a step that is a fraction, the nearest within half of it."""
        if counter in self._missing:
            return counter
        if self._step.is_integer() or not self._missing:
            return None
        nearest = min(self._missing, key=lambda missing: abs(missing - counter))
        return nearest if abs(nearest - counter) <= self._step / 2 else None

    def _learn(self, counter: int, rise: int) -> None:
        """Settle the step when enough rises are known, take back the losses that it explains, and sharpen it from then on."""
        if self._steps is None and rise <= _SHARPEN * self._step:
            if rise < 0.75 * self._step:  # the sender streams faster than it did
                self._step, self._steps = 1.0, []
            elif not self._step.is_integer():
                self._risen += rise
                self._taken += round(rise / self._step)
                self._step = self._risen / self._taken
        elif self._steps is not None:
            self._steps.append((counter, rise))
            if rise == 1:
                self._steps = None
            elif len(self._steps) == _LEARN:
                self._settle_step(self._steps)

    def _settle_step(self, known: list[tuple[int, int]]) -> None:
        """The mean of the rises without a loss: of a steady step, they are the whole numbers below and above it."""
        self._steps = None
        least = min(rise for _, rise in known)
        single = [rise for _, rise in known if rise <= least + 1]
        self._risen, self._taken = sum(single), len(single)
        self._step = step = self._risen / self._taken
        steps = [(counter, rise, max(1, round(rise / step))) for counter, rise in known]
        self._counts.lost -= sum(rise - taken for _, rise, taken in steps)
        begins = [counter for counter, _, _ in steps]
        for missing in list(self._missing):
            before, _, taken = steps[max(0, bisect_right(begins, missing) - 1)]
            k = round((missing - before) / step)
            if not 1 <= k < taken or before + round(k * step) != missing:
                del self._missing[missing]

    def _forget(self, host_ns: int) -> None:
        """Forget what is older than the window, or too much: what belongs to it when it comes is a new beginning."""
        limit_ns, tracker = host_ns - self._tracker.window_ns, self._tracker
        while self._seen:
            oldest = next(iter(self._seen))  # in the order of arrival; a paused sender may repeat the newest for long
            if (self._seen[oldest].seen_ns >= limit_ns or oldest == self._highest) and len(self._seen) <= tracker.memory:
                break
            del self._seen[oldest]
            if oldest in self._open:
                self._lose(oldest)
        while len(self._open) > _OPEN:
            self._lose(next(iter(self._open)))
        while self._missing:
            oldest = next(iter(self._missing))
            if self._missing[oldest][1] >= limit_ns:
                break
            del self._missing[oldest]

    def _lose(self, counter: int) -> None:
        self._open.pop(counter).pieces = None
        self._counts.lost += 1
        self._tracker.incomplete += 1

    def _fit(self, counter: int, sample: _Sample, header: Header, payload: bytes, digest: int) -> Arrival:
        """Add a piece; the whole sample if that was the last that it lacked."""
        pieces = sample.pieces
        contradicts = pieces is None or sample.size + len(payload) > MAX_PAYLOAD
        if sample.last is not None:
            contradicts |= header.last or header.piece > sample.last
        elif header.last:
            contradicts |= any(piece > header.piece for piece in sample.digests)
        if contradicts or pieces is None:
            raise MalformedError("a piece that its sample has no place for")
        self._order(counter, header.piece)
        sample.digests[header.piece] = digest
        pieces[header.piece] = payload
        sample.items += header.items
        sample.size += len(payload)
        if header.last:
            sample.last = header.piece
        if sample.last is None or len(pieces) <= sample.last:
            return Arrival()
        del self._open[counter]
        whole = b"".join(pieces[i] for i in range(sample.last + 1))
        sample.pieces = None
        self._counts.received += 1
        return Arrival(None if sample.sequence < 0 else sample.sequence, sample.items, whole)

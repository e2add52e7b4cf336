"""The account of what MVN sent, held against the emulator's own: exact, whatever the network does. No sockets, no waiting."""

from __future__ import annotations

from collections import defaultdict
from dataclasses import dataclass, field

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cabinpose.record.emulate.mvn import Network
from cabinpose.record.emulate.mvn_motion import generated
from cabinpose.record.emulate.mvn_streamer import Datagram, MvnEmulatorSettings, Streamer
from cabinpose.record.sources import mvn_protocol as mvn
from cabinpose.record.sources.mvn import MvnSettings, MvnSource
from cabinpose.signals.recorded import Counts, Sample

MOTION = generated("walk", rate_hz=60)


def test_two_senders_with_one_character_id_are_counted_apart() -> None:
    """Each counts by itself, far from the other: nothing is lost, and nobody began anew."""
    source, first, second = MvnSource("suit"), ("127.0.0.1", 5001), ("127.0.0.1", 5002)
    mine, other = (Streamer(MvnEmulatorSettings(meta_every_s=0), MOTION) for _ in range(2))
    samples = []
    for n in range(100):
        for streamer, number, sender in ((mine, n, first), (other, 50_000 + n, second)):
            samples += [source.take(d.data, n * 16_000_000, sender) for d in streamer.sample(number)]
    assert source.counts == Counts(received=200)
    assert len({sample.sequence for sample in samples}) == 200


def test_a_sender_that_returns_from_another_port_goes_on_where_it_was() -> None:
    source, streamer = MvnSource("suit"), Streamer(MvnEmulatorSettings(meta_every_s=0), MOTION)
    for n, sender, at_ns in ((0, 5001, 0), (1, 5001, 10**7), (5, 5002, 3 * 10**9), (6, 5002, 3 * 10**9 + 10**7)):
        for datagram in streamer.sample(n):
            source.take(datagram.data, at_ns, ("127.0.0.1", sender))
    assert (source.counts.received, source.counts.lost, source.counts.restarts) == (4, 3, 0)


@dataclass
class Truth:
    """What was sent and what arrived of it, kept without the tracker's help: streams are (epoch, kind, character)."""

    sent: dict[tuple, list[int]] = field(default_factory=lambda: defaultdict(list))  # unwrapped numbers of samples
    arrived: dict[tuple, list[tuple[int, int, int]]] = field(default_factory=lambda: defaultdict(list))  # number, piece, pieces

    def counts(self) -> Counts:
        """Between the first and the last sample of a stream of which anything arrived."""
        counts = Counts()
        for stream, arrived in self.arrived.items():
            pieces: dict[int, set[int]] = defaultdict(set)
            newest = (-1, -1)
            needed = {}
            for number, piece, of in arrived:
                if piece in pieces[number]:
                    counts.duplicate += 1
                    continue
                pieces[number].add(piece)
                needed[number] = of
                counts.reordered += (number, piece) < newest
                newest = max(newest, (number, piece))
            whole = {number for number, got in pieces.items() if len(got) == needed[number]}
            span = [number for number in self.sent[stream] if min(pieces) <= number <= max(pieces)]
            counts.received += len(whole)
            counts.lost += len(set(span) - whole)
        return counts


def play(
    source: MvnSource,
    given_: MvnEmulatorSettings,
    samples: int,
    truth: Truth,
    *,
    epoch: int = 0,
    at_ns: int = 0,
    dies: bool = False,
) -> list[Sample]:
    """Stream into the source without a socket, at the stream's own pace."""
    streamer, network = Streamer(given_, MOTION), Network(given_)
    numbers: dict[int, int] = {}
    taken: list[Sample] = []

    def deliver(datagram: Datagram, copies: int, now_ns: int) -> None:
        if datagram.kind in mvn.COUNTED:
            stream = (epoch, datagram.kind, datagram.character)
            entry = (numbers[datagram.counter], datagram.piece, datagram.pieces)
            truth.arrived[stream] += [entry] * copies
            if not copies and not truth.arrived[stream]:
                del truth.arrived[stream]
        taken.extend(source.take(datagram.data, now_ns) for _ in range(copies))

    for number in range(samples):
        now_ns = at_ns + round(number * 1e9 / given_.rate_hz)
        for datagram in streamer.sample(number):
            numbers[datagram.counter] = number
            if datagram.kind in mvn.COUNTED and datagram.piece == 0:
                truth.sent[epoch, datagram.kind, datagram.character].append(number)
            for each, copies, _ in network.carry(datagram):
                deliver(each, copies, now_ns)
    for each, copies, _ in network.rest(lost=dies):
        deliver(each, copies, at_ns + round(samples * 1e9 / given_.rate_hz))
    return taken


def listening(**given_: object) -> MvnSource:
    source = MvnSource("suit", MvnSettings(port=0, **given_))
    source.open()
    return source


def test_the_network_does_what_it_is_told() -> None:
    """Shares within five standard deviations of a binomial; so many overtake a late datagram as asked; the seed decides."""
    given_ = MvnEmulatorSettings(loss=0.1, duplicate=0.05, reorder=0.2, reorder_by=4, seed=9)
    count = 4000

    def fates(given_: MvnEmulatorSettings) -> list[tuple[int, int, bool, int]]:
        network, out = Network(given_), []
        for n in range(count):
            datagram = Datagram(2, 0, n, 0, 1, 0, b"")
            out += [(each.counter, copies, late, n) for each, copies, late in network.carry(datagram)]
        return out + [(each.counter, copies, late, count) for each, copies, late in network.rest()]

    told = fates(given_)
    assert sorted(number for number, *_ in told) == list(range(count))
    for share, seen in (
        (0.1, sum(copies == 0 for _, copies, _, _ in told)),
        (0.9 * 0.05, sum(copies == 2 for _, copies, _, _ in told)),
        (0.9 * 0.2, sum(late for _, _, late, _ in told)),
    ):
        assert abs(seen - share * count) < 5 * (count * share * (1 - share)) ** 0.5
    assert {n - number for number, _, late, n in told if late and n < count} == {4}
    assert all(n == number for number, _, late, n in told if not late)
    assert fates(given_) == told != fates(given_.model_copy(update={"seed": 10}))


@pytest.mark.slow
@settings(max_examples=60)
@given(st.data())
def test_every_sample_is_received_or_lost(data: st.DataObject) -> None:
    draw = data.draw
    rate, capture = draw(st.sampled_from([(60, None), (60, 60), (60, 240), (120, 240)]))
    emulated = MvnEmulatorSettings(
        rate_hz=rate,
        capture_rate_hz=capture,
        kinds=draw(st.sampled_from([(2,), (2, 23), (1, 2, 24, 25)])),
        characters=draw(st.integers(1, 3)),
        fingers=draw(st.booleans()),
        items_per_datagram=draw(st.sampled_from([None, 12])),
        start_counter=draw(st.sampled_from([0, 1000, 2**32 - 40])),
        loss=draw(st.sampled_from([0, 0.01, 0.1])),
        duplicate=draw(st.sampled_from([0, 0.05])),
        reorder=draw(st.sampled_from([0, 0.02, 0.2])),
        reorder_by=draw(st.integers(1, 6)),
        seed=draw(st.integers(0, 1000)),
    )
    source, truth = listening(counter_step=None if capture is None else capture / rate), Truth()
    taken = play(source, emulated, 80, truth)
    source.close()
    assert source.counts == truth.counts()
    assert len(taken) == sum(map(len, truth.arrived.values())) + sum(s.raw[4:6] in (b"12", b"13") for s in taken)
    # The sequence has a gap for each lost sample, and none other (samples before the first that came have no sequence).
    numbered = [s.sequence for s in taken if s.sequence is not None]
    assert len(set(numbered)) == len(numbered)
    missing = source._tracker.take(0) - 1024 - len(numbered)
    early = source.counts.received - len(numbered)
    assert missing == source.counts.lost if not early else missing <= source.counts.lost


def test_the_step_of_a_lower_streaming_rate_is_found() -> None:
    """Capture at 240 Hz, streams at 60 and 100: the counter rises by 4, and by 2 or 3; losses are exact nevertheless."""
    for rate in (60.0, 100.0):
        for loss in (0.0, 0.03):
            emulated = MvnEmulatorSettings(rate_hz=rate, capture_rate_hz=240, loss=loss, reorder=0.02, seed=4)
            source, truth = listening(), Truth()
            play(source, emulated, 400, truth)
            source.close()
            assert source.counts == truth.counts()


def test_a_sender_that_streams_faster_than_before() -> None:
    source, truth = listening(), Truth()
    play(source, MvnEmulatorSettings(rate_hz=60, capture_rate_hz=240), 60, truth)
    play(source, MvnEmulatorSettings(rate_hz=240, start_counter=240), 100, truth, epoch=1, at_ns=1_000_000_000)
    source.close()
    assert (source.counts.received, source.counts.lost, source.counts.restarts) == (160, 0, 0)


def arriving(source: MvnSource, emulated: MvnEmulatorSettings, numbers: list[int]) -> None:
    streamer = Streamer(emulated.model_copy(update={"meta_every_s": 0}), MOTION)
    for at, number in enumerate(numbers):
        for datagram in streamer.sample(number):
            source.take(datagram.data, at * 16_666_667)


def test_losses_while_the_step_is_found() -> None:
    """Of the first samples more than half are lost, one or two in a row; the step is that of the others."""
    source = listening()
    came = [0, 1, 4, 6, 9, 10, 13, 15, 18, 19, 22, 24, 27, 28, 31, 33, 36, *range(37, 60)]
    arriving(source, MvnEmulatorSettings(rate_hz=60, capture_rate_hz=240), came)
    assert source.counts == Counts(received=40, lost=20)


def test_a_broken_step_grows_sharp() -> None:
    """At 240 / 100 the step is known from 16 samples to 2 %, from 500 to 0.1 %: enough for a long gap."""
    source = listening()
    arriving(source, MvnEmulatorSettings(rate_hz=100, capture_rate_hz=240), [*range(500), *range(3500, 3510)])
    assert abs(source.counts.lost - 3000) <= 3


def test_the_first_to_come_was_not_the_first() -> None:
    """Sample 5 overtakes 3: 4 is lost, until it comes too; what precedes the first has no sequence."""
    source = listening()
    arriving(source, MvnEmulatorSettings(), [5, 3, 6])
    assert source.counts == Counts(received=3, lost=1, reordered=1)
    arriving(source, MvnEmulatorSettings(), [4])
    assert source.counts == Counts(received=4, reordered=2)


def test_many_losses_do_not_make_a_step() -> None:
    source, truth = listening(), Truth()
    play(source, MvnEmulatorSettings(loss=0.3, seed=3), 600, truth)
    source.close()
    assert source.counts == truth.counts()
    assert source.counts.lost > 150


def test_the_counter_wraps() -> None:
    source, truth = listening(), Truth()
    taken = play(source, MvnEmulatorSettings(start_counter=2**32 - 5, meta_every_s=0), 10, truth)
    assert [s.sequence for s in taken] == list(range(1024, 1034))
    assert source.counts == Counts(received=10)


def test_a_sender_that_dies_and_returns() -> None:
    """Both lives are accounted for exactly, what died in the network with the sender too; the streams begin anew together."""
    first = MvnEmulatorSettings(
        kinds=(2, 23), characters=2, start_counter=5000, loss=0.02, reorder=0.05, duplicate=0.02, items_per_datagram=12, seed=1
    )
    second = first.model_copy(update={"start_counter": 0, "seed": 2})
    source, truth = listening(), Truth()
    play(source, first, 300, truth, dies=True)
    play(source, second, 300, truth, epoch=1, at_ns=8_000_000_000)
    source.close()
    expected = truth.counts()
    expected.restarts = 1
    assert source.counts == expected
    assert expected.lost > 20


def test_a_short_life_before_the_return() -> None:
    """A restart whose counters were seen before is told by other bytes."""
    source, truth = listening(), Truth()
    play(source, MvnEmulatorSettings(start_counter=0), 30, truth)
    play(source, MvnEmulatorSettings(start_counter=0, clock_offset_s=5), 30, truth, epoch=1, at_ns=600_000_000)
    source.close()
    assert (source.counts.received, source.counts.lost, source.counts.duplicate, source.counts.restarts) == (60, 0, 0, 1)


def test_a_return_right_after_the_first_sample() -> None:
    """Counters far below the first that came are no late ones, however soon they come."""
    source = listening()
    arriving(source, MvnEmulatorSettings(start_counter=5000), list(range(5)))
    arriving(source, MvnEmulatorSettings(), list(range(5)))
    assert source.counts == Counts(received=10, restarts=1)


def test_a_network_that_is_away_for_a_while_loses_what_was_sent() -> None:
    emulated = MvnEmulatorSettings(meta_every_s=0)
    source = listening()
    datagrams = [d for n in range(1000) for d in Streamer(emulated, MOTION).sample(n)]
    for n in [*range(100), *range(900, 1000)]:
        source.take(datagrams[n].data, round(n * 1e9 / 60))
    assert source.counts == Counts(received=200, lost=800)


def test_a_leap_of_the_counter_is_a_new_beginning() -> None:
    source, truth = listening(), Truth()
    play(source, MvnEmulatorSettings(start_counter=0), 5, truth)
    play(source, MvnEmulatorSettings(start_counter=10**6), 5, truth, at_ns=10**9)
    assert (source.counts.received, source.counts.lost, source.counts.restarts) == (10, 0, 1)


def test_a_paused_sender_repeats_itself() -> None:
    source = listening()
    (datagram,) = Streamer(MvnEmulatorSettings(meta_every_s=0), MOTION).sample(3)
    samples = [source.take(datagram.data, n * 300_000_000) for n in range(30)]
    assert source.counts == Counts(received=1, duplicate=29)
    assert [bool(s.messages) for s in samples] == [True] + [False] * 29
    assert all(s.raw == datagram.data for s in samples)


def test_a_new_recording_in_mvn_starts_its_clock_again() -> None:
    """The counter goes on, the time code falls: one restart, nothing lost, and device times as they are sent."""
    source = listening()
    streamers = [Streamer(MvnEmulatorSettings(meta_every_s=0, clock_offset_s=s, characters=2), MOTION) for s in (100, 0)]
    times = []
    for n in range(60):
        times += [source.take(datagram.data, n * 16_666_667).device_ns for datagram in streamers[n // 30].sample(n)]
    assert source.counts == Counts(received=120, restarts=1)
    assert times[58] == round(100_000 + 29 * 1000 / 60) * 10**6
    assert times[60] == 500 * 10**6


def test_device_time_wraps_with_its_32_bits() -> None:
    source = listening()
    streamer = Streamer(MvnEmulatorSettings(meta_every_s=0, clock_offset_s=2**32 / 1000 - 1), MOTION)
    times = [source.take(d.data, n * 16_666_667).device_ns for n in range(120) for d in streamer.sample(n)]
    assert times[-1] - times[0] == pytest.approx(119 / 60 * 1e9, abs=1e6)
    assert source.counts.restarts == 0


def test_pieces_that_never_come() -> None:
    """A sample that lacks a piece is lost when its time is over, or at the end; `incomplete` says that a part came."""
    emulated = MvnEmulatorSettings(meta_every_s=0, items_per_datagram=10)
    source = listening(reorder_window_s=0.5)
    pieces = [list(Streamer(emulated, MOTION).sample(n)) for n in range(40)]
    for n, sample in enumerate(pieces):
        for datagram in sample[1:] if n in (3, 39) else sample:
            source.take(datagram.data, n * 16_666_667)
        if n == 20:
            assert (source.counts.lost, source.incomplete) == (0, 0)  # may still come
    assert (source.counts.lost, source.incomplete) == (1, 1)
    source.close()
    assert (source.counts.received, source.counts.lost, source.incomplete) == (38, 2, 2)


def test_pieces_in_any_order_make_the_same_message() -> None:
    emulated = MvnEmulatorSettings(meta_every_s=0, items_per_datagram=6, fingers=True)
    pieces = list(Streamer(emulated, MOTION).sample(0))
    (whole,) = Streamer(emulated.model_copy(update={"items_per_datagram": None}), MOTION).sample(0)
    (straight,) = [s for s in [listening().take(whole.data, 0)] if s.messages]
    source = listening()
    samples = [source.take(d.data, 0) for d in reversed(pieces)]
    assert [bool(s.messages) for s in samples] == [False] * 10 + [True]
    assert (samples[-1].messages[-1].position_m == straight.messages[-1].position_m).all()
    assert source.counts == Counts(received=1, reordered=10)


def test_pieces_that_contradict_each_other_are_malformed() -> None:
    pieces = [d.data for d in Streamer(MvnEmulatorSettings(meta_every_s=0, items_per_datagram=10), MOTION).sample(0)]
    beyond = bytearray(pieces[0])
    beyond[10] = 9  # a piece after the last
    again_last = bytearray(pieces[0])
    again_last[10] = 0x80 | 5
    source = listening()
    for data in (pieces[2], bytes(beyond), bytes(again_last), pieces[0], pieces[1]):
        source.take(data, 0)
    assert source.counts == Counts(received=1, malformed=2, reordered=2)


def test_memory_is_bounded_whatever_is_sent() -> None:
    """Streams, samples that lack pieces, and gaps, of a sender that makes up all its numbers."""
    source = listening()
    payload = bytes(32)
    for n in range(3000):
        header = mvn.Header(2, n * 997 % 2**32, 1, False, 1, 0, n % 256, 23, 0, 0, 32)
        source.take(mvn.build_header(header) + payload, 0)
    for n in range(10_000):
        header = mvn.Header(21, n * 7, 0, True, 1, 0, 0, 23, 0, 0, 40)
        source.take(mvn.build_header(header) + bytes(40), 0)
    other = listening()
    for n in range(500):
        header = mvn.Header(22, n, 0, False, 1, 0, 0, 23, 0, 0, 44)
        other.take(mvn.build_header(header) + bytes(44), 0)
    assert len(other._tracker._streams[None, 22, 0]._open) <= 65
    streams = source._tracker._streams
    assert len(streams) <= 256
    assert max(len(s._open) for s in streams.values()) <= 65
    assert max(len(s._seen) for s in streams.values()) <= 4097
    assert max(len(s._missing) for s in streams.values()) <= 4096

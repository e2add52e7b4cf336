"""The bytes of DataStream: held against bytes laid out by hand after the SDK's classes; mutated; cut anywhere."""

from __future__ import annotations

import struct
import tracemalloc

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from cabinpose.record.sources import vicon_protocol as vicon
from cabinpose.record.sources.vicon_messages import PacketDecoder, latency
from cabinpose.record.sources.vicon_protocol import Contents, Packet, PacketSplitter, SegmentInfo, SubjectInfo, Type

ROTATION = (0.0, -1.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0)


def block(kind: int, data: bytes) -> bytes:
    return struct.pack("<II", kind, len(data)) + data


def string(text: str) -> bytes:
    return struct.pack("<I", len(text.encode())) + text.encode()


def by_hand() -> bytes:
    """A packet with one object of each type that is read, in the order in which they are built."""
    subject = struct.pack("<I", 7) + string("Müller")
    subject += (
        struct.pack("<I", 2) + struct.pack("<II6f", 0, 3, *range(6)) + string("Root") + struct.pack("<II6f", 3, 4, *range(6))
    )
    subject += string("Head") + struct.pack("<II", 1, 11) + string("C7") + struct.pack("<III", 1, 11, 4)
    recon = struct.pack("<d3d9dI", 7.0, 1.0, 2.0, 3.0, *range(9), 99)
    segment = struct.pack("<I3d9d", 3, 100.0, 200.0, 300.0, *ROTATION)
    blocks = [
        block(100001, struct.pack("<III", 2, 1, 100004)),
        block(100002, b"\1"),
        block(100008, struct.pack("<I", 3)),
        block(42, struct.pack("<Q", 1 << 40)),
        block(100004, struct.pack("<III", 1, 5, 1) + struct.pack("<II", 1, 2)),
        block(5, struct.pack("<I", 41)),
        block(36, struct.pack("<I", 4100)),
        block(1, struct.pack("<q", 1_350_000)),
        block(37, b"\1"),
        block(39, struct.pack("<I", 1) + string("Camera") + struct.pack("<d", 100.0)),
        block(
            26, struct.pack("<I", 2) + string("Camera") + struct.pack("<d", 0.004) + string("Label") + struct.pack("<d", 0.001)
        ),
        block(2, subject),
        block(28, struct.pack("<II", 7, 1) + segment),
        block(6, struct.pack("<III", 1, 7, 11) + recon),
        block(7, struct.pack("<I", 1) + recon),
        block(9, struct.pack("<II", 7, 1) + segment),
        block(8, struct.pack("<II", 7, 1) + segment),
    ]
    return struct.pack("<II", 0x1A2B0001, sum(map(len, blocks))) + b"".join(blocks)


def test_reads_what_the_sdk_writes() -> None:
    packet = vicon.decode(vicon.payload(by_hand()))
    assert packet.faults == 0
    assert packet.enums == {1, 100004}
    assert packet.streaming is True
    assert packet.next_frames == 3
    assert packet.ping == 1 << 40
    assert packet.contents == Contents({5: 1}, frozenset({2}))
    assert (packet.frame, packet.hardware_frame, packet.period, packet.y_up) == (42, 4100, 1_350_000, True)
    assert packet.rates == {"Camera": 100.0}
    assert packet.latency == (("Camera", 0.004), ("Label", 0.001))
    bounds = tuple(map(float, range(6)))
    segments = (SegmentInfo(0, 3, "Root", bounds), SegmentInfo(3, 4, "Head", bounds))
    assert packet.subjects == [SubjectInfo(7, "Müller", segments, ((11, "C7"),), ((11, 4),))]
    assert packet.labeled is not None
    assert packet.unlabeled is not None
    assert packet.labeled["subject"].tolist() == [7]
    assert packet.labeled["marker"].tolist() == [11]
    for rows in (packet.labeled, packet.unlabeled):
        assert rows["position"].tolist() == [[1.0, 2.0, 3.0]]
        assert rows["covariance"].tolist() == [list(range(9))]
        assert (rows["radius"].tolist(), rows["trajectory"].tolist()) == ([7.0], [99])
    for of in (packet.neutral, packet.global_segments, packet.local_segments):
        assert list(of) == [7]
        assert of[7]["segment"].tolist() == [3]
        assert of[7]["translation"].tolist() == [[100.0, 200.0, 300.0]]
        assert of[7]["rotation"].tolist() == [list(ROTATION)]


def test_writes_what_the_sdk_writes() -> None:
    raw = by_hand()
    assert vicon.encode(vicon.decode(vicon.payload(raw))) == raw


def test_ids_are_the_sdks() -> None:
    assert vicon.MAGIC == 0x1A2B0001
    assert {kind.name: int(kind) for kind in Type} == {
        "STREAM_INFO": 1, "SUBJECT_INFO": 2, "FRAME_INFO": 5, "LABELED_RECONS": 6, "UNLABELED_RECONS": 7, "LOCAL_SEGMENTS": 8,
        "GLOBAL_SEGMENTS": 9, "LATENCY_INFO": 26, "SUBJECT_TOPOLOGY": 28, "HARDWARE_FRAME_INFO": 36, "APPLICATION_INFO": 37,
        "FRAME_RATE_INFO": 39, "PING": 42, "OBJECT_ENUMS": 100001, "REQUEST_FRAME": 100002, "CONTENTS": 100004,
        "REQUEST_NEXT_FRAME": 100008,
    }  # fmt: skip


def test_frames_have_the_sdks_numbers() -> None:
    """`GetFrameNumber` is the number in the bytes + 1, in 32 bits."""
    for in_bytes, of_sdk in ((0, 1), (41, 42), (0xFFFFFFFF, 0)):
        data = block(5, struct.pack("<I", in_bytes))
        assert vicon.decode(data).frame == of_sdk
        assert vicon.encode(Packet(frame=of_sdk))[8:] == data


def test_unknown_blocks_are_skipped() -> None:
    unknown = block(65001, bytes(40)) + block(5, struct.pack("<I", 3))
    packet = vicon.decode(unknown)
    assert (packet.frame, packet.faults) == (4, 0)


def test_a_later_version_may_append_to_a_block() -> None:
    assert vicon.decode(block(5, struct.pack("<II", 3, 8))).frame == 4


@pytest.mark.parametrize(
    "data",
    [
        block(5, b"\1\2"),  # too short for its type
        block(6, struct.pack("<I", 0xFFFFFFFF)),  # more items than there are bytes for
        block(6, struct.pack("<I", 1) + bytes(115)),
        block(26, struct.pack("<II", 1, 0xFFFFFFF0)),  # a text longer than the block
        block(2, struct.pack("<II", 7, 0) + struct.pack("<I", 0x7FFFFFFF)),
        block(9, struct.pack("<II", 7, 0x28F5C29)),  # count * 100 = 2**32 + 4: no overflow makes it fit
        struct.pack("<II", 5, 1 << 31),  # a block longer than the packet
        b"\1\2\3",  # no block
    ],
)
def test_what_does_not_fit_is_a_fault_and_the_rest_stands(data: bytes) -> None:
    packet = vicon.decode(block(1, struct.pack("<q", 10)) + data)
    assert packet.faults == 1
    assert packet.period == 10
    assert packet.frame is None
    assert packet.labeled is None
    assert packet.subjects == []
    assert packet.global_segments == {}


def test_sizes_of_headers_allocate_nothing() -> None:
    bombs = [block(kind, struct.pack("<III", 7, 0x0FFFFFFF, 0x0FFFFFFF)) for kind in Type]
    splitter = PacketSplitter()
    tracemalloc.start()
    for bomb in bombs:
        vicon.decode(bomb)
        splitter.feed(struct.pack("<II", vicon.MAGIC, 0xFFFFFFF0) + bomb)
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert peak < 1 << 20
    assert splitter.malformed == 1  # nothing that came after the first was a packet


@given(cuts=st.lists(st.integers(1, 60), min_size=1, max_size=40))
def test_packets_are_cut_out_of_any_pieces(cuts: list[int]) -> None:
    packets = [vicon.encode(Packet(frame=i, ping=i, latency=(("x" * i, 0.1),))) for i in range(5)]
    stream, found, splitter = b"".join(packets), [], PacketSplitter()
    for cut in [*cuts, len(stream)]:
        found += splitter.feed(stream[:cut])
        stream = stream[cut:]
    assert found == packets
    assert splitter.malformed == 0


@given(garbage=st.lists(st.binary(min_size=1, max_size=30), min_size=4, max_size=4), cut=st.integers(1, 50))
def test_garbage_between_packets_is_counted_and_passed_over(garbage: list[bytes], cut: int) -> None:
    packets = [vicon.encode(Packet(frame=i)) for i in range(4)]
    stream = b"".join(noise.replace(b"\1", b"\2") + packet for noise, packet in zip(garbage, packets, strict=True))
    splitter, found = PacketSplitter(), []
    for start in range(0, len(stream), cut):
        found += splitter.feed(stream[start : start + cut])
    assert found == packets
    assert splitter.malformed == 4


def test_a_packet_over_the_limit_is_malformed() -> None:
    large = vicon.encode(Packet(latency=(("x" * 200, 0.0),)))
    small = vicon.encode(Packet(frame=1))
    splitter = PacketSplitter(limit=100)
    assert splitter.feed(large + small) == [small]
    assert splitter.malformed == 1


def mutated(raw: bytes, rng: np.random.Generator) -> bytes:
    """A packet with some bytes changed, numbers made absurd, pieces cut out, doubled or swapped."""
    data = bytearray(raw)
    for _ in range(rng.integers(1, 5)):
        at, what = int(rng.integers(0, max(1, len(data)))), int(rng.integers(0, 5))
        if what == 0 and data:
            data[at] = rng.integers(0, 256)
        elif what == 1:
            data[at : at + 4] = struct.pack("<I", int(rng.choice([0, 1, 0x7FFFFFFF, 0x80000000, 0xFFFFFFFF, len(data)])))
        elif what == 2:
            del data[at : at + int(rng.integers(1, 40))]
        elif what == 3:
            data[at:at] = data[at : at + int(rng.integers(1, 40))]
        else:
            data[at : at + 8] = struct.pack("<d", float(rng.choice([np.nan, np.inf, -1e308, 5e-324])))
    return bytes(data)


def digest(raw: bytes, splitter: PacketSplitter, decoder: PacketDecoder) -> int:
    """Everything that the source does with bytes; how many faults they had."""
    before, faults = splitter.malformed, 0
    for whole in splitter.feed(raw):
        packet = vicon.decode(vicon.payload(whole))
        faults += packet.faults
        decoder.statics(packet)
        messages = [*decoder.poses(packet), *decoder.labeled(packet), *decoder.unlabeled(packet), *latency(packet, 0.0)]
        for message in messages:
            for value in vars(message).values():
                assert not isinstance(value, np.ndarray) or value.dtype == np.float64
        decoder.device_ns(packet.frame or 0)
    return faults + splitter.malformed - before


@pytest.mark.filterwarnings("error")
def test_mutated_packets_neither_crash_nor_hang() -> None:
    rng = np.random.Generator(np.random.Philox(key=5))
    raw, faulty = by_hand(), 0
    splitter, decoder = PacketSplitter(limit=1 << 16), PacketDecoder()
    for _ in range(3000):
        faulty += digest(mutated(raw, rng), splitter, decoder) > 0
    assert 300 < faulty < 3000
    splitter.feed(bytes(1 << 17))  # whatever length a mutant claimed: after it, packets are found again
    assert splitter.feed(raw)[-1:] == [raw]


@given(st.binary(max_size=400))
def test_any_bytes_are_decoded_without_an_error(data: bytes) -> None:
    packet = vicon.decode(data)
    assert packet.faults > 0 or len(data) == 0 or len(data) >= 8

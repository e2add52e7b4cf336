"""What is left of a recording, whatever happened to its file: each truncation, bits flipped, garbage, a full disk."""

from __future__ import annotations

import hashlib
import itertools
import struct
from collections.abc import Iterable, Sequence
from pathlib import Path

import lz4.frame
import numpy as np
import pytest
import zstandard
from hypothesis import given, settings
from hypothesis import strategies as st
from mcap.reader import make_reader
from mcap.writer import Writer
from recorded_things import bits, markers, poses, take_samples, tof_frame

from cabinpose.core.errors import RecordingError
from cabinpose.signals.recorded import Channels, Facts, Sample
from cabinpose.store.recording import Chunking, Participant, Recording, RecordingWriter, SourceStatus, Take, recover, survey
from cabinpose.store.recording.scan import Chunk, RawMessage, Scanner, _uncompressed, messages_in

TAKE = Take(action="reach", subjects=(Participant(code="S07"),))
SAMPLES = take_samples(24, rng=np.random.default_rng(5))
RIG = "sources: {suit: {kind: mvn}}\n"
Line = tuple[str, int, int, int, str]


def digest(data: bytes | memoryview) -> str:
    return hashlib.sha256(data).hexdigest()[:12]


def made(
    path: Path,
    compression: str = "none",
    chunk_bytes: int = 4000,
    samples: Sequence[tuple[str, Sample]] = SAMPLES,
    definitions_s: float = 10.0,
) -> bytes:
    """A small file of several chunks."""
    how = {"compression": compression, "chunk_bytes": chunk_bytes, "definitions_s": definitions_s}
    with RecordingWriter(path, TAKE, rig=RIG, chunking=Chunking(sync_s=0, **how)) as writer:
        for source, sample in samples:
            writer.write(source, sample)
    return path.read_bytes()


def lines(path: Path) -> list[Line]:
    """Every message in the order of the file, as the mcap package's reader gives it, checksums compared."""
    with path.open("rb") as file:
        found = make_reader(file, validate_crcs=True).iter_messages(log_time_order=False)
        return [(c.topic, m.sequence, m.log_time, m.publish_time, digest(m.data)) for _, c, m in found]


@pytest.fixture(scope="module", params=["none", "lz4", "zstd"])
def whole(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> tuple[bytes, list[Line]]:
    path = tmp_path_factory.mktemp("whole") / f"{request.param}.mcap"
    return made(path, request.param), lines(path)


def saved(folder: Path, data: bytes) -> tuple[list[Line], object] | None:
    """Messages and damage of what recovery makes of the bytes; None where it says that there is nothing."""
    damaged, out = folder / "damaged.mcap", folder / "out.mcap"
    damaged.write_bytes(data)
    out.unlink(missing_ok=True)
    try:
        result = recover(damaged, out)
    except RecordingError:
        assert not out.exists()
        return None
    found = lines(out)
    assert len(found) == result.messages
    assert list(folder.glob(".*")) == []
    return found, result.damage


def check_truncations(path: Path, data: bytes, truth: list[Line], sizes: Iterable[int]) -> None:
    """Read as a recorder's file is after kill -9: nothing invented, nothing lost that was whole, in order; never an error."""
    before = 0
    for size in sizes:
        path.write_bytes(data[:size])
        with Scanner(path) as scanner:
            _, channels = scanner.definitions()
            found = [
                (channels[m.channel_id].topic, m.sequence, m.log_time, m.publish_time, digest(m.data))
                for chunk in scanner.walk()
                if isinstance(chunk, Chunk)
                for m in messages_in(chunk.records)
            ]
            assert found == truth[: len(found)]
            assert len(found) >= before, size
            assert scanner.damage.whole == (size == len(data))
            assert not scanner.damage.chunks
            before = len(found)
    assert before == len(truth)


def test_a_prefix_of_the_messages_survives_truncation(tmp_path: Path, whole: tuple[bytes, list[Line]]) -> None:
    data, truth = whole
    sizes = sorted({*range(0, len(data), 151), *range(len(data) - 60, len(data) + 1)})
    check_truncations(tmp_path / "cut.mcap", data, truth, sizes)


@pytest.mark.slow
def test_truncation_at_every_byte(tmp_path: Path) -> None:
    data = made(tmp_path / "a.mcap", chunk_bytes=600, samples=[s for s in SAMPLES if s[0] == "suit"][:4])
    check_truncations(tmp_path / "cut.mcap", data, lines(tmp_path / "a.mcap"), range(len(data) + 1))


def test_truncated_files_become_ordinary_ones(tmp_path: Path, whole: tuple[bytes, list[Line]]) -> None:
    data, truth = whole
    for size in [*range(0, 900, 41), *range(900, len(data), len(data) // 25), len(data) - 1, len(data)]:
        outcome = saved(tmp_path, data[:size])
        if outcome is None:
            assert size < 400  # the first chunk, with the take, is not whole
            continue
        found, damage = outcome
        assert found == truth[: len(found)]
        assert damage.any == (size < len(data))
        with Recording(tmp_path / "out.mcap") as recording:
            assert recording.take == TAKE
            samples = [bits(sample) for _, sample in recording.samples()]
            assert samples == [bits(sample) for _, sample in SAMPLES][: len(samples)]
    assert found == truth


@pytest.mark.parametrize(
    ("compression", "chunk_bytes"),
    [
        ("zstd", 1000),
        *(pytest.param(*each, marks=pytest.mark.slow) for each in (("none", 1000), ("none", 1 << 24), ("lz4", 1000))),
    ],
)
def test_a_sample_is_whole_or_left_out(tmp_path: Path, compression: str, chunk_bytes: int) -> None:
    """Wherever a file ends: its samples are the first of those written, each with all messages; so are those of its recovery."""
    kinds = (
        poses(rng=(rng := np.random.default_rng(8))), markers(rng=rng), Channels(("fx",), np.ones(1)), Facts("suit", {"a": 1}),
        tof_frame(rng=rng, width=3, height=2),
    )  # fmt: skip
    samples = [
        (f"device{i % 2}", Sample(i, 10**18 + i, 7 + i, rng.bytes(9), tuple(kinds[k] for k in rng.permutation(5)[: 1 + i % 5])))
        for i in range(9)
    ]
    data = made(tmp_path / "a.mcap", compression, chunk_bytes, samples)
    truth, counts = [(source, bits(sample)) for source, sample in samples], set()
    path, out = tmp_path / "cut.mcap", tmp_path / "out.mcap"
    for size in range(400, len(data), len(data) // 150):
        path.write_bytes(data[:size])
        try:
            recording = Recording(path)
        except RecordingError:
            assert not counts  # not even the take is there yet
            continue
        with recording:
            found = [(source, bits(sample)) for source, sample in recording.samples()]
            assert found == truth[: len(found)], size
            assert recording.damage.unfinished in (0, 1)
            if len(found) < len(truth):  # of what the scanner gives, the last sample alone may be missing
                begun = sum(message.channel_id in raw for message in scanned(path)) if (raw := raw_channels(path)) else 0
                assert begun - len(found) == recording.damage.unfinished, size
        assert sum(source.samples for source in survey(path).sources) == len(found)
        out.unlink(missing_ok=True)
        result = recover(path, out)
        assert sum(result.samples.values()) == len(found)
        with Recording(out) as recovered:
            assert [(source, bits(sample)) for source, sample in recovered.samples()] == found
        counts.add(len(found))
    assert len(counts) > 4


def test_a_sample_with_a_status_behind_it_is_whole(tmp_path: Path) -> None:
    (source, first), (_, second) = [sample for sample in SAMPLES if sample[0] == "suit"][:2]
    with RecordingWriter(tmp_path / "a.mcap", TAKE, chunking=Chunking(sync_s=0, flush_s=60.0, chunk_bytes=1 << 24)) as writer:
        writer.write(source, first)
        writer.write_status(SourceStatus(source, "mvn", "recording"), first.host_ns + 1)
        writer.write(source, second)
    data = (tmp_path / "a.mcap").read_bytes()
    (tmp_path / "cut.mcap").write_bytes(data[: data.index(second.raw)])
    with Recording(tmp_path / "cut.mcap") as recording:
        assert [bits(sample) for _, sample in recording.samples()] == [bits(first)]
        assert recording.damage.unfinished == 0


def scanned(path: Path) -> list[RawMessage]:
    """Every message that the scanner gives, of unfinished samples too."""
    with Scanner(path) as scanner:
        return [m for chunk in scanner.walk() if isinstance(chunk, Chunk) for m in messages_in(chunk.records)]


def raw_channels(path: Path) -> set[int]:
    with Scanner(path) as scanner:
        return {i for i, channel in scanner.definitions()[1].items() if channel.topic.endswith("/raw")}


@pytest.mark.parametrize("compression", ["none", "lz4", "zstd"])
def test_of_half_a_chunk_the_whole_messages_are_kept(tmp_path: Path, compression: str) -> None:
    """A file of another writer may be one large chunk: what stands before the cut is worth having, and said to be unverified."""
    data = made(tmp_path / "a.mcap", compression, 1 << 24, take_samples(300, rng=np.random.default_rng(6)))
    outcome = saved(tmp_path, data[: len(data) * 6 // 10])
    assert outcome is not None
    found, damage = outcome
    truth = lines(tmp_path / "a.mcap")
    assert found == truth[: len(found)]
    assert len(found) > 0.4 * len(truth)
    assert damage.unverified == len(found) - 1  # all but the take, which has a chunk of its own


def test_what_unpacks_to_more_than_it_says_is_stopped() -> None:
    for compression, body in (("zstd", zstandard.compress(bytes(1 << 26))), ("lz4", lz4.frame.compress(bytes(1 << 26)))):
        data, whole = _uncompressed(body, compression, 100)
        assert not whole
        assert len(data) < 1 << 22


@settings(max_examples=60)
@given(st.data())
def test_flipped_bits_are_found_and_counted(tmp_path_factory: pytest.TempPathFactory, whole: tuple, data: st.DataObject) -> None:
    """Whatever the bits: each message that is given is one that was written, in order; a loss is never silent."""
    content, truth = whole
    flips = data.draw(st.lists(st.integers(0, 8 * len(content) - 1), min_size=1, max_size=4, unique=True))
    changed = bytearray(content)
    for flip in flips:
        changed[flip // 8] ^= 1 << flip % 8
    outcome = saved(tmp_path_factory.mktemp("flipped"), bytes(changed))
    assert outcome is not None
    found, damage = outcome
    rest = iter(truth)
    assert all(line in rest for line in found), "a message that was not written, or in another order"
    if len(found) < len(truth):
        assert damage.chunks or damage.skipped_bytes or damage.orphans


def test_each_damaged_chunk_costs_itself_only(tmp_path: Path, whole: tuple[bytes, list[Line]]) -> None:
    """A flip in the data of each chunk in turn: that chunk is missing, all others are there, and reading says so."""
    data, truth = whole
    (tmp_path / "whole.mcap").write_bytes(data)
    with (tmp_path / "whole.mcap").open("rb") as file:
        summary = make_reader(file).get_summary()
    assert summary is not None
    assert len(summary.chunk_indexes) > 4
    for chunk in summary.chunk_indexes:
        changed = bytearray(data)
        changed[chunk.chunk_start_offset + chunk.chunk_length // 2] ^= 4
        outcome = saved(tmp_path, bytes(changed))
        assert outcome is not None
        found, damage = outcome
        assert damage.chunks == 1
        lost = [line for line in truth if line not in found]
        assert all(chunk.message_start_time <= line[2] <= chunk.message_end_time for line in lost)
        assert len(found) == len(truth) - len(lost) < len(truth)
        if chunk is not summary.chunk_indexes[0]:
            with Recording(tmp_path / "damaged.mcap") as recording, pytest.raises(RecordingError, match="1 chunks"):
                list(recording.samples())
            with Recording(tmp_path / "damaged.mcap", damaged="skip") as recording:
                assert len(list(recording.samples())) < len(SAMPLES)
                assert recording.damage.chunks == 1


@pytest.mark.parametrize("garbage", [b"\0" * 5000, b"\xff" * 700, bytes(range(256)) * 20, b"\x06" * 3000])
@pytest.mark.parametrize("kept", [1.0, 0.7, 0.4])
def test_garbage_at_the_end(tmp_path: Path, whole: tuple[bytes, list[Line]], garbage: bytes, kept: float) -> None:
    """After a power cut a file may end in blocks that were never written."""
    data, truth = whole
    outcome = saved(tmp_path, data[: int(len(data) * kept)] + garbage)
    assert outcome is not None
    found, damage = outcome
    clean = saved(tmp_path, data[: int(len(data) * kept)])
    assert clean is not None
    verified = len(found) - damage.unverified
    assert found[:verified] == truth[:verified]
    assert verified >= len(clean[0]) - clean[1].unverified
    assert damage.any


def test_without_its_first_bytes(tmp_path: Path, whole: tuple[bytes, list[Line]]) -> None:
    """Magic, header, and take are overwritten: the take is in the first chunk as well."""
    data, truth = whole
    outcome = saved(tmp_path, b"\0" * 40 + data[40:])
    assert outcome is not None
    assert outcome[0] == truth
    with Recording(tmp_path / "out.mcap") as recording:
        assert recording.take == TAKE


def test_sizes_in_heads_are_not_believed(tmp_path: Path) -> None:
    """Records that claim to be huge, and chunks that unpack to more than they say, take neither memory nor time."""
    data = made(tmp_path / "a.mcap")
    for opcode, length in itertools.product((1, 3, 4, 5, 6, 7, 9, 12), (1 << 40, (1 << 64) - 1, 0, 3)):
        outcome = saved(tmp_path, data[:300] + struct.pack("<BQ", opcode, length) + data[300:])
        assert outcome is not None
    bomb = struct.pack("<QQQII", 0, 1, 1 << 29, 7, 4) + b"zstd"
    body = zstandard.compress(bytes(1 << 20))
    record = bomb + struct.pack("<Q", len(body)) + body
    outcome = saved(tmp_path, data[:8] + struct.pack("<BQ", 6, len(record)) + record + data[8:])
    assert outcome is not None
    assert outcome[1].chunks == 1
    assert len(outcome[0]) == len(lines(tmp_path / "a.mcap"))


def test_files_of_other_writers(tmp_path: Path) -> None:
    """With and without chunks: recovery is of MCAP, not of ours alone."""
    for chunked in (True, False):
        path = tmp_path / f"{chunked}.mcap"
        with path.open("wb") as file:
            writer = Writer(file, chunk_size=500, use_chunking=chunked)
            writer.start()
            schema = writer.register_schema("a", "jsonschema", b"{}")
            channel = writer.register_channel("/a", "json", schema)
            for i in range(100):
                writer.add_message(channel, 10 + i, b"{}" * i, 10 + i, i)
            writer.add_attachment(1, 2, "x", "text/plain", b"attached")
            writer.finish()
        data, truth = path.read_bytes(), lines(path)
        for size in (len(data), len(data) * 2 // 3, len(data) // 3):
            outcome = saved(tmp_path, data[:size])
            assert outcome is not None
            assert outcome[0] == truth[: len(outcome[0])]
            assert len(outcome[0]) >= 0.8 * len(truth) * min(size / len(data), 0.9)
        with (tmp_path / "out.mcap").open("rb") as file:
            assert make_reader(file).get_summary() is not None


def test_what_recovery_refuses(tmp_path: Path) -> None:
    made(tmp_path / "a.mcap")
    (tmp_path / "text").write_text("nothing")
    with pytest.raises(RecordingError, match="exists"):
        recover(tmp_path / "a.mcap", tmp_path / "text")
    with pytest.raises(RecordingError, match="nothing in"):
        recover(tmp_path / "text", tmp_path / "b.mcap")
    with pytest.raises(RecordingError, match="does not exist"):
        recover(tmp_path / "missing", tmp_path / "b.mcap")


def test_recovered_files_keep_what_stands_beside_the_messages(tmp_path: Path) -> None:
    data = made(tmp_path / "a.mcap")
    assert saved(tmp_path, data[: len(data) // 2]) is not None
    with Recording(tmp_path / "out.mcap") as recording:
        assert recording.head.rig == RIG
    with (tmp_path / "out.mcap").open("rb") as file:
        names = [m.name for m in make_reader(file).iter_metadata()]
    assert names == ["cabinpose.take", "cabinpose.recovered"]


def test_definitions_are_repeated(tmp_path: Path) -> None:
    """Without the chunk in which a channel was first named, a truncated file is still read."""
    data = made(tmp_path / "a.mcap", definitions_s=0.0)
    truth = lines(tmp_path / "a.mcap")
    (summary,) = struct.unpack_from("<Q", data, len(data) - 28)
    changed = bytearray(data[:summary])
    first = data.index(b"suit/poses")
    changed[first] ^= 1
    outcome = saved(tmp_path, bytes(changed))
    assert outcome is not None
    assert outcome[1].chunks == 1
    assert outcome[1].orphans == 0
    assert len(truth) > len(outcome[0]) > len(truth) / 2

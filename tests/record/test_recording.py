"""What is written is what is read, bit by bit, and other people's readers open it."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import pytest
from hypothesis import given, settings
from mcap.reader import NonSeekingReader, make_reader
from mcap_protobuf.decoder import DecoderFactory
from recorded_things import MESSAGES, SAMPLES, bits, take_samples, tof_frame

from cabinpose.core.errors import RecordingError
from cabinpose.signals.recorded import Channels, Facts, Markers, Message, Sample, SegmentPoses
from cabinpose.store.recording import Chunking, Participant, Recording, RecordingWriter, SourceStatus, Take, recover, survey

TAKE = Take(action="reach", car="sedan", subjects=(Participant(code="S07", seat="driver", consent="C-12"),))
NOW = 1_700_000_000_000_000_000


def written(path: Path, samples: list[tuple[str, Sample]], **options: object) -> list[tuple[str, Sample]]:
    with RecordingWriter(path, TAKE, started_ns=NOW, chunking=Chunking(sync_s=0, **options)) as writer:
        for source, sample in samples:
            assert writer.write(source, sample) == []
    with Recording(path) as recording:
        found = list(recording.samples())
        assert not recording.damage.any
        return found


@pytest.mark.parametrize("name", MESSAGES)
def test_every_message_comes_back_bit_by_bit(name: str) -> None:
    @settings(max_examples=30)
    @given(MESSAGES[name])
    def there_and_back(message: Message) -> None:
        with TemporaryDirectory() as folder:
            ((source, sample),) = written(Path(folder) / "a.mcap", [("suit", Sample(1, NOW, 2, b"raw", (message,)))])
        assert source == "suit"
        assert bits(sample.messages) == bits((message,))

    there_and_back()


@settings(max_examples=30)
@given(SAMPLES, SAMPLES)
def test_every_sample_comes_back(first: Sample, second: Sample) -> None:
    """Numbers beyond 32 bits, times before the epoch, none at all; two sources between each other."""
    samples = [("a", first), ("b", second), ("a", second)]
    with TemporaryDirectory() as folder:
        found = written(Path(folder) / "a.mcap", samples)
    assert [(source, bits(sample)) for source, sample in found] == [(source, bits(sample)) for source, sample in samples]


@pytest.mark.parametrize("compression", ["none", "lz4", "zstd"])
def test_chunks_of_any_size_and_compression(tmp_path: Path, compression: str) -> None:
    samples = take_samples(60, rng=np.random.default_rng(1))
    for i, size in enumerate((1, 5000, 1 << 20)):
        found = written(tmp_path / f"{i}.mcap", samples, compression=compression, chunk_bytes=size)
        assert [bits(s) for _, s in found] == [bits(s) for _, s in samples]


@pytest.mark.parametrize("compression", ["none", "lz4", "zstd"])
def test_other_readers_open_it(tmp_path: Path, compression: str) -> None:
    """The mcap package's own two readers, with its checks on: all messages, their times, and Foxglove's classes."""
    path = tmp_path / "a.mcap"
    samples = take_samples(30, rng=np.random.default_rng(1))
    written(path, samples, compression=compression, chunk_bytes=3000)
    with path.open("rb") as file:
        reader = make_reader(file, validate_crcs=True, decoder_factories=[DecoderFactory()])
        by_topic: dict[str, list] = {}
        for schema, channel, message in reader.iter_messages():
            by_topic.setdefault(channel.topic, []).append((schema, message))
        assert {topic: len(found) for topic, found in by_topic.items()} == {
            "take": 1, "suit/raw": 10, "suit/poses": 10, "optical/raw": 10, "optical/markers": 10, "optical/markers_cloud": 10,
            "tof/raw": 10, "tof/calibration": 10, "tof/amplitude_calibration": 10, "tof/amplitude": 10, "tof/confidence": 10,
            "tof/depth": 10,
        }  # fmt: skip
        summary = reader.get_summary()
        assert summary is not None
        assert summary.statistics is not None
        assert summary.statistics.message_count == sum(map(len, by_topic.values()))
        assert summary.statistics.chunk_count == len(summary.chunk_indexes) > 3
        (metadata,) = reader.iter_metadata()
        assert metadata.metadata == {
            "format": "1", "started_ns": str(NOW), "subject": "S07", "seat": "driver", "consent": "C-12", "action": "reach",
            "car": "sedan",
        }  # fmt: skip
        depths = list(reader.iter_decoded_messages(topics=["tof/depth"]))
        truth = [s for source, s in samples if source == "tof"]
        for found, sample in zip(depths, truth, strict=True):
            image = found.decoded_message
            assert (image.encoding, image.frame_id, image.step) == ("16UC1", "tof", 2 * image.width)
            depth = sample.messages[0].depth
            assert np.array_equal(np.frombuffer(image.data, "<u2").reshape(image.height, image.width), depth)
            assert (found.message.log_time, found.message.publish_time) == (sample.host_ns, sample.device_ns)
            assert found.message.sequence == sample.sequence
            assert image.timestamp.ToNanoseconds() == sample.host_ns
        (first, *_) = reader.iter_decoded_messages(topics=["suit/poses"])
        pelvis = first.decoded_message.transforms[0]
        pose = samples[0][1].messages[0]
        assert (pelvis.parent_frame_id, pelvis.child_frame_id) == ("world", "suit/S07/Pelvis")
        assert (pelvis.rotation.w, pelvis.rotation.x) == tuple(pose.orientation_wxyz[0, :2])
        (cloud, *_) = reader.iter_decoded_messages(topics=["optical/markers_cloud"])
        assert cloud.decoded_message.pose.HasField("position")
        xyz = np.frombuffer(cloud.decoded_message.data, "<f8").reshape(-1, 3)
        assert np.array_equal(xyz, samples[1][1].messages[0].position_m, equal_nan=True)
    with path.open("rb") as file:
        straight = list(NonSeekingReader(file, validate_crcs=True).iter_messages(log_time_order=False))
    assert len(straight) == sum(map(len, by_topic.values()))


def test_rerun_takes_every_message(tmp_path: Path) -> None:
    pytest.importorskip("rerun", reason="rerun-sdk (0.5 GB) is not installed; `pip install rerun-sdk` to try recordings in it")
    written(tmp_path / "a.mcap", take_samples(30, rng=np.random.default_rng(1)))
    environment = {**os.environ, "HOME": str(tmp_path)}  # where Rerun keeps whether it may count its use

    def rerun(*arguments: str) -> subprocess.CompletedProcess[str]:
        command = [sys.executable, "-m", "rerun", *arguments]
        return subprocess.run(command, cwd=tmp_path, env=environment, capture_output=True, text=True, check=False, timeout=120)

    rerun("analytics", "disable")
    converted = rerun("mcap", "convert", "a.mcap", "-o", "a.rrd")
    assert converted.returncode == 0, converted.stderr
    assert "markers_cloud" in converted.stderr
    verified = rerun("rrd", "verify", "a.rrd")
    assert verified.returncode == 0, verified.stderr


def test_a_topic_keeps_to_one_clock(tmp_path: Path) -> None:
    """What has no time of its device has topics of its own, on the host's clock; our readers see no difference."""
    frame = Sample(1, NOW, 5_000_000, b"frame", (Facts("restart", {}), Channels(("n",), np.array([1.0]))))
    ping = Sample(None, NOW + 1, None, b"ping", (Facts("server", {}),))
    samples = [("optical", frame), ("optical", ping)]
    assert [bits(s) for _, s in written(tmp_path / "a.mcap", samples)] == [bits(s) for _, s in samples]
    times: dict[str, set[int]] = {}
    with (tmp_path / "a.mcap").open("rb") as file:
        for _, channel, message in make_reader(file).iter_messages():
            assert message.log_time in (NOW, NOW + 1)
            times.setdefault(channel.topic, set()).add(message.publish_time)
    del times["take"]
    assert times == {
        "optical/raw": {5_000_000}, "optical/facts": {5_000_000}, "optical/channels": {5_000_000},
        "optical/raw_host": {NOW + 1}, "optical/facts_host": {NOW + 1},
    }  # fmt: skip
    recover(tmp_path / "a.mcap", tmp_path / "b.mcap")
    with Recording(tmp_path / "b.mcap") as recording:
        assert [bits(s) for _, s in recording.samples()] == [bits(s) for _, s in samples]


def test_json_fits_its_schema(tmp_path: Path) -> None:
    """Keys of the messages are those that the schema in the file requires; what is unknown is null."""
    path = tmp_path / "a.mcap"
    marker = Markers("S07", ("A",), np.full((1, 3), np.nan), np.array([np.inf]))
    written(path, [("optical", Sample(1, NOW, None, b"", (marker,)))])
    with path.open("rb") as file:
        for schema, channel, message in make_reader(file).iter_messages(topics=["optical/markers", "take"]):
            assert schema is not None
            assert (schema.encoding, channel.message_encoding) == ("jsonschema", "json")
            described, value = json.loads(schema.data), json.loads(message.data)
            assert described["type"] == "object"
            assert described["required"] == list(value)
            assert set(described["properties"]) - set(value) == ({"drive_side"} if channel.topic == "take" else set())
            if channel.topic == "optical/markers":
                assert value["position_m"] == [[None, None, None]]
                assert value["residual_m"] == ["Infinity"]


def test_a_take_that_knows_the_side_of_its_wheel_says_it_in_both_places(tmp_path: Path) -> None:
    path, take = tmp_path / "a.mcap", Take(car="suv", drive_side="right")
    RecordingWriter(path, take).close()
    assert survey(path).take == take
    with path.open("rb") as file:
        ((_, _, message),) = make_reader(file).iter_messages(topics=["take"])
    assert json.loads(message.data)["drive_side"] == "right"


def test_the_raw_bytes_come_first(tmp_path: Path) -> None:
    written(tmp_path / "a.mcap", take_samples(3, rng=np.random.default_rng(1)))
    with (tmp_path / "a.mcap").open("rb") as file:
        topics = [c.topic for s, c, m in make_reader(file).iter_messages(log_time_order=False)]
    for source in ("suit", "optical", "tof"):
        assert next(t for t in topics if t.startswith(source)) == f"{source}/raw"


@pytest.mark.parametrize(
    ("message", "reason"),
    [
        (SegmentPoses("S07", ("A", "B"), np.zeros((1, 3)), np.zeros((2, 4))), "position_m has shape"),
        (Channels(("A",), np.zeros(2)), "values has shape"),
        (Facts("x", {"nan": float("nan")}), "not JSON compliant"),
        (Facts("x", {"a": object()}), "not JSON serializable"),
        (SegmentPoses("\udcff", (), np.zeros((0, 3)), np.zeros((0, 4))), "surrogates not allowed"),
        (Markers("S07", (3,), np.zeros((1, 3)), np.zeros(1)), "is no text"),  # type: ignore[arg-type]
    ],
)
def test_what_cannot_be_written_is_said_and_the_raw_bytes_are_kept(tmp_path: Path, message: Message, reason: str) -> None:
    with RecordingWriter(tmp_path / "a.mcap", TAKE) as writer:
        (refused,) = writer.write("suit", Sample(1, NOW, None, b"bytes", (message, Facts("fine"))))
    assert reason in refused
    with Recording(tmp_path / "a.mcap") as recording:
        ((_, sample),) = recording.samples()
    assert sample.raw == b"bytes"
    assert sample.messages == (Facts("fine"),)


def test_a_device_that_renames_itself_all_the_time_fills_no_memory(tmp_path: Path) -> None:
    nobody = np.zeros((0, 3)), np.zeros((0, 4))
    with RecordingWriter(tmp_path / "a.mcap", TAKE, chunking=Chunking(sync_s=0)) as writer:
        refused = sum(
            len(writer.write("suit", Sample(i, NOW + i, None, b"x", (SegmentPoses(f"S{i}", (), *nobody),)))) for i in range(4200)
        )
    with Recording(tmp_path / "a.mcap") as recording:
        samples = list(recording.samples())
    assert len(samples) == 4200
    assert sum(len(sample.messages) for _, sample in samples) == 4200 - refused
    assert 100 < refused < 120


def test_a_frame_of_the_wrong_kind_is_refused(tmp_path: Path) -> None:
    frame = tof_frame(rng=np.random.default_rng(0))
    with RecordingWriter(tmp_path / "a.mcap", TAKE) as writer:
        wrong = [
            type(frame)(**{**vars(frame), "depth": frame.depth.astype(np.float32)}),
            type(frame)(**{**vars(frame), "confidence": frame.confidence[:4]}),
            type(frame)(**{**vars(frame), "camera_dist": np.zeros(4)}),
        ]
        for message in wrong:
            assert len(writer.write("tof", Sample(1, NOW, None, b"", (message,)))) == 1


def test_views_and_other_byte_orders_are_written_as_their_values(tmp_path: Path) -> None:
    frame = tof_frame(rng=np.random.default_rng(0))
    turned = type(frame)(**{**vars(frame), "depth": frame.depth[:, ::-1], "amplitude": frame.amplitude.astype(">u2")})
    ((_, sample),) = written(tmp_path / "a.mcap", [("tof", Sample(1, NOW, None, b"", (turned,)))])
    assert np.array_equal(sample.messages[0].depth, frame.depth[:, ::-1])
    assert np.array_equal(sample.messages[0].amplitude, frame.amplitude)


def test_only_what_is_asked_for(tmp_path: Path) -> None:
    samples = take_samples(30, rng=np.random.default_rng(1))
    written(tmp_path / "a.mcap", samples, chunk_bytes=2000)
    with Recording(tmp_path / "a.mcap") as recording:
        assert recording.sources == ("optical", "suit", "tof")
        suit = list(recording.samples(["suit"], start_ns=samples[3][1].host_ns, end_ns=samples[9][1].host_ns))
    assert [bits(s) for _, s in suit] == [bits(s) for source, s in samples[3:9] if source == "suit"]


def test_take_rig_and_counts_are_kept(tmp_path: Path) -> None:
    status = SourceStatus("suit", "mvn", "stopped", received=5, lost=1, final=True)
    with RecordingWriter(tmp_path / "a.mcap", TAKE, rig="sources: {}\n", started_ns=NOW) as writer:
        writer.write_status(status, NOW + 5)
    with Recording(tmp_path / "a.mcap") as recording:
        assert recording.take == TAKE
        assert recording.head.rig == "sources: {}\n"
        assert recording.head.started_ns == NOW
        assert recording.statuses() == {"suit": [(NOW + 5, status)]}
        assert list(recording.samples()) == []


def test_nothing_is_overwritten(tmp_path: Path) -> None:
    RecordingWriter(tmp_path / "a.mcap").close()
    before = (tmp_path / "a.mcap").read_bytes()
    with pytest.raises(RecordingError, match="exists"):
        RecordingWriter(tmp_path / "a.mcap")
    assert (tmp_path / "a.mcap").read_bytes() == before


def test_other_files_are_refused(tmp_path: Path) -> None:
    (tmp_path / "a.mcap").write_bytes(b"no recording at all")
    for path in (tmp_path / "a.mcap", tmp_path / "missing.mcap"):
        with pytest.raises(RecordingError):
            Recording(path)


@pytest.mark.parametrize("code", ["Anna", "Müller1", "anna 7", "", "S07\n", "x" * 33 + "1"])
def test_a_name_is_no_code(code: str) -> None:
    with pytest.raises(ValueError, match="a code has a digit"):
        Participant(code=code)


def test_a_take_survives_as_text() -> None:
    take = Take(
        action="drive, not".replace(",", ""), car="suv/2", drive_side="right",
        subjects=(Participant(code="S1", seat="driver"), Participant(code="S2", consent="C 3")),
    )  # fmt: skip
    assert Take.from_metadata(take.as_metadata()) == take
    older = take.model_copy(update={"drive_side": None})
    assert Take.from_metadata(older.as_metadata()) == older
    assert "drive_side" not in older.as_metadata()
    with pytest.raises(ValueError, match="twice"):
        Take(subjects=(Participant(code="S1"), Participant(code="S1")))


def test_keywords_of_the_last_release(tmp_path: Path) -> None:
    with pytest.warns(DeprecationWarning, match=r"RecordingWriter\(sync_s\) is RecordingWriter\(chunking=Chunking"):
        RecordingWriter(tmp_path / "a.mcap", sync_s=0).close()
    with pytest.raises(TypeError, match="speed"):
        RecordingWriter(tmp_path / "b.mcap", speed=2)

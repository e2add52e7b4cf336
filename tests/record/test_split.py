"""A take in several files: nothing is lost at the seams, each file is complete, and all of them are read as one take."""

from __future__ import annotations

import json
import threading
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from mcap.reader import make_reader
from recorded_things import bits, take_samples
from test_crash import killed

import cabinpose
from cabinpose.core.errors import RecordingError, SourceEndedError
from cabinpose.record.config import parse_rig
from cabinpose.record.lane import Lane
from cabinpose.record.recorder import Recorder
from cabinpose.record.session import begin
from cabinpose.record.sources.replay import ReplaySettings, ReplaySource
from cabinpose.record.split import Limit, SplitWriter
from cabinpose.signals.clock import HostClock
from cabinpose.signals.recorded import Counts, Sample
from cabinpose.store.recording import (
    Chunking,
    Participant,
    Recording,
    RecordingWriter,
    SourceStatus,
    Take,
    files_of_take,
    recover,
    segment_series,
    survey,
)

Run = Callable[..., Any]
TAKE = Take(action="reach", subjects=(Participant(code="S07"),))
SAMPLES = take_samples(90, rng=np.random.default_rng(5))
EVERY = 20  # samples of a file


def write_split(folder: Path, name: str = "take.mcap", started_ns: int = 1) -> list[Path]:
    """The samples in files of twenty, and the names of these."""

    def make(path: Path, part: int | None) -> RecordingWriter:
        return RecordingWriter(path, TAKE, rig="rig: 1", started_ns=started_ns, chunking=Chunking(sync_s=0), part=part)

    writer = SplitWriter(folder / name, make, HostClock(), Limit(bytes=1e12))
    for i, (source, sample) in enumerate(SAMPLES):
        if i and i % EVERY == 0:
            writer.go_on()
        writer.write(source, sample)
    writer.close()
    assert writer.samples("suit") == 30
    assert writer.bytes_written == sum(file.stat().st_size for file in writer.files)
    return list(writer.files)


def samples_in(path: Path, **options: Any) -> list[Any]:
    with Recording(path, **options) as recording:
        found = [(source, bits(sample)) for source, sample in recording.samples()]
        assert not recording.damage.any
    return found


GIVEN = [(source, bits(sample)) for source, sample in SAMPLES]


def test_each_file_is_complete_in_itself(tmp_path: Path) -> None:
    files = write_split(tmp_path)
    assert [file.name for file in files] == ["take.mcap", *(f"take-{part:03d}.mcap" for part in range(1, 5))]
    for part, file in enumerate(files):
        with file.open("rb") as stream:
            reader = make_reader(stream, validate_crcs=True)
            summary = reader.get_summary()
            assert summary is not None
            channels = {channel.topic for channel in summary.channels.values()}
            assert {"suit/poses", "optical/markers", "tof/depth", "take"} <= channels
            assert {schema.name for schema in summary.schemas.values()} >= {"foxglove.FrameTransforms", "cabinpose.Markers"}
            assert [attachment.data for attachment in reader.iter_attachments()] == [b"rig: 1"]
            (metadata,) = [found.metadata for found in reader.iter_metadata() if found.name == "cabinpose.take"]
        assert metadata["part"] == str(part)
        if part:
            assert files_of_take(file) == [file]
            assert samples_in(file) == GIVEN[part * EVERY : (part + 1) * EVERY]
            with Recording(file) as recording:
                assert (recording.take, recording.head.rig, recording.head.started_ns) == (TAKE, "rig: 1", 1)


def test_all_of_them_are_one_take(tmp_path: Path) -> None:
    """As a recording of the same samples in one file is read: samples, spans, series, the survey, and played."""
    files = write_split(tmp_path)
    whole = tmp_path / "whole"
    whole.mkdir()
    with RecordingWriter(whole / "one.mcap", TAKE, started_ns=1, chunking=Chunking(sync_s=0)) as writer:
        for source, sample in SAMPLES:
            writer.write(source, sample)
    assert samples_in(files[0]) == samples_in(tmp_path) == samples_in(whole) == GIVEN
    with Recording(files[0]) as split, Recording(whole / "one.mcap") as one:
        assert split.files == files
        span = {"start_ns": SAMPLES[15][1].host_ns, "end_ns": SAMPLES[65][1].host_ns}
        assert [bits(s) for _, s in split.samples(["tof"], **span)] == [bits(s) for _, s in one.samples(["tof"], **span)]
        assert (split.sources, split.topics) == (one.sources, one.topics)
        assert bits(segment_series(split, "suit").position_m) == bits(segment_series(one, "suit").position_m)
    with cabinpose.open(tmp_path) as opened:
        assert len(list(opened.samples())) == len(SAMPLES)
    of_split, of_one = survey(tmp_path), survey(whole)
    assert of_split.bytes == sum(file.stat().st_size for file in files)
    assert of_split.seconds == of_one.seconds
    for ours, theirs in zip(of_split.sources, of_one.sources, strict=True):
        assert (ours.name, ours.samples, ours.missing, ours.rate_hz) == (
            theirs.name,
            theirs.samples,
            theirs.missing,
            theirs.rate_hz,
        )
    source = ReplaySource("suit", ReplaySettings(path=files[0], source="suit", speed=0, host_time=True), HostClock())
    source.open()
    played: list[Sample] = []
    while len(played) < 30:
        played += source.read(0.0)
    with pytest.raises(SourceEndedError):
        source.read(0.0)
    assert [("suit", bits(sample)) for sample in played] == [row for row in GIVEN if row[0] == "suit"]


def test_a_missing_file_is_said(tmp_path: Path, run: Run) -> None:
    files = write_split(tmp_path)
    files[2].unlink()
    with pytest.raises(RecordingError, match=r"take-002\.mcap is missing") as raised:
        Recording(files[0])
    assert raised.value.hint
    with pytest.warns(UserWarning, match=r"take-002\.mcap is missing"):
        found = samples_in(files[0], damaged="skip")
    assert found == GIVEN[: 2 * EVERY] + GIVEN[3 * EVERY :]
    told = run("info", files[0])
    assert told.code == 0
    assert "take-002.mcap is missing" in told.err
    assert run("export", "csv", files[0], "--out", tmp_path / "csv").code == 2


@pytest.mark.parametrize("content", [b"", b"no recording"])
def test_a_file_that_was_cut_at_its_start_keeps_none_of_the_others(content: bytes, tmp_path: Path) -> None:
    """As a machine leaves it that loses its power while the next file is begun."""
    files = write_split(tmp_path)
    files[-1].write_bytes(content)
    for path in (files[0], tmp_path):
        with pytest.warns(UserWarning, match=rf"{files[-1].name} is no recording of cabinpose; it is left out") as told:
            assert files_of_take(path) == files[:-1]
        assert len(told) == 1
    (tmp_path / "else.mcap").write_bytes(content)
    with pytest.warns(UserWarning, match=r"else\.mcap is no recording"):
        assert files_of_take(tmp_path) == files[:-1]
    files[1].write_bytes(content)
    unread = r"take-001\.mcap cannot be read \(.*is no recording"
    with pytest.warns(UserWarning, match="it is left out"), pytest.raises(RecordingError, match=unread) as raised:
        files_of_take(files[0])
    assert "a copy that can be read" in str(raised.value.hint)
    with pytest.warns(UserWarning, match="it is left out"), pytest.warns(UserWarning, match=unread):
        assert files_of_take(files[0], damaged="skip") == [files[0], *files[2:-1]]


def test_files_that_only_look_like_parts_are_not_taken(tmp_path: Path) -> None:
    """One of another take that got the name of a part, and one whose number is not that of its name."""
    files, others = write_split(tmp_path), write_split(tmp_path, "other.mcap", started_ns=2)
    others[4].replace(files[4])
    files[3].rename(tmp_path / "take-012.mcap")
    assert files_of_take(files[0]) == files[:3]
    with pytest.raises(RecordingError, match="2 takes, not one"):
        Recording(tmp_path)
    empty = tmp_path / "empty"
    empty.mkdir()
    with pytest.raises(RecordingError, match="no first file"):
        Recording(empty)
    (empty / "take.mcap").write_bytes(b"x")
    with pytest.raises(RecordingError, match=r"take.mcap is no recording"):
        Recording(empty)


class Counting:
    """A source that gives so many samples, seven at once."""

    def __init__(self, name: str, count: int) -> None:
        self.name, self.counts, self._left = name, Counts(), list(range(count))

    def check(self) -> list[str]:
        return []

    def open(self) -> None:
        pass

    def read(self, timeout_s: float) -> list[Sample]:
        if not self._left:
            raise SourceEndedError("over")
        some, self._left = self._left[:7], self._left[7:]
        self.counts.received += len(some)
        return [Sample(n, HostClock().now_ns(), n, n.to_bytes(8, "little") * 20) for n in some]

    def close(self) -> None:
        pass


def test_the_recorder_loses_nothing_at_the_seams(tmp_path: Path) -> None:
    """Two sources at once, files of some 30 kB; the last counts are those of all files, and the first of a file stand in it."""
    clock, wake = HostClock(), threading.Event()
    lanes = [Lane(Counting(name, 2000), "counting", clock, wake) for name in ("suit", "tof")]

    def make(path: Path, part: int | None) -> RecordingWriter:
        return RecordingWriter(path, part=part, chunking=Chunking(sync_s=0, chunk_bytes=4000))

    writer = SplitWriter(tmp_path / "a.mcap", make, clock, Limit(bytes=30_000))
    recorder = Recorder(lanes, writer, clock, wake)
    recorder.start()
    for lane in lanes:
        lane.join(60)
    outcome = recorder.stop()
    assert outcome.error is None
    assert len(outcome.files) > 5
    assert not [thread for thread in threading.enumerate() if thread.name.startswith("recording-")]
    numbers: dict[str, list[int | None]] = {"suit": [], "tof": []}
    with Recording(tmp_path / "a.mcap") as recording:
        for source, sample in recording.samples():
            numbers[source].append(sample.sequence)
        statuses = recording.statuses()
    assert numbers == {"suit": list(range(2000)), "tof": list(range(2000))}
    for status in outcome.sources:
        assert (status.written, status.dropped) == (2000, 0)
        assert statuses[status.source][-1][1] == status
        assert [found.final for _, found in statuses[status.source]].count(True) == 1
    for file in outcome.files[1:]:
        with Recording(file) as part:
            counts, came = part.statuses(), [sample.host_ns for _, sample in part.samples()]
        for told in (counts["suit"], counts["tof"]):
            assert len(told) > 1, "at its beginning and at its end"
        assert came


def test_a_kill_in_the_second_file_costs_what_it_costs_in_one(tmp_path: Path) -> None:
    out = tmp_path / "take.mcap"
    sent = killed(out, 1.6, {"split_every": "1s"})
    files = files_of_take(out)
    assert [file.name for file in files] == ["take.mcap", "take-001.mcap"]
    with Recording(out) as recording:
        found = [(source, sample.sequence) for source, sample in recording.samples()]
        assert not recording.damage.whole
    with Recording(files[1]) as second:
        assert next(second.samples())[1].sequence is not None
    for source, told in sent.items():
        numbers = [number for name, number in found if name == source]
        assert numbers == list(range(len(numbers))), "without a gap, over the seam too"
        lost = [host_ns for host_ns, number in told if number >= len(numbers)]
        assert not lost or max(lost) - min(lost) < 1e9
    recover(files[1], tmp_path / "whole.mcap")
    (tmp_path / "whole.mcap").replace(files[1])
    with Recording(out) as recording:
        assert [(source, sample.sequence) for source, sample in recording.samples()] == found
        assert recording.damage.whole


class Hours(HostClock):
    """A clock that a test sets."""

    seconds = 0.0

    def now_ns(self) -> int:
        return round(self.seconds * 1e9)


def test_a_file_ends_when_it_is_so_old(tmp_path: Path) -> None:
    clock = Hours()
    writer = SplitWriter(
        tmp_path / "a.mcap",
        lambda path, part: RecordingWriter(path, chunking=Chunking(sync_s=0), part=part),
        clock,
        Limit.of("10min"),
    )
    clock.seconds = 599
    assert not writer.full
    clock.seconds = 600
    assert writer.full
    writer.go_on()
    assert not writer.full
    clock.seconds = 1199
    assert not writer.full
    writer.write_status(SourceStatus("suit", "scripted", "recording"), 1)
    writer.close()
    writer.close()
    assert [file.name for file in writer.files] == ["a.mcap", "a-001.mcap"]
    alone = SplitWriter(
        tmp_path / "b.mcap", lambda path, part: RecordingWriter(path, chunking=Chunking(sync_s=0), part=part), clock
    )
    clock.seconds = 1e9
    assert not alone.full
    alone.close()
    with Recording(tmp_path / "b.mcap") as recording:
        assert recording.head.part is None


def test_what_a_limit_may_be() -> None:
    assert Limit.of("10min") == Limit(600.0, 0.0)
    assert Limit.of("1.5h") == Limit(5400.0, 0.0)
    assert Limit.of("2GB") == Limit(0.0, 2e9)
    assert Limit.of("500 MB") == Limit(0.0, 5e8)
    for text in ("10", "10m", "GB", "-1GB", "10min 2GB", "0.5s", "1e3s", "0MB"):
        with pytest.raises(ValueError, match=r"10min|at least"):
            Limit.of(text)


def test_the_command(tmp_path: Path, run: Run) -> None:
    rig = tmp_path / "rig.yaml"
    sources = {"tof": {"kind": "numbered", "rate_hz": 100, "samples": 250, "width": 100, "height": 100}}
    rig.write_text(yaml.safe_dump({"sources": sources, "storage": {"split_every": "1h"}}))
    out = tmp_path / "takes" / "a.mcap"
    out.parent.mkdir()
    done = run("record", "--config", rig, "--out", out, "--split-every", "3MB", "--json")
    assert done.code == 0, done.err
    told = json.loads(done.out)
    assert told["files"] == [str(file) for file in files_of_take(out)]
    assert len(told["files"]) > 1
    found = json.loads(run("info", out.parent, "--json").out)
    assert found["sources"]["tof"]["samples"] == told["sources"]["tof"]["written"] == 250
    assert found["sources"]["tof"]["missing"] == 0
    assert found["bytes"] == told["bytes"]
    out.unlink()
    rest = sorted(out.parent.iterdir())
    check = run("record", "--config", rig, "--out", out, "--check")
    assert f"{rest[0]} exists" in check.out
    again = run("record", "--config", rig, "--out", out)
    assert again.code == 2
    assert "exists" in again.err
    assert sorted(out.parent.iterdir()) == rest, "nothing was written beside them"
    bad = run("record", "--config", rig, "--out", tmp_path / "b.mcap", "--split-every", "10 m")
    assert "--split-every 10 m is no limit of a file" in bad.err
    assert "such as 10min or 2GB" in bad.err


def test_the_rig_says_it(tmp_path: Path) -> None:
    with pytest.raises(Exception, match=r"storage\.split_every: a number with s, min, h, MB or GB"):
        parse_rig({"sources": {"a": {"kind": "numbered"}}, "storage": {"split_every": "often"}})
    rig = parse_rig({"sources": {"a": {"kind": "numbered", "samples": 10}}, "storage": {"split_every": "2GB"}})
    recorder = begin(rig, tmp_path / "a.mcap", HostClock())
    while recorder.running:
        HostClock().sleep(0.01)
    assert recorder.stop().files == (tmp_path / "a.mcap",)


def test_a_source_that_was_never_started_has_ended() -> None:
    """As after Ctrl-C between the starts of two sources."""
    lane = Lane(Counting("a", 1), "counting", HostClock(), threading.Event())
    lane.stop()
    assert lane.join(0.01)

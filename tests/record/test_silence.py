"""A device that falls silent, or never speaks: the file, `info`, the closing lines and the exit code say so."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from cabinpose.record.config import parse_rig
from cabinpose.signals.recorded import Channels, Facts, Sample
from cabinpose.store.recording import Chunking, RecordingWriter, SourceStatus, survey
from cabinpose.store.recording.messages import decode_status

Run = Callable[..., Any]
START_NS = 1_700_000_000_000_000_000
HANGS = {"kind": "numbered", "rate_hz": 100, "silent_from": 50}
MUTE = {"kind": "numbered", "silent_from": 0}
LIVELY = {"kind": "numbered", "rate_hz": 100}


def rig_of(folder: Path, **sources: dict[str, Any]) -> Path:
    path = folder / "rig.yaml"
    path.write_text(yaml.safe_dump({"take": {"subjects": [{"code": "S07", "consent": "C-1"}]}, "sources": sources}))
    return path


@pytest.mark.usefixtures("quick")
def test_a_source_that_hangs_is_told_and_ends_the_take_with_1(tmp_path: Path, run: Run) -> None:
    out = tmp_path / "a.mcap"
    done = run("record", "--config", rig_of(tmp_path, tof=HANGS, suit=LIVELY), "--out", out, "--duration", "4")
    assert done.code == 1
    assert "error: silent at the end of the take: tof" in done.err
    assert "hint:" in done.err
    (line,) = [line for line in done.out.splitlines() if line.startswith("tof")]
    assert line.startswith("tof   50 samples, from 0.")
    assert "; no data for " in line
    assert "no data" not in next(line for line in done.out.splitlines() if line.startswith("suit"))
    found = {source.name: source for source in survey(out).sources}
    tof = found["tof"]
    assert tof.status is not None
    assert tof.status.silent
    assert (tof.status.first_ns, tof.status.last_ns) == (tof.first_ns, tof.last_ns)
    assert "no data for" in tof.status.error
    began, ended = tof.gaps[-1]
    assert ended - began > 2
    assert ended == pytest.approx(survey(out).seconds, abs=0.01)
    assert not found["suit"].status.silent  # type: ignore[union-attr]
    info = run("info", out).out
    assert "no data for" in info
    assert json.loads(run("info", out, "--json").out)["sources"]["tof"]["gaps_s"][-1] == [began, ended]


@pytest.mark.usefixtures("quick")
def test_a_source_that_never_sends(tmp_path: Path, run: Run) -> None:
    out = tmp_path / "a.mcap"
    done = run("record", "--config", rig_of(tmp_path, tof=MUTE, suit=LIVELY), "--out", out, "--duration", "3")
    assert done.code == 1
    assert "warning: tof has sent no data since the take began" in done.err
    assert "tof   0 samples; no data came" in done.out
    found = survey(out)
    silent = next(source for source in found.sources if source.name == "tof")
    assert (silent.samples, silent.first_ns) == (0, None)
    assert silent.gaps.tolist() == [[0.0, found.seconds]]


@pytest.mark.usefixtures("quick")
def test_a_source_that_the_take_does_not_need(tmp_path: Path, run: Run) -> None:
    rig = rig_of(tmp_path, events={**MUTE, "required": False}, suit=LIVELY)
    done = run("record", "--config", rig, "--out", tmp_path / "a.mcap", "--duration", "0.5", "--json")
    assert done.code == 0
    assert json.loads(done.out)["sources"]["events"]["error"] == "no data came"
    assert parse_rig({"sources": {"a": {"kind": "numbered"}}}).sources[0].required
    bad = rig_of(tmp_path, a={"kind": "numbered", "required": "maybe"})
    done = run("record", "--config", bad, "--out", tmp_path / "b.mcap")
    assert done.code == 2
    assert "sources.a.required: 'maybe' is neither true nor false" in done.err


@pytest.mark.usefixtures("quick")
def test_a_source_that_is_away_at_the_end(tmp_path: Path, run: Run) -> None:
    rig = rig_of(tmp_path, suit={"kind": "numbered", "rate_hz": 100, "die_every": 20, "dead_s": 100})
    done = run("record", "--config", rig, "--out", tmp_path / "a.mcap", "--duration", "0.8")
    assert done.code == 1
    assert "; suit does not answer; no data for " in done.out or "; suit went away; no data for " in done.out


@pytest.mark.slow
@pytest.mark.usefixtures("quick")
def test_the_check_listens(tmp_path: Path, run: Run) -> None:
    done = run("record", "--config", rig_of(tmp_path, tof=MUTE, suit=LIVELY), "--check", "--json")
    assert done.code == 2
    findings = json.loads(done.out)["findings"]
    assert "sends no data" in findings["tof"][0]
    assert findings["suit"] == []
    done = run("record", "--config", rig_of(tmp_path, tof={**MUTE, "required": False}, suit=LIVELY), "--check", "--json")
    assert done.code == 0
    assert "sends no data" in json.loads(done.out)["findings"]["tof"][0]


def test_gaps_reach_from_the_start_of_the_take_to_its_end(tmp_path: Path) -> None:
    """Three sources of a take of 10 s: late, dead but for its pings, ended by itself."""

    def at(seconds: float) -> int:
        return START_NS + round(seconds * 1e9)

    def sample(number: int | None, seconds: float) -> Sample:
        message = Facts("server", {}) if number is None else Channels(("n",), np.array([1.0]))
        return Sample(number, at(seconds), None, b"", (message,))

    with RecordingWriter(tmp_path / "a.mcap", started_ns=at(-3), chunking=Chunking(sync_s=0)) as writer:
        for name in ("late", "dead", "over"):
            writer.write_status(SourceStatus(name, "scripted", "recording"), at(0))
        for i in range(100):
            if i >= 40:
                writer.write("late", sample(i, i / 10))
            writer.write("dead", sample(i if i < 16 else None, i / 10))
            if i < 50:
                writer.write("over", sample(i, i / 10))
        for name, state in (("late", "stopped"), ("dead", "stopped"), ("over", "ended")):
            writer.write_status(SourceStatus(name, "scripted", state, final=True), at(10))
    found = survey(tmp_path / "a.mcap")
    assert (found.started_ns, found.seconds) == (START_NS, 10.0)
    gaps = {source.name: source.gaps.round(6).tolist() for source in found.sources}
    assert gaps == {"late": [[0.0, 4.0]], "dead": [[1.5, 10.0]], "over": []}


def test_counts_of_an_earlier_version_are_read() -> None:
    values = asdict(SourceStatus("suit", "mvn", "stopped", received=5))
    for name in ("first_ns", "last_ns", "silent"):
        del values[name]
    assert decode_status(memoryview(json.dumps(values).encode())) == SourceStatus("suit", "mvn", "stopped", received=5)

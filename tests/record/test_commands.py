"""The commands of recording, from the rig to erasure."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from html.parser import HTMLParser
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import cv2
import numpy as np
import pytest
import yaml
from recorded_things import take_samples
from rich.console import Console

from benchmarks.record import run as bench_record
from cabinpose.app.cli.panel import drawn, line
from cabinpose.core.errors import ConfigError
from cabinpose.record.lane import LaneStatus
from cabinpose.record.recorder import RecorderStatus
from cabinpose.store.recording import Chunking, Participant, Recording, RecordingWriter, SourceStatus, Take, survey

RIG: dict[str, Any] = {
    "take": {"action": "reach", "subjects": [{"code": "S07", "seat": "driver", "consent": "C-1"}]},
    "sources": {
        "suit": {"kind": "numbered", "rate_hz": 400, "samples": 200},
        "tof": {"kind": "numbered", "rate_hz": 50, "samples": 25, "width": 32, "height": 24, "lose_every": 10},
    },
}
Run = Callable[..., Any]


@pytest.fixture
def rig(tmp_path: Path) -> Path:
    path = tmp_path / "rig.yaml"
    path.write_text(yaml.safe_dump(RIG))
    return path


def take_of(path: Path, *codes: str, cut: float = 1.0) -> Path:
    path.parent.mkdir(exist_ok=True, parents=True)
    with RecordingWriter(
        path, Take(subjects=tuple(Participant(code=code) for code in codes)), chunking=Chunking(sync_s=0)
    ) as writer:
        for source, sample in take_samples(12, rng=np.random.default_rng(3)):
            writer.write(source, sample)
    os.truncate(path, int(path.stat().st_size * cut))
    return path


def test_a_take_from_its_rig(tmp_path: Path, rig: Path, run: Run) -> None:
    out = tmp_path / "a.mcap"
    done = run("record", "--config", rig, "--out", out, "--json")
    assert done.code == 0, done.err
    told = json.loads(done.out)
    assert told["sources"]["suit"]["written"] == 200
    assert (told["sources"]["tof"]["written"], told["sources"]["tof"]["lost"]) == (23, 2)
    with Recording(out) as recording:
        assert recording.take.codes == ("S07",)
        assert yaml.safe_load(recording.head.rig) == RIG
    info = json.loads(run("info", out, "--json").out)
    assert info["sources"]["tof"]["missing"] == 2
    assert info["sources"]["suit"]["samples"] == 200
    assert {t["topic"] for t in info["topics"]} >= {"suit/raw", "suit/channels", "tof/depth", "tof/status"}
    words = run("info", out).out
    assert "S07 (driver), consent C-1" in words
    assert "whole" in words
    again = run("record", "--config", rig, "--out", out)
    assert again.code == 2
    assert "exists" in again.err


def test_the_duration_and_a_take_of_its_own(tmp_path: Path, rig: Path, run: Run) -> None:
    rig.write_text(yaml.safe_dump({"sources": {"suit": {"kind": "numbered"}}}))
    (tmp_path / "take.yaml").write_text("action: drive\nsubjects: [{code: S99}]\n")
    done = run("record", "--config", rig, "--out", tmp_path / "a.mcap", "--take", tmp_path / "take.yaml", "--duration", "0.5")
    assert done.code == 0, done.err
    with Recording(tmp_path / "a.mcap") as recording:
        assert recording.take == Take(action="drive", subjects=(Participant(code="S99"),))
    assert 0.3 < survey(tmp_path / "a.mcap").seconds < 30


@pytest.mark.parametrize("kind", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_asked_to_stop_it_ends_the_file(tmp_path: Path, rig: Path, kind: signal.Signals) -> None:
    if signal.getsignal(kind) == signal.SIG_IGN:
        pytest.skip(f"{kind.name} is ignored here (nohup), and so by what is begun from here")
    rig.write_text(yaml.safe_dump({"sources": {"suit": {"kind": "numbered"}}}))
    out = tmp_path / "a.mcap"
    command = [sys.executable, "-m", "cabinpose", "record", "--config", rig, "--out", out]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        limit = time.monotonic() + 60
        while not (out.exists() and out.stat().st_size > 3000) and time.monotonic() < limit:
            time.sleep(0.05)
        process.send_signal(kind)
        said, _ = process.communicate(timeout=60)
    assert process.returncode == 0
    assert "samples" in said
    found = survey(out)
    assert not found.damage.any
    assert found.sources[0].status is not None
    assert found.sources[0].status.final
    assert found.sources[0].status.written == found.sources[0].samples > 0


def test_the_check_says_what_is_missing(tmp_path: Path, rig: Path, run: Run) -> None:
    assert run("record", "--config", rig, "--check", "--out", tmp_path / "a.mcap").code == 0
    rig.write_text(yaml.safe_dump({"sources": {"suit": {"kind": "numbered"}, "old": {"kind": "replay", "path": "gone.mcap"}}}))
    done = run("record", "--config", rig, "--check", "--out", tmp_path / "nowhere" / "a.mcap", "--json")
    assert done.code == 2
    findings = json.loads(done.out)["findings"]
    assert findings["suit"] == []
    assert "gone.mcap" in findings["old"][0]
    assert "no folder" in findings["disk"][0]
    assert "no subject" in findings["take"][0]
    assert list(tmp_path.glob("*.mcap")) == []


def test_what_record_refuses(tmp_path: Path, rig: Path, run: Run) -> None:
    assert "--out" in run("record", "--config", rig).err
    assert "more than 0" in run("record", "--config", rig, "--out", tmp_path / "a.mcap", "--duration", "-1").err
    assert "more than 0" in run("record", "--config", rig, "--out", tmp_path / "a.mcap", "--duration", "nan").err
    assert "no name of a recording" in run("record", "--config", rig, "--out", tmp_path / "a", "--duration", "1").err
    assert "no name of a recording" in run("record", "--config", rig, "--out", tmp_path / "a", "--check").err
    assert "there is no folder" in run("record", "--config", rig, "--out", tmp_path / "none" / "a.mcap").err
    assert "no name of a recording" in run("recover", tmp_path / "a.mcap", "--out", tmp_path / "fixed").err
    assert [path.name for path in tmp_path.iterdir()] == [rig.name]


def test_info_tells_of_all_damage(tmp_path: Path, run: Run) -> None:
    """Damage to the index, which nothing else is read from, as well."""
    path = take_of(tmp_path / "take.mcap", "S07")
    sound = path.read_bytes()
    start = int.from_bytes(sound[-28:-20], "little")
    for at, told in ((start + 20, "1 damaged indexes"), (len(sound) // 3, "damaged chunks")):
        path.write_bytes(sound[:at] + bytes([sound[at] ^ 0x40]) + sound[at + 1 :])
        assert told in run("info", path).out
        damage = json.loads(run("info", path, "--json").out)["damage"]
        assert damage["indexes" if at > start else "chunks"] == 1


def test_recover_and_view(tmp_path: Path, run: Run) -> None:
    cut = take_of(tmp_path / "cut.mcap", "S07", cut=0.6)
    assert "without its end" in run("info", cut).out
    done = run("recover", cut, "--out", tmp_path / "fixed.mcap", "--json")
    assert done.code == 0
    told = json.loads(done.out)
    assert sum(told["samples"].values()) > 4
    assert told["damage"]["whole"] is False
    assert told["damage"]["unfinished"] == 1
    assert run("recover", cut, "--out", tmp_path / "fixed.mcap").code == 2
    said = run("recover", cut, "--out", tmp_path / "again.mcap").out
    assert "was missing" in said
    assert "1 sample at the cut, left out" in said
    done = run("view", tmp_path / "fixed.mcap", "--out", tmp_path / "view", "--frames", "3", "--rows", "2")
    assert done.code == 0, done.err
    sheet = cv2.imread(str(tmp_path / "view" / "contact_sheet.png"))
    assert sheet is not None
    assert sheet.shape[0] == 2 * 228
    page = (tmp_path / "view" / "index.html").read_text()
    seen: dict[str, int] = {}

    class Counter(HTMLParser):
        def handle_starttag(self, tag: str, attrs: object) -> None:
            seen[tag] = seen.get(tag, 0) + 1

    Counter().feed(page)
    assert seen["svg"] == 1 + 3
    assert seen["img"] == 9, "a frame of the camera that was cut is left out, so each that is counted has its three images"
    assert "script" not in seen
    assert "http" not in page.replace("http-equiv", "")


def test_erasure_of_a_subject(tmp_path: Path, run: Run) -> None:
    """Own takes go, even those without their end and in folders within; others' stay, and shared ones until --shared."""
    folder = tmp_path / "takes"
    own = [take_of(folder / "a.mcap", "S07"), take_of(folder / "deep" / "b.mcap", "S07", cut=0.5)]
    shared, other = take_of(folder / "c.mcap", "S07", "S08"), take_of(folder / "d.mcap", "S08")
    (folder / "e.mcap").write_bytes(b"what is this")
    (folder / "notes.txt").write_text("S07")
    listed = json.loads(run("info", "--subject", "S07", folder, "--json").out)
    assert {take["file"] for take in listed["takes"]} == {str(path) for path in (*own, shared)}
    assert listed["unknown"] == [str(folder / "e.mcap")]
    asked = run("forget", "--subject", "S07", folder)
    assert asked.code == 0
    assert all(path.exists() for path in (*own, shared))
    assert "would be deleted" in asked.out
    assert "e.mcap" in asked.err
    done = run("forget", "--subject", "S07", folder, "--confirm", "--json")
    assert done.code == 2, "a take that shows the subject is left"
    assert "--shared" in done.err
    told = json.loads(done.out)
    assert told["deleted"] == [str(path) for path in own]
    assert told["shared_kept"] == [str(shared)]
    assert [path.exists() for path in (*own, shared, other)] == [False, False, True, True]
    assert run("forget", "--subject", "S07", folder, "--confirm", "--shared").code == 0
    assert sorted(path.name for path in folder.rglob("*") if path.is_file()) == ["d.mcap", "e.mcap", "notes.txt"]
    assert "no take of S07" in run("info", "--subject", "S07", folder).out
    assert run("forget", "--subject", "S07", tmp_path / "nowhere").code == 2


def test_the_panel_shows_what_matters() -> None:
    good = LaneStatus(SourceStatus("suit", "mvn", "recording", received=500, written=500), 240.0, 0.31, 12.0, 0.01)
    bad = LaneStatus(
        SourceStatus("tof", "royale", "retrying", written=9, lost=3, dropped=17, restarts=2, error="cable"), 0.0, 0.0, 0.0, 0.9
    )
    status = RecorderStatus((good, bad), 65.0, 1_500_000_000, 25e6, 30_000_000_000)
    console = Console(width=140, record=True, file=open(os.devnull, "w"))  # noqa: PTH123, SIM115 - what is drawn is recorded
    console.print(drawn(status, Path("take.mcap"), 120.0))
    text = console.export_text()
    for words in (
        "take.mcap",
        "1:05 of 2:00",
        "suit",
        "240.0",
        "0.31",
        "retrying",
        "17",
        "90 %",
        "cable",
        "1,500 MB",
        "25.0 MB/s",
    ):
        assert words in text
    assert "30.0 GB free, full in 20:00" in text
    assert line(status) == "65 s, 1500 MB; suit 240/s, 0 lost, 0 dropped; tof 0/s, 3 lost, 17 dropped"


def test_the_bench_accounts_for_every_sample(tmp_path: Path) -> None:
    result = bench_record(seconds=1.0, rate_mb=5.0, folder=tmp_path, say=print)
    assert json.loads(json.dumps(result)) == result
    assert result["accounted"]
    assert result["error"] is None
    assert result["mb_per_s"] > 0
    assert result["bytes"] > 1e5
    assert list(tmp_path.iterdir()) == []
    with pytest.raises(ConfigError, match="needs seconds"):
        bench_record(seconds=0, rate_mb=5.0, folder=None, say=print)


def test_without_the_extra_it_says_how_to_get_it(rig: Path, run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("cabinpose.app.extras.find_spec", lambda name: None if name == "mcap" else SimpleNamespace())
    done = run("record", "--config", rig, "--out", "a.mcap")
    assert done.code == 2
    assert "cabinpose[record]" in done.err

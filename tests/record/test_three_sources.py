"""A take of three emulated sources, each with its faults: what was sent is in the file or counted, exactly."""

from __future__ import annotations

import importlib.util
import sys
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest

from cabinpose.core.errors import RecordingError
from cabinpose.record.sources.tof.simulated import SimulatedSettings, SimulatedSource
from cabinpose.signals.clock import HostClock
from cabinpose.store import open_dataset

TOOL = Path(__file__).resolve().parents[2] / "tools" / "three_source_take.py"


@pytest.fixture(scope="module")
def tool() -> ModuleType:
    spec = importlib.util.spec_from_file_location("three_source_take", TOOL)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module  # its dataclasses look themselves up there
    spec.loader.exec_module(module)
    return module


@pytest.fixture
def spheres(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.syspath_prepend(str(Path(__file__).resolve().parents[1] / "store"))
    people = importlib.import_module("sphere_people")
    return people.write(tmp_path / "dataset", people.manifest())


@pytest.mark.slow
@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="the memory of a process is read as Linux tells it")
def test_everything_sent_is_in_the_file_or_counted(tool: ModuleType, spheres: Path, tmp_path: Path) -> None:
    told = tool.take(tool.Plan(spheres, tmp_path / "take", seconds=6.0, dead_s=1.0, loss=0.05, memory_every_s=1.0))
    assert told["exact"], told
    for name, account in told["sources"].items():
        assert account["counted_lost"] == account["missing"] > 0, name
        assert account["dropped"] == 0
    assert told["sources"]["optical"]["nobody_listened"] > 50  # a second and more without its process
    assert told["counts"]["optical"]["restarts"] == 1
    assert told["counts"]["suit"]["reordered"] > 0
    assert told["memory_mb"]["start"] > 1


def sent(tool: ModuleType) -> Any:
    return tool.Sent({"a": set(range(10)), "b": set(range(5))}, 12)


def found(*gone: tuple[str, int]) -> list[tuple[str, int, int]]:
    every = [(s, n) for s, count in (("a", 10), ("b", 5)) for n in range(count)]
    return [(s, n, 100 + i) for i, (s, n) in enumerate(every) if (s, n) not in gone]


def test_an_account_that_does_not_come_out(tool: ModuleType) -> None:
    whole = tool.account(sent(tool), found(("a", 4), ("b", 2)), {"lost": 2, "dropped": 0})
    assert whole["exact"]
    assert (whole["sent"], whole["in_file"], whole["missing"], whole["nobody_listened"]) == (15, 13, 2, 3)
    ends = tool.account(sent(tool), found(("a", 0), ("b", 4)), {"lost": 0, "dropped": 0})
    assert ends["exact"]
    assert ends["outside"] == 2
    assert tool.account(sent(tool), found(("a", 4), ("b", 2)), {"lost": 1, "dropped": 1})["exact"]
    at_end = tool.account(sent(tool), found(("a", 4), ("b", 4)), {"lost": 1, "dropped": 1})
    assert (at_end["exact"], at_end["dropped_at_end"]) == (True, 1)
    for gone, extra, counts in (
        ((("a", 4),), [], {"lost": 0, "dropped": 0}),  # missing and not counted
        ((), [], {"lost": 1, "dropped": 0}),  # counted and not missing
        ((), [], {"lost": 0, "dropped": 1}),  # dropped, and nothing is missing at the end
        ((("b", 4),), [], {"lost": 1, "dropped": 0}),  # lost, where only dropping is known of
        ((), [("a", 3, 115)], {"lost": 0, "dropped": 0}),  # twice
        ((), [("a", 10, 115)], {"lost": 0, "dropped": 0}),  # never sent
        ((("a", 4),), [("a", 40, 104)], {"lost": 1, "dropped": 0}),
    ):
        assert not tool.account(sent(tool), found(*gone) + extra, counts)["exact"], (gone, extra, counts)
    shifted = [(s, n, q + (n > 4)) for s, n, q in found()]  # a gap in the sequence where nothing is missing
    assert not tool.account(sent(tool), shifted, {"lost": 0, "dropped": 0})["exact"]


def test_the_cameras_log_and_its_frames_from_memory(tool: ModuleType, spheres: Path, tmp_path: Path) -> None:
    settings = SimulatedSettings(dataset=spheres, log=tmp_path / "tof.jsonl", faults={"rate_hz": 200}, queue_frames=1000)
    camera = SimulatedSource("tof", settings, HostClock())
    camera.open()
    samples = []
    while camera.counts.received < 12:  # the five frames of the dataset, more than twice
        samples += [s for s in camera.read(1.0) if s.sequence is not None]
    camera.close()
    log = list(tool._lines(tmp_path / "tof.jsonl"))
    assert len(log) >= 12
    assert {line["fate"] for line in log} == {"sent"}
    assert [line["device_ns"] for line in log[: len(samples)]] == [s.device_ns for s in samples]
    depth = open_dataset(spheres)["depth"]
    for i, sample in enumerate(samples):
        (frame,) = sample.messages
        expected = np.rint(np.nan_to_num(depth.isel(frame=i % 5).values) / 1e-4)
        np.testing.assert_array_equal(frame.depth, expected)  # type: ignore[union-attr]
    with pytest.raises(RecordingError, match=r"tof\.jsonl"):
        SimulatedSource("tof", settings, HostClock()).open()

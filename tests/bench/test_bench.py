"""The bench runs, counts what it says it counts, and is fair to Blender where that is installed."""

from __future__ import annotations

import json
import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from benchmarks import synth as bench
from benchmarks.memory import memory_growth
from benchmarks.renderers import ROUNDS, BlenderPeer, blender_python, rendering
from cabinpose.core.camera import Camera
from cabinpose.core.errors import ConfigError, SceneError
from cabinpose.core.pose import OCCUPANT_SLOTS
from cabinpose.scene.cabin import build_cabin
from cabinpose.scene.sensor import SENSORS
from cabinpose.synth import FrameMaker, person_slots

BLENDER = "CABINPOSE_BENCH_CACHE"
NO_FLAGS: dict[str, Any] = {
    "frames": 1, "repeats": 1, "workers": 2, "skip_blender": True, "memory_frames": 0, "say": lambda _: None,
}  # fmt: skip


def test_the_cars_of_the_full_bench_have_five_seats() -> None:
    config = bench.five_occupants()
    assert len(config.scene.cars) >= 3
    for car in config.scene.cars:
        assert set(OCCUPANT_SLOTS) <= set(build_cabin(car, drive_side="left").seats)
    assert person_slots(config) == OCCUPANT_SLOTS


def test_one_means_one() -> None:
    maker = FrameMaker(bench.one_occupant(), 3)
    for index in range(3):
        frame, scene = maker.make(index)
        assert [person.slot for person in scene.people] == ["driver"]
        assert frame["depth"].shape == (287, 352)


@pytest.mark.slow
def test_a_small_bench_has_every_figure() -> None:
    said: list[str] = []
    result = bench.run(**(NO_FLAGS | {"frames": 4, "repeats": 2, "memory_frames": 20, "say": said.append}), scenes=1)
    assert json.loads(json.dumps(result)) == json.loads(json.dumps(result | {"workers": 2, "rounds": 2, "frames": 4}))
    assert min(result["frames_per_s"], result["frames_per_s_five_occupants"]) > 0
    assert result["cpu_ms_per_frame_met"] > 0
    assert 0 < result["acceptance"] <= 1
    assert {"render", "sensor", "write"} <= set(result["stages_ms"])
    assert "ratio_to_blender" not in result
    assert result["blender"]["reason"] == "not asked for"
    assert 100 < result["memory"]["peak_mb"] < 1000
    assert 0 < result["cpu_s"]["help"] < result["cpu_s"]["import"] < result["cpu_s"]["first_frame"]
    for name, (first, third) in result["quartiles"].items():
        assert first <= result[name] <= third
    assert len(said) == 5


@pytest.mark.slow
def test_memory_is_that_of_a_process_of_its_own() -> None:
    ballast = np.ones(140_000_000)  # 1.1 GB here, none of which may be counted
    figures = memory_growth(8)
    assert 100 < figures["peak_mb"] < 1000 < ballast.nbytes / 1e6
    assert figures["peak_mb"] >= max(figures["rss_mb"]) - 0.1
    assert figures["frames"] == 8
    with pytest.raises(ConfigError, match="cannot be watched"):
        memory_growth(0)


def test_a_failing_process_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("benchmarks.memory.__file__", "no_such_module.py")
    with pytest.raises(SceneError, match="no_such_module"):
        memory_growth(1)


def test_each_speed_is_of_its_own_run(monkeypatch: pytest.MonkeyPatch) -> None:
    """Four frames tell nothing of which run is faster; which run a figure is of can be told exactly."""
    runs: list[tuple[Any, ...]] = []

    def timed(*run: Any) -> Any:
        runs.append(run)
        return bench._Run(float(len(runs)), 1.0, 1.0, {"render": 1.0})

    @contextmanager
    def rendering(*_: Any, **__: Any) -> Iterator[Any]:
        yield lambda: 1.0

    monkeypatch.setattr(bench, "_timed", timed)
    monkeypatch.setattr(bench, "_scenes", lambda count: [None] * count)
    monkeypatch.setattr(bench, "_cpu_s", lambda *_: 1.0)
    monkeypatch.setattr(bench, "rendering", rendering)
    result = bench.run(**(NO_FLAGS | {"frames": 16}))
    names = ("frames_per_s", "frames_per_s_met", "frames_per_s_one_thread", "frames_per_s_five_occupants")
    new, met, alone, full = (runs[int(result[name]) - 1] for name in names)
    seed = new[2]
    assert new == met == (bench.one_occupant(), 16, seed, 2)
    assert result["frames_per_s"] < result["frames_per_s_met"]  # the number of the run: new scenes before the same again
    assert alone == (bench.one_occupant(), 16, seed, 1)
    assert full == (bench.five_occupants(), 2, seed, 2)


def test_the_ratios_are_of_the_same_things(monkeypatch: pytest.MonkeyPatch) -> None:
    """Rendering against rendering; the whole pipeline apart; Blender's import in neither; each pair of the same round."""
    blender = iter([0.6, 0.9, 0.3])
    ours = iter([0.02, 0.03, 0.02])

    class Peer:
        reason = None
        version = "4.5"

        def __init__(self, *_: Any, **__: Any) -> None: ...
        def __enter__(self) -> Peer:
            return self

        def __exit__(self, *_: object) -> None: ...
        def render(self) -> tuple[list[float], list[float]]:
            seconds = next(blender)
            return [seconds], [9.0]

        def agreement(self) -> tuple[float, float]:
            return 1.0, 1.0

    @contextmanager
    def rendering(*_: Any, **__: Any) -> Iterator[Any]:
        yield lambda: next(ours)

    monkeypatch.setattr(bench, "_timed", lambda *_: bench._Run(50.0, 20.0, 1.0, {"render": 1.0}))
    monkeypatch.setattr(bench, "_scenes", lambda count: [None] * count)
    monkeypatch.setattr(bench, "_cpu_s", lambda *_: 1.0)
    monkeypatch.setattr(bench, "rendering", rendering)
    monkeypatch.setattr(bench, "BlenderPeer", Peer)
    result = bench.run(**(NO_FLAGS | {"repeats": 3, "workers": 1, "skip_blender": False}))
    assert result["ratio_to_blender"] == pytest.approx(30.0)  # of 30, 30 and 15
    assert result["quartiles"]["ratio_to_blender"] == pytest.approx((22.5, 30.0))
    assert result["ratio_to_blender_pipeline"] == pytest.approx(0.6 * 50.0)


def test_every_scene_is_rendered_as_often(monkeypatch: pytest.MonkeyPatch) -> None:
    calls: list[int] = []

    class Counting:
        def __init__(self, camera: Camera) -> None:
            assert camera.dist == (0.0, 0.0, 0.0, 0.0, 0.0)

        def render(self, surface: int, _: np.ndarray, *, closed: bool) -> None:
            assert closed
            calls.append(surface)

    monkeypatch.setattr("benchmarks.renderers.Rasteriser", Counting)
    scenes: Any = [SimpleNamespace(surface=lambda n=n: n, world_from_camera=np.eye(4), closed=True) for n in range(3)]
    with rendering(scenes, SENSORS["pico_monstar_105"].camera, threads=2) as measure:
        assert all(measure() > 0 for _ in range(5))
    assert {calls.count(n) for n in range(3)} == {2 + 5 * ROUNDS}


def test_nothing_to_measure_is_refused() -> None:
    with pytest.raises(ConfigError, match="needs frames"):
        bench.run(**(NO_FLAGS | {"frames": 0}))


@pytest.mark.slow
def test_where_blender_cannot_be_installed_the_reason_is_given(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("benchmarks.renderers.REQUIREMENT", str(tmp_path / "no-such-wheel.whl"))
    python, reason = blender_python(tmp_path)
    assert python is None
    assert reason is not None
    assert "no-such-wheel" in reason
    with BlenderPeer([], SENSORS["pico_monstar_105"].camera, threads=1, folder=tmp_path) as peer:
        assert peer.reason


@pytest.mark.slow
def test_blender_sees_the_same_depth() -> None:
    cache = os.environ.get(BLENDER)
    if not cache:
        pytest.skip(f"needs Blender: set {BLENDER} to a folder that `cabinpose bench synth` may fill or has filled")
    maker = FrameMaker(bench.one_occupant(), 1)
    with BlenderPeer([maker.make(0)[1]], SENSORS["pico_monstar_105"].camera, threads=2, folder=Path(cache)) as peer:
        assert peer.reason is None
        seconds, with_import = peer.render()
        depth, instance = peer.agreement()
    assert depth > 0.999
    assert instance > 0.999
    assert 0 < seconds[0] < with_import[0]

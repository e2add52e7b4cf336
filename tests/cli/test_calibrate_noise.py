"""`cabinpose calibrate-noise` on recordings and datasets of simulated walls."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from cabinpose.scene.materials import MATERIAL_ID
from cabinpose.scene.sensor import GeometryBuffers, PhysicalNoise, Sensor, simulate
from cabinpose.signals.recorded import Sample, ToFFrame
from cabinpose.store.recording import Chunking, RecordingWriter
from cabinpose.store.schema import Manifest
from cabinpose.store.source import Source, blank_frame, import_source
from cabinpose.synth.config import SynthConfig

Run = Callable[..., Any]
NOW = 1_700_000_000_000_000_000
STEP_M = 5e-4
TRUTH = {"signal_e_per_s": 3e6, "read_noise_e": 15.0}
SENSOR = {
    "name": "ours", "camera": {"width": 96, "height": 72, "fx": 90.0, "fy": 90.0, "cx": 47.5, "cy": 35.5},
    "range_m": [0.2, 4.0], "integration_s": 7e-4, "fps": 15, "frequencies_hz": [80e6, 60e6],
}  # fmt: skip
DISTANCES = (0.5, 0.8, 1.1, 1.5)


def frames_of(distance: float, count: int) -> Iterator[dict[str, Any]]:
    """Depth, amplitude and intrinsics of a simulated wall in the dark."""
    sensor = Sensor.model_validate(SENSOR | TRUTH)
    ratio = sensor.camera.scaled(2).range_over_depth
    flat = GeometryBuffers.dense(
        2, np.full(ratio.shape, distance, np.float32), (1 / ratio).astype(np.float32),
        np.full(ratio.shape, MATERIAL_ID["painted_wall"], np.uint8),
    )  # fmt: skip
    for i in range(count):
        rng = np.random.Generator(np.random.Philox(key=(round(1000 * distance), i)))
        frame = simulate(flat, sensor, PhysicalNoise(ambient=0.0, wiggling=0.0), rng=rng)
        yield {
            "depth": frame.depth_m, "amplitude": frame.amplitude, "camera_k": sensor.camera.k, "camera_dist": np.zeros(5)
        }  # fmt: skip


def record(
    path: Path, distance: float, count: int = 40, sources: tuple[str, ...] = ("tof",), size: tuple[int, int] = (96, 72)
) -> Path:
    """size: of the part of the image that is kept, px."""
    part = slice(size[1]), slice(size[0])
    with RecordingWriter(path, started_ns=NOW, chunking=Chunking(sync_s=0)) as writer:
        for i, f in enumerate(frames_of(distance, count)):
            depth = np.round(np.nan_to_num(f["depth"][part]) / STEP_M).astype(np.uint16)
            none = np.zeros((0, 0), np.uint8)
            message = ToFFrame(depth, STEP_M, f["amplitude"][part], none, f["camera_k"], np.zeros(5), np.zeros(5))
            for source in sources:
                assert writer.write(source, Sample(i, NOW + 1_000_000 * i, None, b"", (message,))) == []
    return path


def in_steps(frames: Iterator[dict[str, Any]], step_m: float) -> Iterator[dict[str, Any]]:
    for frame in frames:
        yield frame | {"depth": np.round(frame["depth"] / step_m) * np.float32(step_m)}


def two_lenses(frames: Iterator[dict[str, Any]]) -> Iterator[dict[str, Any]]:
    for i, frame in enumerate(frames):
        yield frame | ({"camera_k": frame["camera_k"] * [[1.2], [1.2], [1.0]]} if i % 2 else {})


@pytest.fixture(scope="module")
def walls(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    """A recording for each distance."""
    folder = tmp_path_factory.mktemp("walls")
    return [record(folder / f"wall-{d}m.mcap", d) for d in DISTANCES]


@pytest.fixture
def sensor(tmp_path: Path) -> Path:
    path = tmp_path / "ours.yaml"
    path.write_text(yaml.safe_dump({"camera": {"sensor": SENSOR}}))
    return path


def test_recordings_become_configurations(walls: list[Path], sensor: Path, tmp_path: Path, run: Run) -> None:
    out = tmp_path / "noise"
    done = run("calibrate-noise", *walls, "--sensor", sensor, "--dark", "--out", out, "--json")
    assert done.code == 0, done.err
    told = json.loads(done.out)
    assert [w["frames"] for w in told["walls"]] == [40] * 4
    assert [w["distance_m"] for w in told["walls"]] == pytest.approx(DISTANCES, abs=1e-3)
    assert {**told, "out": None} == {**json.loads((out / "fit.json").read_text()), "out": None}
    physical = SynthConfig.load(out / "physical.yaml")
    fitted = physical.camera.sensor_model
    assert fitted.signal_e_per_s == pytest.approx(TRUTH["signal_e_per_s"], rel=0.03)
    assert fitted.read_noise_e == pytest.approx(TRUTH["read_noise_e"], rel=0.03)
    assert physical.noise.kind == "physical"
    law = SynthConfig.load(out / "empirical.yaml")
    assert law.camera.sensor_model == fitted
    for wall in told["walls"]:
        z = wall["distance_m"]
        sigma = law.noise.a_mm + law.noise.b_mm_per_m * z + law.noise.c_mm_per_m2 * z * z
        assert sigma == pytest.approx(wall["sigma_mm"], rel=0.02)
        assert wall["physical_mm"] == pytest.approx(wall["sigma_mm"], rel=0.02)
    page = (out / "index.html").read_text()
    assert page.count("<svg") == 3
    assert page.count("<img") == 4
    assert "signal_e_per_s" in page
    words = run("calibrate-noise", *walls, "--sensor", sensor, "--dark", "--out", out, "--overwrite")
    assert words.code == 0
    assert "read_noise_e" in words.out
    assert f"cabinpose synth --config {out / 'physical.yaml'}" in words.err


def test_a_preset_keeps_what_is_of_no_other_lens(walls: list[Path], tmp_path: Path, run: Run) -> None:
    """Its image circle is that of its own lens, and its filters have been at work before the walls were recorded."""
    preset = tmp_path / "preset.yaml"
    sequence = "scene: {sequence: {frames: 5, rate_hz: 25}}"  # a median over time asks for one
    preset.write_text(f"camera: {{sensor: {{preset: pico_monstar_105, spatial_filter: mean, temporal_median: 3}}}}\n{sequence}\n")
    done = run("calibrate-noise", *walls, "--sensor", preset, "--dark", "--out", tmp_path / "noise")
    assert done.code == 0, done.err
    for kind in ("empirical", "physical"):
        sensor = SynthConfig.load(tmp_path / "noise" / f"{kind}.yaml").camera.sensor_model
        assert (sensor.camera.width, sensor.field_radius_px, sensor.spatial_filter) == (96, None, "none")
        assert sensor.temporal_median == 1
    assert "spatial_filter of --sensor is left out" in done.err
    assert "temporal_median of --sensor is left out" in done.err


def test_synth_generates_with_what_was_fitted(walls: list[Path], sensor: Path, tmp_path: Path, run: Run) -> None:
    out = tmp_path / "noise"
    assert run("calibrate-noise", *walls, "--sensor", sensor, "--dark", "--out", out).code == 0
    for kind in ("empirical", "physical"):
        config, alone = out / f"{kind}.yaml", ("scene.cars=[sedan]", "scene.occupancy={driver: 1}")
        done = run("synth", "--config", config, "--frames", "1", "--workers", "1", "--out", tmp_path / kind, *alone)
        assert done.code == 0, done.err


def test_one_dataset_of_all_distances(tmp_path: Path, run: Run) -> None:
    """Without a sensor: the measured law alone, with the intrinsics of the dataset."""
    manifest = Manifest(
        generator="walls", generator_version="1", seed=0, licence="CC0-1.0", frames=45, frames_per_part=20, width=96, height=72,
        labels=[{"id": 0, "name": "background", "rgb": 0}],
    )  # fmt: skip

    def frames() -> Iterator[dict[str, Any]]:
        for several in zip(*(frames_of(d, 15) for d in (0.6, 0.9, 1.3)), strict=True):
            for seen in several:
                blank = {v.name: np.zeros(manifest.frame_shape(v), v.dtype) for v in manifest.stored if v.is_image}
                yield blank_frame(manifest) | blank | seen

    folder = import_source(Source(tmp_path / "none", manifest, frames), tmp_path / "walls")
    coarse = import_source(Source(tmp_path / "none", manifest, lambda: in_steps(frames(), 5e-3)), tmp_path / "coarse")
    stepped = run("calibrate-noise", coarse, "--out", tmp_path / "coarse-noise", "--json")
    mixed = import_source(Source(tmp_path / "none", manifest, lambda: two_lenses(frames())), tmp_path / "mixed")
    refused = run("calibrate-noise", mixed, "--out", tmp_path / "noise")
    assert refused.code == 2
    assert f"{mixed} has frames of several cameras" in refused.err
    done = run("calibrate-noise", folder, "--out", tmp_path / "noise", "--json")
    assert done.code == 0, done.err
    told = json.loads(done.out)
    assert [round(w["distance_m"], 1) for w in told["walls"]] == [0.6, 0.9, 1.3]
    assert "physical" not in told
    for wall, rounded in zip(told["walls"], json.loads(stepped.out)["walls"], strict=True):
        assert rounded["sigma_mm"] == pytest.approx(wall["sigma_mm"], rel=0.03)
    assert sorted(path.name for path in (tmp_path / "noise").iterdir()) == ["empirical.yaml", "fit.json", "index.html"]
    assert SynthConfig.load(tmp_path / "noise" / "empirical.yaml").noise.kind == "empirical"


def test_what_will_not_do(walls: list[Path], sensor: Path, tmp_path: Path, run: Run) -> None:
    out, short = tmp_path / "noise", record(tmp_path / "short.mcap", 1.0, 4)
    two = record(tmp_path / "two.mcap", 1.0, 2, ("left", "right"))
    other = record(tmp_path / "other.mcap", 1.5, 10, size=(80, 60))
    for words, message, hint in (
        ((), "no wall to look at", "recordings or datasets"),
        (walls[:2], "walls at 2 distances (0.50, 0.80 m), at least 3", "five or more"),
        ([*walls[:2], short], "short: 4 frames of a wall, at least 10", "about a hundred"),
        ([two], "two.mcap has 2 ToF cameras", "--source names one of them: left, right"),
        ([two, "--source", "top"], "top", "left"),
        ([*walls, "--distances", "0.5", "0.8"], "2 distances for 4 files", "in order"),
        ([*walls, "--reflectance", "0"], "are positive", "0..1"),
        ([*walls, "--reflectance", "75"], "1 at most", "0..1"),
        ([*walls, "--distances", "500", "800", "1100", "1500"], "0.50 m away by its depths, and 500 m are given", "in metres"),
        ([*walls[:3], other], "wall-0.5m and other are of two cameras: 96x72 px, fx 90.0 and 80x60 px, fx 90.0", "by itself"),
        ([*walls, "--sensor", "kinect"], "kinect", "kinect_v1"),
        ([*walls, "--sensor", "evk75023", "--distances", "1", "1", "1", "1"], "walls at 1 distance (1.00, 1.00, 1", "five"),
    ):
        done = run("calibrate-noise", *words, "--out", out)
        assert done.code == 2, (words, done)
        assert message in done.err.splitlines()[0]
        assert hint in done.err
        assert not out.exists()
    assert run("calibrate-noise", *walls, "--out", out).code == 0
    assert "already has empirical.yaml" in run("calibrate-noise", *walls, "--out", out).err

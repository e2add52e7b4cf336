"""The figures of `cabinpose bench synth`: frames per second, stages, acceptance, memory, and Blender on the same scenes."""

from __future__ import annotations

import os
import statistics
import tempfile
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import psutil
from distributed import Client

from cabinpose.app.bench.blender import compare
from cabinpose.app.bench.memory import memory_growth
from cabinpose.app.bench.rendering import rendering_speed
from cabinpose.core.errors import ConfigError
from cabinpose.core.pose import OCCUPANT_SLOTS
from cabinpose.scene.cabin import PRESETS, build_cabin
from cabinpose.synth.config import CabinScene, Camera, Output, SynthConfig
from cabinpose.synth.generate import GenerationReport, generate, local_cluster
from cabinpose.synth.sample import Scene
from cabinpose.synth.write import FrameMaker

_FRAMES_PER_PART = 50
_SEED = 1
Say = Callable[[str], None]


@dataclass(frozen=True)
class Throughput:
    """Medians over runs of one configuration. stages_ms: milliseconds a frame of one worker, by stage."""

    frames_per_s: float
    acceptance: float
    stages_ms: Mapping[str, float]
    runs: tuple[float, ...]


def one_occupant() -> SynthConfig:
    """A driver alone, in every preset, 352 x 287; the 18 named people, wheel on the left."""
    alone = {slot: 1.0 if slot == "driver" else 0.0 for slot in OCCUPANT_SLOTS}
    return SynthConfig(
        scene=CabinScene(occupancy=alone, right_hand_drive=0.0),
        camera=Camera(sensor="pico_monstar_105"),
        output=Output(frames_per_part=_FRAMES_PER_PART),
    )


def five_occupants() -> SynthConfig:
    """Every seat taken, in the presets that have five."""
    cars = tuple(name for name in PRESETS if set(OCCUPANT_SLOTS) <= set(build_cabin(name, drive_side="left").seats))
    return SynthConfig(
        scene=CabinScene(cars=cars, occupancy=dict.fromkeys(OCCUPANT_SLOTS, 1.0), right_hand_drive=0.0),
        camera=Camera(sensor="pico_monstar_105"),
        output=Output(frames_per_part=_FRAMES_PER_PART // 2),
    )


def run_bench(
    *,
    frames: int = 400,
    repeats: int = 3,
    workers: int = 2,
    blender: bool = True,
    blender_scenes: int = 7,
    memory_frames: int = 0,
    cache: Path | None = None,
    say: Say = lambda _: None,
) -> dict[str, Any]:
    """Measure, and return plain data for JSON.

    frames: of each timed run, written whole to a temporary folder; every configuration is run once unmeasured first, so that
    the workers are started and have met the cars and people, and then `repeats` times, each with other scenes · workers:
    processes, and Blender's threads · memory_frames: of one more run, in a process of its own whose memory is watched; 0 leaves
    `rss_growth` null · cache: folder of Blender's environment · say: told what is being measured.

    frames_per_s .. frames_per_s_five_occupants count accepted frames on disk a second of all workers. Two ratios to Blender,
    both null, with `blender.reason`, where Blender does not run:

    - ratio_to_blender: rendering against rendering of the same scenes through the same pinhole, each on `workers` cores;
      Blender's `seconds_per_frame` (the render call alone) over ours (`rendering.seconds_per_frame`, see `rendering_speed`).
    - ratio_to_blender_pipeline: our whole pipeline, from drawing a scene to bytes on disk, against Blender's rendering alone;
      frames_per_s over Blender's frames a second.

    `blender.seconds_per_frame_with_import` is Blender's time with the meshes handed over too; no ratio uses it. startup_s:
    from a cold start of the workers to the end of the unmeasured run.
    """
    if min(frames, repeats, workers, blender_scenes) < 1:
        raise ConfigError("the bench needs frames, repeats, workers and scenes", hint="give each at least 1")
    with local_cluster(workers) as cluster:
        started = time.perf_counter()
        address = cluster.scheduler_address
        say(f"one occupant: {repeats} runs of {frames} frames on {workers} workers")
        single = _throughput(one_occupant(), frames, repeats, address)
        startup = time.perf_counter() - started - sum(frames / rate for rate in single.runs)
        five_frames = max(frames // 8, 1)
        say(f"five occupants: {repeats} runs of {five_frames} frames")
        five = _throughput(five_occupants(), five_frames, repeats, address)
        with Client(cluster) as client:
            rss = client.run(_rss_bytes)
    result: dict[str, Any] = {
        "frames_per_s": single.frames_per_s,
        "frames_per_s_five_occupants": five.frames_per_s,
        "ratio_to_blender": None,
        "ratio_to_blender_pipeline": None,
        "acceptance": single.acceptance,
        "acceptance_five_occupants": five.acceptance,
        "stages_ms": dict(single.stages_ms),
        "stages_ms_five_occupants": dict(five.stages_ms),
        "rss_growth": None,
        "rss_worker_mb": max(rss.values()) / 1e6,
        "startup_s": startup,
        "runs": {"one_occupant": list(single.runs), "five_occupants": list(five.runs)},
        "frames": frames,
        "workers": workers,
        "cores": os.cpu_count(),
        "blender": {"seconds_per_frame": None, "reason": "not asked for"},
    }
    scenes, camera = _scenes(blender_scenes), one_occupant().camera.sensor_model.camera
    say(f"rendering alone of {blender_scenes} of the same scenes")
    result["rendering"] = rendering_speed(scenes, camera, workers=workers, repeats=repeats)
    if blender:
        say("Blender on the same")
        result["blender"] = compare(scenes, camera, threads=workers, folder=cache)
        seconds = result["blender"]["seconds_per_frame"]
        if seconds is not None:
            result["ratio_to_blender"] = seconds / result["rendering"]["seconds_per_frame"]
            result["ratio_to_blender_pipeline"] = seconds * single.frames_per_s
    if memory_frames:
        say(f"memory over {memory_frames} frames")
        result["memory"] = memory_growth(memory_frames)
        result["rss_growth"] = result["memory"]["growth"]
    return result


def _throughput(config: SynthConfig, frames: int, repeats: int, scheduler: str) -> Throughput:
    """One unmeasured run, then the medians of `repeats` runs, on the workers of a running cluster."""
    reports: list[GenerationReport] = []
    with tempfile.TemporaryDirectory(prefix="cabinpose-bench-") as folder:
        for number in range(repeats + 1):
            out = Path(folder) / str(number)
            reports.append(generate(config, frames, out, seed=_SEED + number, scheduler=scheduler))
    measured = reports[1:]
    return Throughput(
        statistics.median(r.frames_per_s for r in measured),
        statistics.median(r.acceptance for r in measured),
        {name: statistics.median(r.stages_ms[name] for r in measured) for name in measured[0].stages_ms},
        tuple(r.frames_per_s for r in measured),
    )


def _scenes(count: int) -> list[Scene]:
    """The first scenes of the run with one occupant."""
    maker = FrameMaker(one_occupant(), _SEED)
    return [maker.make(index)[1] for index in range(count)]


def _rss_bytes() -> int:
    """Resident memory of this process."""
    return int(psutil.Process().memory_info().rss)

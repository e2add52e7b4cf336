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
from distributed import Client, LocalCluster

from cabinpose.app.bench.blender import compare
from cabinpose.core.errors import ConfigError
from cabinpose.core.pose import OCCUPANT_SLOTS
from cabinpose.scene.cabin import PRESETS, build_cabin
from cabinpose.synth.config import CabinScene, Camera, Output, SynthConfig
from cabinpose.synth.generate import GenerationReport, Progress, generate
from cabinpose.synth.write import FrameMaker

_FRAMES_PER_PART = 50
_WARM_FRAMES = 500  # after which memory should no longer grow
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
    """A driver alone, in every preset, 352 x 287."""
    alone = {slot: 1.0 if slot == "driver" else 0.0 for slot in OCCUPANT_SLOTS}
    return SynthConfig(
        scene=CabinScene(occupancy=alone),
        camera=Camera(sensor="pico_monstar_105"),
        output=Output(frames_per_part=_FRAMES_PER_PART),
    )


def five_occupants() -> SynthConfig:
    """Every seat taken, in the presets that have five."""
    cars = tuple(name for name in PRESETS if set(OCCUPANT_SLOTS) <= set(build_cabin(name, drive_side="left").seats))
    return SynthConfig(
        scene=CabinScene(cars=cars, occupancy=dict.fromkeys(OCCUPANT_SLOTS, 1.0)),
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
    the workers are started and warm, and then `repeats` times · workers: processes, and Blender's threads · memory_frames: of
    one more run in this process whose memory is watched; 0 leaves `rss_growth` null · cache: folder of Blender's environment
    · say: told what is being measured.

    frames_per_s .. frames_per_s_five_occupants count accepted frames on disk a second of all workers. ratio_to_blender is
    frames_per_s over Blender's frames a second: our whole pipeline against its rendering alone;
    ratio_to_blender_rendering is our rendering alone against it. Both are null, with `blender.reason`, where Blender does not
    run. startup_s: from a cold start of the workers to the end of the unmeasured run.
    """
    if frames < 1 or repeats < 1 or workers < 1:
        raise ConfigError("the bench needs frames, repeats and workers", hint="give each at least 1")
    with LocalCluster(
        n_workers=workers, threads_per_worker=1, processes=True, host="127.0.0.1", dashboard_address=None, silence_logs="ERROR"
    ) as cluster:
        started = time.perf_counter()
        address = cluster.scheduler_address
        say(f"one occupant: {repeats} runs of {frames} frames on {workers} workers")
        single = _throughput(one_occupant(), frames, repeats, address)
        startup = time.perf_counter() - started - sum(frames / rate for rate in single.runs)
        five_frames = max(frames // 4, 1)
        say(f"five occupants: {repeats} runs of {five_frames} frames")
        five = _throughput(five_occupants(), five_frames, repeats, address)
        with Client(cluster) as client:
            rss = client.run(_rss_bytes)
    result: dict[str, Any] = {
        "frames_per_s": single.frames_per_s,
        "frames_per_s_five_occupants": five.frames_per_s,
        "ratio_to_blender": None,
        "ratio_to_blender_rendering": None,
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
    if blender:
        say(f"Blender on {blender_scenes} of the same scenes")
        result["blender"] = _blender(blender_scenes, workers, cache)
        seconds = result["blender"]["seconds_per_frame"]
        if seconds is not None:
            result["ratio_to_blender"] = seconds * single.frames_per_s
            result["ratio_to_blender_rendering"] = seconds * workers / (single.stages_ms["render"] / 1000)
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
            reports.append(generate(config, frames, out, seed=_SEED, scheduler=scheduler))
    measured = reports[1:]
    return Throughput(
        statistics.median(r.frames_per_s for r in measured),
        statistics.median(r.acceptance for r in measured),
        {name: statistics.median(r.stages_ms[name] for r in measured) for name in measured[0].stages_ms},
        tuple(r.frames_per_s for r in measured),
    )


def _blender(count: int, threads: int, cache: Path | None) -> dict[str, Any]:
    """Blender on the first scenes of the run with one occupant."""
    config = one_occupant()
    maker = FrameMaker(config, _SEED)
    scenes = [maker.make(index)[1] for index in range(count)]
    return compare(scenes, config.camera.sensor_model.camera, threads=threads, folder=cache)


def _rss_bytes() -> int:
    """Resident memory of this process."""
    return int(psutil.Process().memory_info().rss)


def memory_growth(frames: int) -> dict[str, Any]:
    """Resident memory of one worker over a long run with random people in random seats, written to disk part by part.

    growth: of the median resident memory of the last tenth over that right after the first 500 frames (or the first tenth of
    a short run); peak_mb: the greatest seen.
    """
    config = SynthConfig(output=Output(frames_per_part=_FRAMES_PER_PART))
    samples: list[tuple[int, int]] = []

    def watch(progress: Progress) -> None:
        samples.append((progress.frames_done, _rss_bytes()))

    with tempfile.TemporaryDirectory(prefix="cabinpose-bench-") as folder:
        generate(config, frames, Path(folder) / "memory", seed=_SEED, workers=1, progress=watch)
    warm = min(_WARM_FRAMES, frames // 10)
    after = [rss for done, rss in samples if done >= warm]
    count = max(len(after) // 10, 1)
    first, last = statistics.median(after[:count]), statistics.median(after[-count:])
    return {
        "frames": frames,
        "growth": last / first - 1,
        "peak_mb": max(rss for _, rss in samples) / 1e6,
        "rss_mb": [round(rss / 1e6, 1) for _, rss in samples[:: max(len(samples) // 50, 1)]],
    }

"""The figures of `cabinpose bench synth`: throughput, CPU time, threads, start-up, memory, and Blender on the same scenes."""

from __future__ import annotations

import os
import resource
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml

from cabinpose._native import SIMD
from cabinpose.app.bench.blender import BlenderPeer
from cabinpose.app.bench.memory import memory_growth
from cabinpose.app.bench.rendering import rendering
from cabinpose.core.errors import ConfigError
from cabinpose.core.pose import OCCUPANT_SLOTS
from cabinpose.scene.cabin import PRESETS, build_cabin
from cabinpose.synth.config import CabinScene, Camera, Output, SynthConfig
from cabinpose.synth.generate import generate
from cabinpose.synth.sample import Scene
from cabinpose.synth.write import FrameMaker

_FRAMES_PER_PART = 50
_SEED = 1
Say = Callable[[str], None]


@dataclass(frozen=True)
class _Run:
    """One timed run: frames a second, CPU milliseconds a frame of this process, acceptance, CPU milliseconds by stage."""

    frames_per_s: float
    cpu_ms_per_frame: float
    acceptance: float
    stages_ms: Mapping[str, float]


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
    repeats: int = 5,
    workers: int = 2,
    blender: bool = True,
    blender_scenes: int = 7,
    memory_frames: int = 0,
    cache: Path | None = None,
    say: Say = lambda _: None,
) -> dict[str, Any]:
    """Measure, and return plain data for JSON: medians, and under `quartiles` the first and third quartile of each figure.

    frames: of each timed run, written whole to a temporary folder · repeats: rounds; in each, everything is measured once, one
    after the other, so that a slow minute of the machine meets all alike · workers: threads, and Blender's · memory_frames: of
    one more run, in a process of its own whose memory is watched; 0 leaves `memory` out · cache: folder of Blender's
    environment · say: told what is being measured.

    - frames_per_s, cpu_ms_per_frame: scenes never met before; `_met`: the same scenes again; `_one_thread`; `_five_occupants`.
    - threads_speedup: frames a second of `workers` threads over those of one, on the same scenes.
    - ratio_to_blender: rendering against rendering of the same scenes through the same pinhole, each on `workers` cores;
      Blender's render call alone over ours (see `rendering`).
    - ratio_to_blender_pipeline, ratio_to_blender_pipeline_five_occupants: our whole pipeline, from drawing a scene to bytes on
      disk, against Blender's rendering alone.
    - cpu_s: of whole processes, from start to end: `help` of `cabinpose --help`, `import` of the generator, `first_frame` of
      `cabinpose synth --frames 1`.

    Ratios to Blender are missing, and `blender.reason` says why, where Blender does not run.
    """
    if min(frames, repeats, workers, blender_scenes) < 1:
        raise ConfigError("the bench needs frames, repeats, workers and scenes", hint="give each at least 1")
    one, five = one_occupant(), five_occupants()
    five_frames = max(frames // 8, 1)
    rows: list[dict[str, float]] = []
    stages: dict[str, list[Mapping[str, float]]] = {"one": [], "five": []}
    result: dict[str, Any] = {"blender": {"reason": "not asked for"}}
    say("scenes for the renderers")
    scenes, camera = _scenes(blender_scenes), one.camera.sensor_model.camera
    with ExitStack() as stack:
        render = stack.enter_context(rendering(scenes, camera, threads=workers))
        peer = None
        if blender:
            say("Blender's environment")
            peer = stack.enter_context(BlenderPeer(scenes, camera, threads=workers, folder=cache))
            result["blender"] = {"reason": peer.reason}
        for number in range(repeats):
            say(f"round {number + 1} of {repeats}: {frames} frames with one occupant, {five_frames} with five")
            seed = _SEED + number
            new = _timed(one, frames, seed, workers)
            met = _timed(one, frames, seed, workers)
            alone = _timed(one, frames, seed, 1)
            full = _timed(five, five_frames, seed, workers)
            stages["one"].append(new.stages_ms)
            stages["five"].append(full.stages_ms)
            row = {
                "frames_per_s": new.frames_per_s,
                "frames_per_s_met": met.frames_per_s,
                "frames_per_s_one_thread": alone.frames_per_s,
                "frames_per_s_five_occupants": full.frames_per_s,
                "cpu_ms_per_frame": new.cpu_ms_per_frame,
                "cpu_ms_per_frame_met": met.cpu_ms_per_frame,
                "cpu_ms_per_frame_five_occupants": full.cpu_ms_per_frame,
                "acceptance": new.acceptance,
                "acceptance_five_occupants": full.acceptance,
                "threads_speedup": met.frames_per_s / alone.frames_per_s,
                "rendering_s_per_frame": render(),
            }
            if peer is not None and peer.reason is None:
                seconds, with_import = (statistics.median(values) for values in peer.render())
                row |= {
                    "blender_s_per_frame": seconds,
                    "blender_s_per_frame_with_import": with_import,
                    "ratio_to_blender": seconds / row["rendering_s_per_frame"],
                    "ratio_to_blender_pipeline": seconds * new.frames_per_s,
                    "ratio_to_blender_pipeline_five_occupants": seconds * full.frames_per_s,
                }
            rows.append(row)
        if peer is not None and peer.reason is None:
            depth, instance = peer.agreement()
            result["blender"] |= {"version": peer.version, "depth_agreement": depth, "instance_agreement": instance}
    say("start-up")
    result["cpu_s"] = {name: statistics.median(_cpu_s(command) for _ in range(3)) for name, command in _STARTS.items()}
    if memory_frames:
        say(f"memory over {memory_frames} frames")
        result["memory"] = memory_growth(memory_frames, workers=workers)
    return {
        **{name: statistics.median(row[name] for row in rows) for name in rows[0]},
        "quartiles": {name: _quartiles([row[name] for row in rows]) for name in rows[0]},
        "stages_ms": _medians(stages["one"]),
        "stages_ms_five_occupants": _medians(stages["five"]),
        **result,
        "rounds": repeats,
        "frames": frames,
        "workers": workers,
        "cores": os.cpu_count(),
        "simd": SIMD,
    }


# What starts up, as arguments of the interpreter; FOLDER is one that goes away.
_STARTS = {
    "help": ("-m", "cabinpose", "--help"),
    "import": ("-c", "import cabinpose.synth.generate"),
    "first_frame": ("-m", "cabinpose", "synth", "--config", "FOLDER/scene.yaml", "--frames", "1", "--out", "FOLDER/first"),
}


def _cpu_s(arguments: Sequence[str]) -> float:
    """CPU seconds of an interpreter with these arguments, from its start to its end."""
    with tempfile.TemporaryDirectory(prefix="cabinpose-bench-") as folder:
        scene = yaml.safe_dump(one_occupant().model_dump(mode="json"))
        (Path(folder) / "scene.yaml").write_text(scene, encoding="utf-8")
        command = [sys.executable, *(word.replace("FOLDER", folder) for word in arguments)]
        before = resource.getrusage(resource.RUSAGE_CHILDREN)
        subprocess.run(command, check=True, capture_output=True)
        after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


def _timed(config: SynthConfig, frames: int, seed: int, threads: int) -> _Run:
    with tempfile.TemporaryDirectory(prefix="cabinpose-bench-") as folder:
        start = time.process_time()
        report = generate(config, frames, Path(folder) / "dataset", seed=seed, workers=threads)
        cpu = time.process_time() - start
    return _Run(report.frames_per_s, 1000 * cpu / frames, report.acceptance, report.stages_ms)


def _medians(rows: Sequence[Mapping[str, float]]) -> dict[str, float]:
    return {name: statistics.median(row[name] for row in rows) for name in rows[0]}


def _quartiles(values: Sequence[float]) -> tuple[float, float]:
    if len(values) < 2:
        return values[0], values[0]
    first, _, third = statistics.quantiles(values, n=4, method="inclusive")
    return first, third


def _scenes(count: int) -> list[Scene]:
    """The first scenes of the run with one occupant."""
    maker = FrameMaker(one_occupant(), _SEED)
    return [maker.make(index)[1] for index in range(count)]

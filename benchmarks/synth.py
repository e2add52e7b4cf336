"""`cabinpose bench synth`: throughput, CPU time, threads, start-up and memory of generation, and Blender on the same scenes."""

from __future__ import annotations

import os
import resource
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import Any, NamedTuple

import yaml

from benchmarks import Say
from benchmarks.memory import memory_growth
from benchmarks.renderers import BlenderPeer, rendering
from cabinpose._native import SIMD
from cabinpose.core.errors import ConfigError
from cabinpose.core.pose import OCCUPANT_SLOTS
from cabinpose.scene.cabin import PRESETS, build_cabin
from cabinpose.synth import FrameMaker
from cabinpose.synth.camera import Camera
from cabinpose.synth.config import CabinScene, Output, SynthConfig
from cabinpose.synth.generate import generate
from cabinpose.synth.scene import Scene

_FRAMES_PER_PART = 50
_SEED = 1
# Programs whose start-up is measured, as arguments of the interpreter; FOLDER is a temporary folder.
_STARTS = {
    "help": ("-m", "cabinpose", "--help"),
    "import": ("-c", "import cabinpose.synth.generate"),
    "first_frame": ("-m", "cabinpose", "synth", "--config", "FOLDER/scene.yaml", "--frames", "1", "--out", "FOLDER/first"),
}


class _Run(NamedTuple):
    """One timed run; CPU times are of this process."""

    frames_per_s: float
    cpu_ms_per_frame: float
    acceptance: float
    stages_ms: Mapping[str, float]


def one_occupant() -> SynthConfig:
    """A driver alone, in every preset, 352 x 287; the 18 named people, wheel on the left."""
    return _config(tuple(PRESETS), ("driver",), _FRAMES_PER_PART)


def five_occupants() -> SynthConfig:
    """Every seat taken, in the presets that have five."""
    cars = tuple(name for name in PRESETS if set(OCCUPANT_SLOTS) <= set(build_cabin(name, drive_side="left").seats))
    return _config(cars, OCCUPANT_SLOTS, _FRAMES_PER_PART // 2)


def _config(cars: tuple[str, ...], slots: Sequence[str], frames_per_part: int) -> SynthConfig:
    occupancy = {slot: float(slot in slots) for slot in OCCUPANT_SLOTS}
    return SynthConfig(
        scene=CabinScene(cars=cars, occupancy=occupancy, right_hand_drive=0.0),
        camera=Camera(sensor="pico_monstar_105"),
        output=Output(frames_per_part=frames_per_part),
    )


def run(
    *, frames: int, repeats: int, workers: int, skip_blender: bool, memory_frames: int, say: Say, scenes: int = 7
) -> dict[str, Any]:
    """Measure generation.

    Parameters
    ----------
    frames
        Of each timed run, written to a temporary folder.
    repeats
        Rounds. In each, everything is measured once, one after the other, so that other load on the machine affects all alike.
    workers
        Threads, ours and Blender's.
    skip_blender
        Leave Blender out.
    memory_frames
        Of one more run in a process of its own whose memory is watched; 0 leaves `memory` out.
    say
        Called with what is being measured.
    scenes
        Rendered by both renderers.

    Returns
    -------
    dict
        Medians over the rounds, and under `quartiles` the first and third quartile of each.

        - frames_per_s, cpu_ms_per_frame: new scenes; `_met`: the same scenes again; `_one_thread`; `_five_occupants`.
        - threads_speedup: frames a second of `workers` threads over those of one, on the same scenes.
        - ratio_to_blender: Blender's render call over our rendering of the same scenes, each on `workers` cores.
        - ratio_to_blender_pipeline, ratio_to_blender_pipeline_five_occupants: Blender's rendering over our whole pipeline, from
          drawing a scene to bytes on disk. Without Blender, `blender.reason` says why these are missing.
        - cpu_s: of whole processes: `help` of `cabinpose --help`, `import` of the generator, `first_frame` of
          `cabinpose synth --frames 1`.
    """
    if min(frames, repeats, workers, scenes) < 1:
        raise ConfigError("the bench needs frames, repeats, workers and scenes", hint="give each at least 1")
    one, five = one_occupant(), five_occupants()
    five_frames = max(frames // 8, 1)
    rows: list[dict[str, float]] = []
    stages: list[tuple[Mapping[str, float], Mapping[str, float]]] = []
    result: dict[str, Any] = {"blender": {"reason": "not asked for"}}
    say("scenes for the renderers")
    rendered, camera = _scenes(scenes), one.camera.sensor_model.camera
    with ExitStack() as stack:
        render = stack.enter_context(rendering(rendered, camera, threads=workers))
        peer = None
        if not skip_blender:
            say("Blender's environment")
            peer = stack.enter_context(BlenderPeer(rendered, camera, threads=workers))
            result["blender"] = {"reason": peer.reason}
            peer = peer if peer.reason is None else None
        for number in range(repeats):
            say(f"round {number + 1} of {repeats}: {frames} frames with one occupant, {five_frames} with five")
            seed = _SEED + number
            new, met = _timed(one, frames, seed, workers), _timed(one, frames, seed, workers)
            alone, full = _timed(one, frames, seed, 1), _timed(five, five_frames, seed, workers)
            stages.append((new.stages_ms, full.stages_ms))
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
            if peer is not None:
                seconds, with_import = (statistics.median(values) for values in peer.render())
                row |= {
                    "blender_s_per_frame": seconds,
                    "blender_s_per_frame_with_import": with_import,
                    "ratio_to_blender": seconds / row["rendering_s_per_frame"],
                    "ratio_to_blender_pipeline": seconds * new.frames_per_s,
                    "ratio_to_blender_pipeline_five_occupants": seconds * full.frames_per_s,
                }
            rows.append(row)
        if peer is not None:
            depth, instance = peer.agreement()
            result["blender"] |= {"version": peer.version, "depth_agreement": depth, "instance_agreement": instance}
    say("start-up")
    result["cpu_s"] = {name: statistics.median(_cpu_s(command) for _ in range(3)) for name, command in _STARTS.items()}
    if memory_frames:
        say(f"memory over {memory_frames} frames")
        result["memory"] = memory_growth(memory_frames, workers=workers)
    return {
        **_medians(rows),
        "quartiles": {name: _quartiles([row[name] for row in rows]) for name in rows[0]},
        "stages_ms": _medians([each for each, _ in stages]),
        "stages_ms_five_occupants": _medians([each for _, each in stages]),
        **result,
        "rounds": repeats, "frames": frames, "workers": workers, "cores": os.cpu_count(), "simd": SIMD,
    }  # fmt: skip


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
    first, _, third = statistics.quantiles(values if len(values) > 1 else [*values, *values], n=4, method="inclusive")
    return first, third


def _scenes(count: int) -> list[Scene]:
    """The first scenes of the run with one occupant."""
    maker = FrameMaker(one_occupant(), _SEED)
    return [maker.make(index)[1] for index in range(count)]

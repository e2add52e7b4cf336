"""`cabinpose bench`: measure generation, detectors, recording and ground truth on this machine."""

from __future__ import annotations

import sys
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import Annotated, Any

import cabinpose
from cabinpose.app.cli.arguments import Maybe, PrintsJson, one_of, several
from cabinpose.app.cli.output import print_json, print_rows, print_table
from cabinpose.app.extras import require
from cabinpose.core import ConfigError

_MAY_BE_0 = ("seed", "memory_frames")
_STAGES = ("input", "network", "decode", "checks")


@dataclass(frozen=True, kw_only=True)
class BenchSynth(PrintsJson):
    """Measure generation: frames a second, CPU time, threads, start-up, memory, and Blender on the same scenes."""

    frames: int = 400
    """Frames of each timed run."""
    repeats: int = 5
    """Rounds in which everything is measured once; medians and quartiles are reported."""
    workers: int = 2
    """Threads, ours and Blender's."""
    skip_blender: bool = False
    """Leave the comparison out; Blender gets an environment of its own with bpy."""
    memory_frames: int = 0
    """Frames of a long run whose memory is watched; 0: no such run."""


@dataclass(frozen=True, kw_only=True)
class BenchDetect(PrintsJson):
    """Measure detectors on the CPU, from a camera's frame to joints, one frame at a time, beside networks of others.

    The packaged models; and, with the extra `train`, `compact` and `paf` with default settings and fresh weights.
    """

    model: Annotated[tuple[str, ...], several("FILE [FILE ...]")] = ()
    """ONNX files of further models to measure."""
    peer: Annotated[tuple[str, ...], several("NAME=FILE.onnx [NAME=FILE.onnx ...]")] = ()
    """Further networks of others: each an ONNX file with one input, an image of a fixed size."""
    frames: int = 100
    """Frames of each timed run."""
    repeats: int = 3
    """Timed runs; the medians are reported."""
    threads: int = 2
    """Threads of ONNX Runtime."""
    skip_fresh: bool = False
    """Leave out the detectors with fresh weights."""
    skip_peers: bool = False
    """Leave out the networks of others."""


@dataclass(frozen=True, kw_only=True)
class BenchRecord(PrintsJson):
    """Measure recording: two ToF cameras and a suit, emulated, raw and decoded, into one file at a steady rate."""

    seconds: float = 120.0
    """Length of the take, s."""
    rate_mb: float = 160.0
    """Rate of the sources, MB/s."""
    folder: Maybe[Path] = None
    """Folder on the disk to measure; default: that of temporary files. The recording is deleted afterwards."""


@dataclass(frozen=True, kw_only=True)
class BenchLab(PrintsJson):
    """Measure ground truth: a virtual rig's errors, all together and each alone, in its calibration and in the joints."""

    errors: Annotated[tuple[str, ...], several("[ERROR [ERROR ...]]")] = ()
    """Errors to measure alone; default: all that the rig has."""
    views: int = 40
    """Poses of the checkerboard."""
    seconds: float = 20.0
    """Length of the driver's take, s."""
    seed: int = 0
    """Seed of all random numbers, the same for every error."""


@dataclass(frozen=True, kw_only=True)
class BenchRemote(PrintsJson):
    """Measure the way to a model on a server and back, over loopback, beside a bare echo server asked by Triton's client."""

    frames: int = 1000
    """Round trips of each way."""


@dataclass(frozen=True, kw_only=True)
class BenchLive(PrintsJson):
    """Measure what `live` adds to the time of the network, from a camera's frame to joints, one frame at a time."""

    frames: int = 300
    """Frames of the timed run."""
    threads: int = 2
    """Threads of ONNX Runtime."""


@dataclass(frozen=True, kw_only=True)
class BenchStudio(PrintsJson):
    """Measure the studio in headless Chromium: from a change of a scene to its pictures, labelling, arrow keys through frames."""

    changes: int = 20
    """Changes of the scene that are timed."""
    frames: int = 12
    """Frames that are labelled in the browser."""
    scrolled: int = 200
    """Frames that are gone through by arrow keys."""


@dataclass(frozen=True, kw_only=True)
class BenchCluster(PrintsJson):
    """Measure experiments on a cluster: equal cells by two Dask workers of one thread against one. Linux alone."""

    cells: int = 8
    """Trainings of a run."""
    repeats: int = 3
    """Rounds in which one worker and two make the cells; the median of their ratios is reported."""


COMMAND = one_of(
    synth=BenchSynth, detect=BenchDetect, record=BenchRecord, lab=BenchLab, remote=BenchRemote, live=BenchLive,
    studio=BenchStudio, cluster=BenchCluster,
)  # fmt: skip


def run(
    command: BenchSynth | BenchDetect | BenchRecord | BenchLab | BenchRemote | BenchLive | BenchStudio | BenchCluster,
) -> None:
    """Measure; stderr tells what is being measured."""
    name = type(command).__name__.removeprefix("Bench").lower()
    extras = {"record": ("record", "bench"), "lab": ("record",), "live": ("record",), "cluster": ("cluster", "train")}
    require(*extras.get(name, (name,) if name in ("remote", "studio") else ()))
    flags = {key: value for key, value in vars(command).items() if key != "as_json"}
    for key, value in flags.items():
        if key not in _MAY_BE_0 and isinstance(value, int | float) and value <= 0 and not isinstance(value, bool):
            raise ConfigError(f"--{key.replace('_', '-')} {value:g} measures nothing", hint="give more than 0")
    if isinstance(command, BenchRecord) and command.folder is not None and not command.folder.is_dir():
        raise ConfigError(f"there is no folder {command.folder}", hint="give one on the disk to measure")
    if isinstance(command, BenchDetect):
        flags["skip"] = tuple(each for each in ("fresh", "peers") if flags.pop(f"skip_{each}"))
    result = _benchmark(name).run(**flags, say=lambda words: print(words, file=sys.stderr))
    if command.as_json:
        print_json(result)
    elif isinstance(command, BenchLab):
        _print_budget(result)
    elif isinstance(command, BenchDetect):
        _print_detectors(result)
    else:
        print_rows(_rows(result))


def _benchmark(name: str) -> Any:
    """A module of the folder `benchmarks` of a checkout; ConfigError where the package is installed without it."""
    root = Path(cabinpose.__file__).parents[2]
    if not (root / "benchmarks" / f"{name}.py").exists():
        raise ConfigError(
            "the benchmarks are part of a checkout of cabinpose, not of the installed package",
            hint="clone the repository, then `make bench`, or `.venv/bin/cabinpose bench` there",
        )
    if str(root) not in sys.path:
        sys.path.append(str(root))
    return import_module(f"benchmarks.{name}")


def _rows(values: Mapping[str, Any], path: str = "") -> Iterator[tuple[str, str]]:
    for name, value in values.items():
        if isinstance(value, Mapping):
            yield from _rows(value, f"{path}{name}.")
        else:
            yield f"{path}{name}", str(value)


def _print_budget(result: Mapping[str, Any]) -> None:
    """A line for each error that was switched on."""
    rows = [("error", "camera mm", "deg", "delay ms", "head deg", "suit ms", "joints cm", "median cm", "px")]
    for name, s in result["sessions"].items():
        values = [s[key] for key in ("camera_mm", "camera_deg", "tof_delay_ms", "head_deg")]
        values += [s["joints"][key] for key in ("suit_delay_ms", "mean_cm", "median_cm", "mean_px")]
        rows.append((name, *(f"{value:.3f}" for value in values)))
    print_table(rows)
    print(f"root of the sum of squares of each alone: {result['budget_cm']['root_of_squares']:.3f} cm")


def _print_detectors(result: Mapping[str, Any]) -> None:
    """A line for each model and peer: frames/s, milliseconds of a frame and its stages, opening, the peers' as its multiples."""
    models, peers, runtime, load = (result[key] for key in ("models", "peers", "runtime", "load_average"))
    stages = [f"{stage} ms" for stage in _STAGES]
    opening = ["import s", "load s", "MB above the runtime"]
    rows = [
        ["", "frames/s", "aim", "p50 ms", "p95 ms", *stages, "batch frames/s", *opening, *(f"{peer} takes" for peer in peers)]
    ]
    for name, f in (models | peers).items():
        times = f["p50_ms"], f["p95_ms"], *(f["stages_ms"].get(stage) for stage in _STAGES)
        figures = [(f["frames_per_s"], "{:.1f}"), (f.get("aim"), "{:.1f}"), *((time, "{:.2f}") for time in times)]
        figures.append((f.get("frames_per_s_batch"), "{:.1f}"))
        figures += [(f.get("import_s"), "{:.2f}"), (f.get("load_s"), "{:.2f}"), (f.get("above_runtime_mb"), "{:.0f}")]
        figures += [(f.get("peers_take", {}).get(peer), "{:.1f} x") for peer in peers]
        rows.append([name, *("" if value is None else form.format(value) for value, form in figures)])
    print_table(rows)
    print(
        f"{result['repeats']} runs of {result['frames']} frames; ONNX Runtime {runtime['onnxruntime']}, "
        f"{runtime['intra_op_num_threads']} threads of {result['cores']} cores; "
        f"load {load['before'][0]:.1f} before, {load['after'][0]:.1f} after"
    )

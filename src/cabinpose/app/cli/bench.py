"""`cabinpose bench`: the figures of generation, of the detectors, of recording and of ground truth on this machine."""

from __future__ import annotations

import sys
from collections.abc import Iterator, Mapping
from typing import Any

from cabinpose.app.bench.detect import run_detect_bench
from cabinpose.app.bench.synth import run_bench
from cabinpose.app.cli.commands import Bench, BenchDetect, BenchLab, BenchRecord, BenchRemote, BenchSynth
from cabinpose.app.cli.output import print_json, print_rows, print_table
from cabinpose.app.extras import require

_STAGES = ("input", "network", "decode")


def run(command: Bench) -> None:
    """Measure, saying on stderr what is under way."""
    action = command.action
    if isinstance(action, BenchSynth):
        result = _synth(action)
    elif isinstance(action, BenchRecord):
        result = _record(action)
    elif isinstance(action, BenchLab):
        result = _lab(action)
    elif isinstance(action, BenchRemote):
        result = _remote(action)
    else:
        result = _detect(action)
    if action.as_json:
        print_json(result)
    elif isinstance(action, (BenchSynth, BenchRecord, BenchRemote)):
        print_rows(_rows(result))
    elif isinstance(action, BenchLab):
        _print_budget(result)
    else:
        _print_detectors(result)


def _synth(command: BenchSynth) -> dict[str, Any]:
    return run_bench(
        frames=command.frames,
        repeats=command.repeats,
        workers=command.workers,
        blender=not command.skip_blender,
        memory_frames=command.memory_frames,
        say=_say,
    )


def _detect(command: BenchDetect) -> dict[str, Any]:
    return run_detect_bench(
        command.model,
        frames=command.frames,
        repeats=command.repeats,
        threads=command.threads,
        fresh=not command.skip_fresh,
        peers=not command.skip_peers,
        say=_say,
    )


def _record(command: BenchRecord) -> dict[str, Any]:
    require("mcap", "mcap_protobuf", "foxglove_schemas_protobuf", "psutil", extra="record,bench")
    from cabinpose.app.bench.record import run_record_bench

    return run_record_bench(seconds=command.seconds, rate_mb=command.rate_mb, folder=command.folder, say=_say)


def _lab(command: BenchLab) -> dict[str, Any]:
    require("mcap", "mcap_protobuf", "foxglove_schemas_protobuf", extra="record")
    from cabinpose.app.bench.lab import run_lab_bench

    return run_lab_bench(errors=command.errors, views=command.views, seconds=command.seconds, seed=command.seed, say=_say)


def _remote(command: BenchRemote) -> dict[str, Any]:
    require("grpc", "tritonclient", extra="remote")
    from cabinpose.app.bench.remote import run_remote_bench

    return run_remote_bench(frames=command.frames)


def _say(words: str) -> None:
    print(words, file=sys.stderr)


def _rows(values: Mapping[str, Any], path: str = "") -> Iterator[tuple[str, str]]:
    for name, value in values.items():
        if isinstance(value, Mapping):
            yield from _rows(value, f"{path}{name}.")
        else:
            yield f"{path}{name}", str(value)


def _print_budget(result: Mapping[str, Any]) -> None:
    """A line for each error that was switched on."""
    head = ("error", "camera mm", "deg", "delay ms", "head deg", "suit ms", "joints cm", "median cm", "px")
    rows = [
        (
            name,
            *(f"{s[key]:.3f}" for key in ("camera_mm", "camera_deg", "tof_delay_ms", "head_deg")),
            *(f"{s['joints'][key]:.3f}" for key in ("suit_delay_ms", "mean_cm", "median_cm", "mean_px")),
        )
        for name, s in result["sessions"].items()
    ]
    print_table([head, *rows])
    print(f"root of the sum of squares of each alone: {result['budget_cm']['root_of_squares']:.3f} cm")


def _print_detectors(result: Mapping[str, Any]) -> None:
    """A line for each model and each peer: frames/s, milliseconds of a frame and its stages, and the peers' as its multiples."""
    models, peers = result["models"], result["peers"]
    head = ["", "frames/s", "aim", "p50 ms", "p95 ms", *(f"{stage} ms" for stage in _STAGES), "batch frames/s"]
    rows = [[*head, *(f"{peer} takes" for peer in peers)]]
    for name, figures in (models | peers).items():
        rates = figures["frames_per_s"], figures.get("aim")
        times = figures["p50_ms"], figures["p95_ms"], *(figures["stages_ms"].get(stage) for stage in _STAGES)
        cells = [*(_cell(x, 1) for x in rates), *(_cell(x, 2) for x in times), _cell(figures.get("frames_per_s_batch"), 1)]
        takes = (figures.get("peers_take", {}).get(peer) for peer in peers)
        rows.append([name, *cells, *("" if x is None else f"{x:.1f} x" for x in takes)])
    print_table(rows)
    runtime = result["runtime"]
    print(
        f"{result['repeats']} runs of {result['frames']} frames; ONNX Runtime {runtime['onnxruntime']}, "
        f"{runtime['intra_op_num_threads']} threads of {result['cores']} cores; "
        f"load {result['load_average']['before'][0]:.1f} before, {result['load_average']['after'][0]:.1f} after"
    )


def _cell(value: float | None, digits: int) -> str:
    return "" if value is None else f"{value:.{digits}f}"

"""How long a network takes to open, and what memory: `python -m benchmarks.opening KIND FILE THREADS FRAMES` prints it as JSON.

KIND is `ours`, whose frames are in the .npz file FRAMES, or `peer`, which is given zeros. Memory is what is resident once some
frames are answered, less what was when the process had imported numpy and ONNX Runtime alone.
"""

from __future__ import annotations

import json
import resource
import subprocess
import sys
import time
from collections.abc import Sequence
from pathlib import Path
from statistics import median
from typing import Any

import numpy as np
import onnxruntime

from cabinpose.core.errors import ConfigError

_FRAMES = 20  # that are answered before memory is measured


def opened(kind: str, file: Path, *, threads: int, frames: Path | None = None) -> dict[str, float]:
    """import_s: of this package, without the runtime · load_s: until the network can be asked · above_runtime_mb: the memory.

    Raises ConfigError where the process fails.
    """
    command = [sys.executable, "-m", "benchmarks.opening", kind, str(file.resolve()), str(threads), str(frames or "")]
    done = subprocess.run(command, capture_output=True, text=True, check=False, cwd=Path(__file__).parents[1])
    if done.returncode != 0:
        last = (done.stderr.strip().splitlines() or ["no message"])[-1]
        raise ConfigError(f"{file} cannot be opened by itself: {last}", hint="try `cabinpose models FILE`")
    answer: dict[str, float] = json.loads(done.stdout.splitlines()[-1])
    return answer


def medians(each: Sequence[dict[str, float]]) -> dict[str, float]:
    """Of several processes."""
    return {name: median(one[name] for one in each) for name in each[0]}


def _resident_mb() -> float:
    """Of this process; Linux says it in pages."""
    return int(Path("/proc/self/statm").read_text("ascii").split()[1]) * resource.getpagesize() / 1e6


def _ours(file: Path, threads: int, frames: Path) -> dict[str, Any]:
    with np.load(frames) as arrays:
        shown = {name: arrays[name] for name in arrays.files}
    before, began = _resident_mb(), time.perf_counter()
    from cabinpose.estimate.predictor import load_model  # noqa: PLC0415 - it is what is measured

    imported = time.perf_counter()
    model = load_model(file, threads=threads)
    loaded = time.perf_counter()
    for number in range(_FRAMES):
        row = number % len(shown["depth"])
        model(shown["depth"][row], shown["camera_k"], shown["amplitude"][row], camera_dist=shown["camera_dist"])
    return {"import_s": imported - began, "load_s": loaded - imported, "above_runtime_mb": _resident_mb() - before}


def _peer(file: Path, threads: int) -> dict[str, Any]:
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = threads
    before, began = _resident_mb(), time.perf_counter()
    session = onnxruntime.InferenceSession(file, options, providers=["CPUExecutionProvider"])
    loaded = time.perf_counter()
    (image,) = session.get_inputs()
    for _ in range(_FRAMES):
        session.run(None, {image.name: np.zeros((1, *image.shape[1:]), np.float32)})
    return {"import_s": 0.0, "load_s": loaded - began, "above_runtime_mb": _resident_mb() - before}


if __name__ == "__main__":
    kind, file, threads, frames = sys.argv[1:]
    told = _ours(Path(file), int(threads), Path(frames)) if kind == "ours" else _peer(Path(file), int(threads))
    sys.stdout.write(json.dumps(told))

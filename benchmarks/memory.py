"""Resident memory over a long run of the generator, in a process of its own: `python memory.py FRAMES WORKERS` prints JSON."""

from __future__ import annotations

import json
import statistics
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

import psutil

from cabinpose.core.errors import ConfigError, SceneError
from cabinpose.synth.config import Output, SynthConfig
from cabinpose.synth.generate import Progress, generate

_FRAMES_PER_PART = 50
_WARM_FRAMES = 1000  # by then every car was built with either drive side, and memory should stop growing
_SEED = 1


def memory_growth(frames: int, *, workers: int = 1) -> dict[str, Any]:
    """Resident memory of a fresh process that generates frames with random people in random seats.

    Parameters
    ----------
    frames, workers
        Frames to generate, and threads.

    Returns
    -------
    dict
        frames, workers; growth: of the median of the last tenth over that after the first 1000 frames (or the first tenth of a
        short run); peak_mb: the maximum, with interpreter and libraries; rss_mb: up to 50 values.

    Raises
    ------
    SceneError
        Where the process fails.
    """
    if frames < 1:
        raise ConfigError(f"memory over {frames} frames cannot be watched", hint="give memory_frames at least 1")
    command = [sys.executable, __file__, str(frames), str(workers)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode != 0:
        last = (done.stderr.strip().splitlines() or ["no message"])[-1]
        raise SceneError(f"the process whose memory was watched failed: {last}", hint="generate a few frames by themselves")
    figures: dict[str, Any] = json.loads(done.stdout.splitlines()[-1])
    return figures


def watch(frames: int, workers: int) -> dict[str, Any]:
    """What `memory_growth` returns, of this process."""
    process = psutil.Process()
    samples: list[tuple[int, int]] = []

    def note(progress: Progress) -> None:
        samples.append((progress.frames_done, int(process.memory_info().rss)))

    with tempfile.TemporaryDirectory(prefix="cabinpose-bench-") as folder:
        config = SynthConfig(output=Output(frames_per_part=min(_FRAMES_PER_PART, max(frames // 4, 1))))
        generate(config, frames, Path(folder) / "memory", seed=_SEED, workers=workers, progress=note)
    warm = min(_WARM_FRAMES, frames // 10)
    after = [rss for done, rss in samples if done >= warm]
    count = max(len(after) // 10, 1)
    return {
        "frames": frames,
        "workers": workers,
        "growth": statistics.median(after[-count:]) / statistics.median(after[:count]) - 1,
        "peak_mb": max(rss for _, rss in samples) / 1e6,
        "rss_mb": [round(rss / 1e6, 1) for _, rss in samples[:: max(len(samples) // 50, 1)]],
    }


if __name__ == "__main__":
    sys.stdout.write(json.dumps(watch(int(sys.argv[1]), int(sys.argv[2]))))

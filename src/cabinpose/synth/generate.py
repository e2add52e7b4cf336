"""From a configuration to a dataset on disk: checks first, then frames, in the threads of this process or on a Dask cluster.

A frame depends on the configuration, the seed and its own number only, so the bytes are the same whatever the number of
threads or machines.
"""

from __future__ import annotations

import os
import time
import warnings
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import wraps
from pathlib import Path
from typing import Any, Literal, ParamSpec, get_args

from cabinpose.core import ConfigError, optional_module
from cabinpose.store import create_dataset
from cabinpose.synth.config import SynthConfig
from cabinpose.synth.frame_maker import FrameMaker
from cabinpose.synth.preflight import preflight
from cabinpose.synth.streams import CHILD_STREAM, check_seed
from cabinpose.synth.validate import Rejection, by_cause
from cabinpose.synth.variables import build_manifest
from cabinpose.synth.write import Content, FrameReport, make_frames

P = ParamSpec("P")
Existing = Literal["refuse", "resume", "overwrite"]


@dataclass(frozen=True)
class Progress:
    """How far a run is: frames on disk, the poses (of sequences: and ways) judged and rejected in this run, what is under way."""

    frames_done: int
    frames_total: int
    judged: int
    rejections: Mapping[Rejection, int]
    phase: Literal["checking the configuration", "preparing cars and people", "posing"]


@dataclass(frozen=True)
class GenerationReport:
    """What a run made. `frames` were made by this run, `frames_total` are in the dataset.

    proposals: poses of people that were drawn, and activities of sequences · judged: poses, and the ways of sequences between
    them, of which it was said whether they hold · rejections: those that do not, by cause · acceptance: share of those that do ·
    stages_ms: mean milliseconds of CPU time a frame, by stage · content: this run's frames by car, view and style, its
    people by name and seat, the most frequent first · label_shift: the farthest that styling moved an edge (px) and the mean
    depth of a part (mm) in this run's styled frames.
    """

    out: str
    frames: int
    frames_total: int
    seconds: float
    frames_per_s: float
    proposals: int
    judged: int
    rejections: Mapping[str, int]
    acceptance: float
    stages_ms: Mapping[str, float]
    content: Mapping[Content, Mapping[str, int]]
    label_shift: Mapping[str, float]


def _with_old_keywords(function: Callable[P, GenerationReport]) -> Callable[P, GenerationReport]:
    """`generate` also with `resume`, `overwrite` and `scheduler`, which are `existing` and `workers` now."""

    @wraps(function)
    def called(*args: P.args, **given: P.kwargs) -> GenerationReport:
        new: dict[str, Any] = dict(given)
        old = {name: new.pop(name) for name in ("resume", "overwrite", "scheduler") if name in new}
        if old:
            instead = 'existing="resume", existing="overwrite" and workers=ADDRESS'
            warnings.warn(f"generate({', '.join(f'{name}=' for name in old)}): give {instead}", DeprecationWarning, stacklevel=2)
        if old.get("resume") and old.get("overwrite"):
            raise ConfigError("a dataset is either resumed or overwritten", hint="give one of the two as `existing`")
        if old.get("resume") or old.get("overwrite"):
            new["existing"] = "resume" if old.get("resume") else "overwrite"
        if old.get("scheduler") is not None:
            new["workers"] = old["scheduler"]
        return function(*args, **new)

    return called


@_with_old_keywords
def generate(
    config: SynthConfig,
    frames: int,
    out: Path,
    *,
    seed: int = 0,
    workers: int | str | None = None,
    existing: Existing = "refuse",
    progress: Callable[[Progress], None] | None = None,
) -> GenerationReport:
    """Generate frames into a dataset folder.

    Parameters
    ----------
    config
        What the frames show.
    frames
        How many the dataset has in the end.
    out
        The folder.
    seed
        Seed of all randomness.
    workers
        Threads, by default one per core; or the address of a running Dask cluster, whose workers see `out` under the same path.
    existing
        What becomes of a dataset that is there: "refuse" it, "resume" where a run of the same configuration stopped, "overwrite".
    progress
        Called before the work starts and after every frame (on a cluster: every part).

    Returns
    -------
    GenerationReport
        What this run made.

    Raises
    ------
    ConfigError, DatasetError
        Before any work starts where that can be known.
    SceneError
        Where no valid scene is found.
    """
    if frames < 1:
        raise ConfigError(f"cannot generate {frames} frames", hint="ask for at least 1 frame")
    if frames > CHILD_STREAM:
        raise ConfigError("a dataset has at most 2**61 frames", hint="ask for fewer")
    check_seed(seed)
    if isinstance(workers, int) and workers < 1:
        raise ConfigError(f"cannot work with {workers} workers", hint="ask for at least 1 worker")
    tell = progress or (lambda _: None)
    tell(Progress(0, frames, 0, {}, "checking the configuration"))
    threads = 1 if isinstance(workers, str) else workers or os.cpu_count() or 1
    preflight(config, frames=frames, workers=threads)
    manifest = build_manifest(config, frames, seed)
    started = time.perf_counter()
    total = FrameReport()
    with create_dataset(out, manifest, overwrite=existing == "overwrite", resume=existing == "resume") as dataset:
        plans = dataset.missing()
        done = dataset.complete()
        before = sum(plan.frames for plan in done)
        if done and config.may_skip:
            from cabinpose.store import open_dataset  # noqa: PLC0415 - xarray, where frames may have been left out

            before = open_dataset(out, missing="ignore").sizes["frame"]
        tell(Progress(before, frames, 0, {}, "preparing cars and people"))
        folder = out.resolve()
        if isinstance(workers, str):
            optional_module("distributed", purpose="a cluster", hint="pip install 'cabinpose[cluster]'")
            from cabinpose.synth.cluster import make_parts  # noqa: PLC0415 - the extra `cluster`

            reports = make_parts(folder, plans, config, manifest, workers)
        else:
            maker = FrameMaker(config, seed)
            reports = make_frames(folder, plans, manifest, maker, threads=threads)
        for report in reports:
            total.add(report)
            tell(Progress(before + total.frames, frames, total.judged, dict(total.rejections), "posing"))
    return _summary(out, total, before, time.perf_counter() - started)


def _summary(out: Path, total: FrameReport, before: int, seconds: float) -> GenerationReport:
    rejected = sum(total.rejections.values())
    return GenerationReport(
        out=str(out),
        frames=total.frames,
        frames_total=before + total.frames,
        seconds=seconds,
        frames_per_s=total.frames / seconds,
        proposals=total.proposals,
        judged=total.judged,
        rejections=by_cause(total.rejections),
        acceptance=1.0 - rejected / total.judged if total.judged else 1.0,
        content={kind: {n: c for (k, n), c in total.content.most_common() if k == kind} for kind in get_args(Content)},
        stages_ms={name: 1000 * s / total.frames for name, s in total.stage_seconds.items()} if total.frames else {},
        label_shift=total.label_shift,
    )

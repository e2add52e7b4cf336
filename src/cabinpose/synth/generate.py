"""From a configuration to a dataset on disk: checks first, then parts, in this process or on Dask workers.

A part is one task. Parts depend on the configuration, the seed and their own frame numbers only, so the bytes are the
same whatever the number of workers, and a part that was lost with its worker is simply made again.
"""

from __future__ import annotations

import os
import time
from collections import Counter, defaultdict
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import dask
from distributed import Client, KilledWorker, LocalCluster, as_completed, wait

import cabinpose
from cabinpose.core.errors import ConfigError, SceneError
from cabinpose.scene.labels import LABELS
from cabinpose.scene.materials import MATERIALS
from cabinpose.store import Manifest, PartPlan, create_dataset
from cabinpose.synth.config import SynthConfig
from cabinpose.synth.rehearse import SHARES, rehearse
from cabinpose.synth.sample import person_slots, preflight
from cabinpose.synth.write import PartReport, make_part

# glibc's allocator in a worker: what a frame frees (under 4 MB a piece) is kept for the next one, what building a car's fields
# took goes back to the system.
ALLOCATOR = {"MALLOC_ARENA_MAX": "1", "MALLOC_MMAP_THRESHOLD_": str(2**22), "MALLOC_TRIM_THRESHOLD_": str(2**28)}


@dataclass(frozen=True)
class Progress:
    """How far a run is: frames on disk, and the poses proposed and rejected (by cause) in this run."""

    frames_done: int
    frames_total: int
    proposals: int
    rejections: Mapping[str, int]


@dataclass(frozen=True)
class GenerationReport:
    """What a run made. `frames` were made by this run, `frames_total` are in the dataset.

    acceptance: accepted / proposed poses of people · stages_ms: mean milliseconds a frame, by stage, of one worker.
    """

    out: str
    frames: int
    frames_total: int
    seconds: float
    frames_per_s: float
    proposals: int
    rejections: Mapping[str, int]
    acceptance: float
    stages_ms: Mapping[str, float]


def generate(
    config: SynthConfig,
    frames: int,
    out: Path,
    *,
    seed: int = 0,
    workers: int | None = None,
    scheduler: str | None = None,
    resume: bool = False,
    overwrite: bool = False,
    progress: Callable[[Progress], None] | None = None,
) -> GenerationReport:
    """Generate `frames` frames into the dataset folder `out`.

    workers: processes of a local cluster (default: one per core; 1 works in this process) · scheduler: address of a
    running Dask cluster instead, whose workers see `out` under the same path · resume: go on where a run of the same
    configuration stopped · overwrite: replace a dataset of ours.

    Raises ConfigError or DatasetError before any work starts where that can be known, SceneError where no valid scene
    is found.
    """
    if frames < 1:
        raise ConfigError(f"cannot generate {frames} frames", hint="ask for at least 1 frame")
    if not 0 <= seed < 2**63:
        raise ConfigError(f"seed {seed} is not a 63-bit natural number", hint="choose a seed from 0 to 2**63 - 1")
    if workers is not None and workers < 1:
        raise ConfigError(f"cannot work with {workers} workers", hint="ask for at least 1 worker")
    preflight(config, frames=frames)
    manifest = build_manifest(config, frames, seed)
    started = time.perf_counter()
    reports: list[PartReport] = []
    with create_dataset(out, manifest, overwrite=overwrite, resume=resume) as dataset:
        plans = dataset.missing()
        before = sum(plan.frames for plan in dataset.complete())
        for report in _make_parts(plans, config, manifest, out, workers, scheduler):
            reports.append(report)
            if progress is not None:
                progress(_progress(reports, before, frames))
    seconds = time.perf_counter() - started
    return _summary(out, reports, before, seconds)


def build_manifest(config: SynthConfig, frames: int, seed: int) -> Manifest:
    """What `dataset.yaml` says of a run."""
    camera = config.camera.sensor_model.camera
    standing = config.scene.kind == "room"
    images = ("depth", "depth_clean", "amplitude", "confidence", "labels", "instance")
    return Manifest(
        generator="cabinpose.synth",
        generator_version=cabinpose.__version__,
        config=config.model_dump(mode="json"),
        seed=seed,
        frames=frames,
        frames_per_part=config.output.frames_per_part,
        width=camera.width,
        height=camera.height,
        persons=person_slots(config),
        licence=config.output.licence,
        labels=[label._asdict() for label in LABELS],
        materials=[{"id": m.id, "name": m.name, "reflectance": m.reflectance} for m in MATERIALS],
        variables=(*images, "itop_joints_3d") if standing else images,
    )


def _make_parts(
    plans: list[PartPlan], config: SynthConfig, manifest: Manifest, out: Path, workers: int | None, scheduler: str | None
) -> Iterator[PartReport]:
    """Make the parts and yield their reports as they are finished."""
    count = min(workers or os.cpu_count() or 1, max(len(plans), 1))
    folder = out.resolve()
    if scheduler is None and count == 1:
        for plan in plans:
            yield make_part(folder, plan, config, manifest)
        return
    with _client(count, scheduler) as client:
        if scheduler is None:  # the workers of a cluster elsewhere may share no disk with each other
            shares = client.map(rehearse, [config] * SHARES, [manifest.seed] * SHARES, range(SHARES), pure=False)
            wait(shares)
        futures = client.map(make_part, [folder] * len(plans), plans, [config] * len(plans), [manifest] * len(plans), pure=False)
        try:
            for future in as_completed(futures):
                yield future.result()
        except KilledWorker as error:
            raise SceneError(
                f"a part ended its worker again and again: {error}",
                hint="look for too little memory or a full disk, then go on with --resume",
            ) from error
        finally:
            client.cancel(futures)


@contextmanager
def _client(workers: int, scheduler: str | None) -> Iterator[Client]:
    """A Dask client: of the cluster at `scheduler`, or of one made here for the run, on loopback."""
    if scheduler is not None:
        try:
            client = Client(scheduler, timeout="10s")
        except (OSError, TimeoutError, ValueError) as error:
            raise ConfigError(f"no Dask scheduler answers at {scheduler}", hint="start one with `dask scheduler`") from error
        with client:
            yield client
        return
    with local_cluster(workers) as cluster, Client(cluster) as client:
        yield client


def local_cluster(workers: int) -> LocalCluster:
    """Processes on this machine, on loopback, whose memory allocator keeps what a frame frees for the next one.

    Every frame fills and frees the same megabytes. Dask's workers give each back to the system at once, which then clears it
    anew: 6 of 62 ms a frame, and most of the time spent in the system.
    """
    threads = dask.config.get("distributed.nanny.pre-spawn-environ")
    with dask.config.set({"distributed.nanny.pre-spawn-environ": {**threads, **ALLOCATOR}}):
        return LocalCluster(
            n_workers=workers,
            threads_per_worker=1,
            processes=True,
            host="127.0.0.1",
            dashboard_address=None,
            silence_logs="ERROR",
        )


def _totals(reports: list[PartReport]) -> tuple[int, int, Counter[str]]:
    """Frames, proposals and rejections by cause of some parts."""
    rejections: Counter[str] = Counter()
    for report in reports:
        rejections.update(report.rejections)
    return sum(r.frames for r in reports), sum(r.proposals for r in reports), rejections


def _progress(reports: list[PartReport], before: int, total: int) -> Progress:
    frames, proposals, rejections = _totals(reports)
    return Progress(before + frames, total, proposals, dict(rejections))


def _summary(out: Path, reports: list[PartReport], before: int, seconds: float) -> GenerationReport:
    frames, proposals, rejections = _totals(reports)
    stages: defaultdict[str, float] = defaultdict(float)
    for report in reports:
        for name, value in report.stage_seconds.items():
            stages[name] += value
    return GenerationReport(
        out=str(out),
        frames=frames,
        frames_total=before + frames,
        seconds=seconds,
        frames_per_s=frames / seconds,
        proposals=proposals,
        rejections=dict(rejections),
        acceptance=1.0 - sum(rejections.values()) / proposals if proposals else 1.0,
        stages_ms={name: 1000 * value / frames for name, value in stages.items()} if frames else {},
    )

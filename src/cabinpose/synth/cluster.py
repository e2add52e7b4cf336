"""Parts of a dataset made on the workers of a Dask cluster, on this machine or others."""

from __future__ import annotations

from collections.abc import Iterator
from functools import lru_cache
from pathlib import Path

from distributed import Client, KilledWorker, as_completed

from cabinpose.core import ConfigError, SceneError
from cabinpose.store import Manifest, PartPlan
from cabinpose.synth.config import SynthConfig
from cabinpose.synth.frame_maker import FrameMaker
from cabinpose.synth.write import FrameReport, make_frames


def make_parts(
    folder: Path, plans: list[PartPlan], config: SynthConfig, manifest: Manifest, scheduler: str
) -> Iterator[FrameReport]:
    """Make the parts on the cluster whose scheduler answers at an address, and yield a report for each when it is finished.

    A part that was lost with its worker is made again. Raises ConfigError where no scheduler answers, SceneError where a part
    ends its worker again and again.
    """
    try:
        client = Client(scheduler, timeout="10s")
    except (OSError, TimeoutError, ValueError) as error:
        raise ConfigError(f"no Dask scheduler answers at {scheduler}", hint="start one with `dask scheduler`") from error
    with client:
        futures = client.map(_make_part, plans, folder=folder, config=config, manifest=manifest, pure=False)
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


def _make_part(plan: PartPlan, *, folder: Path, config: SynthConfig, manifest: Manifest) -> FrameReport:
    """What a worker does with one part."""
    total = FrameReport()
    maker = _maker(config.model_dump_json(), manifest.seed).beside()
    for report in make_frames(folder, [plan], manifest, maker, threads=1):
        total.add(report)
    return total


@lru_cache(maxsize=2)
def _maker(config_json: str, seed: int) -> FrameMaker:
    """One a process, configuration and seed: parts that follow each other share its people and cars."""
    return FrameMaker(SynthConfig.model_validate_json(config_json), seed)

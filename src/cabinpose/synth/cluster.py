"""Parts of a dataset made on the workers of a Dask cluster, on this machine or others."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import lru_cache, partial
from itertools import islice
from pathlib import Path

from distributed import Client, KilledWorker, as_completed

from cabinpose.core import ConfigError, SceneError
from cabinpose.store import Manifest, PartPlan
from cabinpose.synth.config import SynthConfig
from cabinpose.synth.frame_maker import FrameMaker
from cabinpose.synth.write import FrameReport, make_frames

_AHEAD = 10_000  # parts that the scheduler knows of at a time


def make_parts(
    folder: Path, plans: Sequence[PartPlan], config: SynthConfig, manifest: Manifest, scheduler: str
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
        coming = iter(plans)
        submit = partial(client.submit, _make_part, folder=folder, config=config, manifest=manifest, pure=False)
        waiting = {submit(plan) for plan in islice(coming, _AHEAD)}
        try:
            completed = as_completed(waiting)
            for future in completed:
                yield future.result()
                waiting.discard(future)
                for plan in islice(coming, 1):
                    waiting.add(one := submit(plan))
                    completed.add(one)
        except KilledWorker as error:
            raise SceneError(
                f"a part ended its worker again and again: {error}",
                hint="look for too little memory or a full disk, then go on with --resume",
            ) from error
        finally:
            client.cancel(list(waiting))


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

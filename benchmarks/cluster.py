"""The bench of experiments on a cluster: equal cells by two Dask workers of one thread against one, on a machine that others use.

Time in which a worker is ready to run and others have the cores is taken off the wall time, by what the kernel counts of each
thread: what is left is the time that the cells would take on cores of their own, with all waiting for the scheduler, the disk
and each other.
"""

from __future__ import annotations

import os
import statistics
import tempfile
import time
from collections.abc import Mapping, Sequence
from contextlib import ExitStack, suppress
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

from distributed import Client, LocalCluster

from benchmarks import Say
from cabinpose.app.experiment.cells import TrainCell
from cabinpose.app.experiment.config import Experiment
from cabinpose.app.experiment.plan import make_plan
from cabinpose.app.experiment.schedule import make_cells
from cabinpose.core import ConfigError
from cabinpose.store import validated

_TASKS = Path("/proc/self/task")  # where Linux counts the times of threads
_STEPS = 20  # batches of a training, some seconds
_EXPERIMENT: Mapping[str, Any] = {
    "title": "Equal cells",
    "recipe": {
        "method": "compact",
        "settings": {
            "slots": ["driver"], "width": 64, "height": 48, "channels": [8, 8, 16, 16], "blocks": [1, 1, 1], "looks_px": [],
        },
        "batch": 8,
    },
    "data": {
        "scenes": {
            "synth": {
                "scene": {"cars": ["sedan"], "occupancy": {"driver": 1.0}},
                "people": {"own": {"A": {}, "B": {}}},
                "camera": {"sensor": "evk75023", "views": {"driver": 1.0}},
            },
            "frames": {"A": 24, "B": 8},
        }
    },
    "trainings": {
        "cell": {"train": [{"data": "scenes", "subject": ["A"]}], "validation": [{"data": "scenes", "subject": ["B"]}]},
    },
    "tests": {"B": {"frames": [{"data": "scenes", "subject": ["B"]}], "may_share": ["subject", "car"]}},
    "columns": [{"title": "PCKh@0.5", "test": "B"}],
}  # fmt: skip


class ThreadTimes(NamedTuple):
    """Times of a thread, s: on a core, and ready while others had the cores."""

    run_s: float
    wait_s: float


class Run(NamedTuple):
    """Equal cells made once. wall_s: from the first to the last · threads: of each worker, in that time · cpu_s: of all cells."""

    wall_s: float
    threads: Sequence[ThreadTimes]
    cpu_s: float

    @property
    def own_s(self) -> float:
        """The wall time without what others took, the mean over the workers."""
        return self.wall_s - statistics.fmean(thread.wait_s for thread in self.threads)


def run(*, cells: int, repeats: int, say: Say) -> dict[str, Any]:
    """Make equal cells with one worker, and with two.

    Parameters
    ----------
    cells
        Trainings of a run; they differ in the seed alone.
    repeats
        Rounds. In each, one worker and two make the cells, one after the other.
    say
        Called with what is being measured.

    Returns
    -------
    dict
        - speedup, speedups: by the time without what others took, `Run.own_s`: median of the rounds, and each.
        - wall_speedups: by the wall time as it was.
        - own_s, cpu_s: of one worker and of two, medians: that time, and the CPU time of all cells.
        - share: of a core that a worker got while it was ready to run, the least and the most of all runs.

    Raises
    ------
    ConfigError
        For fewer than two cells or no round, and where no Linux counts the times of threads.
    """
    if cells < 2 or repeats < 1:
        raise ConfigError("the bench needs cells for two workers, and a round", hint="give at least --cells 2 --repeats 1")
    if not _TASKS.exists():
        raise ConfigError("times of threads are counted by Linux alone", hint="run it there")
    plain = dict(_EXPERIMENT) | {"scales": {"paper": {"steps": _STEPS, "epochs": 2, "repeats": cells}}}
    runs: dict[int, list[Run]] = {1: [], 2: []}
    with tempfile.TemporaryDirectory() as place, ExitStack() as stack:
        out = Path(place)
        plan = make_plan(validated(Experiment, plain, None, hint=""), "paper", out, {})
        trained = plan.trained["cell"]
        say("frames to learn from")
        make_cells(plan.made, 1, lambda *_: None)
        say("a cell by each worker, which loads what cells need")
        local = {"threads_per_worker": 1, "host": "127.0.0.1", "dashboard_address": ":0", "silence_logs": "ERROR"}
        clusters = {workers: stack.enter_context(LocalCluster(n_workers=workers, **local)) for workers in runs}
        pids = {workers: _warmed(cluster, trained[0], out / f"warm-{workers}") for workers, cluster in clusters.items()}
        for number in range(repeats):
            for workers, cluster in clusters.items():
                placed = [replace(cell, folder=out / f"{number}-{workers}" / cell.key) for cell in trained]
                runs[workers].append(_run(placed, cluster.scheduler_address, pids[workers]))
            one, two = runs[1][-1].own_s, runs[2][-1].own_s
            say(f"round {number + 1} of {repeats}: {cells} cells in {one:.1f} s by one worker, in {two:.1f} s by two")
    rounds = list(zip(*runs.values(), strict=True))
    speedups = [one.own_s / two.own_s for one, two in rounds]
    shares = [t.run_s / (t.run_s + t.wait_s) for each in runs.values() for made in each for t in made.threads]
    return {
        "cells": cells, "repeats": repeats, "speedup": statistics.median(speedups), "speedups": speedups,
        "wall_speedups": [one.wall_s / two.wall_s for one, two in rounds],
        "own_s": {workers: statistics.median(made.own_s for made in each) for workers, each in runs.items()},
        "cpu_s": {workers: statistics.median(made.cpu_s for made in each) for workers, each in runs.items()},
        "share": [min(shares), max(shares)], "cores": os.cpu_count(), "load_average": os.getloadavg(),
    }  # fmt: skip


def _warmed(cluster: Any, cell: TrainCell, folder: Path) -> list[int]:
    """The processes of the workers, each of which has made the cell once."""
    with Client(cluster.scheduler_address) as client:
        pids = client.run(os.getpid)
        cells = [replace(cell, folder=folder / str(pid)) for pid in pids.values()]
        client.gather([client.submit(each.make, workers=[name], pure=False) for name, each in zip(pids, cells, strict=True)])
    return list(pids.values())


def _run(cells: Sequence[TrainCell], address: str, pids: Sequence[int]) -> Run:
    """Make the cells by the workers of a scheduler, who are these processes."""
    records: list[dict[str, Any]] = []
    before = [thread_times(pid) for pid in pids]
    began = time.perf_counter()
    make_cells(cells, address, lambda _, record: records.append(record))
    wall_s = time.perf_counter() - began
    threads = [_busiest(old, thread_times(pid)) for pid, old in zip(pids, before, strict=True)]
    return Run(wall_s, threads, sum(record["cpu_s"] for record in records))


def thread_times(pid: int) -> dict[str, ThreadTimes]:
    """The times of each thread of a process, by its number, since it began."""
    found = {}
    for task in Path(f"/proc/{pid}/task").iterdir():
        with suppress(OSError):  # a thread that ends meanwhile
            run_ns, wait_ns, _ = (task / "schedstat").read_text().split()
            found[task.name] = ThreadTimes(int(run_ns) * 1e-9, int(wait_ns) * 1e-9)
    return found


def _busiest(before: Mapping[str, ThreadTimes], after: Mapping[str, ThreadTimes]) -> ThreadTimes:
    """What the thread that makes the cells did in between: the one that ran longest."""
    spent = (
        ThreadTimes(*(new - old for new, old in zip(times, before.get(name, (0.0, 0.0)), strict=True)))
        for name, times in after.items()
    )
    return max(spent, key=lambda times: times.run_s)

"""Who makes the cells: this process, several of this machine, or the workers of a Dask cluster.

Each cell waits for those that it needs.
"""

from __future__ import annotations

import multiprocessing
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, BrokenExecutor, Executor, Future, ProcessPoolExecutor, wait
from contextlib import contextmanager
from typing import Any

from cabinpose.app.experiment.cells import ExperimentCell
from cabinpose.core import ConfigError, SceneError, optional_module

Told = Callable[[ExperimentCell, dict[str, Any]], None]


def make_cells(cells: Sequence[ExperimentCell], workers: int | str, told: Told) -> None:
    """Make the cells that are not there.

    Parameters
    ----------
    cells
        None before those that it needs.
    workers
        How many processes of this machine, 1: this one alone; or the address of a Dask scheduler, whose workers see the folders
        of the cells under the same paths.
    told
        Called with each cell that was made, and its record.

    Raises
    ------
    ConfigError
        Where no scheduler answers, or workers have several threads.
    SceneError
        Where a worker ends before its cell is made.
    """
    missing = [cell for cell in cells if not cell.done]
    if workers == 1:
        for cell in missing:
            told(cell, cell.make())
        return
    with _executor(workers) as executor:
        _spread(missing, executor, told, at_once=workers if isinstance(workers, int) else len(missing))


def _spread(missing: Sequence[ExperimentCell], executor: Executor, told: Told, *, at_once: int) -> None:
    """Hand each cell to the executor as soon as all that it needs is there, the first of those that wait first."""
    waiting, absent = list(missing), {cell.key for cell in missing}
    running: dict[Future[dict[str, Any]], ExperimentCell] = {}
    try:
        while waiting or running:
            ready = [cell for cell in waiting if not absent.intersection(cell.needs)][: at_once - len(running)]
            waiting = [cell for cell in waiting if cell not in ready]
            running |= {executor.submit(_make, cell): cell for cell in ready}
            for future in wait(running, return_when=FIRST_COMPLETED).done:
                cell = running.pop(future)
                record = future.result()
                absent.discard(cell.key)
                told(cell, record)
    except BrokenExecutor as error:
        raise SceneError(
            f"a worker ended before its cell was made: {error}",
            hint="look for too little memory or a full disk, then run it again",
        ) from error
    finally:
        for future in running:
            future.cancel()


def _make(cell: ExperimentCell) -> dict[str, Any]:
    """What a worker does."""
    return cell.make()


@contextmanager
def _executor(workers: int | str) -> Iterator[Executor]:
    """Processes of this machine, or a cluster."""
    if isinstance(workers, int):
        with ProcessPoolExecutor(workers, multiprocessing.get_context("spawn")) as executor:
            try:
                yield executor
            except BaseException:
                for process in multiprocessing.active_children():  # who asked this process to end does not wait for their cells
                    process.terminate()
                raise
        return
    optional_module("distributed", purpose="a cluster", hint="pip install 'cabinpose[cluster]'")
    from distributed import Client, KilledWorker  # noqa: PLC0415 - the extra `cluster`

    try:
        client = Client(workers, timeout="10s")
    except (OSError, TimeoutError, ValueError) as error:
        raise ConfigError(f"no Dask scheduler answers at {workers}", hint="start one with `dask scheduler`") from error
    with client:
        if several := [worker for worker, threads in client.nthreads().items() if threads > 1]:
            raise ConfigError(  # trainings in one process share the random numbers of torch, and the time that is counted
                f"the worker {several[0]} makes several cells at a time", hint="start workers with `dask worker --nthreads 1`"
            )
        try:
            yield client.get_executor(pure=False)
        except KilledWorker as error:
            raise SceneError(
                f"a cell ended its worker again and again: {error}",
                hint="look for too little memory or a full disk, then run it again",
            ) from error

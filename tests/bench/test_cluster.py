"""The bench of a cluster: times of threads as the kernel counts them, and every figure of a small run."""

from __future__ import annotations

import json
import os
import threading
import time

import pytest

from benchmarks import cluster
from benchmarks.cluster import Run, ThreadTimes, _busiest, thread_times
from cabinpose.core.errors import ConfigError


def test_the_busiest_thread_ran_as_long_as_the_processor_says() -> None:
    """One computes and one sleeps: the former is told, by its own clock of the processor's time."""
    before, own = thread_times(os.getpid()), []

    def compute() -> None:
        began = time.thread_time()
        while time.thread_time() - began < 0.3:
            pass
        own.append(time.thread_time())
        done.wait()

    done = threading.Event()
    threads = [threading.Thread(target=compute), threading.Thread(target=done.wait)]
    for thread in threads:
        thread.start()
    while not own:
        time.sleep(0.01)
    found = _busiest(before, thread_times(os.getpid()))
    done.set()
    for thread in threads:
        thread.join()
    assert found.run_s == pytest.approx(own[0], abs=0.02)
    assert found.wait_s >= 0.0


def test_what_others_took_is_taken_off() -> None:
    """Two workers that had half a core each, of a second, have worked for half a second."""
    assert Run(1.0, [ThreadTimes(0.5, 0.5), ThreadTimes(0.5, 0.5)], 1.0).own_s == pytest.approx(0.5)
    assert Run(1.0, [ThreadTimes(0.2, 0.0), ThreadTimes(0.5, 0.5)], 0.7).own_s == pytest.approx(0.75)


def test_one_cell_is_too_few() -> None:
    with pytest.raises(ConfigError, match="cells for two workers"):
        cluster.run(cells=1, repeats=1, say=lambda _: None)


@pytest.mark.slow
def test_a_small_bench_has_every_figure() -> None:
    said: list[str] = []
    found = cluster.run(cells=2, repeats=1, say=said.append)
    assert json.loads(json.dumps(found))["speedups"] == [found["speedup"]]
    assert 0.3 < found["speedup"] < 2.5
    assert 0 < found["share"][0] <= found["share"][1] <= 1
    assert found["cpu_s"][1] >= 0.5 * found["own_s"][1]
    assert len(said) == 3
    assert said[-1].startswith("round 1 of 1: 2 cells in ")

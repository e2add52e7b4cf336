"""Fixtures of the tests of models on servers: frames, a detector that tells what it saw, servers good and bad."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import grpc
import numpy as np
import pytest
from tritonclient.grpc import service_pb2_grpc

from cabinpose.app.serve import RunningServer, start_server
from cabinpose.core.ports import FrameBatch

sys.path.insert(0, str(Path(__file__).parent))

from somebodys_server import SIZE, Algorithm, Witness, good_answer


@pytest.fixture
def frames() -> FrameBatch:
    rng = np.random.default_rng(4)
    depth = np.kron(rng.uniform(0.3, 2.0, (3, SIZE[0] // 8, SIZE[1] // 8)), np.ones((1, 8, 8))).astype(np.float32)  # no noise
    depth[:, :5] = np.nan
    k = np.array([[50.0, 0, 31.5], [0, 50.0, 23.5], [0, 0, 1]])
    return FrameBatch(
        depth=depth, camera_k=k + rng.uniform(0, 1, (3, 1, 1)) * [[1, 0, 0], [0, 1, 0], [0, 0, 0]], camera_dist=np.zeros((3, 5)),
        amplitude=rng.integers(0, 4000, depth.shape).astype(np.uint16), frame=np.array([40, 41, 57]),
        sync_ns=np.array([10**15, 10**15 + 1, 10**15 + 33]),
    )  # fmt: skip


@pytest.fixture
def witness() -> Witness:
    return Witness()


@pytest.fixture
def server(witness: Witness) -> Iterator[RunningServer]:
    running = start_server(witness)
    yield running
    running.stop()


@pytest.fixture
def algorithm() -> Iterator[Callable[..., tuple[Algorithm, str]]]:
    """`algorithm(answer)`: somebody's server and the address of its model."""
    servers = []

    def start(answer: Callable[[Any], Any] = good_answer, **settings: Any) -> tuple[Algorithm, str]:
        service = Algorithm(answer)
        vars(service).update(settings)
        server = grpc.server(ThreadPoolExecutor(2), options=[("grpc.max_send_message_length", -1)])
        service_pb2_grpc.add_GRPCInferenceServiceServicer_to_server(service, server)
        port = server.add_insecure_port("127.0.0.1:0")
        server.start()
        servers.append(server)
        return service, f"grpc://127.0.0.1:{port}/theirs"

    yield start
    for server in servers:
        server.stop(0)


@pytest.fixture
def process() -> Iterator[Callable[..., subprocess.Popen[str]]]:
    """`process(arguments)`: another Python, killed at the end."""
    running = []

    def start(*arguments: str) -> subprocess.Popen[str]:
        running.append(subprocess.Popen([sys.executable, *arguments], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True))
        return running[-1]

    yield start
    for each in running:
        each.kill()
        each.communicate()

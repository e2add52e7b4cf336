"""The bench of models on servers: what the way there and back costs, beside the barest server that there can be."""

from __future__ import annotations

import multiprocessing
import os
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from typing import Any

import grpc
import numpy as np
import tritonclient.grpc as triton
from numpy.typing import NDArray
from tritonclient.grpc import service_pb2, service_pb2_grpc

from benchmarks import Say
from cabinpose.app.serve import start_server
from cabinpose.core.ports import FrameBatch, PoseBatch
from cabinpose.core.skeleton import JOINTS
from cabinpose.estimate.remote.client import RemotePredictor
from cabinpose.store.predictions import empty_batch

_SIZE = (287, 352)
_WARM = 20
_PERSONS = ("driver", "front_passenger")


class _Nobody:
    """A detector that finds nothing at once, so that only the way is measured."""

    name, persons, joints = "nobody", _PERSONS, JOINTS

    def predict(self, frames: FrameBatch) -> PoseBatch:
        """No joints of N frames."""
        return empty_batch(len(frames["depth"]), len(_PERSONS), len(JOINTS))


class _Echo(service_pb2_grpc.GRPCInferenceServiceServicer):
    """Answers with the inputs that the client asks for as outputs; with none, it only receives."""

    def ModelInfer(self, request: Any, context: grpc.ServicerContext) -> Any:  # noqa: ARG002, N802 - gRPC's names
        response = service_pb2.ModelInferResponse(id=request.id)
        wanted = {output.name for output in request.outputs}
        for tensor, data in zip(request.inputs, request.raw_input_contents, strict=True):
            if tensor.name in wanted:
                response.outputs.add(name=tensor.name, datatype=tensor.datatype, shape=tensor.shape)
                response.raw_output_contents.append(data)
        return response


def _serve_echo(ready: Any) -> None:
    server = grpc.server(ThreadPoolExecutor(4), options=[("grpc.max_receive_message_length", -1)])
    service_pb2_grpc.add_GRPCInferenceServiceServicer_to_server(_Echo(), server)
    ready.put(f"127.0.0.1:{server.add_insecure_port('127.0.0.1:0')}")
    server.start()
    server.wait_for_termination()


def _serve_ours(ready: Any) -> None:
    server = start_server(_Nobody())
    ready.put(server.address)
    server.wait()


@contextmanager
def _process(target: Callable[[Any], None]) -> Iterator[str]:
    """A server in a process of its own, as its address."""
    context = multiprocessing.get_context("spawn")
    ready = context.Queue()
    process = context.Process(target=target, args=(ready,), daemon=True)
    process.start()
    try:
        yield ready.get(timeout=60)
    finally:
        process.terminate()
        process.join()


def run(*, frames: int, say: Say) -> dict[str, Any]:
    """Round trips of one frame of 352x287 over loopback, each server in a process of its own, the ways in turn.

    Parameters
    ----------
    frames
        Round trips of each way.
    say
        Called with what is being measured.

    Returns
    -------
    dict
        ways: by name, median_ms and p95_ms · ratio_p95: our predictor's over those of a bare echo server that
        `tritonclient` asks with the same tensors (echo gives the depth back, receive nothing).
    """
    say("round trips, the ways in turn")
    rng = np.random.default_rng(0)  # noqa: TID251 - the bench's own frame
    depth = rng.uniform(0.3, 2.0, (1, *_SIZE)).astype(np.float32)
    amplitude = rng.integers(0, 4000, depth.shape).astype(np.uint16)
    k = np.array([[[190.0, 0, 175.5], [0, 190.0, 143.0], [0, 0, 1]]])
    frame = FrameBatch(depth=depth, amplitude=amplitude, camera_k=k, camera_dist=np.zeros((1, 5)))
    with _process(_serve_echo) as echo, _process(_serve_ours) as ours:
        client = triton.InferenceServerClient(echo)
        wire, shared = RemotePredictor(f"{ours}?shared_memory=off"), RemotePredictor(ours)

        def ask(outputs: list[Any]) -> None:
            inputs = []
            for name, values in (
                ("depth", depth),
                ("camera_k", k),
                ("camera_dist", frame["camera_dist"]),
                ("amplitude", amplitude),
            ):
                inputs.append(triton.InferInput(name, values.shape, triton.np_to_triton_dtype(values.dtype)))
                inputs[-1].set_data_from_numpy(values)
            result = client.infer("echo", inputs, outputs=outputs, client_timeout=5.0)
            if outputs and result.as_numpy("depth").shape != depth.shape:
                raise RuntimeError("the echo is another")

        ways: dict[str, Callable[[], Any]] = {
            "echo": lambda: ask([triton.InferRequestedOutput("depth")]),
            "receive": lambda: ask([]),
            "wire": lambda: wire.predict(frame),
            "shared_memory": lambda: shared.predict(frame),
        }
        taken: dict[str, list[float]] = {name: [] for name in ways}
        for index in range(_WARM + frames):
            for name, way in ways.items():  # in turn, so that a busy moment of the machine meets all of them
                began = time.perf_counter()
                way()
                if index >= _WARM:
                    taken[name].append(time.perf_counter() - began)
        wire.close()
        shared.close()
        client.close()
    figures = {name: _figures(np.array(seconds)) for name, seconds in taken.items()}
    ratios = {
        f"{way}_to_{bare}": figures[way]["p95_ms"] / figures[bare]["p95_ms"]
        for way in ("wire", "shared_memory") for bare in ("echo", "receive")
    }  # fmt: skip
    return {
        "size": [_SIZE[1], _SIZE[0]], "frames": frames, "cores": os.cpu_count(),
        "load_average": list(os.getloadavg()), "ways": figures, "ratio_p95": ratios,
    }  # fmt: skip


def _figures(seconds: NDArray[np.float64]) -> dict[str, float]:
    return {"median_ms": 1e3 * float(np.median(seconds)), "p95_ms": 1e3 * float(np.quantile(seconds, 0.95))}

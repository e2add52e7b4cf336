"""Other people's processes: the example in C++ is built and judged, and MLServer serves the example for it."""

from __future__ import annotations

import os
import shutil
import socket
import subprocess
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import grpc
import numpy as np
import pytest
from tritonclient.grpc import service_pb2, service_pb2_grpc

import cabinpose
from cabinpose.core.errors import RemoteError
from cabinpose.core.ports import FrameBatch
from cabinpose.core.skeleton import JOINTS
from cabinpose.estimate.remote import open_predictor
from cabinpose.synth.config import room_preset

EXAMPLES = Path(__file__).resolve().parents[2] / "examples/algorithms"
TOOLS = ("g++", "protoc", "grpc_cpp_plugin", "pkg-config")
MLSERVER = "CABINPOSE_MLSERVER"

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def extremes(tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    """The address of the example in C++, built and running."""
    missing = [tool for tool in TOOLS if shutil.which(tool) is None]
    if not missing and subprocess.run(["pkg-config", "--exists", "grpc++", "protobuf"], check=False).returncode:
        missing = ["gRPC's and protobuf's C++ libraries"]
    if missing:
        pytest.skip(f"the example in C++ needs {', '.join(missing)}: see examples/algorithms/extremes/build.sh")
    folder = tmp_path_factory.mktemp("extremes")
    built = subprocess.run(["sh", EXAMPLES / "extremes/build.sh", folder], check=False, capture_output=True, text=True)
    assert built.returncode == 0, built.stderr
    assert built.stderr == ""  # no warnings
    server = subprocess.Popen([folder / "extremes", "0"], stdout=subprocess.PIPE, text=True)
    assert server.stdout is not None
    yield server.stdout.readline().strip()
    server.kill()
    server.communicate()


@pytest.fixture(scope="module")
def room() -> dict[str, np.ndarray]:
    made = list(cabinpose.generate(config=room_preset(), frames=40, seed=5))
    return {name: np.stack([f[name] for f in made]) for name in ("depth", "camera_k", "camera_dist", "joints_3d")}


def test_the_example_in_cpp_finds_head_and_hands(extremes: str, room: dict[str, np.ndarray]) -> None:
    remote = open_predictor(extremes)
    assert (remote.persons, remote.joints) == (("standing",), ("head", "lhand", "rhand"))
    found = remote.predict(FrameBatch(depth=room["depth"], camera_k=room["camera_k"], camera_dist=room["camera_dist"]))
    truth = room["joints_3d"][:, 0][:, [JOINTS.index(name) for name in remote.joints]]
    near = (np.linalg.norm(found.joints_3d[:, 0] - truth, axis=-1) < 0.2).mean(axis=0)
    assert near[0] > 0.6
    assert near[1:].min() > 0.3
    mirrored = (np.linalg.norm(found.joints_3d[:, 0, [2, 1]] - truth[:, 1:], axis=-1) < 0.2).mean()
    assert mirrored < 0.1  # left is left


def test_the_example_in_cpp_says_nothing_of_an_empty_room(extremes: str) -> None:
    k = np.array([[285.0, 0, 159.5], [0, 285.0, 119.5], [0, 0, 1]])
    for depth in (np.nan, 3.0):
        wall = FrameBatch(depth=np.full((1, 240, 320), depth, np.float32), camera_k=k, camera_dist=np.zeros(5))
        found = open_predictor(extremes).predict(wall)
        assert found.presence.max() == 0
        assert np.isnan(found.joints_3d).all()


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"depth": ("FP64", [1, 2, 2], bytes(32))}, "depth is not FP32"),
        ({"depth": ("FP32", [1, 2, 2], bytes(15))}, "another number of bytes"),
        ({"depth": ("FP32", [1, -2, 2], b"")}, "impossible shape"),
        ({"depth": ("FP32", [1, 2**40, 2**40], b"")}, "impossible shape"),
        ({"depth": ("FP32", [2, 2, 2], bytes(32))}, "one frame a request"),
        ({"camera_k": ("FP64", [1, 3, 3], np.full(9, np.nan).tobytes())}, "not finite"),
        ({"camera_k": None}, "camera_k is missing"),
    ],
)
def test_the_example_in_cpp_refuses_what_is_wrong(extremes: str, changes: dict[str, Any], message: str) -> None:
    good = {"depth": ("FP32", [1, 2, 2], bytes(16)), "camera_k": ("FP64", [1, 3, 3], np.eye(3).tobytes())}
    request = service_pb2.ModelInferRequest(model_name="extremes")
    for name, tensor in (good | changes).items():
        if tensor is not None:
            request.inputs.add(name=name, datatype=tensor[0], shape=tensor[1])
            request.raw_input_contents.append(tensor[2])
    channel = grpc.insecure_channel(extremes.removeprefix("grpc://").split("/")[0])
    with channel, pytest.raises(grpc.RpcError, match=message) as caught:
        service_pb2_grpc.GRPCInferenceServiceStub(channel).ModelInfer(request)
    assert caught.value.code() is grpc.StatusCode.INVALID_ARGUMENT


def test_mlserver_serves_the_example_for_it(room: dict[str, np.ndarray], tmp_path: Path) -> None:
    """By hand: `python -m venv env; env/bin/pip install mlserver`, and the variable names env/bin/mlserver."""
    if MLSERVER not in os.environ:
        pytest.skip(f"MLServer needs an environment of its own, whose bin/mlserver {MLSERVER} names")
    ports = []
    for _ in range(3):
        with socket.create_server(("127.0.0.1", 0)) as free:
            ports.append(str(free.getsockname()[1]))
    keys = ("MLSERVER_GRPC_PORT", "MLSERVER_HTTP_PORT", "MLSERVER_METRICS_PORT")
    shutil.copytree(EXAMPLES / "mlserver", tmp_path / "mlserver")
    settings = tmp_path / "mlserver/settings.json"
    settings.write_text(settings.read_text().replace("8081", ports[0]).replace("8080", ports[1]).replace("8082", ports[2]))
    with (tmp_path / "log").open("w") as log:
        server = subprocess.Popen(
            [os.environ[MLSERVER], "start", tmp_path / "mlserver"],
            stdout=log, stderr=log, env=os.environ | dict(zip(keys, ports, strict=True)),
        )  # fmt: skip
        try:
            remote = _patiently(lambda: open_predictor(f"grpc://127.0.0.1:{ports[0]}/nearest"))
            assert (remote.persons, remote.joints) == (("driver",), ("lhand",))
            found = remote.predict(
                FrameBatch(depth=room["depth"][:5], camera_k=room["camera_k"][:5], camera_dist=room["camera_dist"][:5])
            )
            np.testing.assert_array_equal(found.joints_3d[:, 0, 0, 2], np.nanmin(room["depth"][:5], axis=(1, 2)))
            with pytest.raises(RemoteError, match="NOT_FOUND"):
                open_predictor(f"grpc://127.0.0.1:{ports[0]}/nobody")
        finally:
            server.terminate()
            server.wait()


def _patiently(connect: Callable[[], Any]) -> Any:
    """What `connect` gives, tried again for a minute."""
    for _ in range(60):
        try:
            return connect()
        except RemoteError:
            time.sleep(1.0)
    return connect()

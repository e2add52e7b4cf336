"""Our predictor against other people's servers: good ones, and such as hang, die, answer garbage or something else."""

from __future__ import annotations

import itertools
import socket
import threading
import time
import warnings
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import grpc
import numpy as np
import pytest
from somebodys_server import good_answer
from tritonclient.grpc import service_pb2

from cabinpose.app.serve import start_server
from cabinpose.core.camera import Camera
from cabinpose.core.errors import ConfigError, RemoteError
from cabinpose.core.ports import FrameBatch, Predictor
from cabinpose.estimate.remote import open_predictor
from cabinpose.estimate.remote.client import Address, RemotePredictor

Start = Callable[..., tuple[Any, str]]


def _changed(**changes: Any) -> Callable[[Any], dict[str, Any]]:
    """An answer of which some tensors are others, or left out for None."""

    def answer(request: Any) -> dict[str, Any]:
        return {name: value for name, value in (good_answer(request) | changes).items() if value is not None}

    return answer


def test_the_address_says_everything() -> None:
    assert Address.parse("grpc://pc:8001/m") == Address("pc:8001", "m", "pc")
    full = Address.parse(
        "grpc://[::1]:9/my%20net?timeout_s=0.5&on_error=skip&persons=driver&joints=head,lhand&shared_memory=off&max_message_mb=2"
    )
    assert full == Address("[::1]:9", "my net", "::1", 0.5, "skip", ("driver",), ("head", "lhand"), False, 2.0)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("grpc://pc/m", "is no address"), ("grpc://pc:8001", "is no address"), ("grpc://pc:8001/a/b", "is no address"),
        ("http://pc:8001/m", "is no address"), ("grpc://pc:port/m", "is no address"), ("grpc://me:pw@pc:1/m", "is no address"),
        ("grpc://pc:1/m?on_eror=skip", "unknown key of a model's address 'on_eror'"),
        ("grpc://pc:1/m?on_error=maybe", "on_error cannot be 'maybe'"),
        ("grpc://pc:1/m?timeout_s=0", "timeout_s cannot be '0'"), ("grpc://pc:1/m?timeout_s=nan", "timeout_s cannot be 'nan'"),
        ("grpc://pc:1/m?max_message_mb=2048", "max_message_mb cannot be"),
        ("grpc://pc:1/m?joints=head&joints=neck", "sets a key twice"),
        ("grpc://pc:1/m?persons=driver,driver", "names one of them twice"),
    ],
)  # fmt: skip
def test_addresses_that_are_none(text: str, message: str) -> None:
    with pytest.raises(ConfigError, match=message) as caught:
        Address.parse(text)
    assert caught.value.hint


# ------------------------------------------------------------------------------------------------ servers that work


def test_a_server_that_does_as_little_as_it_may(algorithm: Start, frames: FrameBatch) -> None:
    service, address = algorithm()
    remote = open_predictor(address)
    assert isinstance(remote, Predictor)
    assert (remote.persons, remote.joints) == (("driver",), ("head", "lhand"))
    found = remote.predict(frames)
    assert found.joints_3d.shape == (3, 1, 2, 3)
    assert found.presence.tolist() == [[[1, 0]]] * 3
    assert np.isnan(found.joints_2d[:, 0, 1]).all()
    asked = service.requests[1:]
    assert [r.id for r in asked] == ["40", "41", "57"]
    assert [r.parameters["frame"].int64_param for r in asked] == frames["frame"].tolist()
    assert [r.parameters["sync_ns"].int64_param for r in asked] == frames["sync_ns"].tolist()


def test_the_cloud_goes_to_who_asks_for_it(algorithm: Start, frames: FrameBatch) -> None:
    service, address = algorithm(inputs=["points"])
    open_predictor(address).predict(frames)
    assert [tensor.name for tensor in service.requests[1].inputs] == ["points"]
    points = np.frombuffer(service.requests[1].raw_input_contents[0], np.float32).reshape(*frames["depth"].shape[1:], 3)
    depth, k = frames["depth"][0], frames["camera_k"][0]
    np.testing.assert_array_equal(points[..., 2], depth)
    np.testing.assert_allclose(
        points[20, 30, :2], [(30 - k[0, 2]) / k[0, 0] * depth[20, 30], (20 - k[1, 2]) / k[1, 1] * depth[20, 30]]
    )


def test_a_server_that_says_nothing_of_its_inputs_gets_all_but_the_cloud(algorithm: Start, frames: FrameBatch) -> None:
    service, address = algorithm(inputs=[])
    open_predictor(address).predict(frames)
    assert [tensor.name for tensor in service.requests[1].inputs] == ["depth", "camera_k", "camera_dist", "amplitude"]


def test_answers_in_3d_alone_are_projected(algorithm: Start, frames: FrameBatch) -> None:
    _, address = algorithm(_changed(joints_2d=None))
    found = open_predictor(address).predict(frames)
    k = frames["camera_k"][2]
    camera = Camera(64, 48, k[0, 0], k[1, 1], k[0, 2], k[1, 2])
    np.testing.assert_allclose(found.joints_2d[2, 0, 0], camera.project([0.5, 0.5, 0.5]), rtol=1e-6)


def test_names_may_stand_in_the_address(algorithm: Start, frames: FrameBatch) -> None:
    silent = _changed(person_names=None, joint_names=None)
    service, address = algorithm(silent)
    remote = open_predictor(f"{address}?persons=rear_left&joints=neck,chest")
    assert service.requests == []
    assert (remote.persons, remote.joints) == (("rear_left",), ("neck", "chest"))
    assert remote.predict(frames).joints_3d.shape == (3, 1, 2, 3)


def test_the_first_answer_has_its_time_whoever_names_the_joints(algorithm: Start, frames: FrameBatch) -> None:
    service, address = algorithm()
    service.requests.append(None)  # no answer is the first of its own any more
    service.answer = lambda r: (time.sleep(0.4 if r.id in told else 0.0), good_answer(r))[1]
    told, named = ["40"], f"{address}?persons=driver&joints=head,lhand&timeout_s=0.2"
    assert open_predictor(named).predict(frames).presence.max(axis=(1, 2)).tolist() == [1, 1, 1]
    told = ["41"]
    with pytest.raises(RemoteError, match=r"frame 41: there was no answer within 0.2 s"):
        open_predictor(named).predict(frames)


def test_float_amplitudes_are_rounded(algorithm: Start, frames: FrameBatch) -> None:
    service, address = algorithm(inputs=["amplitude"])
    light = np.float32([0.4, 0.6, np.nan, -3, 1e6])
    frames["amplitude"] = np.resize(light, frames["depth"].shape)
    open_predictor(address).predict(frames)
    sent = np.frombuffer(service.requests[1].raw_input_contents[0], np.uint16)
    assert sent[:5].tolist() == [0, 1, 0, 0, 65535]


# -------------------------------------------------------------------------------------------- servers that do not fit


def test_models_that_cannot_be_used_are_said_at_once(algorithm: Start) -> None:
    _, address = algorithm(inputs=["depth", "radar"])
    with pytest.raises(RemoteError, match="wants an input 'radar'"):
        open_predictor(address)
    _, address = algorithm(platform="cabinpose_pose_2")
    with pytest.raises(RemoteError, match="speaks version 2 of the tensors, this program version 1"):
        open_predictor(address)


def test_a_model_without_names_says_what_to_do(algorithm: Start) -> None:
    service, address = algorithm()
    service.answer = _changed(joint_names=None)
    service.requests.append(None)
    with pytest.raises(RemoteError, match="does not name its joints") as caught:
        open_predictor(address)
    assert "?joints=" in str(caught.value.hint)


def test_a_wrong_name_is_said_in_the_servers_words(witness: Any) -> None:
    running = start_server(witness)
    try:
        with pytest.raises(RemoteError, match="NOT_FOUND: there is no such model; this server has witness"):
            open_predictor(running.address.replace("witness", "wittness"))
    finally:
        running.stop()


def test_no_server_is_said_after_a_while(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("cabinpose.estimate.remote.client._LOOK_S", 0.5)
    silent = socket.create_server(("127.0.0.1", 0))  # it listens, and never says a word
    with silent, pytest.raises(RemoteError, match=r"no server was found within 0.5 s"):
        open_predictor(f"grpc://127.0.0.1:{silent.getsockname()[1]}/m")


def test_a_server_of_something_else_is_no_server(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("cabinpose.estimate.remote.client._LOOK_S", 0.5)
    with socket.create_server(("127.0.0.1", 0)) as babbling:
        babbling.settimeout(0.05)
        over = threading.Event()

        def babble() -> None:
            while not over.is_set():
                try:
                    with babbling.accept()[0] as connection:
                        connection.sendall(bytes(range(256)) * 64)
                except OSError:
                    continue

        thread = threading.Thread(target=babble)
        thread.start()
        try:
            with pytest.raises(RemoteError, match=r"no server was found|cannot be reached"):
                open_predictor(f"grpc://127.0.0.1:{babbling.getsockname()[1]}/m")
        finally:
            over.set()
            thread.join()


# ------------------------------------------------------------------------------- answers that are none, frame by frame

_N = np.float32(np.nan)
BAD: dict[str, tuple[Callable[[Any], Any], str]] = {
    "another shape": (_changed(joints_2d=np.zeros((1, 1, 2, 3), np.float32)), "joints_2d is FP32 .1, 1, 2, 3., not FP32"),
    "other persons": (
        lambda _: {"joints_3d": np.ones((1, 2, 2, 3), np.float32)}, "of 2 persons and 2 joints, not of 1 and 2"
    ),
    "NaN present": (
        _changed(joints_2d=np.full((1, 1, 2, 2), _N), joints_3d=np.full((1, 1, 2, 3), _N)),
        "head of driver: presence is above 0 and the position NaN",
    ),
    "infinite": (_changed(joints_3d=np.full((1, 1, 2, 3), np.float32(np.inf))), "head of driver: joints_3d is partly NaN or inf"),
    "two frames": (
        lambda r: {name: np.repeat(a, 2, axis=0) if a.ndim > 1 else a for name, a in good_answer(r).items()},
        "the answer is of 2 frames, not of one",
    ),
    "other joints": (
        _changed(joint_names=np.array(["lhand", "head"], object)), "its joints are lhand, head, and were head, lhand"
    ),
    "nothing": (lambda _: {}, "neither joints_2d nor joints_3d"),
    "another frame": (lambda r: service_pb2.ModelInferResponse(id="13"), "the answer is that of frame '13'"),
    "too large": (lambda r: service_pb2.ModelInferResponse(raw_output_contents=[bytes(3 << 20)]), "RESOURCE_EXHAUSTED"),
    "an error": (lambda r: 1 / 0, "UNKNOWN: Exception calling application: division by zero"),
    "a hang": (lambda r: time.sleep(1.0), "there was no answer within 0.3 s"),
}  # fmt: skip


@pytest.mark.filterwarnings("ignore::pytest.PytestUnhandledThreadExceptionWarning")
@pytest.mark.parametrize("kind", BAD)
@pytest.mark.parametrize("on_error", ["stop", "skip"])
def test_bad_answers_are_told_with_their_frame(algorithm: Start, frames: FrameBatch, kind: str, on_error: str) -> None:
    bad, message = BAD[kind]
    _service, address = algorithm(lambda r: bad(r) if r.id == "41" else good_answer(r))
    remote = open_predictor(f"{address}?on_error={on_error}&timeout_s=0.3&max_message_mb=2")
    if on_error == "stop":
        with pytest.raises(RemoteError, match=f"theirs: frame 41: .*{message}") as caught:
            remote.predict(frames)
        assert "on_error=skip" in str(caught.value.hint)
        return
    with pytest.warns(UserWarning, match=f"theirs: frame 41: .*{message}.*it has no joints"):
        found = remote.predict(frames)
    assert remote.failed == 1
    assert np.isfinite(found.joints_3d[:, 0, 0]).all(axis=-1).tolist() == [True, False, True]
    assert found.presence[1].max() == 0


@pytest.fixture
def garbage() -> Iterator[str]:
    """A gRPC server whose answers are no messages, but for its metadata."""

    class Handler(grpc.GenericRpcHandler):
        def service(self, details: Any) -> Any:
            def answer(request: bytes, context: Any) -> bytes:
                if details.method.endswith("ModelMetadata"):
                    return service_pb2.ModelMetadataResponse(name="m").SerializeToString()
                return b"\xff\xff\xff\xff not a message"

            return grpc.unary_unary_rpc_method_handler(answer)

    server = grpc.server(ThreadPoolExecutor(1), handlers=[Handler()])
    port = server.add_insecure_port("127.0.0.1:0")
    server.start()
    yield f"grpc://127.0.0.1:{port}/m?persons=driver&joints=head"
    server.stop(0)


def test_garbage_is_told_with_its_frame(garbage: str, frames: FrameBatch) -> None:
    with pytest.raises(RemoteError, match=r"frame 40: the server says INTERNAL: .*[Dd]eserializ"):
        open_predictor(garbage).predict(frames)


def test_tellings_are_bounded(algorithm: Start, frames: FrameBatch) -> None:
    _, address = algorithm(lambda _: {})
    remote = open_predictor(f"{address}?on_error=skip")
    many = FrameBatch(**{name: np.repeat(values, 10, axis=0) for name, values in frames.items()})
    with warnings.catch_warnings(record=True) as told:
        warnings.simplefilter("always", UserWarning)
        remote.predict(many)
    assert len(told) == 20
    assert "only counted" in str(told[-1].message)
    assert remote.failed == 30


_DYING = """
import os, sys
sys.path.insert(0, {folder!r})
from somebodys_server import Algorithm, good_answer
import grpc
from concurrent.futures import ThreadPoolExecutor
from tritonclient.grpc import service_pb2_grpc
server = grpc.server(ThreadPoolExecutor(2), options=[("grpc.so_reuseport", 0)])
service_pb2_grpc.add_GRPCInferenceServiceServicer_to_server(
    Algorithm(lambda r: os._exit(1) if r.id == {frame!r} else good_answer(r)), server
)
print(server.add_insecure_port("127.0.0.1:{port}"), flush=True)
server.start()
server.wait_for_termination()
"""


def test_a_server_that_dies_and_comes_back(process: Callable[..., Any], frames: FrameBatch) -> None:
    folder = str(Path(__file__).parent)
    first = process("-c", _DYING.format(folder=folder, frame="41", port=0))
    port = int(first.stdout.readline())
    remote = open_predictor(f"grpc://127.0.0.1:{port}/m?on_error=skip")
    with pytest.warns(UserWarning, match="frame 41: the server cannot be reached") as told:
        found = remote.predict(frames)
    assert len(told) == 2  # frame 57 as well
    assert found.presence.max(axis=(1, 2)).tolist() == [1, 0, 0]
    assert first.wait() == 1
    process("-c", _DYING.format(folder=folder, frame="none", port=port)).stdout.readline()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        for _ in itertools.takewhile(lambda _: remote.predict(frames).presence.max() == 0, range(50)):
            time.sleep(0.1)
    assert remote.predict(frames).presence.max(axis=(1, 2)).tolist() == [1, 1, 1]


def test_shared_memory_survives_a_new_server(frames: FrameBatch, witness: Any) -> None:
    """The new server knows no region: the frame goes over the wire, and the next in a region of its own."""
    running = start_server(witness)
    remote = open_predictor(running.address)
    assert isinstance(remote, RemotePredictor)
    assert remote._region is not None
    old = remote._region.name
    running.stop()
    running = start_server(witness, port=running.port)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            remote._address = Address.parse(f"{running.address}?on_error=skip")
            for _ in itertools.takewhile(lambda _: remote.predict(frames).presence.max() == 0, range(50)):
                time.sleep(0.1)
        assert np.array_equal(remote.predict(frames).joints_3d, witness.predict(frames).joints_3d, equal_nan=True)
        assert remote._region is not None
        assert remote._region.name != old
    finally:
        running.stop()


def test_a_server_that_fails_keeps_no_region(algorithm: Start, frames: FrameBatch) -> None:
    """Somebody's server would hold the memory of each, since it knows no other end of it."""
    known: set[str] = set()

    def register(request: Any, context: Any) -> Any:
        known.add(request.name)
        return service_pb2.SystemSharedMemoryRegisterResponse()

    def unregister(request: Any, context: Any) -> Any:
        known.discard(request.name)
        return service_pb2.SystemSharedMemoryUnregisterResponse()

    offer = service_pb2.ServerMetadataResponse(extensions=["system_shared_memory"])
    calls = {"SystemSharedMemoryRegister": register, "SystemSharedMemoryUnregister": unregister}
    _, address = algorithm(lambda r: 1 / 0, ServerMetadata=lambda request, context: offer, **calls)
    remote = open_predictor(f"{address}?on_error=skip")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        remote.predict(frames)
    assert remote.failed == 3
    assert not known


def test_a_region_that_is_refused_is_no_error(algorithm: Start, frames: FrameBatch) -> None:
    offer = service_pb2.ServerMetadataResponse(extensions=["system_shared_memory"])
    service, address = algorithm(ServerMetadata=lambda request, context: offer)
    remote = open_predictor(address)
    assert remote.predict(frames).presence.max() == 1
    assert remote._region is None
    assert all(len(request.raw_input_contents) == 5 for request in service.requests)

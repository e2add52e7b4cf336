"""Our server, asked by us, by Triton's client and by clients that are wrong or hostile."""

from __future__ import annotations

import os
import socket
import threading
import time
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import grpc
import numpy as np
import pytest
import tritonclient.grpc as triton
from somebodys_server import JOINTS, PERSONS, SIZE, Witness
from tritonclient.grpc import service_pb2, service_pb2_grpc
from tritonclient.utils import InferenceServerException, np_to_triton_dtype

from cabinpose.app.serve import RunningServer, start_server
from cabinpose.core.errors import RemoteError
from cabinpose.core.ports import FrameBatch, PoseBatch
from cabinpose.estimate.predictor import load_model
from cabinpose.estimate.remote import open_predictor

FIELDS = ("joints_2d", "joints_3d", "score", "presence", "expected_error_m")
SHM = Path("/dev/shm")


def same(a: PoseBatch, b: PoseBatch) -> bool:
    return all(np.array_equal(getattr(a, name), getattr(b, name), equal_nan=True) for name in FIELDS)


@pytest.mark.parametrize("query", ["", "?shared_memory=off"])
def test_a_shipped_model_answers_the_same_bits(frames: FrameBatch, query: str) -> None:
    model = load_model("in_car", threads=1)
    running = start_server(model)
    try:
        remote = open_predictor(running.address + query)
        here, there = model.predict(frames), remote.predict(frames)
        assert (remote.name, remote.persons, remote.joints) == (model.name, model.persons, model.joints)
        assert same(here, there)
        assert np.isfinite(there.joints_3d).all()
        assert running.counts == {"answered": 4, "refused": 0}
    finally:
        running.stop()


@pytest.mark.parametrize("query", ["", "?shared_memory=off"])
def test_reasons_and_remarks_come_to_those_who_ask(frames: FrameBatch, query: str) -> None:
    model = load_model("in_car", threads=1)
    frames["depth"][1] = 1.0
    frames["depth"][2, :, : frames["depth"].shape[2] // 3] = 0.05
    running = start_server(model)
    try:
        remote = open_predictor(running.address + query)
        with pytest.warns(UserWarning, match="in_car: .* something lies on a part of the lens"):
            there = remote.predict(frames)
        here = model.predict(frames)
        assert [bool(reason) for reason in there.reason] == [False, True, False]
        assert there.reason.tolist() == here.reason.tolist()
        assert there.remarks == here.remarks != ()
        assert remote.predict({**frames, "depth": frames["depth"][:1]}).remarks == ()
        client = triton.InferenceServerClient(running.address.removeprefix("grpc://").split("/")[0])
        plain = client.infer("in_car", _triton_inputs(frames, 1))
        assert plain.as_numpy("reason") is plain.as_numpy("remarks") is None  # whoever does not ask gets what there was before
        asked = client.infer("in_car", _triton_inputs(frames, 1), outputs=[triton.InferRequestedOutput("reason")])
        assert asked.as_numpy("reason")[0].decode() == there.reason[1]
        client.close()
    finally:
        running.stop()


@pytest.mark.parametrize("query", ["", "?shared_memory=off"])
def test_every_byte_of_a_frame_arrives(frames: FrameBatch, server: RunningServer, witness: Witness, query: str) -> None:
    remote = open_predictor(server.address + query)
    assert same(witness.predict(frames), remote.predict(frames))
    assert (remote._region is None) == bool(query)
    for index, call in enumerate(witness.calls[-3:]):
        for name in ("depth", "camera_k", "camera_dist", "amplitude"):
            np.testing.assert_array_equal(call[name][0], frames[name][index])
            assert call[name].dtype == frames[name].dtype


def test_a_region_grows_with_the_frames(frames: FrameBatch, server: RunningServer, witness: Witness) -> None:
    remote = open_predictor(server.address)
    small = remote._region.byte_size
    large = frames | {name: np.tile(frames[name], (1, 10, 10)) for name in ("depth", "amplitude")}
    assert same(witness.predict(large), remote.predict(large))
    assert remote._region.byte_size > small
    assert server.counts["refused"] == 0  # and so no frame went over the wire after all


def test_no_frames_no_answers(frames: FrameBatch, server: RunningServer) -> None:
    none = FrameBatch(**{name: values[:0] for name, values in frames.items()})
    assert open_predictor(server.address).predict(none).joints_3d.shape == (0, 2, 3, 3)


def _triton_inputs(frames: FrameBatch, index: int = 0) -> list[triton.InferInput]:
    made = []
    for name in ("depth", "camera_k", "camera_dist", "amplitude"):
        values = frames[name][index : index + 1]
        made.append(triton.InferInput(name, values.shape, np_to_triton_dtype(values.dtype)))
        made[-1].set_data_from_numpy(values)
    return made


def test_tritons_client_asks_us(frames: FrameBatch, server: RunningServer, witness: Witness) -> None:
    with triton.InferenceServerClient(f"127.0.0.1:{server.port}") as client:
        assert client.is_server_live()
        assert client.is_server_ready()
        assert client.is_model_ready("witness")
        assert not client.is_model_ready("other")
        metadata = client.get_model_metadata("witness", as_json=True)
        assert metadata["platform"] == "cabinpose_pose_1"
        assert metadata["inputs"][0] == {"name": "depth", "datatype": "FP32", "shape": ["-1", "-1", "-1"]}
        assert metadata["outputs"][1] == {"name": "joints_3d", "datatype": "FP32", "shape": ["-1", "2", "3", "3"]}
        result = client.infer("witness", _triton_inputs(frames, 1), request_id="41")
        assert result.get_response().id == "41"
        expected = witness.predict(FrameBatch(**{name: values[1:2] for name, values in frames.items()}))
        for name in FIELDS:
            np.testing.assert_array_equal(result.as_numpy(name), getattr(expected, name))
        assert result.as_numpy("joint_names").astype(str).tolist() == list(JOINTS)
        assert result.as_numpy("person_names").astype(str).tolist() == list(PERSONS)
        few = client.infer("witness", _triton_inputs(frames), outputs=[triton.InferRequestedOutput("presence")])
        assert few.as_numpy("presence") is not None
        assert few.as_numpy("joints_3d") is None
        with pytest.raises(InferenceServerException, match="there is no output 'heat'"):
            client.infer("witness", _triton_inputs(frames), outputs=[triton.InferRequestedOutput("heat")])


def test_tritons_client_shares_memory_both_ways(frames: FrameBatch, server: RunningServer, witness: Witness) -> None:
    shm = pytest.importorskip("tritonclient.utils.shared_memory")
    depth, size = frames["depth"][:1], 1 << 16
    region = shm.create_shared_memory_region("theirs", "/theirs-of-a-test", size)
    try:
        with triton.InferenceServerClient(f"127.0.0.1:{server.port}") as client:
            client.register_system_shared_memory("theirs", "/theirs-of-a-test", size)
            status = client.get_system_shared_memory_status(as_json=True)["regions"]
            assert status == {"theirs": {"name": "theirs", "key": "/theirs-of-a-test", "byte_size": str(size)}}
            shm.set_shared_memory_region(region, [depth], offset=64)
            inputs = _triton_inputs(frames)
            inputs[0].set_shared_memory("theirs", depth.nbytes, offset=64)
            wanted = triton.InferRequestedOutput("joints_3d")
            wanted.set_shared_memory("theirs", 72, offset=60000)
            result = client.infer("witness", inputs, outputs=[wanted, triton.InferRequestedOutput("score")])
            assert list(result.get_output("joints_3d").shape) == [1, 2, 3, 3]
            expected = witness.predict(FrameBatch(**{name: values[:1] for name, values in frames.items()}))
            found = shm.get_contents_as_numpy(region, np.float32, (1, 2, 3, 3), offset=60000)
            np.testing.assert_array_equal(found, expected.joints_3d)
            np.testing.assert_array_equal(result.as_numpy("score"), expected.score)
            for output, offset, message in ((71, 0, "more than the 71"), (72, size - 71, "beyond the region")):
                wanted.set_shared_memory("theirs", output, offset=offset)
                with pytest.raises(InferenceServerException, match=message):
                    client.infer("witness", inputs, outputs=[wanted])
            client.unregister_system_shared_memory("theirs")
            with pytest.raises(InferenceServerException, match="no shared memory region 'theirs'"):
                client.infer("witness", inputs)
    finally:
        shm.destroy_shared_memory_region(region)


# ------------------------------------------------------------------------------------------------ requests refused


@pytest.fixture
def stub(server: RunningServer) -> Any:
    with grpc.insecure_channel(f"127.0.0.1:{server.port}") as channel:
        yield service_pb2_grpc.GRPCInferenceServiceStub(channel)


def _request(**arrays: Any) -> Any:
    good = {"depth": np.ones((1, *SIZE), np.float32), "camera_k": np.diag([50.0, 50.0, 1.0])[None]}
    request = service_pb2.ModelInferRequest(model_name="witness", id="7")
    for name, values in (good | arrays).items():
        if values is not None:
            request.inputs.add(name=name, datatype=np_to_triton_dtype(values.dtype), shape=values.shape)
            request.raw_input_contents.append(values.tobytes())
    return request


def test_the_least_request_is_answered(stub: Any) -> None:
    assert stub.ModelInfer(_request()).id == "7"


@pytest.mark.parametrize(
    ("arrays", "message"),
    [
        ({"depth": None}, "depth is missing"),
        ({"camera_k": None}, "camera_k is missing"),
        ({"camera_k": np.full((1, 3, 3), np.nan)}, "not finite"),
        ({"camera_dist": np.full((1, 5), np.inf)}, "not finite"),
        ({"camera_k": np.diag([1e300, 1e300, 1.0])[None]}, r"or beyond 1e\+09"),
        ({"camera_k": np.ones((2, 3, 3))}, "camera_k is FP64 .2, 3, 3., not FP64 .1, 3, 3."),
        ({"amplitude": np.ones((1, *SIZE), np.float32)}, "amplitude is FP32"),
        ({"points": np.ones((1, *SIZE, 3), np.float32)}, "'points' is unknown"),
    ],
)
def test_wrong_requests_are_named(stub: Any, server: RunningServer, witness: Witness, arrays: Any, message: str) -> None:
    with pytest.raises(grpc.RpcError, match=message) as caught:
        stub.ModelInfer(_request(**arrays))
    assert caught.value.code() is grpc.StatusCode.INVALID_ARGUMENT
    assert witness.calls == []
    assert server.counts == {"answered": 0, "refused": 1}


def test_errors_of_the_model_are_told_with_their_hint() -> None:
    running = start_server(load_model("in_car", threads=1))
    try:
        with grpc.insecure_channel(f"127.0.0.1:{running.port}") as channel:
            asked = _request()
            asked.model_name = "in_car"
            with pytest.raises(grpc.RpcError, match=r"reads amplitudes, and the frames have none .take a model of depth alone"):
                service_pb2_grpc.GRPCInferenceServiceStub(channel).ModelInfer(asked)
    finally:
        running.stop()


def test_other_models_and_versions_are_not_found(stub: Any) -> None:
    for name, version in (("other", ""), ("witness", "2")):
        request = _request()
        request.model_name, request.model_version = name, version
        with pytest.raises(grpc.RpcError, match="this server has witness") as caught:
            stub.ModelInfer(request)
        assert caught.value.code() is grpc.StatusCode.NOT_FOUND


def test_messages_are_bounded(witness: Witness) -> None:
    running = start_server(witness, max_message_bytes=8000)
    try:
        with grpc.insecure_channel(f"127.0.0.1:{running.port}") as channel:
            with pytest.raises(grpc.RpcError) as caught:
                service_pb2_grpc.GRPCInferenceServiceStub(channel).ModelInfer(_request())
            assert caught.value.code() is grpc.StatusCode.RESOURCE_EXHAUSTED
    finally:
        running.stop()
    assert witness.calls == []


def test_a_caller_waits_no_longer_than_its_deadline_for_its_turn() -> None:
    begun = threading.Event()

    class Slow(Witness):
        def predict(self, frames: FrameBatch) -> PoseBatch:
            found = super().predict(frames)
            begun.set()
            time.sleep(1.0)
            return found

    slow = Slow()
    running = start_server(slow)
    try:
        with grpc.insecure_channel(f"127.0.0.1:{running.port}") as channel:
            stub = service_pb2_grpc.GRPCInferenceServiceStub(channel)
            first = stub.ModelInfer.future(_request(), timeout=10)
            assert begun.wait(5)
            late = [stub.ModelInfer.future(_request(), timeout=0.3) for _ in range(2)]
            assert [call.code() for call in late] == [grpc.StatusCode.DEADLINE_EXCEEDED] * 2
            assert first.result().id == "7"
            time.sleep(0.3)  # for a call that waited longer than its caller
    finally:
        running.stop()
    assert len(slow.calls) == 1


def _listening(port: int) -> set[str]:
    """The addresses on which this machine listens at a port, as Linux prints them."""
    lines = [line.split() for name in ("tcp", "tcp6") for line in Path(f"/proc/net/{name}").read_text().splitlines()[1:]]
    return {line[1].split(":")[0] for line in lines if line[3] == "0A" and int(line[1].split(":")[1], 16) == port}


def test_it_listens_on_this_machine_alone_unless_told(server: RunningServer, witness: Witness) -> None:
    loopback = socket.inet_aton("127.0.0.1")[::-1].hex().upper()
    assert {address[-8:] for address in _listening(server.port)} == {loopback}
    running = start_server(witness, host="0.0.0.0")
    try:
        assert {address[-8:] for address in _listening(running.port)} == {"0" * 8}
    finally:
        running.stop()


@pytest.mark.parametrize(
    ("peer", "here"),
    [
        ("ipv4:127.0.0.1:5", True), ("ipv6:[::1]:5", True), ("ipv6:%5B::1%5D:5", True), ("unix:/run/x", True),
        ("ipv4:10.0.0.7:5", False), ("ipv4:12.7.0.0:5", False), ("ipv6:[fe80::1]:5", False),
    ],
)  # fmt: skip
def test_shared_memory_is_for_this_machine(server: RunningServer, peer: str, here: bool) -> None:
    assert server._service._shares(SimpleNamespace(peer=lambda: peer)) is here


def test_any_name_makes_an_address(witness: Witness, frames: FrameBatch) -> None:
    running = start_server(witness, name="a/b c?d")
    try:
        assert running.address.endswith("/a%2Fb%20c%3Fd")
        remote = open_predictor(running.address)
        assert remote.name == "a/b c?d"
        assert remote.predict(frames).joints_3d.shape[0] == 3
    finally:
        running.stop()


def test_a_port_is_had_once(server: RunningServer, witness: Witness) -> None:
    with pytest.raises(RemoteError, match="cannot listen") as caught:
        start_server(witness, port=server.port)
    assert "--port" in str(caught.value.hint)


# --------------------------------------------------------------------------------------------------- shared memory


@pytest.fixture
def file() -> Any:
    path = SHM / f"of-a-test-{os.getpid()}"
    path.write_bytes(bytes(100))
    yield path
    path.unlink(missing_ok=True)


def _register(stub: Any, key: str, size: int = 100, offset: int = 0, name: str = "r") -> None:
    stub.SystemSharedMemoryRegister(
        service_pb2.SystemSharedMemoryRegisterRequest(name=name, key=key, byte_size=size, offset=offset)
    )


def test_regions_are_held_to_what_they_are(stub: Any, file: Path) -> None:
    link = SHM / f"{file.name}-link"
    link.symlink_to("/etc/passwd")
    folder = SHM / f"{file.name}-folder"
    folder.mkdir()
    try:
        for key, size, offset in (
            ("/../../etc/passwd", 100, 0), ("/etc/passwd", 100, 0), ("..", 1, 0), ("", 1, 0), (f"/{link.name}", 100, 0),
            (f"/{folder.name}", 1, 0), (f"/{file.name}", 101, 0), (f"/{file.name}", 100, 1), (f"/{file.name}", 0, 0),
            (f"/{file.name}", 2**63, 2**63), ("/there-is-none", 1, 0),
        ):  # fmt: skip
            with pytest.raises(grpc.RpcError) as caught:
                _register(stub, key, size, offset)
            assert caught.value.code() is grpc.StatusCode.INVALID_ARGUMENT, key
    finally:
        link.unlink()
        folder.rmdir()
    if os.geteuid() == 0:
        os.chown(file, 12345, -1)
        with pytest.raises(grpc.RpcError, match="of another user"):
            _register(stub, f"/{file.name}")
        os.chown(file, 0, -1)
    assert not stub.SystemSharedMemoryStatus(service_pb2.SystemSharedMemoryStatusRequest()).regions
    _register(stub, f"/{file.name}")
    with pytest.raises(grpc.RpcError, match="registered already"):
        _register(stub, f"/{file.name}")


def test_regions_are_bounded_in_number(stub: Any, file: Path) -> None:
    for i in range(64):
        _register(stub, f"/{file.name}", name=str(i))
    with pytest.raises(grpc.RpcError, match="no more can be"):
        _register(stub, f"/{file.name}", name="one more")
    stub.SystemSharedMemoryUnregister(service_pb2.SystemSharedMemoryUnregisterRequest(name=""))
    _register(stub, f"/{file.name}", name="one more")


@pytest.mark.parametrize(("offset", "length"), [(1, 12288), (-1, 12288), (2**62, 12288), (0, 12287), (0, -1)])
def test_reading_stays_within_a_region(stub: Any, file: Path, offset: int, length: int) -> None:
    file.write_bytes(bytes(12288))
    _register(stub, f"/{file.name}", 12288)
    request = _request()
    del request.raw_input_contents[0]
    parameters = request.inputs[0].parameters
    parameters["shared_memory_region"].string_param = "r"
    parameters["shared_memory_offset"].int64_param = 0
    parameters["shared_memory_byte_size"].int64_param = 12288
    assert stub.ModelInfer(request).id == "7"
    parameters["shared_memory_offset"].int64_param, parameters["shared_memory_byte_size"].int64_param = offset, length
    with pytest.raises(grpc.RpcError, match=r"beyond the region|cannot be"):
        stub.ModelInfer(request)


def test_a_region_that_is_cut_short_ends_no_server(stub: Any, file: Path) -> None:
    file.write_bytes(bytes(12288))
    _register(stub, f"/{file.name}", 12288)
    request = _request()
    del request.raw_input_contents[0]
    request.inputs[0].parameters["shared_memory_region"].string_param = "r"
    request.inputs[0].parameters["shared_memory_byte_size"].int64_param = 12288
    os.truncate(file, 5000)
    with pytest.raises(grpc.RpcError, match="cut short"):
        stub.ModelInfer(request)
    assert stub.ModelInfer(_request()).id == "7"


def test_regions_of_clients_that_were_killed_go_away(server: RunningServer, stub: Any, process: Callable[..., Any]) -> None:
    code = f"""
import time
import numpy as np
from cabinpose.estimate.remote import open_predictor
from cabinpose.estimate.remote.regions import FrameRegion
kept = FrameRegion(10)
remote = open_predictor({server.address!r})
print(kept.name, remote._region.name, flush=True)
time.sleep(60)
"""
    client = process("-c", code)
    named, registered = client.stdout.readline().split()
    status = service_pb2.SystemSharedMemoryStatusRequest()
    assert (SHM / named).exists()
    assert not (SHM / registered).exists()
    assert list(stub.SystemSharedMemoryStatus(status).regions) == [registered]
    client.kill()
    client.wait()
    assert list(stub.SystemSharedMemoryStatus(status).regions) == []
    remote = open_predictor(server.address)
    assert not (SHM / named).exists()
    assert list(stub.SystemSharedMemoryStatus(status).regions) == [remote._region.name]
    remote.close()
    assert list(stub.SystemSharedMemoryStatus(status).regions) == []
    assert not list(SHM.glob("cabinpose-*"))


def test_shared_memory_can_be_turned_off(frames: FrameBatch, witness: Witness) -> None:
    running = start_server(witness, shared_memory=False)
    try:
        remote = open_predictor(running.address)
        assert same(witness.predict(frames), remote.predict(frames))
        assert remote._region is None
        with triton.InferenceServerClient(f"127.0.0.1:{running.port}") as client:
            assert "system_shared_memory" not in client.get_server_metadata().extensions
            with pytest.raises(InferenceServerException, match="clients on this machine"):
                client.register_system_shared_memory("a", "/a", 10)
    finally:
        running.stop()

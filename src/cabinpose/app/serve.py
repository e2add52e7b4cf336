"""A detector as a server of the Open Inference Protocol v2 over gRPC. Needs the extra `remote`."""

from __future__ import annotations

import threading
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Any, cast
from urllib.parse import quote

import grpc
import numpy as np
from tritonclient.grpc import service_pb2, service_pb2_grpc

import cabinpose
from cabinpose.core import POSE_ARRAYS, CabinposeError, FrameBatch, Predictor, RemoteError, images_of
from cabinpose.estimate import JointPredictor
from cabinpose.estimate.remote import (
    EXTENSION,
    INPUTS,
    OUTPUTS,
    PLATFORM,
    SENTENCES,
    VERSION,
    Arrays,
    ServerRegions,
    TensorError,
    TensorSpec,
    add_tensors,
    pack,
    read_tensors,
)

_MODEL_VERSION = "1"
_THREADS, _MOST_CALLS = 4, 16  # calls that wait cost memory, a frame each
_MOST_PX = 1e9  # of a camera's numbers, which float32 holds with their products
_LONGEST_WAIT_S = 600.0  # of a call without a deadline, for its turn
_SWEEP_S = 5.0


class _Service(service_pb2_grpc.GRPCInferenceServiceServicer):
    """One model. Frames go through it one after the other, whoever sends them."""

    def __init__(self, predictor: Predictor, name: str, *, shared_memory: bool) -> None:
        self.answered = self.refused = 0
        self.regions = ServerRegions()
        self._predictor, self._name, self._shared_memory = predictor, name, shared_memory
        self._turn = threading.Lock()
        reads = {"depth", "camera_k", "camera_dist", *images_of(predictor)}
        if not isinstance(predictor, JointPredictor):
            reads.add("amplitude")
        self._inputs = tuple(spec for spec in INPUTS if spec.name in reads)
        self._names = {
            "person_names": np.array(predictor.persons, object), "joint_names": np.array(predictor.joints, object)
        }  # fmt: skip

    def ServerLive(self, request: Any, context: grpc.ServicerContext) -> Any:  # noqa: ARG002, N802 - gRPC's names
        return service_pb2.ServerLiveResponse(live=True)

    def ServerReady(self, request: Any, context: grpc.ServicerContext) -> Any:  # noqa: ARG002, N802
        return service_pb2.ServerReadyResponse(ready=True)

    def ServerMetadata(self, request: Any, context: grpc.ServicerContext) -> Any:  # noqa: ARG002, N802
        extensions = [EXTENSION] if self._shares(context) else []
        return service_pb2.ServerMetadataResponse(name="cabinpose", version=cabinpose.__version__, extensions=extensions)

    def ModelReady(self, request: Any, context: grpc.ServicerContext) -> Any:  # noqa: ARG002, N802
        known = request.name == self._name and request.version in ("", _MODEL_VERSION)
        return service_pb2.ModelReadyResponse(ready=known)

    def ModelMetadata(self, request: Any, context: grpc.ServicerContext) -> Any:  # noqa: N802
        self._check_model(request.name, request.version, context)
        response = service_pb2.ModelMetadataResponse(name=self._name, versions=[_MODEL_VERSION], platform=f"{PLATFORM}{VERSION}")
        sizes = {"P": len(self._predictor.persons), "J": len(self._predictor.joints)}
        for tensors, table in ((response.inputs, self._inputs), (response.outputs, OUTPUTS)):
            for spec in table:
                shape = [n if isinstance(n, int) else sizes.get(n, -1) for n in spec.shape]
                tensors.add(name=spec.name, datatype=spec.datatype, shape=shape)
        return response

    def ModelInfer(self, request: Any, context: grpc.ServicerContext) -> Any:  # noqa: N802
        self._check_model(request.model_name, request.model_version, context)
        read = self.regions.read if self._shares(context) else None
        response = service_pb2.ModelInferResponse(model_name=self._name, model_version=_MODEL_VERSION, id=request.id)
        try:
            tensors = read_tensors(request.inputs, request.raw_input_contents, self._inputs, read=read)
            self._put(response, self._answer(_frames(tensors, self._predictor), context), request.outputs)
        except TensorError as error:
            self._refuse(context, str(error))
        except CabinposeError as error:
            self._refuse(context, error.in_one_line())
        self.answered += 1
        return response

    def SystemSharedMemoryRegister(self, request: Any, context: grpc.ServicerContext) -> Any:  # noqa: N802
        self._check_shares(context)
        try:
            self.regions.register(request.name, request.key, request.offset, request.byte_size)
        except TensorError as error:
            self._refuse(context, str(error))
        return service_pb2.SystemSharedMemoryRegisterResponse()

    def SystemSharedMemoryUnregister(self, request: Any, context: grpc.ServicerContext) -> Any:  # noqa: N802
        self._check_shares(context)
        self.regions.unregister(request.name)
        return service_pb2.SystemSharedMemoryUnregisterResponse()

    def SystemSharedMemoryStatus(self, request: Any, context: grpc.ServicerContext) -> Any:  # noqa: N802
        self._check_shares(context)
        response = service_pb2.SystemSharedMemoryStatusResponse()
        for name, region in self.regions.status().items():
            if request.name in ("", name):
                status = response.regions[name]
                status.name, status.key, status.offset, status.byte_size = name, region.key, region.offset, region.byte_size
        return response

    def _answer(self, frames: FrameBatch, context: grpc.ServicerContext) -> Arrays:
        """The outputs by name. Waits for its turn at most as long as the caller waits for the answer."""
        left = context.time_remaining()
        if not self._turn.acquire(timeout=min(_LONGEST_WAIT_S if left is None else max(left, 0.0), _LONGEST_WAIT_S)):
            context.abort(grpc.StatusCode.DEADLINE_EXCEEDED, "the model was busy with other frames until the deadline")
        try:
            with np.errstate(all="ignore"):  # of whatever depths a caller sends; what comes of them is not finite
                found = self._predictor.predict(frames)
        finally:
            self._turn.release()
        remarks = np.array(found.remarks or ("",), object)
        return {name: getattr(found, name) for name in (*POSE_ARRAYS, "reason")} | {"remarks": remarks} | self._names

    def _put(self, response: Any, answer: Arrays, asked: Sequence[Any]) -> None:
        """The outputs that were asked for, or all but the sentences, into the response or into shared memory."""
        wanted = {output.name: output.parameters for output in asked}
        if unknown := wanted.keys() - answer.keys():
            raise TensorError(f"there is no output {min(unknown)[:64]!r}; known: {', '.join(answer)}")
        for spec in OUTPUTS:
            parameters = wanted.get(spec.name, {})
            if "shared_memory_region" in parameters:
                self._share(response, answer, spec, parameters)
            elif spec.name in wanted or (not wanted and spec.name not in SENTENCES):
                add_tensors(response.outputs, response.raw_output_contents, answer, [spec])

    def _share(self, response: Any, answer: Arrays, spec: TensorSpec, parameters: Any) -> None:
        """One output into shared memory."""
        region, offset = parameters["shared_memory_region"].string_param, parameters["shared_memory_offset"].int64_param
        data, room = pack(answer[spec.name], spec), parameters["shared_memory_byte_size"].int64_param
        if len(data) > room:
            raise TensorError(f"{spec.name} has {len(data)} bytes, more than the {room} of shared memory that are given")
        self.regions.write(region, offset, data)
        response.raw_output_contents.append(b"")  # Triton's clients count one for every output
        tensor = response.outputs.add(name=spec.name, datatype=spec.datatype, shape=answer[spec.name].shape)
        tensor.parameters["shared_memory_region"].string_param = region
        tensor.parameters["shared_memory_offset"].int64_param = offset
        tensor.parameters["shared_memory_byte_size"].int64_param = len(data)

    def _check_model(self, name: str, version: str, context: grpc.ServicerContext) -> None:
        if name != self._name or version not in ("", _MODEL_VERSION):
            context.abort(grpc.StatusCode.NOT_FOUND, f"there is no such model; this server has {self._name}")

    def _shares(self, context: grpc.ServicerContext) -> bool:
        """Whether the caller may use shared memory: it has to be on this machine."""
        return self._shared_memory and context.peer().startswith(("ipv4:127.", "ipv6:[::1]", "ipv6:%5B::1%5D", "unix:"))

    def _check_shares(self, context: grpc.ServicerContext) -> None:
        if not self._shares(context):
            context.abort(grpc.StatusCode.UNIMPLEMENTED, "shared memory is for clients on this machine, where it is on")

    def _refuse(self, context: grpc.ServicerContext, message: str) -> None:
        self.refused += 1
        context.abort(grpc.StatusCode.INVALID_ARGUMENT, message)


def _frames(tensors: Arrays, predictor: Predictor) -> FrameBatch:
    """A request's tensors as frames of a camera. Raises TensorError for what is missing, and cameras that are none."""
    for spec in INPUTS:  # our models say in their own words that they read amplitudes
        if spec.name not in tensors and (spec.required or (spec.name in images_of(predictor) and spec.name != "amplitude")):
            raise TensorError(f"{spec.name} is missing")
    k = tensors["camera_k"]
    frames = {"camera_dist": np.zeros((len(k), 5))} | dict(tensors)
    if not all((np.abs(values) < _MOST_PX).all() for values in (k, frames["camera_dist"])):  # False for NaN
        raise TensorError(f"camera_k or camera_dist is of no camera: values that are not finite, or beyond {_MOST_PX:g}")
    return cast("FrameBatch", frames)


@dataclass(frozen=True)
class RunningServer:
    """A server that answers calls. address: what `--model` takes."""

    address: str
    port: int
    _server: grpc.Server
    _service: _Service

    @property
    def counts(self) -> dict[str, int]:
        """Requests so far: answered and refused."""
        return {"answered": self._service.answered, "refused": self._service.refused}

    def wait(self, seconds: float | None = None) -> None:
        """Serve for so long, or until the process is interrupted."""
        left = float("inf") if seconds is None else seconds
        while left > 0 and self._server.wait_for_termination(timeout=min(left, _SWEEP_S)):
            left -= _SWEEP_S
            self._service.regions.sweep()

    def stop(self) -> None:
        """Stop; calls that are under way get a second to end."""
        self._server.stop(grace=1.0).wait()
        self._service.regions.unregister("")


def start_server(
    predictor: Predictor,
    *,
    name: str | None = None,
    host: str = "127.0.0.1",
    port: int = 0,
    max_message_bytes: int = 64 << 20,
    shared_memory: bool = True,
) -> RunningServer:
    """Serve a detector.

    Parameters
    ----------
    predictor
        The detector; it gets the frames of one request at a time.
    name
        The model's name on the wire; default: the predictor's.
    host, port
        Where to listen; port 0 takes a free one. There is neither encryption nor a password.
    max_message_bytes
        Greatest message that is taken, and sent.
    shared_memory
        Whether clients on this machine may hand frames over in shared memory.

    Returns
    -------
    RunningServer
        It answers already.

    Raises
    ------
    RemoteError
        Where the port cannot be had.
    """
    service = _Service(predictor, name or predictor.name, shared_memory=shared_memory)
    server = grpc.server(
        ThreadPoolExecutor(_THREADS, thread_name_prefix="serve"),
        maximum_concurrent_rpcs=_MOST_CALLS,
        options=[
            ("grpc.max_receive_message_length", max_message_bytes),
            ("grpc.max_send_message_length", max_message_bytes),
            ("grpc.so_reuseport", 0),  # two servers on one port would share the calls
        ],
    )
    service_pb2_grpc.add_GRPCInferenceServiceServicer_to_server(service, server)
    where = f"[{host}]" if ":" in host else host
    try:
        bound = server.add_insecure_port(f"{where}:{port}")
    except RuntimeError:
        hint = "another --port, or 0 for a free one; --host is an address of this machine"
        raise RemoteError(f"cannot listen on {where}:{port}", hint=hint) from None
    server.start()
    return RunningServer(f"grpc://{where}:{bound}/{quote(name or predictor.name, safe='')}", bound, server, service)

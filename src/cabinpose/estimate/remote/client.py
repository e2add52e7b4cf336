"""A detector on a server, as a predictor."""

from __future__ import annotations

import ipaddress
import warnings
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import Any, Literal, NoReturn, cast
from urllib.parse import parse_qsl, unquote, urlsplit

import grpc
import numpy as np
from numpy.typing import NDArray
from tritonclient.grpc import service_pb2, service_pb2_grpc

from cabinpose.core import (
    IMAGES,
    ConfigError,
    FrameBatch,
    PoseBatch,
    RemoteError,
    joined,
    skeleton_with,
    unknown_name,
    without_numbers,
)
from cabinpose.estimate.onnx_model import cameras_of, image_in
from cabinpose.estimate.remote.messages import add_tensors, read_tensors
from cabinpose.estimate.remote.regions import EXTENSION, FrameRegion
from cabinpose.estimate.remote.tensors import (
    DTYPES,
    INPUTS,
    MOST,
    OUTPUTS,
    PLATFORM,
    SENTENCES,
    USUAL,
    VERSION,
    Arrays,
    TensorError,
    pose_batch,
)
from cabinpose.store import empty_batch

_LOOK_S = 5.0  # for the server's metadata; a server that is just starting is waited for as long
_FIRST_ANSWER_S = 60.0  # networks are loaded and compiled at the first frame
_TOLD = 20  # frames without an answer that are told one by one
_TEXT = 300  # characters of a server's own words
_USUAL_SIZE = (287, 352)
_RECONNECT_MS = 100
_AWAY = (grpc.StatusCode.DEADLINE_EXCEEDED, grpc.StatusCode.UNAVAILABLE)
_NAMES = {"persons": "person_names", "joints": "joint_names"}  # keys of an address, and the tensors that they stand for
_KEYS = ("timeout_s", "on_error", "images", "persons", "joints", "shared_memory", "max_message_mb")


@dataclass(frozen=True)
class Address:
    """Where a model is served, and how it is to be asked; see `parse`."""

    target: str
    model: str
    host: str
    timeout_s: float = 5.0
    on_error: Literal["stop", "skip"] = "stop"
    persons: tuple[str, ...] = ()
    joints: tuple[str, ...] = ()
    shared_memory: bool = True
    max_message_mb: float = 64.0
    images: tuple[str, ...] = ()

    @classmethod
    def parse(cls, text: str) -> Address:
        """`grpc://HOST:PORT/MODEL?key=value&...` with the keys timeout_s, on_error (stop, skip), images, persons and joints
        (names with commas), shared_memory (on, off), max_message_mb. Raises ConfigError.
        """
        try:
            url = urlsplit(text)
            host, port = url.hostname, url.port
        except ValueError as error:
            raise ConfigError(f"{text} is no address of a model: {error}", hint="write grpc://HOST:PORT/MODEL") from None
        model = url.path.removeprefix("/")
        if url.scheme != "grpc" or not host or port is None or not model or "/" in model or url.username or url.fragment:
            raise ConfigError(f"{text} is no address of a model", hint="write grpc://HOST:PORT/MODEL")
        pairs = parse_qsl(url.query, keep_blank_values=True)
        given = dict(pairs)
        if len(given) < len(pairs):
            raise ConfigError(f"{text} sets a key twice", hint="set each key once, with commas between names")
        if unknown := sorted(given.keys() - set(_KEYS)):
            raise unknown_name("key of a model's address", unknown[0], _KEYS)
        for key, allowed in (("on_error", ("stop", "skip")), ("shared_memory", ("on", "off"))):
            if given.get(key, allowed[0]) not in allowed:
                raise ConfigError(f"{key} cannot be '{given[key]}'", hint=f"{key} is {' or '.join(allowed)}")
        settings: dict[str, Any] = {key: given[key] for key in ("on_error",) if key in given}
        for key, most in (("timeout_s", 10_000.0), ("max_message_mb", 2047.0)):  # beyond which gRPC counts no bytes
            if key in given:
                settings[key] = _positive(key, given[key], most)
        for key in ("images", "persons", "joints"):
            settings[key] = names = tuple(name for name in given.get(key, "").split(",") if name)
            if key != "images" and len({*names}) < len(names):
                raise ConfigError(f"{key}={given[key]} names one of them twice", hint="name each once, in the tensors' order")
        check_images(settings["images"])
        where = f"[{host}]" if ":" in host else host
        return cls(f"{where}:{port}", unquote(model), host, shared_memory=given.get("shared_memory") != "off", **settings)


def check_images(names: Sequence[str]) -> None:
    """Raise ConfigError for a name that is none of an image, or one that is there twice."""
    for name in names:
        if name not in IMAGES:
            raise unknown_name("image", name, IMAGES)
        if list(names).count(name) > 1:
            raise ConfigError(f"the image {name} is named twice", hint="name each image once")


def _positive(key: str, text: str, most: float) -> float:
    with suppress(ValueError):
        if 0 < (value := float(text)) <= most:
            return value
    raise ConfigError(f"{key} cannot be '{text}'", hint=f"{key} is a number above 0, up to {most:g}")


class RemotePredictor:
    """A detector that a server of the Open Inference Protocol offers; fulfils `core.ports.Predictor`.

    One frame a request, its number as the request's id. `images` are those that it does not work without. `failed` counts frames
    without an answer, where the address says that the run shall go on (`on_error=skip`); they are told by warnings.
    """

    def __init__(self, address: str, images: Sequence[str] = ()) -> None:
        """Connect, look at the model's tensors and, where the address does not name persons and joints, ask for one empty frame.

        Parameters
        ----------
        address
            What `Address.parse` takes.
        images
            The images that the model is given, of `IMAGES`; default: those of the address, or that the server lists.

        Raises
        ------
        ConfigError
            For an address that is none, or an image that there is not.
        RemoteError
            Where there is no server, no such model, or one with other tensors.
        """
        check_images(images)
        self._address = Address.parse(address)
        if images:
            self._address = replace(self._address, images=tuple(images))
        self.name = self._address.model
        self.failed = 0
        self._remarked: set[str] = set()  # without their numbers
        self._label = f"grpc://{self._address.target}/{self.name}"
        most = int(self._address.max_message_mb * 2**20)
        self._channel = grpc.insecure_channel(
            self._address.target,
            options=[
                ("grpc.max_send_message_length", most),
                ("grpc.max_receive_message_length", most),
                ("grpc.enable_http_proxy", 0),
                ("grpc.initial_reconnect_backoff_ms", _RECONNECT_MS),
                ("grpc.min_reconnect_backoff_ms", _RECONNECT_MS),
                ("grpc.max_reconnect_backoff_ms", 10 * _RECONNECT_MS),
            ],
        )
        self._stub = service_pb2_grpc.GRPCInferenceServiceStub(self._channel)
        self._region: FrameRegion | None = None
        self._asked = False
        try:
            size = self._look()
            self._shares = self._address.shared_memory and _is_loopback(self._address.host) and self._offers_regions()
            self.persons, self.joints = self._address.persons, self._address.joints
            if not (self.persons and self.joints):
                self._ask_names(size)
        except RemoteError:
            self.close()
            raise
        self.skeleton = skeleton_with(self.joints).name

    def predict(self, frames: FrameBatch) -> PoseBatch:
        """The joints of N frames, in their order.

        Raises
        ------
        RemoteError
            With the number of the frame, where the server gives no answer in time, or none that makes sense. With
            `on_error=skip` such a frame has no joints instead.
        """
        count = len(image_in(frames))
        found = joined([empty_batch(0, len(self.persons), len(self.joints)), *(self._one(frames, i) for i in range(count))])
        for remark in found.remarks:
            if (kind := without_numbers(remark)) not in self._remarked:
                self._remarked.add(kind)
                warnings.warn(f"{self._label}: {remark}", stacklevel=2)
        return found

    def close(self) -> None:
        """End the connection; harmless if there is none."""
        self._drop_region(tell=True)
        self._channel.close()

    def _one(self, frames: FrameBatch, index: int) -> PoseBatch:
        number = int(frames["frame"][index]) if "frame" in frames else index
        stamp = int(frames["sync_ns"][index]) if "sync_ns" in frames else None
        try:
            arrays = self._inputs(frames, index)
            answer = self._infer(arrays, number, stamp)
            return self._completed(self._poses(answer), frames, index)
        except (RemoteError, TensorError) as error:
            message = f"{self._label}: frame {number}: {str(error).removeprefix(f'{self._label}: ')}"
            if self._address.on_error == "stop":
                hint = "on_error=skip behind the address (grpc://...?on_error=skip) goes on without such frames"
                raise RemoteError(message, hint=hint) from error
        self.failed += 1
        if self.failed <= _TOLD:
            last = "; further ones are only counted" if self.failed == _TOLD else ""
            warnings.warn(f"{message}; it has no joints{last}", stacklevel=3)
        return empty_batch(1, len(self.persons), len(self.joints))

    def _inputs(self, frames: FrameBatch, index: int) -> dict[str, NDArray[Any]]:
        """The tensors of one frame that the server takes."""
        one, arrays = slice(index, index + 1), dict[str, NDArray[Any]]()
        for spec in self._takes:
            image = "cloud" if spec.name == "points" else spec.name
            values: NDArray[Any] | None = frames.get(image)  # type: ignore[assignment]
            if values is None and image == "cloud" and "depth" in frames:
                depth = np.ascontiguousarray(frames["depth"][one], np.float32)
                arrays[spec.name] = cameras_of(frames, one)[0].points(depth).astype(np.float32)
                continue
            if values is None:
                if image in self.images:
                    raise TensorError(f"it has no {image}")
                continue
            of_one_camera = values.ndim == {"camera_k": 2, "camera_dist": 1}.get(spec.name)
            values = values[None] if of_one_camera else values[one]
            if spec.name == "amplitude" and values.dtype != np.uint16:
                values = np.clip(np.rint(np.nan_to_num(values)), 0, np.iinfo(np.uint16).max)
            arrays[spec.name] = np.ascontiguousarray(values, DTYPES[spec.datatype])
        return arrays

    def _poses(self, answer: Arrays) -> PoseBatch:
        """The joints of an answer. Raises TensorError where it is of several frames, or of others than the first answer was."""
        for key, tensor in _NAMES.items():
            given, known = tuple(answer.get(tensor, ())), getattr(self, key)
            if given and not getattr(self._address, key) and given != known:
                raise TensorError(f"its {key} are {', '.join(given)}, and were {', '.join(known)}")
        found = pose_batch(answer, self.persons, self.joints)
        if len(found.score) != 1:
            raise TensorError(f"the answer is of {len(found.score)} frames, not of one")
        return found

    def _completed(self, found: PoseBatch, frames: FrameBatch, index: int) -> PoseBatch:
        """An answer in 3D alone gets its 2D by projection."""
        if not np.isnan(found.joints_2d).all() or np.isnan(found.joints_3d).all():
            return found
        uv = cameras_of(frames, slice(index, index + 1))[0].project(found.joints_3d).astype(np.float32)
        return replace(found, joints_2d=uv)

    # ------------------------------------------------------------------------------------------------- what there is

    def _look(self) -> tuple[int, int]:
        """Check and choose the model's tensors, and return the size (height, width) of frames that it wants, or the usual one."""
        request = service_pb2.ModelMetadataRequest(name=self._address.model)
        metadata = self._call(self._stub.ModelMetadata, request, _LOOK_S, wait_for_ready=True)
        spoken = metadata.platform.removeprefix(PLATFORM)
        if metadata.platform.startswith(PLATFORM) and spoken != str(VERSION):
            self._fail(f"speaks version {spoken[:8]} of the tensors, this program version {VERSION}", "upgrade the older one")
        known = {spec.name: spec for spec in INPUTS}
        for tensor in metadata.inputs:
            if tensor.name not in known:
                hint = f"inputs are {', '.join(known)}; docs/algorithms.md has their shapes"
                self._fail(f"wants an input {tensor.name[:64]!r} that there is not", hint)
        self._choose([tensor.name for tensor in metadata.inputs])
        listed = {tensor.name for tensor in metadata.outputs}
        # Who names no outputs is given all but the sentences: programmes from before them know none.
        self._asks = [spec.name for spec in OUTPUTS if spec.name in listed] if listed & {*SENTENCES} else []
        for tensor in metadata.inputs:
            if "H" in known[tensor.name].shape and len(tensor.shape) >= 3 and all(0 < n <= MOST["H"] for n in tensor.shape[1:3]):
                return int(tensor.shape[1]), int(tensor.shape[2])
        return _USUAL_SIZE

    def _choose(self, listed: Sequence[str]) -> None:
        """Which tensors the server gets, and which images it does not work without, of those that its metadata lists, if any."""
        chosen = self._address.images
        theirs = {"points" if name == "cloud" and "points" in listed and name not in listed else name for name in chosen}
        if listed and (refused := sorted(theirs - {*listed})):
            self._fail(f"takes no {', '.join(refused)}", f"its inputs are {', '.join(listed)}")
        takes = theirs | {name for name in listed or USUAL if name.startswith("camera_")} if chosen else {*(listed or USUAL)}
        self._takes = tuple(spec for spec in INPUTS if spec.name in takes)
        images = {"cloud" if name == "points" else name for name in takes}
        # Amplitude is sent where the camera has it, unless it was asked for.
        self.images = tuple(name for name in IMAGES if name in images and (name in chosen or name != "amplitude"))

    def _offers_regions(self) -> bool:
        try:
            metadata = self._call(self._stub.ServerMetadata, service_pb2.ServerMetadataRequest(), _LOOK_S)
        except RemoteError:  # a server need not have this call
            return False
        return EXTENSION in metadata.extensions

    def _ask_names(self, size: tuple[int, int]) -> None:
        """Learn persons and joints from the answer to a frame in which nothing is seen."""
        k = np.array([[size[1] / 2, 0, (size[1] - 1) / 2], [0, size[1] / 2, (size[0] - 1) / 2], [0, 0, 1]])
        sizes = {"N": 1, "H": size[0], "W": size[1]}
        blank: dict[str, NDArray[Any]] = {}
        for spec in INPUTS:
            dtype = DTYPES[spec.datatype]
            shape = [n if isinstance(n, int) else sizes[n] for n in spec.shape]
            blank[spec.name] = np.full(shape, np.nan if dtype.kind == "f" else 0, dtype)
        empty = cast("FrameBatch", blank | {"camera_k": k, "camera_dist": np.zeros(5)})
        try:
            answer = self._infer(self._inputs(empty, 0), None, None)
            for key, tensor in _NAMES.items():
                given = tuple(answer.get(tensor, ()))
                if not given and not getattr(self, key):
                    self._fail(f"does not name its {key}", f"name them behind the address: ?{key}=... with commas between")
                setattr(self, key, getattr(self, key) or given)
            self._poses(answer)
        except TensorError as error:
            self._fail(f"answers an empty frame wrongly: {error}", "docs/algorithms.md has the tensors")

    # ------------------------------------------------------------------------------------------------------- asking

    def _infer(self, arrays: Arrays, number: int | None, stamp: int | None) -> dict[str, NDArray[Any]]:
        """The outputs by name. Raises RemoteError and TensorError."""
        timeout = self._address.timeout_s if self._asked else max(_FIRST_ANSWER_S, self._address.timeout_s)
        self._asked = True
        ident = "empty" if number is None else str(number)
        request = service_pb2.ModelInferRequest(model_name=self._address.model, id=ident)
        if number is not None:
            request.parameters["frame"].int64_param = number
        if stamp is not None:
            request.parameters["sync_ns"].int64_param = stamp
        for name in self._asks:
            request.outputs.add(name=name)
        shared = self._shared(request, arrays) if self._shares else False
        if not shared:
            add_tensors(request.inputs, request.raw_input_contents, arrays, INPUTS)
        try:
            response = self._call(self._stub.ModelInfer, request, timeout)
        except RemoteError as error:
            # A server that was started anew does not know it; one that failed otherwise would keep it.
            self._drop_region(tell=_code(error) not in _AWAY)
            if not shared or _code(error) in _AWAY:
                raise
            request.ClearField("inputs")
            add_tensors(request.inputs, request.raw_input_contents, arrays, INPUTS)
            response = self._call(self._stub.ModelInfer, request, timeout)
        if response.id not in ("", ident):
            raise TensorError(f"the answer is that of frame {response.id[:32]!r}")
        return read_tensors(response.outputs, response.raw_output_contents, OUTPUTS)

    def _call(self, method: Any, request: Any, timeout: float, *, wait_for_ready: bool = False) -> Any:
        """The response to one call. Raises RemoteError in the words of the code."""
        try:
            return method(request, timeout=timeout, wait_for_ready=wait_for_ready)
        except grpc.RpcError as error:
            code, details = error.code(), " ".join(str(error.details()).split())[:_TEXT]
            if code is grpc.StatusCode.DEADLINE_EXCEEDED:
                said = "no server was found" if wait_for_ready else "there was no answer"
                message = f"{said} within {timeout:g} s"
            elif code is grpc.StatusCode.UNAVAILABLE:
                message = f"the server cannot be reached ({details})"
            else:
                message = f"the server says {code.name}: {details}"
                if code is grpc.StatusCode.RESOURCE_EXHAUSTED:
                    message += " (the limit of this side is max_message_mb behind the address)"
            hint = "is the server running, and is that its address?" if code in _AWAY else "see what the server prints"
            raise RemoteError(f"{self._label}: {message}", hint=hint) from error

    def _fail(self, message: str, hint: str) -> NoReturn:
        raise RemoteError(f"{self._label}: the model {message}", hint=hint)

    # ------------------------------------------------------------------------------------------------ shared memory

    def _shared(self, request: Any, arrays: Arrays) -> bool:
        """Put the inputs into shared memory and their places into the request; False where that does not work."""
        needed = sum(array.nbytes for array in arrays.values())
        if self._region is None or self._region.byte_size < needed:
            self._drop_region(tell=True)
            self._region = self._registered(needed)
        if self._region is None:
            self._shares = False  # it was offered and does not work: the frames go over the wire from now on
            return False
        shown = [(spec, arrays[spec.name]) for spec in INPUTS if spec.name in arrays]
        for (spec, array), offset in zip(shown, self._region.write([a for _, a in shown]), strict=True):
            tensor = request.inputs.add(name=spec.name, datatype=spec.datatype, shape=array.shape)
            tensor.parameters["shared_memory_region"].string_param = self._region.name
            tensor.parameters["shared_memory_offset"].int64_param = offset
            tensor.parameters["shared_memory_byte_size"].int64_param = array.nbytes
        return True

    def _registered(self, byte_size: int) -> FrameRegion | None:
        try:
            region = FrameRegion(byte_size)
        except OSError:  # no /dev/shm, or none left of it
            return None
        request = service_pb2.SystemSharedMemoryRegisterRequest(name=region.name, key=region.key, byte_size=byte_size)
        try:
            self._call(self._stub.SystemSharedMemoryRegister, request, _LOOK_S)
        except RemoteError as error:
            region.close()
            if _code(error) in _AWAY:
                raise
            return None
        region.unlink()
        return region

    def _drop_region(self, *, tell: bool) -> None:
        if self._region is None:
            return
        if tell:
            request = service_pb2.SystemSharedMemoryUnregisterRequest(name=self._region.name)
            with suppress(RemoteError):
                self._call(self._stub.SystemSharedMemoryUnregister, request, _LOOK_S)
        self._region.close()
        self._region = None


def _code(error: RemoteError) -> Any:
    cause = error.__cause__
    return cause.code() if isinstance(cause, grpc.RpcError) else None


def _is_loopback(host: str) -> bool:
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return host == "localhost"

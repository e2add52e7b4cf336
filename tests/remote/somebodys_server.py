"""What the tests of models on servers share: a detector that tells what it saw, and somebody's server."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from tritonclient.grpc import service_pb2, service_pb2_grpc

from cabinpose.core.ports import FrameBatch, PoseBatch
from cabinpose.estimate.remote.messages import add_tensors
from cabinpose.estimate.remote.tensors import OUTPUTS, USUAL

SIZE = (48, 64)
PERSONS, JOINTS = ("driver", "front_passenger"), ("head", "lhand", "rhand")


class Witness:
    """A detector whose joints are sums over what it was given, so that every byte counts."""

    name, persons, joints = "witness", PERSONS, JOINTS

    def __init__(self) -> None:
        self.calls: list[dict[str, Any]] = []

    def predict(self, frames: FrameBatch) -> PoseBatch:
        self.calls.append(dict(frames))
        n = len(frames["depth"])
        shape = (n, len(PERSONS), len(JOINTS))
        weights = np.arange(frames["depth"][0].size).reshape(frames["depth"].shape[1:]) % 251
        depth = (np.nan_to_num(frames["depth"]) * weights).sum(axis=(1, 2))
        light = (frames["amplitude"].astype(float) * weights).sum(axis=(1, 2)) if "amplitude" in frames else np.zeros(n)
        camera = np.broadcast_to(frames["camera_k"], (n, 3, 3)).sum(axis=(1, 2)) + np.sum(frames["camera_dist"], axis=-1)
        spread = np.arange(1, 7).reshape(1, 2, 3)
        xyz = np.stack([s[:, None, None] * spread for s in (depth, light, camera)], axis=-1).astype(np.float32)
        certain = np.full(shape, 0.75, np.float32)
        certain[:, 1, 2] = 0
        xyz[:, 1, 2] = np.nan
        return PoseBatch(xyz[..., :2].copy(), xyz, 2 * certain, certain)


def good_answer(request: Any) -> dict[str, Any]:
    """What an algorithm may answer: one person, two joints, one of them not found."""
    n = request.inputs[0].shape[0] if request.inputs else 1
    uv = np.full((n, 1, 2, 2), 20, np.float32)
    xyz = np.full((n, 1, 2, 3), 0.5, np.float32)
    presence = np.ones((n, 1, 2), np.float32)
    uv[:, :, 1], xyz[:, :, 1], presence[:, :, 1] = np.nan, np.nan, 0
    names = {"person_names": np.array(["driver"], object), "joint_names": np.array(["head", "lhand"], object)}
    return {"joints_2d": uv, "joints_3d": xyz, "presence": presence, **names}


class Algorithm(service_pb2_grpc.GRPCInferenceServiceServicer):
    """Somebody's server, which does as little as it may: metadata and answers. `answer` gets every request but the first."""

    def __init__(self, answer: Callable[[Any], Any] = good_answer) -> None:
        self.answer, self.requests = answer, list[Any]()
        self.outputs: Callable[[Any], dict[str, Any]] = good_answer
        self.inputs = [*USUAL, "points"]
        self.platform = ""

    def ModelMetadata(self, request: Any, context: Any) -> Any:  # noqa: N802 - gRPC's name
        response = service_pb2.ModelMetadataResponse(name=request.name, platform=self.platform)
        for name in self.inputs:
            response.inputs.add(name=name, datatype="FP32", shape=[-1])
        return response

    def ModelInfer(self, request: Any, context: Any) -> Any:  # noqa: N802 - gRPC's name
        self.requests.append(request)
        answer = self.answer(request) if len(self.requests) > 1 else good_answer(request)
        return response_of(request, answer) if isinstance(answer, dict) else answer


def response_of(request: Any, answer: dict[str, Any]) -> Any:
    response = service_pb2.ModelInferResponse(model_name=request.model_name, id=request.id)
    add_tensors(response.outputs, response.raw_output_contents, answer, OUTPUTS)
    return response

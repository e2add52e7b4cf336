"""The least algorithm behind MLServer: the point nearest to the camera is the left hand.

python -m venv env && env/bin/pip install mlserver     # an environment of its own
env/bin/mlserver start examples/algorithms/mlserver    # the folder holds model-settings.json and settings.json
cabinpose evaluate my-dataset --model grpc://127.0.0.1:8081/nearest
"""

from __future__ import annotations

import numpy as np
from mlserver import MLModel
from mlserver.codecs import NumpyCodec
from mlserver.types import InferenceRequest, InferenceResponse, ResponseOutput

PERSONS, JOINTS = ["driver"], ["lhand"]


class Nearest(MLModel):
    """What MLServer loads, as model-settings.json says."""

    async def predict(self, payload: InferenceRequest) -> InferenceResponse:
        """One frame's depth and camera in, one joint out."""
        arrays = {tensor.name: NumpyCodec.decode_input(tensor) for tensor in payload.inputs}
        depth, k = arrays["depth"][0], arrays["camera_k"][0]
        joint, presence = np.full(3, np.nan, np.float32), 0.0
        if np.isfinite(depth).any():
            v, u = np.unravel_index(np.nanargmin(depth), depth.shape)
            z = depth[v, u]
            joint, presence = np.array([(u - k[0, 2]) / k[0, 0] * z, (v - k[1, 2]) / k[1, 1] * z, z], np.float32), 1.0
        return InferenceResponse(
            model_name=self.name,
            id=payload.id,
            outputs=[
                # By hand, since NumpyCodec makes None of NaN, which gRPC cannot send, and StringCodec an array of two dimensions.
                ResponseOutput(name="joints_3d", datatype="FP32", shape=[1, 1, 1, 3], data=joint.tolist()),
                ResponseOutput(name="presence", datatype="FP32", shape=[1, 1, 1], data=[presence]),
                ResponseOutput(name="person_names", datatype="BYTES", shape=[1], data=PERSONS),
                ResponseOutput(name="joint_names", datatype="BYTES", shape=[1], data=JOINTS),
            ],
        )

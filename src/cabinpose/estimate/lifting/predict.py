"""Lifting as it runs: 2D joints to 3D, and a predictor whose 3D joints are lifted from its 2D ones."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from cabinpose.core.camera import Camera
from cabinpose.core.errors import ConfigError
from cabinpose.core.ports import FrameBatch, PoseBatch, Predictor
from cabinpose.estimate.onnx_model import OnnxModel, cameras_of


class OnnxLifting(OnnxModel):
    """A lifting network in an ONNX file that `cabinpose export --onnx` wrote."""

    task = "lift"

    def lift(self, directions: NDArray[np.floating]) -> NDArray[np.float64]:
        """Joints (N, J, 3) in the camera frame (m) of N people from directions (N, J, 2): x/z and y/z, NaN where unknown.

        NaN for people of fewer directions than the settings ask for.
        """
        known = np.isfinite(directions).all(axis=-1, keepdims=True)
        pose = np.concatenate((np.where(known, directions, 0.0), known), axis=-1).astype(np.float32)
        joints: NDArray[np.float64] = self.run({"pose": pose})
        return joints


class LiftedPredictor:
    """A predictor of 2D joints whose 3D joints come from lifting; fulfils `core.ports.Predictor`.

    Joints that the lifting network does not know keep the 3D joints of the predictor.
    """

    def __init__(self, base: Predictor, lifting: OnnxLifting) -> None:
        """Raises ConfigError where base and lifting have no joint in common."""
        self._base, self._lifting = base, lifting
        self.name, self.persons, self.joints = f"{base.name}+{lifting.name}", base.persons, base.joints
        self._columns = [(base.joints.index(name), j) for j, name in enumerate(lifting.joints) if name in base.joints]
        if not self._columns:
            raise ConfigError(
                f"{base.name} finds none of the joints that {lifting.name} lifts", hint=f"it lifts {', '.join(lifting.joints)}"
            )

    def predict(self, frames: FrameBatch) -> PoseBatch:
        """The joints of N frames; 3D joints where the base has 2D ones of people with enough of them."""
        found = self._base.predict(frames)
        n, persons = found.joints_2d.shape[:2]
        cameras = cameras_of(frames, slice(0, n))
        theirs, ours = (list(column) for column in zip(*self._columns, strict=True))
        uv = found.joints_2d[:, :, theirs].astype(np.float64)
        directions = np.full((n, persons, len(self._lifting.joints), 2), np.nan)
        for i, camera in enumerate(cameras):
            directions[i][:, ours] = _directions(uv[i], camera)
        believed = found.presence[:, :, theirs, None] >= float(self._lifting.config.presence)
        directions[:, :, ours] = np.where(believed, directions[:, :, ours], np.nan)
        lifted = self._lifting.lift(directions.reshape(n * persons, -1, 2)).reshape(n, persons, -1, 3)
        joints_3d = found.joints_3d.copy()
        answered = np.isfinite(uv).all(axis=-1, keepdims=True)
        joints_3d[:, :, theirs] = np.where(answered, lifted[:, :, ours], np.nan)
        return replace(found, joints_3d=joints_3d)


def _directions(uv: NDArray[np.float64], camera: Camera) -> NDArray[np.float64]:
    """x/z and y/z (..., 2) of pixels (..., 2); NaN for NaN."""
    known = np.isfinite(uv).all(axis=-1, keepdims=True)
    rays = camera.unproject(np.where(known, uv, (camera.cx, camera.cy)), np.ones(uv.shape[:-1]))[..., :2]
    return np.where(known, rays, np.nan)

"""Lifting as it runs: 2D joints to 3D, and a predictor whose 3D joints are lifted from its 2D ones."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from cabinpose.core import Camera, ConfigError, FrameBatch, PoseBatch, Predictor, images_of, told_as
from cabinpose.estimate.onnx_model import TrainedModel, cameras_of
from cabinpose.store import merged_ranges


class Lifter:
    """A trained model that lifts the 2D joints of people to 3D."""

    def __init__(self, model: TrainedModel) -> None:
        """model: of a method whose task is lift."""
        self.model, self.config, self.name, self.joints = model, model.config, model.name, model.joints
        self.trained_on = model.trained_on

    def lift(self, directions: NDArray[np.floating]) -> NDArray[np.float64]:
        """Joints (N, J, 3) in the camera frame (m) of N people from directions (N, J, 2): x/z and y/z, NaN where unknown.

        NaN for people of fewer directions than the settings ask for.
        """
        learnt, meant = self.model.learnt, self.config.joint_set
        directions = told_as(directions, self.joints, meant, learnt)
        known = np.isfinite(directions).all(axis=-1, keepdims=True)
        pose = np.concatenate((np.where(known, directions, 0.0), known), axis=-1).astype(np.float32)
        joints: NDArray[np.float64] = self.model.run({"pose": pose})
        return np.asarray(told_as(joints, self.joints, learnt, meant), np.float64)


class LiftedPredictor:
    """A predictor of 2D joints whose 3D joints come from lifting; fulfils `core.ports.Predictor`.

    Joints that the lifting model does not know keep the 3D joints of the predictor.
    """

    def __init__(self, base: Predictor, lifting: Lifter) -> None:
        """Raises ConfigError where base and lifting have no joint in common."""
        self.base, self._lifting = base, lifting
        self.name, self.persons, self.joints = f"{base.name}+{lifting.name}", base.persons, base.joints
        self.joint_definition = getattr(base, "joint_definition", "")
        self.trained_on = merged_ranges(getattr(base, "trained_on", {}), lifting.trained_on)
        _common(base.joints, lifting, base.name)

    @property
    def images(self) -> tuple[str, ...]:
        """The images that the predictor of 2D joints reads."""
        return images_of(self.base)

    def predict(self, frames: FrameBatch) -> PoseBatch:
        """The joints of N frames; 3D joints where the base has 2D ones of people with enough of them."""
        found = self.base.predict(frames)
        return lifted(found, self.joints, cameras_of(frames, slice(0, len(found.score))), self._lifting, self.base.name)


def lifted(found: PoseBatch, joints: Sequence[str], cameras: Sequence[Camera], lifting: Lifter, source: str) -> PoseBatch:
    """A batch whose 3D joints are lifted from its 2D ones, frame by frame as `cameras` see them.

    Parameters
    ----------
    found
        2D joints of F frames and P persons; those of too low a presence are ignored.
    joints
        (J,) their names; those that the lifting model does not know keep their 3D joints.
    cameras
        (F,) of the frames.
    lifting
        The model.
    source
        What error messages call the joints' origin.

    Raises
    ------
    ConfigError
        Where none of the joints is one that the model lifts.
    """
    theirs, ours = _common(joints, lifting, source)
    n, persons = found.joints_2d.shape[:2]
    uv = found.joints_2d[:, :, theirs].astype(np.float64)
    directions = np.full((n, persons, len(lifting.joints), 2), np.nan)
    for i, camera in enumerate(cameras):
        directions[i][:, ours] = _directions(uv[i], camera)
    believed = found.presence[:, :, theirs, None] >= float(lifting.config.presence)
    directions[:, :, ours] = np.where(believed, directions[:, :, ours], np.nan)
    points = lifting.lift(directions.reshape(n * persons, -1, 2)).reshape(n, persons, -1, 3)
    joints_3d = found.joints_3d.copy()
    answered = np.isfinite(uv).all(axis=-1, keepdims=True)
    joints_3d[:, :, theirs] = np.where(answered, points[:, :, ours], np.nan)
    return PoseBatch(found.joints_2d, joints_3d, found.score, found.presence)


def _common(joints: Sequence[str], lifting: Lifter, source: str) -> tuple[list[int], list[int]]:
    """The positions of the joints that both know, in `joints` and in the model's; ConfigError where there is none."""
    pairs = [(list(joints).index(name), j) for j, name in enumerate(lifting.joints) if name in joints]
    if not pairs:
        raise ConfigError(
            f"{source} finds none of the joints that {lifting.name} lifts", hint=f"it lifts {', '.join(lifting.joints)}"
        )
    theirs, ours = (list(column) for column in zip(*pairs, strict=True))
    return theirs, ours


def _directions(uv: NDArray[np.float64], camera: Camera) -> NDArray[np.float64]:
    """x/z and y/z (..., 2) of pixels (..., 2); NaN for NaN."""
    known = np.isfinite(uv).all(axis=-1, keepdims=True)
    rays = camera.unproject(np.where(known, uv, (camera.cx, camera.cy)), np.ones(uv.shape[:-1]))[..., :2]
    return np.where(known, rays, np.nan)

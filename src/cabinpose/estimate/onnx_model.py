"""Trained models in ONNX files, run by ONNX Runtime without torch."""

from __future__ import annotations

import dataclasses
import json
import os
import warnings
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from importlib import resources
from pathlib import Path
from typing import Any, cast

import numpy as np
import onnxruntime
from numpy.typing import NDArray

from cabinpose.core import (
    ANATOMY,
    CABINPOSE,
    IMAGES,
    NAMES,
    RIG,
    Camera,
    ConfigError,
    FrameBatch,
    ModelError,
    Skeleton,
    alike,
    camera_from,
    check_onnx,
    open_onnx,
    run_onnx,
)
from cabinpose.estimate.expected_error import METADATA_KEY as EXPECTED_ERROR
from cabinpose.estimate.expected_error import check as check_expected_error
from cabinpose.estimate.inputs import InputView, channels_first
from cabinpose.estimate.methods import Method, NetworkMethod, method_of
from cabinpose.store import in_ranges

METADATA_KEY = "cabinpose"
WHOLE = "cabinpose_whole"  # where a graph of `export onnx --whole` says what it is: JSON of name, persons, joints, unit, card
DRIVE_SIDE = "drive_side"  # in the metadata
TRAINED_ON = "trained_on"  # in the metadata, and in checkpoints: ranges of frames by the datasets' `frames_id`
JOINT_DEFINITION = "joint_definition"  # in the metadata, and in checkpoints: how the joints lie that were learnt
BATCH = 16  # frames that go through a network at a time


class TrainedModel(ABC):
    """What the file of a trained model says of itself: its method with settings, and the names of what it answers."""

    kind: type[Method[Any]]  # of methods whose models are such files
    answers: tuple[str, ...] = ()  # names of what its network answers
    _again: str  # how another file of this kind is made

    def __init__(self, path: Path, text: str | bytes) -> None:
        """text: JSON with method, config, name and card. Raises ModelError for another text, or a method of another kind."""
        self.path = path
        try:
            self.metadata: dict[str, Any] = json.loads(text)
            self.method = method_of(path, str(self.metadata["method"]))
            self.config = self.method.settings(self.metadata["config"])
            self.trained_on = _checked_ranges(self.metadata.get(TRAINED_ON, {}))
            self.expected_error = check_expected_error(self.metadata.get(EXPECTED_ERROR, {}).get("joints", {}))
        except (ValueError, KeyError, TypeError, AttributeError, RecursionError, ConfigError) as error:
            raise ModelError(f"{path} does not say what it is: {error}", hint=f"{self._again} with this version") from error
        if not isinstance(self.method, self.kind):
            raise ModelError(f"{path} cannot be a model of {self.method.name}", hint=self._again)
        self.name = str(self.metadata.get("name", path.stem))
        self.drive_side = str(self.metadata.get(DRIVE_SIDE, ""))  # of the cars that it is for; "" = as the frames say
        self.persons: tuple[str, ...] = tuple(self.config.slots)
        self.joints: tuple[str, ...] = tuple(self.config.joints)
        self.skeleton: str = self.config.joint_set.name
        definition = self.metadata.get(JOINT_DEFINITION, "")  # what was trained up to version 0.2 says nothing
        self.learnt: Skeleton = RIG if self.skeleton == CABINPOSE.name and definition != ANATOMY else self.config.joint_set

    @abstractmethod
    def run(self, seen: Mapping[str, NDArray[Any]]) -> Any:
        """The method's answer from a batch of what the view saw, by name."""

    def describe(self) -> dict[str, Any]:
        """What the file says of itself, as plain data: name, file, bytes, method, task, view, inputs, persons, joints, parts,
        joint_definition, mirrored, drive_side, settings, expected_error (where its confidence was calibrated: data, frames,
        joints), trained_on
        (ranges of frames by the `frames_id` of their datasets), card.
        """
        return {
            "name": self.name,
            "file": str(self.path),
            "bytes": self.path.stat().st_size,
            "method": self.method.name,
            "task": self.method.task,
            "view": dataclasses.asdict(self.config.view),
            "inputs": list(self.config.inputs),
            "persons": list(self.persons),
            "joints": list(self.joints),
            JOINT_DEFINITION: self.learnt.definition,
            "parts": [part.name for part in getattr(self.config, "parts", ())],
            "mirrored": bool(self.metadata.get("mirrored", False)),
            DRIVE_SIDE: self.drive_side,
            "settings": self.metadata["config"],
            EXPECTED_ERROR: self.metadata.get(EXPECTED_ERROR, {}),
            TRAINED_ON: self.trained_on,
            "card": self.metadata.get("card", {}),
        }


class OnnxModel(TrainedModel):
    """A network that `cabinpose export onnx` wrote, with its method and settings."""

    kind = NetworkMethod
    method: NetworkMethod[Any]
    _again = "export it again with `cabinpose export onnx`"

    def __init__(self, path: Path | str, *, threads: int | None = None) -> None:
        """Raises ModelError for a file that is missing, truncated, no model of this package, or claims more than it holds."""
        path = existing(path)
        try:
            if nan := check_onnx(path):
                told = f"{path} has {nan} tensors of weights with values that are not numbers (NaN): it may find nothing"
                warnings.warn(told, stacklevel=2)
            self.session = open_session(path, threads=threads)
        except Exception as error:  # ONNX Runtime's own errors share no base class
            raise ModelError(f"{path} cannot be read: {error}", hint="copy the file again, or export the model again") from error
        properties: Mapping[str, str] = self.session.get_modelmeta().custom_metadata_map
        if WHOLE in properties:
            raise ModelError(f"{path} is a whole graph for other programs", hint="give the model that it was made of")
        if METADATA_KEY not in properties:
            raise ModelError(f"{path} is an ONNX file of another program", hint="export models with `cabinpose export`")
        super().__init__(path, properties[METADATA_KEY])
        self._told = bool(nan)
        self.answers = tuple(output.name for output in self.session.get_outputs())

    def run(self, seen: Mapping[str, NDArray[Any]]) -> Any:
        """What the method decodes from a batch of inputs by name; arrays that the network does not take go to decoding."""
        return self.method.decode(self.outputs(seen), self.config, seen)

    def outputs(self, seen: Mapping[str, NDArray[Any]]) -> dict[str, NDArray[Any]]:
        """The network's outputs by name for a batch of inputs."""
        inputs = {name: seen[name] for name in self.config.inputs}
        empty = not any(len(array) for array in inputs.values())
        if empty:  # no network takes an empty batch
            inputs = {name: np.zeros((1, *array.shape[1:]), array.dtype) for name, array in inputs.items()}
        values = run_onnx(self.session, self.path, self.answers, inputs)
        if empty:
            values = [value[:0] for value in values]
        elif not self._told and any(value.dtype.kind == "f" and np.isnan(value).all() for value in values):
            self._told = True
            warnings.warn(f"{self.path} answers with values that are not numbers (NaN)", stacklevel=2)
        return dict(zip(self.answers, values, strict=True))


def _checked_ranges(trained_on: Mapping[Any, Any]) -> dict[str, str]:
    """Ranges of frames by dataset; ValueError where they are none."""
    ranges = {str(dataset): str(frames) for dataset, frames in trained_on.items()}
    for frames in ranges.values():
        in_ranges(frames, np.zeros(0, np.int64))
    return ranges


def existing(path: Path | str) -> Path:
    """The path of a file that is there. Raises ModelError."""
    if not Path(path).is_file():
        packaged = packaged_models()
        near = alike(str(path), packaged, NAMES)
        meant = f"did you mean {' or '.join(near)}? " if near else ""
        hint = f"{meant}give an ONNX file, or a packaged model ({', '.join(packaged) or 'none'})"
        raise ModelError(f"there is no model {path}", hint=hint)
    return Path(path)


def open_session(path: Path, *, threads: int | None = None) -> onnxruntime.InferenceSession:
    """ONNX Runtime as `open_onnx` has it; threads: one a core where it is not said."""
    session: onnxruntime.InferenceSession = open_onnx(path, threads=threads or os.cpu_count() or 1)
    return session


def slices(count: int) -> list[slice]:
    """Frames in batches; one, empty batch where there are none."""
    return [slice(i, i + BATCH) for i in range(0, max(count, 1), BATCH)]


def image_in(frames: FrameBatch) -> NDArray[Any]:
    """(N, H, W, ...) an image of the frames, for their number and size: the depth, or another where there is none."""
    image: NDArray[Any] = next(frames[name] for name in IMAGES if name in frames)  # type: ignore[literal-required]
    return image


def cameras_of(frames: FrameBatch, which: slice) -> list[Camera]:
    """The camera of each of some frames. Raises ConfigError where one cannot be."""
    count, height, width = image_in(frames)[which].shape[:3]
    k, dist = np.asarray(frames["camera_k"]), np.asarray(frames["camera_dist"])
    each_k = [k] * count if k.ndim == 2 else k[which]
    each_dist = [dist] * count if dist.ndim == 1 else dist[which]
    return [camera_from(m, d, width, height) for m, d in zip(each_k, each_dist, strict=True)]


def view_inputs(
    frames: FrameBatch, which: slice, cameras: Sequence[Camera], view: InputView, images: Sequence[str]
) -> dict[str, NDArray[np.float32]]:
    """What a view sees of frames of their cameras, by name: depth (N, h, w), m, and the images that are asked for.

    Amplitude is (N, h, w) as the camera has it, rgb (N, 3, h, w) sRGB from 0 to 255. Depth is 0 where it is invalid, and all over
    where the frames have none.
    """
    size, pictures = (view.height, view.width), [name for name in images if name != "depth"]
    if not cameras:
        shapes = {"depth": (0, *size)} | {name: (0, 3, *size) if name == "rgb" else (0, *size) for name in pictures}
        return {name: np.zeros(shape, np.float32) for name, shape in shapes.items()}
    taken = {name: image[which] for name, image in cast(Mapping[str, NDArray[Any]], frames).items() if name in IMAGES}
    for name in images:
        if name not in taken:
            what = "amplitudes" if name == "amplitude" else name
            raise ConfigError(f"this model reads {what}, and the frames have none", hint="take a model of depth alone")
    inputs = {"depth": np.zeros((len(cameras), *size), np.float32)}
    if "depth" in taken:
        inputs["depth"] = _seen(taken["depth"], cameras, view.depth)
    for name in pictures:
        seen = _seen(channels_first(taken[name]) if name == "rgb" else taken[name], cameras, view.resample)
        inputs[name] = seen.astype(np.float32, copy=False)
    return inputs


def _seen(images: NDArray[Any], cameras: Sequence[Camera], look: Callable[[NDArray[Any], Camera], NDArray[Any]]) -> NDArray[Any]:
    """Images (N, H, W) of their cameras as a view sees them; at once where the camera is the same."""
    if all(camera is cameras[0] for camera in cameras):
        return look(images, cameras[0])
    return np.stack([look(image, camera) for image, camera in zip(images, cameras, strict=True)])


def packaged_models() -> dict[str, Path]:
    """The models that come with the package, by name."""
    folder = Path(str(resources.files("cabinpose.estimate") / "models"))
    return {path.stem: path for path in sorted(folder.glob("*.onnx"))}

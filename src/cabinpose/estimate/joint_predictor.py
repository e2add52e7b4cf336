"""A trained model of joints as a predictor of body pose, whether a network or arrays answer."""

from __future__ import annotations

import math
import warnings
from collections.abc import Iterable, Sequence
from dataclasses import replace
from functools import partial
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from cabinpose.core import (
    ANATOMY,
    CABINPOSE,
    POSE_ARRAYS,
    Camera,
    ConfigError,
    FrameBatch,
    PoseBatch,
    camera_doubts,
    depth_doubt,
    joined,
    told_as,
)
from cabinpose.estimate.alternatives import ALTERNATIVES, Alternatives
from cabinpose.estimate.expected_error import expected_errors, usual_errors
from cabinpose.estimate.found import RIGHT_BELOW, Found, WheelOverTime, front_exchanged, mirrored
from cabinpose.estimate.onnx_model import TrainedModel, cameras_of, image_in, slices, view_inputs
from cabinpose.estimate.settings import PlacedSettings
from cabinpose.estimate.sight import unseen
from cabinpose.store import FoundPeople

# Median of amplitude times squared depth (m) over a generated frame, and where a model begins to fail: at a tenth of it the
# median error of `in_car` is 2.5 cm in place of 1.0, at a hundredth 52, at ten times as much 1.4 and at a hundred times 3.3.
USUAL_LIGHT: Final = 150.0
"""Median of amplitude times squared depth (camera's unit times m²) in the frames that packaged models learnt from."""
FAINTER: Final = 7.0
"""Times as faint as `USUAL_LIGHT`, from which packaged models fail."""
BRIGHTER: Final = 30.0
"""Times as bright, from which they fail."""
_EVERY = 4  # pixels between those that are looked at: a sixteenth tells the median, and a whole image costs half a millisecond
_MOST_CAMERAS = 16  # whose frames are tried turned and scaled
_FAR_M = 50.0  # no ToF camera in a car or a room looks so far


class _Known(NamedTuple):
    """What does not change from frame to frame of a camera: the share of the view that it fills, whether its lens folds, and what
    is tried of its frames, or None.
    """

    filled: float
    folds: bool
    tried: Alternatives | None


class JointPredictor:
    """A trained model of joints, whatever its file holds; fulfils `core.ports.Predictor`."""

    def __init__(self, model: TrainedModel) -> None:
        """model: of a method whose task is joints."""
        self.model, self.config = model, model.config
        self.name, self.persons, self.joints, self.skeleton = model.name, model.persons, model.joints, model.skeleton
        self.trained_on = model.trained_on
        self.joint_definition = ANATOMY if model.skeleton == CABINPOSE.name else ""
        self._warned: set[str] = set()  # of what
        self._known: dict[Camera, _Known] = {}
        self.drive_side = ""  # "left" or "right": where the wheel is in all frames, whatever they or the file say
        # While `predict` is given the frames of one car in their order; else each frame is a car by itself.
        self.wheel_over_time: WheelOverTime | None = None

    @property
    def seats_by_place(self) -> bool:
        """Whether seats are told by where people are in the image, so that it helps to say where the wheel is."""
        sees_wheel = "wheel" in self.model.answers and {"driver", "front_passenger"} <= set(self.persons)
        return isinstance(self.config, PlacedSettings) or sees_wheel

    @property
    def images(self) -> tuple[str, ...]:
        """The images that the model reads."""
        return tuple(self.config.inputs)

    def predict(self, frames: FrameBatch) -> PoseBatch:
        """The joints of N frames, in their order. Raises ConfigError where the model needs amplitudes and there are none."""
        batches = []
        for which in slices(len(image_in(frames))):
            cameras = cameras_of(frames, which)
            seen = self.seen(frames, which, cameras)
            poses = self.poses(self.found(seen, frames, which, over_time=self.wheel_over_time), cameras)
            batches.append(self.believed(poses, frames, which, seen, cameras))
        return joined(batches)

    def believed(
        self,
        poses: PoseBatch,
        frames: FrameBatch,
        which: slice,
        seen: dict[str, NDArray[np.float32]],
        cameras: Sequence[Camera],
    ) -> PoseBatch:
        """The poses of some frames without those in which nobody can be seen, which say why; the last of the stages.

        Warns of the first of them, and of images that seem to be turned or scaled.
        """
        if not cameras or "depth" not in frames:
            return poses
        known = [self._known.get(camera) or self._looked_at(camera) for camera in cameras]
        judged = unseen(seen, [each.filled for each in known])
        reasons, remarks = ([text for text in texts if text] for texts in zip(*judged, strict=True))
        for remark in remarks[:1]:
            self._warn_once("a covered lens", remark)
        if any(each.folds for each in known):
            folded = [depth_doubt(camera, depth) for camera, depth in zip(cameras, frames["depth"][which], strict=True)]
            for doubt in dict.fromkeys(filter(None, folded)):
                self._warn_once("a lens that folds", doubt)
                remarks.append(doubt)
        for reason in reasons[:1]:
            self._warn_once("nobody", f"a frame in which {self.name} cannot see anybody: {reason}; it has no joints")
        for name in POSE_ARRAYS if reasons else ():
            getattr(poses, name)[[why != "" for why, _ in judged]] = 0.0 if name in ("score", "presence") else np.nan
        remarks += self._changes(poses, frames, which, zip(cameras, known, strict=True))
        if not reasons and not remarks:
            return poses
        reason = np.array([why for why, _ in judged], object)
        return replace(poses, reason=reason, remarks=(*poses.remarks, *dict.fromkeys(remarks)))

    def _looked_at(self, camera: Camera) -> _Known:
        """What is looked up of a camera whose frames come for the first time; of too many, each time."""
        tried = Alternatives(self.name, usual_errors(self.model.expected_error, self.joints))
        known = _Known(self.config.view.filled(camera), not math.isinf(camera.monotonic_radius), tried)
        if len(self._known) == _MOST_CAMERAS:
            return known._replace(tried=None)
        self._known[camera] = known
        return known

    def _changes(self, poses: PoseBatch, frames: FrameBatch, which: slice, cameras: Iterable[tuple[Camera, _Known]]) -> list[str]:
        """What speaks for frames that are turned or scaled, of each camera once; warns of it."""
        told = dict[str, None]()
        for n, (camera, known) in enumerate(cameras):
            tried = known.tried
            if tried is None:
                continue
            if tried.open:
                ask = partial(self._changed, frames, which.start + n, camera)
                tried.look(poses.presence[n : n + 1], poses.expected_error_m[n : n + 1], ask)
            if tried.told:
                told[tried.told] = None
                self._warn_once(tried.told, tried.told)
        return [*told]

    def _changed(self, frames: FrameBatch, index: int, camera: Camera) -> tuple[NDArray[Any], NDArray[Any]]:
        """Presence and expected errors (A, P, J) of one frame's alternatives; presence 0 where nobody can be seen."""
        view, images = self.config.view, {"depth", *self.config.inputs}
        presences, errors = [], []
        for change in ALTERNATIVES:  # one by one: the features of all in a batch would stay in the runtime's memory
            turned = camera.turned(change.quarters)
            seen = view_inputs(change.undone(frames, index, images), slice(1), [turned], view, self.config.inputs)
            found = self.found(seen, frames, slice(index, index + 1))
            ((why, _),) = unseen(seen, [view.filled(turned)])
            presences.append(np.zeros_like(found.presence) if why else found.presence)
            errors.append(expected_errors(self.model.expected_error, self.joints, found))
        return np.concatenate(presences), np.concatenate(errors)

    def _warn_once(self, of: str, words: str) -> None:
        """Warn, the first time that there is anything of this kind to say."""
        if of not in self._warned:
            self._warned.add(of)
            warnings.warn(words, stacklevel=4)

    def _told(self, frames: FrameBatch, which: slice, count: int) -> NDArray[np.str_]:
        """(N,) where the wheel is, as it is told: left, right, empty where nothing says it."""
        if not self.seats_by_place:
            return np.full(count, "")
        said = self.drive_side or self.model.drive_side or "drive_side" in frames
        if not said and isinstance(self.config, PlacedSettings) and {"driver", "front_passenger"} & set(self.persons):
            self._warn_once(
                "the wheel",
                f"nothing says where the wheel is: {self.name} tells seats by place and takes it to be on the"
                f" {self.config.drive_side}. Say it with --drive-side left or right, or in a dataset (`drive_side`)",
            )
        told = np.full(count, self.drive_side) if self.drive_side or "drive_side" not in frames else frames["drive_side"][which]
        return np.where(told == "", self.model.drive_side, told)

    def found(
        self,
        seen: dict[str, NDArray[np.float32]],
        frames: FrameBatch,
        which: slice,
        *,
        over_time: WheelOverTime | None = None,
    ) -> Found:
        """The model's answers in its view to what it has `seen` of some frames, the driver at the wheel; a stage of `predict`.

        A model that sees the wheel answers by place, so that the front row is exchanged where it is on the right. Others see the
        mirror image where it is on the other side, and so where they have learnt it. over_time: what it saw of the wheel in the
        frames before.
        """
        told = self._told(frames, which, len(next(iter(seen.values()))))
        if not isinstance(self.config, PlacedSettings):
            answer: Found = self.model.run(seen)
            if over_time is not None and answer.wheel is not None:
                answer = answer._replace(wheel=over_time(answer.wheel))
            return _at_the_wheel(answer, told, self.persons)
        turned = (told != "") & (told != self.config.drive_side)
        if not turned.any():
            plain: Found = self.model.run(seen)
            return plain
        other: Found = self.model.run({name: _chosen(turned, images, images[..., ::-1]) for name, images in seen.items()})
        return other.map(partial(_chosen, turned), mirrored(other, self.config))

    def __call__(
        self,
        depth_m: NDArray[Any],
        camera_k: NDArray[Any],
        amplitude: NDArray[Any] | None = None,
        *,
        camera_dist: NDArray[Any] | None = None,
        rgb: NDArray[Any] | None = None,
    ) -> FoundPeople:
        """The joints of one frame or of many, from plain arrays.

        Parameters
        ----------
        depth_m
            (H, W) or (N, H, W), metres along the optical axis, 0 or NaN where the camera saw nothing.
        camera_k
            (3, 3), or (N, 3, 3) for one camera a frame: intrinsics, px; an integer pixel is a pixel's centre.
        amplitude
            The same shape as the depth: the active infrared light, as the camera gives it (uint16 or float).
        camera_dist
            (5,) or (N, 5): OpenCV's k1 k2 p1 p2 k3; default: no distortion.
        rgb
            (H, W, 3) or (N, H, W, 3), sRGB from 0 to 255, of the pixels of the depth.

        Returns
        -------
        FoundPeople
            A `PoseBatch` with names, which draws itself into an image (`draw`) and becomes a table (`to_dataframe`): joints_2d
            (P, J, 2) px, joints_3d (P, J, 3) m in the camera frame, score and presence (P, J), for the slots `persons` and the
            joints `joints`, with expected_error_m (P, J) where the model's confidence is calibrated; with N before that for many
            frames. reason, an array () of one text, or (N,), says why a frame in which nobody can be seen has no answer; remarks,
            texts, what speaks against the camera, and what stood out in the frames.

        Raises
        ------
        ConfigError
            For shapes that do not fit, depths that are no metres, amplitudes that are missing, or a camera that cannot be.
        """
        depth = np.asarray(depth_m)
        one = depth.ndim == 2
        if depth.ndim not in (2, 3) or not depth.size:
            raise ConfigError(f"depth of shape {depth.shape} is no image", hint="give (H, W) for one frame, (N, H, W) for many")
        k = np.asarray(camera_k, np.float64)
        count = 1 if one else len(depth)
        if k.shape not in ((3, 3), (count, 3, 3)):
            raise ConfigError(f"camera_k of shape {k.shape} is no camera matrix", hint="give (3, 3), or (N, 3, 3) for N frames")
        # Counted: numpy's median loads half a megabyte the first time.
        if 2 * np.count_nonzero((depth > _FAR_M) & (depth < np.inf)) > np.count_nonzero((depth > 0) & (depth < np.inf)):
            raise ConfigError(f"half of the depths are beyond {_FAR_M:g}", hint="depths are metres: divide millimetres by 1000")
        dist = np.zeros(5) if camera_dist is None else np.asarray(camera_dist, np.float64)
        frames = FrameBatch(depth=depth.reshape(count, *depth.shape[-2:]).astype(np.float32), camera_k=k, camera_dist=dist)
        if amplitude is not None:
            light = np.asarray(amplitude)
            if light.shape != depth.shape:
                raise ConfigError(
                    f"amplitude of shape {light.shape} does not belong to depth of shape {depth.shape}",
                    hint="give both of one frame",
                )
            frames["amplitude"] = light.reshape(frames["depth"].shape)
        if rgb is not None:
            if np.shape(rgb) != (*depth.shape, 3):
                raise ConfigError(
                    f"rgb of shape {np.shape(rgb)} does not belong to depth of shape {depth.shape}", hint="give both of one frame"
                )
            frames["rgb"] = np.asarray(rgb).reshape(*frames["depth"].shape, 3)
        poses = self.predict(frames)
        poses = poses.map(lambda values: values[0]) if one else poses
        return FoundPeople(
            **vars(poses), persons=tuple(self.persons), joints=tuple(self.joints), model=self.name, skeleton=self.skeleton,
            size=(depth.shape[-1], depth.shape[-2]),
        )  # fmt: skip

    def seen(self, frames: FrameBatch, which: slice, cameras: Sequence[Camera]) -> dict[str, NDArray[np.float32]]:
        """What the model's view sees of some frames by name; the first of the stages of `predict`.

        Warns once where the amplitudes cannot be what the model has learnt from.
        """
        seen = view_inputs(frames, which, cameras, self.config.view, self.config.inputs)
        if "amplitude" in seen and "light" not in self._warned:
            amplitude, depth = (seen[name][..., ::_EVERY, ::_EVERY] for name in ("amplitude", "depth"))
            light = amplitude * depth**2
            # Counting tells on which side the median is, in less time than finding it takes.
            above = (0.0, USUAL_LIGHT / FAINTER, USUAL_LIGHT * BRIGHTER)
            lit, enough, brighter = (np.count_nonzero(light > least) for least in above)
            if 2 * max(lit - enough, brighter) > lit:
                median = float(np.median(light[light > 0]))
                self._warn_once(
                    "light",
                    f"the median of amplitude x depth² is {median:.3g}, where {self.name} has learnt from"
                    f" {USUAL_LIGHT:g}: joints will be far off. Scale the amplitudes to that",
                )
        return seen

    def poses(self, found: Found, cameras: Sequence[Camera]) -> PoseBatch:
        """The joints in the frames' own cameras, as their set defines them, from those in the view, as the model has learnt
        them; a stage of `predict`.

        Warns of the first camera whose field of view is another than the model's.
        """
        view = self.config.view
        joints_2d = np.empty_like(found.uv)
        for n, camera in enumerate(cameras):
            joints_2d[n] = view.pixels(found.uv[n], camera)
        learnt, meant = self.model.learnt, self.config.joint_set
        places = [told_as(points, self.joints, learnt, meant) for points in (joints_2d, found.joints_3d)]
        arrays = *places, found.score, found.presence
        expected = expected_errors(self.model.expected_error, self.joints, found)
        remarks = dict.fromkeys(doubt for camera in cameras for doubt in camera_doubts(camera))
        for doubt in dict.fromkeys(doubt for camera in cameras for doubt in view.doubts(camera)):
            self._warn_once("the field of view", f"{self.name}: {doubt}")
            remarks[doubt] = None
        floats = (a.astype(np.float32) for a in arrays)
        return PoseBatch(*floats, expected_error_m=expected.astype(np.float32), remarks=tuple(remarks))


def _chosen(which: NDArray[np.bool_], plain: NDArray[Any], other: NDArray[Any]) -> NDArray[Any]:
    """Arrays (N, ...) of `other` where `which` (N,) says so."""
    return np.where(which.reshape(-1, *[1] * (plain.ndim - 1)), other, plain)


def _at_the_wheel(found: Found, told: NDArray[np.str_], slots: Sequence[str]) -> Found:
    """What a model found by place, with the driver at the wheel: where it is not told, on the side where the model sees it."""
    if found.wheel is None:
        return found
    exchanged = np.where(told == "", found.wheel < RIGHT_BELOW, told == "right")
    if not exchanged.any():
        return found
    order = front_exchanged(slots)
    return found.map(lambda values: _chosen(exchanged, values, values[:, order]))

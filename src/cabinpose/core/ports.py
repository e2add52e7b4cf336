"""The interfaces of detectors, and the types that they take and give: rooms that share no files meet here."""

from __future__ import annotations

import re
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, NotRequired, Protocol, TypedDict, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from cabinpose.core.errors import DatasetError
from cabinpose.core.imports import moved
from cabinpose.core.segmentation import Part

__getattr__ = moved(__name__, {name: f"cabinpose.signals.{name}" for name in ("Counts", "FrameSource", "Sample")})


class FrameBatch(TypedDict):
    """N frames of one camera, as a detector gets them. Camera frame: OpenCV (x right, y down, z forward).

    depth: (N, H, W) float32, metres along the optical axis, NaN = invalid.
    camera_k: (N, 3, 3) or (3, 3) float64, px; an integer pixel is a pixel's centre.
    camera_dist: (N, 5) or (5,) float64, OpenCV's k1 k2 p1 p2 k3.
    amplitude: (N, H, W) uint16 or float32, of the active infrared light; left out where the camera gives none.
    confidence, noise, depth_styled, labels, rgb, nir: images as the dataset's variables of these names hold them, for detectors
    that ask for them (`images_of`): uint8, uint16 µm (0 = unknown), float32 m (NaN = invalid), uint8 classes, (N, H, W, 3) uint8
    sRGB, uint16.
    cloud: (N, H, W, 3) float32 m, each pixel's point in the camera frame, NaN where depth is; for those that ask for it.
    drive_side: (N,) str, where the wheel is: "left", "right", "" = not known; left out where nothing says it.
    frame, sync_ns: (N,) int64, the frames' numbers and time stamps on the common clock; for messages and detectors elsewhere.
    """

    depth: NDArray[np.float32]
    camera_k: NDArray[np.float64]
    camera_dist: NDArray[np.float64]
    amplitude: NotRequired[NDArray[Any]]
    confidence: NotRequired[NDArray[np.uint8]]
    noise: NotRequired[NDArray[np.uint16]]
    depth_styled: NotRequired[NDArray[np.float32]]
    labels: NotRequired[NDArray[np.uint8]]
    rgb: NotRequired[NDArray[np.uint8]]
    nir: NotRequired[NDArray[np.uint16]]
    cloud: NotRequired[NDArray[np.float32]]
    drive_side: NotRequired[NDArray[Any]]
    frame: NotRequired[NDArray[np.int64]]
    sync_ns: NotRequired[NDArray[np.int64]]


IMAGES = ("depth", "amplitude", "confidence", "noise", "depth_styled", "labels", "rgb", "nir", "cloud")
"""The images of a frame that a detector can be given, by their names in a `FrameBatch`."""


@dataclass(frozen=True)
class PoseBatch:
    """Joints of F frames, P persons (slots) and J joints, as a detector finds them.

    joints_2d: (F, P, J, 2) float32 px, NaN = no answer.
    joints_3d: (F, P, J, 3) float32 m, camera frame, NaN = no answer.
    score: (F, P, J) float32, any scale on which more is better; it orders detections.
    presence: (F, P, J) float32 in 0..1, the probability that the joint is in the image; 0 = no answer.
    expected_error_m: (F, P, J) float32 m, the mean distance of such joints to the truth in 3D; NaN = not known, as in all of a
    detector whose confidence is not calibrated.
    reason: (F,) object, why a frame has no answer, in words; "" = the detector looked at it, and may have found nobody.
    remarks: what stood out in these frames or their answers, in words, once each.
    """

    joints_2d: NDArray[np.float32]
    joints_3d: NDArray[np.float32]
    score: NDArray[np.float32]
    presence: NDArray[np.float32]
    expected_error_m: NDArray[np.float32] = field(default_factory=lambda: np.zeros((), np.float32), kw_only=True)
    reason: NDArray[np.object_] = field(default_factory=lambda: np.zeros(0, object), kw_only=True)
    remarks: tuple[str, ...] = field(default=(), kw_only=True)

    def __post_init__(self) -> None:
        if not self.expected_error_m.ndim:  # left out
            object.__setattr__(self, "expected_error_m", np.full(self.score.shape, np.nan, np.float32))
        frames = self.score.shape[:-2]
        if not self.reason.size:  # left out
            object.__setattr__(self, "reason", np.full(frames, "", object))
        if self.reason.shape != frames:
            raise ValueError(f"reasons of shape {self.reason.shape} do not belong to frames of shape {frames}")

    @property
    def unseen(self) -> dict[str, int]:
        """Frames with a reason, counted by it; reasons that differ in numbers alone count as one, in the words of the first."""
        first: dict[str, str] = {}
        reasons = [first.setdefault(without_numbers(each), each) for each in self.reason.ravel().tolist() if each]
        return {reason: reasons.count(reason) for reason in first.values()}

    def map(self, change: Callable[[NDArray[Any]], NDArray[Any]]) -> PoseBatch:
        """The batch with all arrays changed alike: frames, persons or joints chosen or put in another order."""
        arrays = {name: change(getattr(self, name)) for name in POSE_ARRAYS}
        reason = np.full(arrays["score"].shape[:-2], "", object)
        if self.reason.any() and self.score.size:  # chosen with the joints: those of one frame have the same
            each = change(np.broadcast_to(self.reason[..., None, None], self.score.shape))
            reason = each[..., 0, 0] if each.size else reason
        return PoseBatch(**arrays, reason=np.asarray(reason, object), remarks=self.remarks)


def without_numbers(message: str) -> str:
    """What messages that differ in numbers alone have in common, by which they count as one."""
    return re.sub(r"[0-9.]+", "0", message)


def unseen_words(unseen: Mapping[str, int], frames: int) -> list[str]:
    """Frames in which nobody can be seen, counted by reason (`PoseBatch.unseen`), of all `frames`, in words."""
    return [f"{count} of {frames} frames: nobody can be seen: {reason}" for reason, count in unseen.items()]


POSE_ARRAYS = ("joints_2d", "joints_3d", "score", "presence", "expected_error_m")
"""The arrays of a `PoseBatch` that have numbers for each joint."""


def joined(batches: Sequence[PoseBatch]) -> PoseBatch:
    """The frames of several batches of the same persons and joints, in their order."""
    if len(batches) == 1:
        return batches[0]
    names = (*POSE_ARRAYS, "reason")
    remarks = tuple(dict.fromkeys(remark for batch in batches for remark in batch.remarks))
    return PoseBatch(**{name: np.concatenate([getattr(batch, name) for batch in batches]) for name in names}, remarks=remarks)


@runtime_checkable
class Predictor(Protocol):
    """A detector of body pose.

    One that reads other images than depth, and amplitude where there is one, has an attribute `images`: their names, of `IMAGES`.
    One that knows what it was trained on has `trained_on`: ranges of frames (`store.frame_ranges`) by the attribute `frames_id`
    of their dataset.
    """

    @property
    def name(self) -> str:
        """What reports call it."""

    @property
    def persons(self) -> tuple[str, ...]:
        """(P,) names of the slots that it fills."""

    @property
    def joints(self) -> tuple[str, ...]:
        """(J,) names of the joints that it finds."""

    def predict(self, frames: FrameBatch) -> PoseBatch:
        """The joints of N frames, in their order."""


@runtime_checkable
class Segmenter(Protocol):
    """A segmentation of people's parts."""

    @property
    def name(self) -> str:
        """What reports call it."""

    @property
    def parts(self) -> tuple[Part, ...]:
        """The parts: the number n of a label image is `parts[n - 1]`."""

    def segment(self, frames: FrameBatch) -> NDArray[np.uint8]:
        """Label images (N, H, W) in the frames' own pixels: 0 = nobody, else 1 + the position of the part."""


def images_of(model: Predictor | Segmenter) -> tuple[str, ...]:
    """The images without which a detector does not work, of `IMAGES`."""
    return tuple(getattr(model, "images", ("depth",)))


def require_images(models: Iterable[Predictor | Segmenter], there: Collection[str], source: str) -> None:
    """Raise DatasetError where a detector reads images that a source does not have.

    Parameters
    ----------
    models
        The detectors.
    there
        The images of the source, of `IMAGES`.
    source
        What the message calls it.
    """
    for model in models:
        if lacking := [name for name in images_of(model) if name not in there]:
            known = [name for name in IMAGES if name in there]
            listed = f"; `cabinpose models --reads {' '.join(known)}` lists models that do with it" if known else ""
            raise DatasetError(
                f"{source} has no {', '.join(lacking)} for {model.name} to see",
                hint=f"it has {', '.join(known) or 'no images'}{listed}",
            )

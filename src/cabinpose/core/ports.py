"""What the rooms meet in beside files: the interfaces that a detector fulfils, and the arrays that it takes and gives."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NotRequired, Protocol, TypedDict, runtime_checkable

import numpy as np
from numpy.typing import NDArray


class FrameBatch(TypedDict):
    """N frames of one camera, as a detector gets them. Camera frame: OpenCV (x right, y down, z forward).

    depth: (N, H, W) float32, metres along the optical axis, NaN = invalid.
    camera_k: (N, 3, 3) or (3, 3) float64, px; an integer pixel is a pixel's centre.
    camera_dist: (N, 5) or (5,) float64, OpenCV's k1 k2 p1 p2 k3.
    amplitude: (N, H, W) uint16 or float32, of the active infrared light; left out where the camera gives none.
    """

    depth: NDArray[np.float32]
    camera_k: NDArray[np.float64]
    camera_dist: NDArray[np.float64]
    amplitude: NotRequired[NDArray[Any]]


@dataclass(frozen=True)
class PoseBatch:
    """Joints of F frames, P persons (slots) and J joints, as a detector finds them.

    joints_2d: (F, P, J, 2) float32 px, NaN = no answer.
    joints_3d: (F, P, J, 3) float32 m, camera frame, NaN = no answer.
    score: (F, P, J) float32, any scale on which more is better; it orders detections.
    presence: (F, P, J) float32 in 0..1, the probability that the joint is in the image; 0 = no answer.
    """

    joints_2d: NDArray[np.float32]
    joints_3d: NDArray[np.float32]
    score: NDArray[np.float32]
    presence: NDArray[np.float32]


@runtime_checkable
class Predictor(Protocol):
    """A detector of body pose."""

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

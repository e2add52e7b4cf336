"""What decoding gives: joints in the view and in the camera frame, with how sure the model is of them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from cabinpose.estimate.settings import ViewSettings

RIGHT_BELOW = -0.85
"""Logit of the wheel being on the left below which it is on the right: a probability of 0.3. Without a wheel it is 0.5."""
_CERTAIN = 6.0  # logits beyond count as this: one frame that is sure of the wrong side is one frame
_FORGETTING = 0.98  # from frame to frame: the last fifty count, 3 s
_KEPT = 1.0  # by which the mean has to be beyond `RIGHT_BELOW` for the wheel to change its side
_REAR, _FRONT = ("rear_left", "rear_right"), ("driver", "front_passenger")


class Found(NamedTuple):
    """Joints of N frames, P persons and J joints.

    uv: (N, P, J, 2) px of the model's view; NaN = no answer · joints_3d: (N, P, J, 3) m, camera frame; NaN = no answer ·
    score: (N, P, J), more is better · presence: (N, P, J) probability that the joint is in the image · spreads: (N, P, J, C) m,
    how far apart the parts of the model are that answered, in C ways; None where the model does not say · wheel: (N,), positive
    where the wheel seems to be on the left; None where the model does not tell: where it does, driver means the left front place.
    """

    uv: NDArray[np.float64]
    joints_3d: NDArray[np.float64]
    score: NDArray[np.float64]
    presence: NDArray[np.float64]
    spreads: NDArray[np.float64] | None = None
    wheel: NDArray[np.float64] | None = None

    def map(self, change: Callable[..., NDArray[np.float64]], *others: Found) -> Found:
        """What `change` makes of each array of people, and of that of other answers of the same model."""
        arrays = [change(*each) for each in zip(self[:-1], *(other[:-1] for other in others), strict=True) if each[0] is not None]
        return Found(*arrays)._replace(wheel=self.wheel)


class WheelOverTime:
    """Where a model sees the wheel in frames of one car in their order: the mean of its logits, of which older ones count less,
    and a side that stays until the mean is well beyond the border between them.
    """

    def __init__(self) -> None:
        self._sum = self._weight = 0.0
        self._side = 0  # -1 = right, 1 = left, 0 = not known yet

    def __call__(self, wheel: NDArray[np.float64]) -> NDArray[np.float64]:
        """(N,) logits to decide by, of those of the next N frames."""
        return np.array([self._next(float(logit)) for logit in wheel])

    def _next(self, logit: float) -> float:
        if np.isfinite(logit):
            self._sum = _FORGETTING * self._sum + min(max(logit, -_CERTAIN), _CERTAIN)
            self._weight = _FORGETTING * self._weight + 1.0
        mean = self._sum / max(self._weight, 1.0) + _KEPT * self._side
        self._side = -1 if mean < RIGHT_BELOW else 1
        return mean


def sigmoid(logit: NDArray[Any]) -> NDArray[np.float64]:
    """1 / (1 + exp(-x)), without overflow."""
    return np.asarray(0.5 * (1.0 + np.tanh(0.5 * np.asarray(logit, dtype=np.float64))))


def mirrored_slots(slots: Sequence[str], *, at_wheel: bool = False) -> list[int]:
    """For each place the position of its mirror place: driver means the left one of the front row, wherever the wheel is.

    `at_wheel`: driver means who sits at the wheel, in the mirrored car as well. A place whose partner is not among them stays
    itself.
    """
    pairs = (_REAR,) if at_wheel else (_REAR, _FRONT)
    other = dict(pairs) | {b: a for a, b in pairs}
    position = {slot: i for i, slot in enumerate(slots)}
    return [position.get(other.get(slot, slot), i) for slot, i in position.items()]


def front_exchanged(slots: Sequence[str]) -> list[int]:
    """For each place its position once driver and front passenger, where both are among them, have changed places."""
    slots = list(slots)
    both = [slots.index(name) for name in _FRONT] if set(_FRONT) <= set(slots) else []
    return [both[1 - both.index(i)] if i in both else i for i in range(len(slots))]


def mirrored(found: Found, settings: ViewSettings) -> Found:
    """What was found in the mirror images of frames as it is in the frames themselves; the driver stays at the wheel."""
    slots, joints = mirrored_slots(settings.slots, at_wheel=True), list(settings.joint_set.mirror)
    swapped = found.map(lambda values: values[:, slots][:, :, joints])
    u = settings.view.width - 1 - swapped.uv[..., :1]
    return swapped._replace(uv=np.concatenate((u, swapped.uv[..., 1:]), axis=-1), joints_3d=swapped.joints_3d * (-1.0, 1.0, 1.0))

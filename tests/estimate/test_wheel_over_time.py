"""Where the wheel is seen, over the frames of one car: single frames that see it elsewhere do not exchange the front row."""

from __future__ import annotations

import numpy as np
import pytest

from cabinpose.core import FrameBatch
from cabinpose.estimate import Found, JointPredictor, WheelOverTime, load_model
from cabinpose.estimate.found import RIGHT_BELOW

WRONG = (5, 6, 17, 30)
FRAMES = 40


def logits(side: float) -> np.ndarray:
    """(40,) of a wheel on one side (1 = left), wrong in some frames."""
    wheel = np.full(FRAMES, 3.0 * side)
    wheel[list(WRONG)] *= -2
    return wheel


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_single_frames_do_not_change_the_side(side: float) -> None:
    seen = WheelOverTime()
    over_time = np.concatenate([seen(each) for each in np.split(logits(side), 10)])  # in batches, as one by one
    assert ((over_time < RIGHT_BELOW) == (side < 0)).all()
    assert ((logits(side) < RIGHT_BELOW) != (side < 0)).sum() == len(WRONG)


def test_a_first_frame_that_is_wrong_is_put_right_and_a_changed_car_is_seen() -> None:
    seen = WheelOverTime()
    assert (seen(np.array([-1.0, 3.0, 3.0, 3.0])) < RIGHT_BELOW).tolist() == [True, False, False, False]
    seen(np.full(300, 5.0))
    changed = seen(np.full(120, -5.0)) < RIGHT_BELOW
    assert not changed[0]
    assert 20 < np.argmax(changed) < 60
    assert changed[np.argmax(changed) :].all()


def test_a_mean_at_the_border_does_not_go_to_and_fro_and_what_is_no_number_counts_nothing() -> None:
    seen, rng = WheelOverTime(), np.random.Generator(np.random.Philox(key=1))
    sides = seen(rng.normal(RIGHT_BELOW, 2.0, 500)) < RIGHT_BELOW
    assert np.count_nonzero(np.diff(sides)) <= 2
    assert np.isfinite(seen(np.array([np.nan, np.inf]))).all()


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_a_predictor_keeps_the_seats_over_frames_with_a_wrong_wheel(side: float, monkeypatch: pytest.MonkeyPatch) -> None:
    predictor = load_model("in_car", threads=1)
    wheel = iter(logits(side))

    def run(_: object) -> Found:
        p, j = len(predictor.persons), len(predictor.joints)
        left_first = np.broadcast_to(np.arange(p, dtype=float)[None, :, None], (1, p, j))  # the left place has presence 0
        points = np.ones((1, p, j, 3)) * left_first[..., None]
        return Found(points[..., :2], points, left_first, left_first, np.full((1, p, j, 2), 0.01), np.array([next(wheel)]))

    monkeypatch.setattr(predictor.model, "run", run)
    monkeypatch.setattr(JointPredictor, "believed", lambda _, poses, *rest: poses)
    shown = FrameBatch(
        depth=np.full((1, 160, 192), 1.0, np.float32), camera_k=np.array([[76.0, 0, 95.5], [0, 76.0, 79.5], [0, 0, 1]]),
        camera_dist=np.zeros(5), amplitude=np.full((1, 160, 192), 150, np.uint16),
    )  # fmt: skip
    predictor.wheel_over_time = WheelOverTime()
    driver = np.array([predictor.predict(shown).presence[0, 0, 0] for _ in range(FRAMES)])
    assert (driver == (0.0 if side > 0 else 1.0)).all()
    predictor.wheel_over_time, wheel = None, iter(logits(side))
    alone = np.array([predictor.predict(shown).presence[0, 0, 0] for _ in range(FRAMES)])
    assert np.flatnonzero(alone != driver).tolist() == [*WRONG]

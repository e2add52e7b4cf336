"""Numbers over repeats: the report's own for one, and intervals against their closed forms."""

from __future__ import annotations

import numpy as np
import pytest
import xarray as xr

from cabinpose.evaluate.offline import samples_of
from cabinpose.evaluate.options import EvaluationOptions
from cabinpose.evaluate.repeats import ModelErrors, accuracy_curve, errors_of, joined_errors, over_repeats, row_differences
from cabinpose.evaluate.report import make_report
from cabinpose.store.predictions import Predictions

OPTIONS = EvaluationOptions(resamples=0)


@pytest.mark.parametrize("space", ["2d", "3d"])
def test_one_repeat_has_the_numbers_of_the_report(space: str, dataset: xr.Dataset, predictions: Predictions) -> None:
    samples, _ = samples_of(dataset, predictions, OPTIONS)
    report, errors = make_report(samples, OPTIONS, "m", "d"), errors_of(samples)
    mean = "mean error" if space == "2d" else "MPJPE"
    rows = [("pckh", 0.5, "PCKh", 0.5), ("auc", 0.5, "AUC of PCKh", None), ("mean_error", 1.0, mean, None)]
    if space == "2d":
        rows += [("presence_precision", 1.0, "presence precision", None), ("presence_recall", 1.0, "presence recall", None)]
    else:
        rows += [("root_relative_error", 1.0, "root-relative MPJPE", None)]
    rows += [("pck", 26.0, "PCK", 26.0)] if space == "2d" else [("pck", 0.10, "PCK", 10.0)]
    for measure, threshold, name, at in rows:
        for joints in ("All", "Wrist"):
            members = report.joint_sets[joints]
            columns = [samples.skeleton.joints.index(joint) for joint in members]
            found = over_repeats([errors], measure, space=space, threshold=threshold, joints=columns, resamples=0)  # type: ignore[arg-type]
            theirs = report.value(name, "image" if measure.startswith("presence") else space, joints, at)
            assert theirs is not None
            assert found.value == pytest.approx(theirs.value, abs=1e-4), (measure, joints)
    line = report.curves[space]["pckh"]["lines"]["All"]
    grid = np.array(report.curves[space]["pckh"]["grid"])
    assert accuracy_curve(errors, grid, space) == pytest.approx(np.array(line), abs=0.01)


def hits(share: float, frames: int, *, rng: np.random.Generator) -> ModelErrors:
    """A joint a frame, found at once or not at all."""
    error = np.where(rng.random((frames, 1)) < share, 0.0, np.inf)
    head = np.ones(frames)
    return ModelErrors(
        np.arange(frames),
        np.arange(frames),
        error,
        error,
        error * np.nan,
        head,
        head,
        error * np.nan,
        np.zeros((0, 0, 0), np.int64),
    )


def test_the_interval_over_frames_is_the_binomial_one() -> None:
    run = hits(0.3, 2000, rng=np.random.Generator(np.random.Philox(1)))
    found = over_repeats([run], "pckh", resamples=2000)
    share = found.value / 100
    half = 1.96 * 100 * np.sqrt(share * (1 - share) / 2000)
    assert (found.high - found.low) / 2 == pytest.approx(half, rel=0.1)


def test_the_interval_over_repeats_is_that_of_their_mean() -> None:
    """Models that differ by far more than frames do: the mean of R draws with replacement has the variance of the R over R."""
    rng = np.random.Generator(np.random.Philox(2))
    runs = [hits(share, 5000, rng=rng) for share in np.linspace(0.2, 0.8, 12)]
    found = over_repeats(runs, "pckh", resamples=2000)
    spread = np.std(found.each) / np.sqrt(len(runs))
    assert found.value == pytest.approx(np.mean(found.each))
    assert (found.high - found.low) / 2 == pytest.approx(1.96 * spread, rel=0.1)


def test_the_difference_on_the_same_frames_is_the_paired_one() -> None:
    """Of frames alone: McNemar's variance, half of that of two samples where most frames are as hard for both."""
    rng = np.random.Generator(np.random.Philox(4))
    one = hits(0.5, 3000, rng=rng)
    flipped = np.where(rng.random((3000, 1)) < 0.1, 0.0, one.error_px)
    found = row_differences({"a": [one], "b": [one._replace(error_px=flipped)]}, "pckh", resamples=2000)
    away = np.isinf(one.error_px).astype(float) - np.isinf(flipped)
    assert found["b", "a"].value == pytest.approx(100 * away.mean())
    assert found["a", "b"].value == -found["b", "a"].value
    half = 1.96 * 100 * away.std() / np.sqrt(3000)
    assert (found["b", "a"].high - found["b", "a"].low) / 2 == pytest.approx(half, rel=0.1)
    assert found["b", "a"].sure


def test_the_spread_of_repeats_is_pooled_over_rows() -> None:
    """Of repeats alone: 8 rows of 3, of whose variance a difference of means has 2/3; that to a row of one repeat has 4/3."""
    rng = np.random.Generator(np.random.Philox(5))
    rows = {f"{i}": [hits(share, 6000, rng=rng) for share in 0.5 + 0.05 * rng.standard_normal(3)] for i in range(8)}
    variance = np.mean([np.var(over_repeats(runs, "pckh", resamples=0).each, ddof=1) for runs in rows.values()])
    found = row_differences(rows | {"one": [rows["0"][0]]}, "pckh")
    halves = {pair: (each.high - each.low) / 2 for pair, each in found.items()}
    assert np.mean([half for pair, half in halves.items() if "one" not in pair]) == pytest.approx(
        1.96 * np.sqrt(2 / 3 * variance), rel=0.1
    )
    assert halves["one", "3"] == pytest.approx(1.96 * np.sqrt(4 / 3 * variance), rel=0.1)


def test_a_repeat_that_differs_makes_nothing_sure_of_its_row() -> None:
    rng = np.random.Generator(np.random.Philox(6))
    far, near = [hits(share, 5000, rng=rng) for share in (0.3, 0.9)], [hits(0.55, 5000, rng=rng) for _ in range(2)]
    assert not row_differences({"far": far, "near": near}, "pckh")["far", "near"].sure
    assert row_differences({"far": far[:1], "near": near[:1]}, "pckh")["near", "far"].sure
    assert row_differences({}, "pckh") == {}


def test_parts_are_pooled_over_frames() -> None:
    confusion = np.array([[[90, 0, 0], [0, 5, 5], [0, 0, 10]], [[80, 10, 0], [0, 10, 0], [10, 0, 0]]])
    none, joints = np.zeros(0), np.zeros((0, 1))
    run = ModelErrors(np.arange(2), np.zeros(0, np.int64), joints, joints, joints, none, none, joints, confusion)
    found = over_repeats([run], "iou", resamples=0)
    assert found.value == pytest.approx(100 * (15 / 30 + 10 / 25) / 2)  # 15 of 20 true and 25 found; 10 of 20 and 15
    assert over_repeats([run], "person_iou", resamples=0).value == pytest.approx(100 * 30 / 50)


def test_datasets_follow_each_other() -> None:
    rng = np.random.Generator(np.random.Philox(3))
    one, two = hits(0.5, 100, rng=rng), hits(0.9, 300, rng=rng)
    both = joined_errors([one, two])
    each = [over_repeats([run], "pckh", resamples=0).value for run in (one, two, both)]
    assert each[2] == pytest.approx((100 * each[0] + 300 * each[1]) / 400)
    assert both.at.tolist() == list(range(400))

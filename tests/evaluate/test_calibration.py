"""Reliability, risk and coverage, expected errors: by hand, against scikit-learn and scipy, and from end to end by loops."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import xarray as xr
from scipy.stats import spearmanr
from sklearn.calibration import calibration_curve

from cabinpose.core.pose import Visibility
from cabinpose.evaluate.calibration import Confidence, _rank_correlation, reliability
from cabinpose.evaluate.offline import evaluate
from cabinpose.evaluate.options import EvaluationOptions
from cabinpose.evaluate.report import Report
from cabinpose.store.predictions import Predictions

TENTHS = np.linspace(0, 1, 11)
OPTIONS = EvaluationOptions(resamples=0, hit_m=0.08)


def test_by_hand() -> None:
    bins = reliability(np.array([0.05, 0.95, 0.9, 1.0]), np.array([0.0, 1, 0, 1]), TENTHS)
    assert bins.samples.tolist() == [1, 3]
    np.testing.assert_allclose(bins.said, [0.05, 0.95])
    np.testing.assert_allclose(bins.was, [0, 2 / 3])
    assert bins.error == pytest.approx((1 * 0.05 + 3 * (0.95 - 2 / 3)) / 4)
    assert np.isnan(reliability(np.zeros(0), np.zeros(0), TENTHS).error)


def test_bins_are_those_of_scikit_learn() -> None:
    rng = np.random.default_rng(3)
    said = rng.random(500) ** 2
    was = (rng.random(500) < said**0.5).astype(float)
    share, mean = calibration_curve(was, said, n_bins=10)
    bins = reliability(said, was, TENTHS)
    np.testing.assert_allclose(bins.was, share)
    np.testing.assert_allclose(bins.said, mean)


def test_ranks_are_those_of_scipy() -> None:
    rng = np.random.default_rng(4)
    a, b = rng.integers(0, 6, 80).astype(float), rng.integers(0, 9, 80).astype(float)
    a[rng.random(80) < 0.1] = np.inf
    assert _rank_correlation(a, b) == pytest.approx(spearmanr(a, b).statistic)
    assert np.isnan(_rank_correlation(np.ones(5), b[:5]))
    assert np.isnan(_rank_correlation(a[:0], b[:0]))


def test_the_surest() -> None:
    curve = Confidence(np.array([1.0, 3, 2, 10]), np.full(4, np.nan), 0.0).of_surest(2.5)
    of = {kept: row for kept, *row in zip(*curve.values(), strict=True)}
    assert of[25] == [1, 1, 100]
    assert of[30] == of[50] == [2, 2, 50]
    assert of[75] == [2, 2, pytest.approx(200 / 3, abs=1e-3)]
    assert of[100] == [2.5, 4, 50]
    assert Confidence(*[np.zeros(0)] * 2, np.nan).of_surest(1.0)["kept"] == []


def judged(dataset: xr.Dataset, predictions: Predictions) -> list[tuple[float, bool, bool, float]]:
    """Of each joint with a position: presence, whether it is in the image, and whether within 8 cm or 26 px; its 3D error."""
    found = []
    names = "visibility", "joints_2d", "joints_3d"
    state, two, three = (dataset[name].transpose("frame", "person", "joint", ...).values for name in names)  # read once
    persons, joints = dataset["person"].values.tolist(), dataset["joint"].values.tolist()
    for f in range(dataset.sizes["frame"]):
        for p, person in enumerate(predictions.persons):
            for j, joint in enumerate(predictions.joints):
                uv, xyz = predictions.joints_2d[f, p, j], predictions.joints_3d[f, p, j]
                true = f, persons.index(person), joints.index(joint)
                inside = int(state[true]) > Visibility.OUTSIDE_IMAGE
                error = float(np.linalg.norm(xyz - three[true]))
                pixels = float(np.linalg.norm(uv - two[true]))
                near = error <= 0.08 if np.isfinite(xyz).all() else pixels <= 26
                if np.isfinite(uv).all() or np.isfinite(xyz).all():
                    found.append((float(predictions.presence[f, p, j]), inside, inside and near, error))
    return found


def test_presence_is_held_against_every_answer(dataset: xr.Dataset, predictions: Predictions) -> None:
    """Improbable joints too, those of people who are not there, and those outside of the image, however near."""
    dataset = dataset.load()
    dataset["visibility"].values[:, :, ::3] = np.minimum(dataset["visibility"].values[:, :, ::3], Visibility.OUTSIDE_IMAGE)
    empty = (dataset["visibility"].sel(person=list(predictions.persons)).values == Visibility.ABSENT).all(axis=-1)
    predictions = replace(predictions, presence=np.where(empty[..., None], 0.4, 1).astype(np.float32) * predictions.presence)
    wanted = judged(dataset, predictions)
    report = evaluate(dataset, predictions, OPTIONS)
    assert report.calibration["presence"].keys() == report.joint_sets.keys()
    for kind, column, metric in (("in_image", 1, "ECE of presence"), ("within", 2, "ECE of presence@d")):
        bins = report.calibration["presence"]["All"][kind]
        off = total = 0.0
        for low in range(10):
            of_bin = [row for row in wanted if min(int(row[0] * 10), 9) == low]
            if of_bin:
                said, was = np.mean([row[0] for row in of_bin]), np.mean([row[column] for row in of_bin])
                i = int(np.abs(np.array(bins["said"]) - said).argmin())
                assert (bins["samples"][i], bins["was"][i]) == (len(of_bin), pytest.approx(was, abs=1e-5))
                off, total = off + len(of_bin) * abs(said - was), total + len(of_bin)
        value = report.value(metric, "image")
        assert value is not None
        assert (value.samples, value.value) == (total, pytest.approx(100 * off / total))


def with_expected(predictions: Predictions, dataset: xr.Dataset, factor: float) -> Predictions:
    true = dataset.sel(person=list(predictions.persons), joint=list(predictions.joints))
    error = np.linalg.norm(predictions.joints_3d - true["joints_3d"].values, axis=-1)
    return replace(predictions, expected_error_m=(factor * error).astype(np.float32))


def numbers(report: Report, metric: str) -> float:
    value = report.value(metric, "3d")
    assert value is not None
    return value.value


def test_an_expected_error_that_is_the_error(dataset: xr.Dataset, predictions: Predictions) -> None:
    """It orders the joints before the score does, and is off by nothing; one that is twice as large by the mean error."""
    right, double = (evaluate(dataset, with_expected(predictions, dataset, factor), OPTIONS) for factor in (1, 2))
    doubt, off = "rank correlation of doubt and error", "calibration error of the expected error"
    assert numbers(right, doubt) == numbers(double, doubt) == pytest.approx(1)
    assert numbers(right, off) == pytest.approx(0, abs=1e-5)
    assert numbers(double, off) == pytest.approx(numbers(right, "MPJPE"), rel=1e-5)
    means = right.calibration["surest"]["3d"]["All"]["mean"]
    assert means == sorted(means)
    assert means[-1] == pytest.approx(numbers(right, "MPJPE"), abs=1e-4)
    by_score = evaluate(dataset, predictions, OPTIONS)
    assert abs(numbers(by_score, doubt)) < 0.5
    assert by_score.value(off) is None
    assert by_score.calibration["expected_error"] == {}


def test_an_expected_error_is_judged_by_joint(dataset: xr.Dataset, predictions: Predictions) -> None:
    """One that is right but of one joint, where it is half as large again, is off there alone, by half of its mean error."""
    expected = with_expected(predictions, dataset, 1.0)
    expected.expected_error_m[:, :, 1] *= 1.5
    name, off = predictions.joints[1], "calibration error of the expected error"
    report = evaluate(dataset, expected, OPTIONS)
    for joint in predictions.joints:
        value, mean = report.value(off, "3d", joint), report.value("MPJPE", "3d", joint)
        assert value is not None
        assert mean is not None
        assert value.value == pytest.approx(0.5 * mean.value if joint == name else 0.0, rel=1e-4, abs=1e-5)
        assert sum(report.calibration["expected_error"][joint]["samples"]) == value.samples
    assert report.calibration["surest"]["3d"].keys() == report.joint_sets.keys()

"""Every metric against a plain loop over frames, people and joints that follows its definition word by word."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import xarray as xr
from hypothesis import given, settings
from hypothesis import strategies as st

from cabinpose.core.errors import ConfigError
from cabinpose.core.ports import PoseBatch
from cabinpose.core.pose import Visibility
from cabinpose.core.skeleton import CABINPOSE, Skeleton
from cabinpose.evaluate import bootstrap
from cabinpose.evaluate.bootstrap import frame_weights, interval, weighted_quantiles, weighted_sums
from cabinpose.evaluate.offline import evaluate
from cabinpose.evaluate.options import EvaluationOptions
from cabinpose.evaluate.report import Report, make_report
from cabinpose.evaluate.samples import TruthChunk, collect
from cabinpose.store.predictions import Predictions

OPTIONS = EvaluationOptions(resamples=0)
PX, M = ("2d", 1.0, 26.0, 26.0), ("3d", 100.0, 0.1, 0.2)  # space, report unit in one, d, head size


def cells(dataset: xr.Dataset, predictions: Predictions, joints: tuple[str, ...], space: str) -> list[dict[str, object]]:
    """Frame by frame, person by person, joint by joint: what is true and what was said."""
    name = f"joints_{space}"
    states, places = (dataset[of].transpose("frame", "person", "joint", ...).values for of in ("visibility", name))  # read once
    every = dataset["joint"].values.tolist()
    found = []
    for f, number in enumerate(dataset["frame"].values):
        for at, person in enumerate(dataset["person"].values):
            for joint in joints:
                true = f, at, every.index(joint)
                i, p, j = (
                    predictions.frame.tolist().index(number),
                    predictions.persons.index(person),
                    predictions.joints.index(joint),
                )
                said = getattr(predictions, name)[i, p, j]
                there = bool(np.isfinite(said).all() and predictions.presence[i, p, j] >= 0.5)
                state = int(states[true])
                error = float(np.linalg.norm(said.astype(float) - places[true])) if there and state >= 2 else None
                found.append({"joint": joint, "state": state, "found": there, "error": error})
    return found


def check(report: Report, metric: str, space: str, joints: str, expected: float, threshold: float | None = None) -> None:
    value = report.value(metric, space, joints, threshold)
    assert value is not None
    assert value.value == pytest.approx(expected, rel=1e-5, abs=1e-5), (metric, space, joints)


@pytest.mark.parametrize(("space", "unit", "hit", "head"), [PX, M])
@pytest.mark.parametrize("group", ["All", "Wrist", "Shoulder", "lhand"])
def test_against_loops(
    dataset: xr.Dataset, predictions: Predictions, space: str, unit: float, hit: float, head: float, group: str
) -> None:
    report = evaluate(dataset, predictions, OPTIONS)
    members = {"All": CABINPOSE.sets["upper body"]}.get(group) or CABINPOSE.groups.get(group) or (group,)
    every = cells(dataset, predictions, tuple(members), space)
    true = [c for c in every if c["state"] >= 2]
    errors = np.array([c["error"] for c in true if c["found"]], float)
    assert 0 < len(errors) < len(true)
    for t in (26.0,) if space == "2d" else (0.05, 0.1, 0.15, 0.2):
        check(report, "PCK", space, group, 100 * (errors <= t).sum() / len(true), t * unit)
    for alpha in (0.5, 1.0):
        check(report, "PCKh", space, group, 100 * (errors <= alpha * head).sum() / len(true), alpha)
    alphas = (np.arange(20000) + 0.5) / 40000  # midpoints of [0, 0.5]
    area = np.mean([(errors <= a * head).sum() / len(true) for a in alphas])
    value = report.value("AUC of PCKh", space, group)
    assert value is not None
    assert value.value == pytest.approx(100 * area, abs=0.01)
    assert value.samples == len(true)
    check(report, "mean error" if space == "2d" else "MPJPE", space, group, unit * errors.mean())
    check(report, "median error", space, group, unit * np.median(errors))
    check(report, "P95 of the error", space, group, unit * np.quantile(errors, 0.95))
    check(report, "mean error of hits", space, group, unit * errors[errors <= hit].mean())
    check(report, "found", space, group, 100 * len(errors) / len(true))
    rows = []
    for joint in members:
        mine = [c for c in every if c["joint"] == joint]
        e = np.array([c["error"] for c in mine if c["error"] is not None], float)
        near, there = (e <= hit).sum(), sum(c["state"] >= 2 for c in mine)
        false = sum(c["found"] and c["state"] < 2 for c in mine)
        rows.append((e.mean(), e[e <= hit].mean(), near / (near + false), near / len(e), near / there, len(e) / there))
    mad, mad_d, literal, among, mar_literal, mar = np.mean(rows, axis=0)
    check(report, "mAD", space, group, unit * mad)
    check(report, "mAD@d", space, group, unit * mad_d)
    check(report, "mAP@d (literal)", space, group, 100 * literal)
    check(report, "mAP@d (among detected)", space, group, 100 * among)
    check(report, "mAR@d (literal)", space, group, 100 * mar_literal)
    check(report, "mAR (detected)", space, group, 100 * mar)


@pytest.mark.parametrize("state", [Visibility.VISIBLE, Visibility.SELF_OCCLUDED, Visibility.OCCLUDED])
def test_by_visibility(dataset: xr.Dataset, predictions: Predictions, state: Visibility) -> None:
    report = evaluate(dataset, predictions, OPTIONS)
    mine = [c for c in cells(dataset, predictions, CABINPOSE.sets["upper body"], "3d") if c["state"] == state]
    value = report.value("PCK", "3d", "All", 5.0, visibility=state.name.lower())
    assert value is not None
    assert value.samples == len(mine)
    near = sum(c["error"] is not None and c["error"] <= 0.05 for c in mine)
    assert value.value == pytest.approx(100 * near / len(mine))


def test_joints_without_a_place_in_space_count_in_the_image_alone(dataset: xr.Dataset, predictions: Predictions) -> None:
    """As of labels in images that were lifted by the depth: hidden joints have no 3D."""
    hidden = (dataset["visibility"] != Visibility.VISIBLE) & (dataset["visibility"] != Visibility.ABSENT)
    lifted = dataset.assign(joints_3d=dataset["joints_3d"].where(~hidden))
    before, report = (evaluate(given, predictions, OPTIONS) for given in (dataset, lifted))
    for metric in ("mean error", "found"):
        value = before.value(metric, "2d", "All")
        assert value is not None
        check(report, metric, "2d", "All", value.value)
    seen = [c for c in cells(dataset, predictions, CABINPOSE.sets["upper body"], "3d") if c["state"] == Visibility.VISIBLE]
    errors = np.array([c["error"] for c in seen if c["found"]], float)
    assert 0 < len(errors) < len(seen)
    check(report, "PCK", "3d", "All", 100 * (errors <= 0.1).sum() / len(seen), 10.0)
    check(report, "MPJPE", "3d", "All", 100 * errors.mean())
    check(report, "found", "3d", "All", 100 * len(errors) / len(seen))


def test_min_visibility_leaves_joints_out(dataset: xr.Dataset, predictions: Predictions) -> None:
    every = cells(dataset, predictions, CABINPOSE.sets["upper body"], "3d")
    counts = {}
    for least in (Visibility.OCCLUDED, Visibility.SELF_OCCLUDED, Visibility.VISIBLE):
        report = evaluate(dataset, predictions, replace(OPTIONS, min_visibility=least))
        value = report.value("PCK", "3d")
        assert value is not None
        counts[least] = value.samples
        assert value.samples == sum(c["state"] >= least for c in every)
        precision = report.value("presence precision", "image")
        assert precision is not None
        assert precision.samples <= sum(c["state"] >= least or c["state"] < 2 for c in every)
    assert len(set(counts.values())) == 3


def test_presence(dataset: xr.Dataset, predictions: Predictions) -> None:
    report = evaluate(dataset, predictions, OPTIONS)
    two, three = (cells(dataset, predictions, CABINPOSE.sets["upper body"], space) for space in ("2d", "3d"))
    said = [(a["found"] or b["found"], a["state"]) for a, b in zip(two, three, strict=True)]
    right = sum(found and state >= 2 for found, state in said)
    check(report, "presence precision", "image", "All", 100 * right / sum(found for found, _ in said))
    check(report, "presence recall", "image", "All", 100 * right / sum(state >= 2 for _, state in said))


# -------------------------------------------------------------------------------------------------------- by hand


def chunk(truth: np.ndarray, visibility: np.ndarray, predicted: np.ndarray) -> tuple[TruthChunk, PoseBatch]:
    """A chunk in 3D alone from (F, P, J, 3) arrays."""
    frames = len(truth)
    nothing = np.full((*truth.shape[:-1], 2), np.nan, np.float32)
    there = np.isfinite(predicted).all(-1).astype(np.float32)
    number = np.arange(frames)
    return (
        TruthChunk(number, nothing, truth.astype(np.float32), visibility.astype(np.uint8), np.zeros(frames, int), number),
        PoseBatch(nothing, predicted.astype(np.float32), there, there),
    )


def reported(skeleton: Skeleton, *chunks: tuple[TruthChunk, PoseBatch], **changed: object) -> Report:
    persons = tuple(f"p{i}" for i in range(chunks[0][0].visibility.shape[1]))
    options = replace(OPTIONS, **changed)  # type: ignore[arg-type]
    return make_report(collect(chunks, skeleton, persons, persons, options), options, "m", "d")


def test_errors_are_pooled_not_averaged_twice() -> None:
    """Three joints off by 1 cm in one frame, one off by 9 cm in another: the mean is 3 cm, not the 5 cm of the frames' means."""
    skeleton = CABINPOSE.subset(("head", "neck", "chest"))
    truth = np.zeros((2, 1, 3, 3)) + (0, 0, 2)
    predicted = truth.copy()
    predicted[0, ..., 0] += 0.01
    predicted[1, 0, 0, 0] += 0.09
    visibility = np.array([[[4, 4, 4]], [[4, 0, 0]]])
    report = reported(skeleton, chunk(truth, visibility, predicted))
    check(report, "MPJPE", "3d", "All", 3.0)
    check(report, "mAD", "3d", "All", np.mean([5.0, 1.0, 1.0]))  # the thesis' way: joint by joint


def test_a_person_not_found_is_missed_and_one_not_there_is_false() -> None:
    skeleton = CABINPOSE.subset(("head", "neck"))
    truth = np.zeros((1, 3, 2, 3)) + (0, 0, 2)
    visibility = np.array([[[4, 4], [4, 4], [0, 0]]])
    predicted = truth.copy()
    predicted[0, 1] = np.nan
    report = reported(skeleton, chunk(truth, visibility, predicted))
    check(report, "PCK", "3d", "All", 50)
    check(report, "presence precision", "image", "Person", 50)
    check(report, "presence recall", "image", "Person", 50)
    check(report, "mAP@d (literal)", "3d", "All", 50)
    check(report, "mAP@d (among detected)", "3d", "All", 100)
    assert report.worst == (0,)


def test_a_joint_found_too_far_away_is_no_recall_by_the_formula_and_one_as_detected() -> None:
    skeleton = CABINPOSE.subset(("head",))
    truth = np.zeros((4, 1, 1, 3)) + (0, 0, 2)
    predicted = truth.copy()
    predicted[1] += (0.5, 0, 0)  # found, half a metre off: FN
    predicted[2] = np.nan  # not found: FN
    visibility = np.array([4, 4, 4, 0]).reshape(4, 1, 1)  # the last has no true joint: FP
    report = reported(skeleton, chunk(truth, visibility, predicted))
    check(report, "mAR@d (literal)", "3d", "All", 100 / 3)
    check(report, "mAR (detected)", "3d", "All", 200 / 3)
    check(report, "mAP@d (literal)", "3d", "All", 50)


def test_typical_frames_lie_around_the_median_and_worst_ones_at_the_end() -> None:
    skeleton = CABINPOSE.subset(("head", "neck"))
    truth = np.zeros((40, 1, 2, 3)) + (0, 0, 2)
    order = np.random.default_rng(5).permutation(40)  # of the errors
    predicted = truth + 0.001 * (1 + order[:, None, None, None]) * np.array((1.0, 0, 0))
    report = reported(skeleton, chunk(truth, np.full((40, 1, 2), 4), predicted))
    assert [order[i] for i in report.worst] == list(range(39, 27, -1))
    assert [order[i] for i in report.typical] == list(range(14, 26))


def test_the_true_head_size() -> None:
    skeleton = CABINPOSE.subset(("head", "neck", "lwrist"))
    truth = np.array([[[[0, 0, 2], [0, 0.16, 2], [0.5, 0, 2]]]], float)
    predicted = truth + (0.09, 0, 0)
    visibility = np.full((1, 1, 3), 4)
    check(reported(skeleton, chunk(truth, visibility, predicted)), "PCKh", "3d", "All", 100, 0.5)
    true = reported(skeleton, chunk(truth, visibility, predicted), head="true")
    check(true, "PCKh", "3d", "All", 0, 0.5)
    check(true, "PCKh", "3d", "All", 100, 1.0)
    value = true.value("PCKh", "3d")
    assert value is not None
    assert value.threshold_unit == "true head-neck length"


@settings(max_examples=15)
@given(st.integers(0, 10**6), st.integers(1, 9))
def test_chunks_do_not_matter(seed: int, cut: int) -> None:
    """Any cut of the frames into chunks gives the same report, jitter over the cut included."""
    rng = np.random.default_rng(seed)
    skeleton = CABINPOSE.subset(("neck", "lshoulder", "rshoulder", "lelbow", "relbow"))
    truth = rng.normal((0, 0, 2), 0.3, (10, 2, 5, 3))
    predicted = truth + rng.normal(0, 0.1, truth.shape)
    predicted[rng.random(predicted.shape[:-1]) < 0.1] = np.nan
    visibility = rng.integers(0, 5, (10, 2, 5))
    whole, batch = chunk(truth, visibility, predicted)
    halves = [(TruthChunk(*(v[s] for v in whole)), batch.map(lambda v, s=s: v[s])) for s in (slice(0, cut), slice(cut, None))]
    one, two = reported(skeleton, (whole, batch)), reported(skeleton, *halves)
    for a, b in zip(one.values, two.values, strict=True):
        assert (a.metric, a.samples) == (b.metric, b.samples)
        assert a.value == pytest.approx(b.value, nan_ok=True)
    jitter = one.value("jitter")
    assert jitter is not None
    both = np.isfinite(predicted).all(-1) & (visibility >= 2)
    assert jitter.samples == (both[2:] & both[1:-1] & both[:-2]).sum()


def test_jitter_of_white_noise() -> None:
    """The second difference of noise has 6 times its variance, and a 3D Gaussian the mean length sqrt(8 / pi) sigma."""
    rng = np.random.default_rng(3)
    truth = np.zeros((5000, 1, 2, 3)) + (0, 0, 2)
    predicted = truth + rng.normal(0, 0.01, truth.shape)
    report = reported(CABINPOSE.subset(("head", "neck")), chunk(truth, np.full((5000, 1, 2), 4), predicted))
    value = report.value("jitter")
    assert value is not None
    assert value.value == pytest.approx(np.sqrt(6) * np.sqrt(8 / np.pi), rel=0.02)


@pytest.mark.parametrize(
    ("changed", "measured"),
    [
        ({}, 4),
        ({"frame": [0, 1, 2, 4, 5, 6]}, 2),
        ({"sequence": [0, 0, 0, 0, 1, 1]}, 2),
        ({"sync_ns": [0, 0, 0, 0, 0, 0]}, 0),
    ],
)
def test_jitter_only_where_frames_follow_each_other(changed: dict[str, list[int]], measured: int) -> None:
    truth = np.zeros((6, 1, 1, 3)) + (0, 0, 2)
    whole, batch = chunk(truth, np.full((6, 1, 1), 4), truth)
    whole = whole._replace(**{name: np.array(values) for name, values in changed.items()})
    value = reported(CABINPOSE.subset(("head",)), (whole, batch)).value("jitter")
    assert value is not None
    assert value.samples == measured


# ------------------------------------------------------------------------------------------------------ bootstrap


def test_resamples_are_drawn_frames(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(bootstrap, "_BLOCK", 7)
    rng = np.random.default_rng(0)
    values, weights = rng.normal(size=(30, 2)), frame_weights(np.arange(30), 50, rng=rng)
    assert (weights.sum(axis=1) == 30).all()
    for weight, total in zip(weights, weighted_sums(weights, values), strict=True):
        assert np.allclose(np.repeat(values, weight, axis=0).sum(axis=0), total)
    at = rng.integers(0, 30, 101)
    errors, shares = rng.random(101), np.array([0.5, 0.95])
    for weight, found in zip(weights, weighted_quantiles(errors, at, weights, shares), strict=True):
        assert np.allclose(np.quantile(np.repeat(errors, weight[at]), shares, method="inverted_cdf"), found)


def test_interval_is_that_of_the_mean() -> None:
    """For a mean of many independent frames the interval is ±1.96 standard errors."""
    rng = np.random.default_rng(1)
    values = rng.exponential(1, (4000, 1))
    means = weighted_sums(frame_weights(np.arange(4000), 2000, rng=rng), values) / 4000
    low, high = interval(means)
    error = values.std() / np.sqrt(4000)
    assert low[0] == pytest.approx(values.mean() - 1.96 * error, abs=0.15 * error)
    assert high[0] == pytest.approx(values.mean() + 1.96 * error, abs=0.15 * error)


def test_intervals_come_from_the_seed(dataset: xr.Dataset, predictions: Predictions) -> None:
    one, again, other = (
        evaluate(dataset, predictions, EvaluationOptions(resamples=40, seed=seed)).to_dict()["values"] for seed in (3, 3, 4)
    )
    assert repr(one) == repr(again)
    assert repr(one) != repr(other)


@pytest.mark.parametrize(
    "wrong",
    [{"presence": 1.5}, {"pckh": (0.0,)}, {"pck_m": (-0.1,)}, {"resamples": -1}, {"min_visibility": Visibility.ABSENT}],
)
def test_senseless_options(wrong: dict[str, object]) -> None:
    with pytest.raises(ConfigError) as caught:
        EvaluationOptions(**wrong)  # type: ignore[arg-type]
    assert caught.value.hint

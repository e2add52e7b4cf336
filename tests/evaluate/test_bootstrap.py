"""What the bootstrap draws, and that its intervals hold the truth where frames of a sequence resemble each other."""

from __future__ import annotations

import numpy as np
import pytest
import xarray as xr
from scipy import stats

from cabinpose.evaluate.bootstrap import clusters_of, frame_weights, interval, weighted_sums
from cabinpose.evaluate.offline import samples_of
from cabinpose.evaluate.options import EvaluationOptions
from cabinpose.evaluate.repeats import ModelErrors, errors_of, joined_errors, over_repeats
from cabinpose.evaluate.report import make_report
from cabinpose.store.predictions import Predictions


def clusters(sequence: list[int], sync_ns: list[int]) -> list[int]:
    return clusters_of(np.array(sequence), np.array(sync_ns)).tolist()


def test_frames_are_drawn_with_their_sequence() -> None:
    assert clusters([3, 3, 5, 5], [0, 10, 0, 10]) == [0, 0, 1, 1]
    assert clusters([0, 0, 0], [0, 0, 0]) == [0, 1, 2]  # of no time: single frames
    assert clusters([7, 8, 9], [0, 0, 0]) == [0, 1, 2]
    mixed = clusters([2, 2, 4, 4, 4], [0, 5, 1, 1, 1])
    assert mixed[0] == mixed[1]
    assert len(set(mixed)) == 4
    assert clusters([1] * 9, list(range(9))) == [0, 0, 0, 1, 1, 1, 2, 2, 2]  # a single one: stretches
    assert clusters([], []) == []


def test_a_cluster_is_drawn_as_a_whole() -> None:
    cluster = np.array([0, 0, 1, 2, 2, 2])
    weights = frame_weights(cluster, 200, rng=np.random.default_rng(0))
    assert (weights[:, 0] == weights[:, 1]).all()
    assert (weights[:, 3] == weights[:, 5]).all()
    assert (weights[:, [0, 2, 3]].sum(axis=1) == 3).all()  # as many clusters as there are


def correlated(sequences: int, frames: int, spread: float, *, rng: np.random.Generator) -> np.ndarray:
    """(S, F) values of mean 0: the sum of one of the sequence, of variance spread², and one of the frame, of variance 1."""
    return spread * rng.standard_normal((sequences, 1)) + rng.standard_normal((sequences, frames))


@pytest.mark.parametrize(("sequences", "trials", "holds"), [(5, 1000, 0.845), (20, 500, 0.929)])
def test_intervals_hold_the_truth_as_often_as_they_say(sequences: int, trials: int, holds: float) -> None:
    """Percentiles over S sequences of normal means are at ± z sqrt((S - 1) / S) s / sqrt(S): Student's t tells how often."""
    rng, frames = np.random.default_rng(sequences), 8
    values = correlated(sequences * trials, frames, 1.0, rng=rng).reshape(trials, -1).T  # a trial a column
    shares = []
    for cluster in (np.repeat(np.arange(sequences), frames), np.arange(sequences * frames)):
        low, high = interval(weighted_sums(frame_weights(cluster, 500, rng=rng), values))
        shares.append(float(np.mean((low <= 0.0) & (high >= 0.0))))
    z = stats.norm.ppf(0.975) * np.sqrt((sequences - 1) / sequences)
    expected = 1 - 2 * stats.t.sf(z, sequences - 1)
    assert expected == pytest.approx(holds, abs=0.002)
    assert shares[0] == pytest.approx(expected, abs=0.04)
    assert shares[1] < 0.70  # drawn one by one they hold it far too seldom


def test_the_width_is_that_of_the_clustered_standard_error() -> None:
    """The sandwich of Liang and Zeger for a mean: sqrt of the sum over clusters of their squared sums of residuals, over N."""
    rng = np.random.default_rng(4)
    values = correlated(150, 12, 0.8, rng=rng)
    cluster = np.repeat(np.arange(150), 12)
    residuals = (values - values.mean()).sum(axis=1)
    error = np.sqrt((residuals**2).sum()) / values.size
    found = interval(weighted_sums(frame_weights(cluster, 3000, rng=rng), values.reshape(-1, 1)) / values.size)
    assert (found[1][0] - found[0][0]) / 2 == pytest.approx(1.96 * error, rel=0.08)


def test_every_report_draws_sequences(dataset: xr.Dataset, predictions: Predictions) -> None:
    """The evaluation's numbers and those over repeats: whole sequences in both."""
    frames = dataset.sizes["frame"]
    moving = dataset.assign_coords(
        sequence=("frame", np.arange(frames) // 2), sync_ns=("frame", 10_000_000 * np.arange(frames, dtype=np.int64))
    )
    options = EvaluationOptions(resamples=50)
    for data, count in (
        (dataset.assign_coords(sync_ns=("frame", np.zeros(frames, np.int64))), frames),
        (moving, -(-frames // 2)),
    ):
        samples, _ = samples_of(data, predictions, options)
        assert make_report(samples, options, "m", "d").settings["clusters"] == count
        assert len(np.unique(errors_of(samples).cluster)) == count


def test_sequences_of_two_datasets_are_apart() -> None:
    none = np.zeros((0, 0, 0), np.int64)
    error, head = np.array([[0.0], [0.0], [9.0], [9.0]]), np.ones(4)
    run = ModelErrors(np.array([0, 0, 1, 1]), np.arange(4), error, error, error * np.nan, head, head, error * np.nan, none)
    both = joined_errors([run, run])
    assert both.cluster.tolist() == [0, 0, 1, 1, 2, 2, 3, 3]
    whole = over_repeats([run], "pckh", resamples=2000, seed=1)
    assert (whole.low, whole.high) == (0.0, 100.0)  # two sequences: one of four draws has the worse one alone

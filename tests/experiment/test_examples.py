"""Which frames the page of an experiment shows: by a rule, each kind against made errors."""

from __future__ import annotations

import numpy as np

from cabinpose.app.experiment.examples import BODY, GOOD, ONE_JOINT, chosen_frames, what_fails
from cabinpose.evaluate.repeats import ModelErrors


def made(rows: list[list[float]], cluster: list[int] | None = None) -> ModelErrors:
    """A person a frame, errors in px of heads of 10 px."""
    error = np.array(rows)
    count = len(rows)
    apart = np.arange(count) if cluster is None else np.array(cluster)
    return ModelErrors(
        apart, np.arange(count), error, error / 100, error * np.nan, np.full(count, 10.0), np.full(count, 0.1), error * np.nan,
        np.zeros((0, 0, 0), np.int64),
    )  # fmt: skip


ROWS = [
    [1.0, 1.0, 1.0, 1.0],  # good
    [4.0, 5.0, 5.0, np.nan],  # good, the last joint does not count
    [2.0, 2.0, 3.0, 3.0],  # good, at the median
    [1.0, 1.0, 12.0, 1.0],  # one joint
    [1.0, np.inf, 1.0, 1.0],  # one joint, not found
    [1.0, 8.0, 1.0, 1.0],  # one joint, nearer
    [20.0, 20.0, 1.0, 1.0],  # a body
    [np.inf, np.inf, np.inf, 15.0],  # a body, worse
    [np.nan, np.nan, np.nan, np.nan],  # nothing counts
]


def test_the_rule() -> None:
    for space in ("2d", "3d"):
        assert chosen_frames(made(ROWS), space) == {GOOD: [2, 0, 1], ONE_JOINT: [4, 3, 5], BODY: [7, 6]}


def test_what_is_wrong_is_said() -> None:
    told = [what_fails(made(ROWS), "abcd", position, "2d") for position in range(len(ROWS))]
    assert told == [
        "", "", "", "c 1.2 heads off", "b not found", "b 0.8 heads off", "b 2.0 heads off, a 2.0 heads off",
        "c not found, b not found, a not found and 1 more", "",
    ]  # fmt: skip


def test_of_a_sequence_one_frame_and_of_frames_alike_the_first() -> None:
    same = [[1.0, 12.0, 1.0]] * 6
    assert chosen_frames(made(same, [0, 0, 1, 1, 2, 2]), "2d")[ONE_JOINT] == [0, 2, 4]
    assert len(chosen_frames(made([[1.0]] * 40), "2d")[GOOD]) == 8

"""Box plots: quartiles, whiskers and outliers beside matplotlib's, the ranges, and the picture that is drawn of them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from matplotlib.cbook import boxplot_stats
from PIL import Image

from cabinpose.app.cli.evaluate import write_boxes
from cabinpose.app.report.charts import COLOURS, box_chart
from cabinpose.app.report.raster import write_png
from cabinpose.evaluate.boxes import FOUND, Box, box_of, boxes_by_range
from cabinpose.evaluate.itop import evaluate_itop
from cabinpose.evaluate.options import EvaluationOptions
from cabinpose.store.itop import ItopReference


@pytest.mark.parametrize("count", [1, 2, 5, 300])
def test_boxes_are_those_of_matplotlib(count: int) -> None:
    values = np.random.default_rng(count).lognormal(sigma=1.0, size=count).round(4)
    box = box_of(values)
    [theirs] = boxplot_stats(values)
    assert box is not None
    ours = box.low, box.lower, box.median, box.upper, box.high
    assert ours == pytest.approx([theirs[k] for k in ("whislo", "q1", "med", "q3", "whishi")], abs=1e-4)
    assert box.outliers == pytest.approx(np.sort(theirs["fliers"]))
    assert (box.samples, box.beyond) == (count, len(theirs["fliers"]))
    assert count < 300 or box.beyond > 5


def test_of_many_outliers_some_are_kept_and_all_counted() -> None:
    box = box_of(np.concatenate((np.full(4000, 1.0), np.linspace(5, 50, 500))))
    assert box is not None
    assert (box.samples, box.beyond, len(box.outliers)) == (4500, 500, 100)
    assert (box.outliers[0], box.outliers[-1]) == (5.0, 50.0)
    assert np.all(np.diff(box.outliers) > 0)


def test_ranges_leave_out_what_is_as_far_as_the_limit() -> None:
    errors = np.array([[1.0, np.nan], [5.0, np.nan], [9.0, np.nan], [10.0, np.nan], [80.0, np.nan]])
    made = boxes_by_range(errors, ("head", "neck"), 10.0, "cm")
    assert {name: {j: box.samples for j, box in by_joint.items()} for name, by_joint in made.items()} == {
        FOUND: {"head": 5}, "< 5 cm": {"head": 1}, "< 10 cm": {"head": 3},
    }  # fmt: skip


@pytest.mark.parametrize("log", [False, True])
def test_the_picture_shows_median_and_outlier_where_the_axis_has_them(tmp_path: Path, log: bool) -> None:
    boxes = {"one": {"head": Box(9, 1.0, 2.0, 3.0, 4.0, 5.0, (10.0,), 1)}}
    write_png(tmp_path / "p.png", [box_chart("t", boxes, log=log, width=200, height=320)])
    picture = np.asarray(Image.open(tmp_path / "p.png"), int)
    assert picture.shape == (640, 400, 3)
    colour = np.array([int(COLOURS[0][i : i + 2], 16) for i in (1, 3, 5)])
    column = picture[:, round(2 * (46 + 140 / 2))]  # the middle of the only joint
    drawn = np.flatnonzero(np.abs(column - colour).max(axis=1) < 60)
    top, bottom = (2 * 30, 2 * (320 - 64))

    def row(value: float) -> float:
        share = (np.log10(value) + 1) / 2 if log else value / 10
        return bottom - share * (bottom - top)

    for value in (3.0, 1.0, 5.0):  # median and both whiskers
        assert np.abs(drawn - row(value)).min() <= 2
    between = (row(9.0), row(6.0))
    assert not ((drawn > between[0]) & (drawn < between[1])).any()
    dot = picture[round(row(10.0)), 2 * 116]
    assert dot[2] > dot[0] + 40  # bluish, half transparent


def test_without_anything_found_there_is_no_picture(tmp_path: Path) -> None:
    truth = np.random.default_rng(0).normal(size=(2, 15, 3)) + (0, 0, 3)
    reference = ItopReference(np.arange(2), truth, np.ones(2, np.bool_))
    options = EvaluationOptions(resamples=0)
    nothing, all_of_it = (evaluate_itop(reference, found, options, model="m", name="n") for found in (truth * np.nan, truth))
    write_boxes(tmp_path, [nothing])
    assert not (tmp_path / "boxes.png").exists()
    write_boxes(tmp_path, [nothing, all_of_it])
    assert (tmp_path / "boxes.png").exists()

"""Metrics by name: the package's own in the order of reports, and what other packages add."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import pytest
import xarray as xr

from cabinpose.app.cli import main
from cabinpose.evaluate import METRICS, EvaluationOptions, Metric, evaluate
from cabinpose.evaluate.metrics import TABLE
from cabinpose.store.predictions import Predictions, write_predictions

OPTIONS = EvaluationOptions(resamples=0)
HANDS = """
import numpy as np
from cabinpose.evaluate import Metric

def of_hands(view):
    hands = np.isin(view.samples.skeleton.joints, ("lhand", "rhand"))
    return view.quantiles(np.where(hands, view.found_errors, np.nan), {"median error of hands": 0.5}, "hands found")

def broken(view):
    raise ValueError("no such thing")

HANDS = Metric("median error of hands", "{length}", "less", of_hands, spaces=("3d",))
BROKEN = Metric("broken", "%", "more", broken)
NO_METRIC = "text"
"""
Install = Callable[..., None]


@pytest.fixture
def install(extension: Callable[..., None]) -> Install:
    """`install(hands="HANDS")`: a package "acme" with the module above, and entry points for what is in it."""
    return lambda **names: extension("acme", {"metrics": names}, HANDS)


def test_our_own_are_registered_in_the_order_of_reports() -> None:
    assert METRICS.names(own=True) == tuple(TABLE)
    for name, metric in TABLE.items():
        assert METRICS[name] is metric


def test_a_metric_of_another_package_is_in_every_report_after_ours(
    install: Install, dataset: xr.Dataset, predictions: Predictions, dataset_folder: Path, tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:  # fmt: skip
    plain = evaluate(dataset, predictions, EvaluationOptions(resamples=20))
    install(hands="HANDS")
    report = evaluate(dataset, predictions, EvaluationOptions(resamples=20))
    assert same(report.values[: len(plain.values)], plain.values)
    added = report.values[len(plain.values) :]
    assert {(v.metric, v.space, v.unit, v.denominator) for v in added} == {("median error of hands", "3d", "cm", "hands found")}
    value, of_group = report.value("median error of hands"), report.value("median error", joints="Hand")
    assert value is not None
    assert of_group is not None
    assert (value.value, value.samples, value.low, value.high) == (of_group.value, of_group.samples, of_group.low, of_group.high)
    file = write_predictions(tmp_path / "a.jsonl", predictions)
    out = tmp_path / "out"
    assert main(["evaluate", str(dataset_folder), "--predictions", str(file), "--resamples", "0", "--out", str(out)]) == 0
    assert "median error of hands 3D" in capsys.readouterr().out
    assert "median error of hands 3D" in (out / "index.html").read_text()
    told = json.loads((out / "report.json").read_text())["models"][0]["values"][-1]
    assert (told["metric"], told["space"]) == ("median error of hands", "3d")


@pytest.mark.parametrize(
    ("names", "message"),
    [
        ({"odd": "BROKEN"}, "the metric 'odd' of acme is left out of the report: ValueError: no such thing"),
        ({"odd": "ABSENT"}, "the metric 'odd' of acme cannot be loaded: AttributeError"),
        ({"odd": "NO_METRIC"}, "the metric 'odd' of acme is not a Metric, but 'text'"),
    ],
)
def test_one_that_fails_is_left_out_with_a_warning(
    install: Install, dataset: xr.Dataset, predictions: Predictions, names: dict[str, str], message: str
) -> None:
    plain = evaluate(dataset, predictions, OPTIONS)
    install(**names, hands="HANDS")
    with pytest.warns(UserWarning, match=message):
        report = evaluate(dataset, predictions, OPTIONS)
    assert same(plain.values, report.values[: len(plain.values)])
    assert report.value("median error of hands") is not None


def test_a_name_of_ours_stays_ours(install: Install, dataset: xr.Dataset, predictions: Predictions) -> None:
    plain = evaluate(dataset, predictions, OPTIONS)
    install(pck="BROKEN")
    with pytest.warns(UserWarning, match="the metric 'pck' of acme is left out: cabinpose has one of this name"):
        report = evaluate(dataset, predictions, OPTIONS)
    assert same(plain.values, report.values)


def same(one: tuple[object, ...], other: tuple[object, ...]) -> bool:
    """Whether values are equal, NaN being NaN."""
    return str(one) == str(other)


@pytest.mark.parametrize("wrong", [{"spaces": ("4d",)}, {"listed_by": ("unit",)}])
def test_a_space_or_an_order_that_there_is_not_is_refused(wrong: dict[str, tuple[str, ...]]) -> None:
    with pytest.raises(ValueError, match=r"x: (4d|unit): not one of"):
        Metric("x", "%", "more", lambda view: (), **wrong)

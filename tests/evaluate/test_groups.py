"""Groups of people: each has the numbers of an evaluation of it alone, and the worst is named as far as it is known."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import xarray as xr

from cabinpose.app.cli import main
from cabinpose.core import ConfigError, DatasetError
from cabinpose.evaluate import EvaluationOptions, evaluate, groupings, read_group_by
from cabinpose.evaluate.groups import GroupBy, Grouping, people_labels
from cabinpose.evaluate.offline import samples_of
from cabinpose.store.predictions import Predictions, write_predictions

OPTIONS = EvaluationOptions(resamples=100, presence=0.0)
PLAIN = replace(OPTIONS, resamples=0)


@pytest.fixture
def many(dataset: xr.Dataset) -> xr.Dataset:
    """The sphere people twenty times, everyone with a stature (m) that is theirs in all frames."""
    frames = dataset.isel(frame=np.tile(np.arange(dataset.sizes["frame"]), 40))
    frames = frames.assign_coords(frame=np.arange(frames.sizes["frame"]))
    stature = 1.5 + 0.02 * np.arange(frames.sizes["frame"])[:, None] % 0.4 + np.zeros(frames.sizes["person"])
    stature[frames["subject"].values == ""] = np.nan
    arrays = {"stature": (("frame", "person"), stature.astype(np.float32), {"units": "m"})}
    return frames.assign_coords(arrays)


def answers(dataset: xr.Dataset, off: np.ndarray) -> Predictions:
    """The truth, with the joints of everybody in a frame moved by `off` (F, P) px and cm."""
    two, three = dataset["joints_2d"].values.copy(), dataset["joints_3d"].values.copy()
    two[..., 0] += off[..., None]
    three[..., 0] += 0.01 * off[..., None]
    score = np.isfinite(two).all(axis=-1).astype(np.float32)
    persons, joints = (tuple(map(str, dataset[name].values)) for name in ("person", "joint"))
    return Predictions(two, three, score, score, dataset["frame"].values, persons, joints, "made")


def grouped(dataset: xr.Dataset, model: Predictions, word: str, options: EvaluationOptions = OPTIONS) -> Grouping:
    samples, _ = samples_of(dataset, model, options)
    (grouping,) = groupings(samples, dataset, [read_group_by(word)], options, [dataset])
    return grouping


@pytest.mark.slow
def test_a_group_has_the_numbers_of_an_evaluation_of_it_alone(many: xr.Dataset) -> None:
    rng = np.random.default_rng(3)
    model = answers(many, rng.gamma(2.0, 8.0, (many.sizes["frame"], many.sizes["person"])))
    for group in grouped(many, model, "seat").groups:
        alone = evaluate(many, model, PLAIN, persons=[group.name])
        assert group.people == alone.people > 0
        for value in group.values:
            theirs = alone.value(value.metric, value.space, value.joints, value.threshold)
            assert theirs is not None
            assert value.value == pytest.approx(theirs.value, nan_ok=True)
            assert value.samples == theirs.samples
    for group in grouped(many, model, "stature=1.6,1.75").groups:
        low, high = {"below 1.6 m": (0, 1.6), "1.6 to 1.75 m": (1.6, 1.75), "1.75 m and more": (1.75, 9)}[group.name]
        inside = (many["stature"] >= np.float32(low)) & (many["stature"] < np.float32(high))
        alone = evaluate(many.isel(frame=inside.any("person").values), model, PLAIN)
        assert group.frames == int(inside.any("person").sum())
        assert group.people == int(inside.sum())
        assert group.training == pytest.approx(100 * int(inside.sum()) / int((many["subject"] != "").sum()))
        (value,) = [v for v in group.values if v.metric == "MPJPE"]
        theirs = alone.value("MPJPE")
        assert theirs is not None
        assert value.value == pytest.approx(theirs.value)
        assert value.low < value.value < value.high


def test_the_worst_group_is_named_and_by_how_much(many: xr.Dataset) -> None:
    tall = many["stature"].values >= np.float32(1.7)
    off = np.where(tall, 20.0, 5.0)  # 13 px are half a head
    worst = grouped(many, answers(many, off), "stature=1.6,1.7").worst
    assert worst is not None
    assert (worst.group, worst.below, worst.low, worst.high) == ("1.7 m and more", 100.0, 100.0, 100.0)
    assert worst.is_certain
    rng = np.random.default_rng(8)
    by_chance = grouped(many, answers(many, np.where(rng.random(off.shape) < 0.5, 20.0, 5.0)), "stature").worst
    assert by_chance is not None
    assert by_chance.below > 0
    assert not by_chance.is_certain


def test_an_interval_of_more_groups_is_wider(many: xr.Dataset) -> None:
    rng = np.random.default_rng(8)
    off = np.where(many["stature"].values >= np.float32(1.8), 20.0, np.where(rng.random(many["stature"].shape) < 0.5, 20.0, 5.0))
    two = grouped(many, answers(many, off), "stature=1.8").worst
    four = grouped(many, answers(many, off), "stature=1.58,1.7,1.8").worst
    assert two is not None
    assert four is not None
    assert (two.group, two.below) == (four.group, four.below)
    assert four.high - four.low > two.high - two.low


def test_too_few_people_are_not_called_the_worst(dataset: xr.Dataset) -> None:
    model = answers(dataset, np.zeros((dataset.sizes["frame"], dataset.sizes["person"])))
    assert grouped(dataset, model, "seat").worst is None


def test_quarters_and_those_who_are_not_known(many: xr.Dataset) -> None:
    model = answers(many, np.zeros((many.sizes["frame"], many.sizes["person"])))
    quarters = grouped(many, model, "stature", PLAIN)
    people = [group.people for group in quarters.groups]
    assert len(people) == 4
    assert max(people) < 1.5 * min(people)
    stature = many["stature"].values.copy()
    stature[:20] = np.nan
    partly = many.assign_coords(stature=(("frame", "person"), stature))
    assert grouped(partly, model, "stature", PLAIN).groups[-1].name == "not known"
    nobody = many.assign_coords(stature=(("frame", "person"), np.full_like(stature, np.nan)))
    with pytest.raises(DatasetError, match="known of nobody"):
        grouped(nobody, model, "stature", PLAIN)


def test_labels_of_things_and_of_frames(many: xr.Dataset) -> None:
    shape = many.sizes["frame"], many.sizes["person"]
    worn = many.drop_dims("worn").assign_coords(worn=["top", "legs"])
    worn["reflectance"] = (("frame", "person", "worn"), np.random.default_rng(0).random((*shape, 2)))
    values, _ = people_labels(worn, GroupBy("reflectance", "legs"))
    np.testing.assert_array_equal(values, worn["reflectance"].values[..., 1])
    values, _ = people_labels(many, GroupBy("car"))
    np.testing.assert_array_equal(values, np.broadcast_to(many["car"].values[:, None], shape))
    for by, hint in ((GroupBy("reflectance"), "write reflectance:top"), (GroupBy("reflectance", "hat"), "there are top, legs")):
        with pytest.raises(ConfigError) as error:
            people_labels(worn, by)
        assert hint in str(error.value.hint)


@pytest.mark.parametrize("word", ["=1", "stature=a", "stature=2,1", "stature=1,1", "stature=nan"])
def test_words_that_make_no_groups(word: str) -> None:
    with pytest.raises(ConfigError):
        read_group_by(word)


@pytest.mark.parametrize(
    ("word", "hint"),
    [("statures", "stature"), ("stature:top", "write stature"), ("sex=1,2", "write sex"), ("plate", "40 at most")],
)
def test_labels_that_make_no_groups(many: xr.Dataset, word: str, hint: str) -> None:
    sex = np.where(many["subject"].values == "", "", "female")
    many = many.assign_coords(sex=(("frame", "person"), sex), plate=("frame", many["frame"].values.astype(str)))
    with pytest.raises(ConfigError) as error:
        grouped(many, answers(many, np.zeros((many.sizes["frame"], many.sizes["person"]))), word)
    assert hint in f"{error.value} {error.value.hint}"


def test_the_command_prints_and_keeps_them(
    dataset_folder: Path, predictions: Predictions, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = write_predictions(tmp_path / "a.jsonl", predictions)
    command = ["evaluate", str(dataset_folder), "--predictions", str(file), "--resamples", "5"]
    assert main([*command, "--by", "seat", "--training-data", str(dataset_folder), "--out", str(tmp_path / "out")]) == 0
    out = capsys.readouterr().out
    assert "in training %" in out
    assert "by seat: too few groups of people to say which is worst" in out
    page = (tmp_path / "out" / "index.html").read_text(encoding="utf-8")
    assert "By groups of people" in page
    assert main([*command, "--training-data", str(dataset_folder)]) == 2
    assert "--by" in capsys.readouterr().err


def test_a_group_in_which_nothing_is_found_has_numbers(many: xr.Dataset) -> None:
    model = answers(many, np.zeros((many.sizes["frame"], many.sizes["person"])))
    seat = model.persons.index("driver")
    for of in (model.joints_2d, model.joints_3d):
        of[:, seat] = np.nan
    found = {group.name: [v.value for v in group.values if v.metric == "found"] for group in grouped(many, model, "seat").groups}
    assert found["driver"] == [0.0, 0.0]
    assert found["front_passenger"] == [100.0, 100.0]


def test_edges_are_as_exact_as_the_labels(many: xr.Dataset) -> None:
    """Who is 1.8 m tall, which float32 holds a little less of, is in "1.8 m and more"."""
    tall = many.assign_coords(stature=(("frame", "person"), np.full(many["subject"].shape, 1.8, np.float32), {"units": "m"}))
    model = answers(tall, np.zeros(many["subject"].shape))
    assert [group.name for group in grouped(tall, model, "stature=1.6,1.8").groups] == ["1.8 m and more"]


def test_people_without_a_name_are_no_subject(many: xr.Dataset) -> None:
    unnamed = many.assign_coords(subject=many["subject"].where(many["subject"] == "", "unknown"))
    model = answers(unnamed, np.zeros(many["subject"].shape))
    assert {group.subjects for group in grouped(unnamed, model, "seat").groups} == {0}

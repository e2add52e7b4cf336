"""Splits: selections by coordinates that cannot overlap."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import xarray as xr
from hypothesis import given
from hypothesis import strategies as st

from cabinpose.core.errors import ConfigError, DatasetError
from cabinpose.store import open_dataset
from cabinpose.store.split import frame_mask, parse_splits, read_splits, split_dataset, split_datasets


def test_selection_by_car_and_view(dataset_folder: Path) -> None:
    dataset = open_dataset(dataset_folder)  # cars: sedan van coupe sedan van; views: two driver, two front_row, driver
    assert frame_mask(dataset, {"car": ("sedan", "van")}).tolist() == [True, True, False, True, True]
    assert frame_mask(dataset, {"car": ("sedan",), "pov": ("front_row",)}).tolist() == [False, False, False, True, False]


def test_nobody_of_another_split_is_seen(dataset_folder: Path) -> None:
    """Subjects by frame: {S01}, {S02 S03}, {S03 S04 S01}, {S04}, {S01 S02}: all of a frame's people are in the selection."""
    dataset = open_dataset(dataset_folder)
    splits = parse_splits({"train": {"subject": ["S01", "S02"]}, "test": {"subject": ["S03", "S04"]}}, "here")
    parts = split_dataset(dataset, splits)
    assert parts["train"].frame.values.tolist() == [0, 4]
    assert parts["test"].frame.values.tolist() == [3]
    assert parts["train"].depth[1].values.shape == (48, 64)


def test_empty_frames_belong_to_no_selection_of_people() -> None:
    subject = np.array([["", ""], ["S01", ""], ["S01", "S02"]], object)
    dataset = xr.Dataset({"subject": (("frame", "person"), subject)})
    assert frame_mask(dataset, {"subject": ("S01",)}).tolist() == [False, True, False]


def test_a_file_of_splits(tmp_path: Path) -> None:
    path = tmp_path / "splits.yaml"
    path.write_text("train: {subject: [S01, S02], car: [van]}\ntest: {subject: [S03], sequence: [1, 2]}\n")
    splits = {"train": {"subject": ("S01", "S02"), "car": ("van",)}, "test": {"subject": ("S03",), "sequence": (1, 2)}}
    assert read_splits(path) == splits
    assert list(read_splits(path, ["test"]).items()) == [("test", splits["test"])]
    with pytest.raises(ConfigError, match="validate"):
        read_splits(path, ["validate"])


@pytest.mark.parametrize(
    ("data", "message"),
    [
        ({"a": {"car": ["van"]}, "b": {"car": ["van", "suv"]}}, "'a' and 'b' overlap in car van"),
        ({"a": {"car": ["van"]}, "b": {"subject": ["S01"]}}, "'a' and 'b' overlap"),
        ({"a": {"cars": ["van"]}}, "selects by 'cars'"),
        ({"a": {"car": "van"}}, "a.car is no list of values"),
        ({"a": {"car": []}}, "a.car is no list of values"),
        ({"a": {}}, "selects nothing"),
        ([], "holds no splits"),
    ],
)
def test_refused(data: Any, message: str, tmp_path: Path) -> None:
    with pytest.raises(DatasetError, match=message):
        parse_splits(data, "splits.yaml")


def test_unknown_value_and_empty_split(dataset_folder: Path, tmp_path: Path) -> None:
    dataset = open_dataset(dataset_folder)
    with pytest.raises(DatasetError, match="no car 'bus'") as error:
        split_dataset(dataset, {"a": {"car": ("bus",)}})
    assert "coupe, sedan, van" in str(error.value.hint)
    with pytest.raises(DatasetError, match="no frame belongs to split 'a'"):
        split_dataset(dataset, {"a": {"car": ("coupe",), "pov": ("driver",)}})
    with pytest.raises(DatasetError, match="cannot read"):
        read_splits(tmp_path / "absent.yaml")


def named(*frames: tuple[str, ...]) -> xr.Dataset:
    return xr.Dataset({"subject": (("frame", "person"), np.array(frames))}, {"frame": np.arange(len(frames))})


def test_splits_of_several_datasets() -> None:
    """A value may be missing in some of the datasets; a longer one than a dataset's names is not cut to one of them."""
    datasets = [named(("A", ""), ("B", "A"), ("C", "")), named(("B", ""), ("Anna", "B"))]
    parts = split_datasets(datasets, {"mine": {"subject": ("A", "B")}, "theirs": {"subject": ("Anna", "C", "B")}})
    assert [part.frame.values.tolist() for part in parts["mine"]] == [[0, 1], [0]]
    assert [part.frame.values.tolist() for part in parts["theirs"]] == [[2], [0, 1]]
    parts = split_datasets(datasets, {"hers": {"subject": ("Anna", "B")}})
    assert [part.frame.values.tolist() for part in parts["hers"]] == [[], [0, 1]]
    with pytest.raises(DatasetError, match="the datasets have no subject 'D'") as error:
        split_datasets(datasets, {"a": {"subject": ("A", "D")}})
    assert error.value.hint == "they have: A, Anna, B, C"
    with pytest.raises(DatasetError, match="no frame belongs to split 'a'"):
        split_datasets(datasets, {"a": {"subject": ("Anna",)}})


values = st.lists(st.sampled_from(["sedan", "van", "coupe"]), min_size=1, max_size=3, unique=True)
people = st.lists(st.sampled_from(["S01", "S02", "S03", "S04"]), min_size=1, max_size=4, unique=True)
selections = st.fixed_dictionaries({}, optional={"car": values, "subject": people}).filter(bool)


@given(st.dictionaries(st.sampled_from("abc"), selections, min_size=2))
def test_accepted_splits_share_no_frame(dataset_folder: Path, data: dict[str, dict[str, list[str]]]) -> None:
    dataset = open_dataset(dataset_folder)
    try:
        splits = parse_splits(data, "here")
    except DatasetError:
        return
    masks = np.array([frame_mask(dataset, selection) for selection in splits.values()])
    assert (masks.sum(axis=0) <= 1).all()

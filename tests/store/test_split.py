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
        ({"a": {"car": "van"}}, "split 'a': car is no list of values"),
        ({"a": {"car": []}}, "split 'a': car is no list of values"),
        ({"a": {}}, "selects nothing"),
        ({"a": {"frames": 5}}, "selects nothing"),
        ({"a": {"car": ["van"], "frames": 0}}, "0 frames cannot be drawn"),
        ({"a": {"car": ["van"], "frames": True}}, "True frames cannot be drawn"),
        ({"a": {"subject/1": [1]}}, "selects by 'subject/1'"),
        ({"a": {"subject/x": [1]}}, "selects by 'subject/x'"),
        ({"a": {"colour/3": [1]}}, "selects by 'colour/3'"),
        ({"a": {"subject/3": [0]}}, "subject/3 has no fold 0"),
        ({"a": {"subject/3": [1]}, "b": {"subject/4": [2]}}, "'a' and 'b' overlap"),
        ({"a": {"subject/3": [1, 2], "frames": 5}, "b": {"subject/3": [2], "frames": 6}}, "overlap in subject/3 2"),
        ({"a": {"datasets": {}}}, "datasets names none"),
        ({"a": {"datasets": {"x": {"cars": ["van"]}}}}, "split 'a', x selects by 'cars'"),
        ({"a": {"datasets": {"x": {"datasets": {"y": "all"}}}}}, "x names datasets itself"),
        ({"a": {"car": ["van"], "datasets": {"x": "all"}}, "b": {"car": ["suv"]}}, "'a' and 'b' overlap of x"),
        ({"a": {"datasets": {"x": "all"}}, "b": {"datasets": {"x": "all"}}}, "overlap of x"),
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


def test_folds_are_dealt_out_in_the_order_of_names() -> None:
    """Of five subjects in three folds: A D, B E, C; each frame is in one fold at most, and nobody is in two."""
    dataset = named(("A", ""), ("B", ""), ("C", ""), ("D", "A"), ("E", "A"), ("", ""))
    folds = [frame_mask(dataset, {"subject/3": (fold,)}).tolist() for fold in (1, 2, 3)]
    assert folds == [
        [True, False, False, True, False, False],
        [False, True, False, False, False, False],
        [False, False, True, False, False, False],
    ]
    assert frame_mask(dataset, {"subject/3": (1, 2)}).tolist() == [True, True, False, True, True, False]
    numbered = xr.Dataset({"sequence": ("frame", [10, 2, 2, 7, 10])})
    assert frame_mask(numbered, {"sequence/2": (1,)}).tolist() == [True, True, True, False, True]
    with pytest.raises(DatasetError, match="no sequence/4 4"):
        frame_mask(numbered, {"sequence/4": (4,)})


@given(st.lists(st.tuples(*[st.sampled_from(["", "A", "B", "C", "D", "E"])] * 2), min_size=1), st.integers(2, 5))
def test_folds_share_nobody_and_lose_only_mixed_frames(frames: list[tuple[str, str]], count: int) -> None:
    dataset, there = named(*frames), {name for frame in frames for name in frame if name}
    seen: list[set[str]] = []
    kept = 0
    for fold in range(1, min(count, len(there)) + 1):
        part = dataset.isel(frame=frame_mask(dataset, {f"subject/{count}": (fold,)}))
        seen.append({name for name in part.subject.values.ravel().tolist() if name})
        kept += part.sizes["frame"]
    assert sum(map(len, seen)) == len(set().union(*seen))
    assert kept >= sum(len(set(frame) - {""}) == 1 for frame in frames)


def test_a_number_of_frames_is_drawn_always_the_same_ones() -> None:
    dataset = named(*[("A", "") if number % 2 else ("B", "") for number in range(40)])
    some, more = (frame_mask(dataset, {"subject": ("A",), "frames": count}) for count in (5, 12))
    assert (some.sum(), more.sum()) == (5, 12)
    assert (more | ~some).all()
    assert (dataset.subject.values[more, 0] == "A").all()
    np.testing.assert_array_equal(some, frame_mask(dataset, {"subject": ("A",), "frames": 5}))
    with pytest.raises(DatasetError, match="21 frames are asked for, and the split has 20") as error:
        frame_mask(dataset, {"subject": ("A",), "frames": 21})
    assert error.value.hint == "ask for at most 20"


def test_a_split_says_what_is_otherwise_of_a_dataset(tmp_path: Path, dataset_folder: Path) -> None:
    data = {
        "train": {"subject": ["A"], "datasets": {"rooms": "all", "own": {"subject": ["B"], "frames": 1}, "lab": "none"}},
        "test": {"subject": ["B"], "datasets": {"rooms": "none", "own": {"subject": ["A"]}}},
    }
    datasets = [named(("A", ""), ("B", "")) for _ in range(4)]
    for dataset, name in zip(datasets, ("cars", "rooms", "own", "lab"), strict=True):
        dataset.encoding["source"] = f"/somewhere/{name}"
    parts = split_datasets(datasets, parse_splits(data, "here"))
    assert [part.frame.values.tolist() for part in parts["train"]] == [[0], [0, 1], [1], []]
    assert [part.frame.values.tolist() for part in parts["test"]] == [[1], [], [0], [1]]
    only = parse_splits({"train": {"datasets": {"dataset": "all"}}}, "here")["train"]
    assert frame_mask(open_dataset(dataset_folder), only).all()  # the folder's name is dataset
    assert not frame_mask(datasets[0], only).any()
    with pytest.raises(DatasetError, match="no subject 'C'"):
        split_datasets(datasets, parse_splits({"a": {"datasets": {"rooms": {"subject": ["C"]}}}}, "here"))


values = st.lists(st.sampled_from(["sedan", "van", "coupe"]), min_size=1, max_size=3, unique=True)
people = st.lists(st.sampled_from(["S01", "S02", "S03", "S04"]), min_size=1, max_size=4, unique=True)
selections = st.fixed_dictionaries({}, optional={"car": values, "subject": people}).filter(bool)


@pytest.mark.slow
@given(st.dictionaries(st.sampled_from("abc"), selections, min_size=2))
def test_accepted_splits_share_no_frame(dataset_folder: Path, data: dict[str, dict[str, list[str]]]) -> None:
    dataset = open_dataset(dataset_folder)
    try:
        splits = parse_splits(data, "here")
    except DatasetError:
        return
    masks = np.array([frame_mask(dataset, selection) for selection in splits.values()])
    assert (masks.sum(axis=0) <= 1).all()

"""Who trains and who validates, and configurations of runs."""

from __future__ import annotations

from collections.abc import Sized
from pathlib import Path
from types import SimpleNamespace
from typing import cast

import numpy as np
import psutil
import pytest
import small
import xarray as xr

from cabinpose.app.training import stored_frames
from cabinpose.app.training_split import individuals, training_split
from cabinpose.core.errors import ConfigError, DatasetError
from cabinpose.estimate.data import StoredFrames
from cabinpose.estimate.train_config import read_train_config
from cabinpose.estimate.training import TrainConfig, frame_spec
from cabinpose.store.split import held_out, people_of
from cabinpose.synth.config import SynthConfig


def dataset(subjects: list[tuple[str, ...]], seed: int = 7) -> xr.Dataset:
    made = small.dataset(len(subjects))
    return made.assign_coords(
        subject=(("frame", "person"), np.array(subjects, dtype=object)),
        seed=("frame", np.full(len(subjects), seed)),
        car=("frame", ["van"] * len(subjects)),
        sequence=("frame", np.zeros(len(subjects), np.int64)),
    )


def split(given: xr.Dataset, splits: Path | None = None, train: str = "train", validate: str = "validate") -> list[xr.Dataset]:
    """Both sides of a dataset alone."""
    return [side["it"] for side in training_split({"it": given}, splits, train, validate)]


SEATS = [("A", "B", ""), ("A", "", "C"), ("D", "", ""), ("D", "A", ""), ("", "", ""), ("C", "B", "")]


def test_without_splits_some_subjects_are_held_out() -> None:
    training, validation = split(dataset(SEATS))
    assert people_of(training) == {"A", "B", "C"}
    assert people_of(validation) == {"D"}
    assert validation["frame"].values.tolist() == [2]  # the frame that shows D beside A belongs to neither
    assert training["frame"].values.tolist() == [0, 1, 4, 5]


def test_named_splits_select(tmp_path: Path) -> None:
    splits = tmp_path / "splits.yaml"
    splits.write_text("mine: {subject: [A, B, C]}\ntheirs: {subject: [D]}\n")
    training, validation = split(dataset(SEATS), splits, "mine", "theirs")
    assert training["frame"].values.tolist() == [0, 1, 5]
    assert validation["frame"].values.tolist() == [2]
    with pytest.raises(ConfigError, match="unknown split 'train'") as caught:
        split(dataset(SEATS), splits, "train", "theirs")
    assert "mine, theirs" in caught.value.hint


def test_people_on_both_sides_are_named(tmp_path: Path) -> None:
    splits = tmp_path / "splits.yaml"
    splits.write_text("train: {car: [van]}\nvalidate: {car: [sedan]}\n")
    cars = dataset(SEATS).assign_coords(car=("frame", ["van", "sedan", "van", "sedan", "van", "van"]))
    with pytest.raises(DatasetError, match="share A, C, D") as caught:
        split(cars, splits)
    assert "subject" in caught.value.hint


def test_people_who_are_always_together_are_held_out_together() -> None:
    """The last by name, D, is never alone."""
    training, validation = split(dataset([("A", "B", "")] * 3 + [("C", "D", "")] + [("", "B", "A")]))
    assert (people_of(training), people_of(validation)) == ({"A", "B"}, {"C", "D"})
    assert [side.sizes["frame"] for side in (training, validation)] == [4, 1]


def test_a_share_is_met_as_near_as_people_allow() -> None:
    given = alone(*"AAAAABBBCC")
    for share, name in ((0.2, "C"), (0.3, "B"), (0.5, "A")):
        cut = held_out(given, share)
        assert people_of(cut.validate) == {name}
        assert not cut.words


@pytest.mark.parametrize(
    "subjects",
    [
        pytest.param([("A", "", "")] * 10, id="one person"),
        pytest.param([("A", "B", "")] * 10, id="always together"),
        pytest.param([("A", "B", ""), ("A", "", "")] * 5, id="one of them always there"),
        pytest.param([("A", "B", ""), ("B", "C", ""), ("C", "A", "")] * 3 + [("A", "B", "")], id="all with all"),
    ],
)
def test_where_nobody_can_be_held_out_frames_are_and_it_is_told(subjects: list[tuple[str, ...]]) -> None:
    given = dataset(subjects)
    with pytest.warns(UserWarning, match="it: nobody can be held out.*validated on the last frames \\(2 frames\\)"):
        training, validation = split(given)
    assert validation["frame"].values.tolist() == [8, 9]
    assert training["frame"].values.tolist() == list(range(8))
    cars = given.assign_coords(car=("frame", ["van"] * 7 + ["suv"] * 3))
    cut = held_out(cars, 0.3)
    assert (cut.by, cut.validate["car"].values.tolist()) == ("car", ["suv"] * 3)
    cut = held_out(given.assign_coords(sequence=("frame", [0] * 4 + [1] * 4 + [2] * 2)), 0.2)
    assert (cut.by, cut.validate["frame"].values.tolist()) == ("sequence", [8, 9])


def test_a_single_frame_cannot_be_split() -> None:
    with pytest.raises(DatasetError, match="it: a single frame"):
        split(dataset([("A", "", "")]))


def alone(*subjects: str, seed: int = 7) -> xr.Dataset:
    """A frame for each subject."""
    return dataset([(name, "", "") for name in subjects], seed)


def test_each_dataset_is_split_by_its_own_subjects() -> None:
    training, validation = training_split({"a": dataset(SEATS), "b": alone("A", "E", "E")}, None, "train", "validate")
    assert [(name, part["frame"].values.tolist()) for name, part in training.items()] == [("a", [0, 1, 4, 5]), ("b", [0])]
    assert [(name, part["frame"].values.tolist()) for name, part in validation.items()] == [("a", [2]), ("b", [1, 2])]


def test_somebody_who_learns_in_one_dataset_and_validates_in_another_is_refused() -> None:
    with pytest.raises(DatasetError, match="'train' and 'validate' share B: ") as caught:
        training_split({"a": alone("A", "B", "C"), "b": alone("A", "B", seed=8)}, None, "train", "validate")
    assert "--splits" in caught.value.hint


def test_people_drawn_at_random_are_others_with_every_seed() -> None:
    """R0001 learns of the one and validates of the other."""
    first, second = alone("R0000", "R0001", "R0002"), ("R0000", "R0001")
    training, validation = training_split({"a": first, "b": alone(*second, seed=8)}, None, "train", "validate")
    assert people_of(training["a"]) & people_of(validation["b"]) == {"R0001"}
    with pytest.raises(DatasetError, match="share R0001: "):
        training_split({"a": first, "b": alone(*second)}, None, "train", "validate")


def test_a_crowds_names_are_known() -> None:
    crowd = SynthConfig.model_validate({"people": {"subjects": ["S01"], "random": {"count": 12_000}}})
    there = alone(*crowd.people.names[::1000], seed=3)
    assert {seed for name, seed in individuals(there) if name != "S01"} == {3}
    assert ("S01", None) in individuals(there)
    assert len(individuals(there)) == 13


def test_named_splits_apply_to_every_dataset(tmp_path: Path) -> None:
    """One dataset may be on one side alone, but not on none."""
    splits = tmp_path / "splits.yaml"
    splits.write_text("train: {subject: [A, B, E]}\nvalidate: {subject: [F, D]}\n")
    given = {"a": dataset(SEATS), "b": alone("E", "F"), "c": alone("F", "G", "F")}
    training, validation = training_split(given, splits, "train", "validate")
    assert [(name, part["frame"].values.tolist()) for name, part in training.items()] == [("a", [0]), ("b", [0])]
    assert [(name, part["frame"].values.tolist()) for name, part in validation.items()] == [("a", [2]), ("b", [1]), ("c", [0, 2])]
    with pytest.raises(DatasetError, match="d: no frame belongs to 'train' or 'validate'") as caught:
        training_split(given | {"d": alone("G")}, splits, "train", "validate")
    assert caught.value.hint


SPEC = frame_spec(TrainConfig(settings=small.TINY["compact"]))


def test_stored_frames_are_the_sides_of_the_split() -> None:
    sides = stored_frames(training_split({"it": dataset(SEATS)}, None, "train", "validate"), SPEC)
    assert [len(cast(Sized, side)) for side in sides] == [4, 1]


def test_stored_frames_of_several_datasets_follow_each_other() -> None:
    given = {"a": dataset(SEATS), "b": alone("A", "E", "E").assign_coords(frame=[10, 11, 12])}
    training, validation = stored_frames(training_split(given, None, "train", "validate"), SPEC)
    shown = [("a", 0), ("a", 1), ("a", 4), ("a", 5), ("b", 10)], [("a", 2), ("b", 11), ("b", 12)]
    for side, frames in zip((training, validation), shown, strict=True):
        assert len(cast(Sized, side)) == len(frames)
        for index, (name, frame) in enumerate(frames):
            alone_ = StoredFrames(given[name].sel(frame=[frame]), SPEC)[0]
            for mine, theirs in zip(side[index], alone_, strict=True):
                np.testing.assert_array_equal(mine, theirs)


def test_joints_that_others_placed_are_learnt_with_a_warning() -> None:
    given = {"a": dataset(SEATS), "b": alone("A", "E", "E").assign_attrs(generator="import coco")}
    with pytest.warns(UserWarning, match=r"placed differently: in a joint centres as .*; in b those of the file's annotators"):
        stored_frames(training_split(given, None, "train", "validate"), SPEC)


def test_another_image_may_be_read_as_depth() -> None:
    given = dataset(SEATS)
    spec = frame_spec(TrainConfig(settings=small.TINY["compact"], depth="depth_styled"))
    with pytest.raises(DatasetError, match="it: the dataset has no depth_styled"):
        stored_frames(training_split({"it": given}, None, "train", "validate"), spec)
    plain, styled = StoredFrames(given, SPEC)[0], StoredFrames(given.assign(depth_styled=given["depth"] + 0.1), spec)[0]
    assert (plain.depth > 0).any()
    np.testing.assert_allclose(styled.depth[plain.depth > 0], plain.depth[plain.depth > 0] + 1000, atol=1)  # of 0.1 mm
    np.testing.assert_array_equal(styled.amplitude, plain.amplitude)


def test_frames_are_kept_all_together_or_not_at_all(monkeypatch: pytest.MonkeyPatch) -> None:
    """A frame has 64 x 48 pixels of two images, two bytes each; eight are kept if they fill less than half of what is free."""
    given = {"a": dataset(SEATS), "b": alone("A", "E", "E")}
    for free, kept in ((2 * 8 * 64 * 48 * 4, False), (2 * 8 * 64 * 48 * 4 + 1, True)):
        monkeypatch.setattr(psutil, "virtual_memory", lambda free=free: SimpleNamespace(available=free))
        for side in stored_frames(training_split(given, None, "train", "validate"), SPEC):
            assert [side[i] is side[i] for i in range(len(cast(Sized, side)))] == [kept] * len(cast(Sized, side))


def test_a_dataset_that_does_not_fit_is_named() -> None:
    given = {"a": dataset(SEATS), "b": alone("A", "E").drop_vars("amplitude")}
    with pytest.raises(DatasetError, match="b: the dataset has no amplitude") as caught:
        stored_frames(training_split(given, None, "train", "validate"), SPEC)
    assert caught.value.hint


def test_a_configuration_is_read_and_its_method_may_come_from_outside(tmp_path: Path) -> None:
    path = tmp_path / "run.yaml"
    path.write_text("epochs: 3\naugment: {flip: 0.25}\n")
    config = read_train_config(path, "paf")
    assert (config.method, config.epochs, config.augment.flip) == ("paf", 3, 0.25)
    assert read_train_config(None, None) == TrainConfig()
    path.write_text("method: unet\n")
    assert read_train_config(path, "unet").method == "unet"
    with pytest.raises(ConfigError, match="for unet, not paf"):
        read_train_config(path, "paf")


@pytest.mark.parametrize(
    ("text", "words"),
    [("epochs: 0", "epochs"), ("- 1", "no mapping"), ("a: [", "is not YAML"), ("augment: {flip: 2}", "augment.flip")],
)
def test_a_configuration_that_is_wrong_is_refused(text: str, words: str, tmp_path: Path) -> None:
    path = tmp_path / "run.yaml"
    path.write_text(text)
    with pytest.raises(ConfigError, match=words) as caught:
        read_train_config(path, None)
    assert caught.value.hint

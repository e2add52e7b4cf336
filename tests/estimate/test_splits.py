"""Who trains and who validates, and configurations of runs."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import small
import xarray as xr

from cabinpose.app.training import people_of, read_train_config, stored_frames, training_split
from cabinpose.core.errors import ConfigError, DatasetError
from cabinpose.estimate.training import TrainConfig, frame_spec


def dataset(subjects: list[tuple[str, ...]]) -> xr.Dataset:
    made = small.dataset(len(subjects))
    return made.assign_coords(subject=(("frame", "person"), np.array(subjects, dtype=object)))


SEATS = [("A", "B", ""), ("A", "", "C"), ("D", "", ""), ("D", "A", ""), ("", "", ""), ("C", "B", "")]


def test_without_splits_some_subjects_are_held_out() -> None:
    training, validation = training_split(dataset(SEATS), None, "train", "validate")
    assert people_of(training) == {"A", "B", "C"}
    assert people_of(validation) == {"D"}
    assert validation["frame"].values.tolist() == [2]  # the frame that shows D beside A belongs to neither
    assert training["frame"].values.tolist() == [0, 1, 4, 5]


def test_named_splits_select(tmp_path: Path) -> None:
    splits = tmp_path / "splits.yaml"
    splits.write_text("mine: {subject: [A, B, C]}\ntheirs: {subject: [D]}\n")
    training, validation = training_split(dataset(SEATS), splits, "mine", "theirs")
    assert training["frame"].values.tolist() == [0, 1, 5]
    assert validation["frame"].values.tolist() == [2]
    with pytest.raises(ConfigError, match="unknown split 'train'") as caught:
        training_split(dataset(SEATS), splits, "train", "theirs")
    assert "mine, theirs" in caught.value.hint


def test_people_on_both_sides_are_named(tmp_path: Path) -> None:
    splits = tmp_path / "splits.yaml"
    splits.write_text("train: {car: [van]}\nvalidate: {car: [sedan]}\n")
    cars = dataset(SEATS).assign_coords(car=("frame", ["van", "sedan", "van", "sedan", "van", "van"]))
    with pytest.raises(DatasetError, match="share A, C, D") as caught:
        training_split(cars, splits, "train", "validate")
    assert "subject" in caught.value.hint


def test_one_subject_cannot_be_split() -> None:
    with pytest.raises(DatasetError, match="1 subject"):
        training_split(dataset([("A", "", "")] * 3), None, "train", "validate")


def test_a_side_without_frames_is_refused() -> None:
    with pytest.raises(DatasetError, match="no frame in 'train'"):
        training_split(dataset([("A", "B", ""), ("A", "B", "")]), None, "train", "validate")
    with pytest.raises(DatasetError, match="no frame in 'validate'"):
        training_split(dataset([("A", "B", ""), ("A", "", "")]), None, "train", "validate")


def test_stored_frames_are_the_sides_of_the_split() -> None:
    sides = stored_frames(dataset(SEATS), frame_spec(TrainConfig(settings=small.TINY["compact"])), None, "train", "validate")
    assert [len(side) for side in sides] == [4, 1]


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

"""Segmentations against pixel classes: numbers beside scikit-learn's, label images on disk, the page's pictures."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import xarray as xr
import zarr

from cabinpose.app.report.parts import part_colours
from cabinpose.core.errors import CabinposeError, DatasetError, PredictionsError
from cabinpose.core.ports import FrameBatch, Segmenter
from cabinpose.core.segmentation import Part
from cabinpose.evaluate.parts import evaluate_parts
from cabinpose.store.class_images import ClassImages, read_class_images, write_class_images

PARTS = (Part("head", (20, 21)), Part("arm", (30,)), Part("leg", (41, 40)))
IDS = np.array([5, 21, 30, 40], np.uint8)  # a class of the dataset for each number of a label image; 5 is no part


class Fixed:
    """A segmentation with given answers, by the frames' numbers."""

    name, parts = "fixed", PARTS

    def __init__(self, answers: np.ndarray) -> None:
        self._answers = answers.astype(np.uint8)

    def segment(self, frames: FrameBatch) -> np.ndarray:
        return self._answers[frames["frame"] - 10]


def scene(truth: np.ndarray) -> xr.Dataset:
    frames = len(truth)
    return xr.Dataset(
        {
            "depth": (("frame", "y", "x"), np.ones(truth.shape, np.float32)),
            "labels": (("frame", "y", "x"), IDS[truth]),
            "camera_k": (("frame", "k_row", "k_column"), np.tile(np.eye(3), (frames, 1, 1))),
            "camera_dist": (("frame", "dist_coefficient"), np.zeros((frames, 5))),
        },
        {
            "frame": np.arange(10, 10 + frames),
            "sequence": ("frame", np.zeros(frames, np.int64)),
            "sync_ns": ("frame", np.zeros(frames, np.int64)),
        },
    )


@pytest.fixture
def labelled() -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(11)
    truth = rng.integers(0, 4, (6, 20, 30))
    said = np.where(rng.random(truth.shape) < 0.7, truth, rng.integers(0, 4, truth.shape))
    truth[:, :3] = 0
    return truth, said


def test_the_numbers_are_those_of_scikit_learn(labelled: tuple[np.ndarray, np.ndarray]) -> None:
    """scikit-learn 1.9.1: confusion_matrix, jaccard_score per class, macro over 1 to 3 and over all, binary, accuracy_score."""
    truth, said = labelled
    model = Fixed(said)
    assert isinstance(model, Segmenter)
    done: list[int] = []
    report = evaluate_parts(scene(truth), model, name="d", resamples=200, progress=done.append)
    assert report.confusion == ((734, 201, 179, 195), (67, 570, 52, 64), (48, 49, 612, 70), (62, 58, 53, 586))
    assert report.classes == ("nobody", "head", "arm", "leg")
    assert [report.value("IoU", name) for name in report.classes] == pytest.approx([49.394347, 53.722903, 57.572907, 53.860294])
    assert report.value("mean IoU") == pytest.approx(55.052035)
    assert report.value("mean IoU", "parts and nobody") == pytest.approx(53.637613)
    assert report.value("IoU", "people") == pytest.approx(73.76134)
    assert report.value("pixels right", "all") == pytest.approx(69.5)
    assert all(v.low < v.value < v.high < v.low + 15 for v in report.values)
    assert (report.model, report.dataset, report.frames, done) == ("fixed", "d", 6, [6])


def test_frames_are_ranked_by_their_mean_iou_and_empty_ones_left_out(labelled: tuple[np.ndarray, np.ndarray]) -> None:
    truth, _ = labelled
    said = truth.copy()
    said[4, :, :20] = 0  # the worst but for the next
    said[2] = 0
    truth[5], said[5] = 0, 0  # nobody there, and nobody found
    report = evaluate_parts(scene(truth), Fixed(said), resamples=0)
    assert report.worst[:2] == (12, 14)
    assert 15 not in report.worst
    assert all(np.isnan(v.low) for v in report.values)


def test_label_images_come_back_as_they_were(tmp_path: Path, labelled: tuple[np.ndarray, np.ndarray]) -> None:
    truth, said = labelled
    file, dataset = tmp_path / "said.zarr", scene(truth)
    numbers = dataset["frame"].values
    write_class_images(file, (said[i : i + 4].astype(np.uint8) for i in (0, 4)), numbers, PARTS, model="m", dataset="d")
    assert [each.name for each in tmp_path.iterdir()] == ["said.zarr"]
    read = read_class_images(file)
    assert (read.name, read.parts, read.dataset) == ("m", PARTS, "d")
    np.testing.assert_array_equal(read.frame, numbers)
    assert evaluate_parts(dataset, read).confusion == evaluate_parts(dataset, Fixed(said)).confusion
    with pytest.raises(PredictionsError, match="exists"):
        write_class_images(file, [], numbers, PARTS, model="m")
    write_class_images(file, [said.astype(np.uint8)[:5]], numbers[:5], PARTS, model="n", overwrite=True)
    short = read_class_images(file)
    assert not short.segment({"depth": np.ones((1, 20, 30), np.float32), "frame": numbers[5:]}).any()  # type: ignore[typeddict-item]


def test_what_breaks_off_leaves_nothing(tmp_path: Path) -> None:
    def failing() -> object:
        yield np.zeros((1, 2, 3), np.uint8)
        raise RuntimeError

    with pytest.raises(RuntimeError):
        write_class_images(tmp_path / "a.zarr", failing(), np.arange(2), PARTS, model="m")  # type: ignore[arg-type]
    assert not list(tmp_path.iterdir())


def _other_size(folder: Path) -> None:
    images = ClassImages(np.zeros((1, 4, 4), np.uint8), np.array([3]), PARTS, "m", None)
    images.segment({"depth": np.ones((1, 20, 30), np.float32), "frame": np.array([3])})  # type: ignore[typeddict-item]


def _beyond_the_parts(folder: Path) -> None:
    images = ClassImages(np.full((1, 2, 3), 255, np.uint8), np.array([3]), PARTS, "m", None)
    images.segment({"depth": np.ones((1, 2, 3), np.float32), "frame": np.array([3])})  # type: ignore[typeddict-item]


def _of_another_kind(folder: Path) -> None:
    zarr.open_group(folder / "x.zarr", mode="w").attrs["format"] = "else"
    read_class_images(folder / "x.zarr")


def _torn(folder: Path) -> None:
    write_class_images(folder / "x.zarr", [np.zeros((2, 2, 3), np.uint8)], np.array([1, 2]), PARTS, model="m")
    group = zarr.open_group(folder / "x.zarr", mode="a")
    group.create_array("frame", data=np.array([2, 1]), overwrite=True)
    read_class_images(folder / "x.zarr")


def _giant(folder: Path) -> None:
    """A chunk of 10^12 bytes, of which none is there."""
    write_class_images(folder / "x.zarr", [np.zeros((2, 2, 3), np.uint8)], np.array([1, 2]), PARTS, model="m")
    group = zarr.open_group(folder / "x.zarr", mode="a")
    group.create_array("labels", shape=(2, 10**6, 10**6), chunks=(1, 10**6, 10**6), dtype="uint8", overwrite=True)
    read_class_images(folder / "x.zarr")


def _cut(folder: Path) -> None:
    path = folder / "x.zarr"
    write_class_images(path, [np.arange(6, dtype=np.uint8).reshape(1, 2, 3)], np.array([1]), PARTS, model="m")
    chunk = path / "labels/c/0/0/0"
    chunk.write_bytes(chunk.read_bytes()[:9])
    read_class_images(path).segment({"depth": np.ones((1, 2, 3), np.float32), "frame": np.array([1])})  # type: ignore[typeddict-item]


def _without_labels(folder: Path) -> None:
    evaluate_parts(scene(np.zeros((1, 2, 2), int)).drop_vars("labels"), Fixed(np.zeros((1, 2, 2))))


@pytest.mark.parametrize(
    ("what", "error", "words"),
    [
        (_other_size, PredictionsError, "4x4 pixels, frames of 30x20"),
        (_beyond_the_parts, PredictionsError, "a pixel of class 255"),
        (_of_another_kind, PredictionsError, "no label images of version 1"),
        (_torn, PredictionsError, "do not fit"),
        (_giant, PredictionsError, "do not fit"),
        (_cut, PredictionsError, "frame 1 cannot be read"),
        (lambda folder: read_class_images(folder / "none.zarr"), PredictionsError, "that can be read"),
        (_without_labels, DatasetError, "no pixel classes"),
    ],
)  # fmt: skip
def test_what_does_not_fit_is_said(
    tmp_path: Path, what: Callable[[Path], object], error: type[CabinposeError], words: str
) -> None:
    with pytest.raises(error, match=words) as caught:
        what(tmp_path)
    assert caught.value.hint


@pytest.mark.parametrize("count", [8, 33])
def test_every_part_has_a_colour_of_its_own(count: int) -> None:
    colours = part_colours([Part(str(i), (i,)) for i in range(count)]).astype(int)
    apart = np.abs(colours[:, None] - colours).sum(axis=-1)[np.triu_indices(count + 1, 1)]
    assert apart.min() > 12

"""Frames of a dataset for a network of one's own, by a torch DataLoader."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import small
import torch
import xarray as xr
from torch.utils.data import DataLoader

from cabinpose.core.errors import ConfigError, DatasetError
from cabinpose.estimate import FrameDataset
from cabinpose.store import PartWriter, create_dataset, open_dataset

FRAMES = 10
VARIABLES = ("frame", "depth", "amplitude", "labels", "camera_k", "joints_3d", "visibility")


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Sphere people on disk, in parts of four frames."""
    made = tmp_path_factory.mktemp("frames") / "dataset"
    manifest = small.manifest(FRAMES).model_copy(update={"frames_per_part": 4})
    with create_dataset(made, manifest) as dataset:
        for plan in dataset.missing():
            with PartWriter(made, plan, manifest) as part:
                for index in range(plan.first, plan.first + plan.frames):
                    part.append(small.frame(index))
    return made


def batches(frames: FrameDataset, **options: Any) -> dict[str, np.ndarray]:
    """All that a loader gives, as one batch."""
    loaded = list(DataLoader(frames, batch_size=3, **options))
    return {name: torch.cat([batch[name] for batch in loaded]).numpy() for name in loaded[0]}


def assert_same(loaded: dict[str, np.ndarray], dataset: xr.Dataset) -> None:
    assert list(loaded) == list(VARIABLES)
    for name, values in loaded.items():
        assert values.dtype == dataset[name].dtype
        np.testing.assert_array_equal(values, dataset[name].values)


@pytest.mark.parametrize(("workers", "context"), [(0, None), (2, "fork"), pytest.param(2, "spawn", marks=pytest.mark.slow)])
def test_values_are_those_of_the_dataset_with_any_workers(folder: Path, workers: int, context: str | None) -> None:
    frames = FrameDataset(folder, VARIABLES)
    assert len(frames) == FRAMES
    assert_same(batches(frames, num_workers=workers, multiprocessing_context=context), open_dataset(folder))


def test_shuffled_frames_are_the_same_frames(folder: Path) -> None:
    loaded = batches(FrameDataset(folder, VARIABLES), shuffle=True, generator=torch.Generator().manual_seed(1))
    assert loaded["frame"].tolist() != sorted(loaded["frame"])
    order = np.argsort(loaded["frame"])
    assert_same({name: values[order] for name, values in loaded.items()}, open_dataset(folder))


def test_a_selection_is_what_is_fed(folder: Path) -> None:
    dataset = open_dataset(folder)
    chosen = dataset.isel(frame=[7, 2, 5]).sel(person="driver")
    assert_same(batches(FrameDataset(chosen, VARIABLES)), chosen)


def test_a_transform_has_the_last_word(folder: Path) -> None:
    frames = FrameDataset(folder, ("depth",), lambda sample: torch.nan_to_num(sample["depth"]).max())
    assert frames[4].item() == float(open_dataset(folder).depth[4].max())


def test_what_cannot_be_fed_is_named(folder: Path) -> None:
    with pytest.raises(ConfigError, match="unknown variable 'joints'") as error:
        FrameDataset(folder, ("depth", "joints"))
    assert "joints_3d" in str(error.value.hint)
    with pytest.raises(ConfigError, match="subject"):  # a name is no number
        FrameDataset(folder, ("subject",))
    with pytest.raises(DatasetError, match="no frame"):
        FrameDataset(open_dataset(folder).isel(frame=[]))

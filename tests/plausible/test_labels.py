"""Joints that are not those of their images are told; the generated ones beside them are not."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import xarray as xr

from cabinpose.core import CABINPOSE
from cabinpose.store import label_warnings, open_dataset

Change = Callable[[xr.Dataset], None]


@pytest.fixture(scope="module")
def dataset(tmp_path_factory: pytest.TempPathFactory) -> xr.Dataset:
    from cabinpose.app.cli import main

    folder = tmp_path_factory.mktemp("labels") / "data"
    assert main(["synth", "--frames", "6", "--seed", "3", "--out", str(folder), "scene.cars=[suv]"]) == 0
    return open_dataset(Path(folder)).load()


def scale(name: str, factor: float | tuple[float, ...]) -> Change:
    return lambda data: data[name].values.__imul__(np.asarray(factor, np.float32))


def exchange(data: xr.Dataset) -> None:
    other = [CABINPOSE.index[{"l": "r", "r": "l"}[j[0]] + j[1:]] if j[0] in "lr" else i for i, j in enumerate(CABINPOSE.joints)]
    for name in ("joints_2d", "joints_3d", "visibility"):
        data[name].values[...] = data[name].values[:, :, other]


def normalise(data: xr.Dataset) -> None:
    uv = data["joints_2d"].values
    uv /= (data.sizes["x"], data.sizes["y"])
    uv[np.abs(uv).max(axis=-1) > 1] = np.nan


def shift(data: xr.Dataset) -> None:
    for name in ("joints_2d", "visibility"):
        data[name].values[...] = np.roll(data[name].values, 1, axis=0)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (normalise, "normalised to the image's size?"),
        (scale("joints_2d", 2.0), "lie outside of the image"),
        (scale("joints_2d", 0.5), "from where joints_3d and camera_k have it"),
        (shift, "from where joints_3d and camera_k have it"),
        (scale("joints_3d", 1000.0), "joints_3d fits in mm"),
        (scale("joints_3d", 100.0), "joints_3d fits in cm"),
        (scale("joints_3d", (1.0, 1.0, -1.0)), "lie behind the camera"),
        (exchange, "of the people left and right contradict the knees"),
    ],
    ids=("normalised", "twice", "half", "shifted", "mm", "cm", "negated", "sides"),
)
def test_a_wrong_label_is_told(dataset: xr.Dataset, change: Change, said: str) -> None:
    wrong = dataset.copy(deep=True)
    change(wrong)
    assert label_warnings(dataset) == ()
    assert any(said in warning for warning in label_warnings(wrong))

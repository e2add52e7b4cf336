"""Fixtures of the evaluation's tests: the sphere people of the store's tests, and predictions on them."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest
import xarray as xr

from cabinpose.core.skeleton import CABINPOSE
from cabinpose.store import open_dataset
from cabinpose.store.predictions import Predictions

sys.path.insert(0, str(Path(__file__).parents[1] / "store"))
sys.path.insert(0, str(Path(__file__).parent))

import sphere_people


@pytest.fixture(scope="session")
def dataset_folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Five frames in three parts; read only."""
    return sphere_people.write(tmp_path_factory.mktemp("spheres") / "dataset", sphere_people.manifest())


@pytest.fixture
def dataset(dataset_folder: Path) -> xr.Dataset:
    return open_dataset(dataset_folder)


@pytest.fixture
def predictions(dataset: xr.Dataset) -> Predictions:
    """Noisy answers for the upper body, some joints missing, in an order of their own."""
    rng = np.random.default_rng(5)
    joints, persons = CABINPOSE.sets["upper body"][::-1], tuple(str(p) for p in dataset["person"].values[::-1])
    truth = dataset.sel(joint=list(joints), person=list(persons))
    two, three = truth["joints_2d"].values.copy(), truth["joints_3d"].values.copy()
    two += rng.normal(0, 4, two.shape)
    three += rng.normal(0, 0.05, three.shape)
    false = np.isnan(three).all(axis=-1) & (rng.random(three.shape[:-1]) < 0.2)  # joints of people who are not there, far off
    two[false], three[false] = (900.0, 900.0), (0.0, 0.0, 9.0)
    two[rng.random(two.shape[:-1]) < 0.1] = np.nan
    shape = two.shape[:-1]
    nothing = np.isnan(two).any(-1) & np.isnan(three).any(-1)
    presence = np.where(nothing, 0, rng.uniform(0.3, 1, shape))
    score = np.where(nothing, 0, rng.random(shape))
    return Predictions(
        two.astype(np.float32), three.astype(np.float32), score.astype(np.float32), presence.astype(np.float32),
        dataset["frame"].values, persons, joints, "noisy",
    )  # fmt: skip

"""What the Dataset tab does with chosen frames: histograms, small images, predictions drawn, and taking them out."""

from __future__ import annotations

import io
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("nicegui", reason="needs the extra `studio`")

from fastapi import FastAPI
from PIL import Image
from starlette.testclient import TestClient

from cabinpose.app.studio.choice import Choice, as_dataset, as_split, new_path
from cabinpose.app.studio.histogram import MOST_BARS, Bar, bars_of
from cabinpose.app.studio.models import found_in
from cabinpose.app.studio.pictures import IMAGES
from cabinpose.app.studio.thumbs import WIDTH, thumb_routes
from cabinpose.app.studio.workspace import open_workspace
from cabinpose.core import ConfigError, DatasetError
from cabinpose.evaluate import EvaluationOptions
from cabinpose.store import Predictions, empty_batch, frame_mask, frames_where, open_dataset, read_manifest, read_splits

rng = np.random.default_rng(3)
COLUMNS: dict[str, Any] = {
    "car": np.array(["suv", "van", "suv", "suv", "", "coupé \"x\""], object),
    "action": np.array([["drive", "drive"], ["sleep", ""], ["", ""], ["drive", "sleep"], ["", ""], ["phone", ""]], object),
    "people": np.array([2, 1, 0, 2, 0, 1]),
    "sync_ns": np.array([1_700_000_000_123_456_789 + 40_000_000 * i for i in range(6)]),
    "error_cm": np.array([0.31, np.nan, 1.02, 2.49, np.inf, 0.3]),
    "stature": np.array([[1.5, 1.5], [1.45, np.nan], [1.6, 1.65], [np.nan] * 2, [1.55, 1.7], [1.9, 1.2]], np.float32),
    "near": np.array([834449.06, 834449.1, 834449.1, np.nan, 834449.25, 834449.1], np.float32),  # a few roundings apart
    "far": np.full(6, 1.21e8, np.float32),
    "tilt": np.round(np.arange(6) / 10, 1),
    "level": np.array([0, 40, 80, 120, 200, 255], np.uint8),
    "same": np.full(6, 4.25),
    "nothing": np.full(6, np.nan),
}  # fmt: skip


@pytest.mark.parametrize("name", COLUMNS)
def test_a_bar_counts_the_frames_that_its_condition_chooses(name: str) -> None:
    bars = bars_of(name, COLUMNS[name])
    for bar in bars:
        assert frames_where(COLUMNS, bar.condition).sum() == bar.frames, bar if bar.frames else True
    covered = np.logical_or.reduce([np.zeros(6, bool), *(frames_where(COLUMNS, bar.condition) for bar in bars)])
    empty = COLUMNS[name] == "" if COLUMNS[name].dtype == object else np.isnan(COLUMNS[name].astype(float))
    assert covered.tolist() == (~(empty.all(axis=1) if empty.ndim == 2 else empty)).tolist()


def test_bars_are_in_an_order_that_is_read() -> None:
    assert bars_of("action", COLUMNS["action"])[0] == Bar("drive", 2, 'action == "drive"')
    assert [bar.words for bar in bars_of("people", COLUMNS["people"])] == ["0", "1", "2"]
    assert [bar.words for bar in bars_of("error_cm", COLUMNS["error_cm"])][-2:] == ["2.4 to 2.6", "nobody found"]
    many = np.array([f"S{n:03d}" for n in range(MOST_BARS + 7)], object)
    assert bars_of("subject", many)[-1] == Bar("7 more", 0, "")


def test_small_images_are_those_of_the_frames(dataset_folder: Path) -> None:
    workspace = open_workspace(dataset_folder)
    dataset = workspace.dataset
    assert dataset is not None
    server = FastAPI()
    server.include_router(thumb_routes(workspace.of_key))
    client = TestClient(server)

    def got(name: str, query: str = "") -> Any:
        answer = client.get(f"{workspace.thumbs_url(name)}2{query}")
        assert answer.headers["content-type"] == "image/png"
        return np.asarray(Image.open(io.BytesIO(answer.content)).convert("RGB"), float)

    depth = dataset["depth"][2].values
    step = depth.shape[1] // WIDTH
    for name in IMAGES:
        if name in dataset:
            assert got(name).shape[:2] == depth[::step, ::step].shape
    valid = np.isfinite(depth[::step, ::step])
    bright = got("depth").mean(axis=2)
    assert np.unique(got("depth")[~valid], axis=0).tolist() == [[38, 40, 46]]
    nearer = np.corrcoef(bright[valid], depth[::step, ::step][valid])[0, 1]
    assert abs(nearer) > 0.8  # the colours are even in lightness
    assert not np.array_equal(got("depth"), got("depth", "?near=0.1&far=9"))
    for wrong in (workspace.thumbs_url("joints_3d") + "2", workspace.thumbs_url("depth") + "77", "/thumbs/other/depth/2"):
        assert client.get(wrong).status_code == 404
    workspace.close()


def test_who_is_not_sure_is_not_drawn() -> None:
    batch = empty_batch(2, 1, 3)
    batch.joints_2d[:], batch.joints_3d[:], batch.presence[1, 0] = 7.0, 1.5, (1.0, EvaluationOptions().presence - 0.01, 1.0)
    names = ("head", "neck", "chest")
    model = Predictions(
        batch.joints_2d, batch.joints_3d, batch.score, batch.presence, np.array([4, 9]), ("driver",), names, "oracle"
    )
    found = found_in(model, 9)
    assert np.isfinite(found.xyz[0]).all(axis=1).tolist() == [True, False, True]
    (person,) = found.drawn("#123456")
    assert [joint["u"] for joint in person["joints"]] == [7.0, None, 7.0]


def test_chosen_frames_are_taken_out_whole_and_nothing_is_replaced(dataset_folder: Path) -> None:
    workspace = open_workspace(dataset_folder)
    made = as_dataset(workspace, Choice(np.array([4, 1]), "people > 1"), new_path(workspace, "mine"), labels=False)
    stored, whole = open_dataset(made), open_dataset(dataset_folder)
    np.testing.assert_array_equal(stored["depth"].values, whole["depth"].values[[1, 4]])
    np.testing.assert_array_equal(stored["vehicle_from_camera"].values, whole["vehicle_from_camera"].values[[1, 4]])
    told = read_manifest(made).selection
    assert (told["by"], told["frames"]) == ("people > 1", "1 4")
    for name in ("mine", "../out", "", "a/b", ".hidden", ".yaml"):
        with pytest.raises(ConfigError):
            new_path(workspace, name)
    first = whole["frame"].values[whole["pov"].values == whole["pov"].values[0]]
    try:
        told = as_split(workspace, Choice(first, ""), new_path(workspace, "splits.yaml"))
    except DatasetError:
        assert (whole["pov"].values == whole["pov"].values[0]).all()
    else:
        name = told.split("told apart by ")[1].split(",")[0]
        splits = read_splits(dataset_folder.parent / "splits.yaml")
        chosen = frame_mask(whole, splits["test"])
        assert set(whole["frame"].values[chosen].tolist()) <= set(first.tolist())
        assert list(splits["test"]) == [name]
    workspace.close()

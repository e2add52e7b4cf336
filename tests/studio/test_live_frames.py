"""Frames of a live run: kept, written, opened to be labelled, and as clouds; without a browser but for the last two."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from dataclasses import replace
from datetime import datetime
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from fastapi import FastAPI
from starlette.testclient import TestClient

from cabinpose.app.label.labelling import Labelling
from cabinpose.app.live.feed import DatasetFeed
from cabinpose.app.live.run import Found
from cabinpose.app.studio import live_keep
from cabinpose.app.studio.clouds import MOST_LIVE, live_cloud
from cabinpose.app.studio.live_cloud import skeletons
from cabinpose.app.studio.live_keep import keep, write_kept
from cabinpose.app.studio.live_session import Shown
from cabinpose.app.studio.models import first_choice, load_choice
from cabinpose.app.studio.pictures import image_routes
from cabinpose.app.studio.workspace import Workspace, open_workspace
from cabinpose.core import camera_from
from cabinpose.core.errors import ConfigError, DatasetError
from cabinpose.estimate.predictor import load_model
from cabinpose.store import open_dataset, read_manifest
from cabinpose.store.labels import read_labels
from cabinpose.store.predictions import Predictions, read_predictions
from cabinpose.store.schema import dataset_id
from tests.studio.test_browser import JOINTS, canvas, tab, until

KEPT = 4, 1  # frames that are kept, in this order


@pytest.fixture(scope="module")
def live(generated: Path) -> list[Shown]:
    """All frames, each with what a model finds in it."""
    model = load_model("in_car", threads=1)
    frames = [frame for frame in DatasetFeed(generated).frames() if frame is not None]
    return [Shown(frame, ((model, Found("in_car", model.predict(frame.batch), "", 1.0)),)) for frame in frames]


@pytest.fixture
def kept(live: list[Shown]) -> list[Shown]:
    chosen: list[Shown] = []
    for number in KEPT:
        keep(chosen, live[number])
    return chosen


@pytest.fixture
def workspace(dataset_folder: Path) -> Iterator[Workspace]:
    opened = open_workspace(dataset_folder)
    yield opened
    opened.close()


def test_kept_frames_are_those_of_the_camera(kept: list[Shown], generated: Path, tmp_path: Path) -> None:
    folder, _ = write_kept(kept, tmp_path)
    written, before = open_dataset(folder), open_dataset(generated).isel(frame=list(KEPT))
    for name in ("depth", "amplitude", "camera_k", "camera_dist"):
        np.testing.assert_array_equal(written[name].values, before[name].values)
    assert written["sync_ns"].values.tolist() == [shown.frame.host_ns for shown in kept]
    assert (written["visibility"].values == 0).all()  # what a model finds is no truth


def test_depth_beyond_a_dataset_is_invalid(live: list[Shown], tmp_path: Path) -> None:
    depth = live[0].frame.batch["depth"].copy()
    depth[0, 5, 5:8] = 6.5535, 6.5536, 65.0
    batch = dict(live[0].frame.batch) | {"depth": depth}
    folder, _ = write_kept([Shown(replace(live[0].frame, batch=batch), ())], tmp_path)  # type: ignore[arg-type]
    np.testing.assert_allclose(open_dataset(folder)["depth"].values[0, 5, 5:8], (6.5535, np.nan, np.nan))


def test_answers_lie_beside_the_frames(kept: list[Shown], tmp_path: Path) -> None:
    folder, (file,) = write_kept(kept, tmp_path)
    assert file.parent == folder.parent == tmp_path
    read = read_predictions(file)
    assert read.dataset == dataset_id(read_manifest(folder))
    found = read.take(np.arange(len(KEPT)))
    for row, shown in enumerate(kept):
        ((_, answer),) = shown.found
        sure = answer.poses.presence[0] > 0.5
        assert sure.any()
        np.testing.assert_allclose(found.joints_3d[row][sure], answer.poses.joints_3d[0][sure], atol=1e-4)


def test_frame_on_which_a_model_failed_is_kept_without_its_answer(kept: list[Shown], tmp_path: Path) -> None:
    first, second = kept
    ((model, answer),) = first.found
    failed = Shown(first.frame, ((model, replace(answer, error="it cannot")),))
    _, (file,) = write_kept([failed, second], tmp_path)
    assert read_predictions(file).frame.tolist() == [1]


def test_frame_is_kept_once(kept: list[Shown], live: list[Shown]) -> None:
    keep(kept, live[KEPT[0]])
    assert len(kept) == len(KEPT)


def test_frames_of_two_sizes_are_not_kept_together(kept: list[Shown], live: list[Shown]) -> None:
    batch = dict(live[0].frame.batch) | {"depth": live[0].frame.batch["depth"][:, ::2]}
    with pytest.raises(ConfigError, match="another size"):
        keep(kept, Shown(replace(live[0].frame, batch=batch), ()))  # type: ignore[arg-type]


def test_not_more_frames_are_kept_than_memory_bears(
    kept: list[Shown], live: list[Shown], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(live_keep, "MOST", len(KEPT))
    with pytest.raises(ConfigError, match="frames are kept"):
        keep(kept, live[0])


def test_nothing_is_overwritten(kept: list[Shown], tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    clock = SimpleNamespace(now=lambda: datetime(2026, 1, 2, 3, 4, 5))  # noqa: DTZ001 - local
    monkeypatch.setattr(live_keep, "datetime", clock)
    folder, _ = write_kept(kept, tmp_path)
    assert folder.name == "kept-20260102-030405"
    with pytest.raises(DatasetError, match="already holds a dataset"):
        write_kept(kept[:1], tmp_path)
    assert open_dataset(folder).sizes["frame"] == len(KEPT)


def test_kept_frames_are_opened_to_be_labelled(workspace: Workspace, kept: list[Shown]) -> None:
    """The labels of the dataset before are let go of, its images no longer given, and proposals are what was found live."""
    before, root, key = workspace.labels, workspace.root, workspace.key
    workspace.open(*write_kept(kept, workspace.root))
    assert workspace.root == root
    another = open_workspace(root / "dataset")
    assert another.labels.path == before.path  # would be refused while somebody has them
    another.close()
    assert workspace.of_key(key) is None
    assert workspace.of_key(workspace.key) is workspace.dataset
    labelling = Labelling(workspace.dataset, workspace.labels, workspace.role)
    model = load_choice(workspace, first_choice(workspace))
    assert isinstance(model, Predictions)
    labelling.use(model)
    ((_, answer),) = kept[0].found
    neck = answer.poses.joints_2d[0, 0, model.joints.index("neck")]
    (proposed,) = (shown for shown in labelling.shown(0, "driver") if shown.joint == "neck")
    assert proposed.origin == "proposal"
    assert proposed.label is not None
    np.testing.assert_allclose(proposed.label.uv, neck, atol=0.01)


def test_image_of_another_dataset_is_not_given(workspace: Workspace, kept: list[Shown]) -> None:
    """Browsers keep images: one address must never stand for two of them."""
    app = FastAPI()
    app.include_router(image_routes(workspace.of_key))
    client, first = TestClient(app), workspace.key
    assert client.get(f"/frames/{first}/0/depth").status_code == 200
    workspace.open(*write_kept(kept, workspace.root))
    assert client.get(f"/frames/{first}/0/depth").status_code == 404
    assert client.get(f"/frames/{workspace.key}/0/depth").status_code == 200


def test_cloud_is_of_the_pixels(live: list[Shown]) -> None:
    """Each point falls on a pixel's centre of the camera and has its depth."""
    batch = live[0].frame.batch
    points, colours = live_cloud(batch)
    assert 1000 < len(points) == len(colours) <= 1.1 * MOST_LIVE
    depth = batch["depth"][0]
    forward, left, up = points.T
    uv = camera_from(batch["camera_k"][0], batch["camera_dist"][0], *depth.shape[::-1]).project(
        np.stack((-left, -up, forward), 1)
    )
    u, v = np.rint(uv).astype(int).T
    np.testing.assert_allclose(uv, np.stack((u, v), 1), atol=1e-6)
    np.testing.assert_allclose(forward, depth[v, u], rtol=1e-6)
    by_light = np.argsort(batch["amplitude"][0][v, u], kind="stable")
    assert (np.diff(colours[by_light].astype(int), axis=0) >= 0).all()


def test_skeleton_runs_through_the_joints(live: list[Shown]) -> None:
    ((model, answer),) = live[0].found
    points, colours = skeletons(live[0])
    assert len(points) == len(colours) > 0
    sure = answer.poses.presence[0, 0] > 0.5
    for name in ("neck", "rshoulder", "relbow"):
        column = model.joints.index(name)
        assert sure[column]
        x, y, z = answer.poses.joints_3d[0, 0, column]
        assert np.linalg.norm(points - (z, -x, -y), axis=1).min() < 1e-6


@pytest.mark.slow
def test_frozen_frame_is_labelled(page: Any, start: Callable[..., Any], dataset_folder: Path) -> None:
    """The frame stands in the tab Label with the joints that were found in it; the source stays as it is."""
    page.goto(start(dataset_folder).address)
    tab(page, "Live")
    page.get_by_text("cloud", exact=True).click()
    page.get_by_role("button", name="Start").click()
    page.get_by_text(re.compile(r"^driver: \d+ joints")).wait_for()
    page.get_by_role("button", name="Freeze").click()
    page.get_by_role("button", name="Go on").wait_for()
    page.get_by_role("button", name="Label this frame").click()
    page.get_by_text("0 of 1 frames done").wait_for()
    assert page.get_by_role("tab", name="Label", selected=True).is_visible()
    page.get_by_text("proposal", exact=True).first.wait_for()
    page.get_by_text(re.compile(r"^kept-[\d-]+: 1 frame$")).wait_for()
    canvas(page).click(position={"x": 5, "y": 5}, modifiers=["Shift"])
    page.keyboard.press("Enter")
    (journal,) = dataset_folder.parent.glob("kept-*.labels.jsonl")
    until(lambda: len(read_labels(journal)[1]) == JOINTS)
    assert not read_labels(dataset_folder.with_name(dataset_folder.name + ".labels.jsonl"))[1]


@pytest.mark.slow
def test_recording_is_opened_live(page: Any, start: Callable[..., Any], tmp_path: Path) -> None:
    (tmp_path / "take.mcap").touch()
    page.goto(start(tmp_path / "take.mcap").address)
    page.get_by_role("tab", name="Live", selected=True).wait_for()
    page.get_by_text("take.mcap").nth(1).wait_for()  # after the header's: the source
    for name in ("Dataset", "Label", "Compare"):
        tab(page, name)
        page.get_by_text("cabinpose align take.mcap").and_(page.locator(":visible")).wait_for()

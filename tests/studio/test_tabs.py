"""The tabs Dataset, Label and Compare, built and used without a browser."""

from __future__ import annotations

import asyncio
import json
import threading
import time
import zipfile
from collections.abc import Awaitable, Callable, Iterator, Mapping
from dataclasses import replace
from functools import partial
from pathlib import Path
from types import MappingProxyType
from typing import Any

import httpx
import numpy as np
import pytest
import yaml
from fastapi import APIRouter, FastAPI
from nicegui import ui
from nicegui.elements.upload_files import SmallFileUpload
from nicegui.testing import User, user_simulation
from nicegui.testing.user_download import UserDownload
from starlette.testclient import TestClient

from cabinpose.app.label.labelling import Labelling
from cabinpose.app.studio.canvas import MOST_INPUTS, FrameCanvas, input_routes
from cabinpose.app.studio.choice import Choice, as_dataset
from cabinpose.app.studio.clouds import cloud_routes
from cabinpose.app.studio.exchange import MOST_BYTES, zipped
from cabinpose.app.studio.live_session import LiveRoom, Shown
from cabinpose.app.studio.models import FrameErrors, frame_errors, load_choice, worst_first
from cabinpose.app.studio.page import TABS, shared_by, studio_page
from cabinpose.app.studio.pictures import image_routes
from cabinpose.app.studio.tab import Page, Tab
from cabinpose.app.studio.workspace import Workspace, open_workspace
from cabinpose.core.errors import ConfigError, DatasetError
from cabinpose.core.pose import Visibility
from cabinpose.core.skeleton import CABINPOSE
from cabinpose.store import create_dataset, open_dataset, points_m, read_manifest
from cabinpose.store.predictions import Predictions, empty_batch
from cabinpose.store.schema import MANIFEST_NAME, manifest_yaml, with_checksum_line
from cabinpose.store.variables import DEPTH_SCALE_M

SHIFT_CM = (3.0, 9.0, 1.0, 27.0, 6.0, 12.0)  # by which all joints of a frame are off


@pytest.fixture
def workspace(dataset_folder: Path) -> Iterator[Workspace]:
    """A dataset with the predictions of an oracle that is off by `SHIFT_CM`."""
    opened = open_workspace(dataset_folder)
    opened.predictions["oracle"] = off_by(opened, SHIFT_CM)
    yield opened
    opened.close()


def off_by(workspace: Workspace, shift_cm: Any) -> Predictions:
    """The dataset's joints, moved to the right, each frame by its own distance; nobody is found where that is infinite."""
    dataset = workspace.dataset
    assert dataset is not None
    batch = empty_batch(dataset.sizes["frame"], dataset.sizes["person"], dataset.sizes["joint"])
    there = (dataset["visibility"].values > Visibility.OUTSIDE_IMAGE) & np.isfinite(shift_cm)[:, None, None]
    batch.joints_2d[there] = dataset["joints_2d"].values[there]
    batch.joints_3d[there], batch.presence[there] = dataset["joints_3d"].values[there], 1.0
    batch.joints_3d[..., 0] += np.where(np.isfinite(shift_cm), shift_cm, 0)[:, None, None] / 100
    persons, joints = (tuple(str(n) for n in dataset[d].values) for d in ("person", "joint"))
    return Predictions(
        batch.joints_2d, batch.joints_3d, batch.score, batch.presence, dataset["frame"].values, persons, joints, "oracle"
    )


def used(
    workspace: Workspace,
    steps: Callable[[User], Awaitable[None]],
    *shared: Any,
    address: Mapping[str, str] = MappingProxyType({}),
) -> None:
    """Open the page and take the steps of a user; shared: in place of what the browsers of a studio share of a tab."""

    async def simulate() -> None:
        each = [*shared, *shared_by(workspace)]
        async with user_simulation(lambda: studio_page(workspace, each, address, "w")) as user:
            # What is computed beside the page may come late where the machine has more to do; it is waited for as long as that.
            vars(user).update(should_see=partial(user.should_see, retries=40))
            await user.open("/")
            await steps(user)

    asyncio.run(simulate())


def marked(user: User, mark: str) -> Any:
    """The only element with a mark."""
    (found,) = user.find(marker=mark).elements
    return found


def test_error_of_a_frame_is_how_far_its_joints_are_off(workspace: Workspace) -> None:
    assert workspace.dataset is not None
    errors = frame_errors(workspace, workspace.dataset, "oracle")
    np.testing.assert_allclose(errors.d, SHIFT_CM, rtol=1e-4)
    assert errors.unit == "cm"
    assert worst_first(errors.d).tolist() == [3, 5, 1, 4, 0, 2]


@pytest.mark.parametrize(
    ("over", "worst", "by_error", "rows"),
    [
        (None, None, True, [3, 5, 1, 4, 0, 2]),
        (None, None, False, [0, 1, 2, 3, 4, 5]),
        (6.5, None, True, [3, 5, 1]),
        (6.5, None, False, [1, 3, 5]),
        (None, 2, True, [3, 5]),
        (6.5, 2, False, [3, 5]),
        (99.0, None, True, []),
        (None, -3, True, [3]),  # typed, before the field is left
    ],
)
def test_frames_are_chosen_by_error(over: float | None, worst: int | None, by_error: bool, rows: list[int]) -> None:
    errors = FrameErrors(np.array(SHIFT_CM), "cm")
    assert errors.choose(np.arange(6), over, worst, by_error=by_error).tolist() == rows


def test_error_of_one_person_is_theirs(workspace: Workspace) -> None:
    """The order "worst first" of a person who is labelled: another one's errors do not count."""
    assert workspace.dataset is not None
    both = workspace.dataset.copy(deep=True)
    for name in ("joints_2d", "joints_3d", "visibility"):
        both[name].values[:, 1] = both[name].values[:, 0]  # somebody in the driver's place, in the next slot
    predictions = workspace.predictions["oracle"]
    for values in (predictions.joints_3d, predictions.joints_2d, predictions.presence, predictions.score):
        values[:, 1] = values[:, 0]
    predictions.joints_3d[:, 1, :, 0] += 0.3
    driver, other = (str(name) for name in both["person"].values[:2])
    np.testing.assert_allclose(frame_errors(workspace, both, "oracle", driver).d, SHIFT_CM, rtol=1e-4)
    np.testing.assert_allclose(frame_errors(workspace, both, "oracle", other).d, np.array(SHIFT_CM) + 30, rtol=1e-4)


def test_frame_in_which_nobody_is_found_is_the_worst(workspace: Workspace) -> None:
    assert workspace.dataset is not None
    workspace.predictions["oracle"] = off_by(workspace, (3.0, 9.0, np.inf, 27.0, 6.0, 12.0))
    errors = frame_errors(workspace, workspace.dataset, "oracle")
    assert worst_first(errors.d).tolist()[:2] == [2, 3]
    assert errors.words(2) == "nobody found"
    nobody = workspace.dataset.copy()
    nobody["visibility"] = nobody["visibility"] * (nobody["frame"] != 2)
    errors = frame_errors(workspace, nobody, "oracle")
    assert np.isnan(errors.d[2])  # where nobody is, nothing is wrong
    assert worst_first(errors.d).tolist()[-1] == 2


def test_dataset_tab_goes_from_the_worst_frame_to_its_labels(workspace: Workspace) -> None:
    async def steps(user: User) -> None:
        marked(user, "error of").set_value("oracle")
        await user.should_see(kind=ui.number, content="over, cm")
        await user.should_see("frame 3")
        user.find(kind=ui.number, content="over, cm").elements.pop().set_value(6.5)
        await user.should_see("3 of 6 frames")
        user.find("Label this frame").click()  # the first that is seen, that of the tab Dataset
        await user.should_see("frame 3, 4 of 6")

    used(workspace, steps)


def test_frames_are_asked_for_by_a_condition(workspace: Workspace) -> None:
    """A condition with the errors of what is chosen; what is none is said at its field, and the frames of before stay."""

    async def steps(user: User) -> None:
        async def ask(condition: str) -> None:
            marked(user, "where").set_value(condition)
            user.find(marker="where").trigger("keydown.enter")
            await asyncio.sleep(0)

        await ask('car == "suv" and frame >= 2')
        await user.should_see("4 of 6 frames")
        await ask("error_cm > 6.5")
        await user.should_see("unknown coordinate 'error_cm'")
        await user.should_see("4 of 6 frames")
        user.find("Take these frames out").click()
        await user.should_see('car == "suv" and frame >= 2', kind=ui.label)  # by which they were chosen
        marked(user, "error of").set_value("oracle")
        await user.should_see("3 of 6 frames")
        await user.should_not_see("unknown coordinate")
        await ask("")
        await user.should_see("6 of 6 frames")

    used(workspace, steps)


def test_keys_go_through_the_frames_as_fast_as_the_browser_shows_them(workspace: Workspace) -> None:
    """What comes while it loads a frame is one step, once it has; one that does not answer is waited for no longer than 2 s."""

    async def steps(user: User) -> None:
        frames, canvas = marked(user, "frames"), user.find(marker="frame")

        async def press(*keys: str) -> float:
            for key in keys:
                canvas.trigger("pressed", key)
            await asyncio.sleep(0)
            return float(frames.value)

        assert [await press(key) for key in ("ArrowRight", "End", "ArrowLeft", "Home", "PageDown", "x")] == [1, 5, 4, 0, 5, 5]
        canvas.trigger("loaded")
        assert await press("Home") == 0
        assert await press("ArrowRight", "ArrowRight", "ArrowRight") == 0
        canvas.trigger("loaded")
        assert await press() == 3
        assert await press("ArrowRight") == 3
        await asyncio.sleep(3.5)
        assert frames.value == 4

    used(workspace, steps)


def test_images_and_clouds_travel_packed(workspace: Workspace) -> None:
    """As they are, in fewer bytes; the cloud's points lie on the rays of valid pixels."""
    dataset = workspace.dataset
    assert dataset is not None
    server = FastAPI()
    server.include_router(image_routes(workspace.of_key))
    server.include_router(cloud_routes(workspace.of_key))
    client = TestClient(server)
    for name in ("depth", "amplitude", "confidence", "labels"):
        values = dataset[name][3].values
        answer = client.get(workspace.url(3, name))
        wide = answer.headers["x-bits"] == "16"
        assert int(answer.headers["content-length"]) < 0.7 * values.size * (2 if wide else 1)
        stored = np.rint(np.nan_to_num(values) / DEPTH_SCALE_M) if name == "depth" else values
        np.testing.assert_array_equal(unpacked(answer.content, 0, values.size, wide=wide), stored.ravel())
    answer = client.get(workspace.cloud_url(3, "depth"))
    count = int(answer.headers["x-points"])
    cloud = np.stack([unpacked(answer.content, 2 * axis * count, count, wide=True).astype(np.int16) for axis in range(3)], axis=1)
    camera_from_vehicle = np.linalg.inv(dataset["vehicle_from_camera"].values[3])
    points = points_m(dataset.isel(frame=3)).values.reshape(-1, 3)
    seen = np.c_[cloud / 1000, np.ones(count)] @ camera_from_vehicle.T
    every = points[np.isfinite(points).all(axis=1)]
    assert abs(len(every) / count - 2) < 1e-3
    np.testing.assert_allclose(seen[:, :3], every[::2], atol=0.001)
    assert client.get(workspace.cloud_url(3, "labels")).status_code == 404
    assert client.get(workspace.cloud_url(9, "depth")).status_code == 404


def unpacked(body: bytes, begin: int, count: int, *, wide: bool) -> Any:
    """The `count` numbers that differences stand for, by what `packed` says of them."""
    low = np.frombuffer(body, np.uint8, count, begin).astype(int)
    even = low + 256 * np.frombuffer(body, np.uint8, count, begin + count).astype(int) if wide else low
    return np.cumsum(np.where(even % 2, -(even + 1) // 2, even // 2)) % (65536 if wide else 256)


def test_worst_frames_of_predictions_are_labelled_first(workspace: Workspace) -> None:
    async def steps(user: User) -> None:
        user.find("Label", kind=ui.tab).click()
        await user.should_see("frame 0, 1 of 6")
        marked(user, "order").set_value("worst:oracle")
        await user.should_see("frame 3, 1 of 6")

    used(workspace, steps)


def test_keys_that_come_while_frames_are_ordered_are_for_whom_is_seen(
    workspace: Workspace, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Another person, then other joints, in an order that takes its time: shown at once; the order asked for last holds."""
    begun, go_on = threading.Event(), threading.Event()

    def slowly(*given: Any) -> FrameErrors:
        begun.set()
        go_on.wait(10.0)
        return frame_errors(*given)

    async def steps(user: User) -> None:
        user.find("Label", kind=ui.tab).click()
        await user.should_see("frame 0, 1 of 6")
        monkeypatch.setattr("cabinpose.app.studio.label_tab.frame_errors", slowly)
        marked(user, "order").set_value("worst:oracle")
        await asyncio.to_thread(begun.wait, 10.0)
        marked(user, "person").set_value("front_passenger")
        marked(user, "joint set").set_value("wrists and hips")
        await asyncio.sleep(0.1)
        (seen,) = label_canvas(user).props["people"]
        assert [joint["name"] for joint in seen["joints"]] == list(CABINPOSE.sets["wrists and hips"])
        marked(user, "order").set_value("open")
        await asyncio.sleep(0.1)
        user.find("Accept").click()
        await user.should_see("frame 1, 2 of 6")
        go_on.set()
        await asyncio.sleep(1.0)
        await user.should_see("frame 1, 2 of 6")
        assert {key[:2] for key in workspace.labels.now} == {(0, "front_passenger")}

    used(workspace, steps)


def test_a_model_that_proposes_nothing_here_says_so(workspace: Workspace) -> None:
    """Of other people; and one that cannot be opened is not the one that is chosen."""
    workspace.predictions["strangers"] = replace(workspace.predictions["oracle"], persons=tuple("abcde"))

    async def steps(user: User) -> None:
        user.find("Label", kind=ui.tab).click()
        await user.should_see("frame 0, 1 of 6")
        marked(user, "proposals").set_value("file:strangers")
        await user.should_see("it proposes nothing: it knows a, b, c, d, e; here are driver, front_passenger")
        marked(user, "proposals").set_options({**marked(user, "proposals").options, "gone.onnx": "gone"})
        marked(user, "proposals").set_value("gone.onnx")
        await user.should_see("gone.onnx")
        await asyncio.sleep(0.3)
        assert marked(user, "proposals").value == ""

    used(workspace, steps)


def test_a_model_that_fails_late_leaves_what_was_chosen_since(workspace: Workspace, monkeypatch: pytest.MonkeyPatch) -> None:
    go_on = threading.Event()

    def slowly(*given: Any) -> Any:
        if given[1] != "gone.onnx":
            return load_choice(*given)
        go_on.wait(10.0)
        raise ConfigError("gone.onnx is gone")

    monkeypatch.setattr("cabinpose.app.studio.label_tab.load_choice", slowly)

    async def steps(user: User) -> None:
        user.find("Label", kind=ui.tab).click()
        await user.should_see("frame 0, 1 of 6")
        marked(user, "proposals").set_options({**marked(user, "proposals").options, "gone.onnx": "gone"})
        marked(user, "proposals").set_value("gone.onnx")
        await asyncio.sleep(0.2)
        marked(user, "proposals").set_value("file:oracle")
        go_on.set()
        await user.should_see("gone.onnx is gone")
        assert marked(user, "proposals").value == "file:oracle"

    used(workspace, steps)


def test_frame_without_the_person_is_opened_with_somebody_who_is_there(workspace: Workspace) -> None:
    assert workspace.dataset is not None
    seen = workspace.dataset["visibility"].values.copy()
    seen[2, 0] = Visibility.ABSENT
    seen[2, 3, 5] = Visibility.VISIBLE
    workspace.dataset["visibility"] = workspace.dataset["visibility"].copy(data=seen)
    there = str(workspace.dataset["person"].values[np.flatnonzero(seen[2].any(axis=1))[0]])

    async def steps(user: User) -> None:
        marked(user, "frames").set_value(2)
        user.find("Label this frame").click()
        await user.should_see("frame 2, 3 of 6")
        assert marked(user, "person").value == there != "driver"
        await asyncio.sleep(0.3)
        await user.should_see("frame 2, 3 of 6")

    used(workspace, steps)


def test_two_predictions_of_one_model_are_two(workspace: Workspace) -> None:
    workspace.predictions["oracle (2.jsonl)"] = off_by(workspace, [2 * shift for shift in SHIFT_CM])

    async def steps(user: User) -> None:
        user.find("Compare", kind=ui.tab).click()
        await user.should_see("frame 3: oracle 27.0 cm, oracle (2.jsonl) 54.0 cm")

    used(workspace, steps)


def test_a_run_stands_beside_a_file_of_the_same_model(workspace: Workspace, predicted: Path) -> None:
    """Which it took the place of; what the model found here before gives way."""
    assert workspace.add_predictions(predicted) == "in_car"
    run = replace(workspace.predictions["oracle"], model="in_car")
    assert [workspace.add_run(run) for _ in range(2)] == ["in_car (run here)"] * 2
    assert list(workspace.predictions) == ["oracle", "in_car", "in_car (run here)"]
    assert workspace.add_run(replace(run, model="paf")) == "paf"


def test_a_run_is_not_of_the_dataset_that_was_opened_meanwhile(
    workspace: Workspace, dataset_folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    found = workspace.predictions["oracle"]

    def slowly(*_: Any, **__: Any) -> Predictions:
        workspace.open(dataset_folder)
        time.sleep(1.5)  # the tab has been built anew
        return found

    monkeypatch.setattr("cabinpose.app.studio.compare_tab.predict_dataset", slowly)

    async def steps(user: User) -> None:
        user.find("Compare", kind=ui.tab).click()
        user.find("Run", kind=ui.button).click()
        await user.should_see("another dataset was opened meanwhile")
        assert not workspace.predictions

    used(workspace, steps)


def test_corrected_labels_count_before_the_tab_label_is_there(workspace: Workspace, dataset_folder: Path) -> None:
    """A studio that begins with Compare, and one beside another that has the labels."""
    Labelling(workspace.dataset, workspace.labels).place(3, "driver", "neck", 50.0, 51.0)
    other = open_workspace(dataset_folder)
    for each in (other, workspace):
        assert each.dataset is not None
        corrected = each.corrected(each.dataset).sel(person="driver", joint="neck")["joints_2d"].values
        assert corrected[3].tolist() == [50.0, 51.0]
    workspace.labels.path.write_text("no journal\n")
    with pytest.raises(DatasetError, match="not a line of JSON"):
        other.corrected(other.dataset)


def test_what_is_chosen_last_is_judged(workspace: Workspace, monkeypatch: pytest.MonkeyPatch) -> None:
    """However long those before take; and a reload goes on with the frame that was shown."""
    workspace.predictions["other"] = off_by(workspace, [2.0, *[1.0] * 5])
    go_on = threading.Event()

    def slowly(*given: Any) -> FrameErrors:
        if given[2] == "oracle":
            go_on.wait(10.0)
        return frame_errors(*given)

    async def shows(user: User, frame: int, error: str) -> None:
        for _ in range(40):
            if marked(user, "frame number").text == f"frame {frame}" and f"{error} cm" in marked(user, "frame facts").content:
                return
            await asyncio.sleep(0.1)
        pytest.fail(f"{marked(user, 'frame number').text}: {marked(user, 'frame facts').content}")

    async def steps(user: User) -> None:
        await shows(user, 2, ">1.0")
        monkeypatch.setattr("cabinpose.app.studio.dataset_tab.frame_errors", slowly)
        marked(user, "error of").set_value("oracle")
        await asyncio.sleep(0.2)
        marked(user, "error of").set_value("other")
        await shows(user, 0, ">2.0")
        go_on.set()
        await asyncio.sleep(0.5)
        marked(user, "frames").set_value(1)
        await shows(user, 1, ">1.0")
        marked(user, "error of").set_value("oracle")
        await shows(user, 3, ">27.0")  # the worst of these comes first

    used(workspace, steps, address={"dataset.errors": "other", "dataset.frame": "2"})


def test_frames_in_which_one_model_is_better_are_listed(workspace: Workspace) -> None:
    """The worst frames of each of two, and those where the other is nearer; arrows and joints as well."""
    workspace.predictions["other"] = off_by(workspace, [1.0, 30.0, 1.0, 30.0, 30.0, 30.0])

    async def steps(user: User) -> None:
        user.find("Compare", kind=ui.tab).click()
        await user.should_see("frame 1: oracle")
        marked(user, "worst of").set_value("worst:oracle")
        await user.should_see("frame 3: oracle 27.0 cm, other 30.0 cm")
        marked(user, "worst of").set_value("better:other|oracle")
        await user.should_see("frame 0: oracle")
        await user.should_not_see("frame 3: oracle")
        marked(user, "worst of").set_value("seats:oracle")
        await user.should_see("there are none")
        await user.should_not_see(marker="places")
        marked(user, "joint").set_value("lwrist")
        await user.should_see(marker="places")

    used(workspace, steps)


def test_what_evaluate_says_before_its_numbers_stands_in_compare(workspace: Workspace) -> None:
    """An answer in millimetres, one that names no dataset, and one of which nothing is said."""
    oracle, dataset = workspace.predictions["oracle"], workspace.dataset
    assert dataset is not None
    known = replace(oracle, dataset=dataset.attrs["dataset_id"])
    workspace.predictions |= {"known": known, "scaled": replace(known, joints_3d=1000 * known.joints_3d)}

    async def steps(user: User) -> None:
        user.find("Compare", kind=ui.tab).click()
        await user.should_see("oracle: the predictions name no dataset")
        await user.should_see("scaled: errors fall from")
        await user.should_see("if x, y and z are millimetres in place of metres")
        await user.should_not_see("known: ")

    used(workspace, steps)


def test_predictions_that_come_later_are_offered(workspace: Workspace) -> None:
    late = workspace.predictions.pop("oracle")

    async def steps(user: User) -> None:
        await user.should_see("6 of 6 frames")
        workspace.predictions["late"] = late
        for _ in range(40):
            if "late" in marked(user, "error of").options:
                return
            await asyncio.sleep(0.1)
        pytest.fail("they were not offered")

    used(workspace, steps)


def test_frame_that_is_not_in_the_order_is_shown_all_the_same(workspace: Workspace) -> None:
    """Of the frames still to be labelled, one that is done is asked for."""

    async def steps(user: User) -> None:
        user.find("Label", kind=ui.tab).click()
        await user.should_see("frame 0, 1 of 6")
        user.find("Accept").click()
        await user.should_see("1 of 6 frames done")
        marked(user, "order").set_value("open")
        await user.should_see("frame 1, 1 of 5")
        user.find("Dataset", kind=ui.tab).click()
        user.find("Label this frame").click()
        await user.should_see("frame 0, 1 of 6, done")

    used(workspace, steps)


def test_who_has_labelled_all_frames_is_told_so(workspace: Workspace) -> None:
    async def steps(user: User) -> None:
        user.find("Label", kind=ui.tab).click()
        for count in range(1, 7):
            await user.should_see(f"{count - 1} of 6 frames done" if count > 1 else "frame 0, 1 of 6")
            user.find("Accept").click()
        await user.should_see("6 of 6 frames done")
        marked(user, "order").set_value("open")
        await user.should_see("all frames of driver are labelled")
        await user.should_see("frame 0, 1 of 6, done")

    used(workspace, steps)


def test_coco_goes_out_and_comes_back_corrected(workspace: Workspace, monkeypatch: pytest.MonkeyPatch) -> None:
    """Downloaded, one keypoint moved, uploaded: that joint is a label, and undo takes it back."""
    given: list[Path] = []
    monkeypatch.setattr(UserDownload, "file", lambda _, path, name: given.append(path) if name == "dataset-coco.zip" else None)

    async def steps(user: User) -> None:
        user.find("Label", kind=ui.tab).click()
        await user.should_see("0 of 6 frames done")
        user.find("Download frames and labels").click()
        while not given:
            await asyncio.sleep(0.1)
        with zipfile.ZipFile(given[0]) as archive:
            assert sum(name.endswith(".png") for name in archive.namelist()) == 6
            coco = json.loads(archive.read("annotations/person_keypoints.json"))
        person = coco["annotations"][0]
        person["keypoints"][3] += 11
        upload = marked(user, "corrected")
        await upload.handle_uploads([SmallFileUpload("c.json", "application/json", json.dumps(coco).encode())])
        await user.should_see("1 joints corrected in 1 frames")
        assert list(workspace.labels.now) == [(person["image_id"], person["slot"], "neck")]
        assert workspace.labels.history[-1].how == "imported"
        await upload.handle_uploads([SmallFileUpload("c.json", "application/json", b"{}")])
        await user.should_see("c.json has no category with keypoints")
        assert len(workspace.labels.history) == 1
        await upload.handle_uploads([SmallFileUpload("c.json", "application/json", b" " * (MOST_BYTES + 1))])
        await user.should_see("of at most 64 MB")
        user.find("Undo").click()
        await user.should_see("2 changes")
        assert workspace.labels.now == {}

    used(workspace, steps)


@pytest.mark.parametrize("what", ["journal", "dataset"])
def test_label_tab_says_that_it_takes_nothing_more(workspace: Workspace, dataset_folder: Path, what: str) -> None:
    """Before anybody changes a joint; once it is back, the tab goes on."""

    async def steps(user: User) -> None:
        user.find("Label", kind=ui.tab).click()
        user.find("Accept").click()
        await user.should_see("1 of 6 frames done")
        gone = workspace.labels.path if what == "journal" else dataset_folder
        aside = gone.rename(gone.with_name("aside"))
        await user.should_see("Nothing more is taken")
        assert not user.find("Accept", kind=ui.button).elements.pop().enabled
        aside.rename(gone)
        await user.should_not_see("Nothing more is taken", retries=40)
        user.find("Accept").click()
        await user.should_see("2 of 6 frames done")

    used(workspace, steps)


def test_undo_says_what_another_window_has_set(workspace: Workspace) -> None:
    async def steps(user: User) -> None:
        user.find("Label", kind=ui.tab).click()
        user.find("Accept").click()
        await user.should_see("1 of 6 frames done")
        Labelling(workspace.dataset, workspace.labels).place(0, "driver", "neck", 50.0, 51.0)
        user.find("Undo").click()
        await user.should_see("13 joints undone; 1 stay: they were set in another window since")
        assert list(workspace.labels.now) == [(0, "driver", "neck")]

    used(workspace, steps)


def label_canvas(user: User) -> FrameCanvas:
    (canvas,) = (c for c in user.find(kind=FrameCanvas).elements if c.props["inputs"])
    return canvas


async def asked(canvas: FrameCanvas, keys: str, first: int, *, window: str = "one", **values: Any) -> dict[str, Any]:
    """What a window is answered, with the status, when it sends keys over the image that is shown, numbered from `first`."""
    server = FastAPI()
    server.include_router(input_routes())
    shown = {"event": "key", "url": canvas.props["url"]}
    inputs = [shown | {"n": first + i, "key": key} | values for i, key in enumerate(keys)]
    async with httpx.AsyncClient(transport=httpx.ASGITransport(server), base_url="http://127.0.0.1") as http:
        answer = await http.post(canvas.props["inputs"], json={"window": window, "inputs": inputs})
    told: dict[str, Any] = answer.json() | {"code": answer.status_code}
    return told


def test_inputs_are_done_once_and_in_order_or_told(workspace: Workspace) -> None:
    """What windows send: keys, the same request again, what was meant for an image before, and what cannot be kept."""

    async def steps(user: User) -> None:
        user.find("Label").click()
        await user.should_see("0 of 6 frames done")
        canvas, journal = label_canvas(user), workspace.labels.path
        ask = partial(asked, canvas)

        def states() -> list[tuple[str, int]]:
            return [(change["joint"], change["visibility"]) for change in map(json.loads, journal.read_text().splitlines()[1:])]

        done = {"code": 200, "missed": 0, "refused": 0, "why": ""}
        first, second, third = CABINPOSE.sets["upper body"][:3]
        assert await ask("vh", 1) == done | {"taken": 2}
        assert await ask("vho", 1) == done | {"taken": 3}  # an answer was lost: two of these are done already
        assert states() == [(first, Visibility.VISIBLE), (second, Visibility.OCCLUDED), (third, Visibility.OUTSIDE_IMAGE)]
        assert await ask("z", 1, window="two") == done | {"taken": 1}  # another window counts for itself
        assert len(states()) == 4
        assert await ask("vv", 4, url="/frames/before") == done | {"taken": 5, "missed": 2}
        place = {"event": "place", "u": 30.0, "v": 40.0}
        assert (await ask("-", 6, **place))["taken"] == 6
        (placed,) = (json.loads(line) for line in journal.read_text().splitlines()[5:])
        assert (placed["how"], placed["u"], placed["v"]) == ("placed", 30.0, 40.0)
        assert (await ask("-", 7, u="x"))["code"] == 422
        assert (await ask("v" * (MOST_INPUTS + 1), 7))["code"] == 422
        journal.rename(journal.with_name("aside"))
        told = await ask("vh", 7)
        assert (told["taken"], told["refused"]) == (8, 2)
        assert "was deleted or renamed" in told["why"]
        assert not journal.exists()
        canvas.delete()
        assert (await ask("v", 9))["code"] == 404

    used(workspace, steps)


def test_inputs_over_a_dataset_that_was_replaced_are_refused(workspace: Workspace, dataset_folder: Path) -> None:
    async def steps(user: User) -> None:
        user.find("Label").click()
        await user.should_see("0 of 6 frames done")
        canvas, journal = label_canvas(user), workspace.labels.path
        assert (await asked(canvas, "v", 1))["refused"] == 0
        lines = journal.read_text()
        other = read_manifest(dataset_folder).model_copy(update={"seed": 4})
        create_dataset(dataset_folder, other, overwrite=True).close()  # as `synth --overwrite` begins
        why = f"{dataset_folder} is another dataset now (end the studio and open it again)"
        refused = {"code": 200, "taken": 3, "missed": 0, "refused": 2, "why": why}
        assert await asked(canvas, "vz", 2) == refused
        assert journal.read_text() == lines
        await user.should_see(f"Nothing more is taken: {why}")
        assert not canvas.props["editable"]

    used(workspace, steps)


def test_frames_that_come_are_offered(dataset_folder: Path) -> None:
    """The second of three parts comes last, as on a cluster: frames keep their numbers, and images their frames."""
    part = dataset_folder / "part-00001.zarr"
    part.rename(dataset_folder.parent / "later")
    with pytest.warns(UserWarning, match="lacks 1 of 3 parts"):
        workspace = open_workspace(dataset_folder)
    server = FastAPI()
    server.include_router(image_routes(workspace.of_key))

    def seen(url: str) -> Any:
        content = TestClient(server).get(url).content
        return unpacked(content, 0, len(content) // 2, wide=True)

    before = workspace.url(4, "depth")
    seen_before = seen(before)
    assert workspace.new_frames() == 0

    async def steps(user: User) -> None:
        await user.should_see("4 of 4 frames")
        await user.should_not_see("Show them")
        (dataset_folder.parent / "later").rename(part)
        await user.should_see("2 frames have come since this was opened")
        user.find("Show them").click()
        await user.should_see("6 of 6 frames")
        await user.should_not_see("Show them")

    used(workspace, steps)
    assert workspace.url(4, "depth") == before  # what the browser has kept goes on being right: a frame keeps its number
    assert workspace.dataset is not None
    assert workspace.dataset["frame"].values.tolist() == [0, 1, 2, 3, 4, 5]
    whole = open_dataset(dataset_folder)
    for image in (seen_before, seen(before)):
        np.testing.assert_array_equal(image, np.rint(np.nan_to_num(whole["depth"].sel(frame=4).values) / DEPTH_SCALE_M).ravel())
    workspace.close()


def test_dataset_that_vanishes_is_told_and_comes_back(workspace: Workspace, dataset_folder: Path) -> None:
    """All tabs go on; a page that is opened meanwhile says what to do."""
    aside = dataset_folder.parent / "aside"

    async def steps(user: User) -> None:
        await user.should_see("6 of 6 frames")
        dataset_folder.rename(aside)
        await user.should_see("dataset has vanished")
        await user.should_see("bring it back to where it was")
        user.find("Label", kind=ui.tab).click()
        await user.should_see("Nothing more is taken")
        user.find("chevron_right", kind=ui.button).click()  # to the next frame, which cannot be shown
        await user.should_see("this frame cannot be read: ")
        user.find("Compare", kind=ui.tab).click()
        user.notify.messages.clear()
        user.find("frame 0: 3.0 cm").click()
        await user.should_see("this frame cannot be read")
        await user.open("/")
        await user.should_see("What was opened cannot be read")
        await user.should_see("dataset has vanished")
        aside.rename(dataset_folder)
        user.notify.messages.clear()
        await user.open("/")
        await user.should_see("6 of 6 frames")
        await user.should_not_see("has vanished")

    used(workspace, steps)


def test_part_that_goes_and_another_dataset_in_its_place_are_told(workspace: Workspace, dataset_folder: Path) -> None:
    assert workspace.trouble() is None
    (dataset_folder / "part-00002.zarr").rename(dataset_folder.parent / "aside")
    with pytest.raises(DatasetError, match=r"has lost part-00002\.zarr"):
        workspace.new_frames()
    (dataset_folder.parent / "aside").rename(dataset_folder / "part-00002.zarr")
    assert workspace.new_frames() == 0
    with pytest.raises(ConfigError, match="no frame is chosen"):
        as_dataset(workspace, Choice(np.arange(0), ""), dataset_folder.with_name("chosen"), labels=False)
    manifest = read_manifest(dataset_folder).model_copy(update={"seed": 77})
    (dataset_folder / MANIFEST_NAME).write_text(with_checksum_line(manifest_yaml(manifest)))
    choice = Choice(np.arange(2), "")
    for asks in (
        workspace.check,
        lambda: as_dataset(workspace, choice, dataset_folder.with_name("chosen"), labels=False),
        lambda: zipped(workspace, workspace.dataset, dataset_folder.parent),
    ):
        with pytest.raises(DatasetError, match="is another dataset now"):
            asks()


class Notes:
    """What the browsers of a studio share of a tab that is added."""

    def __init__(self, workspace: Workspace) -> None:
        self.opened = str(workspace.folder)

    def routes(self) -> APIRouter:
        router = APIRouter()
        router.get("/notes")(lambda: self.opened)
        return router

    def stop(self) -> None:
        """Nothing runs."""


def test_a_tab_is_a_row_of_the_table(workspace: Workspace, monkeypatch: pytest.MonkeyPatch) -> None:
    built = []

    def build(page: Page) -> None:
        built.append(page.of_studio(Notes).opened)
        ui.button(f"Look {len(built)}", on_click=lambda: page.label(1))

    monkeypatch.setattr("cabinpose.app.studio.page.TABS", (*TABS, Tab("Notes", build, of_dataset=True, shared=Notes)))

    async def steps(user: User) -> None:
        user.find("Notes", kind=ui.tab).click()
        user.find("Look 1").click()
        await user.should_see("frame 1, 2 of 6")
        workspace.key = "another"  # another dataset was opened
        await user.should_see("Look 2")
        assert built == [str(workspace.folder)] * 2

    used(workspace, steps)


def test_a_scene_is_opened_by_who_looks_at_it(tmp_path: Path) -> None:
    """Where one is named at once, with what is wrong with it told in its tab; where none is, when somebody asks."""
    (tmp_path / "scene.yaml").write_text("[")

    async def broken(user: User) -> None:
        await user.should_see("The scene cannot be opened")

    async def begun(user: User) -> None:
        user.find("Scene", kind=ui.tab).click()
        await user.should_see("No scene is open")
        await user.should_not_see("Generate")
        user.find("Begin a new one here").click()
        await user.should_see("Generate")

    used(open_workspace(tmp_path / "scene.yaml"), broken)
    used(Workspace(), begun)


def test_cameras_of_extensions_are_offered(extension: Callable[..., None], tmp_path: Path) -> None:
    code = "from cabinpose.record.sources.tof import SimulatedSource\nclass Source(SimulatedSource): ...\n"
    extension("acme", {"sources": {"acme": "Source"}}, code)
    extension("broken", {"sources": {"lidar": "Source"}}, "raise RuntimeError('no licence')")

    async def steps(user: User) -> None:
        user.find("Live", kind=ui.tab).click()
        kinds = ["simulated", "synth", "royale", "bta", "genicam", "orbbec", "realsense", "oak", "v4l2", "acme"]
        assert marked(user, "source").options == kinds

    with pytest.warns(UserWarning, match="of broken cannot be loaded: RuntimeError: no licence"):
        used(Workspace(), steps)


ADJUSTABLE = """
from typing import ClassVar
import numpy as np
from cabinpose.core import Camera
from cabinpose.record.sources import FrameNumbers
from cabinpose.record.sources.tof import AdjustableSource, CameraSetup, Control, RefusedError, frame_of
class Settings(CameraSetup):
    cannot: ClassVar = {"modulation_hz": "it is fixed"}
class Source(AdjustableSource):
    Settings: ClassVar = Settings
    def _controls(self):
        have = {"integration_us": 1000, "frame_rate_hz": 25}
        def put(name, value):
            if value > 1000:
                raise RefusedError("up to 1000")
            have[name] = value // 16 * 16 if name == "integration_us" else value
        for name in have:
            yield Control(name, getattr(self.settings, name), lambda value, n=name: put(n, value), lambda n=name: have[n])
    def _connect(self):
        self._set_up()
        self._numbers = FrameNumbers(self.counts)
    def _wait(self, timeout_s):
        self._clock.sleep(0.05)
        self._deliver(None)
    def _disconnect(self): ...
    def _alive(self): return True
    def _number(self, payload, host_ns): return self._numbers.forward(), host_ns
    def _decode(self, payload):
        return frame_of(Camera(8, 6, 8.0, 8.0, 4.0, 3.0), np.full((6, 8), 4000, np.uint16), 0.00025)
"""


def test_a_camera_is_set_up_in_its_panel(extension: Callable[..., None]) -> None:
    """Fields of the keys that the kind has; what the camera has then is shown, and what it refuses."""
    extension("adjustable", {"sources": {"adjustable": "Source"}}, ADJUSTABLE)

    async def steps(user: User) -> None:
        user.find("Live", kind=ui.tab).click()
        source, fields = marked(user, "source"), ("integration_us", "frame_rate_hz", "modulation_hz")
        for kind, there in (("simulated", ()), ("bta", fields), ("adjustable", fields[:2])):
            source.value = kind
            for field in fields:
                await (user.should_see if field in there else user.should_not_see)(marker=field, retries=100)
        marked(user, "integration_us").value = 500
        user.find("Start").click()
        await user.should_see("integration_us 496 (asked 500), frame_rate_hz 25", retries=100)
        marked(user, "integration_us").value = 5000
        user.find("Start").click()
        await user.should_see("the camera refuses integration_us 5000: up to 1000", retries=100)
        user.find("settings").type("integration_us=3")
        user.find("Start").click()
        await user.should_see("integration_us is given twice", retries=100)

    used(Workspace(), steps)


@pytest.mark.slow
def test_a_start_that_fails_leaves_its_reason_and_no_picture(dataset_folder: Path, tmp_path: Path) -> None:
    """And what is open stands in the settings of the source that takes it; what is seen is recorded line by line."""
    (tmp_path / "scene.yaml").write_text("scene:\n  cars: [suv]\n")
    workspace = open_workspace(dataset_folder)
    workspace.scene = tmp_path / "scene.yaml"

    async def steps(user: User) -> None:
        user.find("Live", kind=ui.tab).click()
        source, settings = marked(user, "source"), marked(user, "settings")
        source.value = "synth"
        await user.should_see("scenes=")
        assert Path(yaml.safe_load(settings.value.removeprefix("scenes="))) == workspace.scene.resolve()
        settings.value = "seed=1"
        source.value = "simulated"
        assert settings.value == "seed=1"  # what was typed stays
        settings.value, source.value = "", str(dataset_folder)
        user.find("record what is seen").click()
        user.find("Start").click()
        await user.should_see("recorded in live-", retries=100)
        pictures = [each for each in user.find(kind=FrameCanvas).elements if "/live/" in each.props["url"]]
        assert len(pictures) == 2
        settings.value = "faults.rate_hz=-1"
        user.find("Start").click()
        await user.should_see("rate_hz", kind=ui.label, retries=100)
        await asyncio.sleep(0.5)
        await user.should_see("rate_hz", kind=ui.label)
        assert {each.props["url"] for each in pictures} == {""}

    used(workspace, steps)
    (lines,) = tmp_path.glob("live-*.jsonl")
    rows = [json.loads(line) for line in lines.read_text().splitlines()]
    assert [row["frame"] for row in rows] == sorted(row["frame"] for row in rows)
    assert rows
    assert {model["model"] for row in rows for model in row["models"]} == {"in_car"}
    assert not list(tmp_path.glob("live-*.mcap"))  # it is recorded already


def test_a_run_that_was_stopped_says_how_it_ended_and_its_frames_are_labelled(dataset_folder: Path) -> None:
    """Also where the frame that is shown cannot be among those that are kept: others are of another size."""
    workspace = open_workspace(dataset_folder)
    room = LiveRoom()

    async def steps(user: User) -> None:
        user.find("Live", kind=ui.tab).click()
        user.find("Start").click()
        await user.should_see("ended: ", retries=100)
        user.find("Keep", kind=ui.button).click()
        other = dict(room.kept[0].frame.batch)
        other["depth"] = other["depth"][:, ::2]
        room.frozen = Shown(replace(room.kept[0].frame, batch=other), ())
        user.find("Keep", kind=ui.button).click()
        await user.should_see("the frames that are kept have another size")
        user.find("Stop").click()
        await user.should_see("Label 1 kept")
        await user.should_see("ended: ")
        room.frozen = Shown(replace(room.kept[0].frame, batch=other), ())
        await user.should_see("Label this and 1 kept")
        user.find("Label this and 1 kept").click()
        await user.should_see("0 of 1 frames done", retries=100)
        assert room.kept == []

    used(workspace, steps, room)
    workspace.close()


def test_the_keys_of_a_tab_are_listed(workspace: Workspace) -> None:
    async def steps(user: User) -> None:
        await user.should_not_see("interpolate up to")
        user.find("keyboard", kind=ui.button).click()
        await user.should_see("interpolate up to the next labelled frame")
        for title in ("Dataset", "Label", "Everywhere"):
            await user.should_see(title, kind=ui.label)

    used(workspace, steps)

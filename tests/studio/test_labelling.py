"""What labelling does, without a browser."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import closing
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import xarray as xr

from cabinpose.app.cli import main
from cabinpose.app.label.labelling import Labelling
from cabinpose.app.studio.workspace import Workspace, open_workspace
from cabinpose.core.errors import DatasetError
from cabinpose.core.pose import Visibility
from cabinpose.core.skeleton import CABINPOSE
from cabinpose.store import camera_of
from cabinpose.store.labels import JointLabel
from cabinpose.store.predictions import Predictions, empty_batch

DRIVER = "driver"


@pytest.fixture
def workspace(dataset_folder: Path) -> Iterator[Workspace]:
    opened = open_workspace(dataset_folder)
    yield opened
    opened.close()


@pytest.fixture
def labelling(workspace: Workspace) -> Labelling:
    return Labelling(workspace.dataset, workspace.labels, workspace.role)


def truth_as_predictions(workspace: Workspace, shift: float = 0.0, presence: float = 0.9) -> Predictions:
    """The dataset's own joints, moved to the right by some pixels, as if a model had found them."""
    dataset = workspace.dataset
    assert dataset is not None
    batch = empty_batch(dataset.sizes["frame"], dataset.sizes["person"], dataset.sizes["joint"])
    there = dataset["visibility"].values > Visibility.OUTSIDE_IMAGE
    batch.joints_2d[there] = dataset["joints_2d"].values[there] + (shift, 0)
    batch.joints_3d[there] = dataset["joints_3d"].values[there]
    batch.presence[there] = presence
    names = [tuple(str(n) for n in dataset[d].values) for d in ("person", "joint")]
    return Predictions(
        batch.joints_2d, batch.joints_3d, batch.score, batch.presence, dataset["frame"].values, names[0], names[1], "oracle"
    )


def test_joints_go_along_the_skeleton(labelling: Labelling) -> None:
    assert labelling.joints == CABINPOSE.sets["upper body"]


def test_dataset_s_joints_are_shown_until_they_are_labels(labelling: Labelling) -> None:
    shown = labelling.shown(0, DRIVER)
    assert {s.origin for s in shown} == {"dataset"}
    count = labelling.accept(0, DRIVER)
    assert count == len(CABINPOSE.sets["upper body"])
    assert {s.origin for s in labelling.shown(0, DRIVER)} == {"label"}
    assert labelling.done(0, DRIVER)
    assert labelling.key_frames(DRIVER) == [0]


def test_placed_joint_lies_behind_the_measured_surface(workspace: Workspace, labelling: Labelling) -> None:
    """Where the truth was, the joint's own depth comes back from its distance to the surface."""
    assert workspace.dataset is not None
    frame = workspace.dataset.isel(frame=0).load()
    joint = CABINPOSE.sets["upper body"].index("chest")
    column = [str(n) for n in frame["joint"].values].index("chest")
    u, v = frame["joints_2d"].values[0, column].tolist()
    label = labelling.place(0, DRIVER, "chest", u, v)
    np.testing.assert_allclose(label.xyz, frame["joints_3d"].values[0, column], atol=0.002)
    moved = labelling.place(0, DRIVER, "chest", u + 6, v)
    height, width = frame["depth"].shape
    np.testing.assert_allclose(camera_of(frame, width, height).project(np.array(moved.xyz)), (u + 6, v), atol=1e-6)
    assert labelling.shown(0, DRIVER)[joint].origin == "label"


def test_joint_outside_the_image_is_told_so_and_has_no_depth(labelling: Labelling) -> None:
    """However it was seen before; back in the image it is visible."""
    label = labelling.place(0, DRIVER, "head", -40.0, 10.0)
    assert np.isnan(label.xyz).all()
    assert label.visibility == Visibility.OUTSIDE_IMAGE
    assert labelling.place(0, DRIVER, "head", 40.0, 10.0).visibility == Visibility.VISIBLE


def test_joint_without_a_place_in_the_image_is_not_seen_there(labelling: Labelling) -> None:
    labelling.mark(0, DRIVER, "head", Visibility.ABSENT)
    labelling.place(0, DRIVER, "neck", 10.0, -20.0)
    for joint in ("head", "neck"):
        with pytest.raises(DatasetError, match="no place in the image"):
            labelling.mark(0, DRIVER, joint, Visibility.OCCLUDED)
    labelling.mark(0, DRIVER, "head", Visibility.OUTSIDE_IMAGE)  # which is where no image shows it


def test_accepting_keeps_a_joint_behind_the_camera(workspace: Workspace) -> None:
    """Outside the image, with a place in space and none in the image: it was taken for absent."""
    assert workspace.dataset is not None
    behind = workspace.dataset.copy(deep=True)
    column = [str(n) for n in behind["joint"].values].index("hip")
    behind["joints_2d"].values[0, 0, column], behind["visibility"].values[0, 0, column] = np.nan, Visibility.OUTSIDE_IMAGE
    labelling = Labelling(behind, workspace.labels)
    labelling.accept(0, DRIVER)
    label = workspace.labels.get(0, DRIVER, "hip")
    assert label is not None
    assert label.visibility == Visibility.OUTSIDE_IMAGE
    np.testing.assert_array_equal(label.xyz, behind["joints_3d"].values[0, 0, column])


def test_mark_keeps_the_place_but_for_absent(labelling: Labelling) -> None:
    before = labelling.shown(0, DRIVER)[0].label
    assert before is not None
    labelling.mark(0, DRIVER, "head", Visibility.OCCLUDED)
    after = labelling.shown(0, DRIVER)[0].label
    assert after == JointLabel(before.uv, before.xyz, Visibility.OCCLUDED)
    labelling.mark(0, DRIVER, "head", Visibility.ABSENT)
    gone = labelling.shown(0, DRIVER)[0].label
    assert gone is not None
    assert np.isnan(gone.uv).all()


def test_undo_takes_back_one_change_at_a_time(labelling: Labelling) -> None:
    labelling.place(0, DRIVER, "head", 50.0, 60.0)
    labelling.accept(0, DRIVER)
    assert labelling.undo()
    assert [s.origin for s in labelling.shown(0, DRIVER)] == ["label", *["dataset"] * (len(CABINPOSE.sets["upper body"]) - 1)]
    assert labelling.undo()
    assert {s.origin for s in labelling.shown(0, DRIVER)} == {"dataset"}
    assert not labelling.undo()
    assert [c.how for c in labelling.labels.history[-15:]].count("undone") == len(CABINPOSE.sets["upper body"])


def test_undo_leaves_what_another_session_has_set_since(workspace: Workspace, labelling: Labelling) -> None:
    """Whoever undoes gets back what is theirs, and is told what stays; their own later steps are not another's."""
    other = Labelling(workspace.dataset, workspace.labels, "reviewer")
    labelling.place(0, DRIVER, "head", 40.0, 41.0)
    labelling.accept(0, DRIVER)
    accepted, theirs = labelling.labels.get(0, DRIVER, "neck"), other.place(0, DRIVER, "neck", 50.0, 51.0)
    count = len(CABINPOSE.sets["upper body"]) - 1
    assert labelling.undo() == (count - 1, 1)
    assert labelling.labels.get(0, DRIVER, "neck") == theirs
    assert labelling.undo() == (1, 0)
    assert list(labelling.labels.now) == [(0, DRIVER, "neck")]
    other.undo()
    assert labelling.labels.get(0, DRIVER, "neck") == accepted
    labelling.place(0, DRIVER, "neck", 60.0, 61.0)
    other.accept(0, DRIVER)
    other.place(0, DRIVER, "neck", 70.0, 71.0)
    lines = labelling.labels.path.read_text()
    assert labelling.undo() == (0, 1)
    assert labelling.labels.path.read_text() == lines


def test_undo_goes_on_after_a_reload_and_another_day(dataset_folder: Path, workspace: Workspace) -> None:
    """A window's changes are its own after a reload; once the studio was ended, whoever has the role takes back what it did."""
    window = Labelling(workspace.dataset, workspace.labels, session="a")
    window.place(0, DRIVER, "head", 40.0, 41.0)
    first = window.place(0, DRIVER, "head", 50.0, 51.0)
    window.place(0, DRIVER, "head", 60.0, 61.0)
    Labelling(workspace.dataset, workspace.labels, "reviewer", session="b").place(0, DRIVER, "neck", 1.0, 2.0)
    reloaded = Labelling(workspace.dataset, workspace.labels, session="a")
    assert reloaded.undo() == (1, 0)
    assert reloaded.labels.get(0, DRIVER, "head") == first
    assert Labelling(workspace.dataset, workspace.labels, session="c").undo() is None  # another window
    workspace.close()
    with closing(open_workspace(dataset_folder)) as next_day:
        again = Labelling(next_day.dataset, next_day.labels)
        assert again.undo() == (1, 0)
        held = again.labels.get(0, DRIVER, "head")
        assert held is not None
        assert held.uv == (40.0, 41.0)
        assert again.undo() == (1, 0)
        assert list(again.labels.now) == [(0, DRIVER, "neck")]
        assert again.undo() is None  # what is left is another role's


@pytest.mark.parametrize("what", ["deleted", "renamed", "replaced", "written to"])
def test_journal_that_is_another_one_takes_nothing(workspace: Workspace, labelling: Labelling, what: str) -> None:
    labelling.place(0, DRIVER, "head", 40.0, 41.0)
    path, aside = workspace.labels.path, workspace.labels.path.with_name("aside")
    if what == "deleted":
        path.unlink()
    elif what == "renamed":
        path.rename(aside)
    elif what == "replaced":
        path.rename(aside)
        path.write_text("mine\n")
    else:
        with path.open("a") as file:
            file.write("\n")
    before = {file.name: file.read_bytes() for file in path.parent.glob("*") if file.is_file()}
    for change in (lambda: labelling.place(0, DRIVER, "neck", 1.0, 1.0), lambda: labelling.accept(1, DRIVER), labelling.undo):
        with pytest.raises(DatasetError, match="was"):
            change()
    assert {file.name: file.read_bytes() for file in path.parent.glob("*") if file.is_file()} == before
    assert list(labelling.labels.now) == [(0, DRIVER, "head")]
    if what in ("renamed", "replaced"):
        aside.rename(path)
        assert labelling.undo() == (1, 0)  # it is back


@pytest.mark.parametrize("what", ["moved", "replaced"])
def test_dataset_that_is_another_one_takes_nothing(workspace: Workspace, dataset_folder: Path, what: str) -> None:
    assert workspace.dataset is not None
    labelling = Labelling(workspace.dataset, workspace.labels, "annotator", workspace.new_frames)
    labelling.place(0, DRIVER, "head", 40.0, 41.0)
    lines = workspace.labels.path.read_text()
    if what == "moved":
        dataset_folder.rename(dataset_folder.with_name("elsewhere"))
    else:
        settings = ["scene.cars=[suv]", "output.frames_per_part=2"]
        assert main(["synth", "--out", str(dataset_folder), "--frames", "2", "--seed", "4", "--overwrite", *settings]) == 0
    with pytest.raises(DatasetError, match="vanished" if what == "moved" else "another dataset now"):
        labelling.place(0, DRIVER, "neck", 1.0, 1.0)
    assert workspace.labels.path.read_text() == lines


def test_copy_takes_the_last_labelled_frame(labelling: Labelling) -> None:
    assert not labelling.copy(2, DRIVER)
    labelling.accept(1, DRIVER)
    labelling.place(1, DRIVER, "head", 44.0, 55.0)
    assert labelling.copy(3, DRIVER)
    label = labelling.shown(3, DRIVER)[0].label
    assert label is not None
    assert label.uv == (44.0, 55.0)


def as_one_motion(dataset: xr.Dataset) -> xr.Dataset:
    """Frames as those of a recording: one sequence, of the same people and one camera."""
    people = np.broadcast_to(dataset["subject"].values[0], dataset["subject"].shape)
    return dataset.assign_coords(
        sequence=("frame", np.zeros(6, int)), pov=("frame", ["driver"] * 6), subject=(dataset["subject"].dims, people)
    )


def test_interpolation_is_straight_in_space(workspace: Workspace, labelling: Labelling) -> None:
    labelling.dataset = as_one_motion(labelling.dataset)
    labelling.accept(0, DRIVER)
    labelling.accept(4, DRIVER)
    assert labelling.interpolate(2, DRIVER) == 3
    first, middle, last = (labelling.labels.get(int(labelling.numbers[row]), DRIVER, "neck") for row in (0, 2, 4))
    assert first is not None
    assert middle is not None
    assert last is not None
    np.testing.assert_allclose(middle.xyz, (np.array(first.xyz) + last.xyz) / 2, atol=1e-9)
    assert workspace.dataset is not None
    frame = workspace.dataset.isel(frame=2).load()
    height, width = frame["depth"].shape
    np.testing.assert_allclose(middle.uv, camera_of(frame, width, height).project(np.array(middle.xyz)), atol=1e-6)
    labelling.dataset = labelling.dataset.assign_coords(sequence=("frame", np.array([0, 0, 0, 0, 1, 1])))
    labelling._truth.cache_clear()
    labelling.undo()
    assert labelling.interpolate(2, DRIVER) == 0  # never from one sequence into another


def test_nothing_is_interpolated_between_scenes_of_their_own(labelling: Labelling) -> None:
    """Generated frames are all of sequence 0, of other people each."""
    labelling.accept(0, DRIVER)
    labelling.accept(4, DRIVER)
    assert labelling.interpolate(2, DRIVER) == 0


def test_what_has_a_place_in_one_frame_alone_is_not_seen_on_the_way(labelling: Labelling) -> None:
    labelling.dataset = as_one_motion(labelling.dataset)
    labelling.accept(0, DRIVER)
    labelling.accept(4, DRIVER)
    labelling.mark(0, DRIVER, "rwrist", Visibility.ABSENT)
    labelling.place(4, DRIVER, "lwrist", -200.0, 100.0)  # it leaves the image, and is in it until then
    assert labelling.interpolate(2, DRIVER) == 3
    assert [labelling.labels.get(row, DRIVER, "rwrist") for row in (2, 3)] == [None, None]
    for row in (1, 2, 3):
        label = labelling.labels.get(row, DRIVER, "lwrist")
        assert label is not None
        assert (label.visibility == Visibility.OUTSIDE_IMAGE) == (label.uv[0] < -0.5)


def test_proposals_come_before_the_dataset_and_after_labels(workspace: Workspace, labelling: Labelling) -> None:
    labelling.use(truth_as_predictions(workspace, shift=3.0))
    shown = labelling.shown(0, DRIVER)
    assert shown[0].origin == "proposal"
    labelling.place(0, DRIVER, "head", 50.0, 60.0)
    assert labelling.shown(0, DRIVER)[0].origin == "label"
    labelling.use(None)
    assert labelling.shown(0, DRIVER)[1].origin == "dataset"


def test_unsure_frames_come_first(workspace: Workspace, labelling: Labelling) -> None:
    predictions = truth_as_predictions(workspace)
    predictions.presence[3, 0][predictions.presence[3, 0] > 0] = 0.6
    predictions.presence[5] = 0.0  # nobody is found there
    labelling.use(predictions)
    assert labelling.unsure(range(6))[0] == 5
    assert labelling.unsure([0, 1, 3])[0] == 3


def test_proposals_of_a_model_that_was_changed_meanwhile_are_not_shown(workspace: Workspace, labelling: Labelling) -> None:
    """What a thread finds with the model of before is its own answer, and nothing is what a model finds that is gone."""
    before = truth_as_predictions(workspace, shift=3.0)

    class Slow(Predictions):
        def take(self, numbers: Any) -> Any:
            labelling.use(truth_as_predictions(workspace, shift=9.0))
            return super().take(numbers)

    labelling.use(Slow(**vars(before)))
    labelling.unsure([0])
    dataset = workspace.dataset
    assert dataset is not None
    proposal = labelling.proposals(0)[DRIVER]["head"]
    assert proposal.uv[0] - dataset["joints_2d"].sel(person=DRIVER, joint="head").values[0, 0] == pytest.approx(9.0, abs=1e-3)


def test_label_far_from_what_the_model_sees_is_suspicious(workspace: Workspace, labelling: Labelling) -> None:
    labelling.use(truth_as_predictions(workspace))
    labelling.accept(0, DRIVER)
    assert labelling.doubts(0, DRIVER) == {}
    head = labelling.shown(0, DRIVER)[0].label
    assert head is not None
    labelling.place(0, DRIVER, "head", head.uv[0] + 30, head.uv[1])
    assert "30 px from what the model sees" in labelling.doubts(0, DRIVER)["head"]


def test_bone_of_an_unusual_length_is_suspicious(labelling: Labelling) -> None:
    for row in range(4):
        labelling.accept(row, DRIVER)
    key = int(labelling.numbers[0]), DRIVER, "neck"
    neck = labelling.labels.get(*key)
    assert neck is not None
    moved = JointLabel(neck.uv, (neck.xyz[0] + 0.3, *neck.xyz[1:]), neck.visibility)
    labelling.labels.set([(key, moved)], role="annotator", how="placed")
    assert "usually" in labelling.doubts(0, DRIVER)["neck"]


def test_usual_lengths_follow_every_change(labelling: Labelling, workspace: Workspace) -> None:
    """After placing, undoing and another tab's labels, the doubts are those of somebody who has just opened the journal."""
    for row in range(5):
        labelling.accept(row, DRIVER)
        assert labelling.doubts(row, DRIVER) == Labelling(workspace.dataset, workspace.labels, workspace.role).doubts(row, DRIVER)
    labelling.place(0, DRIVER, "neck", 200.0, 20.0)
    doubts = labelling.doubts(0, DRIVER)
    assert "neck" in doubts
    assert doubts == Labelling(workspace.dataset, workspace.labels, workspace.role).doubts(0, DRIVER)
    labelling.undo()
    assert labelling.doubts(0, DRIVER) == {}
    Labelling(workspace.dataset, workspace.labels, workspace.role).mark(1, DRIVER, "neck", Visibility.ABSENT)
    Labelling(workspace.dataset, workspace.labels, workspace.role).place(0, DRIVER, "neck", 200.0, 20.0)
    assert labelling.doubts(0, DRIVER) == Labelling(workspace.dataset, workspace.labels, workspace.role).doubts(0, DRIVER)
    for row in (2, 3, 4):
        labelling.mark(row, DRIVER, "neck", Visibility.ABSENT)
    assert labelling.doubts(0, DRIVER) == {}  # no other frame tells how long it should be


def test_second_studio_on_the_same_labels_is_told(dataset_folder: Path, labelling: Labelling) -> None:
    other = open_workspace(dataset_folder)
    with pytest.raises(DatasetError, match="open in another studio"):
        Labelling(other.dataset, other.labels, other.role)


def test_labels_of_the_sample_lie_in_the_current_folder(dataset_folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """And not in the package, which may be read-only."""
    opened: list[Path | None] = []
    monkeypatch.setattr("cabinpose.app.studio.serve.serve", lambda workspace, **_: opened.append(workspace.labels_path))
    main(["studio", "sample"])
    main(["studio", str(dataset_folder)])
    assert opened == [Path("sample.labels.jsonl"), None]

"""COCO keypoints of an export, corrected in another tool: exactly what was changed there becomes labels."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import xarray as xr

from cabinpose.app.cli.selection import opened
from cabinpose.core.pose import Visibility
from cabinpose.store import open_dataset
from cabinpose.store.labels import JointLabel, Labels, read_labels
from cabinpose.store.schema import dataset_id, read_manifest

Run = Callable[..., Any]


@pytest.fixture
def exported(run: Run, dataset_folder: Path, tmp_path: Path) -> Path:
    """The annotations of an export."""
    assert run("export", "coco", dataset_folder, "--out", tmp_path / "coco").code == 0
    return tmp_path / "coco" / "annotations" / "person_keypoints.json"


def as_cvat(coco: dict[str, Any]) -> None:
    """What CVAT keeps: names of images in folders, new numbers, keypoints to 0.01 px; no slots, nothing of ours in `info`."""
    coco["info"], coco["licenses"] = {"contributor": "", "version": ""}, [{"id": 0, "name": "", "url": ""}]
    new = {image["id"]: i for i, image in enumerate(coco["images"], 1)}
    coco["images"] = [
        {"id": new[i["id"]], "file_name": f"default/{i['file_name']}", "width": i["width"], "height": i["height"]}
        for i in reversed(coco["images"])
    ]
    people = []
    for i, person in enumerate(reversed(coco["annotations"]), 1):
        kept = {name: person[name] for name in ("category_id", "bbox", "area", "iscrowd", "num_keypoints")}
        points = [round(x, 2) for x in person["keypoints"]]
        people.append({"id": i, "image_id": new[person["image_id"]], "keypoints": points, "segmentation": [], **kept})
    coco["annotations"] = people


def rewritten(path: Path, change: Callable[[dict[str, Any]], None], cvat: bool = False) -> dict[str, Any]:
    """Change a file, after another tool had it."""
    coco = json.loads(path.read_text())
    if cvat:
        as_cvat(coco)
    change(coco)
    path.write_text(json.dumps(coco))
    return coco


def person_in(coco: dict[str, Any], frame: int, position: int = 0) -> list[float]:
    """The keypoints of the person farthest to the left, or the next, in the image of a frame."""
    (image,) = (i["id"] for i in coco["images"] if int(Path(i["file_name"]).stem) == frame)
    people = sorted((a for a in coco["annotations"] if a["image_id"] == image), key=lambda a: a["bbox"][0])
    keypoints: list[float] = people[position]["keypoints"]
    return keypoints


def column(dataset: xr.Dataset, joint: str) -> int:
    return [str(name) for name in dataset["joint"].values].index(joint)


def person_at(dataset: xr.Dataset, frame: int, keypoints: list[float]) -> int:
    """The slot whose joints are nearest to the file's, told apart from the code under test by all visible joints."""
    points = np.array(keypoints).reshape(-1, 3)
    apart = np.linalg.norm(dataset["joints_2d"].values[frame] - points[:, :2], axis=-1)
    return int(np.nanargmin(np.nanmedian(np.where(points[:, 2] > 0, apart, np.nan), axis=1)))


def correct(run: Run, source: Path, folder: Path, *flags: str) -> Any:
    return run("import", "coco-labels", source, "--corrects", folder, "--out", labels_of(folder), *flags)


def labels_of(folder: Path) -> Path:
    return folder.with_name(folder.name + ".labels.jsonl")


@pytest.mark.parametrize("cvat", [False, True])
@pytest.mark.filterwarnings("ignore:All-NaN slice")
def test_exactly_what_was_changed_comes_back(run: Run, dataset_folder: Path, exported: Path, cvat: bool) -> None:
    """Two joints moved, of one the visibility changed, one taken away; unchanged joints give no line."""
    truth = open_dataset(dataset_folder)
    neck, chest, wrist, head = (column(truth, joint) for joint in ("neck", "chest", "lwrist", "head"))
    where: list[tuple[int, int, int]] = []

    def change(coco: dict[str, Any]) -> None:
        for frame, joint in ((1, neck), (4, chest), (2, wrist), (3, head)):
            points = person_in(coco, frame)
            where.append((frame, person_at(truth, frame, points), joint))
            if joint in (neck, chest):
                points[3 * joint] += 7.5
                points[3 * joint + 1] -= 4.25
            elif joint == wrist:
                points[3 * joint + 2] = 3 - points[3 * joint + 2]  # visible becomes occluded, and the reverse
            else:
                points[3 * joint : 3 * joint + 3] = [0, 0, 0]

    rewritten(exported, change, cvat)
    code, out, err = correct(run, exported, dataset_folder, "--role", "reviewer")
    assert (code, err) == (0, "")
    assert out == f"{labels_of(dataset_folder)}: 4 joints corrected in 4 frames\n"
    rows = [json.loads(line) for line in labels_of(dataset_folder).read_text().splitlines()[1:]]
    assert {(row["role"], row["how"]) for row in rows} == {("reviewer", "imported")}
    persons, joints = ([str(n) for n in truth[d].values] for d in ("person", "joint"))
    assert {(r["frame"], r["person"], r["joint"]) for r in rows} == {(f, persons[p], joints[j]) for f, p, j in where}

    now = opened(dataset_folder, labels_of(dataset_folder))  # as `evaluate --labels` has it
    for name in ("joints_2d", "joints_3d", "visibility"):
        differs = ~np.isclose(now[name].values, truth[name].values, equal_nan=True)
        differs = differs.any(axis=-1) if differs.ndim == 4 else differs
        expected = {"joints_2d": (0, 1, 3), "joints_3d": (0, 1, 3), "visibility": (2, 3)}[name]
        assert sorted(zip(*np.nonzero(differs), strict=True)) == sorted(where[i] for i in expected)
    for at in where[:2]:
        moved = now["joints_2d"].values[at] - truth["joints_2d"].values[at]
        np.testing.assert_allclose(moved, (7.5, -4.25), atol=0.011)
        assert now["visibility"].values[at] == truth["visibility"].values[at]
    flags = {int(Visibility.VISIBLE): int(Visibility.OCCLUDED)}
    assert now["visibility"].values[where[2]] == flags.get(int(truth["visibility"].values[where[2]]), int(Visibility.VISIBLE))

    again = correct(run, exported, dataset_folder)
    assert again.out == f"{labels_of(dataset_folder)}: 0 joints corrected in 0 frames\n"


def test_evaluate_sees_the_corrections(run: Run, dataset_folder: Path, exported: Path, tmp_path: Path) -> None:
    assert run("predict", dataset_folder, "--model", "in_car", "--out", tmp_path / "p.jsonl").code == 0

    def error(*flags: object) -> float:
        out = run("evaluate", dataset_folder, "--predictions", tmp_path / "p.jsonl", "--resamples", 0, "--json", *flags).out
        values = json.loads(out)["models"][0]["values"]
        wanted = {"metric": "mAD", "space": "2d", "joints": "All", "visibility": "any"}
        (found,) = (v["value"] for v in values if {name: v[name] for name in wanted} == wanted)
        return float(found)

    rewritten(exported, lambda coco: person_in(coco, 1).__setitem__(3, person_in(coco, 1)[3] + 60))
    assert correct(run, exported, dataset_folder).code == 0
    assert error("--labels", labels_of(dataset_folder)) > error() + 0.1


def test_labels_set_since_the_export_stay(run: Run, dataset_folder: Path, exported: Path) -> None:
    """Of an export without labels, what it holds of a joint that is labelled by now is no correction."""
    manifest = read_manifest(dataset_folder)
    labels = Labels(labels_of(dataset_folder), dataset_id(manifest), manifest.persons, manifest.joints)
    key, other = (1, "driver", "neck"), (2, "driver", "neck")
    label = JointLabel((50.0, 60.0), (0.1, 0.2, 0.8), Visibility.VISIBLE)
    labels.set([(key, label), (other, label)], role="annotator", how="placed")
    labels.close()

    def change(coco: dict[str, Any]) -> None:
        (driver,) = (a for a in coco["annotations"] if (a["image_id"], a["slot"]) == (2, "driver"))
        driver["keypoints"][3:6] = [33.0, 44.0, 2]

    rewritten(exported, change)
    code, out, err = correct(run, exported, dataset_folder)
    assert code == 0
    held = read_labels(labels_of(dataset_folder))[1]
    assert "1 joints corrected in 1 frames" in out
    assert "1 joints are as they were before a later label, which stays" in err
    assert held[key].uv == label.uv
    assert held[other].uv[0] == 33.0


def test_people_are_told_apart_by_where_they_are(run: Run, dataset_folder: Path, exported: Path) -> None:
    """In each frame somebody else is moved; without slots in the file, it is that person's joint that gets the label."""
    truth = open_dataset(dataset_folder)
    chest = column(truth, "chest")
    slots = {}
    for person in json.loads(exported.read_text())["annotations"]:
        if person["keypoints"][3 * chest + 2]:
            slots[person["image_id"]] = person["slot"], person["keypoints"]  # the last person of each image
    assert len(slots) == truth.sizes["frame"]
    assert len({slot for slot, _ in slots.values()}) > 2

    def change(coco: dict[str, Any]) -> None:
        for person in coco["annotations"]:
            for _, keypoints in slots.values():
                if np.allclose(person["keypoints"], keypoints, atol=0.006):
                    person["keypoints"][3 * chest] += 3

    rewritten(exported, change, cvat=True)
    assert correct(run, exported, dataset_folder).code == 0
    held = read_labels(labels_of(dataset_folder))[1]
    assert set(held) == {(frame, slot, "chest") for frame, (slot, _) in slots.items()}


def test_nobody_of_the_frame_is_left_out(run: Run, dataset_folder: Path, exported: Path) -> None:
    def change(coco: dict[str, Any]) -> None:
        coco["annotations"].append(coco["annotations"][0] | {"id": 99})

    rewritten(exported, change, cvat=True)
    code, out, err = correct(run, exported, dataset_folder)
    assert code == 0
    assert "0 joints corrected" in out
    assert "1 people are nobody of their frame and are left out; an attribute `slot` names the seat" in err
    rewritten(exported, lambda coco: coco["annotations"][-1].update(attributes={"slot": "rear_left"}))
    assert correct(run, exported, dataset_folder).code == 0
    assert {key[1] for key in read_labels(labels_of(dataset_folder))[1]} == {"rear_left"}


def elsewhere(coco: dict[str, Any]) -> None:
    for person in coco["annotations"]:
        person["keypoints"] = [x + (3 * (i % 3 < 2)) for i, x in enumerate(person["keypoints"])]


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (elsewhere, "not one keypoint of"),
        (lambda coco: coco["images"][2].update(file_name="a.png"), "the image 'a.png' is no frame of this dataset"),
        (lambda coco: coco["images"][2].update(file_name="00000077.png"), "'00000077.png' is no frame"),
        (lambda coco: coco["images"][2].update(width=640), "has 640x"),
        (lambda coco: coco.pop("categories"), "no category with keypoints"),
    ],
)
@pytest.mark.parametrize("before", ["", "{}\n"])
def test_foreign_file_leaves_nothing_behind(
    run: Run, dataset_folder: Path, exported: Path, change: Callable[[dict[str, Any]], None], message: str, before: str
) -> None:
    """Neither does a journal appear, nor does a file that is none change."""
    rewritten(exported, change)
    path = labels_of(dataset_folder)
    if before:
        path.write_text(before)
    code, out, err = correct(run, exported, dataset_folder)
    assert (code, out) == (2, "")
    assert (message if not before else "no labels of this version") in err
    assert "hint: " in err
    assert (path.read_text() if path.exists() else "") == before

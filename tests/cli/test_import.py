"""`cabinpose import`, and what the other commands make of datasets without images, intrinsics or extrinsics."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
from ticam_folder import ticam_folder

from cabinpose.app.view.sheet import caption
from cabinpose.store import open_dataset, read_manifest
from cabinpose.store.convert import export_dataset
from cabinpose.store.predictions import Predictions, write_predictions

Run = Callable[..., Any]


def coco_file(path: Path, keypoints: tuple[str, ...] = ("left_elbow", "right_elbow", "left_hip")) -> Path:
    """Three images with one person each; no pixels."""
    people = [
        {"id": i, "image_id": i, "category_id": 1, "keypoints": [30 + i, 40, 2, 60, 41, 2, 45, 80, 1], "subject": f"S{i}"}
        for i in (1, 2, 3)
    ]
    images = [{"id": i, "file_name": f"{i}.png", "width": 120, "height": 100} for i in (1, 2, 3)]
    category = {"id": 1, "name": "person", "keypoints": list(keypoints)}
    path.write_text(json.dumps({"images": images, "annotations": people, "categories": [category]}))
    return path


def itop_folder(folder: Path) -> Path:
    """Four frames of two people, without a segmentation."""
    folder.mkdir()
    world = np.zeros((4, 15, 3), np.float16)
    world[..., 0], world[..., 1], world[..., 2] = np.linspace(-0.4, 0.4, 15), np.linspace(0.6, -0.6, 15), 2
    ids = np.array([b"00_00000", b"00_00001", b"01_00000", b"01_00001"])
    with h5py.File(folder / "ITOP_side_train_depth_map.h5", "w") as file:
        file["id"], file["data"] = ids, np.full((4, 240, 320), 2, np.float16)
    with h5py.File(folder / "ITOP_side_train_labels.h5", "w") as file:
        file["id"], file["is_valid"], file["visible_joints"] = ids, [1, 1, 0, 1], np.ones((4, 15), np.int16)
        file["real_world_coordinates"] = world
    return folder


def test_help(run: Run) -> None:
    code, out, _ = run("import", "--help")
    assert code == 0
    assert "usage: cabinpose import" in out
    assert all(name in out for name in ("png-json", "coco", "itop", "ntu", "bvh"))
    assert "yolo" not in out
    code, out, _ = run("import", "itop", "--help")
    assert code == 0
    assert "usage: cabinpose import itop" in out
    assert all(flag in out for flag in ("--keep-invalid", "--intrinsics"))
    assert "--images" not in out


def test_import(run: Run, tmp_path: Path) -> None:
    out = tmp_path / "out"
    arguments = ("import", "itop", itop_folder(tmp_path / "itop"), "--out", out)
    code, text, err = run(*arguments, "--json")
    assert (code, err) == (0, "")
    assert json.loads(text) == {"out": str(out), "format": "itop", "frames": 3, "variables": ["depth", "itop_joints_3d"]}
    code, text, err = run(*arguments, "--keep-invalid", "--licence", "by agreement")
    assert (code, text) == (2, "")
    assert err.splitlines() == [
        f"error: {out} already holds a dataset",
        "hint: --overwrite replaces it, or give another folder with --out",
    ]
    code, text, err = run(*arguments, "--keep-invalid", "--licence", "by agreement", "--overwrite")
    assert (code, text) == (0, f"{out}: 4 frames of itop\n")
    manifest = read_manifest(out)
    assert manifest.licence == "by agreement"
    assert manifest.config.pop("content").startswith("sha256:")
    assert manifest.config == {"format": "itop", "source": "itop", "keep_invalid": True}


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (
            "fbx",
            "hint: known: adtfdat, azure-mkv, bvh, c3d, coco, coco-labels, depth-images, folder, itop, mvnx, ntu, png-json, ",
        ),
        ("bvh", "hint: --out FILE.mcap; datasets are made of png-json, coco, itop, ntu, ticam, depth-images, folder, recording"),
        ("coco --keep-invalid", "hint: --keep-invalid is of itop"),
        ("itop --images x", "hint: --images is of coco, ntu"),
        ("itop --intrinsics 0 1 2 3", "hint: give fx, fy, cx and cy"),
        ("ntu", "hint: give a file, or the folder that has them"),
        ("itop --every 2", "hint: --every is of ntu, ticam"),
        ("ticam --every 0", "hint: give --every a number above 0"),
        ("ticam --topic /depth", "hint: --topic is of rosbag2"),
    ],
)
def test_mistakes(run: Run, tmp_path: Path, words: str, message: str) -> None:
    (tmp_path / "source").mkdir()
    name, *flags = words.split()
    code, out, err = run("import", name, tmp_path / "source", "--out", tmp_path / "out", *flags)
    assert (code, out) == (2, "")
    assert message in err
    assert [p.name for p in tmp_path.iterdir()] == ["source"]


def test_joints_only(run: Run, tmp_path: Path) -> None:
    """A dataset without images: info and evaluate work, what needs depth says so."""
    data = tmp_path / "data"
    assert run("import", "coco", coco_file(tmp_path / "a.json"), "--out", data).code == 0
    code, out, _ = run("info", data, "--verify")
    assert code == 0
    assert "120x100, no depth" in out
    code, out, _ = run("info", data, "--json")
    assert json.loads(out)["valid_pixels"] is None
    code, _, err = run("view", data, "--out", tmp_path / "view")
    assert code == 2
    assert "error: the dataset has no depth to show" in err
    for name in ("coco", "itop", "ply"):
        code, _, err = run("export", name, data, "--out", tmp_path / "x")
        assert code == 2
        assert "which the dataset lacks" in err

    truth = open_dataset(data)
    joints = ("lelbow", "relbow", "lpelvis")
    uv = truth.joints_2d.sel(joint=list(joints)).values.astype(np.float32)
    uv[0, 0, 0] += (30, 40)  # 50 px off
    shape = uv.shape[:-1]
    write_predictions(
        tmp_path / "p.jsonl",
        Predictions(
            uv, np.full((*shape, 3), np.nan, np.float32), np.ones(shape, np.float32), np.ones(shape, np.float32),
            truth.frame.values, tuple(truth.person.values), joints, "made up",
        ),
    )  # fmt: skip
    code, out, err = run("evaluate", data, "--predictions", tmp_path / "p.jsonl", "--json", "--resamples", "0")
    assert (code, err) == (0, "")
    values = [v for v in json.loads(out)["models"][0]["values"] if v["metric"] == "PCK" and v["joints"] == "All"]
    found = {v["space"]: (v["value"], v["samples"]) for v in values if v["visibility"] == "any" and v["average"] == "pooled"}
    assert found["2d"] == (pytest.approx(100 * 8 / 9), 9)
    assert found.get("3d", (None, 0)) == (None, 0)  # nothing to measure: a COCO file knows no metres


def test_depth_without_segmentation_or_extrinsics(run: Run, tmp_path: Path) -> None:
    data = tmp_path / "data"
    assert run("import", "itop", itop_folder(tmp_path / "itop"), "--out", data).code == 0
    assert np.isnan(open_dataset(data).vehicle_from_camera.values).all()
    code, _, err = run("view", data, "--out", tmp_path / "view", "--frames", "1", "--rows", "1")
    assert code == 0
    assert err == ""
    import cv2

    sheet = cv2.imread(str(tmp_path / "view" / "contact_sheet.png"))
    right = sheet[100:-80, sheet.shape[1] * 3 // 5 :]  # the clouds: the wall as a line, so more than one colour of ground
    assert len(np.unique(right.reshape(-1, 3), axis=0)) > 10


def test_nothing_is_said_to_be_accepted_of_what_was_not_generated(run: Run, tmp_path: Path) -> None:
    data = tmp_path / "data"
    assert run("import", "itop", itop_folder(tmp_path / "itop"), "--out", data).code == 0
    code, out, _ = run("info", data)
    assert (code, "acceptance" in out, "proposed" in out) == (0, False, False)
    told = json.loads(run("info", data, "--json").out)
    assert (told["proposals"], told["acceptance"]) == (0, None)


def test_depth_without_intrinsics(run: Run, tmp_path: Path, dataset_folder: Path) -> None:
    exported = export_dataset(open_dataset(dataset_folder), "coco", tmp_path / "exported", images="depth16")
    file = exported / "annotations" / "person_keypoints.json"
    content = json.loads(file.read_text())
    for image in content["images"]:
        del image["camera_k"]
    file.write_text(json.dumps(content))
    assert run("import", "coco", exported, "--out", tmp_path / "data").code == 0
    for verb in (("view",), ("export", "ply")):
        code, _, err = run(*verb, tmp_path / "data", "--out", tmp_path / "out")
        assert code == 2
        assert "hint: import it again with --intrinsics" in err or "'labels', which the dataset lacks" in err
    flags = ("--intrinsics", "51.2", "51.2", "31.5", "23.5")
    assert run("import", "coco", exported, "--out", tmp_path / "data", "--overwrite", *flags).code == 0
    assert run("view", tmp_path / "data", "--out", tmp_path / "view", "--frames", "1", "--rows", "1").code == 0


def test_a_dataset_without_joints(run: Run, tmp_path: Path) -> None:
    """TICaM: masks and depth, nobody's joints."""
    data = tmp_path / "data"
    done = run("import", "ticam", ticam_folder(tmp_path / "ticam"), "--out", data, "--sequences", "p01", "--every", "2")
    assert (done.code, done.out) == (0, f"{data}: 2 frames of ticam\n"), done.err
    code, out, _ = run("info", data, "--verify")
    assert code == 0
    assert "driver 2, front_passenger 2" in out
    code, _, err = run("view", data, "--out", tmp_path / "view", "--frames", "1", "--rows", "1")
    assert (code, err) == (0, "")
    assert caption(open_dataset(data).isel(frame=0)).endswith("driver 3, looking left; front passenger 8, reading")
    done = run("predict", data, "--model", "in_car", "--out", tmp_path / "p.jsonl")
    assert done.code == 0, done.err


def test_segmentation_learns_from_ticam(run: Run, tmp_path: Path) -> None:
    pytest.importorskip("torch", reason="training needs the extra `train`")
    from cabinpose.core.errors import DatasetError
    from cabinpose.estimate.data import StoredFrames
    from cabinpose.estimate.training import TrainConfig, frame_spec

    root = ticam_folder(tmp_path / "ticam")
    assert run("import", "ticam", root, "--out", tmp_path / "data").code == 0
    dataset = open_dataset(tmp_path / "data")
    size = {"width": 32, "height": 32, "focal": 12.28, "levels": 2, "channels": 2, "slots": ("driver", "front_passenger")}

    def frames(**settings: Any) -> StoredFrames:
        return StoredFrames(dataset, frame_spec(TrainConfig(method="unet", settings=size | settings)))

    kept = frames(classes="person")[0].labels
    assert (kept[16:, 20:28] == 34).mean() > 0.9
    with pytest.raises(DatasetError, match="tell no parts of the body apart"):
        frames()
    slots = {"slots": size["slots"]}
    with pytest.raises(DatasetError, match="nobody whose joints are known"):
        StoredFrames(dataset, frame_spec(TrainConfig(method="compact", settings=slots)))


def test_training_takes_an_import(run: Run, tmp_path: Path) -> None:
    """ITOP's joints, split by subject, in the view of the detector for rooms."""
    pytest.importorskip("torch", reason="training needs the extra `train`")
    from cabinpose.app.training import stored_frames
    from cabinpose.app.training_split import training_split
    from cabinpose.estimate.data import FrameSpec
    from cabinpose.estimate.inputs import InputView

    data = tmp_path / "data"
    assert run("import", "itop", itop_folder(tmp_path / "itop"), "--out", data).code == 0
    f = 1 / 0.0035 / 2
    view = InputView(160, 120, f)
    spec = FrameSpec(view, ("standing",), "itop", ("head", "rhand"), amplitude=False)
    training, validation = stored_frames(training_split({"itop": open_dataset(data)}, None, "train", "validate"), spec)
    assert (len(training), len(validation)) == (2, 1)
    kept = training[0]
    assert (kept.depth == 20000).mean() > 0.9
    assert kept.present.tolist() == [True]
    # head: x = -0.4, y = -0.6 (down), z = 2
    np.testing.assert_allclose(kept.joints[0, 0], (79.5 - 0.2 * f, 59.5 - 0.3 * f, 2), atol=0.05)

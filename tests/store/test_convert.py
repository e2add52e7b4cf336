"""Exports, read back by the libraries of the formats: OpenCV, pycocotools, h5py, trimesh."""

from __future__ import annotations

import contextlib
import io
import json
from pathlib import Path
from types import ModuleType

import cv2
import h5py
import numpy as np
import pytest
import trimesh
import yaml
from hypothesis import given
from hypothesis.extra import numpy as hnp

from cabinpose.core.errors import ConfigError, DatasetError
from cabinpose.core.skeleton import CABINPOSE, ITOP, JOINTS
from cabinpose.store import open_dataset, points_m
from cabinpose.store.convert import FORMATS, export_dataset
from cabinpose.store.convert.coco import run_lengths
from cabinpose.store.convert.itop import segmentation_table


def test_png_json(spheres: ModuleType, dataset_folder: Path, tmp_path: Path) -> None:
    dataset = open_dataset(dataset_folder)
    seen: list[int] = []
    out = export_dataset(dataset, "png-json", tmp_path / "out", report=seen.append)
    assert seen == [1, 2, 3, 4, 5]
    colours = {row["id"]: row["rgb"] for row in spheres.LABELS}
    for i in range(5):
        want = spheres.frame(i, spheres.manifest())
        depth = cv2.imread(str(out / "depth_clean" / f"{i:08d}.png"), cv2.IMREAD_UNCHANGED)
        assert depth.dtype == np.uint16
        np.testing.assert_allclose(depth / 1000, want["depth_clean"], atol=0.00056)
        amplitude = cv2.imread(str(out / "amplitude" / f"{i:08d}.png"), cv2.IMREAD_UNCHANGED)
        np.testing.assert_array_equal(amplitude, want["amplitude"])
        bgr = cv2.imread(str(out / "labels" / f"{i:08d}.png"), cv2.IMREAD_COLOR).astype(int)
        code = bgr[..., 2] << 16 | bgr[..., 1] << 8 | bgr[..., 0]
        np.testing.assert_array_equal(code, np.vectorize(colours.__getitem__)(want["labels"]))
        record = json.loads((out / "pose" / f"{i:08d}.json").read_text())
        assert [p["subject"] for p in record["people"]] == [s for s in want["subject"] if s]
        elbow = record["people"][0]["joints"]["lelbow"]
        np.testing.assert_allclose(elbow["xyz_m"], want["joints_3d"][0, CABINPOSE.index["lelbow"]], atol=1e-5)
        np.testing.assert_allclose(elbow["uv_px"], want["joints_2d"][0, CABINPOSE.index["lelbow"]], atol=1e-3)
    noisy = cv2.imread(str(out / "depth" / "00000002.png"), cv2.IMREAD_UNCHANGED)
    np.testing.assert_array_equal(noisy == 0, np.isnan(dataset.depth[2].values))


@pytest.mark.filterwarnings("ignore:__array__ implementation:DeprecationWarning")  # pycocotools under numpy 2
def test_coco(spheres: ModuleType, dataset_folder: Path, tmp_path: Path) -> None:
    coco_api = pytest.importorskip("pycocotools.coco", reason="COCO's own reader is not installed (extra dev)")
    out = export_dataset(open_dataset(dataset_folder), "coco", tmp_path / "out")
    coco = coco_api.COCO(str(out / "annotations" / "person_keypoints.json"))
    assert coco.loadCats(1)[0]["keypoints"] == list(JOINTS)
    assert len(coco.loadCats(1)[0]["skeleton"]) == len(JOINTS) - 1
    assert coco.getImgIds() == [0, 1, 2, 3, 4]
    people = 0
    for i in range(5):
        want = spheres.frame(i, spheres.manifest())
        assert (out / "images" / coco.loadImgs(i)[0]["file_name"]).exists()
        for annotation in coco.loadAnns(coco.getAnnIds(imgIds=i)):
            people += 1
            person = spheres.PERSONS.index(annotation["slot"])
            mask = want["instance"] == person + 1
            np.testing.assert_array_equal(coco.annToMask(annotation).astype(bool), mask)
            assert annotation["area"] == mask.sum()
            x, y, w, h = annotation["bbox"]
            assert mask[y : y + h, x : x + w].sum() == mask.sum()
            assert mask[y].any()
            assert mask[:, x + w - 1].any()
            points = np.reshape(annotation["keypoints"], (-1, 3))
            flags = {0: 0, 1: 0, 2: 1, 3: 1, 4: 2}
            assert points[:, 2].tolist() == [flags[v] for v in want["visibility"][person].tolist()]
            assert annotation["num_keypoints"] == (points[:, 2] > 0).sum()
            assert (points[points[:, 2] == 0] == 0).all()
            labelled = points[:, 2] > 0
            np.testing.assert_allclose(points[labelled, :2], want["joints_2d"][person][labelled], atol=1e-3)
    assert people == sum(len(np.unique(spheres.frame(i, spheres.manifest())["instance"])) - 1 for i in range(5))


SPLITS = {"train": {"car": ("sedan", "van")}, "test": {"car": ("coupe",)}}


@pytest.mark.parametrize("kind", ["depth8", "amplitude8", "depth16"])
def test_coco_images_say_their_scale(spheres: ModuleType, dataset_folder: Path, tmp_path: Path, kind: str) -> None:
    """What the file says of the greys leads back to the variable, as far as the steps of the greys allow."""
    dataset = open_dataset(dataset_folder)
    out = export_dataset(dataset, "coco", tmp_path / "out", images=kind)
    said = json.loads((out / "annotations" / "person_keypoints.json").read_text())["info"]["images"]
    assert said["kind"] == kind
    for i in range(5):
        grey = cv2.imread(str(out / "images" / f"{i:08d}.png"), cv2.IMREAD_UNCHANGED)
        assert grey.dtype == (np.uint16 if kind == "depth16" else np.uint8)
        first, last = said["grey"]
        low, high = said["amplitude" if kind == "amplitude8" else "depth_m"]
        value = low + (grey.astype(float) - first) / (last - first) * (high - low)
        want = dataset["amplitude" if kind == "amplitude8" else "depth"][i].values.astype(float)
        valid = np.isfinite(want)
        if kind != "amplitude8":
            np.testing.assert_array_equal(grey == said["invalid"], ~valid)
        step = abs((high - low) / (last - first))
        np.testing.assert_allclose(value[valid], np.clip(want[valid], low, high), atol=0.51 * step + 1e-6)
        assert np.median(grey[valid]) > (900 if kind == "depth16" else 60)  # it does not open black


def test_depth8_of_what_is_far(tmp_path: Path) -> None:
    from cabinpose.store.convert.pictures import PICTURES

    grey = PICTURES["depth8"].pixels(np.array([[np.nan, 0.0, 2.0, 4.0, 6.5]], np.float32))
    assert grey.tolist() == [[0, 255, 128, 1, 1]]


def test_coco_of_splits(dataset_folder: Path, tmp_path: Path) -> None:
    """A file a split, as COCO 2017 has them; each names its own images alone."""
    dataset = open_dataset(dataset_folder)
    out = export_dataset(dataset, "coco", tmp_path / "out", splits=SPLITS)
    files = {str(p.relative_to(out)) for p in out.rglob("*") if p.is_file()}
    names = {"train": [0, 1, 3, 4], "test": [2]}
    images = {f"images/{split}/{i:08d}.png" for split, frames in names.items() for i in frames}
    assert files == images | {f"annotations/person_keypoints_{split}.json" for split in names}
    for split, frames in names.items():
        content = json.loads((out / "annotations" / f"person_keypoints_{split}.json").read_text())
        assert [image["id"] for image in content["images"]] == frames
        assert [image["file_name"] for image in content["images"]] == [f"{i:08d}.png" for i in frames]
        assert {a["image_id"] for a in content["annotations"]} <= set(frames)


@pytest.mark.filterwarnings("ignore:__array__ implementation:DeprecationWarning")  # pycocotools under numpy 2
def test_coco_is_evaluated_by_coco(dataset_folder: Path, tmp_path: Path) -> None:
    """Perfect predictions have an AP of 1 with the sigmas of the file; those of COCO's 17 keypoints do not fit 20 joints."""
    coco_api = pytest.importorskip("pycocotools.coco", reason="COCO's own reader is not installed (extra dev)")
    from pycocotools.cocoeval import COCOeval

    out = export_dataset(open_dataset(dataset_folder), "coco", tmp_path / "out")

    def average_precision(shift: float = 0.0, *, own: bool = True) -> float:
        with contextlib.redirect_stdout(io.StringIO()):  # it prints
            truth = coco_api.COCO(str(out / "annotations" / "person_keypoints.json"))
            people = [a for a in truth.anns.values() if a["num_keypoints"]]
            found = [
                {"image_id": a["image_id"], "category_id": 1, "score": 1.0, "keypoints": [x + shift for x in a["keypoints"]]}
                for a in people
            ]
            evaluation = COCOeval(truth, truth.loadRes(found), "keypoints")
            if own:
                evaluation.params.kpt_oks_sigmas = np.array(truth.loadCats(1)[0]["sigmas"])
            evaluation.evaluate()
            evaluation.accumulate()
            evaluation.summarize()
        return float(evaluation.stats[0])

    assert average_precision() == 1.0
    assert average_precision(3.0) < 0.9
    with pytest.raises(ValueError, match="broadcast"):
        average_precision(own=False)


def test_sigmas_are_those_of_coco_where_it_has_them(dataset_folder: Path, tmp_path: Path) -> None:
    cocoeval = pytest.importorskip("pycocotools.cocoeval", reason="COCO's own reader is not installed (extra dev)")
    out = export_dataset(open_dataset(dataset_folder), "coco", tmp_path / "out")
    category = json.loads((out / "annotations" / "person_keypoints.json").read_text())["categories"][0]
    ours = dict(zip(category["keypoints"], category["sigmas"], strict=True))
    names = [f"{side}_{joint}" for joint in ("shoulder", "elbow", "wrist", "hip", "knee", "ankle") for side in ("left", "right")]
    theirs = dict(zip(names, cocoeval.Params("keypoints").kpt_oks_sigmas[5:], strict=True))
    for joint, name in CABINPOSE.maps["coco"].items():
        assert ours[joint] == pytest.approx(theirs[name])


def test_yolo(spheres: ModuleType, dataset_folder: Path, tmp_path: Path) -> None:
    """Read by the rules of Ultralytics: labels beside images, 5 + 20 x 3 numbers a line, all of them shares of the image."""
    dataset = open_dataset(dataset_folder)
    splits = {"train": {"car": ("sedan",)}, "validate": {"car": ("coupe",)}, "test": {"car": ("van",)}}
    out = export_dataset(dataset, "yolo", tmp_path / "out", splits=splits, images="amplitude8")
    data = yaml.safe_load((out / "data.yaml").read_text())
    assert {key: data[key] for key in ("train", "val", "test", "names", "kpt_shape")} == {
        "train": "images/train", "val": "images/validate", "test": "images/test", "names": {0: "person"}, "kpt_shape": [20, 3],
    }  # fmt: skip
    assert data["kpt_names"] == {0: list(JOINTS)}
    flipped = [JOINTS[i] for i in data["flip_idx"]]
    assert [(a, b) for a, b in zip(JOINTS, flipped, strict=True) if a == b] == [(j, j) for j in ("head", "neck", "chest", "hip")]
    assert dict(zip(JOINTS, flipped, strict=True))["lelbow"] == "relbow"
    for key, frames in (("train", [0, 3]), ("val", [2]), ("test", [1, 4])):
        images = sorted((out / data[key]).glob("*.png"))
        assert [int(path.stem) for path in images] == frames
        for path, i in zip(images, frames, strict=True):
            assert cv2.imread(str(path), cv2.IMREAD_UNCHANGED).dtype == np.uint8
            text = Path(str(path).replace("/images/", "/labels/")).with_suffix(".txt").read_text()
            rows = np.array([line.split() for line in text.splitlines()], float)
            want = spheres.frame(i, spheres.manifest())
            people = [p for p in range(5) if (want["instance"] == p + 1).any()]
            assert rows.shape == (len(people), 5 + 20 * 3)
            assert (rows[:, 0] == 0).all()
            points = rows[:, 5:].reshape(-1, 20, 3)
            assert (rows[:, 1:5] >= 0).all()
            assert (points[..., :2] >= 0).all()
            assert (points[..., :2] <= 1).all()
            for row, joints, person in zip(rows, points, people, strict=True):
                v, u = np.nonzero(want["instance"] == person + 1)
                left, right, top, bottom = u.min() / 64, (u.max() + 1) / 64, v.min() / 48, (v.max() + 1) / 48
                box = ((left + right) / 2, (top + bottom) / 2, right - left, bottom - top)
                np.testing.assert_allclose(row[1:5], box, atol=1e-6)
                assert joints[:, 2].tolist() == [{0: 0, 1: 0, 2: 1, 3: 1, 4: 2}[s] for s in want["visibility"][person].tolist()]
                labelled = joints[:, 2] > 0
                pixels = joints[labelled, :2] * (64, 48) - 0.5
                np.testing.assert_allclose(pixels, want["joints_2d"][person][labelled], atol=1e-3)


def test_yolo_holds_people_out(dataset_folder: Path, tmp_path: Path) -> None:
    """Without splits: subjects by frame are {S01}, {S02 S03}, {S03 S04 S01}, {S04}, {S01 S02}, and S04 validates."""
    out = export_dataset(open_dataset(dataset_folder), "yolo", tmp_path / "out")
    shown = {split: sorted(int(p.stem) for p in (out / "images" / split).iterdir()) for split in ("train", "val")}
    assert shown == {"train": [0, 1, 4], "val": [3]}


@pytest.mark.parametrize(
    ("name", "options", "message"),
    [
        ("yolo", {"splits": SPLITS}, "yolo needs the splits train and val, not train, test"),
        ("yolo", {"images": "depth16"}, "there are no images of the kind depth16"),
        ("ply", {"images": "depth8"}, "ply has no option 'images'"),
        ("ply", {"splits": SPLITS}, "the format tells no splits apart"),
        ("coco", {"splits": {"../x": {"car": ("van",)}}}, "the split '../x' cannot name a folder"),
    ],
)
def test_what_a_format_does_not_have(dataset_folder: Path, tmp_path: Path, name: str, options: dict, message: str) -> None:
    with pytest.raises(ConfigError, match=message) as error:
        export_dataset(open_dataset(dataset_folder), name, tmp_path / "out", **options)
    assert error.value.hint
    assert list(tmp_path.iterdir()) == []


@given(hnp.arrays(bool, hnp.array_shapes(min_dims=2, max_dims=2, max_side=9)))
def test_run_lengths(mask: np.ndarray) -> None:
    lengths = run_lengths(mask)
    again = np.repeat(np.arange(len(lengths)) % 2 == 1, lengths).reshape(mask.shape, order="F")
    np.testing.assert_array_equal(again, mask)


def room(spheres: ModuleType, folder: Path, persons: int = 1) -> Path:
    """A dataset in ITOP's geometry: one person a frame."""
    manifest = spheres.manifest(
        frames=3,
        frames_per_part=3,
        width=320,
        height=240,
        persons=("a", "b")[:persons],
        variables=("depth", "labels", "instance"),
    )
    stored = {v.name for v in manifest.stored}
    with spheres.create_dataset(folder, manifest), spheres.PartWriter(folder, manifest.parts[0], manifest) as part:
        for i in range(3):
            part.append({k: v for k, v in spheres.frame(i, manifest).items() if k in stored})
    return folder


def test_itop(spheres: ModuleType, tmp_path: Path) -> None:
    dataset = open_dataset(room(spheres, tmp_path / "room"))
    out = export_dataset(dataset, "itop", tmp_path / "out")
    with h5py.File(out / "depth_map.h5") as depth, h5py.File(out / "labels.h5") as labels:
        layout = {name: (d.shape, d.dtype) for name, d in labels.items()}
        assert layout == {
            "id": ((3,), np.dtype("S8")),
            "is_valid": ((3,), np.uint8),
            "visible_joints": ((3, 15), np.int16),
            "image_coordinates": ((3, 15, 2), np.int16),
            "real_world_coordinates": ((3, 15, 3), np.float16),
            "segmentation": ((3, 240, 320), np.int8),
        }
        assert (depth["data"].shape, depth["data"].dtype) == ((3, 240, 320), np.float16)
        assert labels["id"][1] == depth["id"][1] == b"01_00001"
        np.testing.assert_allclose(depth["data"][2], np.nan_to_num(dataset.depth[2].values), rtol=1e-3)
        world = labels["real_world_coordinates"][...].astype(float)
        ours = dataset.joints_3d.values[:, 0]
        for ours_name, itop_name in (("rshoulder", "rshoulder"), ("lpelvis", "lhip"), ("rhand", "rhand"), ("lfoot", "lfoot")):
            got = world[:, ITOP.joints.index(itop_name)]
            np.testing.assert_allclose(got, ours[:, CABINPOSE.index[ours_name]] * (1, -1, 1), atol=2e-3)
        # the files' own consistency: pixels follow from metres with y up
        f, cx, cy = 0.8 * 320, 159.5, 119.5
        uv = np.stack((cx + f * world[..., 0] / world[..., 2], cy - f * world[..., 1] / world[..., 2]), -1)
        assert np.abs(labels["image_coordinates"][...] - uv).max() < 1.5
        segmentation = labels["segmentation"][1]
        frame = spheres.frame(1, spheres.manifest(width=320, height=240, persons=("a",)))
        np.testing.assert_array_equal(segmentation == ITOP.joints.index("head"), frame["labels"] == 29)
        np.testing.assert_array_equal(segmentation == ITOP.joints.index("torso"), frame["labels"] == 14)
        assert (segmentation[frame["instance"] == 0] == -1).all()
        assert labels["is_valid"][...].all()


def test_itop_numbers_people_alike_in_every_part(spheres: ModuleType, tmp_path: Path) -> None:
    dataset = open_dataset(room(spheres, tmp_path / "room"))
    out = export_dataset(dataset.isel(frame=[2]), "itop", tmp_path / "out")
    with h5py.File(out / "labels.h5") as labels:
        assert labels["id"][...].tolist() == [b"02_00000"]
    assert json.loads((out / "subjects.json").read_text()) == {"00": "S01", "01": "S02", "02": "S03"}
    names = np.array([[f"P{i:03d}"] for i in range(101)])
    crowd = dataset.isel(frame=[0] * 101).assign_coords(subject=(("frame", "person"), names)).drop_encoding()
    with h5py.File(export_dataset(crowd, "itop", tmp_path / "crowd") / "labels.h5") as labels:
        assert labels["id"][[0, 100]].tolist() == [b"00_00000", b"100_00100"]


def test_itop_takes_its_own_joints(spheres: ModuleType, tmp_path: Path) -> None:
    manifest = spheres.manifest(frames=1, persons=("a",), variables=("depth", "labels", "instance", "itop_joints_3d"))
    stored = {v.name for v in manifest.stored}
    joints = np.linspace((-0.2, -0.6, 2.0), (0.3, 0.9, 2.2), 15)[None]
    with spheres.create_dataset(tmp_path, manifest), spheres.PartWriter(tmp_path, manifest.parts[0], manifest) as part:
        frame = spheres.frame(0, manifest) | {"itop_joints_3d": joints}
        part.append({k: v for k, v in frame.items() if k in stored})
    out = export_dataset(open_dataset(tmp_path), "itop", tmp_path.parent / "itop-own")
    with h5py.File(out / "labels.h5") as labels:
        np.testing.assert_allclose(labels["real_world_coordinates"][0], joints[0] * (1, -1, 1), atol=2e-3)


def test_itop_layout_is_the_real_ones(real_data: object) -> None:
    """Axes of the published ground truth: y up, so heads above feet; a facing person's right shoulder at negative x."""
    joints = np.load(real_data("itop/itop_front_64.npz"))["joints_3d"]  # type: ignore[operator]
    names = {name: i for i, name in enumerate(ITOP.joints)}
    assert (joints[:, names["head"], 1] > joints[:, names["lfoot"], 1]).all()
    assert joints[:, names["rshoulder"], 0].mean() < joints[:, names["lshoulder"], 0].mean()


def test_itop_holds_one_person(spheres: ModuleType, tmp_path: Path) -> None:
    dataset = open_dataset(room(spheres, tmp_path / "room", persons=2))
    with pytest.raises(DatasetError, match="frame 1 shows 2 people") as error:
        export_dataset(dataset, "itop", tmp_path / "out")
    assert "coco" in str(error.value.hint)
    assert not (tmp_path / "out").exists()
    assert [p.name for p in tmp_path.iterdir()] == ["room"]


def test_every_body_part_has_an_itop_joint(spheres: ModuleType) -> None:
    """The table knows all parts of the package's own label table and no thing of the world."""
    from cabinpose.scene.labels import LABELS

    manifest = spheres.manifest(labels=[label._asdict() for label in LABELS])
    import xarray as xr

    from cabinpose.store.schema import label_attributes

    table = segmentation_table(xr.Dataset({"labels": ("x", [0], label_attributes(manifest))}))
    for label in LABELS:
        assert (table[label.id] >= 0) == (1 <= label.id <= 63), label.name
    by_name = {label.name: ITOP.joints[table[label.id]] for label in LABELS if table[label.id] >= 0}
    assert by_name["forearm_left"] == "lelbow"
    assert by_name["hip_center"] == "torso"
    assert by_name["hip_right"] == "rhip"


def test_ply(spheres: ModuleType, dataset_folder: Path, tmp_path: Path) -> None:
    dataset = open_dataset(dataset_folder)
    out = export_dataset(dataset, "ply", tmp_path / "out")
    for i in range(5):
        cloud = trimesh.load(out / f"{i:08d}.ply")
        depth = dataset.depth[i].values
        valid = np.isfinite(depth)
        np.testing.assert_allclose(cloud.vertices, points_m(dataset)[i].values[valid], atol=1e-6)
        labels = spheres.frame(i, spheres.manifest())["labels"][valid]
        np.testing.assert_array_equal(cloud.metadata["_ply_raw"]["vertex"]["data"]["label"].ravel(), labels)
        colours = np.asarray(cloud.colors)
        assert (colours[labels == 29][:, :3] == (0xAA, 0x55, 0xAA)).all()


def test_the_cloud_of_another_depth(dataset_folder: Path, tmp_path: Path) -> None:
    dataset = open_dataset(dataset_folder)
    styled = dataset.assign(depth_styled=dataset.depth.where(dataset.depth > dataset.depth.median(), np.nan) + np.float32(0.01))
    out = export_dataset(styled, "ply", tmp_path / "styled", depth="depth_styled")
    for i in range(5):
        wanted = styled.depth_styled[i].values
        heights = trimesh.load(out / f"{i:08d}.ply").vertices[:, 2]
        np.testing.assert_allclose(heights, wanted[np.isfinite(wanted)], atol=1e-6)  # row by row
        assert 0 < len(heights) < np.isfinite(dataset.depth[i].values).sum()
    with pytest.raises(DatasetError, match="depth_styled"):
        export_dataset(dataset, "ply", tmp_path / "none", depth="depth_styled")


@pytest.mark.parametrize("name", ["png-json", "coco", "yolo", "ply"])
def test_export_is_deterministic_and_overwrites_nothing(dataset_folder: Path, tmp_path: Path, name: str) -> None:
    dataset = open_dataset(dataset_folder)
    first = export_dataset(dataset, name, tmp_path / "a")
    with pytest.raises(DatasetError, match="exists and is not empty"):
        export_dataset(dataset, name, tmp_path / "a")
    before = {p.relative_to(first): p.read_bytes() for p in first.rglob("*") if p.is_file()}
    export_dataset(dataset, name, tmp_path / "a", overwrite=True)
    assert before == {p.relative_to(first): p.read_bytes() for p in first.rglob("*") if p.is_file()}
    with pytest.raises(DatasetError, match="never replaces"):
        export_dataset(dataset, name, dataset_folder, overwrite=True)
    assert open_dataset(dataset_folder).sizes["frame"] == 5


def test_itop_is_deterministic(spheres: ModuleType, tmp_path: Path) -> None:
    dataset = open_dataset(room(spheres, tmp_path / "room"))
    a, b = (export_dataset(dataset, "itop", tmp_path / name) for name in "ab")
    assert (a / "labels.h5").read_bytes() == (b / "labels.h5").read_bytes()
    assert (a / "depth_map.h5").read_bytes() == (b / "depth_map.h5").read_bytes()


def test_unknown_format(dataset_folder: Path, tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="unknown format 'pcd'") as error:
        export_dataset(open_dataset(dataset_folder), "pcd", tmp_path / "x")
    assert all(name in str(error.value.hint) for name in FORMATS.names())

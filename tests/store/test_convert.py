"""Exports, read back by the libraries of the formats: OpenCV, pycocotools, h5py, trimesh."""

from __future__ import annotations

import json
from pathlib import Path
from types import ModuleType

import cv2
import h5py
import numpy as np
import pytest
import trimesh
from hypothesis import given
from hypothesis.extra import numpy as hnp

from cabinpose.core.errors import ConfigError, DatasetError
from cabinpose.core.skeleton import INDEX, ITOP_JOINTS, JOINTS
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
        np.testing.assert_allclose(elbow["xyz_m"], want["joints_3d"][0, INDEX["lelbow"]], atol=1e-5)
        np.testing.assert_allclose(elbow["uv_px"], want["joints_2d"][0, INDEX["lelbow"]], atol=1e-3)
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
            got = world[:, ITOP_JOINTS.index(itop_name)]
            np.testing.assert_allclose(got, ours[:, INDEX[ours_name]] * (1, -1, 1), atol=2e-3)
        # the files' own consistency: pixels follow from metres with y up
        f, cx, cy = 0.8 * 320, 159.5, 119.5
        uv = np.stack((cx + f * world[..., 0] / world[..., 2], cy - f * world[..., 1] / world[..., 2]), -1)
        assert np.abs(labels["image_coordinates"][...] - uv).max() < 1.5
        segmentation = labels["segmentation"][1]
        frame = spheres.frame(1, spheres.manifest(width=320, height=240, persons=("a",)))
        np.testing.assert_array_equal(segmentation == ITOP_JOINTS.index("head"), frame["labels"] == 29)
        np.testing.assert_array_equal(segmentation == ITOP_JOINTS.index("torso"), frame["labels"] == 14)
        assert (segmentation[frame["instance"] == 0] == -1).all()
        assert labels["is_valid"][...].all()


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
    names = {name: i for i, name in enumerate(ITOP_JOINTS)}
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
    by_name = {label.name: ITOP_JOINTS[table[label.id]] for label in LABELS if table[label.id] >= 0}
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


@pytest.mark.parametrize("name", ["png-json", "coco", "ply"])
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
    assert all(name in str(error.value.hint) for name in FORMATS)

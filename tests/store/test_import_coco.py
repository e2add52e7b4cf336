"""COCO keypoints: what our export wrote, and files of others made by hand."""

from __future__ import annotations

import json
import struct
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import xarray as xr

from cabinpose.core.errors import DatasetError
from cabinpose.core.pose import Visibility
from cabinpose.core.skeleton import CABINPOSE
from cabinpose.store import open_dataset
from cabinpose.store.convert import export_dataset, open_source
from cabinpose.store.source import import_source

COCO_17 = [
    "nose", "left_eye", "right_eye", "left_ear", "right_ear", "left_shoulder", "right_shoulder", "left_elbow", "right_elbow",
    "left_wrist", "right_wrist", "left_hip", "right_hip", "left_knee", "right_knee", "left_ankle", "right_ankle",
]  # fmt: skip


def imported(path: Path, out: Path, **options: Any) -> xr.Dataset:
    return open_dataset(import_source(open_source(path, "coco", **options), out))


def person(number: int, image: int, shift: float = 0.0, **changes: Any) -> dict[str, Any]:
    """17 keypoints at (10 i + shift, 20 + i), the last of which is not labelled and the elbows of which are hidden."""
    points = [[10.0 * i + shift, 20.0 + i, 1 if "elbow" in name else 2] for i, name in enumerate(COCO_17)]
    points[-1] = [0, 0, 0]
    flat = [x for point in points for x in point]
    base = {"id": number, "image_id": image, "category_id": 1, "iscrowd": 0, "keypoints": flat, "num_keypoints": 16}
    return base | {"bbox": [0, 0, 170, 40], "segmentation": [[0, 0, 9, 0, 9, 9]]} | changes


def by_hand() -> dict[str, Any]:
    """Categories last, as COCO 2017 has them; two people, a crowd, a box, somebody without a labelled joint, an empty image."""
    return {
        "info": {"description": "by hand"},
        "licenses": [{"id": 1, "name": "CC-BY-4.0", "url": ""}],
        "annotations": [
            person(1, 30),
            person(2, 10),
            person(3, 30, 5.0),
            person(4, 10, iscrowd=1, segmentation={"size": [100, 200], "counts": [0, 20000]}),
            person(5, 20, keypoints=[1, 1, 0] * 17, num_keypoints=0),
            {"id": 6, "image_id": 20, "category_id": 1, "bbox": [0, 0, 5, 5]},
        ],
        "images": [
            {"id": 10, "file_name": "a.png", "width": 200, "height": 100},
            {"id": 30, "file_name": "c.png", "width": 150, "height": 120},
            {"id": 20, "file_name": "b.png", "width": 200, "height": 100},
            {"id": 40, "file_name": "d.png", "width": 200, "height": 100},
        ],
        "categories": [{"id": 1, "name": "person", "keypoints": COCO_17, "skeleton": []}],
    }


def written(folder: Path, data: dict[str, Any], kind: str = "") -> Path:
    (folder / "annotations").mkdir(parents=True)
    path = folder / "annotations" / "person_keypoints_val.json"
    path.write_text(json.dumps(data))
    if kind:
        (folder / "images").mkdir()
        for i, image in enumerate(data["images"]):
            shape = (image["height"], image["width"])
            pixels = np.full(shape, 1000 + i, np.uint16) if kind == "depth" else np.full((*shape, 3), (10, 20, 30 + i), np.uint8)
            if kind == "grey":
                pixels = np.full(shape, 90, np.uint8)
            assert cv2.imwrite(str(folder / "images" / image["file_name"]), pixels)
    return path


def test_keypoints_of_others(tmp_path: Path) -> None:
    ds = imported(written(tmp_path / "coco", by_hand()), tmp_path / "out")
    assert ds.person.values.tolist() == ["person_1", "person_2"]
    assert [v for v in ds.data_vars if "y" in ds[v].dims] == []
    assert (ds.attrs["width"], ds.attrs["height"], ds.attrs["licence"]) == (200, 120, "CC-BY-4.0")
    # the order of `images`: 10 has one person, 30 two, 20 and 40 none
    assert (ds.subject.values != "").tolist() == [[True, False], [True, True], [False, False], [False, False]]
    second = ds.isel(frame=1, person=1)
    states = dict(zip(ds.joint.values.tolist(), second.visibility.values.tolist(), strict=True))
    want = {"shoulder": 4, "elbow": Visibility.OCCLUDED, "wrist": 4, "pelvis": 4, "knee": 4}
    expected = {side + name: int(state) for side in "lr" for name, state in want.items()} | {"lankle": 4}
    assert {name: state for name, state in states.items() if state} == expected
    np.testing.assert_array_equal(second.joints_2d.sel(joint="lpelvis"), (10 * COCO_17.index("left_hip") + 5, 31))
    np.testing.assert_array_equal(second.joints_2d.sel(joint="rwrist"), (10 * COCO_17.index("right_wrist") + 5, 30))
    absent = second.visibility.values == 0
    assert np.isnan(second.joints_2d.values[absent]).all()
    assert np.isnan(ds.joints_3d.values).all()
    assert np.isnan(ds.camera_k.values).all()


def test_animals_are_no_people(tmp_path: Path) -> None:
    data = by_hand()
    data["categories"].append({"id": 18, "name": "dog", "keypoints": ["muzzle", "tail"]})
    data["annotations"].append({"id": 9, "image_id": 40, "category_id": 18, "keypoints": [5, 5, 2, 9, 9, 2]})
    ds = imported(written(tmp_path / "coco", data), tmp_path / "out")
    assert (ds.subject.values != "").sum(axis=1).tolist() == [1, 2, 0, 0]


def test_a_folder_is_as_good_as_its_file(tmp_path: Path) -> None:
    path = written(tmp_path / "coco", by_hand())
    a, b = imported(path, tmp_path / "a"), imported(tmp_path / "coco", tmp_path / "b")
    xr.testing.assert_equal(a, b)
    (path.parent / "person_keypoints_train.json").write_text("{}")
    with pytest.raises(DatasetError, match="2 files person_keypoints") as error:
        imported(tmp_path / "coco", tmp_path / "c")
    assert "give one file" in str(error.value.hint)


@pytest.mark.parametrize("kind", ["depth", "rgb", "grey"])
def test_images_of_different_sizes_are_filled_up(tmp_path: Path, kind: str) -> None:
    path = written(tmp_path / "coco", by_hand(), kind)
    ds = imported(path, tmp_path / "out", intrinsics=(100.0, 100.0, 99.5, 59.5))
    if kind == "depth":
        np.testing.assert_allclose(ds.depth[1, :120, :150], 1.001, atol=1e-6)
        assert np.isnan(ds.depth[1, :, 150:].values).all()
        assert np.isnan(ds.depth[0, 100:, :].values).all()
    else:
        assert ds.rgb[1, 119, 149].values.tolist() == ([31, 20, 10] if kind == "rgb" else [90] * 3)  # cv2 writes BGR
        assert (ds.rgb[1, :, 150:].values == 0).all()
    assert ds.camera_k[0, 0, 0].item() == 100


def test_images_from_elsewhere(tmp_path: Path) -> None:
    path = written(tmp_path / "coco", by_hand(), "depth")
    (tmp_path / "coco" / "images").rename(tmp_path / "val")
    assert "depth" not in imported(path, tmp_path / "a")
    assert "depth" in imported(path, tmp_path / "b", images=tmp_path / "val")


def test_round_trip_of_our_export(dataset_folder: Path, tmp_path: Path) -> None:
    before = open_dataset(dataset_folder)
    out = export_dataset(before, "coco", tmp_path / "exported", images="depth16")
    after = imported(out, tmp_path / "back")
    assert set(after.data_vars) >= {"depth", "instance"}
    np.testing.assert_allclose(after.depth.values, before.depth.values, atol=0.00051)
    shown = np.array([[(before.instance[i].values == p + 1).any() for p in range(5)] for i in range(5)])
    np.testing.assert_array_equal(after.instance.values, before.instance.values)
    table = np.array([0, 0, Visibility.OCCLUDED, Visibility.OCCLUDED, Visibility.VISIBLE])
    np.testing.assert_array_equal(after.visibility.values, table[before.visibility.values] * shown[..., None])
    known = after.visibility.values > 0
    np.testing.assert_allclose(after.joints_2d.values[known], before.joints_2d.values[known], atol=5.1e-4)
    assert np.isnan(after.joints_2d.values[~known]).all()
    for name in ("camera_k", "camera_dist", "vehicle_from_camera", "car", "pov", "person"):
        np.testing.assert_array_equal(after[name].values, before[name].values)
    for name in ("subject", "action"):
        np.testing.assert_array_equal(after[name].values, np.where(shown, before[name].values, ""))
    exported = export_dataset(after, "coco", tmp_path / "again", images="depth16")
    again = json.loads((exported / "annotations" / "person_keypoints.json").read_text())
    first = json.loads((out / "annotations" / "person_keypoints.json").read_text())
    assert again["annotations"] == first["annotations"]
    assert again["images"] == first["images"]


@pytest.mark.parametrize("kind", ["depth8", "amplitude8"])
def test_grey_images_of_our_export_are_not_taken_for_depth(dataset_folder: Path, tmp_path: Path, kind: str) -> None:
    """Joints and masks come back; the images do only where they are named, as the grey pictures that they are."""
    before = open_dataset(dataset_folder)
    out = export_dataset(before, "coco", tmp_path / "exported", images=kind)
    source = open_source(out, "coco")
    assert source.note.startswith(f"the images are {kind}, too coarse for a dataset")
    after = open_dataset(import_source(source, tmp_path / "back"))
    assert [name for name in after.data_vars if "y" in after[name].dims] == ["instance"]
    np.testing.assert_array_equal(after.instance.values, before.instance.values)
    known = after.visibility.values > 0
    assert known.sum() > 40
    np.testing.assert_allclose(after.joints_2d.values[known], before.joints_2d.values[known], atol=5.1e-4)
    named = open_source(out, "coco", images=out / "images")
    assert (named.note, named.manifest.variables) == ("", ("rgb", "instance"))
    assert open_source(export_dataset(before, "coco", tmp_path / "d", images="depth16"), "coco").note == ""


def test_a_split_of_our_export(dataset_folder: Path, tmp_path: Path) -> None:
    before = open_dataset(dataset_folder)
    splits = {"train": {"car": ("sedan", "van")}, "test": {"car": ("coupe",)}}
    out = export_dataset(before, "coco", tmp_path / "exported", images="depth16", splits=splits)
    with pytest.raises(DatasetError, match="has 2 files person_keypoints"):
        imported(out, tmp_path / "both")
    after = imported(out / "annotations" / "person_keypoints_train.json", tmp_path / "train")
    np.testing.assert_allclose(after.depth.values, before.depth.values[[0, 1, 3, 4]], atol=0.00051)


def change(**changes: Any) -> Callable[[dict[str, Any]], None]:
    return lambda data: data.update(changes)


def changed_person(**changes: Any) -> Callable[[dict[str, Any]], None]:
    return lambda data: data["annotations"][0].update(changes)


def without(key: str) -> Callable[[dict[str, Any]], None]:
    return lambda data: data["annotations"][0].pop(key)


RUN = {"size": [120, 150], "counts": [100, 17900]}


@pytest.mark.parametrize(
    ("damage", "message"),
    [
        (change(images=[]), "annotations are of the image 10"),
        (change(images=[], annotations=[]), "lists no image"),
        (change(categories=[{"id": 1, "name": "person"}]), "no category with keypoints"),
        (change(categories=[{"id": 1, "keypoints": ["nose", "tail"]}]), "none of the keypoints nose, tail"),
        (change(categories=[{"id": 1, "keypoints": COCO_17[:16]}]), "has 17 keypoints, the category 16"),
        (change(categories=[{"id": 2, "keypoints": COCO_17}]), "has 17 keypoints, the category 0"),
        (lambda data: data["images"].append(data["images"][0]), "images 10 is not COCO's"),
        (lambda data: data["images"][0].pop("width"), "images 10 is not COCO's"),
        (changed_person(keypoints=[1.0] * 50), "annotations 1 is not COCO's"),
        (changed_person(keypoints=[1, 1, 7] * 17), "annotations 1 is not COCO's"),
        (changed_person(keypoints=["a"] * 51), "annotations 1 is not COCO's"),
        (without("image_id"), "annotations 1 is not COCO's"),
        (changed_person(segmentation=RUN | {"counts": [5]}), "annotations 1 is not COCO's"),
        (changed_person(segmentation=RUN | {"counts": [100, 1 << 40]}), "annotations 1 is not COCO's"),
        (changed_person(image_id=77), "annotations are of the image 77"),
        (lambda data: data["images"][0].update(width=60_000, height=60_000), "has images of 60000x60000 pixels"),
    ],
)
def test_damaged_files(tmp_path: Path, damage: Callable[[dict[str, Any]], None], message: str) -> None:
    data = by_hand()
    damage(data)
    path = written(tmp_path / "coco", data)
    with pytest.raises(DatasetError, match=message) as error:
        imported(path, tmp_path / "out")
    assert error.value.hint
    assert [p.name for p in tmp_path.iterdir()] == ["coco"]


@pytest.mark.parametrize(
    "break_it",
    [
        lambda data: b"", lambda data: data[:1500], lambda data: data + b"2", lambda data: data.replace(b":", b"", 1),
        lambda data: data.replace(b'"info', b'"\xff', 1), lambda data: b"{1: 2}",
    ],
)  # fmt: skip
def test_what_is_no_whole_file(tmp_path: Path, break_it: Callable[[bytes], bytes]) -> None:
    path = written(tmp_path / "coco", by_hand() | {"info": {}})
    path.write_bytes(break_it(path.read_bytes()))
    with pytest.raises(DatasetError, match="no whole JSON object") as error:
        imported(path, tmp_path / "out")
    assert error.value.hint
    assert [p.name for p in tmp_path.iterdir()] == ["coco"]


def test_brackets_that_nest_deep_take_no_memory(tmp_path: Path) -> None:
    """ijson would take a gigabyte for 20 000 of them, 25 for 100 000."""
    path = written(tmp_path / "coco", by_hand())
    path.write_text('{"info": ' + "[" * 100_000)
    with pytest.raises(DatasetError, match="nested too deep"):
        open_source(path, "coco")


def test_a_list_is_no_coco_file(tmp_path: Path) -> None:
    path = written(tmp_path / "coco", by_hand())
    path.write_text("[1]")
    with pytest.raises(DatasetError, match="no category with keypoints"):
        imported(path, tmp_path / "out")


@pytest.mark.slow
def test_memory_follows_the_people_and_not_the_file(tmp_path: Path) -> None:
    """8 MB of annotations that are left out (boxes without keypoints) take next to none."""
    import tracemalloc

    data = by_hand()
    path = written(tmp_path / "coco", data)
    open_source(path, "coco")  # what is imported on the way is not the file's
    data["annotations"] += [{"id": 100 + i, "image_id": 10, "category_id": 1, "bbox": [1] * 120} for i in range(20_000)]
    path.write_text(json.dumps(data))
    size = path.stat().st_size
    del data
    tracemalloc.start()
    open_source(path, "coco")
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert size > 7e6
    assert peak < size / 20


@pytest.mark.parametrize(
    ("file", "pixels", "message"),
    [
        ("b.png", None, "cannot read the image"),
        ("b.png", np.zeros((100, 200, 3), np.uint8), "is no image of depth"),
        ("b.png", np.zeros((100, 199), np.uint16), "has 199x100 pixels, not 200x100"),
    ],
)
def test_images_that_do_not_fit(tmp_path: Path, file: str, pixels: np.ndarray | None, message: str) -> None:
    path = written(tmp_path / "coco", by_hand(), "depth")
    target = tmp_path / "coco" / "images" / file
    target.unlink()
    if pixels is not None:
        cv2.imwrite(str(target), pixels)
    with pytest.raises(DatasetError, match=message) as error:
        imported(path, tmp_path / "out")
    assert error.value.hint
    assert [p.name for p in tmp_path.iterdir()] == ["coco"]


def test_an_image_takes_no_memory_for_what_it_claims(tmp_path: Path) -> None:
    """7 000 x 8 000 pixels in 70 bytes, under right checksums."""
    path = written(tmp_path / "coco", by_hand(), "depth")
    chunks = {b"IHDR": struct.pack(">IIBBBBB", 7_000, 8_000, 16, 0, 0, 0, 0), b"IDAT": zlib.compress(bytes(9)), b"IEND": b""}
    data = b"".join(struct.pack(">I", len(c)) + k + c + struct.pack(">I", zlib.crc32(k + c)) for k, c in chunks.items())
    (tmp_path / "coco" / "images" / "b.png").write_bytes(b"\x89PNG\r\n\x1a\n" + data)
    with pytest.raises(DatasetError, match="it claims 56000000 pixels"):
        imported(path, tmp_path / "out")


def test_masks_of_run_lengths(tmp_path: Path) -> None:
    """Instances come where everybody has them; column by column, a run of zeros first."""
    data = by_hand()
    data["annotations"] = [
        person(1, 30, segmentation=RUN),
        person(2, 30, segmentation={"size": [120, 150], "counts": [0, 100, 17900]}),
    ]
    ds = imported(written(tmp_path / "coco", data), tmp_path / "out")
    flat = ds.instance[1, :120, :150].values.ravel(order="F")
    assert flat.tolist() == [2] * 100 + [1] * 17900
    data["annotations"].append(person(3, 30))
    assert "instance" not in imported(written(tmp_path / "polygons", data), tmp_path / "out2")
    data["annotations"] = [person(1, 10, segmentation=RUN)]
    with pytest.raises(DatasetError, match="a mask of image 10 has the size"):
        imported(written(tmp_path / "misfit", data), tmp_path / "out3")


@pytest.mark.parametrize("box", [[], [1, 2, 3], [1, 2, "3", 4], "all", None])
def test_a_box_that_is_none_is_left_out(tmp_path: Path, box: Any) -> None:
    content = by_hand()
    content["annotations"] = [person(n, 30, 5.0 * n, bbox=box) for n in range(8)]
    path = tmp_path / "coco.json"
    path.write_text(json.dumps(content))
    assert (imported(path, tmp_path / "out").subject.values != "").sum() == 8


def test_visible_joints_are_lifted_by_the_depth(tmp_path: Path) -> None:
    """The images are flat, 1.000 m and on: a joint lies on its pixel's ray, as far behind them as it lies below the skin."""
    path = written(tmp_path / "coco", by_hand(), "depth")
    made = imported(path, tmp_path / "out", lift=True, intrinsics=(100.0, 110.0, 90.0, 50.0))
    lifted = made.joints_3d[1, 0].values  # the second image, of 1.001 m
    u, v, skin = 60.0, 26.0, CABINPOSE.skin_m["rshoulder"]
    z = 1.001 + skin
    np.testing.assert_allclose(lifted[CABINPOSE.index["rshoulder"]], [(u - 90) / 100 * z, (v - 50) / 110 * z, z], atol=1e-4)
    seen = made.visibility[1, 0].values == Visibility.VISIBLE
    assert (np.isfinite(lifted).all(axis=-1) == seen).all()
    assert 0 < seen.sum() < (made.visibility[1, 0].values > Visibility.ABSENT).sum()  # elbows are labelled, and hidden


def test_lifting_needs_depth_and_a_camera(tmp_path: Path) -> None:
    path = written(tmp_path / "rgb", by_hand(), "rgb")
    with pytest.raises(DatasetError, match="no images of depth"):
        imported(path, tmp_path / "a", lift=True, fov_deg=90.0)
    path = written(tmp_path / "depth", by_hand(), "depth")
    with pytest.raises(DatasetError, match="camera is not known") as caught:
        imported(path, tmp_path / "b", lift=True)
    assert "--camera" in caught.value.hint

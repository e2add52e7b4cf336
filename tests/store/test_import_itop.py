"""ITOP's files: what our export wrote, and files made by hand with the traps of the published ones. h5py is the oracle."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from types import ModuleType
from typing import Any

import h5py
import numpy as np
import pytest
import xarray as xr

from cabinpose.core.errors import DatasetError
from cabinpose.core.pose import Visibility
from cabinpose.core.skeleton import CABINPOSE, ITOP
from cabinpose.store import PartWriter, create_dataset, open_dataset, points_m
from cabinpose.store.convert import export_dataset, open_source
from cabinpose.store.convert.itop import label_rows
from cabinpose.store.source import import_source

FRAMES = 20  # more than are read at a time
INVALID = (3, 17)
HEAD, RHAND, LHIP, LKNEE, LFOOT = (ITOP.joints.index(n) for n in ("head", "rhand", "lhip", "lknee", "lfoot"))


def imported(path: Path, out: Path, **options: Any) -> xr.Dataset:
    return open_dataset(import_source(open_source(path, "itop", **options), out))


def by_hand(folder: Path, stem: str = "ITOP_side_test_", *, segmented: bool = True) -> Path:
    """A set of 20 frames: a person 2 m from the camera, y up, head 0.6 m above the axis."""
    folder.mkdir(parents=True, exist_ok=True)
    i = np.arange(FRAMES)
    world = np.zeros((FRAMES, 15, 3), np.float16)
    world[..., 2] = 2
    world[..., 1] = np.linspace(0.6, -0.8, 15)
    world[..., 0] = 0.01 * i[:, None]
    world[:, LFOOT] = (0.0, -1.5, 2.0)  # v = 120 + 1.5 / (2 * 0.0035) = 334 px: below the image
    world[INVALID, :] = 0
    depth = np.full((FRAMES, 240, 320), 3.5, np.float16)
    depth[:, 100:140, 150:170] = 2
    depth[:, :, 0] = 0  # no answer
    depth[:, :, 1] = 7  # beyond what a dataset stores
    visible = np.ones((FRAMES, 15), np.int16)
    visible[:, RHAND] = 0
    segmentation = np.full((FRAMES, 240, 320), -1, np.int8)
    segmentation[:, 100:140, 150:170] = RHAND
    z = np.where(world[..., 2] > 0, world[..., 2], 1).astype(float)
    pixels = np.stack((160 + world[..., 0] / (z * 0.0035), 120 - world[..., 1] / (z * 0.0035)), -1).round().astype(np.int16)
    ids = np.array([f"{4 + (n > 9):02d}_{n:05d}" for n in i], "S8")
    with h5py.File(folder / f"{stem}depth_map.h5", "w") as file:
        file["id"], file["data"] = ids, depth
    with h5py.File(folder / f"{stem}labels.h5", "w") as file:
        file["id"], file["is_valid"], file["visible_joints"] = ids, ~np.isin(i, INVALID), visible
        file["image_coordinates"], file["real_world_coordinates"] = pixels, world
        if segmented:
            file["segmentation"] = segmentation
    return folder


def test_by_hand(tmp_path: Path) -> None:
    ds = imported(by_hand(tmp_path / "itop"), tmp_path / "out")
    valid = [n for n in range(FRAMES) if n not in INVALID]
    assert ds.sizes["frame"] == len(valid)
    assert ds.subject.values[:, 0].tolist() == [("04" if n < 10 else "05") for n in valid]
    assert set(ds.pov.values) == {"side"}
    # y up becomes y down; float16 of 0.6 is 0.60009766
    np.testing.assert_array_equal(ds.itop_joints_3d[5, 0, HEAD].values, np.float32([np.float16(0.06), -np.float16(0.6), 2]))
    assert ds.itop_joints_3d[0, 0, LFOOT, 1].item() == 1.5
    hip = ds.joints_3d.sel(joint="lpelvis")[5, 0].values
    np.testing.assert_array_equal(hip, ds.itop_joints_3d[5, 0, LHIP].values)
    np.testing.assert_allclose(ds.joints_2d.sel(joint="lpelvis")[5, 0], (160 + hip[0] / 0.007, 120 + hip[1] / 0.007), atol=1e-3)
    # joints of another meaning stay absent
    states = dict(zip(ds.joint.values.tolist(), ds.visibility[5, 0].values.tolist(), strict=True))
    kept = {n for n, state in states.items() if state}
    assert kept == {side + name for side in "lr" for name in ("shoulder", "elbow", "hand", "pelvis", "knee")}
    assert (states["rhand"], states["lhand"]) == (Visibility.SELF_OCCLUDED, Visibility.VISIBLE)
    assert np.isfinite(ds.joints_3d[5, 0].values).all(axis=1).tolist() == [s > 0 for s in states.values()]
    # depth: 0 is no answer, 7 m is beyond the range
    depth = ds.depth[0].values
    assert np.isnan(depth[:, :2]).all()
    assert np.isfinite(depth[:, 2:]).all()
    np.testing.assert_allclose(depth[120, 160], 2, atol=5e-5)
    np.testing.assert_allclose(depth[0, 5], 3.5, atol=5e-5)
    # x = (u - 160) z 0.0035, y down
    np.testing.assert_allclose(points_m(ds)[0, 10, 300].values, (140 * 3.5 * 0.0035, -110 * 3.5 * 0.0035, 3.5), atol=1e-3)
    names = dict(zip(ds.labels.attrs["flag_values"], ds.labels.attrs["flag_meanings"].split(), strict=True))
    assert names[ds.labels[0, 110, 160].item()] == "hand_right"
    assert names[ds.labels[0, 0, 160].item()] == "background"
    np.testing.assert_array_equal(ds.instance[0].values == 1, ds.labels[0].values > 0)
    assert np.isnan(ds.vehicle_from_camera.values).all()


def test_invalid_frames_on_request(tmp_path: Path) -> None:
    ds = imported(by_hand(tmp_path / "itop"), tmp_path / "out", keep_invalid=True)
    assert ds.sizes["frame"] == FRAMES
    absent = (ds.visibility.values == 0).all(axis=(1, 2))
    assert np.flatnonzero(absent).tolist() == list(INVALID)
    assert np.isnan(ds.itop_joints_3d.values[list(INVALID)]).all()
    assert np.isfinite(ds.depth[3, 120, 160].item())
    assert ds.subject[3, 0].item() == "04"


def test_joints_outside_the_image(tmp_path: Path) -> None:
    folder = by_hand(tmp_path / "itop")
    with h5py.File(folder / "ITOP_side_test_labels.h5", "a") as file:
        file["real_world_coordinates"][:, LKNEE] = (0, -1.5, 2)
    ds = imported(folder, tmp_path / "out")
    assert (ds.visibility.sel(joint="lknee").values == Visibility.OUTSIDE_IMAGE).all()
    np.testing.assert_allclose(ds.joints_2d.sel(joint="lknee")[0, 0], (160, 120 + 1.5 / 0.007), atol=1e-3)


@pytest.mark.parametrize("name", ["", "ITOP_side_test_depth_map.h5", "ITOP_side_test_labels.h5"])
def test_a_set_by_either_of_its_files(tmp_path: Path, name: str) -> None:
    folder = by_hand(tmp_path / "itop")
    if name:
        by_hand(folder, "ITOP_top_test_")
    ds = imported(folder / name, tmp_path / "out")
    assert ds.sizes["frame"] == FRAMES - len(INVALID)


def test_all_sets_of_a_folder(tmp_path: Path) -> None:
    folder = by_hand(by_hand(tmp_path / "itop"), "ITOP_top_train_", segmented=False)
    ds = imported(folder, tmp_path / "out")
    assert ds.sizes["frame"] == 2 * (FRAMES - len(INVALID))
    assert ds.pov.values[[0, -1]].tolist() == ["side", "top"]
    assert ds.sequence.values[[0, -1]].tolist() == [0, 1]
    assert "labels" not in ds  # not every set has a segmentation


def test_round_trip_of_our_export(spheres: ModuleType, tmp_path: Path) -> None:
    """A camera that is not ITOP's: the export says which it is."""
    variables = ("depth", "labels", "instance", "itop_joints_3d")
    manifest = spheres.manifest(frames=3, frames_per_part=3, persons=("standing",), variables=variables)
    stored = {v.name for v in manifest.stored}
    itop = np.linspace((-0.2, -0.6, 2.0), (0.3, 0.9, 2.2), 15)[None]
    with create_dataset(tmp_path / "a", manifest), PartWriter(tmp_path / "a", manifest.parts[0], manifest) as part:
        for i in range(3):
            frame = spheres.frame(i, manifest) | {"itop_joints_3d": itop, "camera_dist": np.array([0.01, 0, 0, 0, 0])}
            part.append({k: v for k, v in frame.items() if k in stored})
    before = open_dataset(tmp_path / "a")
    out = export_dataset(before, "itop", tmp_path / "exported")
    after = imported(out, tmp_path / "b")
    half = before.depth.values.astype(np.float16).astype(np.float64)
    np.testing.assert_allclose(after.depth.values, half, atol=5.1e-5)  # NaN where NaN
    np.testing.assert_array_equal(after.itop_joints_3d.values, itop[None].astype(np.float16).repeat(3, 0).astype(np.float32))
    np.testing.assert_array_equal(after.camera_k.values, before.camera_k.values)
    np.testing.assert_array_equal(after.camera_dist.values, before.camera_dist.values)
    again = export_dataset(after, "itop", tmp_path / "again")
    with h5py.File(out / "labels.h5") as a, h5py.File(again / "labels.h5") as b:
        for name in ("real_world_coordinates", "segmentation", "is_valid"):
            np.testing.assert_array_equal(a[name][...], b[name][...])


def test_classes_are_told_apart() -> None:
    rows = label_rows()
    assert [row.id for row in rows] == list(range(16))
    assert len({row.rgb for row in rows}) == len({row.name for row in rows}) == 16
    assert rows[1 + RHAND].name == "hand_right"


def drop(key: str) -> Callable[[h5py.File], None]:
    def change(file: h5py.File) -> None:
        del file[key]

    return change


def put(key: str, values: Callable[[np.ndarray], np.ndarray]) -> Callable[[h5py.File], None]:
    def change(file: h5py.File) -> None:
        changed = values(file[key][...])
        del file[key]
        file[key] = changed

    return change


@pytest.mark.parametrize(
    ("name", "change", "message"),
    [
        ("labels", drop("is_valid"), "labels.h5 lacks the dataset is_valid"),
        ("labels", drop("real_world_coordinates"), "lacks the dataset real_world_coordinates"),
        ("depth_map", drop("data"), "depth_map.h5 lacks the dataset data"),
        ("depth_map", put("data", lambda d: d[:-1]), r"depth of the shape \(19, 240, 320\), .* labels of 20 frames"),
        ("depth_map", put("data", lambda d: d[..., 0]), "depth of the shape"),
        ("depth_map", put("data", lambda d: d[:, ::2, ::2]), "segmentation has the shape"),
        ("depth_map", put("id", lambda i: i[::-1]), "different ids"),
        ("labels", put("visible_joints", lambda v: v[:, :14]), "visible_joints has the shape"),
        ("labels", put("real_world_coordinates", lambda w: w * np.float16([1, -1, 1])), "px from the projection"),
        ("labels", put("is_valid", np.zeros_like), "holds no frame to import"),
        ("labels", put("segmentation", lambda s: s + 20), "segments 19 to"),
    ],
)
def test_contradictions(tmp_path: Path, name: str, change: Callable[[h5py.File], None], message: str) -> None:
    folder = by_hand(tmp_path / "itop")
    with h5py.File(folder / f"ITOP_side_test_{name}.h5", "a") as file:
        change(file)
    with pytest.raises(DatasetError, match=message) as error:
        imported(folder, tmp_path / "out")
    assert error.value.hint
    assert [p.name for p in tmp_path.iterdir()] == ["itop"]


def test_ids_of_another_kind(tmp_path: Path) -> None:
    folder = by_hand(tmp_path / "itop")
    for name in ("labels", "depth_map"):
        with h5py.File(folder / f"ITOP_side_test_{name}.h5", "a") as file:
            put("id", lambda ids: np.array([b"frame" for _ in ids]))(file)
    with pytest.raises(DatasetError, match="is none of ITOP's"):
        imported(folder, tmp_path / "out")
    assert [p.name for p in tmp_path.iterdir()] == ["itop"]


def test_another_size_needs_intrinsics(tmp_path: Path) -> None:
    folder = by_hand(tmp_path / "itop", segmented=False)
    with h5py.File(folder / "ITOP_side_test_depth_map.h5", "a") as file:
        put("data", lambda d: d[:, ::2, ::2])(file)
    with h5py.File(folder / "ITOP_side_test_labels.h5", "a") as file:
        put("image_coordinates", lambda uv: uv // 2)(file)
    with pytest.raises(DatasetError, match="160x120 are not known") as error:
        imported(folder, tmp_path / "out")
    assert "--intrinsics" in str(error.value.hint)
    ds = imported(folder, tmp_path / "out", intrinsics=(1 / 0.007, 1 / 0.007, 80, 60))
    assert ds.camera_k[0, 0, 2].item() == 80


@pytest.mark.parametrize("share", [0.0, 0.5, 0.98])
@pytest.mark.parametrize("name", ["labels", "depth_map"])
def test_files_cut_short(tmp_path: Path, name: str, share: float) -> None:
    folder = by_hand(tmp_path / "itop")
    file = folder / f"ITOP_side_test_{name}.h5"
    data = file.read_bytes()
    file.write_bytes(data[: int(share * len(data))])
    with pytest.raises(DatasetError, match="is damaged") as error:
        imported(folder, tmp_path / "out")
    assert "copy or unpack it again" in str(error.value.hint)
    assert [p.name for p in tmp_path.iterdir()] == ["itop"]


def test_files_that_are_not_there(tmp_path: Path) -> None:
    folder = by_hand(tmp_path / "itop")
    (folder / "ITOP_side_test_depth_map.h5").unlink()
    with pytest.raises(DatasetError, match=r"depth_map\.h5 does not exist"):
        imported(folder, tmp_path / "out")
    (folder / "ITOP_side_test_labels.h5").rename(folder / "ITOP_side_test_point_cloud.h5")
    with pytest.raises(DatasetError, match="is no file of ITOP") as error:
        imported(folder / "ITOP_side_test_point_cloud.h5", tmp_path / "out")
    assert "not the point clouds" in str(error.value.hint)
    (folder / "ITOP_side_test_labels.h5.gz").write_bytes(b"")
    with pytest.raises(DatasetError, match=r"unpack its \.h5\.gz first"):
        imported(folder, tmp_path / "out")


def test_axes_are_those_of_the_published_labels(real_data: Any, tmp_path: Path) -> None:
    """Real ground truth in a file of ITOP's layout: heads above feet, a facing person's right shoulder to the left."""
    with np.load(real_data("itop/itop_front_64.npz")) as arrays:
        world, number = arrays["joints_3d"], arrays["frame"]
    count = len(world)
    ids = np.array([f"00_{n:05d}" for n in number], "S8")
    with h5py.File(tmp_path / "a_depth_map.h5", "w") as file:
        file["id"], file["data"] = ids, np.zeros((count, 240, 320), np.float16)
    with h5py.File(tmp_path / "a_labels.h5", "w") as file:
        file["id"], file["is_valid"], file["visible_joints"] = ids, np.ones(count), np.ones((count, 15))
        file["real_world_coordinates"] = world
    ds = imported(tmp_path / "a_labels.h5", tmp_path / "out")
    joints = ds.itop_joints_3d.values[:, 0]
    assert (joints[:, HEAD, 1] < joints[:, LFOOT, 1]).all()
    right, left = (ds.joints_3d.values[:, 0, CABINPOSE.index[name]] for name in ("rshoulder", "lshoulder"))
    assert right[:, 0].mean() < left[:, 0].mean()

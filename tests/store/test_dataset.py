"""The dataset folder: what is written is what is read, by this package, by zarr and by xarray alone."""

from __future__ import annotations

import json
import pickle
import tracemalloc
import warnings
from pathlib import Path
from types import ModuleType, SimpleNamespace

import numpy as np
import pytest
import xarray as xr
import zarr
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from zarr.codecs import BloscCodec, Crc32cCodec
from zarr.errors import ZarrUserWarning
from zarr.storage import MemoryStore

from cabinpose.core.errors import DatasetError
from cabinpose.store import Manifest, PartWriter, create_dataset, open_dataset, points_m, read_manifest
from cabinpose.store.schema import PartPlan, PartPlans, manifest_yaml, with_checksum_line
from cabinpose.store.shard import FRAMES_PER_SHARD, LEVEL, depth_ticks
from cabinpose.store.variables import DEPTH_SCALE_M, VARIABLE
from cabinpose.store.zarr_metadata import zarr_arrays


def test_frames_come_back(spheres: ModuleType, dataset_folder: Path) -> None:
    dataset = open_dataset(dataset_folder)
    manifest = spheres.manifest()
    assert dataset.sizes["frame"] == 5
    for index in range(5):
        want = spheres.frame(index, manifest)
        for name, value in want.items():
            got = dataset[name][index].values
            if name.startswith("depth"):
                np.testing.assert_allclose(got, value, atol=DEPTH_SCALE_M / 2 + 1e-6)
                assert got.dtype == np.float32
            else:
                np.testing.assert_array_equal(got, np.asarray(value, dtype=got.dtype), err_msg=name)


def test_attributes_sum_over_parts(dataset_folder: Path) -> None:
    attrs = open_dataset(dataset_folder).attrs
    assert attrs["proposals"] == 5 + 3 * 3
    assert attrs["rejections"] == {"car": 6, "self": 3}


def test_opening_reads_no_image(dataset_folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*_: object) -> None:
        raise AssertionError("an image was read")

    monkeypatch.setattr("cabinpose.store.lazy.read_frames", refuse)
    dataset = open_dataset(dataset_folder)
    assert dataset.isel(frame=[0, 3]).depth.shape == (2, 48, 64)
    assert dataset.car.values.tolist() == ["sedan", "van", "coupe", "sedan", "van"]
    with pytest.raises(AssertionError, match="image was read"):
        dataset.depth[0].load()


def test_frames_come_in_the_order_asked(dataset_folder: Path) -> None:
    whole, order = open_dataset(dataset_folder), [3, 0, 4, 0, 2]  # of all parts, there and back
    for name in ("depth", "joints_3d", "subject"):
        np.testing.assert_array_equal(open_dataset(dataset_folder)[name][order].values, whole[name].values[order])


def test_xarray_alone_reads_a_part(dataset_folder: Path) -> None:
    """A part needs no code of ours: coordinates, units, metres and NaN come from its own metadata, without a warning."""
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        part = xr.open_zarr(dataset_folder / "part-00001.zarr", chunks=None)
    ours = open_dataset(dataset_folder).isel(frame=slice(2, 4))
    np.testing.assert_allclose(part.depth.values, ours.depth.values, rtol=1e-6)
    assert np.isnan(ours.depth.values).any()
    assert part.depth.attrs["units"] == "m"
    own = {"frame", "person", "joint", "sync_ns", "sequence", "seed", "subject", "action", "car", "pov"}
    assert own | {"occupancy", "sex", "belt", "seat_track"} <= set(part.coords) <= set(ours.coords)
    for name in set(part.variables) - {"depth", "depth_clean"}:
        assert part[name].dims == ours[name].dims
        np.testing.assert_array_equal(part[name].values, ours[name].values.astype(part[name].dtype))


def test_zarr_validates_what_we_write(dataset_folder: Path) -> None:
    """Stored numbers, through zarr's own sharding, checksum and blosc code."""
    raw = zarr.open_group(dataset_folder / "part-00000.zarr", mode="r")
    assert raw["depth"].dtype == np.uint16
    assert raw["depth"].shards == (FRAMES_PER_SHARD, 48, 64)
    assert raw["depth"].chunks == (1, 48, 64)
    clean = np.asarray(raw["depth_clean"])
    assert clean.max() == 25000
    assert raw["labels"].attrs["flag_meanings"] == "background torso_left head_left wall"


def test_indexing_is_numpys(dataset_folder: Path) -> None:
    dataset = open_dataset(dataset_folder)
    whole = dataset.amplitude.values
    rng = np.random.default_rng(5)
    for _ in range(30):
        keys = []
        for size in whole.shape:
            kind = rng.integers(3)
            a, b = sorted(rng.integers(0, size + 1, 2))
            keys.append([slice(a, b), int(rng.integers(size)), rng.integers(0, size, 3)][kind])
        want = whole
        for axis in (2, 1, 0):
            want = want[(*[slice(None)] * axis, keys[axis])]
        np.testing.assert_array_equal(dataset.amplitude[tuple(keys)].values, want)
    np.testing.assert_array_equal(dataset.amplitude[::-2].values, whole[::-2])


def test_boolean_selection_and_dask_and_pickle(dataset_folder: Path) -> None:
    dataset = open_dataset(dataset_folder)
    vans = dataset.sel(frame=dataset.car.values == "van")
    assert vans.frame.values.tolist() == [1, 4]
    again = pickle.loads(pickle.dumps(vans))
    np.testing.assert_array_equal(again.labels.values, dataset.labels.values[[1, 4]])
    chunked = dataset.chunk({"frame": 2})
    assert float(chunked.amplitude.mean().compute()) == pytest.approx(dataset.amplitude.values.mean())


def test_points_agree_with_the_closed_form(spheres: ModuleType, dataset_folder: Path) -> None:
    dataset = open_dataset(dataset_folder)
    points = points_m(dataset, "depth_clean")
    assert points.dims == ("frame", "y", "x", "xyz")
    cloud = points[2].values
    k = spheres.camera_k(64, 48)
    depth = dataset.depth_clean[2].values
    v, u = np.mgrid[:48, :64]
    want = np.stack(((u - k[0, 2]) * depth / k[0, 0], (v - k[1, 2]) * depth / k[1, 1], depth), -1)
    np.testing.assert_allclose(cloud, want, atol=1e-6)
    np.testing.assert_array_equal(points_m(dataset.isel(frame=2), "depth_clean").values, cloud)
    np.testing.assert_array_equal(points.isel(frame=[2], x=3).values[0], cloud[:, 3])
    with pytest.raises(DatasetError, match="no variable 'depth_of_field'"):
        points_m(dataset, "depth_of_field")


@given(hnp.arrays(np.float32, (3, 4), elements=st.floats(-1, 9, width=32) | st.just(float("nan")) | st.just(float("inf"))))
def test_depth_ticks(depth: np.ndarray) -> None:
    ticks = depth_ticks(depth)
    valid = np.isfinite(depth) & (depth >= 0.6e-4) & (depth <= 6.5535)
    np.testing.assert_allclose(ticks[valid] * DEPTH_SCALE_M, depth[valid], atol=0.5001e-4 + 1e-6)
    assert (ticks[~(depth > 0.4e-4) | ~(depth < 6.5536)] == 0).all()


@pytest.mark.slow
@settings(max_examples=15, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow])
@given(data=st.data())
def test_any_values_survive(data: st.DataObject, spheres: ModuleType, tmp_path_factory: pytest.TempPathFactory) -> None:
    """Round trip of arbitrary images, poses and names through a part."""
    manifest = spheres.manifest(
        frames=2, width=5, height=3, persons=("a", "b"), variables=("depth", "labels", "rgb", "itop_joints_3d")
    )
    frames = []
    for _ in range(2):
        frame = {}
        for variable in manifest.stored:
            shape = manifest.frame_shape(variable)
            if variable.dtype == "str":
                names = st.text(st.characters(exclude_categories=["Cs"]), max_size=8)
                frame[variable.name] = (
                    data.draw(names) if not shape else data.draw(hnp.arrays(object, shape, elements=names)).tolist()
                )
            else:
                frame[variable.name] = data.draw(hnp.arrays(variable.dtype, shape))
        frame["camera_k"], frame["camera_dist"] = spheres.camera_k(5, 3), np.zeros(5)  # any others are no camera's
        frames.append(frame)
    folder = tmp_path_factory.mktemp("any")
    with create_dataset(folder, manifest), PartWriter(folder, manifest.parts[0], manifest) as part:
        for frame in frames:
            part.append(frame)
    raw = zarr.open_group(folder / "part-00000.zarr", mode="r")
    dataset = open_dataset(folder)
    for variable in manifest.stored:
        want = np.stack([np.asarray(f[variable.name], dtype=object if variable.dtype == "str" else None) for f in frames])
        np.testing.assert_array_equal(np.asarray(raw[variable.name]).astype(want.dtype), want)
        if variable.scale is None:
            np.testing.assert_array_equal(dataset[variable.name].values, want)


def test_same_frames_same_bytes(spheres: ModuleType, dataset_folder: Path, tmp_path: Path) -> None:
    again = spheres.write(tmp_path / "again", spheres.manifest())
    names = sorted(p.relative_to(dataset_folder) for p in dataset_folder.rglob("*") if p.is_file())
    assert names == sorted(p.relative_to(again) for p in again.rglob("*") if p.is_file())
    for name in names:
        assert (dataset_folder / name).read_bytes() == (again / name).read_bytes(), name


def test_metadata_is_the_librarys_own(spheres: ModuleType, tmp_path: Path) -> None:
    """Every zarr.json, byte by byte as the Zarr library writes it, and its consolidated copies."""
    manifest = spheres.manifest(frames=2, variables=("depth", "labels", "rgb", "itop_joints_3d"), width=5, height=4)
    store = MemoryStore()
    group = zarr.create_group(store, zarr_format=3)
    for array in zarr_arrays(manifest, frames=2):
        item = 1 if array.dtype == "str" else np.dtype(array.dtype).itemsize
        group.create_array(
            array.name,
            shape=array.shape,
            dtype=str if array.dtype == "str" else array.dtype,
            chunks=(1, *array.shape[1:]) if array.is_image else array.shape,
            shards=(FRAMES_PER_SHARD, *array.shape[1:]) if array.is_image else None,
            compressors=[BloscCodec(cname="lz4", clevel=LEVEL, shuffle="bitshuffle", typesize=item), Crc32cCodec()],
            fill_value={"U": "", "f": np.nan}.get(np.dtype(array.dtype).kind, 0),
            dimension_names=array.dims,
            attributes=dict(array.attrs),
        )
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ZarrUserWarning)
        zarr.consolidate_metadata(store)
    with create_dataset(tmp_path, manifest), PartWriter(tmp_path, manifest.parts[0], manifest) as part:
        for index in range(2):
            frame = spheres.frame(index, manifest)
            frame |= {"rgb": np.zeros((4, 5, 3), np.uint8), "itop_joints_3d": np.zeros((5, 15, 3), np.float32)}
            part.append({variable.name: frame[variable.name] for variable in manifest.stored if variable.name in frame})
    folder = tmp_path / "part-00000.zarr"
    theirs = {name: buffer.to_bytes() for name, buffer in store._store_dict.items()}
    root = json.loads(theirs.pop("zarr.json"))
    assert sorted(theirs) == sorted(path.relative_to(folder).as_posix() for path in folder.glob("*/zarr.json"))
    for name, text in theirs.items():
        assert (folder / name).read_bytes() == text, name
    ours = json.loads((folder / "zarr.json").read_text())
    assert json.dumps(ours | {"attributes": {}}) == json.dumps(root)


def test_frames_span_shards(spheres: ModuleType, tmp_path: Path) -> None:
    manifest = spheres.manifest(frames=FRAMES_PER_SHARD + 3, frames_per_part=FRAMES_PER_SHARD + 3, width=4, height=3)
    dataset = open_dataset(spheres.write(tmp_path, manifest))
    raw = zarr.open_array(tmp_path / "part-00000.zarr" / "amplitude", mode="r")
    np.testing.assert_array_equal(dataset.amplitude.values, np.asarray(raw))
    np.testing.assert_array_equal(
        dataset.amplitude[FRAMES_PER_SHARD + 1].values, spheres.frame(FRAMES_PER_SHARD + 1, manifest)["amplitude"]
    )


def test_manifest_round_trip(spheres: ModuleType, dataset_folder: Path) -> None:
    manifest = read_manifest(dataset_folder)
    assert manifest.model_dump() == Manifest(**spheres.manifest().model_dump(by_alias=True)).model_dump()
    assert manifest.config["small"] == 1e-5
    assert with_checksum_line(manifest_yaml(manifest)) == (dataset_folder / "dataset.yaml").read_text()


def test_frame_is_checked(spheres: ModuleType, tmp_path: Path) -> None:
    manifest = spheres.manifest()
    good = spheres.frame(0, manifest)
    create_dataset(tmp_path, manifest).close()
    cases = [
        ({k: v for k, v in good.items() if k != "labels"}, "missing variables .'labels'"),
        (good | {"depht": 1}, "unknown variables .'depht'"),
        (good | {"labels": good["labels"][:-1]}, "labels has shape"),
        (good | {"labels": good["labels"].astype(np.int64)}, "labels is int64"),
        (good | {"joints_3d": np.zeros((5, 20, 3), np.int64)}, "joints_3d is int64"),
        (good | {"subject": ["a"]}, "subject has shape"),
        (good | {"car": 3}, "car is text"),
    ]
    for frame, message in cases:
        with pytest.raises(DatasetError, match=message), PartWriter(tmp_path, manifest.parts[0], manifest) as part:
            part.append(frame)
    with pytest.raises(DatasetError, match="needs 2 frames, got 1"), PartWriter(tmp_path, manifest.parts[0], manifest) as part:
        part.append(good)
    with PartWriter(tmp_path, manifest.parts[0], manifest) as part:
        part.append(good)
        part.append(good)
        with pytest.raises(DatasetError, match="not more"):
            part.append(good)
    assert sorted(p.name for p in tmp_path.iterdir()) == ["dataset.yaml", "part-00000.zarr"]


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"variables": ("depth", "deep")}, "unknown variables: deep"),
        ({"persons": ("a", "a")}, "persons names one entry twice"),
        ({"frames": 0}, "greater than or equal to 1"),
        ({"labels": [{"id": 1, "name": "a", "rgb": 1}, {"id": 1, "name": "b", "rgb": 2}]}, "two labels share one id"),
    ],
)
def test_manifest_is_checked(spheres: ModuleType, change: dict[str, object], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        spheres.manifest(**change)


def test_every_variable_says_what_it_is() -> None:
    for variable in VARIABLE.values():
        assert variable.meaning
        assert variable.dims[0] == "frame"
        assert (variable.scale is not None) == variable.name.startswith("depth")


def test_skipped_frames_leave_gaps_in_the_index(spheres: ModuleType, tmp_path: Path) -> None:
    manifest = spheres.manifest()
    with create_dataset(tmp_path / "gaps", manifest) as writer:
        for plan in writer.missing():
            with PartWriter(writer.folder, plan, manifest) as part:
                for index in range(plan.first, plan.first + plan.frames):
                    if index in (1, 3):
                        part.skip()
                    else:
                        part.append(spheres.frame(index, manifest))
    dataset = open_dataset(tmp_path / "gaps")
    assert dataset.frame.values.tolist() == [0, 2, 4]
    assert dataset.attrs["skipped_frames"] == 2
    for place, index in enumerate((0, 2, 4)):
        want = spheres.frame(index, manifest)
        np.testing.assert_array_equal(dataset.labels[place].values, want["labels"])
        np.testing.assert_array_equal(dataset.sel(frame=index).joints_2d.values, np.float32(want["joints_2d"]))


def skip(folder: Path, manifest: Manifest, count: int) -> None:
    """Skips `count` frames of the first part."""
    with PartWriter(folder, manifest.parts[0], manifest) as part:
        for _ in range(count):
            part.skip()


def test_a_part_of_skipped_frames_alone_is_refused(spheres: ModuleType, tmp_path: Path) -> None:
    manifest = spheres.manifest()
    with create_dataset(tmp_path / "none", manifest) as writer:
        with pytest.raises(DatasetError, match="every frame"):
            skip(writer.folder, manifest, manifest.parts[0].frames)
        with pytest.raises(DatasetError, match="not more"):
            skip(writer.folder, manifest, manifest.parts[0].frames + 1)
    assert not list((tmp_path / "none").glob("*part*"))


@given(frames=st.integers(1, 60), size=st.integers(1, 7), data=st.data())
def test_plans_of_parts_are_a_list_without_some(frames: int, size: int, data: st.DataObject) -> None:
    listed = [PartPlan(n, first, min(size, frames - first)) for n, first in enumerate(range(0, frames, size))]
    gone = sorted(data.draw(st.sets(st.sampled_from(range(len(listed))))))
    want = [plan for plan in listed if plan.index not in gone]
    plans = PartPlans(frames, size).without(gone)
    assert (list(plans), len(plans), plans.frames) == (want, len(want), sum(plan.frames for plan in want))
    assert [plans[n] for n in range(-len(want), 0)] == want
    assert plans[1:3] == want[1:3]
    with pytest.raises(IndexError):
        plans[len(want)]


def test_a_billion_frames_are_planned_in_little_memory(
    spheres: ModuleType, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Where the disk has room; what is there already is left out, and the file is read again."""
    monkeypatch.setattr("cabinpose.store.dataset.shutil.disk_usage", lambda _: SimpleNamespace(free=10**18))
    manifest = spheres.manifest().model_copy(update={"frames": 10**9, "frames_per_part": 100})
    (tmp_path / "part-00000.zarr").mkdir()
    (tmp_path / "part-9999998.zarr").mkdir()
    tracemalloc.start()
    with create_dataset(tmp_path / "new", manifest) as writer:
        assert (len(writer.missing()), writer.missing().frames) == (10**7, 10**9)
        assert writer.missing()[-1] == PartPlan(9_999_999, 999_999_900, 100)
        assert read_manifest(tmp_path / "new").parts.frames == 10**9
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 5e6
    assert [plan.index for plan in manifest.parts_in(tmp_path)] == [0, 9_999_998]
    (tmp_path / "part-10000000.zarr").mkdir()  # beyond the last
    (tmp_path / "part-000001.zarr").mkdir()  # no name of a part
    assert len(manifest.parts_in(tmp_path)) == 2


def test_a_disk_that_is_too_small_is_told_before_anything_is_planned(spheres: ModuleType, tmp_path: Path) -> None:
    manifest = spheres.manifest().model_copy(update={"frames": 10**15, "frames_per_part": 100})
    with pytest.raises(DatasetError, match=r"1000000000000000 frames need about [\d,.]+ GB \(and take 115,740,741 days") as error:
        create_dataset(tmp_path / "new", manifest)
    assert "fewer frames" in (error.value.hint or "")
    assert not (tmp_path / "new").exists()

"""Imports in general, and of our own exports: what is written is what was exported; a failure leaves nothing behind."""

from __future__ import annotations

import errno
import json
from collections.abc import Callable
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any

import numpy as np
import pytest
import xarray as xr

from cabinpose.core.errors import ConfigError, DatasetError
from cabinpose.store import dataset_skeleton, open_dataset, read_manifest
from cabinpose.store.convert import FORMATS, DatasetFormat, ImportOptions, export_dataset, open_source
from cabinpose.store.source import Source, import_source


def imported(path: Path, name: str, out: Path, **options: Any) -> xr.Dataset:
    return open_dataset(import_source(open_source(path, name, **options), out))


@pytest.fixture(scope="session")
def png_json(dataset_folder: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return export_dataset(open_dataset(dataset_folder), "png-json", tmp_path_factory.mktemp("png") / "out")


def copy_of(folder: Path, to: Path) -> Path:
    import shutil

    return Path(shutil.copytree(folder, to))


def test_png_json_round_trip(dataset_folder: Path, png_json: Path, tmp_path: Path) -> None:
    before, after = open_dataset(dataset_folder), imported(png_json, "png-json", tmp_path / "out")
    assert set(after.variables) == set(before.variables) - {"confidence"}
    for name in ("depth", "depth_clean"):
        want = before[name].values
        np.testing.assert_array_equal(np.isnan(after[name].values), np.isnan(want))
        np.testing.assert_allclose(after[name].values, want, atol=0.00051)  # half a millimetre
    for name in ("amplitude", "labels", "instance", "visibility", "camera_k", "camera_dist", "vehicle_from_camera", "frame"):
        np.testing.assert_array_equal(after[name].values, before[name].values)
    for name in ("subject", "action", "car", "pov", "sequence", "sync_ns", "seed", "person", "joint"):
        assert after[name].values.tolist() == before[name].values.tolist()
    np.testing.assert_allclose(after.joints_3d.values, before.joints_3d.values, atol=5.1e-6)
    np.testing.assert_allclose(after.joints_2d.values, before.joints_2d.values, atol=5.2e-4)
    assert after.labels.attrs == before.labels.attrs
    manifest = read_manifest(tmp_path / "out")
    assert (manifest.generator, manifest.licence, manifest.config["exported_from"]) == (
        "import png-json",
        "CC0-1.0",
        "spheres 1.0",
    )
    again = export_dataset(after, "png-json", tmp_path / "again")
    for file in [*png_json.rglob("*.png"), *png_json.rglob("pose/*.json"), png_json / "labels.json"]:
        assert (again / file.relative_to(png_json)).read_bytes() == file.read_bytes()


def test_who_has_no_joints_and_whose_joints_they_are_stay(spheres: ModuleType, tmp_path: Path) -> None:
    manifest = spheres.manifest(frames=1, joint_definition="anatomy", variables=())
    stored = {variable.name for variable in manifest.stored}
    frame = {name: value for name, value in spheres.frame(0, manifest).items() if name in stored}
    frame["visibility"], frame["subject"], frame["action"] = frame["visibility"] * 0, ["S02", *[""] * 4], ["sleep", *[""] * 4]
    frame["joints_3d"], frame["joints_2d"] = (np.full_like(frame[name], np.nan) for name in ("joints_3d", "joints_2d"))
    before = open_dataset(import_source(Source(tmp_path / "none", manifest, lambda: iter([frame])), tmp_path / "before"))
    after = imported(export_dataset(before, "png-json", tmp_path / "out"), "png-json", tmp_path / "after")
    assert after.attrs["joint_definition"] == "anatomy"
    assert (after.subject.values[0, 0], after.action.values[0, 0]) == ("S02", "sleep")
    theirs = before.assign_attrs(generator="import itop", joint_definition="")
    back = imported(export_dataset(theirs, "png-json", tmp_path / "theirs"), "png-json", tmp_path / "back")
    assert dataset_skeleton(back).definition == dataset_skeleton(theirs).definition


def test_an_import_is_deterministic(png_json: Path, tmp_path: Path) -> None:
    for name in "ab":
        imported(png_json, "png-json", tmp_path / name)
    files = {p.relative_to(tmp_path / "a"): p.read_bytes() for p in (tmp_path / "a").rglob("*") if p.is_file()}
    assert files == {p.relative_to(tmp_path / "b"): p.read_bytes() for p in (tmp_path / "b").rglob("*") if p.is_file()}


def test_the_users_intrinsics_and_licence(png_json: Path, tmp_path: Path) -> None:
    after = imported(png_json, "png-json", tmp_path / "out", intrinsics=(50.0, 51.0, 31.5, 23.5), licence="CC-BY-4.0")
    assert after.camera_k[3].values.tolist() == [[50, 0, 31.5], [0, 51, 23.5], [0, 0, 1]]
    assert after.attrs["licence"] == "CC-BY-4.0"
    for wrong in ((0.0, 1.0, 0.0, 0.0), (1.0, 1.0, float("nan"), 0.0)):
        with pytest.raises(ConfigError, match="no intrinsics"):
            ImportOptions(intrinsics=wrong)


def remove(path: Path) -> None:
    path.unlink()


def cut(path: Path) -> None:
    path.write_bytes(path.read_bytes()[:-40])


def recoloured(path: Path) -> None:
    rows = json.loads(path.read_text())
    rows[1]["rgb"] = "#123456"
    path.write_text(json.dumps(rows))


def doubled(path: Path) -> None:
    rows = json.loads(path.read_text())
    rows[1]["rgb"] = rows[2]["rgb"]
    path.write_text(json.dumps(rows))


def no_people(path: Path) -> None:
    record = json.loads(path.read_text())
    del record["people"]
    path.write_text(json.dumps(record))


def stranger(path: Path) -> None:
    record = json.loads(path.read_text())
    record["people"][0]["slot"] = "roof"
    path.write_text(json.dumps(record))


def amplitude_for_labels(path: Path) -> None:
    path.write_bytes((path.parents[1] / "amplitude" / path.name).read_bytes())


@pytest.mark.parametrize(
    ("file", "damage", "message"),
    [
        ("dataset.json", remove, "lacks dataset.json"),
        ("dataset.json", cut, "cannot read"),
        ("labels.json", cut, "cannot read"),
        ("labels.json", recoloured, "labels.json has no class of colour #00faaa"),
        ("labels.json", doubled, "two classes share a colour"),
        ("depth/00000003.png", remove, "cannot read the image"),
        ("depth/00000003.png", cut, "depth/00000003.png is"),
        ("labels/00000003.png", amplitude_for_labels, "has no colours"),
        ("instance/00000003.png", amplitude_for_labels, "instance is uint8"),
        ("pose/00000004.json", cut, "cannot read"),
        ("pose/00000004.json", no_people, "00000004.json is no pose of this export"),
        ("pose/00000004.json", stranger, "00000004.json is no pose of this export"),
    ],
)
def test_a_damaged_export_leaves_nothing_behind(
    png_json: Path, tmp_path: Path, file: str, damage: Callable[[Path], None], message: str
) -> None:
    source = copy_of(png_json, tmp_path / "source")
    damage(source / file)
    with pytest.raises(DatasetError, match=message) as error:
        imported(source, "png-json", tmp_path / "out")
    assert error.value.hint
    assert [p.name for p in tmp_path.iterdir()] == ["source"]


def test_what_is_there_is_kept(dataset_folder: Path, png_json: Path, tmp_path: Path) -> None:
    out = copy_of(dataset_folder, tmp_path / "out")
    source = open_source(png_json, "png-json")
    with pytest.raises(DatasetError, match="already holds a dataset") as error:
        import_source(source, out)
    assert "--overwrite" in str(error.value.hint)
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "thesis.tex").write_text("x")
    for overwrite in (False, True):
        with pytest.raises(DatasetError, match="exists and is no dataset"):
            import_source(source, tmp_path / "mine", overwrite=overwrite)
    broken = copy_of(png_json, tmp_path / "broken")
    remove(broken / "depth" / "00000004.png")
    with pytest.raises(DatasetError, match="cannot read the image"):
        import_source(open_source(broken, "png-json"), out, overwrite=True)
    assert open_dataset(out).attrs["generator"] == "spheres"
    import_source(source, out, overwrite=True)
    assert open_dataset(out).attrs["generator"] == "import png-json"
    (out / "mine.labels.jsonl").write_text("x")
    with pytest.raises(DatasetError, match=r"holds mine\.labels\.jsonl, which is no part of the dataset"):
        import_source(source, out, overwrite=True)
    inside = copy_of(png_json, out / "source")
    with pytest.raises(DatasetError, match="holds the source"):
        import_source(open_source(inside, "png-json"), out, overwrite=True)
    assert sorted(p.name for p in tmp_path.iterdir()) == ["broken", "mine", "out"]


def test_unknown_sources(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="the format 'ply' reads no datasets") as error:
        open_source(tmp_path, "ply")
    assert error.value.hint == "those that do: png-json, coco, itop, ntu, ticam, depth-images, folder, recording"
    with pytest.raises(ConfigError, match="itop has no option 'every'"):
        open_source(tmp_path, "itop", every=2)
    for name in (name for name, form in FORMATS.items() if isinstance(form, DatasetFormat) and form.can("read")):
        with pytest.raises(DatasetError, match="does not exist"):
            open_source(tmp_path / "none", name)
        with pytest.raises(DatasetError) as wrong:
            open_source(tmp_path, name)
        assert wrong.value.hint


def test_one_frame_at_a_time(spheres: ModuleType, tmp_path: Path) -> None:
    """A frame is asked for when the one before has been written: nothing gathers them."""
    manifest = spheres.manifest(frames=7, frames_per_part=3)
    asked: list[int] = []
    done: list[int] = []

    def frames() -> Any:
        for i in range(7):
            asked.append(len(done))
            yield spheres.frame(i, manifest)

    out = import_source(Source(tmp_path, manifest, frames), tmp_path / "out", report=done.append)
    assert done == list(range(1, 8))
    assert asked == list(range(7))
    assert open_dataset(out).sizes["frame"] == 7


def test_a_source_that_shrinks(spheres: ModuleType, tmp_path: Path) -> None:
    manifest = spheres.manifest()
    source = Source(tmp_path, manifest, lambda: iter([spheres.frame(0, manifest)]))
    with pytest.raises(DatasetError, match="ended after 1 frames"):
        import_source(source, tmp_path / "out")
    assert list(tmp_path.iterdir()) == []


def test_a_disk_that_is_too_small_is_told_of_the_folder_that_was_asked_for(
    png_json: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("cabinpose.store.dataset.shutil.disk_usage", lambda _: SimpleNamespace(free=10))
    with pytest.raises(DatasetError, match=f"frames need about .*, {tmp_path / 'out'} has"):
        import_source(open_source(png_json, "png-json"), tmp_path / "out")
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(("writes", "named"), [("store.part.sync", ""), ("core.whole._fill", "/dataset.yaml")])
def test_a_disk_that_is_full_is_told_of_the_folder_that_was_asked_for(
    writes: str, named: str, png_json: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(path: Path, *_: object) -> None:
        raise OSError(errno.ENOSPC, "no space", str(path))

    monkeypatch.setattr(f"cabinpose.{writes}", full)
    with pytest.raises(DatasetError) as error:
        import_source(open_source(png_json, "png-json"), tmp_path / "out")
    assert str(error.value) == f"no space left while writing {tmp_path / 'out'}{named}"
    assert error.value.hint == "free some disk space, then run the same command again"  # and not: with --resume
    assert not list(tmp_path.iterdir())

"""What goes wrong: killed writers, full disks, damaged files, folders that hold something else."""

from __future__ import annotations

import os
import resource
import shutil
import signal
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from types import ModuleType

import pytest

from cabinpose.core.errors import DatasetError
from cabinpose.store import PartWriter, create_dataset, open_dataset, read_manifest
from cabinpose.store.part import temporary_parts
from cabinpose.store.schema import manifest_yaml

HERE = Path(__file__).parent


def contents(folder: Path) -> dict[str, bytes]:
    return {p.relative_to(folder).as_posix(): p.read_bytes() for p in sorted(folder.rglob("*")) if p.is_file()}


def test_kill_in_the_middle_of_a_part(spheres: ModuleType, dataset_folder: Path, tmp_path: Path) -> None:
    """Kill -9 with one part complete and the next under way; --resume ends with the same bytes as an undisturbed run."""
    code = (
        f"import sys, time; sys.path.insert(0, {str(HERE)!r})\n"
        "import sphere_people as s\n"
        "from cabinpose.store import PartWriter, create_dataset\n"
        "m = s.manifest(); folder = sys.argv[1]; create_dataset(folder, m)\n"
        "for plan in m.parts[:2]:\n"
        "    with PartWriter(folder, plan, m) as part:\n"
        "        part.attrs |= {'proposals': plan.frames + 3, 'rejections': {'car': 2, 'self': 1}}\n"
        "        for i in range(plan.first, plan.first + plan.frames):\n"
        "            part.append(s.frame(i, m))\n"
        "            if i == 2: print('now', flush=True); time.sleep(60)\n"
    )
    folder = tmp_path / "killed"
    with subprocess.Popen([sys.executable, "-c", code, str(folder)], stdout=subprocess.PIPE) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == b"now\n"
        process.send_signal(signal.SIGKILL)
    assert len(temporary_parts(folder)) == 1
    with pytest.warns(UserWarning, match="lacks 2 of 3 parts"):
        assert open_dataset(folder).sizes["frame"] == 2
    with create_dataset(folder, spheres.manifest(), resume=True):
        assert not temporary_parts(folder)
    spheres.write(folder, spheres.manifest(), resume=True)
    assert contents(folder) == contents(dataset_folder)


def test_disk_full(spheres: ModuleType, tmp_path: Path) -> None:
    """A limit on file sizes stands for the full disk: the part goes, what was complete stays, and resume completes it."""
    manifest = spheres.manifest(frames=4, frames_per_part=2, width=160, height=120)
    folder = tmp_path / "full"
    with create_dataset(folder, manifest):
        write_part(spheres, folder, manifest, 0)
        before = contents(folder)
        old = resource.getrlimit(resource.RLIMIT_FSIZE)
        resource.setrlimit(resource.RLIMIT_FSIZE, (20_000, old[1]))
        try:
            with pytest.raises(DatasetError, match="no space left") as error:
                write_part(spheres, folder, manifest, 1)
        finally:
            resource.setrlimit(resource.RLIMIT_FSIZE, old)
        assert "--resume" in str(error.value.hint)
    assert contents(folder) == before
    spheres.write(folder, manifest, resume=True)
    assert open_dataset(folder).sizes["frame"] == 4


@pytest.mark.skipif(os.geteuid() != 0, reason="mounting a tmpfs needs root")
def test_disk_really_full(spheres: ModuleType, tmp_path: Path) -> None:
    manifest = spheres.manifest(frames=4, frames_per_part=2, width=160, height=120)
    mount = ["mount", "-t", "tmpfs", "-o", "size=1600k", "none", tmp_path]
    if subprocess.run(mount, check=False, capture_output=True).returncode:
        pytest.skip("a tmpfs cannot be mounted here")
    try:
        folder = tmp_path / "full"
        with create_dataset(folder, manifest):
            write_part(spheres, folder, manifest, 0)
            before = contents(folder)
            (tmp_path / "ballast").write_bytes(bytes(shutil.disk_usage(tmp_path).free - 100_000))
            with pytest.raises(DatasetError, match="no space left"):
                write_part(spheres, folder, manifest, 1)
            assert contents(folder) == before
            with pytest.raises(DatasetError, match="another process is writing"):
                create_dataset(folder, manifest, resume=True)
        with pytest.raises(DatasetError, match="frames need about"):
            create_dataset(folder, manifest, resume=True)
    finally:
        subprocess.run(["umount", "--lazy", tmp_path], check=True)  # a failure above may leave files open


def write_part(spheres: ModuleType, folder: Path, manifest: object, index: int) -> None:
    plan = manifest.parts[index]  # type: ignore[attr-defined]
    with PartWriter(folder, plan, manifest) as part:  # type: ignore[arg-type]
        for i in range(plan.first, plan.first + plan.frames):
            part.append(spheres.frame(i, manifest))


def test_an_exception_leaves_nothing(spheres: ModuleType, tmp_path: Path) -> None:
    manifest = spheres.manifest()

    def fail(part: PartWriter) -> None:
        with part:
            part.append(spheres.frame(0, manifest))
            assert temporary_parts(tmp_path)
            part.append(spheres.frame(1, spheres.manifest(width=8)))

    with create_dataset(tmp_path, manifest):
        with pytest.raises(DatasetError, match="has shape"):
            fail(PartWriter(tmp_path, manifest.parts[0], manifest))
        assert [p.name for p in tmp_path.iterdir()] == ["dataset.yaml"]


def test_two_workers_with_one_part(spheres: ModuleType, dataset_folder: Path, tmp_path: Path) -> None:
    """A worker that was thought dead commits late: the part that is there stays."""
    manifest = spheres.manifest()
    with create_dataset(tmp_path, manifest), PartWriter(tmp_path, manifest.parts[0], manifest) as late:
        write_part(spheres, tmp_path, manifest, 0)
        inode = (tmp_path / "part-00000.zarr").stat().st_ino
        for i in range(2):
            late.append(spheres.frame(i, manifest))
    assert (tmp_path / "part-00000.zarr").stat().st_ino == inode
    assert not temporary_parts(tmp_path)


def truncate(path: Path) -> None:
    os.truncate(path, path.stat().st_size // 2)


def flip(path: Path) -> None:
    data = bytearray(path.read_bytes())
    data[len(data) // 4] ^= 0x10
    path.write_bytes(data)


@pytest.mark.parametrize(
    ("name", "damage", "message"),
    [
        ("depth/c/0/0/0", truncate, r"part-00001.zarr is damaged: depth/c/0/0/0 has \d+ bytes instead of \d+"),
        ("labels/c/0/0/0", Path.unlink, "part-00001.zarr is damaged: labels/c/0/0/0 is missing"),
        ("zarr.json", truncate, "part-00001.zarr is damaged: its zarr.json cannot be read"),
        ("amplitude/c/0/0/0", flip, "part-00001.zarr is damaged: cannot read amplitude .*checksum"),
        ("joints_3d/c/0/0/0/0", flip, "part-00001.zarr is damaged: cannot read joints_3d"),
    ],
)
def test_damaged_part(dataset_folder: Path, tmp_path: Path, name: str, damage: Callable[[Path], None], message: str) -> None:
    folder = tmp_path / "copy"
    shutil.copytree(dataset_folder, folder)
    damage(folder / "part-00001.zarr" / name)
    with pytest.raises(DatasetError, match=message) as error:
        open_dataset(folder).load()
    assert "--resume" in str(error.value.hint)


def test_resume_refuses_a_damaged_part(spheres: ModuleType, dataset_folder: Path, tmp_path: Path) -> None:
    folder = tmp_path / "copy"
    shutil.copytree(dataset_folder, folder)
    truncate(folder / "part-00002.zarr" / "depth/c/0/0/0")
    with pytest.raises(DatasetError, match=r"part-00002.zarr is damaged"):
        create_dataset(folder, spheres.manifest(), resume=True)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("schema_version: 2", "schema_version: 3", "has schema version 3, this program reads versions 1 and 2"),
        ("schema: cabinpose-dataset", "schema: other", "is not the manifest of a dataset"),
        ("frames: 5", "frames: five", "frames: must be a whole number, not 'five'"),
        ("seed: 7", "seed: 7\nsede: 8", "sede: unknown key"),
        ("seed: 7", "seed: [7", "is not YAML"),
    ],
)
def test_damaged_manifest(dataset_folder: Path, tmp_path: Path, old: str, new: str, message: str) -> None:
    """What is wrong is said by name where there is no checksum to say it first."""
    text = manifest_yaml(read_manifest(dataset_folder))
    assert old in text
    (tmp_path / "dataset.yaml").write_text(text.replace(old, new))
    with pytest.raises(DatasetError, match=message):
        open_dataset(tmp_path)


def test_folders_that_are_no_dataset(spheres: ModuleType, tmp_path: Path) -> None:
    with pytest.raises(DatasetError, match=r"holds no dataset: dataset\.yaml is missing"):
        open_dataset(tmp_path)
    (tmp_path / "thesis.tex").write_text("mine")
    for flags in ({}, {"resume": True}, {"overwrite": True}):
        with pytest.raises(DatasetError, match="not empty and holds no dataset"):
            create_dataset(tmp_path, spheres.manifest(), **flags)
    with pytest.raises(DatasetError, match=r"cannot use .* as a folder"):
        create_dataset(tmp_path / "thesis.tex", spheres.manifest())
    assert contents(tmp_path) == {"thesis.tex": b"mine"}
    create_dataset(tmp_path / "empty", spheres.manifest()).close()
    with pytest.raises(DatasetError, match="no complete part"):
        open_dataset(tmp_path / "empty")


def test_nothing_is_overwritten_unasked(spheres: ModuleType, dataset_folder: Path, tmp_path: Path) -> None:
    folder = tmp_path / "copy"
    shutil.copytree(dataset_folder, folder)
    before = contents(folder)
    manifest = spheres.manifest()
    with pytest.raises(DatasetError, match="already holds a dataset of 5 frames") as error:
        create_dataset(folder, manifest)
    assert "--resume" in str(error.value.hint)
    with pytest.raises(DatasetError, match="resumed or overwritten"):
        create_dataset(folder, manifest, resume=True, overwrite=True)
    other = spheres.manifest(seed=8, config={"scene": {"wall_m": 3.0, "cars": ["sedan"]}, "new": 1})
    with pytest.raises(DatasetError, match="made differently") as error:
        create_dataset(folder, other, resume=True)
    for text in ("seed: 7 there, 8 now", "config.scene.wall_m: 2.5 there, 3.0 now", "config.new: '(absent)' there, 1 now"):
        assert text in str(error.value)
    assert contents(folder) == before
    create_dataset(folder, manifest, resume=True).close()
    assert contents(folder) == before
    (folder / "notes.txt").write_text("mine")
    create_dataset(folder, other, overwrite=True).close()
    assert sorted(contents(folder)) == ["dataset.yaml", "notes.txt"]


def test_resume_grows(spheres: ModuleType, tmp_path: Path) -> None:
    spheres.write(tmp_path, spheres.manifest(frames=4))
    with pytest.raises(DatasetError, match="cannot shrink to 3"):
        create_dataset(tmp_path, spheres.manifest(frames=3), resume=True)
    spheres.write(tmp_path, spheres.manifest(frames=5), resume=True)
    assert open_dataset(tmp_path, missing="raise").frame.values.tolist() == [0, 1, 2, 3, 4]
    spheres.write(tmp_path, spheres.manifest(frames=6), resume=True)  # the last part had one frame of two
    assert open_dataset(tmp_path, missing="raise").frame.values.tolist() == [0, 1, 2, 3, 4, 5]


def test_gaps_show(spheres: ModuleType, dataset_folder: Path, tmp_path: Path) -> None:
    folder = tmp_path / "copy"
    shutil.copytree(dataset_folder, folder)
    shutil.rmtree(folder / "part-00001.zarr")
    with pytest.raises(DatasetError, match="lacks 1 of 3 parts"):
        open_dataset(folder, missing="raise")
    dataset = open_dataset(folder, missing="ignore")
    assert dataset.frame.values.tolist() == [0, 1, 4]
    assert dataset.car.values.tolist() == ["sedan", "van", "van"]


def test_one_writer_a_folder(spheres: ModuleType, tmp_path: Path) -> None:
    first = create_dataset(tmp_path, spheres.manifest())
    with pytest.raises(DatasetError, match="another process is writing"):
        create_dataset(tmp_path, spheres.manifest(), resume=True)
    first.close()
    create_dataset(tmp_path, spheres.manifest(), resume=True).close()


def test_too_large_for_the_disk(spheres: ModuleType, tmp_path: Path) -> None:
    with pytest.raises(DatasetError, match=r"frames need about .* GB"):
        create_dataset(tmp_path, spheres.manifest(frames=10**9, frames_per_part=10**6, width=352, height=287))
    assert list(tmp_path.iterdir()) == []

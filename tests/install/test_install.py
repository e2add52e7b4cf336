"""What is handed out installs: the source distribution, and the wheels of a release in the folder that CABINPOSE_WHEELS names.

Nothing comes from a network: environments are clean but for one line, which shows them the libraries of the one that runs the
tests, and building finds its tools there as well.
"""

from __future__ import annotations

import json
import os
import re
import resource
import shutil
import subprocess
import sys
import venv
import zipfile
from pathlib import Path

import pytest
from packaging.tags import sys_tags
from packaging.utils import parse_wheel_filename

from cabinpose import _native

ROOT = Path(__file__).parents[2]
RELEASE = os.environ.get("CABINPOSE_WHEELS", "")
WHEELS = sorted(Path(RELEASE).resolve().glob("*.whl")) if RELEASE else []
GLIBC = (2, 28)  # of every Linux that the wheels are for
BUILD_CPU_S = 120
of_a_release = pytest.mark.skipif(not RELEASE, reason="CABINPOSE_WHEELS names no folder of a release (`make wheels` makes one)")


def _newest_glibc(library: bytes) -> tuple[int, int]:
    """The newest version of glibc whose symbols a library asks for."""
    return max((int(major), int(minor)) for major, minor in re.findall(rb"GLIBC_(\d+)\.(\d+)", library))


def _kernels(wheel: Path) -> dict[str, bytes]:
    """The compiled libraries in a wheel by their build's name."""
    with zipfile.ZipFile(wheel) as held:
        return {Path(name).name.partition(".")[0]: held.read(name) for name in held.namelist() if name.endswith(".so")}


def _fits(wheel: Path) -> bool:
    return not parse_wheel_filename(wheel.name)[3].isdisjoint(sys_tags())


def _pip(*words: object) -> None:
    command = [sys.executable, "-m", "pip", "--quiet", "--disable-pip-version-check", *map(str, words)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr


def _show_libraries(environment: Path) -> None:
    """The libraries of the environment that runs the tests; of a package that both have, the clean one's is taken."""
    [site] = environment.glob("lib/python*/site-packages")
    libraries = [path for path in sys.path if path.endswith("site-packages")]
    (site / "libraries.pth").write_text("\n".join(libraries) + "\n", encoding="utf-8")


def _installed(wheel: Path, folder: Path) -> Path:
    """The folder of programs of a clean environment that has the wheel."""
    venv.create(folder, symlinks=True)
    bin_ = folder / "bin"
    _pip("--python", bin_ / "python", "install", "--no-deps", "--no-index", wheel)
    _show_libraries(folder)
    return bin_


@pytest.fixture(scope="session")
def built(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A wheel built here, as pip does it, from a source distribution, by the compiler of this machine."""
    if not any(map(shutil.which, ("c++", "g++", "clang++"))):
        pytest.skip("there is no C++ compiler here")
    folder = tmp_path_factory.mktemp("dist")
    code = f"from scikit_build_core.build import build_sdist; build_sdist({str(folder)!r})"
    subprocess.run([sys.executable, "-c", code], cwd=ROOT, check=True, capture_output=True)
    [sdist] = folder.glob("*.tar.gz")
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    _pip("wheel", "--no-deps", "--no-index", "--no-build-isolation", "-w", folder, sdist)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    assert after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime < BUILD_CPU_S
    [wheel] = folder.glob("*.whl")
    return wheel


def _runs_without_a_compiler(bin_: Path, folder: Path) -> None:
    """Help, a frame, the sample: by what is installed, with no other program on the PATH."""
    outside = {"PATH": str(bin_), "HOME": str(folder), "LANG": "C.UTF-8"}

    def ran(*words: str) -> str:
        command = [str(bin_ / words[0]), *words[1:]]
        done = subprocess.run(command, cwd=folder, env=outside, capture_output=True, text=True, check=False)
        assert done.returncode == 0, done.stderr
        return done.stdout

    assert "usage: cabinpose" in ran("cabinpose", "--help")
    ran("cabinpose", "synth", "--frames", "1", "--out", "one", "scene.cars=[suv]")
    assert json.loads(ran("cabinpose", "info", "one", "--json"))["frames"] == 1
    place, frames, simd = ran(
        "python", "-c", "import cabinpose; print(cabinpose.__file__, cabinpose.sample().sizes['frame'], cabinpose._native.SIMD)"
    ).split()
    assert Path(place).is_relative_to(bin_.parent)
    assert (frames, simd) == ("20", _native.SIMD)


@pytest.mark.slow
def test_the_source_distribution_builds_for_this_machine(built: Path, tmp_path: Path) -> None:
    """One build of the kernels, within 120 CPU-s; what it makes needs no compiler."""
    assert list(_kernels(built)) == [f"_{_native.SIMD}"]
    _runs_without_a_compiler(_installed(built, tmp_path / "clean"), tmp_path)


@pytest.mark.slow
def test_the_steps_of_the_container_file(built: Path, tmp_path: Path) -> None:
    """All that builds the image, taken in a virtual environment; nothing here builds images."""
    context, clean = tmp_path / "context", tmp_path / "clean"
    (context / "dist").mkdir(parents=True)
    shutil.copy(ROOT / "requirements.lock", context)
    shutil.copy(built, context / "dist")
    venv.create(clean, symlinks=True, with_pip=True)
    _show_libraries(clean)
    command = [ROOT / "tools" / "run_containerfile.sh", ROOT / "Containerfile", context, clean, f"WHEEL={built.name}"]
    offline = {"PIP_NO_INDEX": "1", "PIP_NO_DEPS": "1", "HOME": str(tmp_path)}
    done = subprocess.run(command, env=offline, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    assert "in_car on sample: 20 frames, 40 people" in done.stdout
    assert done.stdout.count("RUN ") == 2
    assert "usage: cabinpose" in done.stdout


@pytest.mark.slow
@pytest.mark.timeout(400)
def test_the_second_day(built: Path, tmp_path: Path) -> None:
    """The commands of docs/guides/second-day.md by the script that measures them, with one epoch and without an index."""
    pytest.importorskip("torch", reason="training needs the extra `train`")
    [libraries] = [path for path in sys.path if path.endswith("site-packages") and Path(path, "torch").exists()]
    environment = os.environ | {"OFFLINE": "1", "LIBRARIES": libraries, "EPOCHS": "1"}
    command = [ROOT / "tools" / "second_day.sh", built, tmp_path / "day"]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    for words in ("cabinpose synth", "cabinpose view", "mine: 150 frames of coco", "mine.onnx", "PCKh@0.5 2D"):
        assert words in done.stdout
    [spent] = re.findall(r"([\d.]+) CPU-s of them after it", done.stdout)
    assert 0 < float(spent) <= 15
    shown = (ROOT / "docs/guides/second-day.md").read_text(encoding="utf-8")
    steps = re.findall(r"^(\S.*?) +[\d.]+ s +[\d.]+ CPU-s", done.stdout, re.M)
    assert len(steps) == 9
    assert all(step in shown for step in steps)


def test_versions_of_glibc_are_read() -> None:
    assert _newest_glibc(b"\0GLIBC_2.4\0GLIBC_2.36\0GLIBC_2.2.5\0") == (2, 36)
    assert _newest_glibc(Path(str(_native._build.__file__)).read_bytes()) >= (2, 2)


@of_a_release
def test_a_release_is_for_every_python_and_linux() -> None:
    tags = {(tag.interpreter, tag.abi) for wheel in WHEELS for tag in parse_wheel_filename(wheel.name)[3]}
    assert tags == {("cp311", "cp311"), ("cp312", "abi3")}
    for wheel in WHEELS:
        for tag in parse_wheel_filename(wheel.name)[3]:
            stated = re.match(r"manylinux_(\d+)_(\d+)_", tag.platform)
            assert stated is not None
            assert (int(stated[1]), int(stated[2])) <= GLIBC
        kernels = _kernels(wheel)
        assert set(kernels) == {"_baseline", "_avx2"}
        for name, library in kernels.items():
            assert _newest_glibc(library) <= GLIBC, (wheel.name, name)
            assert b"libstdc++.so" not in library


@of_a_release
@pytest.mark.slow
def test_a_wheel_of_a_release_runs(tmp_path: Path) -> None:
    [wheel] = filter(_fits, WHEELS)
    _runs_without_a_compiler(_installed(wheel, tmp_path / "clean"), tmp_path)


@of_a_release
@pytest.mark.slow
def test_a_wheel_of_a_release_makes_the_same_bytes(tmp_path: Path) -> None:
    """Another compiler, and the same sums."""
    [wheel] = filter(_fits, WHEELS)
    theirs = tmp_path / "kernels"
    theirs.mkdir()
    for name, library in _kernels(wheel).items():
        (theirs / f"{name}.so").write_bytes(library)
    made = {}
    for simd in ("baseline", _native.SIMD):
        for folder in ("", str(theirs)):
            out = tmp_path / f"{simd}-{bool(folder)}"
            command = [sys.executable, "-m", "cabinpose", "synth", "--frames", "4", "--seed", "9", "--out", str(out)]
            kernels = {"CABINPOSE_SIMD": simd} | ({"CABINPOSE_NATIVE": folder} if folder else {})
            subprocess.run(command, env=os.environ | kernels, capture_output=True, check=True)
            files = sorted(path for path in out.rglob("*") if path.is_file())
            made[out.name] = [(path.relative_to(out), path.read_bytes()) for path in files]
    first, *others = made.values()
    assert first
    assert all(other == first for other in others)

"""Either build, any number of threads: the same bytes. What cannot be loaded is told with its remedy."""

from __future__ import annotations

import hashlib
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

import cabinpose._native as native
from cabinpose._native import _baseline

PROGRAM = """
import sys
from pathlib import Path
from cabinpose import _native
from cabinpose.synth.config import CabinScene, Output, SynthConfig, room_preset
from cabinpose.synth.people import People
from cabinpose.synth.generate import generate
out, threads = Path(sys.argv[1]), int(sys.argv[2])
seats = {"driver": 1.0, "front_passenger": 0.5, "rear_left": 0.3}
car = SynthConfig(scene=CabinScene(cars=("hatchback",), occupancy=seats), people=People(subjects=("S01", "S02", "S03")),
                  output=Output(frames_per_part=3))
generate(car, 6, out / "car", seed=4, workers=threads)
generate(room_preset(), 2, out / "room", seed=4, workers=threads)
print(_native.SIMD)
"""

_SYNTH = ("--config", str(Path(__file__).parents[2] / "docs" / "examples" / "demo.yaml"), "--frames", "1", "--out")


def _run(program: str, *arguments: str, **variables: str) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-c", program, *arguments]
    return subprocess.run(command, capture_output=True, text=True, check=False, env=os.environ | variables)


def _fingerprint(folder: Path) -> dict[str, str]:
    files = sorted(p for p in folder.rglob("*") if p.is_file())
    return {str(p.relative_to(folder)): hashlib.sha256(p.read_bytes()).hexdigest() for p in files}


@pytest.mark.skipif(not _baseline.runs_here(), reason="this processor has no AVX2: there is one build to run")
@pytest.mark.slow
def test_builds_and_threads_make_the_same_bytes(tmp_path: Path) -> None:
    made = {}
    for simd, threads in (("avx2", "1"), ("baseline", "1"), ("avx2", "3")):
        folder = tmp_path / f"{simd}-{threads}"
        done = _run(PROGRAM, str(folder), threads, CABINPOSE_SIMD=simd)
        assert done.stdout.split() == [simd], done.stderr
        made[folder.name] = _fingerprint(folder)
    assert made["avx2-1"] == made["baseline-1"] == made["avx2-3"]


@pytest.mark.parametrize("wanted", ["", "baseline"])
def test_a_build_is_chosen(wanted: str) -> None:
    done = _run("from cabinpose import _native; print(_native.SIMD)", CABINPOSE_SIMD=wanted)
    assert done.stdout.strip() == (wanted or ("avx2" if _baseline.runs_here() or native._cpu_has_avx2() else "baseline"))


def _refused(*arguments: str, **variables: str) -> str:
    """What the command line says where the kernels cannot be loaded."""
    done = _run("import sys; from cabinpose.app.cli import main; sys.exit(main(sys.argv[1:]))", *arguments, **variables)
    assert done.returncode == 2, done.stderr
    assert done.stderr.count("hint: ") == 1
    assert "Traceback" not in done.stderr
    return done.stderr


def test_no_such_build(tmp_path: Path) -> None:
    said = _refused("synth", *_SYNTH, str(tmp_path / "out"), CABINPOSE_SIMD="avx512")
    assert said.startswith("error: CABINPOSE_SIMD=avx512: no such build\nhint: use avx2 or baseline")


def test_kernels_of_another_processor(tmp_path: Path) -> None:
    """A library that the loader refuses, as it does one of another processor."""
    real = Path(str(_baseline.__file__))
    broken = tmp_path / real.name
    shutil.copy(real, broken)
    data = bytearray(broken.read_bytes())
    data[18:20] = (0xB7).to_bytes(2, "little")  # the ELF header's machine: AArch64
    broken.write_bytes(data)
    said = _refused("synth", *_SYNTH, str(tmp_path / "out"), CABINPOSE_NATIVE=str(tmp_path))
    assert "cannot be loaded" in said
    assert "wheel for this processor" in said


def test_no_kernel_of_the_avx2_build_fuses() -> None:
    """A fused product and sum would round once where the other build rounds twice."""
    if shutil.which("objdump") is None or native.SIMD != "avx2":
        pytest.skip("needs objdump and the AVX2 build")
    from cabinpose._native import _avx2  # type: ignore[attr-defined]

    listing = subprocess.run(
        ["objdump", "-d", "--no-show-raw-insn", str(_avx2.__file__)], capture_output=True, text=True, check=True
    )
    assert "vmulps" in listing.stdout
    fused = [line for line in listing.stdout.splitlines() if "\tvfm" in line or "\tvfnm" in line]
    assert fused == []
    used = subprocess.run(["objdump", "-T", str(_avx2.__file__)], capture_output=True, text=True, check=True).stdout
    libm = {
        "sin",
        "cos",
        "tan",
        "exp",
        "log",
        "pow",
        "atan",
        "atan2",
        "asin",
        "acos",
        "sinf",
        "cosf",
        "expf",
        "logf",
        "powf",
        "fma",
    }
    assert not libm & {line.split()[-1] for line in used.splitlines() if "*UND*" in line}


ALONE = """
import pathlib
if {blind}:
    pathlib.Path.read_text = lambda self, **_: "flags\\t\\t: fpu sse4_2 avx\\n"
from cabinpose import _native
print(_native.SIMD)
"""


@pytest.mark.skipif(native.SIMD != "avx2", reason="needs the AVX2 build")
@pytest.mark.parametrize("wanted", ["", "avx2"])
def test_a_build_for_one_machine_alone(tmp_path: Path, wanted: str) -> None:
    """pip builds what the machine runs; another processor is refused in words, not by an illegal instruction."""
    library = Path(str(native._build.__file__))
    shutil.copy(library, tmp_path / library.name)
    done = _run(ALONE.format(blind=False), CABINPOSE_SIMD=wanted, CABINPOSE_NATIVE=str(tmp_path))
    assert done.stdout.strip() == "avx2", done.stderr
    elsewhere = _run(ALONE.format(blind=True), CABINPOSE_SIMD=wanted, CABINPOSE_NATIVE=str(tmp_path))
    assert "the compiled kernels of cabinpose cannot be loaded: " in elsewhere.stderr
    assert "no _baseline in" in _refused(
        "synth", *_SYNTH, str(tmp_path / "out"), CABINPOSE_SIMD="baseline", CABINPOSE_NATIVE=str(tmp_path)
    )

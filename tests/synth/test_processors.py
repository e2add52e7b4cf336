"""Datasets are the same bytes, in every file, whatever processor OpenBLAS, numpy, the C library and the kernels take it for."""

from __future__ import annotations

import hashlib
import os
import subprocess
import sys
from pathlib import Path

import pytest

FEATURES = "X86_V3 X86_V4 AVX512_ICL AVX512_SPR"
WITHOUT_AVX = "glibc.cpu.hwcaps=-AVX2,-FMA,-AVX512F,-AVX512VL"
# OpenBLAS's kernels for six, with what numpy, the C library and our kernels may be beside them.
PROCESSORS = [
    {"OPENBLAS_CORETYPE": "Haswell", "CABINPOSE_SIMD": "baseline"},
    {"OPENBLAS_CORETYPE": "SkylakeX", "GLIBC_TUNABLES": WITHOUT_AVX},
    {"OPENBLAS_CORETYPE": "Zen", "OPENBLAS_NUM_THREADS": "2", "NPY_DISABLE_CPU_FEATURES": "X86_V4 AVX512_ICL AVX512_SPR"},
    {"OPENBLAS_CORETYPE": "Nehalem", "NPY_DISABLE_CPU_FEATURES": FEATURES, "CABINPOSE_SIMD": "baseline"},
    {"OPENBLAS_CORETYPE": "Sandybridge", "NPY_DISABLE_CPU_FEATURES": FEATURES, "GLIBC_TUNABLES": WITHOUT_AVX},
    {"OPENBLAS_CORETYPE": "Prescott", "GLIBC_TUNABLES": WITHOUT_AVX, "CABINPOSE_SIMD": "baseline"},
]
FULL = "scene.occupancy={driver: 1, front_passenger: 1, rear_left: 1, rear_center: 1, rear_right: 1}"
THINGS = str(Path(__file__).parents[2] / "docs" / "examples" / "things.yaml")
SCENES = {
    "plain": ["noise.multipath=true"],
    "full": [FULL, "scene.cars=[suv, sedan]"],
    "things": ["--config", THINGS],
    "room": ["scene={kind: room}"],
    "sequence": ["scene.sequence={frames: 6, rate_hz: 15, activities: [steer, drink, check_mirror]}"],
}

# What drivers hold the rim with, to the last bit: datasets round it to what they store.
POSES = """
import hashlib
from cabinpose.synth import SynthConfig
from cabinpose.synth.sample import SceneSampler
from cabinpose.synth.streams import frame_rng
driver = {"occupancy": {"driver": 1.0}, "occupants": {"driver": {"action": "drive"}}, "cars": ["sedan", "suv", "coupe"]}
sampler = SceneSampler(SynthConfig.parse({"scene": driver}), 0)
for index in range(5):
    posed = sampler.sample(index, rng=frame_rng(0, index)).people[0].posed
    print(*(hashlib.sha256(values.tobytes()).hexdigest() for values in (posed.q, posed.fingers, posed.vehicle_from_root)))
"""


def made(out: Path, scene: str, frames: int, workers: int, **processor: str) -> dict[str, str]:
    command = ["-m", "cabinpose", "synth", "--seed", "3", "--frames", str(frames), "--workers", str(workers), "--out", str(out)]
    environment = os.environ | processor
    subprocess.run([sys.executable, *command, *SCENES[scene]], env=environment, check=True, stdout=subprocess.DEVNULL)
    files = sorted(path for path in out.rglob("*") if path.is_file())
    return {str(path.relative_to(out)): hashlib.sha256(path.read_bytes()).hexdigest() for path in files}


@pytest.mark.slow
@pytest.mark.parametrize("scene", SCENES)
def test_a_dataset_is_the_same_bytes_on_every_processor(scene: str, tmp_path: Path) -> None:
    frames = int(os.environ.get("CABINPOSE_PROCESSOR_FRAMES", "4"))
    here = made(tmp_path / "here", scene, frames, 2)
    assert len(here) > 20
    for number, processor in enumerate(PROCESSORS):
        there = made(tmp_path / str(number), scene, frames, (1, 4)[number % 2], **processor)
        assert there == here, processor


@pytest.mark.slow
def test_poses_are_the_same_bits_on_every_processor() -> None:
    told = []
    for processor in ({}, PROCESSORS[3]):
        command = [sys.executable, "-c", POSES]
        told.append(subprocess.run(command, env=os.environ | processor, check=True, capture_output=True, text=True).stdout)
    assert len(told[0].split()) == 15
    assert told[0] == told[1]

"""Datasets are the same bytes, in every file, whatever processor OpenBLAS, numpy, the C library and the kernels take it for."""

from __future__ import annotations

import hashlib
import json
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


# Every scene's dataset, in the folder and with the workers and frames that are asked for.
DATASETS = """
import json, sys
from cabinpose.app.cli import main
out, frames, workers, scenes = sys.argv[1:]
for name, words in json.loads(scenes).items():
    flags = ["--seed", "3", "--frames", frames, "--workers", workers, "--out", f"{out}/{name}"]
    if code := main(["synth", *flags, *words]):
        sys.exit(code)
"""


def made(out: Path, workers: int, **processor: str) -> dict[str, dict[str, str]]:
    """By scene the checksum of every file of its dataset."""
    frames = os.environ.get("CABINPOSE_PROCESSOR_FRAMES", "4")
    command = [sys.executable, "-c", DATASETS, str(out), frames, str(workers), json.dumps(SCENES)]
    subprocess.run(command, env=os.environ | processor, check=True, stdout=subprocess.DEVNULL)
    hashes: dict[str, dict[str, str]] = {}
    for scene in SCENES:
        files = sorted(path for path in (out / scene).rglob("*") if path.is_file())
        hashes[scene] = {str(path.relative_to(out)): hashlib.sha256(path.read_bytes()).hexdigest() for path in files}
    return hashes


@pytest.fixture(scope="module")
def everywhere(tmp_path_factory: pytest.TempPathFactory) -> list[dict[str, dict[str, str]]]:
    """Of this processor, then of each of the others."""
    folder = tmp_path_factory.mktemp("processors")
    others = [made(folder / str(number), (1, 4)[number % 2], **processor) for number, processor in enumerate(PROCESSORS)]
    return [made(folder / "here", 2), *others]


@pytest.mark.slow
@pytest.mark.parametrize("scene", SCENES)
def test_a_dataset_is_the_same_bytes_on_every_processor(scene: str, everywhere: list[dict[str, dict[str, str]]]) -> None:
    here, *others = (hashes[scene] for hashes in everywhere)
    assert len(here) > 20
    for processor, there in zip(PROCESSORS, others, strict=True):
        assert there == here, processor


@pytest.mark.slow
def test_poses_are_the_same_bits_on_every_processor() -> None:
    told = []
    for processor in ({}, PROCESSORS[3]):
        command = [sys.executable, "-c", POSES]
        told.append(subprocess.run(command, env=os.environ | processor, check=True, capture_output=True, text=True).stdout)
    assert len(told[0].split()) == 15
    assert told[0] == told[1]

"""A configuration that is quick to generate, and what the tests say of the folders it makes."""

from __future__ import annotations

import hashlib
import json
import os
import subprocess
import sys
from pathlib import Path

from cabinpose.synth.camera import Camera
from cabinpose.synth.config import CabinScene, Output, SynthConfig
from cabinpose.synth.people import People

PART = 3
SCRIPT = """
import json, sys
from pathlib import Path
from cabinpose.synth.generate import generate
from synth_scenes import small_config
if __name__ == "__main__":
    out, workers, resume, scene = Path(sys.argv[1]), int(sys.argv[2]), sys.argv[3] == "resume", json.loads(sys.argv[5])
    generate(small_config(**scene), int(sys.argv[4]), out, seed=7, workers=workers, existing="resume" if resume else "refuse",
             progress=lambda p: print("done", p.frames_done, flush=True))
"""


def small_config(**scene: object) -> SynthConfig:
    """Drivers alone in one car, three frames a part."""
    values: dict[str, object] = {"cars": ("hatchback",), "occupancy": {"driver": 1.0}, "right_hand_drive": 0.0}
    return SynthConfig(
        scene=CabinScene.model_validate(values | scene),
        people=People(subjects=("S01", "S02", "S03")),
        camera=Camera(sensor="pico_monstar_105/5"),
        output=Output(frames_per_part=PART),
    )


def start(
    script: Path, out: Path, workers: int, mode: str = "fresh", frames: int = 3 * PART, **scene: object
) -> subprocess.Popen[str]:
    """Runs `generate` of `small_config(**scene)` in a process of its own, with the seed 7."""
    environment = os.environ | {"PYTHONPATH": str(Path(__file__).parent)}
    script.write_text(SCRIPT, encoding="utf-8")
    command = [sys.executable, str(script), str(out), str(workers), mode, str(frames), json.dumps(scene)]
    return subprocess.Popen(command, stdout=subprocess.PIPE, text=True, env=environment, start_new_session=True)


def fingerprint(folder: Path) -> dict[str, str]:
    """SHA-256 of every file of a dataset, by its path."""
    files = sorted(p for p in folder.rglob("*") if p.is_file())
    return {str(p.relative_to(folder)): hashlib.sha256(p.read_bytes()).hexdigest() for p in files}

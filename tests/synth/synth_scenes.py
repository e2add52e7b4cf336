"""A configuration that is quick to generate, and what the tests say of the folders it makes."""

from __future__ import annotations

import hashlib
from pathlib import Path

from cabinpose.synth.config import CabinScene, Camera, Output, People, SynthConfig

PART = 3


def small_config(**scene: object) -> SynthConfig:
    """Drivers alone in one car, three frames a part."""
    values: dict[str, object] = {"cars": ("hatchback",), "occupancy": {"driver": 1.0}, "right_hand_drive": 0.0}
    return SynthConfig(
        scene=CabinScene.model_validate(values | scene),
        people=People(subjects=("S01", "S02", "S03")),
        camera=Camera(sensor="pico_monstar_105/5"),
        output=Output(frames_per_part=PART),
    )


def fingerprint(folder: Path) -> dict[str, str]:
    """SHA-256 of every file of a dataset, by its path."""
    files = sorted(p for p in folder.rglob("*") if p.is_file())
    return {str(p.relative_to(folder)): hashlib.sha256(p.read_bytes()).hexdigest() for p in files}

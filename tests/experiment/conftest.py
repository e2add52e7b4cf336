"""A small experiment: three people at the wheel, of whom one teaches, one validates and one is tested."""

from __future__ import annotations

import copy
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import yaml

from cabinpose.app.experiment.config import merged

Write = Callable[..., Path]
SMALL: dict[str, Any] = {
    "title": "A small experiment",
    "source": "a test",
    "recipe": {
        "method": "compact",
        "settings": {
            "slots": ["driver"], "width": 64, "height": 48, "channels": [4, 4, 8, 8], "blocks": [1, 1, 1], "looks_px": [],
        },
        "batch": 2,
    },
    "scales": {"paper": {"steps": 4, "epochs": 2, "sample_s": 0.01}},
    "data": {
        "real": {
            "stands_for": "recordings of three people",
            "seed": 3,
            "synth": {
                "scene": {"cars": ["sedan"], "occupancy": {"driver": 1.0}, "clutter": 0.0},
                "people": {"driver_years": 0, "own": {"P1": {"gender": "male"}, "P2": {"gender": "female"}, "P3": {}}},
                "camera": {"sensor": "evk75023", "views": {"driver": 1.0}},
            },
            "frames": {"P1": 4, "P2": 2, "P3": 3},
        },
    },
    "trainings": {
        "R1": {
            "train": [{"data": "real", "subject": ["P1"], "frames": 4}],
            "validation": [{"data": "real", "subject": ["P2"], "frames": 2}],
        },
    },
    "tests": {"T": {"frames": [{"data": "real", "subject": ["P3"], "frames": 3}], "may_share": ["car"]}},
    "columns": [{"title": "PCKh@0.5", "test": "T"}, {"title": "error cm", "test": "T", "measure": "mean_error", "space": "3d"}],
    "published": {"R1": {"PCKh@0.5": 13.47}},
}  # fmt: skip


@pytest.fixture
def write(tmp_path: Path) -> Write:
    """Writes the small experiment with changes, as a file."""

    def written(changes: dict[str, Any] | None = None, name: str = "small.yaml") -> Path:
        path = tmp_path / name
        path.write_text(yaml.safe_dump(merged(copy.deepcopy(SMALL), changes or {}), sort_keys=False))
        return path

    return written

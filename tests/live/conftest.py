from __future__ import annotations

from pathlib import Path

import pytest

from cabinpose.app.cli import main

FRAMES = 6


@pytest.fixture(scope="session")
def dataset_folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Six generated frames of drivers; read only."""
    folder = tmp_path_factory.mktemp("live") / "dataset"
    assert main(["synth", "--out", str(folder), "--frames", str(FRAMES), "scene.cars=[suv]"]) == 0
    return folder


@pytest.fixture(scope="session")
def recording(dataset_folder: Path) -> Path:
    """The frames of the dataset once, recorded from a simulated camera at 30 frames a second."""
    out = dataset_folder.parent / "take.mcap"
    rig = dataset_folder.parent / "rig.yaml"
    rig.write_text(
        f"sources:\n  camera: {{kind: simulated, dataset: {dataset_folder.name}, loop: false, faults: {{rate_hz: 30}}}}\n",
        encoding="utf-8",
    )
    assert main(["record", "--config", str(rig), "--out", str(out)]) == 0
    return out

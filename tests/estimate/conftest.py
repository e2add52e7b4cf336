"""Fixtures of the estimation's tests; the sphere people of the store's tests serve as dataset."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

for folder in (Path(__file__).parent, Path(__file__).parents[1] / "store"):
    sys.path.insert(0, str(folder))


@pytest.fixture(scope="session")
def checkpoints(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """A checkpoint of each method, trained for an epoch on sphere people; read only."""
    import small

    from cabinpose.estimate.data import StoredFrames
    from cabinpose.estimate.train_config import Machines, TrainConfig
    from cabinpose.estimate.training import fit, frame_spec

    folder, dataset = tmp_path_factory.mktemp("trained"), small.dataset(8)
    made = {}
    for method, settings in small.TINY.items():
        config = TrainConfig(method=method, settings=settings, epochs=1, batch=4, average=0.5)
        frames = StoredFrames(dataset, frame_spec(config))
        made[method] = fit(config, frames, frames, folder / method, machines=Machines(1))
    return made


@pytest.fixture(scope="session")
def trained(checkpoints: dict[str, Path]) -> dict[str, Path]:
    """The ONNX models of the checkpoints; read only."""
    from cabinpose.estimate.export import export_onnx

    made = {method: path.parent / f"{method}.onnx" for method, path in checkpoints.items()}
    for method, path in made.items():
        export_onnx(checkpoints[method], path, name=method, card={"data": "spheres"})
    return made

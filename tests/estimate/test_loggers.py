"""Loggers of a run: the figures of its table in the files of each, read by its own reader where it has one."""

from __future__ import annotations

import csv
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace

import pytest
import small

from cabinpose.core import ConfigError, DependencyError
from cabinpose.estimate.data import StoredFrames
from cabinpose.estimate.loggers import LOGGERS, check_loggers
from cabinpose.estimate.train_config import Machines, Observers
from cabinpose.estimate.training import TrainConfig, fit, frame_spec


def _in_tensorboard(log: Path) -> list[float]:
    from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

    return [event.value for event in EventAccumulator(str(log)).Reload().Scalars("val_loss")]


def _in_mlflow(log: Path) -> list[float]:
    from mlflow.tracking import MlflowClient

    client = MlflowClient((log / "mlflow").resolve().as_uri())
    [experiment] = [found for found in client.search_experiments() if found.name == "cabinpose"]
    [run] = client.search_runs([experiment.experiment_id])
    assert (run.info.run_name, run.info.status) == (log.parent.name, "FINISHED")
    assert run.data.params["config/epochs"] == "2"
    return [metric.value for metric in client.get_metric_history(run.info.run_id, "val_loss")]


def _in_wandb(log: Path) -> list[float]:
    """It has no public reader of offline runs: the table's numbers, as they are written."""
    [held] = [path.read_bytes() for path in log.glob("wandb/offline-run-*/run-*.wandb")]
    assert b"val_loss" in held
    return [value for value in _in_table(log) if repr(value).encode() in held]


def _in_table(log: Path) -> list[float]:
    with (log / "metrics.csv").open(encoding="utf-8", newline="") as file:
        return [float(row["val_loss"]) for row in csv.DictReader(file)]


READERS: dict[str, Callable[[Path], list[float]]] = {"tensorboard": _in_tensorboard, "mlflow": _in_mlflow, "wandb": _in_wandb}


def trained(out: Path, *loggers: str) -> None:
    settings = small.TINY["lifting"]
    config = TrainConfig.model_validate({"method": "lifting", "settings": settings, "epochs": 2, "batch": 4})
    frames = StoredFrames(small.dataset(), frame_spec(config), keep=True)
    fit(config, frames, frames, out, machines=Machines(devices=1), observers=Observers(loggers=loggers))


def test_every_logger_has_a_reader() -> None:
    assert set(READERS) == set(LOGGERS)


@pytest.mark.slow
@pytest.mark.parametrize("name", READERS)
def test_a_logger_has_the_figures_of_the_table(name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip(name, reason=f"needs the extra `{name}`")
    monkeypatch.delenv("MLFLOW_TRACKING_URI", raising=False)
    trained(tmp_path / "run", name)
    assert len(_in_table(tmp_path / "run/log")) == 2
    assert READERS[name](tmp_path / "run/log") == pytest.approx(_in_table(tmp_path / "run/log"), rel=1e-6)


def test_a_run_without_a_logger_writes_its_table_alone(tmp_path: Path) -> None:
    trained(tmp_path / "run")
    assert [path.name for path in (tmp_path / "run/log").iterdir()] == ["metrics.csv"]


def test_what_is_not_installed_is_told_before_anything_is_written(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A folder of the name, such as an earlier run has left where it was started, is no package."""
    for spec in (None, SimpleNamespace(origin=None)):
        monkeypatch.setattr("cabinpose.estimate.loggers.find_spec", lambda _, spec=spec: spec)
        for name in LOGGERS:
            with pytest.raises(DependencyError, match=f"Python package {name}, which is not installed") as caught:
                trained(tmp_path / "run", name)
            assert caught.value.hint == f"pip install 'cabinpose[{name}]'"
    assert list(tmp_path.iterdir()) == []


def test_a_logger_that_does_not_exist_names_those_that_do() -> None:
    with pytest.raises(ConfigError, match="unknown logger 'tensorbord'") as caught:
        check_loggers(["tensorbord"])
    assert caught.value.hint == "did you mean tensorboard? known: mlflow, tensorboard, wandb"

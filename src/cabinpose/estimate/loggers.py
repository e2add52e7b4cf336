"""Where the figures of a training run go besides its own table: TensorBoard, MLflow, Weights & Biases.

Each is asked for by name and is an extra of that name. All write into the run's folder, `log`; none needs a network.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager, ExitStack, contextmanager
from importlib.util import find_spec
from pathlib import Path
from types import MappingProxyType
from typing import Any

from cabinpose.core import DependencyError, unknown_name

_PROJECT = "cabinpose"  # under which MLflow and Weights & Biases list runs


@contextmanager
def _tensorboard(folder: Path) -> Iterator[Any]:
    """Event files in the folder itself."""
    from lightning.pytorch.loggers import TensorBoardLogger  # noqa: PLC0415 - loads torch

    yield TensorBoardLogger(folder.parent, name="", version=folder.name)


@contextmanager
def _mlflow(folder: Path) -> Iterator[Any]:
    """A file store in `mlflow`, or the server that MLFLOW_TRACKING_URI names."""
    os.environ.setdefault("MLFLOW_DISABLE_TELEMETRY", "true")
    server = os.environ.get("MLFLOW_TRACKING_URI")
    if not server:
        os.environ.setdefault("MLFLOW_ALLOW_FILE_STORE", "true")  # a database needs more than mlflow-skinny
    from lightning.pytorch.loggers import MLFlowLogger  # noqa: PLC0415 - loads torch

    place = server or (folder / "mlflow").resolve().as_uri()
    yield MLFlowLogger(_PROJECT, run_name=folder.resolve().parent.name, tracking_uri=place)


@contextmanager
def _wandb(folder: Path) -> Iterator[Any]:
    """An offline run in `wandb`, which `wandb sync` uploads when somebody wants it to."""
    os.environ.setdefault("WANDB_ERROR_REPORTING", "false")
    os.environ.setdefault("WANDB_SILENT", "true")
    import wandb  # noqa: PLC0415 - an extra
    from lightning.pytorch.loggers import WandbLogger  # noqa: PLC0415 - loads torch

    folder.mkdir(parents=True, exist_ok=True)  # else it writes to the system's temporary folder
    settings = wandb.Settings(console="off")
    logger = WandbLogger(folder.resolve().parent.name, folder, offline=True, project=_PROJECT, settings=settings)
    try:
        yield logger
    finally:
        logger.experiment.finish()  # else the next run of this process goes on with it


LOGGERS: MappingProxyType[str, Callable[[Path], AbstractContextManager[Any]]] = MappingProxyType(
    {"tensorboard": _tensorboard, "mlflow": _mlflow, "wandb": _wandb}
)
"""What opens a logger of Lightning for a folder, by its name: that of the Python package which it needs, and of the extra."""


def check_loggers(names: Sequence[str]) -> None:
    """Look for the packages of these loggers, without importing one.

    Parameters
    ----------
    names
        Keys of `LOGGERS`.

    Raises
    ------
    ConfigError
        For a name that does not exist; lists the ones that do.
    DependencyError
        Where the package of one is not installed.
    """
    for name in names:
        if name not in LOGGERS:
            raise unknown_name("logger", name, tuple(LOGGERS))
        found = find_spec(name)
        if found is None or found.origin is None:  # a folder `wandb`, such as older runs have left, is none
            raise DependencyError(f"--logger {name} needs the Python package {name}, which is not installed",
                                  hint=f"pip install 'cabinpose[{name}]'")  # fmt: skip


@contextmanager
def open_loggers(names: Sequence[str], folder: Path) -> Iterator[list[Any]]:
    """Loggers of Lightning that write into `folder` (`log` of a run's folder) until they are left; errors: `check_loggers`."""
    check_loggers(names)
    with ExitStack() as stack:
        yield [stack.enter_context(LOGGERS[name](folder)) for name in dict.fromkeys(names)]

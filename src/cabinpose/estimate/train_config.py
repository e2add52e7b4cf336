"""What a training run is told: its configuration, what it begins with, where it computes, and who is told how it goes.

A configuration is checked without torch, which takes seconds to load.
"""

from __future__ import annotations

import warnings
from collections.abc import Mapping
from dataclasses import dataclass, replace
from operator import not_
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Field, ValidationInfo, field_validator

from cabinpose.core import ConfigError, unknown_name
from cabinpose.estimate.methods import METHODS, Progress
from cabinpose.estimate.settings import AugmentConfig
from cabinpose.store import JointNames, as_named, read_mapping, validated

if TYPE_CHECKING:
    import xarray as xr
    from lightning.pytorch.callbacks import Callback

    from cabinpose.estimate.curves import Draw

Positive = Annotated[int, Field(ge=1)]
Precision = Literal["32-true", "16-mixed", "bf16-mixed"]
_CPU_INFO = Path("/proc/cpuinfo")
_BF16_FLAGS = {"avx512_bf16", "amx_bf16", "bf16"}  # as Linux calls what computes bfloat16, of x86 and of Arm


class DatasetNames(BaseModel):
    """How a run calls the places and joints of a dataset, see `store.as_named`."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    places: Annotated[Mapping[str, str], Field(description="Places of the dataset by new names; the others go.")] = {}
    joints: Annotated[
        JointNames,
        Field(description="Joints of the dataset by new names, or their set: itop; others are not labelled."),
    ] = {}


class TrainConfig(BaseModel):
    """A training run: the method with its settings, the data's splits and the optimiser."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    method: Annotated[str, Field(description="Name of a method; `cabinpose train --help` lists them.")] = "compact"
    settings: Annotated[dict[str, Any], Field(description="Settings of the method.")] = Field(
        default_factory=dict, validate_default=True
    )
    augment: AugmentConfig = Field(default_factory=AugmentConfig)
    depth: Annotated[
        Literal["depth", "depth_styled", "depth_clean"], Field(description="The dataset's image that is read as depth.")
    ] = "depth"
    data: Annotated[
        Mapping[str, DatasetNames], Field(exclude_if=not_, description="Places and joints by new names, by dataset.")
    ] = {}
    epochs: Annotated[Positive, Field(description="Passes over the training frames.")] = 30
    batch: Annotated[Positive, Field(description="Frames in a batch.")] = 32
    epoch_steps: Annotated[
        Positive | None, Field(description="Batches in an epoch, taken from one pass after another; default: those of one pass.")
    ] = None
    patience: Annotated[int, Field(ge=0, description="Stop after so many epochs without a better one; 0 = never.")] = 0
    best_by: Annotated[
        Literal["figure", "loss"], Field(description="The best epoch has the greatest figure, or the least validation loss.")
    ] = "figure"
    optimiser: Annotated[Literal["adamw", "adam"], Field(description="adam: the decay is part of the gradient (L2).")] = "adamw"
    schedule: Annotated[Literal["one-cycle", "constant"], Field(description="Of the learning rate.")] = "one-cycle"
    learning_rate: Annotated[float, Field(gt=0, description="Greatest rate of the schedule; default: the method's.")] = Field(
        default_factory=lambda run: METHODS[run["method"]].learning_rate
    )
    weight_decay: Annotated[float, Field(ge=0, description="Of the optimiser; default: the method's.")] = Field(
        default_factory=lambda run: METHODS[run["method"]].weight_decay
    )
    average: Annotated[float, Field(ge=0, lt=1, description="Greatest decay of the weights' moving average; 0 = none.")] = 0.998
    precision: Annotated[
        Precision, Field(description="Lightning's precision; mixed ones are 32-true on a CPU without bfloat16.")
    ] = "32-true"
    workers: Annotated[int, Field(ge=0, description="Processes that read frames beside the training; 0 = none.")] = 0
    seed: Annotated[int, Field(ge=0, description="Seed of weights, order and augmentation.")] = 1

    @field_validator("settings")
    @classmethod
    def _with_defaults(cls, value: dict[str, Any], info: ValidationInfo) -> dict[str, Any]:
        """All settings of the method, so that runs compare; ConfigError for one that the method does not know."""
        return METHODS[info.data.get("method", "compact")].settings(value).model_dump(mode="json")


def as_configured(config: TrainConfig, datasets: Mapping[str, xr.Dataset]) -> dict[str, xr.Dataset]:
    """Datasets, by the paths of their folders, with places and joints as the `data` of a configuration calls them.

    A key of `data` is the name of a folder or its path. Raises ConfigError for one that is neither, and as `as_named` does.
    """
    known = {name: {name, Path(name).resolve().name} for name in datasets}
    for key in config.data:
        if not any(key in names for names in known.values()):
            raise unknown_name("dataset in `data`", key, [Path(name).resolve().name for name in datasets])
    settings = METHODS[config.method].settings(config.settings)
    result = dict(datasets)
    for key, names in config.data.items():
        for name in (name for name, called in known.items() if key in called):
            result[name] = as_named(
                result[name], names.places, names.joints, skeleton=settings.joint_set.name, slots=settings.slots
            )
    return result


def read_train_config(path: Path | None, method: str | None) -> TrainConfig:
    """The configuration in a YAML file, its method replaced by `method` if given. Raises ConfigError."""
    hint = "docs/training.md lists the keys"
    data = read_mapping(path, hint=hint) if path is not None else {}
    if method is not None:
        if data.get("method", method) != method:
            raise ConfigError(f"{path} is for {data['method']}, not {method}", hint="leave --method out, or give another file")
        data = {**data, "method": method}
    return validated(TrainConfig, data, path, hint=hint)


@dataclass(frozen=True)
class Start:
    """What a run begins with.

    Parameters
    ----------
    resume
        Go on with the run in the folder from its last whole epoch.
    init
        Checkpoint, compact ONNX model or name of a packaged one whose weights a new run begins with.
    """

    resume: bool = False
    init: Path | None = None


@dataclass(frozen=True)
class Machines:
    """Where a run computes, as Lightning understands it: devices of a machine, and machines; and on how many threads of a CPU.

    threads: default: those that torch takes. The last bits of sums depend on them.
    """

    devices: int | str = "auto"
    nodes: int = 1
    threads: int | None = None


@dataclass(frozen=True)
class Observers:
    """Who is told how a run goes.

    Parameters
    ----------
    progress
        Called after every batch, and where something else takes its time.
    draw
        Called after every epoch with the figures of all epochs by name, the best one's row, the figure that decides it, and
        whether the run ends here before its time.
    callbacks
        Lightning's.
    loggers
        What else the figures are written to, keys of `cabinpose.estimate.LOGGERS`.
    """

    progress: Progress | None = None
    draw: Draw | None = None
    callbacks: tuple[Callback, ...] = ()
    loggers: tuple[str, ...] = ()


def usable_precision(precision: Precision) -> Precision:
    """The precision that this machine trains with: 32-true, and a warning, for a mixed one on a CPU that has to emulate it.

    Lightning computes both mixed precisions in bfloat16 on a CPU. Without instructions for it each product is made of several in
    float32, and training takes about ten times as long as without it.
    """
    import torch  # noqa: PLC0415 - see above

    if precision == "32-true" or torch.cuda.is_available() or torch.backends.mps.is_available():
        return precision
    try:
        words = set(_CPU_INFO.read_text(encoding="utf-8", errors="replace").split())
    except OSError:  # another system than Linux: what its CPU has is not known, and float32 is slow nowhere
        words = set()
    if words & _BF16_FLAGS:
        return precision
    warnings.warn(
        f"precision: 32-true in place of {precision}, which takes ten times as long on a CPU without avx512_bf16 or amx_bf16",
        stacklevel=3,
    )
    return "32-true"


def with_old_keywords(
    start: Start, machines: Machines, observers: Observers, old: Mapping[str, Any]
) -> tuple[Start, Machines, Observers]:
    """The options of a run with the keywords that `fit` had in their place; each warns, and names the new one."""
    options: dict[str, Any] = {"start": start, "machines": machines, "observers": observers}
    for name, value in old.items():
        new = next((new for new, option in options.items() if name in vars(option)), None)
        if new is None:
            raise TypeError(f"fit() got an unexpected keyword argument '{name}'")
        warnings.warn(f"fit({name}=...) is fit({new}={new.title()}({name}=...)) now", DeprecationWarning, stacklevel=3)
        options[new] = replace(options[new], **{name: value})
    return options["start"], options["machines"], options["observers"]

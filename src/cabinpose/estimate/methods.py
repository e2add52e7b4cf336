"""The table of methods: what belongs to each. The parts that need torch are imported only to train or export."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from importlib import import_module
from typing import Any, Literal

from numpy.typing import NDArray
from pydantic import BaseModel, ValidationError

from cabinpose.core import ConfigError, unknown_name
from cabinpose.estimate.compact import decode as compact_decode
from cabinpose.estimate.compact.config import CompactConfig
from cabinpose.estimate.dpm.config import DpmConfig
from cabinpose.estimate.lifting import decode as lifting_decode
from cabinpose.estimate.lifting.config import LiftingConfig
from cabinpose.estimate.paf import decode as paf_decode
from cabinpose.estimate.paf.config import PafConfig
from cabinpose.estimate.unet import decode as unet_decode
from cabinpose.estimate.unet.config import UnetConfig
from cabinpose.estimate.walks.config import WalksConfig
from cabinpose.estimate.yolo import decode as yolo_decode
from cabinpose.estimate.yolo.config import YoloConfig

Arrays = Mapping[str, NDArray[Any]]


def _no_network(outputs: Arrays, settings: Any, seen: Arrays) -> Any:  # noqa: ARG001 - the signature of decoding
    raise TypeError("this method has no network whose outputs could be decoded")


@dataclass(frozen=True)
class Method:
    """A way to find joints or body parts. Its folder in this package has the name of the method.

    Parameters
    ----------
    name
        Of the method and of its folder.
    task
        "joints" (images to joints), "parts" (images to pixel classes) or "lift" (2D joints to 3D): a key of
        `estimate.tasks.TASKS`, which says what training does for it.
    config
        The settings, see `estimate.settings.Settings`.
    decode
        Of a network: decode(outputs, settings, seen) gives the task's answer from the network's outputs and from what the view
        saw (`depth`, and `amplitude` where it is an input), all numpy arrays.
    network
        Name of the network's class in the folder's `model.py`. The folder's `fit.py` has its `loss`.
    outputs
        Names of the network's outputs, in order.
    fitted
        "torch": a network, see above. "arrays": `fit.py` has fit(settings, frames, config, progress), which gives arrays by name
        from a sequence of `data.Kept`, the run's `TrainConfig` and a `training.Progress`; `find.py`, which does without torch,
        has find(arrays, settings, seen), the task's answer, and check(arrays, settings), which raises ValueError or KeyError for
        arrays that do not fit.
    measured
        Whether the folder's `measure.py` has `measured(settings, frames)`, which fills settings from the training frames.
    mirrored
        Whether `model.py` has a class `Mirrored`: a network that answers with the mean over a frame and its mirror image.
    learning_rate, weight_decay
        Of AdamW, where the configuration of a run names none.
    """

    name: str
    task: Literal["joints", "parts", "lift"]
    config: type[BaseModel]
    decode: Callable[[Arrays, Any, Arrays], Any] = _no_network
    network: str = ""
    outputs: tuple[str, ...] = ()
    fitted: Literal["torch", "arrays"] = "torch"
    measured: bool = False
    mirrored: bool = False
    learning_rate: float = 3e-3
    weight_decay: float = 0.02

    def settings(self, values: Mapping[str, Any]) -> Any:
        """The settings that plain data describes; ConfigError names what is wrong."""
        try:
            return self.config.model_validate(values)
        except ValidationError as error:
            first = error.errors()[0]
            where = ".".join(str(part) for part in first["loc"])
            known = ", ".join(self.config.model_fields)
            raise ConfigError(f"{self.name}: {where}: {first['msg']}", hint=f"settings of {self.name}: {known}") from error

    def part(self, module: str, name: str) -> Any:
        """A function or class of a module in the method's folder."""
        return getattr(import_module(f"cabinpose.estimate.{self.name}.{module}"), name)


_METHODS = (
    Method(
        "compact", "joints", CompactConfig, compact_decode.decode, "Compact",
        ("joints", "inside", "visible", "present", "spreads"), mirrored=True,
    ),
    Method(
        "paf", "joints", PafConfig, paf_decode.decode, "Paf", ("fields", "heat", "presence"), measured=True,
        learning_rate=4e-4, weight_decay=0.01,
    ),
    Method(
        "lifting", "lift", LiftingConfig, lifting_decode.decode, "Lifting", ("relative", "root"),
        learning_rate=1e-3, weight_decay=0.01,
    ),
    Method(
        "unet", "parts", UnetConfig, unet_decode.decode, "Unet", ("person", "parts"), learning_rate=1e-3, weight_decay=0.01
    ),
    Method("yolo", "joints", YoloConfig, yolo_decode.decode, "Yolo", ("boxes", "classes")),
    Method("dpm", "joints", DpmConfig, fitted="arrays"),
    Method("walks", "joints", WalksConfig, fitted="arrays"),
)  # fmt: skip
METHODS = {method.name: method for method in _METHODS}


def method_named(name: str) -> Method:
    """The method of this name; ConfigError lists the ones that exist."""
    if name not in METHODS:
        raise unknown_name("method", name, list(METHODS))
    return METHODS[name]

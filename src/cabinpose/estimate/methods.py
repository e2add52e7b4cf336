"""What a method of finding joints or body parts is made of, and the registry of those that are installed.

A method is an object with its settings, its training and what makes joints of its answers. Whatever needs torch is imported
by the functions that need it: running a trained model does without.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Hashable, Mapping, Sequence
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, ClassVar, Generic, Literal, TypeVar, get_args

from numpy.typing import NDArray
from pydantic import ValidationError

from cabinpose.core import ConfigError, ModelError, Registry, explained
from cabinpose.estimate.inputs import Kept
from cabinpose.estimate.settings import AugmentConfig, Settings

if TYPE_CHECKING:
    from torch import Tensor, nn


Arrays = Mapping[str, NDArray[Any]]
"""Arrays by name."""
Layout = Mapping[str, Mapping[int, Sequence[Hashable]]]
"""By the name of a network's tensor and its axis, what each row stands for: tuples of names and numbers, a joint of a place."""
Progress = Callable[[int, int, str], None]
"""Called with batches done, batches in all (0 before they are known), and in words the epoch and its figures or what is done."""
ARRAYS_SUFFIX = ".npz"  # of models of an `ArrayMethod`
S = TypeVar("S", bound=Settings)
TaskName = Literal["joints", "parts", "lift"]


class Method(ABC, Generic[S]):
    """A way to find joints or body parts: subclass `NetworkMethod` or `ArrayMethod`, and register an instance.

    Attributes
    ----------
    name
        By which it is registered in the entry point group `cabinpose.methods`, and by which a trained model says what it is.
    task
        What it does, a key of `estimate.tasks.TASKS`. "joints": images to joints; its answer is a `Found`. "parts": images to
        classes of pixels; its answer is (N, h, w) uint8, 0 = nobody, else 1 + the position of the part in the settings' `parts`.
        "lift": 2D joints of one person to 3D; its answer is (N, J, 3) m in the camera frame, NaN = no answer.
    settings_type
        Its settings, all with defaults. For "parts" they also have `parts`, the `Part`s that it tells apart; for "lift" `noise`
        and `drop`, by which training disturbs 2D joints, and `presence`, the least of a 2D joint that is lifted.
    room
        Settings with which `experiment compare` trains it to find ITOP's joints of one person in a room, beside those that it
        gives to every method that has them (see `app/compare.py`).
    learning_rate, weight_decay
        Of the optimiser, where the configuration of a run names none.
    """

    name: ClassVar[str]
    task: ClassVar[TaskName]
    settings_type: type[S]
    room: ClassVar[Mapping[str, Any]] = MappingProxyType({})
    learning_rate: ClassVar[float] = 3e-3
    weight_decay: ClassVar[float] = 0.02

    def __init_subclass__(cls) -> None:
        if cls.__dict__.get("task", "joints") not in get_args(TaskName):
            raise TypeError(f"the task of {cls.__name__} is none of {', '.join(get_args(TaskName))}")

    def settings(self, values: Mapping[str, Any]) -> S:
        """The settings that plain data describes; ConfigError names what is wrong."""
        try:
            return self.settings_type.model_validate(values)
        except ValidationError as error:
            known = f"settings of {self.name}: {', '.join(self.settings_type.model_fields)}"
            raise explained(error, self.settings_type, values, at=f"{self.name}: ", lists=known) from error

    def measured(self, settings: S, some: Callable[[], Sequence[Kept]]) -> S:  # noqa: ARG002 - most measure nothing
        """The settings with what they leave open measured on training frames; `some` reads at most 500 of them."""
        return settings


class NetworkMethod(Method[S]):
    """A method whose network is trained by `cabinpose train` and runs as an ONNX file without torch.

    Attributes
    ----------
    outputs
        Names of the fields of what the network returns that are exported, in their order. The network may return more, for its
        loss.
    reads_onnx
        Whether training may begin with an exported model, see `estimate.weights`: each layer keeps its name in the file.
    precise
        Layers of the network that stay in float32 where an export is in eight bits.
    of_places
        Whether the network answers for the places one by one, so that its weights are for those places in that order.
    channels_last
        Whether it is trained with the channels of a pixel side by side in memory: what is faster was measured by method.
    """

    outputs: ClassVar[tuple[str, ...]]
    reads_onnx: ClassVar[bool] = False
    precise: ClassVar[tuple[str, ...]] = ()
    of_places: ClassVar[bool] = True
    channels_last: ClassVar[bool] = False

    @abstractmethod
    def network(self, settings: S) -> nn.Module:
        """A network with fresh weights. Import torch here.

        It is called with a tensor for each of the settings' `inputs`, in their order: "depth" (N, h, w) m, 0 = invalid, and
        "amplitude" (N, h, w) in the settings' view; "pose" (N, J, 3) x/z, y/z and 1 where the joint is given, for "lift". It
        returns a NamedTuple of tensors.
        """

    @abstractmethod
    def loss(self, network: Any, batch: Any) -> dict[str, Tensor]:
        """The terms of the training loss by name and, as "loss", what is minimised: scalars, means over the batch.

        batch: an `estimate.batch.Batch`; for "lift" an `estimate.tasks.PeopleBatch`.
        """

    @abstractmethod
    def decode(self, outputs: Arrays, settings: S, seen: Arrays) -> Any:
        """The task's answer for N frames, from the network's outputs and from what the view saw (the inputs, and the amplitude
        where there is one) by name. Without torch: numpy alone.
        """

    def layout(self, settings: S) -> Layout:  # noqa: ARG002 - {} of a method that does not say it
        """Which rows of which tensors are of single places, joints, limbs, or cells of the view.

        Training that begins with another network of the method takes these rows by what they stand for, and all else as it is.
        Of a method that does not say it, places and joints have to be the same.
        """
        return {}

    def mirrored(self, network: Any) -> nn.Module:  # noqa: ARG002 - few have one
        """A network that answers with the mean over a frame and its mirror image. Raises ConfigError where there is none."""
        raise ConfigError(f"{self.name} has no mirrored form", hint="leave --mirrored out")


class ArrayMethod(Method[S]):
    """A method without a network: it is fitted in one go, and its model is an .npz file of arrays. Nothing of it needs torch."""

    @abstractmethod
    def fit(
        self, settings: S, frames: Sequence[Kept], augment: AugmentConfig, progress: Progress, *, seed: int
    ) -> dict[str, NDArray[Any]]:
        """The arrays of a model by name, from training frames in the settings' view; the same frames and seed give the same bits.

        Parameters
        ----------
        settings
            With everything measured.
        frames
            To learn from.
        augment
            How the run asks for frames to be varied; a method uses what it can.
        progress
            Called with steps done, steps in all, and what is being done.
        seed
            Of all randomness.
        """

    @abstractmethod
    def find(self, arrays: Arrays, settings: S, seen: Arrays) -> Any:
        """The task's answer for N frames, from the model's arrays and what the view saw: depth (N, h, w) m, 0 = invalid, and
        amplitude where the settings' `inputs` have it.
        """

    @abstractmethod
    def check(self, arrays: Arrays, settings: S) -> None:
        """Raises ValueError or KeyError for arrays that `find` cannot use: a file may hold anything."""


METHODS: Registry[Method[Any]] = Registry("cabinpose.methods", "method", Method, named=True)
"""The methods by name, those of extensions too: `METHODS.names()` imports none, `METHODS["compact"]` that one."""


def method_of(path: Path, name: str) -> Method[Any]:
    """The method that the file of a trained model names. Raises ModelError where nothing installed offers it."""
    if name not in METHODS:
        raise ModelError(
            f"{path} is a model of the method '{name}', which is not installed",
            hint=f"install the package that offers it; installed: {', '.join(METHODS.names())}",
        )
    return METHODS[name]

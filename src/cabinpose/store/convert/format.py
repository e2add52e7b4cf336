"""What a format of other tools is: an object that reads files, writes them or both, and the options of either.

A format is an instance of one of the classes here, registered as an entry point of the group `cabinpose.formats`. It reads where
its class has a method `read`, and writes where it has `write`. The options of reading and of writing are dataclasses: fields are
flags of `cabinpose import` and `export` and keywords in Python, and the text below a field is its help.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, Literal, NamedTuple, TypeVar

from cabinpose.core import ConfigError, Registry

if TYPE_CHECKING:
    import xarray as xr

    from cabinpose.signals import Sample
    from cabinpose.store.convert.rows import Entry
    from cabinpose.store.source import Report, Source
    from cabinpose.store.split import Splits

O = TypeVar("O")
F = TypeVar("F", bound="Format")
Method = Literal["read", "write"]


@dataclass(frozen=True, kw_only=True)
class NoOptions:
    """None."""


@dataclass(frozen=True, kw_only=True)
class ImportOptions:
    """How any dataset is read."""

    intrinsics: tuple[float, float, float, float] | None = None
    """fx fy cx cy of the camera in px, in place of those of the source."""
    camera: Path | None = None
    """The same as a file: a calibration of OpenCV, ROS, Open3D or RealSense, or fx, fy, cx, cy by name, with distortion."""
    fov_deg: float | None = None
    """The same as a horizontal field of view, of a lens that is centred and does not distort."""
    licence: str | None = None
    """Licence of the data; default: that of the source."""

    def __post_init__(self) -> None:
        flags = ("--intrinsics", self.intrinsics), ("--camera", self.camera), ("--fov-deg", self.fov_deg)
        if len(told := [flag for flag, value in flags if value is not None]) > 1:
            raise ConfigError(f"{' and '.join(told)} say the same", hint="give one of them")
        if self.fov_deg is not None and not 0 < self.fov_deg < 180:
            raise ConfigError(f"no field of view: {self.fov_deg}", hint="give degrees between 0 and 180, from edge to edge")
        given = self.intrinsics
        if given is not None and not (all(map(math.isfinite, given)) and given[0] > 0 and given[1] > 0):
            raise ConfigError(f"no intrinsics: {given}", hint="give fx, fy, cx and cy in px, fx and fy above 0")


class Format:
    """A format; the first line of its docstring is what `--help` says of it. heading: of the list that it stands in."""

    heading: ClassVar[str]
    import_options: ClassVar[type[Any]] = NoOptions
    export_options: ClassVar[type[Any]] = NoOptions

    def can(self, method: Method) -> bool:
        """Whether the format reads, or writes: has a method that is not of this module."""
        return any(method in vars(kind) for kind in type(self).__mro__ if kind.__module__ != __name__)

    def options(self, method: Method) -> type[Any]:
        """The dataclass of what may be said of reading, or of writing."""
        return self.import_options if method == "read" else self.export_options


class DatasetFormat(Format):
    """A format of datasets.

    `tells_splits`: it writes the splits of a dataset apart.
    """

    heading = "datasets"
    import_options = ImportOptions
    tells_splits: ClassVar[bool] = False

    def read(self, path: Path, options: Any, /) -> Source:
        """The dataset in a file or folder, which is there; no image is read yet.

        Raises
        ------
        DatasetError
            For a source that lacks what the format has, or contradicts itself.
        """
        raise NotImplementedError

    def parts(self, dataset: xr.Dataset, splits: Splits) -> dict[str, xr.Dataset]:
        """The frames that are written, by the name of their split; "" is all of them, where there are no splits.

        Raises
        ------
        ConfigError
            Where the format tells no splits apart, and for the name of a split that is no name of a folder.
        DatasetError
            Where a split is empty.
        """
        from cabinpose.store.split import split_dataset  # noqa: PLC0415 - xarray, for those who write

        if not splits:
            return {"": dataset}
        if not self.tells_splits:
            raise ConfigError("the format tells no splits apart", hint="export them one by one")
        for split in splits:
            if not re.fullmatch(r"\w[\w.-]*", split):
                raise ConfigError(f"the split '{split}' cannot name a folder", hint="name it by letters, digits, _ and -")
        return split_dataset(dataset, splits)

    def write(self, parts: Mapping[str, xr.Dataset], folder: Path, options: Any, report: Report, /) -> None:
        """Write the frames that `parts` gave into `folder`, which is empty; `report` is called with the number of frames done.

        Raises
        ------
        DatasetError
            Where the format cannot hold the dataset.
        """
        raise NotImplementedError


class RecordingFormat(Format):
    """A format of recordings."""

    heading = "recordings"

    def read(self, path: Path, options: Any, subjects: Sequence[str], /) -> Iterator[Entry]:
        """What a file holds, each entry with the name of its source; subjects: codes of the take's people, in the file's order.

        Raises
        ------
        RecordingError, MocapError
            Where the file cannot be read to its end.
        DependencyError
            Where a package is missing.
        """
        raise NotImplementedError

    def topics(self, _options: Any, /) -> tuple[str, ...]:
        """Topics of which a source has to have one to be written; clocks of devices differ, so there may be only one such source.

        None: any number of any sources.
        """
        return ()

    def write(self, out: Path, samples: Iterable[tuple[str, Sample]], options: Any, /, *, overwrite: bool) -> list[Path]:
        """Write samples with the names of their sources, and give the files, each of which appears when it is whole.

        Raises
        ------
        RecordingError, MocapError
            Where the recording lacks what the format needs or has more than it can hold, and where `out` is there already.
        """
        raise NotImplementedError


class Keypoints(NamedTuple):
    """Somebody in an image of a file of labels.

    image: name of its file · size: (width, height) px · slot: as our exports tell it, None where the file does not ·
    joints: those labelled or told absent, by our names: u, v px and COCO's visibility.
    """

    image: str
    size: tuple[int, int]
    slot: str | None
    joints: dict[str, tuple[float, float, int]]


class LabelFormat(Format):
    """A format of joints that were corrected in another tool."""

    heading = "labels of a dataset"

    def read(self, path: Path, options: Any, /) -> list[Keypoints]:
        """Everybody in a file. Raises DatasetError for a file that cannot be read."""
        raise NotImplementedError


class ModelFormat(Format):
    """A format of trained models."""

    heading = "models"

    def write(self, checkpoint: Path, out: Path, options: Any, /, *, overwrite: bool) -> float:
        """Write a checkpoint of `cabinpose train`, and give the greatest difference of the answers from torch's.

        Raises
        ------
        ModelError
            Where `out` exists, the checkpoint cannot be read or the two differ too much.
        """
        raise NotImplementedError


FORMATS: Registry[Format] = Registry("cabinpose.formats", "format", Format)


def format_of(name: str, kind: type[F], method: Method) -> F:
    """The format of this name. Raises ConfigError for one of another kind or without the ability, which lists those that do."""
    form = FORMATS[name]
    if isinstance(form, kind) and form.can(method):
        return form
    able = (other for other, each in FORMATS.items() if isinstance(each, kind) and each.can(method))
    raise ConfigError(f"the format '{name}' {method}s no {kind.heading}", hint=f"those that do: {', '.join(able)}")


def made_options(name: str, options: type[O], given: Mapping[str, object]) -> O:
    """The options of a format from values by name. Raises ConfigError for a value that the format has no use for."""
    known = [field.name for field in fields(options)]  # type: ignore[arg-type]  # options are dataclasses
    for other in given:
        if other not in known:
            raise ConfigError(f"{name} has no option '{other}'", hint=f"it has: {', '.join(known) or 'none'}")
    return options(**given)

"""Arguments that several verbs have, and checks of them."""

from __future__ import annotations

import sys
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Optional, TypeVar, Union

from tyro.conf import Positional, arg, subcommand
from tyro.constructors import ConstructorRegistry, PrimitiveConstructorSpec, PrimitiveTypeInfo

from cabinpose.app.api import SAMPLE
from cabinpose.core import ConfigError, DatasetError, DriveSide, Visibility

if TYPE_CHECKING:
    from cabinpose.estimate import Smoother


def several(metavar: str) -> Any:
    """Metavar of an argument that is optional or takes any number of words; its help shows no empty default."""
    return arg(metavar=metavar, help_behavior_hint="")


def one_of(**commands: type) -> Any:
    """`COMMAND` of a verb with verbs of its own, such as `cabinpose config init`."""
    return Union[tuple(Annotated[command, subcommand(name)] for name, command in commands.items())]  # noqa: UP007


# Optional[T] and not T | None: for the latter tyro imports typeguard, which takes as long as tyro itself.
T = TypeVar("T")
Maybe = Annotated[Optional[T], arg(help_behavior_hint="")]  # a flag without a value as default; its help states what happens


def dataset_path(word: str) -> Path:
    """A path, or `sample`: the dataset of the package, where nothing here has that name."""
    path = Path(word)
    return SAMPLE if word == "sample" and not path.exists() else path


DatasetPath = Annotated[
    Path,
    PrimitiveConstructorSpec(
        nargs=1, metavar="PATH", instance_from_str=lambda words: dataset_path(words[0]),
        is_instance=lambda value: isinstance(value, Path),
        str_from_instance=lambda path: [str(path)],
    ),
]  # fmt: skip
ThingArgument = Annotated[Positional[DatasetPath], arg(metavar="DATASET|RECORDING")]
DatasetArgument = Annotated[Positional[DatasetPath], arg(metavar="DATASET", help="Folder of the dataset, or `sample`.")]


READS = ConstructorRegistry()  # how words of the command line become types of ours


@READS.primitive_rule
def _visibility(info: PrimitiveTypeInfo) -> PrimitiveConstructorSpec[Visibility] | None:
    """A state of a joint that is there, by its name in small letters."""
    if info.type is not Visibility:
        return None
    states = {state.name.lower(): state for state in Visibility if state != Visibility.ABSENT}
    return PrimitiveConstructorSpec(
        nargs=1, metavar=f"{{{','.join(states)}}}", choices=tuple(states), instance_from_str=lambda words: states[words[0]],
        is_instance=lambda value: isinstance(value, Visibility), str_from_instance=lambda state: [state.name.lower()],
    )  # fmt: skip


@dataclass(frozen=True, kw_only=True)
class PrintsJson:
    """The flag of every verb that prints results."""

    as_json: Annotated[bool, arg(name="json")] = False
    """Print one JSON object on stdout."""


@dataclass(frozen=True, kw_only=True)
class RunsModels(PrintsJson):
    """The flag of the verbs that run detectors in cars."""

    drive_side: Maybe[DriveSide] = None
    """Side of the wheel, for models that tell seats by place (paf, dpm, walks); default: as the dataset or the model's file
    says."""


@dataclass(frozen=True, kw_only=True)
class Smooths(PrintsJson):
    """Flags of the verbs that smooth joints over time."""

    smooth: Maybe[str] = None
    """Smooth joints over the frames of each sequence: one-euro answers at once, fixed-lag some frames later."""
    lag: Maybe[int] = None
    """Frames by which fixed-lag answers later, from 1 to 30; default: 3."""

    def smoothers(self, count: int) -> list[Smoother]:
        """One for each of a number of detectors; none where nothing is smoothed. Raises ConfigError, see `make_smoother`."""
        from cabinpose.estimate import make_smoother

        if self.smooth is None:
            if self.lag is not None:
                raise ConfigError("--lag says nothing without --smooth", hint="give --smooth fixed-lag as well")
            return []
        return [make_smoother(self.smooth, self.lag) for _ in range(count)]


def tell_unsmoothed(smoothers: Sequence[Smoother]) -> None:
    """Say on stderr that no frame followed another, where that is so of some that were given to smoothers."""
    if smoothers and not any(smoother.followed for smoother in smoothers):
        from cabinpose.estimate import LONGEST_GAP_S

        gap = f"of one sequence, and at most {LONGEST_GAP_S:g} s later"
        print(f"nothing was smoothed: no frame follows another ({gap})", file=sys.stderr)


@dataclass(frozen=True, kw_only=True)
class SelectsFrames(PrintsJson):
    """Flags of the verbs that work on some frames of a dataset."""

    splits: Annotated[Maybe[Path], arg(metavar="FILE")] = None
    """YAML file of splits; --split names one of them."""
    split: Annotated[Maybe[str], arg(metavar="NAME")] = None
    """Only the frames of this split."""
    select: Annotated[tuple[str, ...], several("NAME=VALUE[,VALUE] ...")] = ()
    """Only frames with these values of subject, action, car, pov or sequence, or of their folds (subject/5=1)."""
    where: Annotated[Maybe[str], arg(metavar="CONDITION")] = None
    """Only frames for which this holds: 'car == "suv" and people > 1 and not action == "sleep"'."""


def renamed(words: Sequence[str], old: Mapping[str, tuple[str, Callable[[str], str]]]) -> list[str]:
    """The words behind a verb with flags of the last release by their new names, each with a warning.

    old: by an old flag its new name, and what makes a value for it of an old one.
    """
    result: list[str] = []
    turn: Callable[[str], str] = str  # what the values of the last flag become
    for word in words:
        flag, given, value = word.partition("=")
        if flag.startswith("--"):
            new, turn = old.get(flag, (flag, str))
            if new != flag:
                warnings.warn(f"{flag} is called {new} now", stacklevel=2)
            result.append(f"{new}={turn(value)}" if given else new)
        else:
            result.append(turn(word))
    return result


def placed(words: Sequence[str], flag: str) -> list[str]:
    """The words behind a verb with the value of a flag before all others, where it stands since it is what the verb is about."""
    for number, word in enumerate(words):
        name, given, value = word.partition("=")
        if name == flag and (given or number + 1 < len(words)):
            value, after = (value, number + 1) if given else (words[number + 1], number + 2)
            return [value, *words[:number], *words[after:]]
    return list(words)


def metres(centimetres: str) -> str:
    """A number of cm in m; what is no number as it is."""
    try:
        return repr(float(centimetres) / 100)
    except ValueError:
        return centimetres


def workers_of(workers: int | None, scheduler: str | None, local: str) -> int | str | None:
    """Who works: the scheduler's address, or how many `local` workers; ConfigError where both are given."""
    if workers is not None and scheduler is not None:
        raise ConfigError(
            f"--workers are {local}, --scheduler is a cluster elsewhere", hint="give one of --workers and --scheduler"
        )
    return workers if scheduler is None else scheduler


def refuse(flags: Mapping[str, object], message: str) -> None:
    """ConfigError for the first flag that was given; `{}` in the message is its name."""
    for flag, value in flags.items():
        if value not in (None, False, ()):
            raise ConfigError(message.format(flag), hint=f"leave out {flag}")


def refuse_selection(command: SelectsFrames, message: str) -> None:
    """ConfigError for the first flag that selects frames of a dataset."""
    refuse({f"--{flag}": getattr(command, flag) for flag in ("splits", "split", "select", "where")}, message)


def refuse_existing(folder: Path | None, *names: str, overwrite: bool) -> None:
    """DatasetError where one of these files is in the folder already and may not be replaced."""
    there = [name for name in names if folder is not None and (folder / name).exists()]
    if there and not overwrite:
        raise DatasetError(f"{folder} already has {' and '.join(there)}", hint="--overwrite replaces them")


def recording_name(flag: str, out: Path) -> None:
    """ConfigError for a name by which nothing knows a recording again: not to read it, and not to erase whom it shows."""
    if out.suffix != ".mcap":
        raise ConfigError(f"{out} is no name of a recording", hint=f"{flag} FILE.mcap")


def refuse_inputs(flag: str, out: Path | None, *inputs: Path) -> None:
    """ConfigError where a file to write is one that the command reads, which it would replace; of a take, any of its files."""
    read = (file for path in inputs for file in _files_of(path) if file.exists())
    if out is not None and out.exists() and any(out.samefile(file) for file in read):
        raise ConfigError(f"{out} is what is read, and would be lost", hint=f"give another file with {flag}")


def _files_of(path: Path) -> Iterator[Path]:
    """A file that a command reads; of a recording with what goes on from it, of a folder with the recordings in it."""
    yield path
    if path.is_dir():
        yield from path.glob("*.mcap")
    elif path.suffix == ".mcap":
        from cabinpose.store.recording import parts_beside

        yield from parts_beside(path).values()


@contextmanager
def no_empty_folder(folder: Path) -> Iterator[None]:
    """A folder that is made within the block and is empty at an error goes."""
    made = not folder.exists()
    try:
        yield
    except BaseException:
        if made and folder.is_dir() and not any(folder.iterdir()):
            folder.rmdir()
        raise


def is_recording(path: Path) -> bool:
    """Whether a path is a recording, one that `recover` left unfinished or a folder of takes among them.

    Raises ConfigError for a file that is neither a recording nor a dataset.
    """
    if path.is_dir():
        return not (path / "dataset.yaml").exists() and any(path.glob("*.mcap"))
    if path.exists() and ".mcap" not in path.suffixes:
        raise ConfigError(
            f"{path} is neither a dataset nor a recording",
            hint="give the folder that holds dataset.yaml, or a recording (.mcap)",
        )
    return ".mcap" in path.suffixes

"""Arguments that several commands have."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Optional, TypeVar

from tyro.conf import Positional, arg

from cabinpose.core.errors import ConfigError

if TYPE_CHECKING:
    from cabinpose.app.cli.commands import Info, View
    from cabinpose.app.cli.exchange_commands import Export


def several(metavar: str) -> object:
    """How what may be left out, or takes any number of words, shows in the help: without an empty default behind it."""
    return arg(metavar=metavar, help_behavior_hint="")


T = TypeVar("T")
Maybe = Annotated[Optional[T], arg(help_behavior_hint="")]  # a flag that may be left out; its help says what then
ThingArgument = Annotated[Positional[Path], arg(metavar="DATASET|RECORDING")]
RecordingArgument = Annotated[Positional[Path], arg(metavar="RECORDING")]
DatasetArgument = Annotated[Positional[Path], arg(metavar="DATASET", help="Folder of the dataset.")]
SplitsFlag = Annotated[Maybe[Path], arg(metavar="FILE", help="YAML file of splits, of which --split names one.")]
SplitFlag = Annotated[Maybe[str], arg(metavar="NAME", help="Only the frames of this split.")]
SelectFlag = Annotated[
    tuple[str, ...],
    arg(
        metavar="NAME=VALUE[,VALUE] ...",
        help="Only frames with these values of subject, action, car, pov or sequence.",
        help_behavior_hint="",
    ),
]
JsonFlag = Annotated[bool, arg(name="json", help="Print one JSON object on stdout.")]


def refuse(flags: Mapping[str, object], message: str) -> None:
    """ConfigError for the first flag that was given; `{}` in the message is its name."""
    for flag, value in flags.items():
        if value not in (None, False, ()):
            raise ConfigError(message.format(flag), hint=f"leave out {flag}")


def refuse_selection(command: Info | View | Export, message: str) -> None:
    """ConfigError for the first of the flags that choose frames of a dataset."""
    refuse({"--splits": command.splits, "--split": command.split, "--select": command.select}, message)


def is_recording(path: Path) -> bool:
    """Whether a DATASET|RECORDING is a recording, one that a recovery left or a folder of takes among them; ConfigError for a
    file that is neither.
    """
    if path.is_dir():
        return not (path / "dataset.yaml").exists() and any(path.glob("*.mcap"))
    if ".mcap" in path.suffixes:
        return True
    if path.exists():
        raise ConfigError(
            f"{path} is neither a dataset nor a recording",
            hint="give the folder that holds dataset.yaml, or a recording (.mcap)",
        )
    return False

"""What can be typed about recordings; see `commands`."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

from tyro.conf import Positional, arg

from cabinpose.app.cli.arguments import JsonFlag, Maybe, RecordingArgument


@dataclass(frozen=True)
class Record:
    """Record what the devices of a rig say into one file (MCAP), until Ctrl-C.

    Nothing connects or listens beyond what the rig names. A device that goes away is reached again; what is lost is counted.
    """

    config: Path
    """The rig (YAML): its sources, how to write, and the take."""
    out: Maybe[Path] = None
    """Recording to write (.mcap)."""
    take: Maybe[Path] = None
    """YAML file of the take (subjects, action, car), in place of the rig's."""
    check: bool = False
    """Say what is missing, of the disk and of each source, and record nothing."""
    duration: Maybe[float] = None
    """Stop after so many seconds."""
    split_every: Annotated[Maybe[str], arg(metavar="10min|2GB")] = None
    """Go on in a new file after so long (s, min, h) or so much (MB, GB): FILE.mcap, FILE-001.mcap; in place of the rig's."""
    as_json: JsonFlag = False


@dataclass(frozen=True)
class Recover:
    """Make a whole recording of one that a crash cut short, or that is damaged."""

    recording: RecordingArgument
    """The recording as it is; it stays so."""
    out: Path
    """Recording to write."""
    as_json: JsonFlag = False


@dataclass(frozen=True)
class Forget:
    """Erase the takes of a subject, at their request: list them, and with --confirm delete them."""

    folder: Annotated[Positional[Path], arg(metavar="FOLDER")]
    """Folder of recordings, and the folders within."""
    subject: str
    """Subject code."""
    confirm: bool = False
    """Delete; without it nothing is."""
    shared: bool = False
    """Delete also the takes in which others were recorded beside the subject."""
    as_json: JsonFlag = False


@dataclass(frozen=True)
class EmulateStepper:
    """Play the controller of a stepper motor (GRBL or Marlin) on a pseudo-terminal, whose name it prints. Ctrl-C ends it."""

    dialect: Literal["grbl", "marlin"] = "grbl"
    """What it speaks."""
    link: Maybe[Path] = None
    """Name that leads to the pseudo-terminal, for a rig's `port`."""
    backlash: float = 0.0
    """Degrees by which the shaft stays behind where the motor turns back."""
    miss_every: int = 0
    """Every so many moves the motor misses steps; 0: never."""
    miss: float = 0.9
    """Degrees that it misses then."""
    fault: Literal["none", "error", "alarm", "hang", "drop", "garbage"] = "none"
    """What goes wrong: a refusal, an alarm, silence, the line, or what comes over it."""
    fault_at: int = 1
    """At which move; 0: from the start."""
    seconds: Maybe[float] = None
    """How long; default: until Ctrl-C."""
    as_json: JsonFlag = False

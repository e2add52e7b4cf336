"""What can be typed to bring the sources of recordings into one time and space; see `commands`."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from tyro.conf import Positional, arg

from cabinpose.app.cli.arguments import JsonFlag, Maybe, several


@dataclass(frozen=True)
class Calibrate:
    """Find where a rig's camera stands, when its stamps are late, and how the suit's head sits in the optical system's.

    From recordings of a checkerboard with markers, of a swinging marker, and of each subject's turning head.
    """

    session: Annotated[Positional[Path], arg(metavar="SESSION")]
    """YAML file that names the recordings and the board."""
    out: Path
    """Calibration to write (YAML)."""
    overwrite: bool = False
    """Replace the calibration that is there."""
    as_json: JsonFlag = False


@dataclass(frozen=True)
class Align:
    """Make a dataset of recordings of suit, optical system and camera: the suit's pose in every frame of the camera.

    Frames in which the pose is not known are left out, counted by reason; nothing is interpolated across gaps.
    """

    recordings: Annotated[Positional[tuple[Path, ...]], several("RECORDING [RECORDING ...]")]
    """Recordings of the rig; everybody whom a take names wears a suit of their own."""
    calibration: Path
    """Calibration of the rig (YAML), made by `cabinpose calibrate`."""
    out: Path
    """Folder of the dataset."""
    report: Maybe[Path] = None
    """HTML file to write: how well suit and optical system agree on the head over each take, with its best and worst frame."""
    subject: Maybe[str] = None
    """Subject code, where a take does not name it, or where only one of its people wears a suit."""
    pose_correction: bool = True
    """Correct what the suit's own calibration got wrong, where the rig's calibration knows it."""
    max_lag: float = 2.0
    """Greatest delay between suit and optical system that is looked for, s."""
    licence: str = "private"
    """Licence of the dataset; recordings of people are personal data."""
    overwrite: bool = False
    """Replace the dataset that is there."""
    as_json: JsonFlag = False


@dataclass(frozen=True)
class Lab:
    """Record a session in a virtual laboratory: suit, optical system and ToF camera, with real ones' errors, and the truth.

    Writes calibration takes, a take of a driver, the files that `calibrate` and `align` need, and what is true of them all.
    """

    out: Path
    """Folder of the session; it has to be new or empty."""
    rig: Maybe[Path] = None
    """Rig of the laboratory (YAML): camera, clocks, errors; default: one with the errors of a real one."""
    only: Maybe[str] = None
    """One error of the rig alone, all others off; `exact`: none at all."""
    seconds: float = 20.0
    """Length of the driver's take."""
    rate: Maybe[float] = None
    """Frames per second of the camera in it; default: the rig's."""
    views: int = 50
    """Poses of the checkerboard."""
    car: str = "sedan"
    """A preset car."""
    subjects: tuple[str, ...] = ("S01",)
    """Of the package's people, one after the other."""
    together: bool = False
    """Record the first two of them in one car as well, driver and front passenger, each in a suit of their own."""
    exercises: bool = True
    """Record movements in each anatomical plane outside the car as well, for `evaluate-mocap`."""
    seed: int = 0
    """Seed of everything that is drawn."""
    as_json: JsonFlag = False

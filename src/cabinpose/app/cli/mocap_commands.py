"""The options of `cabinpose evaluate-mocap`; see `commands`."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

from tyro.conf import Positional, subcommand

from cabinpose.app.cli.arguments import JsonFlag, Maybe, several


@dataclass(frozen=True)
class MocapReport:
    """Options of all four evaluations on their report."""

    out: Maybe[Path] = None
    """Folder for the page (index.html) and its numbers (report.json)."""
    resamples: int = 1000
    """Resamples of the bootstrap; 0: no intervals."""
    block_s: Maybe[float] = None
    """Seconds of a block of the bootstrap; default: from the correlation time of the errors."""
    seed: int = 0
    """Seed of the bootstrap."""
    overwrite: bool = False
    """Replace the page that is in the folder."""
    as_json: JsonFlag = False


@dataclass(frozen=True)
class EvaluateSse(MocapReport):
    """One sensor, turned in known steps about each of its axes: the error about the axis, mean and deviation."""

    takes: Annotated[Positional[tuple[str, ...]], several("AXIS=FILE")] = ()
    """roll=FILE, pitch=FILE, yaw=FILE: recordings (.mcap) or MVNX files, one axis each."""
    sensor: Maybe[str] = None
    """Name of the sensor (or segment); default: the only one."""
    source: Maybe[str] = None
    """Source of the sensor in a recording."""
    step_deg: float = 11.25
    """Degrees that the motor turns at a step."""
    steps: int = 33
    """How many times the sensor stands still: 33 for a full turn of 32 steps, with the place where it began."""
    samples: int = 300
    """Samples taken at each step, from its middle; 0: all."""
    still_deg_s: float = 1.5
    """Degrees a second under which the sensor stands still."""
    still_s: float = 0.5
    """Seconds that it does so at least."""
    motor: Maybe[str] = None
    """SOURCE/CHANNEL that recorded the motor's angle in degrees; default: a source of kind stepper, else steps by stillness."""


@dataclass(frozen=True)
class EvaluateSfe(MocapReport):
    """The whole body: the first N-pose against the last, before and after a drive, joints relative to the pelvis."""

    takes: Annotated[Positional[tuple[str, ...]], several("[DRIVE=]FILE")] = ()
    """Recordings (.mcap), MVNX, BVH or C3D files, one a drive."""
    source: Maybe[str] = None
    """Source of the suit in a recording; default: suit where there is one, else the only one that gives a body."""
    subject: Maybe[str] = None
    """Subject code; default: the only one."""
    first: Maybe[tuple[float, float]] = None
    """Seconds from and to, of the first pose; default: where the person stands still in an N-pose for the first time."""
    last: Maybe[tuple[float, float]] = None
    """Seconds from and to, of the last pose; default: the last time."""
    still_m_s: float = 0.05
    """Metres a second under which every segment stands still."""
    any_pose: bool = False
    """Take whatever pose the person is still in, not only an N-pose."""
    fit: Literal["pelvis", "body"] = "pelvis"
    """Lay the poses on each other by the pelvis, or by all joints (markers have no pelvis)."""
    pelvis: str = "Pelvis"
    """Name of the pelvis segment."""


@dataclass(frozen=True)
class AgainstOptical(MocapReport):
    """Options of both evaluations against an optical system."""

    takes: Annotated[Positional[tuple[str, ...]], several("[PLANE=]TAKE")] = ()
    """Recordings (.mcap) of both systems, or SUIT.c3d,OPTICAL.c3d, two files of one trigger; default label: the take's action."""
    suit: str = "suit"
    """Source of the suit."""
    optical: str = "optical"
    """Source of the optical system."""
    subject: Maybe[str] = None
    """Subject code in the suit's stream; default: the only one."""
    optical_subject: Maybe[str] = None
    """Subject in the optical system's stream; default: the suit's, if it has it, else the only one."""
    windows: Annotated[tuple[str, ...], several("[WINDOW [WINDOW ...]]")] = ()
    """PLANE=START:END in seconds of the take, to tell planes of motion in one recording apart."""
    pairs: Annotated[tuple[str, ...], several("[PAIR [PAIR ...]]")] = ()
    """NAME=SEGMENT of the optical system, where its model names something differently."""
    rate: Maybe[float] = None
    """Samples a second of the common clock; default: the slower system's."""
    max_gap_s: float = 0.1
    """Longest pause of a stream that is interpolated over."""
    delay_ms: Maybe[float] = None
    """By how much the suit's stamps are late; default: from how both see the segments turn, in two files 0."""


@dataclass(frozen=True)
class EvaluateDse(AgainstOptical):
    """Segments' turns since the first frame, suit against optical system, in up to 17 pairs, by plane of motion."""

    sensors: bool = False
    """Take the orientations of the suit's sensors, not of its segments."""
    heading_deg: Maybe[float] = None
    """Heading of the optical world seen from the suit's; default: fitted."""


@dataclass(frozen=True)
class EvaluateDfe(AgainstOptical):
    """Joints' positions, suit against optical system, in up to 20 pairs: raw, laid on each other by pelvis, by pelvis and ICP."""


@dataclass(frozen=True)
class EvaluateMocap:
    """Judge the ground truth of a motion capture suit: the thesis' four evaluations, with intervals and a page each."""

    evaluation: (
        Annotated[EvaluateSse, subcommand("sse")]
        | Annotated[EvaluateSfe, subcommand("sfe")]
        | Annotated[EvaluateDse, subcommand("dse")]
        | Annotated[EvaluateDfe, subcommand("dfe")]
    )

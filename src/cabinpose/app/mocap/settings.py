"""How a suit is held against an optical system: what the comparison needs, and the command line takes."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

from tyro.conf import Positional

from cabinpose.app.cli.arguments import Maybe, several


@dataclass(frozen=True, kw_only=True)
class OpticalSettings:
    """Of both evaluations against an optical system."""

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
    """Longest gap of a stream that is interpolated, s."""
    delay_ms: Maybe[float] = None
    """Delay of the suit's time stamps relative to the optical system's, ms; default: estimated from rotations, in two files 0."""


@dataclass(frozen=True, kw_only=True)
class RotationSettings(OpticalSettings):
    """Of the evaluation of rotations."""

    sensors: bool = False
    """Use the orientations of the suit's sensors, not of its segments."""
    heading_deg: Maybe[float] = None
    """Heading of the optical system's world relative to the suit's, degrees; default: fitted."""

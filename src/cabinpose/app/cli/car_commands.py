"""`cabinpose car`: a user's own car mesh, described and checked."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from tyro.conf import Positional, arg, subcommand

from cabinpose.app.cli.arguments import JsonFlag, Maybe


@dataclass(frozen=True)
class CarInit:
    """Write a first YAML for a car mesh: axes, unit, origin, seats and steering wheel as far as they are found."""

    mesh: Annotated[Positional[Path], arg(metavar="MESH")]
    """Mesh file: .glb, .gltf, .obj, .stl or .ply."""
    out: Path
    """YAML file to write."""
    up_axis: str = "auto"
    """Axis of the mesh that points up, such as z or -y."""
    front_axis: str = "auto"
    """Axis of the mesh that points to the car's front."""
    unit: str = "auto"
    """Unit of the mesh: m, cm, mm or inch."""
    overwrite: bool = False
    """Replace the YAML that is there."""
    as_json: JsonFlag = False


@dataclass(frozen=True)
class CarCheck:
    """Check the YAML of an own car: what was loaded, people tried in every seat, what was in their way, rules to add."""

    file: Annotated[Positional[Path], arg(metavar="YAML")]
    """YAML file of the car."""
    out: Maybe[Path] = None
    """Folder for car.png: side and top view, and a frame with people in it."""
    overwrite: bool = False
    """Replace the picture that is in the folder."""
    as_json: JsonFlag = False


@dataclass(frozen=True)
class Car:
    """Describe your own car mesh, or check what describes it."""

    action: Annotated[CarInit, subcommand("init")] | Annotated[CarCheck, subcommand("check")]

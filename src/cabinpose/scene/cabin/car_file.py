"""The YAML beside a user's own car mesh: its keys, and the rules for meshes that no rule of the user names."""

from __future__ import annotations

from collections.abc import Mapping
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from cabinpose.core import ConfigError, explained, read_yaml
from cabinpose.scene.cabin.model import STATIC_GROUP, WHEEL_GROUP
from cabinpose.scene.cabin.seats import PAN_BEHIND_H, PAN_BELOW_H
from cabinpose.scene.cabin.views import View
from cabinpose.scene.labels import LABEL_ID as LABEL
from cabinpose.scene.materials import MATERIAL_ID as MATERIAL

Point = tuple[float, float, float]
Slot = Literal["driver", "front_passenger", "rear_left", "rear_center", "rear_right"]


class _Strict(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)


class Rule(_Strict):
    """What meshes of this name are: the first rule whose pattern matches "node/geometry/material" counts."""

    pattern: str = Field(description="Shell pattern for its name, in any case, such as `*seat*`.")
    within: tuple[Point, Point] | None = Field(
        None, description="Only what of these meshes lies in this box, given by two opposite corners."
    )
    label: str = Field(
        "trim",
        description="Pixel class: seat, headrest, trim, door, dashboard, console, mirror, screen, glass, steering_wheel,"
        " steering_column, seat_belt, floor or pedal.",
    )
    material: str = Field("hard_plastic", description="What it is made of, for the sensor; a wrong name lists all.")
    give_mm: float = Field(0.0, ge=0, le=120, description="Depth to which its foam may be pressed in.")
    group: str = Field(
        STATIC_GROUP, description="What it moves with: body, wheel, seat:SLOT/base, seat:SLOT/back or seat:SLOT/headrest."
    )
    hide: bool = Field(False, description="Leave these meshes out, such as the car's outer skin.")

    def names(self, mesh: str) -> bool:
        """Whether the pattern matches the name of a mesh."""
        return fnmatchcase(mesh.lower(), self.pattern.lower())


class Belt(_Strict):
    """Anchors of a three-point belt."""

    upper: Point = Field(description="Where the belt comes down to the shoulder: D-ring or exit of the backrest.")
    buckle: Point = Field(description="Top of the buckle, at the inner side of the seat.")
    outer_lap: Point = Field(description="Anchor of the lap belt at the outer side of the seat.")
    rides_seat: bool = Field(False, description="Whether buckle and lap anchor move with the seat.")


class SeatSpec(_Strict):
    """A place to sit. Points are in the frame that `points` of the cabin names."""

    h_point: Point = Field(description="Hip pivot of the sitter at the design position: see below how to measure it.")
    heel_point: Point | None = Field(
        None, description="Where the heels rest on the floor; default: 0.8 m ahead of the H-point at the height of the origin."
    )
    facing: Literal["forward", "backward"] = Field("forward", description="Where the sitter looks.")
    torso_angle_deg: float = Field(25.0, ge=0, le=60, description="Recline of the backrest from the vertical.")
    cushion_angle_deg: float = Field(14.0, ge=0, le=35, description="Rise of the cushion from the horizontal.")
    fore_aft_mm: tuple[float, float] = Field(
        (0.0, 0.0), description="Travel of the seat from the design position, rearmost (negative) to foremost."
    )
    height_mm: tuple[float, float] = Field((0.0, 0.0), description="Travel of the seat in height, lowest to highest.")
    torso_angle_range_deg: tuple[float, float] | None = Field(
        None, description="Most upright and most reclined backrest; default: it is fixed."
    )
    feet: Literal["pedals", "floor"] | None = Field(
        None, description="What the feet rest on; default: pedals for the driver where pedals are given, else floor."
    )
    width_mm: float = Field(620.0, ge=350, le=1200, description="Not used; kept for files that give it.")
    cushion_below_h_mm: float = Field(
        1000 * PAN_BELOW_H - 40, ge=0, le=200, description="Free surface of the cushion below the H-point."
    )
    backrest_behind_h_mm: float = Field(
        1000 * PAN_BEHIND_H - 40, ge=0, le=250, description="Free surface of the backrest behind the H-point, normal to the back."
    )
    belt: Belt | None = Field(None, description="Anchors of the belt; default: nobody in this seat wears one.")


class WheelSpec(_Strict):
    """The steering wheel: its axis points from the hub to the driver."""

    centre: Point = Field(description="Middle of the rim.")
    axis: Point = Field(description="Direction from the hub to the driver, of any length.")
    diameter_mm: float = Field(370.0, ge=250, le=600, description="Outer diameter of the rim.")
    section_mm: float = Field(33.0, ge=15, le=60, description="Thickness of the rim.")


class PedalSpec(_Strict):
    """A pedal: a point and a plane."""

    point: Point = Field(description="Where the ball of the foot touches the pad.")
    angle_deg: float | None = Field(
        None,
        ge=10,
        le=90,
        description="The pad's plane from the horizontal; default: SAE J4004's A47 for the driver's seat height.",
    )


class ViewSpec(_Strict):
    """A camera place: where it is and where it looks."""

    eye: Point = Field(description="Where the camera is; it needs 5 cm of free space about it.")
    target: Point = Field(description="A point that it looks at.")


class CabinFile(_Strict):
    """The YAML beside a car mesh."""

    name: str | None = Field(None, description="What the car is called in a dataset; default: the name of this file.")
    mesh: str = Field(
        description="Mesh file (.glb, .gltf, .obj, .stl, .ply); a relative path counts from this file's folder."
        " It may name files in its own folder only."
    )
    up_axis: str = Field("auto", description="Axis of the mesh file that points up: x, -x, y, -y, z, -z or auto.")
    front_axis: str = Field("auto", description="Axis of the mesh file that points to the car's front, likewise.")
    unit: str = Field("auto", description="Unit of the mesh file: m, cm, mm, inch or auto.")
    scale: Annotated[float, Field(gt=0, description="Factor on top of the unit.")] = 1.0
    origin: Point = Field(
        (0.0, 0.0, 0.0), description="Vehicle origin (floor, centre line, heel point) in the mesh file's own coordinates."
    )
    points: Literal["vehicle", "mesh"] = Field(
        "vehicle", description="Frame of all points here but `origin`: vehicle (m), or the mesh file's own axes, unit and origin."
    )
    drive_side: Literal["left", "right"] = Field("left", description="Side of the steering wheel, as the driver sees it.")
    shell_mm: float = Field(
        15.0, ge=2, le=100, description="Thickness either side of open surfaces within which they are touched."
    )
    seats: dict[Slot, SeatSpec] = Field(
        min_length=1, description="Places to sit: driver, front_passenger, rear_left, rear_center, rear_right."
    )
    steering_wheel: WheelSpec | None = Field(None, description="The steering wheel; without one nobody steers.")
    pedals: dict[Literal["accelerator", "brake", "clutch", "footrest"], PedalSpec] = Field(
        {}, description="Pedals: accelerator, brake, clutch, footrest."
    )
    rules: tuple[Rule, ...] = Field((), description="What the meshes are: the first rule that fits a mesh counts.")
    views: dict[View, ViewSpec] = Field(
        {},
        description="Camera places: driver, front_row, rear, or those of products, mirror, roof_console, cluster, a_pillar,"
        " display; default: a free place is looked for before the seats for the first three.",
    )
    reach_targets: dict[str, Point] = Field(
        {}, description="Points that hands go to, by name, such as gear_lever, infotainment, glovebox, armrest_left."
    )


# Names that artists use, after the user's own rules.
COMMON_RULES = (
    Rule(pattern="*glass*", label="glass", material="glass"),
    Rule(pattern="*window*", label="glass", material="glass"),
    Rule(pattern="*windscreen*", label="glass", material="glass"),
    Rule(pattern="*windshield*", label="glass", material="glass"),
    Rule(pattern="*leather*headrest*", label="headrest", material="seat_leather", give_mm=50),
    Rule(pattern="*headrest*leather*", label="headrest", material="seat_leather", give_mm=50),
    Rule(pattern="*headrest*", label="headrest", material="seat_fabric", give_mm=50),
    Rule(pattern="*head[_ -]rest*", label="headrest", material="seat_fabric", give_mm=50),
    Rule(pattern="*leather*seat*", label="seat", material="seat_leather", give_mm=50),
    Rule(pattern="*belt*", label="seat_belt", material="belt_webbing"),
    Rule(pattern="*seat*", label="seat", material="seat_fabric", give_mm=50),
    Rule(pattern="*steering*wheel*", label="steering_wheel", material="steering_leather"),
    Rule(pattern="*steering*column*", label="steering_column", material="hard_plastic"),
    Rule(pattern="*pedal*", label="pedal", material="rubber"),
    Rule(pattern="*carpet*", label="floor", material="carpet"),
    Rule(pattern="*floor*", label="floor", material="carpet"),
    Rule(pattern="*headlin*", label="trim", material="headliner"),
    Rule(pattern="*roof*", label="trim", material="headliner"),
    Rule(pattern="*mirror*", label="mirror", material="hard_plastic"),
    Rule(pattern="*dash*", label="dashboard", material="soft_trim"),
    Rule(pattern="*instrument*panel*", label="dashboard", material="soft_trim"),
    Rule(pattern="*console*", label="console", material="hard_plastic"),
    Rule(pattern="*sun*screen*", label="trim", material="headliner"),
    Rule(pattern="*screen*", label="screen", material="hard_plastic"),
    Rule(pattern="*display*", label="screen", material="hard_plastic"),
    Rule(pattern="*[0-9]door*", label="trim", material="hard_plastic"),  # the name of a car
    Rule(pattern="*[0-9]-door*", label="trim", material="hard_plastic"),
    Rule(pattern="*outdoor*", label="trim", material="hard_plastic"),
    Rule(pattern="*door*", label="door", material="soft_trim"),
    Rule(pattern="*", label="trim", material="hard_plastic"),
)


def read_car_file(path: Path) -> CabinFile:
    """The YAML of a car mesh, checked; raises ConfigError that names the key."""
    from cabinpose.scene.cabin.meshfile import SUFFIXES  # noqa: PLC0415 - trimesh

    if path.suffix.lower() in SUFFIXES:
        hint = f"`cabinpose car init {path} --out {path.stem}.yaml` writes the YAML file that does"
        raise ConfigError(f"{path} is a mesh, and does not say what is what in it", hint=hint)
    data = read_yaml(path, hint="give the YAML file that describes the car mesh, with mesh, seats and steering_wheel")
    if not isinstance(data, Mapping):
        raise ConfigError(f"{path} is no mapping of keys to values", hint="it takes at least `mesh` and `seats`")
    try:
        spec = CabinFile.model_validate(data)
    except ValidationError as error:
        raise explained(error, CabinFile, data, at=f"{path}: ", lists="docs/own-car.md lists the keys") from None
    for rule in spec.rules:
        known_groups = [STATIC_GROUP, WHEEL_GROUP] + [f"seat:{s}/{g}" for s in spec.seats for g in ("base", "back", "headrest")]
        for kind, value, known in (
            ("label", rule.label, list(LABEL)), ("material", rule.material, list(MATERIAL)), ("group", rule.group, known_groups)
        ):  # fmt: skip
            if value not in known:
                raise ConfigError(f"{path}: rule '{rule.pattern}': unknown {kind} '{value}'", hint=f"known: {', '.join(known)}")
        if rule.group == WHEEL_GROUP and spec.steering_wheel is None:
            raise ConfigError(f"{path}: rule '{rule.pattern}' is part of a wheel that is not given", hint="add steering_wheel")
    return spec

"""`load_cabin`: a user's own car mesh, with a YAML file that says where its seats, wheel and pedals are."""

from __future__ import annotations

from collections.abc import Mapping
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
import trimesh
import yaml
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from cabinpose.core.errors import ConfigError, MeshError
from cabinpose.core.frames import Matrix, apply, invert
from cabinpose.core.pose import OCCUPANT_SLOTS
from cabinpose.scene.cabin.layout import pedal_plane_angle
from cabinpose.scene.cabin.meshfile import MeshFile, read_mesh
from cabinpose.scene.cabin.model import (
    STATIC_GROUP,
    WHEEL_GROUP,
    BeltAnchors,
    Cabin,
    Part,
    Seat,
    SeatSetting,
    SteeringWheel,
    Vector,
    ViewAnchor,
    in_slot_order,
)
from cabinpose.scene.cabin.seats import PAN_BEHIND_H, PAN_BELOW_H
from cabinpose.scene.cabin.shading import to_surface
from cabinpose.scene.cabin.shapes import Solid
from cabinpose.scene.labels import ID as LABEL
from cabinpose.scene.materials import ID as MATERIAL

Point = tuple[float, float, float]
Slot = Literal["driver", "front_passenger", "rear_left", "rear_center", "rear_right"]
CLEAR_OF_CAMERA = 0.05  # m from an eye that was chosen here to the nearest surface


class _Strict(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)


class Rule(_Strict):
    """What meshes of this name are: the first rule whose pattern matches "node/geometry/material" counts."""

    pattern: str = Field(description="Shell pattern, any case: *seat*")
    label: str = "trim"
    material: str = "hard_plastic"
    give_mm: float = Field(0.0, ge=0, le=120, description="Depth by which its foam may be pressed in.")
    group: str = Field(STATIC_GROUP, description="body, wheel, seat:<slot>/base, seat:<slot>/back or seat:<slot>/headrest")
    hide: bool = Field(False, description="Leave these meshes out, such as the car's outer skin.")


class Belt(_Strict):
    """Anchors of a three-point belt."""

    upper: Point
    buckle: Point
    outer_lap: Point
    rides_seat: bool = False


class SeatSpec(_Strict):
    """A place to sit. Points are in the frame that `points` of the cabin names."""

    h_point: Point
    heel_point: Point | None = Field(None, description="Default: 0.8 m ahead of the H-point on the floor.")
    facing: Literal["forward", "backward"] = "forward"
    torso_angle_deg: float = Field(25.0, ge=0, le=60)
    cushion_angle_deg: float = Field(14.0, ge=0, le=35)
    fore_aft_mm: tuple[float, float] = (0.0, 0.0)
    height_mm: tuple[float, float] = (0.0, 0.0)
    torso_angle_range_deg: tuple[float, float] | None = None
    feet: Literal["pedals", "floor"] | None = None
    width_mm: float = Field(620.0, ge=350, le=1200)
    cushion_below_h_mm: float = Field(1000 * PAN_BELOW_H - 40, ge=0, le=200)
    backrest_behind_h_mm: float = Field(1000 * PAN_BEHIND_H - 40, ge=0, le=250)
    belt: Belt | None = None


class WheelSpec(_Strict):
    """The steering wheel: its axis points from the hub to the driver."""

    centre: Point
    axis: Point
    diameter_mm: float = Field(370.0, ge=250, le=600)
    section_mm: float = Field(33.0, ge=15, le=60, description="Thickness of the rim.")


class PedalSpec(_Strict):
    """Where the ball of the foot touches, and the pad's plane from the horizontal (default: SAE J1516's A47)."""

    point: Point
    angle_deg: float | None = Field(None, ge=10, le=90)


class ViewSpec(_Strict):
    """A camera place: where it is and where it looks."""

    eye: Point
    target: Point


class CabinFile(_Strict):
    """The YAML beside a car mesh."""

    name: str | None = None
    mesh: str = Field(description="Mesh file; a relative path counts from the YAML's folder.")
    up_axis: str = "auto"
    front_axis: str = "auto"
    unit: str = "auto"
    scale: Annotated[float, Field(gt=0)] = 1.0
    origin: Point = Field(
        (0.0, 0.0, 0.0), description="Vehicle origin (floor, centre line, heel point) in the file's coordinates."
    )
    points: Literal["vehicle", "mesh"] = Field(
        "vehicle", description="Frame of all points here: vehicle (m) or the mesh file's own."
    )
    drive_side: Literal["left", "right"] = "left"
    shell_mm: float = Field(
        15.0, ge=2, le=100, description="Thickness either side of open surfaces within which they are touched."
    )
    seats: dict[Slot, SeatSpec] = Field(min_length=1)
    steering_wheel: WheelSpec | None = None
    pedals: dict[Literal["accelerator", "brake", "clutch", "footrest"], PedalSpec] = {}
    rules: tuple[Rule, ...] = ()
    views: dict[Literal["driver", "front_row", "rear"], ViewSpec] = {}
    reach_targets: dict[str, Point] = {}


# Names that artists use, after the user's own rules.
_COMMON_RULES = (
    Rule(pattern="*glass*", label="glass", material="glass"),
    Rule(pattern="*window*", label="glass", material="glass"),
    Rule(pattern="*windscreen*", label="glass", material="glass"),
    Rule(pattern="*windshield*", label="glass", material="glass"),
    Rule(pattern="*leather*seat*", label="seat", material="seat_leather", give_mm=50),
    Rule(pattern="*belt*", label="seat_belt", material="belt_webbing"),
    Rule(pattern="*seat*", label="seat", material="seat_fabric", give_mm=50),
    Rule(pattern="*steering*wheel*", label="steering_wheel", material="steering_leather"),
    Rule(pattern="*pedal*", label="pedal", material="rubber"),
    Rule(pattern="*carpet*", label="floor", material="carpet"),
    Rule(pattern="*floor*", label="floor", material="carpet"),
    Rule(pattern="*headlin*", label="trim", material="headliner"),
    Rule(pattern="*roof*", label="trim", material="headliner"),
    Rule(pattern="*", label="trim", material="hard_plastic"),
)


def load_cabin(yaml_path: str | Path) -> Cabin:
    """A cabin from a YAML file (`CabinFile`) and the mesh it names.

    Closed meshes with outward faces (turned where they look inwards) are solids; others, and closed ones that an
    occupant's H-point lies inside of, are shells of the stated thickness. Raises ConfigError for the YAML, MeshError
    or DependencyError for the mesh; `notes` of the cabin say what was found and how.
    """
    path = Path(yaml_path)
    spec = _read_yaml(path)
    file = read_mesh(
        path.parent / spec.mesh,
        up_axis=spec.up_axis,
        front_axis=spec.front_axis,
        unit=spec.unit,
        scale=spec.scale,
        origin=spec.origin,
    )
    place = _Placer(file, spec.points)
    seats: dict[str, Seat] = {slot: _seat(slot, s, place, spec) for slot, s in spec.seats.items()}
    everything = np.concatenate([m.vertices for m in file.meshes])
    low, high = everything.min(axis=0), everything.max(axis=0)
    for slot, seat in seats.items():
        if ((seat.design_h_point < low) | (seat.design_h_point > high)).any():
            raise ConfigError(
                f"{path}: the H-point of {slot} is outside the mesh: {np.round(low, 2)} to {np.round(high, 2)} m (vehicle)",
                hint="check unit, axes and origin, or set `points: mesh` where points are the file's own coordinates",
            )
    wheel = _wheel(spec.steering_wheel, place)
    notes = list(file.notes)
    groups = {STATIC_GROUP: np.eye(4)}
    for slot, seat in seats.items():
        groups[f"seat:{slot}/base"] = seat.vehicle_from_seat(seat.default)
        groups[f"seat:{slot}/back"] = groups[f"seat:{slot}/headrest"] = seat.vehicle_from_back(seat.default)
    if wheel is not None:
        groups[WHEEL_GROUP] = wheel.vehicle_from_wheel
    h_points = np.stack([s.design_h_point for s in seats.values()])
    parts = _parts(path, file, spec, groups, h_points, notes)
    pads = _pedals(spec, place, seats)
    views = _default_views(seats, parts, groups, notes)
    views |= {str(name): ViewAnchor(place.point(v.eye), place.point(v.target)) for name, v in spec.views.items()}
    targets = {name: place.point(p) for name, p in spec.reach_targets.items()}
    return Cabin(
        spec.name or path.stem, spec.drive_side, tuple(parts), in_slot_order(seats), wheel, pads, targets, views, tuple(notes)
    )


def _read_yaml(path: Path) -> CabinFile:
    try:
        data = yaml.safe_load(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise ConfigError(
            f"cannot read {path}: {error.strerror}", hint="give the YAML file that describes the car mesh"
        ) from None
    except (yaml.YAMLError, UnicodeDecodeError) as error:
        raise ConfigError(f"{path} is not YAML: {error}", hint="it takes keys such as mesh, seats, steering_wheel") from None
    if not isinstance(data, Mapping):
        raise ConfigError(f"{path} is no mapping of keys to values", hint="it takes at least `mesh` and `seats`")
    try:
        spec = CabinFile.model_validate(data)
    except ValidationError as error:
        first = error.errors()[0]
        where = ".".join(str(p) for p in first["loc"])
        raise ConfigError(f"{path}: {where}: {first['msg']}", hint=f"known keys: {', '.join(CabinFile.model_fields)}") from None
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


class _Placer:
    """Takes points of the YAML to the vehicle frame."""

    def __init__(self, file: MeshFile, frame: str) -> None:
        self._matrix = file.vehicle_from_mesh if frame == "mesh" else np.eye(4)

    def point(self, p: Point) -> Vector:
        return apply(self._matrix, p)

    def direction(self, v: Point) -> Vector:
        turned = self._matrix[:3, :3] @ np.asarray(v, dtype=np.float64)
        length = float(np.linalg.norm(turned))
        if length < 1e-9:
            raise ConfigError("a direction of length zero", hint="the wheel's axis points from its hub to the driver")
        return np.asarray(turned / length)


def _seat(slot: str, s: SeatSpec, place: _Placer, spec: CabinFile) -> Seat:
    yaw = 0.0 if s.facing == "forward" else np.pi
    h = place.point(s.h_point)
    forward = np.array([np.cos(yaw), 0.0, 0.0])
    default = SeatSetting(0.0, 0.0, float(np.deg2rad(s.torso_angle_deg)))
    torso = s.torso_angle_range_deg or (s.torso_angle_deg, s.torso_angle_deg)
    for name, (low, high), inside in (
        ("fore_aft_mm", s.fore_aft_mm, 0.0), ("height_mm", s.height_mm, 0.0), ("torso_angle_range_deg", torso, s.torso_angle_deg)
    ):  # fmt: skip
        if not low <= inside <= high:
            raise ConfigError(
                f"seat {slot}: {name} = [{low:g}, {high:g}] does not hold its design value {inside:g}", hint="min <= max"
            )
    ranges = (
        SeatSetting(s.fore_aft_mm[0] / 1000, s.height_mm[0] / 1000, float(np.deg2rad(torso[0]))),
        SeatSetting(s.fore_aft_mm[1] / 1000, s.height_mm[1] / 1000, float(np.deg2rad(torso[1]))),
    )
    heel = place.point(s.heel_point) if s.heel_point is not None else np.array([*(h + 0.8 * forward)[:2], 0.0])
    feet = s.feet or ("pedals" if slot == "driver" and spec.pedals else "floor")
    belt = None
    if s.belt is not None:
        belt = BeltAnchors(
            place.point(s.belt.upper), place.point(s.belt.buckle), place.point(s.belt.outer_lap), s.belt.rides_seat
        )
    return Seat(
        slot, h, yaw, default, ranges, float(np.deg2rad(s.cushion_angle_deg)), heel, feet, belt, s.width_mm / 1000,
        s.cushion_below_h_mm / 1000, s.backrest_behind_h_mm / 1000,
    )  # fmt: skip


def _wheel(spec: WheelSpec | None, place: _Placer) -> SteeringWheel | None:
    if spec is None:
        return None
    z = place.direction(spec.axis)
    x = np.array([0.0, 0.0, 1.0]) - z * z[2]
    if np.linalg.norm(x) < 1e-6:
        x = np.array([1.0, 0.0, 0.0])
    x = x / np.linalg.norm(x)
    pose = np.eye(4)
    pose[:3, 0], pose[:3, 1], pose[:3, 2], pose[:3, 3] = x, np.cross(z, x), z, place.point(spec.centre)
    return SteeringWheel(pose, (spec.diameter_mm - spec.section_mm) / 2000, spec.section_mm / 2000)


def _pedals(spec: CabinFile, place: _Placer, seats: Mapping[str, Seat]) -> dict[str, Matrix]:
    poses = {}
    for name, pedal in spec.pedals.items():
        angle = np.deg2rad(pedal.angle_deg) if pedal.angle_deg is not None else None
        if angle is None:
            driver = seats.get("driver")
            angle = (
                pedal_plane_angle(float(driver.design_h_point[2] - driver.heel_m[2])) if driver is not None else np.deg2rad(60)
            )
        pose = np.eye(4)
        pose[:3, 0], pose[:3, 1] = (np.cos(angle), 0, np.sin(angle)), (0, 1, 0)
        pose[:3, 2], pose[:3, 3] = (-np.sin(angle), 0, np.cos(angle)), place.point(pedal.point)
        poses[str(name)] = pose
    return poses


def _parts(
    path: Path, file: MeshFile, spec: CabinFile, groups: Mapping[str, Matrix], h_points: NDArray[np.float64], notes: list[str]
) -> list[Part]:
    parts = []
    for mesh in file.meshes:
        rule = next(r for r in (*spec.rules, *_COMMON_RULES) if fnmatchcase(mesh.name.lower(), r.pattern.lower()))
        if rule.hide:
            continue
        solid, closed, remark = _cleaned(mesh.vertices, mesh.faces, h_points)
        if remark:
            notes.append(f"{mesh.name}: {remark}")
        if len(solid.faces) == 0:
            continue
        local = solid.moved(invert(groups[rule.group]))
        surface = to_surface(local, rule.label, rule.material)
        shell = 0.0 if closed else spec.shell_mm / 1000
        parts.append(Part(mesh.name, surface, rule.group, rule.give_mm / 1000, closed, shell))
    if not parts:
        raise MeshError(f"{path}: every mesh is hidden by a rule", hint="leave at least the seats and the floor")
    return parts


def _cleaned(vertices: NDArray[np.float64], faces: NDArray[np.int32], h_points: NDArray[np.float64]) -> tuple[Solid, bool, str]:
    """The mesh without doubled and degenerate triangles, whether it is a solid, and what was done to it."""
    mesh = trimesh.Trimesh(vertices, faces, process=False)
    mesh.merge_vertices()
    f = np.asarray(mesh.faces)
    f = f[(f[:, 0] != f[:, 1]) & (f[:, 1] != f[:, 2]) & (f[:, 2] != f[:, 0])]
    _, first = np.unique(np.sort(f, axis=1), axis=0, return_index=True)
    doubled = len(f) - len(first)
    remarks = [f"{doubled} triangles lay twice in one place: one of each kept"] if doubled else []
    single = trimesh.Trimesh(mesh.vertices, f[np.sort(first)], process=False)
    solid = Solid(np.asarray(single.vertices, dtype=np.float64), np.asarray(single.faces, dtype=np.int32))
    if not (len(solid.faces) and single.is_watertight and single.is_winding_consistent):
        return solid, False, "; ".join(remarks)
    if solid.volume() < 0:
        solid = solid.flipped()
        remarks.append("faces looked inwards: turned")
    if any(_winding_number(solid, p) > 0.5 for p in h_points):
        remarks.append("closed around an occupant: taken as a shell")
        return solid, False, "; ".join(remarks)
    return solid, True, "; ".join(remarks)


def _winding_number(solid: Solid, point: NDArray[np.float64]) -> float:
    """1 inside, 0 outside a closed mesh (van Oosterom and Strackee 1983, the solid angle of a triangle)."""
    a, b, c = (solid.vertices[solid.faces[:, i]] - point for i in range(3))
    la, lb, lc = (np.linalg.norm(v, axis=1) for v in (a, b, c))
    numerator = np.einsum("ij,ij->i", a, np.cross(b, c))
    denominator = la * lb * lc + np.sum(a * b, 1) * lc + np.sum(b * c, 1) * la + np.sum(c * a, 1) * lb
    return float(np.sum(np.arctan2(numerator, denominator)) / (2 * np.pi))


def _default_views(
    seats: Mapping[str, Seat], parts: list[Part], groups: Mapping[str, Matrix], notes: list[str]
) -> dict[str, ViewAnchor]:
    """Views that look at the seats from before and above, at the first place that is clear of everything."""
    triangles = np.concatenate([apply(groups[p.group], p.surface.vertices)[p.surface.faces] for p in parts])
    wanted: dict[str, list[str]] = {
        "driver": ["driver"],
        "front_row": ["driver", "front_passenger"],
        "rear": list(OCCUPANT_SLOTS[2:]),
    }
    views = {}
    for name, slots in wanted.items():
        there = [seats[s] for s in slots if s in seats]
        if not there or (name == "front_row" and len(there) < 2):
            continue
        middle = np.mean([s.design_h_point for s in there], axis=0)
        forward = there[0].vehicle_from_seat(there[0].default)[:3, 0]
        target = middle - 0.10 * forward + (0, 0, 0.32)
        for ahead, above in ((a, z) for z in (0.72, 0.66, 0.60, 0.54) for a in (0.70, 0.62, 0.78, 0.54)):
            eye = middle + ahead * forward + (0, 0, above)
            if _clearance(triangles, eye) >= CLEAR_OF_CAMERA:
                views[name] = ViewAnchor(eye, target)
                break
        else:
            notes.append(f"view {name}: no place before its seats is clear of the mesh; give one under `views`")
    return views


def _clearance(triangles: NDArray[np.float64], point: Vector) -> float:
    near = np.linalg.norm(triangles - point, axis=-1).min()
    reach = float(np.linalg.norm(np.ptp(triangles, axis=1), axis=-1).max())
    close = triangles[(np.linalg.norm(triangles - point, axis=-1).min(axis=1)) < near + reach]
    closest: Any = trimesh.triangles.closest_point(close, np.broadcast_to(point, (len(close), 3)))
    return float(np.linalg.norm(closest - point, axis=-1).min())

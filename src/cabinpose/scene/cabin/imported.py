"""`load_cabin`: a user's own car mesh, with a YAML file that says where its seats, wheel and pedals are."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np

from cabinpose.core import ConfigError, Matrix, apply
from cabinpose.core import reproducible as rp
from cabinpose.scene.cabin.car_file import CabinFile, Point, SeatSpec, WheelSpec, read_car_file
from cabinpose.scene.cabin.default_views import default_views
from cabinpose.scene.cabin.layout import pedal_plane_angle
from cabinpose.scene.cabin.mesh_parts import mesh_parts
from cabinpose.scene.cabin.meshfile import MeshFile, read_mesh
from cabinpose.scene.cabin.model import (
    STATIC_GROUP,
    WHEEL_GROUP,
    BeltAnchors,
    Cabin,
    Seat,
    SeatSetting,
    SteeringWheel,
    Vector,
    ViewAnchor,
    in_slot_order,
)
from cabinpose.scene.cabin.sizes import UNITS, judged, measured, opposite, places_of

_APART_M = 0.3  # between two seats of a car, at least
_APART_VIEW_M = 1e-3  # between the eye and the target of a view
_ASIDE_M = 0.1  # by which the driver sits on a side


def load_cabin(yaml_path: str | Path, spec: CabinFile | None = None, *, refuse: bool = True) -> Cabin:
    """A cabin from a YAML file (`CabinFile`) and the mesh it names.

    Closed meshes with outward faces (turned where they look inwards) are solids; others, and closed ones that an
    occupant's H-point lies inside of, are shells of the stated thickness.

    Parameters
    ----------
    yaml_path
        The YAML file; the mesh's path counts from its folder.
    spec
        What stands in place of the file's content, for a change that is tried before it is written.
    refuse
        Whether sizes that no car has raise ConfigError; without, they are warnings.

    Returns
    -------
    Cabin
        `notes` say what was found and how, `warnings` what is wrong with the meshes.

    Raises
    ------
    ConfigError
        For the YAML, and for sizes that no car has.
    MeshError, DependencyError
        For the mesh.
    """
    path = Path(yaml_path)
    spec = spec or read_car_file(path)
    file = _mesh_of(path, spec)
    place = _Placer(file, spec.points)
    seats: dict[str, Seat] = {slot: _seat(slot, s, place, spec) for slot, s in spec.seats.items()}
    everything = np.concatenate([m.vertices for m in file.meshes])
    low, high = everything.min(axis=0), everything.max(axis=0)
    for slot, seat in seats.items():
        if ((seat.design_h_point < low) | (seat.design_h_point > high)).any():
            raise ConfigError(
                f"{path}: the H-point of {slot} is outside the mesh: {np.round(low, 2)} to {np.round(high, 2)} m (vehicle)",
                hint=_why_outside(seats.values(), low, high, file.front_axis)
                or "check unit, axes and origin, or set `points: mesh` where points are the file's own coordinates",
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
    rules = [(rule, None if rule.within is None else place.box(*rule.within)) for rule in spec.rules]
    parts, remarks, warnings = mesh_parts(path, file.meshes, rules, groups, h_points, spec.shell_mm / 1000)
    views = {str(name): ViewAnchor(place.point(v.eye), place.point(v.target)) for name, v in spec.views.items()}
    for name, view in views.items():
        if not rp.norm(view.target - view.eye) > _APART_VIEW_M:
            raise ConfigError(f"{path}: the eye and the target of the view {name} coincide", hint="give a target farther away")
    cabin = Cabin(
        spec.name or path.stem,
        spec.drive_side,
        tuple(parts),
        in_slot_order(seats),
        wheel,
        _pedals(spec, place, seats),
        {name: place.point(p) for name, p in spec.reach_targets.items()},
        views,
        warnings=tuple(warnings),
    )
    verdict = judged(measured(cabin), places_of(cabin), steered=wheel is not None, unit=file.unit, front=file.front_axis)
    if verdict.errors and refuse:
        raise ConfigError(f"{path}: {'; '.join(verdict.errors)}", hint=verdict.hint)
    _check_side(path, spec.drive_side, seats)
    own, no_place = default_views(cabin, frozenset(views))
    told = (*cabin.warnings, *verdict.errors, *verdict.said)
    return replace(cabin, views=own | views, notes=(*notes, *remarks, *no_place), warnings=told)


def _why_outside(seats: Iterable[Seat], low: Vector, high: Vector, front: str) -> str | None:
    """What would bring all H-points into the mesh from `low` to `high` (3,) m, in words; None where nothing known does."""
    points = np.stack([seat.design_h_point for seat in seats])

    def fit(changed: Vector) -> bool:
        return bool(((changed >= low) & (changed <= high)).all())

    if fit(points * (-1.0, -1.0, 1.0)):
        return f"all seats lie in it if it is turned round: front axis {opposite(front)}"
    for unit, metres in UNITS.items():
        if np.ptp(points * metres, axis=0).max() > _APART_M and fit(points * metres):
            return f"all seats lie in it if the YAML's points are in {unit}: give them in metres"
    return None


def _check_side(path: Path, drive_side: str, seats: Mapping[str, Seat]) -> None:
    """Raise ConfigError where the driver looks forward and sits on the other side: of the passenger, or of the centre line."""
    driver, passenger = seats.get("driver"), seats.get("front_passenger")
    if driver is None or driver.facing_yaw:
        return
    to_left = float(driver.design_h_point[1]) - (0.0 if passenger is None else float(passenger.design_h_point[1]))
    side = "left" if to_left > 0 else "right"
    if abs(to_left) > _ASIDE_M and side != drive_side:
        of = "the centre line" if passenger is None else "the front passenger"
        raise ConfigError(
            f"{path}: drive_side is {drive_side}, and the driver's H-point is {abs(to_left):.2f} m to the {side} of {of}",
            hint=f"give drive_side: {side}, or exchange the seats",
        )


class _Placer:
    """Takes points of the YAML to the vehicle frame."""

    def __init__(self, file: MeshFile, frame: str) -> None:
        self._matrix = file.vehicle_from_mesh if frame == "mesh" else np.eye(4)

    def point(self, p: Point) -> Vector:
        return apply(self._matrix, p)

    def box(self, one: Point, other: Point) -> tuple[Vector, Vector]:
        """Lowest and highest corner, (3,) vehicle, m."""
        corners = apply(self._matrix, [one, other])
        return corners.min(axis=0), corners.max(axis=0)

    def direction(self, v: Point) -> Vector:
        turned = rp.matmul(self._matrix[:3, :3], np.asarray(v, dtype=np.float64))
        length = rp.norm(turned)
        if length < 1e-9:
            raise ConfigError("a direction of length zero", hint="the wheel's axis points from its hub to the driver")
        return np.asarray(turned / length)


def file_from_vehicle(yaml_path: Path, spec: CabinFile) -> Matrix:
    """(4, 4) that takes a point of the vehicle frame (m) to the frame in which a YAML file gives its points."""
    if spec.points == "vehicle":
        return np.eye(4)
    return np.asarray(rp.inv(_mesh_of(yaml_path, spec).vehicle_from_mesh), np.float64)


def _mesh_of(yaml_path: Path, spec: CabinFile) -> MeshFile:
    return read_mesh(
        yaml_path.parent / spec.mesh,
        up_axis=spec.up_axis,
        front_axis=spec.front_axis,
        unit=spec.unit,
        scale=spec.scale,
        origin=spec.origin,
    )


def _seat(slot: str, s: SeatSpec, place: _Placer, spec: CabinFile) -> Seat:
    yaw = 0.0 if s.facing == "forward" else np.pi
    h = place.point(s.h_point)
    forward = np.array([rp.cos(yaw), 0.0, 0.0])
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
        slot, h, yaw, default, ranges, float(np.deg2rad(s.cushion_angle_deg)), heel, feet, belt,
        s.cushion_below_h_mm / 1000, s.backrest_behind_h_mm / 1000,
    )  # fmt: skip


def _wheel(spec: WheelSpec | None, place: _Placer) -> SteeringWheel | None:
    if spec is None:
        return None
    z = place.direction(spec.axis)
    x = np.array([0.0, 0.0, 1.0]) - z * z[2]
    if rp.norm(x) < 1e-6:
        x = np.array([1.0, 0.0, 0.0])
    x = x / rp.norm(x)
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
        pose[:3, 0], pose[:3, 1] = (rp.cos(angle), 0, rp.sin(angle)), (0, 1, 0)
        pose[:3, 2], pose[:3, 3] = (-rp.sin(angle), 0, rp.cos(angle)), place.point(pedal.point)
        poses[str(name)] = pose
    return poses

"""What a cabin is to the rest of the package: parts in groups that move, seats, wheel, pedals, views."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from types import MappingProxyType

import numpy as np

from cabinpose.core import OCCUPANT_SLOTS, ConfigError, Floats, Floats32, Matrix, axis_rotation, unknown_name
from cabinpose.core import reproducible as rp
from cabinpose.scene.surface import Surface, merge

Vector = Floats  # (3,)
STATIC_GROUP, WHEEL_GROUP = "body", "wheel"


@dataclass(frozen=True)
class Part:
    """One piece of a cabin, in the frame of its group.

    surface: its triangles · group: "body" (vehicle frame), "seat:<slot>/base", "seat:<slot>/back",
    "seat:<slot>/headrest" or "wheel" · give_m: depth by which its foam may be pressed in (0: hard) ·
    solid: closed, with outward normals once equal positions are merged · shell_m: thickness (m) on both sides of an
    open surface within which a point touches it, 0 for solids · mesh: of a file, out of which a rule cut it; "" if none did.
    """

    name: str
    surface: Surface
    group: str = STATIC_GROUP
    give_m: float = 0.0
    solid: bool = True
    shell_m: float = 0.0
    mesh: str = ""


@dataclass(frozen=True)
class SeatSetting:
    """Where a seat stands: metres forward (its own forward) and up from the design position, torso angle in radians.

    The torso angle is that of SAE J1100 A40: from the vertical, positive rearward.
    """

    fore_aft_m: float = 0.0
    height_m: float = 0.0
    torso_angle: float = 0.0


@dataclass(frozen=True)
class BeltAnchors:
    """Where a three-point belt is held, (3,) vehicle frame, m: D-ring or shoulder exit, buckle, outer lap anchor.

    `rides_seat`: buckle and lap anchor move fore-aft with the seat (front seats), as given for the design position.
    """

    upper: Vector
    buckle: Vector
    outer_lap: Vector
    rides_seat: bool = True


@dataclass(frozen=True)
class Seat:
    """A place to sit: where its H-point may be, how its parts follow, what its occupant's feet rest on.

    design_h_point: (3,) vehicle, m, at the default setting's zero · facing_yaw: 0 looks forward, pi backward ·
    cushion_angle: A27, rad · heel_m: (3,) vehicle, the heel point · cushion_below_h_m, backrest_behind_h_m: free foam surface
    from the H-point, down and along the normal of the torso line (SAE J826: the manikin's pans are 98 mm below and 135 mm
    behind, foam pressed in).
    """

    slot: str
    design_h_point: Vector
    facing_yaw: float
    default: SeatSetting
    ranges: tuple[SeatSetting, SeatSetting]
    cushion_angle: float
    heel_m: Vector
    foot_support: str
    belt: BeltAnchors | None
    cushion_below_h_m: float
    backrest_behind_h_m: float

    @property
    def floor_z(self) -> float:
        """Height of the floor under the occupant's heels, m."""
        return float(self.heel_m[2])

    def check(self, setting: SeatSetting) -> None:
        """Raises ConfigError where a setting is beyond the ranges of the seat."""
        for name in ("fore_aft_m", "height_m", "torso_angle"):
            low, high, value = (float(getattr(s, name)) for s in (*self.ranges, setting))
            if not low - 1e-9 <= value <= high + 1e-9:
                message = f"seat {self.slot}: {name} = {value:g} is outside [{low:g}, {high:g}]"
                raise ConfigError(message, hint=f"choose {name} within its range")

    def vehicle_from_seat(self, setting: SeatSetting) -> Matrix:
        """Origin in the H-point, x the seat's forward, z up (not reclined)."""
        matrix = self._facing.copy()
        x, y, z, forward_x, forward_y = self._place
        travel = setting.fore_aft_m
        matrix[0, 3], matrix[1, 3], matrix[2, 3] = x + forward_x * travel, y + forward_y * travel, z + setting.height_m
        return matrix

    @cached_property
    def _place(self) -> tuple[float, ...]:
        """The design H-point's x, y, z and the x, y of the seat's forward."""
        return (*map(float, self.design_h_point), *self._facing[:2, 0].tolist())

    @cached_property
    def _facing(self) -> Matrix:
        """The seat's turn, about the vehicle's origin."""
        matrix = np.eye(4)
        matrix[:3, :3] = np.round(axis_rotation("z", self.facing_yaw), 15)
        return matrix

    def vehicle_from_back(self, setting: SeatSetting) -> Matrix:
        """Origin in the H-point, z along the torso line (up the back), x its normal towards the seat's front."""
        return self._reclined(self.vehicle_from_seat(setting), setting)

    def _reclined(self, vehicle_from_seat: Matrix, setting: SeatSetting) -> Matrix:
        matrix = vehicle_from_seat.copy()
        matrix[:3, :3] = rp.matmul(matrix[:3, :3], axis_rotation("y", -setting.torso_angle))
        return matrix

    def h_point(self, setting: SeatSetting) -> Vector:
        """(3,) vehicle frame, m."""
        return np.asarray(self.vehicle_from_seat(setting)[:3, 3])

    def heel_point(self, setting: SeatSetting) -> Vector:
        """(3,) vehicle frame, m: fixed for the pedals; elsewhere it follows the seat by half its travel."""
        if self.foot_support == "pedals":
            return self.heel_m.copy()
        forward = self.vehicle_from_seat(setting)[:3, 0]
        return np.asarray(self.heel_m + 0.5 * setting.fore_aft_m * forward)

    def belt_anchors(self, setting: SeatSetting) -> BeltAnchors | None:
        """The anchors with the seat at a setting."""
        if self.belt is None or not self.belt.rides_seat:
            return self.belt
        shift = self.h_point(setting) - self.design_h_point
        return BeltAnchors(self.belt.upper, self.belt.buckle + shift, self.belt.outer_lap + shift)


@dataclass(frozen=True)
class SteeringWheel:
    """vehicle_from_wheel: origin in the hub, z the axis towards the driver, x up in the plane of the rim (then y left).

    rim_radius_m: to the centre line of the rim · rim_section_m: radius of the rim's section.
    """

    vehicle_from_wheel: Matrix
    rim_radius_m: float
    rim_section_m: float

    def grip_point(self, angle: float) -> Vector:
        """(3,) vehicle: the rim's centre line at `angle` rad from the top, positive to the left (pi/2 = nine o'clock)."""
        local = np.array([rp.cos(angle), rp.sin(angle), 0.0]) * self.rim_radius_m
        return np.asarray(rp.matmul(self.vehicle_from_wheel[:3, :3], local) + self.vehicle_from_wheel[:3, 3])

    def tangent(self, angle: float) -> Vector:
        """(3,) unit, vehicle: along the rim at `angle`, the way the angle grows."""
        return np.asarray(rp.matmul(self.vehicle_from_wheel[:3, :3], np.array([-rp.sin(angle), rp.cos(angle), 0.0])))


@dataclass(frozen=True)
class ViewAnchor:
    """A camera place: eye and target, (3,) vehicle, m."""

    eye: Vector
    target: Vector


@dataclass(frozen=True)
class _Group:
    name: str
    vertices: Floats32
    normals: Floats32
    span: slice


@dataclass(frozen=True, eq=False)
class Cabin:
    """An interior: its parts, the seats in it, and where its moving groups stand for given settings."""

    name: str
    drive_side: str
    parts: tuple[Part, ...]
    seats: Mapping[str, Seat]
    steering_wheel: SteeringWheel | None
    pedals: Mapping[str, Matrix]
    reach_targets: Mapping[str, Vector]
    views: Mapping[str, ViewAnchor]
    notes: tuple[str, ...] = ()  # what was found in a user's mesh, and how
    warnings: tuple[str, ...] = ()  # what is wrong with its meshes
    bounds: Floats = field(init=False)
    _template: Surface = field(init=False, repr=False)
    _groups: tuple[_Group, ...] = field(init=False, repr=False)

    def __post_init__(self) -> None:
        names = [STATIC_GROUP] + sorted({p.group for p in self.parts} - {STATIC_GROUP})
        merged = [merge([p.surface for p in self.parts if p.group == name]) for name in names]
        template = merge(merged)
        groups, start = [], 0
        for name, part in zip(names, merged, strict=True):
            end = start + len(part.vertices)
            groups.append(_Group(name, part.vertices, part.normals, slice(start, end)))
            start = end
        for array in (template.vertices, template.normals, template.faces, template.label, template.material, template.instance):
            array.flags.writeable = False
        object.__setattr__(self, "_template", template)
        object.__setattr__(self, "_groups", tuple(groups))
        object.__setattr__(self, "seats", MappingProxyType(dict(self.seats)))
        vertices = self.surface({}).vertices
        object.__setattr__(self, "bounds", np.stack((vertices.min(axis=0), vertices.max(axis=0))).astype(np.float64))

    def setting(self, settings: Mapping[str, SeatSetting], slot: str) -> SeatSetting:
        """The setting of a slot, its default where none is given."""
        return settings.get(slot, self.seats[slot].default)

    def group_transforms(self, settings: Mapping[str, SeatSetting], *, wheel_angle: float = 0.0) -> dict[str, Matrix]:
        """`vehicle_from_group` of every group; wheel_angle: rad, positive turns to the left.

        Raises ConfigError for a slot that the cabin does not have.
        """
        for slot in settings:
            if slot not in self.seats:
                raise unknown_name("seat", slot, tuple(self.seats))
        result: dict[str, Matrix] = {STATIC_GROUP: np.eye(4)}
        for slot, seat in self.seats.items():
            setting = self.setting(settings, slot)
            result[f"seat:{slot}/base"] = base = seat.vehicle_from_seat(setting)
            result[f"seat:{slot}/back"] = back = seat._reclined(base, setting)
            result[f"seat:{slot}/headrest"] = back
        if (wheel := self.vehicle_from_wheel(wheel_angle)) is not None:
            result[WHEEL_GROUP] = wheel
        return result

    def vehicle_from_wheel(self, wheel_angle: float = 0.0) -> Matrix | None:
        """Where the parts that turn with the wheel are at an angle (rad, positive to the left); None where there is no wheel."""
        if self.steering_wheel is None:
            return None
        turn = np.eye(4)
        turn[:3, :3] = axis_rotation("z", wheel_angle)
        return np.asarray(rp.matmul(self.steering_wheel.vehicle_from_wheel, turn))

    def surface(self, settings: Mapping[str, SeatSetting] | None = None, *, wheel_angle: float = 0.0) -> Surface:
        """Everything in one surface, vehicle frame, instance 0. Its faces and classes are shared: read-only arrays."""
        transforms = self.group_transforms(settings or {}, wheel_angle=wheel_angle)
        vertices, normals = self._template.vertices.copy(), self._template.normals.copy()
        for group in self._groups[1:]:
            m = transforms[group.name].astype(np.float32)
            vertices[group.span] = rp.matmul(group.vertices, m[:3, :3].T) + m[:3, 3]
            normals[group.span] = rp.matmul(group.normals, m[:3, :3].T)
        t = self._template
        return Surface(vertices, normals, t.faces, t.label, t.material, t.instance)

    def view(self, name: str) -> ViewAnchor:
        """The anchor of a camera view; raises ConfigError with the known names for one that the cabin has not."""
        try:
            return self.views[name]
        except KeyError:
            raise unknown_name("view", name, tuple(self.views)) from None


def in_slot_order(seats: Mapping[str, Seat]) -> dict[str, Seat]:
    """The seats in the order of `OCCUPANT_SLOTS`."""
    return {slot: seats[slot] for slot in OCCUPANT_SLOTS if slot in seats}

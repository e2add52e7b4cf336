"""Dimensions of a car as lines in the 3D view: from where to where SAE J1100 measures each, found on the car that is shown."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from cabinpose.scene.cabin import Cabin, Seat

_LEG_M = 0.45  # of an angle's sides
_HEAD_ROOM_LEAN = math.radians(8.0)  # of the line along which head room is measured, rearward (H61)
_BELOW_H_M = 0.102  # where H61 counts from, on that line below the H-point
_TO_SHOULDER_M = 0.25  # above the H-point, where the trims are as far apart as at the belt line
Line = tuple[NDArray[np.float64], NDArray[np.float64]]
_ALONG, _ASIDE, _UP = np.eye(3)


def dimension_lines(cabin: Cabin, name: str, value: float) -> list[Line]:
    """The line of a dimension, or the two sides of an angle, (3,) vehicle, m; [] for those that no line shows.

    name, value: of the configuration, such as `h30_mm`. Lines begin at seats, wheel and floor of the cabin, and are as long as
    the value, or open by it: where the car follows its dimensions they end where it does.
    """
    row = "rear" if "_2_" in name else "front"
    seats = [seat for slot, seat in cabin.seats.items() if (slot.startswith("rear") == (row == "rear")) and slot != "rear_center"]
    if not seats or any(abs(seat.facing_yaw) > 1e-6 for seat in cabin.seats.values()):
        return []
    seat = next((each for each in seats if each.slot in ("driver", "rear_left")), seats[0])
    if name in ("w9_mm", "a18_deg", "l11_mm", "h17_mm"):
        return _of_wheel(cabin, seat, name, value)
    return _of_angle(seat, name.replace("_2_", "_"), value) or _of_seat(seat, name, value / 1000)


def _of_seat(seat: Seat, name: str, length: float) -> list[Line]:
    h, heel = seat.design_h_point, seat.heel_m
    side = 1.0 if h[1] >= 0 else -1.0
    lean = np.array([-math.sin(_HEAD_ROOM_LEAN), 0.0, math.cos(_HEAD_ROOM_LEAN)])
    starts = {
        "h30_mm": (h * (1, 1, 0) + heel * (0, 0, 1), _UP),
        "l53_mm": (heel * (1, 0, 1) + h * (0, 1, 0), -_ALONG),
        "w20_mm": (h * (1, 0, 1), side * _ASIDE),
        "h61_mm": (h - _BELOW_H_M * lean, lean),
        "l23_fore_mm": (h, _ALONG),
        "l23_aft_mm": (h, -_ALONG),
        "h58_mm": (h - length / 2 * _UP, _UP),
        "h25_mm": (h, _UP),
        "l50_mm": (h, -_ALONG),
        "w3_mm": (h * (1, 0, 1) + (0, -length / 2, _TO_SHOULDER_M), _ASIDE),
    }
    key = name.replace("_2_", "_")
    if key not in starts:
        return []
    start, way = starts[key]
    return [(start, start + length * way)]


def _of_angle(seat: Seat, name: str, degrees: float) -> list[Line]:
    angle, h = math.radians(degrees), seat.design_h_point
    if name == "a40_deg":
        return _angle(h, _UP, np.array([-math.sin(angle), 0.0, math.cos(angle)]))
    if name == "a27_deg":
        return _angle(h, _ALONG, np.array([math.cos(angle), 0.0, math.sin(angle)]))
    return []


def _of_wheel(cabin: Cabin, seat: Seat, name: str, value: float) -> list[Line]:
    if cabin.steering_wheel is None:
        return []
    wheel = cabin.steering_wheel.vehicle_from_wheel
    centre, up, left = wheel[:3, 3], wheel[:3, 0], wheel[:3, 1]
    if name == "a18_deg":
        return _angle(centre, _UP, up)
    if name == "w9_mm":
        return [(centre - value / 2000 * left, centre + value / 2000 * left)]
    low = seat.heel_m * (0, 0, 1) + centre * (1, 1, 0)
    if name == "h17_mm":
        return [(low, low + value / 1000 * _UP)]
    return [(low, low + value / 1000 * _ALONG)]


def _angle(at: NDArray[np.float64], one: NDArray[np.float64], other: NDArray[np.float64]) -> list[Line]:
    return [(at, at + _LEG_M * one), (at, at + _LEG_M * other)]

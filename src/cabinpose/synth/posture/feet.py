"""Where feet go: soles on pedals, flat on the floor, or hanging where the floor is out of reach."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from cabinpose.core import CABINPOSE, Floats, Matrix, invert, rotation_vector, transform
from cabinpose.core import reproducible as rp
from cabinpose.scene.body import BONE_INDEX, Person
from cabinpose.scene.cabin import Cabin, Seat
from cabinpose.synth.posture.context import SeatContext
from cabinpose.synth.posture.neighbours import is_opposite

GROUND_M = 0.002  # between a shoe and what it stands on, so that they do not share a surface
_PEDAL_M = 0.006  # between sole and pad
_HEEL_M = 0.012  # along the pad, of a heel's roundness behind the sole's end
_UP_PAD_M = 0.045  # at most, of the ball of a long foot
_ASIDE_M = {"accelerator": -0.024}  # clear of the brake, which stands proud of it
# Pads that stand nearer are pressed with the ball, the heel behind: the sole flatter (rad), off the pad and lower (m; assumed).
_PRESSED = dict.fromkeys(("brake", "clutch"), (math.radians(10.0), 0.008, 0.012))
MISS_M = 0.03  # a foot further than this from its pedal has not reached it
_TOE_OUT = np.radians(7.0)
# Weights along and about the sole's axes, 1/m and 1/rad. A foot on the floor may stand elsewhere, but on the floor.
_ON_PEDAL = np.array([5.0, 4.0, 5.0, 0.1, 0.05, 0.02])  # the sole leans off a pad rather than the ankle bends to its limit
_STANDING = np.array([1.5, 1.5, 6.0, 0.4, 0.4, 0.15])
_HANGING = np.array([0.6, 0.6, 0.6, 0.02, 0.02, 0.02])
LEG_STIFFNESS = np.array([0.004, 0.02, 0.02, 0.0005, 0.002, 0.03])  # 1/rad, of departing from the comfortable leg
_PEDAL_LEG_STIFFNESS = np.array([0.004, 0.02, 0.02, 0.0005, 0.03, 0.03])  # an ankle that is not bent to its limit
_FREE_KNEE = np.radians((75.0, 7.0, -4.0, 75.0, -5.0, 0.0))
_PEDAL_KNEE = np.radians((70.0, 9.0, -5.0, 60.0, 5.0, 0.0))
_KNEE_OUT = np.array((0.0, 1.0, -0.7, 0.0, 0.0, 0.0))  # abduction, and the rotation that keeps the foot in its place (assumed)
_BESIDE_PITCH = math.radians(22.0)  # of a driver's sole on its heel on the floor
_SHIN_LEAN = math.radians(24.0)  # of a foot drawn back: a shin that would lean back further lets the knee rise instead
_FLAT_LEAN = math.radians(25.0)  # of a shin; the sole of one that leans back further rises from the floor, but for the heel
_HEEL_BACK_M = 0.015  # of the skin, behind the sole's origin
# Of what a front seat stands on behind its H-point: feet go under the rear of a high seat, not of a low one.
_SEAT_BASE_M = (0.10, 0.20)
_HIGH_SEAT_M = 0.25  # of an H-point above the floor
_FOOT_SHARE = 0.155  # length of a shoe, of the stature
_SHORT_OF_HEEL_M = 0.02  # what is before a seat's heel point (toe board, front seat) leaves no more
_KNEES_OUT_M = 0.03  # feet from below the hips to the sides
_SHOE_M, _HALF_SHOE_M = 0.12, 0.055  # with what is between two of them
_TOE_GAP_M = 0.01  # from the middle between two who face each other
_HANGING_SHIN = rp.arcsin(0.12)  # before the vertical, rad
_STRETCHED = 0.9  # sine of the angle of a shin over the edge of a cushion, at most
_SHIN_BEHIND = 0.015  # how far an ankle may stand behind the knee: what the seat's base leaves


class FootPlan(NamedTuple):
    """One foot's intent: pedal name or None for the floor; the rest moves a foot on the floor, but for the knee.

    forward: m, from where it would rest · out: m, to the side of the hip · toe_out: rad · knee_out: rad, by which the comfortable
    thigh turns out · lean: rad, how far back a shin may lean before the knee rises from the cushion instead · across: m, how far
    an ankle is past the body's middle, None where legs are not crossed.
    """

    pedal: str | None = None
    forward: float = 0.0
    out: float = 0.0
    toe_out: float = float(_TOE_OUT)
    knee_out: float = 0.0
    lean: float = _SHIN_LEAN
    across: float | None = None


class FootGoal(NamedTuple):
    """Where a foot goes: foot_from_tool and vehicle_from_target (4, 4), weights (6,), the comfortable leg (6,) rad.

    must: a foot that misses its place by more than `MISS_M` makes the pose impossible · stiffness: (6,) 1/rad, of departing from
    the comfortable leg.
    """

    tool: Matrix
    target: Matrix
    weight: Floats
    prior: Floats
    must: bool
    stiffness: Floats = LEG_STIFFNESS


def _on_pedal(person: Person, side: int, pad: Matrix, floor_z: float, plan: FootPlan) -> FootGoal:
    """The ball of a foot on a pad (vehicle_from_pad), sole along it and heel on the floor.

    The foot slides down the pad by what it is shorter than the 200 mm from heel to ball of SAE J4004.
    """
    tool = person.rest.soles[side].copy()
    ball = float(person.rest.joint_offset[CABINPOSE.index["lr"[side] + "foot"], 0] - tool[0, 3])
    tool[0, 3] += ball
    along, out = pad[:3, 0], pad[:3, 2]
    to_floor = (pad[2, 3] - floor_z) / max(along[2], 1e-6)  # along the pad, from its origin to the floor
    target = pad.copy()
    pressed, off, lower = _PRESSED.get(plan.pedal or "", (0.0, 0.0, 0.0))
    target[:3, :3] = rp.matmul(pad[:3, :3], rotation_vector((0.0, pressed, 0.0)))
    target[:3, 3] += (_PEDAL_M + off) * out - lower * along
    target[:3, 3] += min(ball - to_floor + _HEEL_M, _UP_PAD_M) * along + _ASIDE_M.get(plan.pedal or "", 0.0) * pad[:3, 1]
    leg = _turned_out(_PEDAL_KNEE, plan)
    return FootGoal(tool, target, _ON_PEDAL, leg, True, stiffness=_PEDAL_LEG_STIFFNESS)


def _on_floor(seated: SeatContext, root: Matrix, side: int, plan: FootPlan) -> FootGoal:
    """A foot flat on the floor before the seat, with the thigh on the cushion where the legs allow it.

    Where the shin is longer than the cushion is high the foot goes forward, up to a little past the seat's heel
    point, and the knee rises; where it is shorter the foot hangs.
    """
    person, seat, setting, fit = seated.person, seated.seat, seated.setting, seated.fit
    s, ahead = 1.0 - 2.0 * side, _room_ahead(seat, seated.cabin, seated.neighbours.faced)
    vehicle_from_seat = seat.vehicle_from_seat(setting)
    seat_from_vehicle = invert(vehicle_from_seat)
    hip_half = float(person.rest.offsets[BONE_INDEX["lthigh"], 1])
    hip = (rp.matmul(seat_from_vehicle, root, np.array([0.0, s * hip_half, 0.0, 1.0])))[:3]
    lengths = person.segment_lengths
    knee = hip + lengths["thigh"] * np.array([rp.cos(fit.thigh_angle), 0.0, rp.sin(fit.thigh_angle)])
    sole = person.rest.soles[side]
    ankle_height = GROUND_M - float(sole[2, 3])
    floor = seat.floor_z - vehicle_from_seat[2, 3]
    drop = knee[2] - floor - ankle_height
    heel_x = float((rp.matmul(seat_from_vehicle[:3, :3], seat.heel_point(setting) - vehicle_from_seat[:3, 3]))[0])
    reach = min(heel_x - _SHORT_OF_HEEL_M, ahead - _FOOT_SHARE * person.stature_m) - float(sole[0, 3])  # of the ankle
    shin = lengths["shin"]
    hangs = drop >= shin or fit.edge_m > knee[0]  # the floor is out of reach
    if hangs:
        over = min(max((fit.edge_m - knee[0]) / shin, 0.0), _STRETCHED)  # the edge of a cushion that goes on below the shins
        swing = max(_HANGING_SHIN, rp.arcsin(over), rp.arccos(min(drop / shin, 1.0)))
        ankle = knee + np.array([rp.sin(swing) * shin + plan.forward, 0.0, -shin * min(rp.cos(swing), 0.99)])
        pitch = math.radians(12.0) if swing == _HANGING_SHIN else -0.7 * swing
    else:
        lean = min(np.sqrt(shin * shin - drop * drop), rp.sin(plan.lean) * shin)
        farthest = max(reach, knee[0] - _SHIN_BEHIND)
        ankle_x = max(min(knee[0] + lean + plan.forward, farthest), knee[0] - _SHIN_BEHIND)
        pitch = -max(rp.arcsin(min(max((ankle_x - knee[0]) / shin, 0.0), 1.0)) - _FLAT_LEAN, 0.0)
        ankle = np.array([ankle_x, 0.0, floor + ankle_height])
    rotation = rp.matmul(rotation_vector((0.0, 0.0, s * plan.toe_out)), rotation_vector((0.0, pitch, 0.0)))
    if plan.across is None:
        ankle[1] = _between(s * (hip_half + _KNEES_OUT_M + plan.out), side, seated.neighbours.feet)
    else:
        ankle[1] = -s * plan.across
    place = ankle + rp.matmul(rotation, sole[:3, 3])
    if not hangs:  # on the heel
        place[2] = floor + GROUND_M - _HEEL_BACK_M * rp.sin(pitch)
    target = rp.matmul(vehicle_from_seat, transform(rotation, place))
    return FootGoal(sole, target, _HANGING if hangs else _STANDING, _turned_out(_FREE_KNEE, plan), False)


def _turned_out(leg: Floats, plan: FootPlan) -> Floats:
    """The comfortable leg (6,) rad with its knee out: the thigh goes aside, and turns for the foot to stay."""
    return leg + plan.knee_out * _KNEE_OUT


def _beside_pedals(seated: SeatContext, side: int, plan: FootPlan) -> FootGoal:
    """A driver's foot on the floor behind the pedals, on its heel: under the wheel there is no room for knees that rise."""
    pads, seat = seated.cabin.pedals, seated.seat
    beside = pads.get("footrest", pads["accelerator"])
    heel = beside[:3, 3] - (beside[2, 3] - seat.floor_z) / max(beside[2, 0], 1e-6) * beside[:3, 0]
    s = 1.0 - 2.0 * side
    rotation = rp.matmul(rotation_vector((0.0, 0.0, s * plan.toe_out)), rotation_vector((0.0, -_BESIDE_PITCH, 0.0)))
    place = heel + (plan.forward, -s * plan.out, GROUND_M + _HEEL_BACK_M * rp.sin(_BESIDE_PITCH))
    return FootGoal(seated.person.rest.soles[side], transform(rotation, place), _STANDING, _turned_out(_PEDAL_KNEE, plan), False)


def _between(y: float, side: int, room: tuple[float, float]) -> float:
    """The place (m, + left) of an ankle that would be at y, and the other one's beside it, in the room that neighbours leave."""
    left, right = room[0] - _HALF_SHOE_M, room[1] - _HALF_SHOE_M
    y = min(max(y, -right), left)
    return max(y, _SHOE_M - right) if side == 0 else min(y, left - _SHOE_M)


def foot_goals(seated: SeatContext, root: Matrix, plans: tuple[FootPlan, FootPlan]) -> tuple[FootGoal, FootGoal]:
    """Goals of both feet.

    Parameters
    ----------
    seated
        Who sits where. Where somebody sits opposite toes stay on the own side of the middle.
    root
        `vehicle_from_root`, (4, 4).
    plans
        What the left and the right foot do.
    """
    result = []
    for side, plan in enumerate(plans):
        if plan.pedal is not None:
            result.append(_on_pedal(seated.person, side, seated.cabin.pedals[plan.pedal], seated.seat.floor_z, plan))
        elif drives(seated.seat, seated.cabin):
            result.append(_beside_pedals(seated, side, plan))
        else:
            own = plan._replace(forward=min(plan.forward, 0.0)) if seated.neighbours.faced else plan
            result.append(_on_floor(seated, root, side, own))
    return result[0], result[1]


def _room_ahead(seat: Seat, cabin: Cabin, faced: bool) -> float:
    """How far (m) toes may reach ahead of the H-point before they meet those opposite, or the base of the seat in front."""
    if faced:
        away = [abs(float(o.design_h_point[0] - seat.design_h_point[0])) for o in cabin.seats.values() if is_opposite(seat, o)]
        return 0.5 * min(away, default=math.inf) - _TOE_GAP_M
    if not seat.slot.startswith("rear") or "driver" not in cabin.seats or cabin.seats["driver"].facing_yaw != seat.facing_yaw:
        return math.inf
    front = cabin.seats["driver"].design_h_point
    return float(front[0] - seat.design_h_point[0]) - _SEAT_BASE_M[0 if front[2] > _HIGH_SEAT_M else 1]


def drives(seat: Seat, cabin: Cabin) -> bool:
    """Whether the feet of who sits here are at the pedals."""
    return seat.foot_support == "pedals" and "accelerator" in cabin.pedals


def default_plans(seat: Seat, cabin: Cabin) -> tuple[FootPlan, FootPlan]:
    """Driver: left on the footrest, right on the accelerator; everyone else: both on the floor."""
    if not drives(seat, cabin):
        return FootPlan(), FootPlan()
    left = "footrest" if "footrest" in cabin.pedals else None
    return FootPlan(left), FootPlan("accelerator")

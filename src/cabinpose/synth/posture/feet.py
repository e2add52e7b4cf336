"""Where feet go: soles on pedals, flat on the floor, or hanging where the floor is out of reach."""

from __future__ import annotations

import math
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from cabinpose._native import pose as native
from cabinpose.core.errors import SceneError
from cabinpose.core.frames import Matrix, invert, rotation_vector, transform
from cabinpose.core.skeleton import INDEX
from cabinpose.scene.body import Person
from cabinpose.scene.body.kinematics import RestArrays
from cabinpose.scene.body.rig import BONE_INDEX
from cabinpose.scene.cabin import Cabin, Seat, SeatSetting
from cabinpose.synth.posture.chain import Residual
from cabinpose.synth.posture.limbs import LimbTask, frames, solve_leg
from cabinpose.synth.posture.room import Room
from cabinpose.synth.posture.seat_fit import SeatFit

Array = NDArray[np.float64]

GROUND_M = 0.002  # between a shoe and what it stands on, so that they do not share a surface
_PEDAL_M = 0.006  # between sole and pad
_ASIDE_M = {"accelerator": -0.024}  # clear of the brake, which stands proud of it
MISS_M = 0.03  # a foot further than this from its pedal has not reached it
_TOE_OUT = np.radians(7.0)
_STIFFNESS = np.array([0.004, 0.02, 0.02, 0.0005, 0.002, 0.01])
_FREE_KNEE = np.radians((75.0, 7.0, -4.0, 75.0, -5.0, 0.0))
_PEDAL_KNEE = np.radians((70.0, 9.0, -5.0, 60.0, 5.0, 0.0))
_SHIN_LEAN = math.sin(math.radians(24.0))  # a shin that leans back further lets the knee rise from the cushion instead
_SEAT_BASE_M = (
    0.10,
    0.20,
)  # of what a front seat stands on behind its H-point: feet go under the rear of a high seat, not of a low one
_HIGH_SEAT_M = 0.25  # of an H-point above the floor
_FEET_CLOSER_M = 0.05  # a foot that is pushed further drives the other one before it
_FOOT_SHARE = 0.155  # length of a shoe, of the stature
_SHORT_OF_HEEL_M = 0.02  # what is before a seat's heel point (toe board, front seat) leaves no more
_KNEES_OUT_M = 0.03  # feet from below the hips to the sides
_TOE_GAP_M = 0.01  # from the middle between two who face each other
_TUNNEL_AHEAD_M = 1.0  # of the rearmost seat, where feet stand
_LEG_ROUNDS, _LEG_SQUEEZE_M = 3, 0.008
_SHIN_BEHIND = 0.015  # how far an ankle may stand behind the knee: what the seat's base leaves


class FootPlan(NamedTuple):
    """One foot's intent: pedal name or None for the floor; the rest moves a foot on the floor.

    forward: m, from where it would rest · out: m, to the side of the hip · toe_out: rad.
    """

    pedal: str | None = None
    forward: float = 0.0
    out: float = 0.0
    toe_out: float = float(_TOE_OUT)


def _ball_frames(rest: RestArrays) -> tuple[RestArrays, tuple[float, float]]:
    """The rest arrays with the tool of a leg below the ball of the foot, and the lengths heel to ball."""
    soles = rest.soles.copy()
    lengths = []
    for side, joint in enumerate(("lfoot", "rfoot")):
        length = rest.joint_offset[INDEX[joint], 0] - soles[side, 0, 3]
        soles[side, 0, 3] += length
        lengths.append(float(length))
    return rest._replace(soles=soles), (lengths[0], lengths[1])


def on_pedal(q: Array, person: Person, root: Matrix, side: int, pad: Matrix, floor_z: float, aside: float = 0.0) -> Residual:
    """Put the ball of a foot on a pad (vehicle_from_pad), sole along it and heel on the floor, in place of q.

    The foot slides down the pad by what it is shorter than the 200 mm from heel to ball of SAE J4004, and stands `aside` m
    to the left of its middle.
    """
    rest, lengths = _ball_frames(person.rest)
    along, out = pad[:3, 0], pad[:3, 2]
    to_floor = (pad[2, 3] - floor_z) / max(along[2], 1e-6)  # along the pad, from its origin to the floor
    target = pad.copy()
    target[:3, 3] += _PEDAL_M * out
    target[:3, 3] += min(lengths[side] - to_floor, 0.03) * along + aside * pad[:3, 1]
    weights = np.array([5.0, 4.0, 5.0]), np.array([0.05, 0.06, 0.05])
    return solve_leg(q, rest, root, side, LimbTask(target, *weights, _PEDAL_KNEE, _STIFFNESS))


def on_floor(
    q: Array, person: Person, root: Matrix, side: int, seat: Seat, setting: SeatSetting, fit: SeatFit, plan: FootPlan,
    room: Room, *, ahead: float = math.inf, crowded: bool = False,
) -> tuple[Residual, float]:  # fmt: skip
    """Put a foot flat on the floor before the seat, in place of q, with the thigh on the cushion where the legs allow it.

    Where the shin is longer than the cushion is high the foot goes forward, up to a little past the seat's heel
    point, and the knee rises; where it is shorter the foot hangs, and nothing is missed. A foot in the tunnel or the door
    moves aside, and among close neighbours (`crowded`) so does the whole leg. `ahead` is what toes have before they meet
    a seat's base (m).
    Returns the residual and the shift to the left (m).
    """
    s = 1.0 - 2.0 * side
    vehicle_from_seat = seat.vehicle_from_seat(setting)
    seat_from_vehicle = invert(vehicle_from_seat)
    hip_half = float(person.rest.offsets[BONE_INDEX["lthigh"], 1])
    hip = (seat_from_vehicle @ root @ np.array([0.0, s * hip_half, 0.0, 1.0]))[:3]
    lengths = person.segment_lengths
    knee = hip + lengths["thigh"] * np.array([np.cos(fit.thigh_angle), 0.0, np.sin(fit.thigh_angle)])
    sole = person.rest.soles[side]
    ankle_height = GROUND_M - float(sole[2, 3])
    floor = seat.floor_z - vehicle_from_seat[2, 3]
    drop = knee[2] - floor - ankle_height
    heel_x = float((seat_from_vehicle[:3, :3] @ (seat.heel_point(setting) - vehicle_from_seat[:3, 3]))[0])
    reach = min(heel_x - _SHORT_OF_HEEL_M, ahead - _FOOT_SHARE * person.stature_m) - float(sole[0, 3])  # of the ankle
    shin = lengths["shin"]
    if drop >= shin:  # the floor is out of reach
        ankle = knee + np.array([0.12 * shin + plan.forward, 0.0, -shin * 0.99])
        pitch, fixed = np.radians(12.0), 0.2
    else:
        lean = min(np.sqrt(shin * shin - drop * drop), _SHIN_LEAN * shin)
        ankle_x = min(knee[0] + lean, max(reach, knee[0] - _SHIN_BEHIND))
        ankle = np.array([max(ankle_x + plan.forward, knee[0] - _SHIN_BEHIND), 0.0, floor + ankle_height])
        pitch, fixed = 0.0, 1.0
    rotation = rotation_vector((0.0, 0.0, s * plan.toe_out)) @ rotation_vector((0.0, pitch, 0.0))
    ankle[1] = s * (hip_half + _KNEES_OUT_M + plan.out)
    target = vehicle_from_seat @ transform(rotation, ankle + rotation @ sole[:3, 3])
    in_the_middle = abs(float(seat.design_h_point[1])) < 0.05  # feet stand on both sides of the tunnel
    aside = 0.0 if in_the_middle else native.foot_aside(room, target, side)
    target[1, 3] += aside
    rotations = np.array([0.06, 0.06, 0.04]) * fixed
    task = LimbTask(target, np.full(3, 4.0), rotations, _FREE_KNEE, _STIFFNESS)
    residual = solve_leg(q, person.rest, root, side, task)
    for _ in range(_LEG_ROUNDS if crowded else 0):
        shift = native.leg_aside(room, q, person.rest, root, side)
        if abs(shift) < _LEG_SQUEEZE_M:
            break
        aside += shift
        task.target[1, 3] += shift
        residual = solve_leg(q, person.rest, root, side, task)
    if drop >= shin:
        return Residual(0.0, 0.0), aside
    if frames(q, person.rest, root).soles[side][2, 0] < -0.01:  # the ankle gives no more: the heel lifts, not the toes sink
        rest, ball = _ball_frames(person.rest)
        task.target[:3, 3] += ball[side] * task.target[:3, 0]
        residual = solve_leg(q, rest, root, side, task)
    return residual, aside


def place_feet(
    q: Array, person: Person, root: Matrix, seat: Seat, setting: SeatSetting, fit: SeatFit, cabin: Cabin,
    plans: tuple[FootPlan, FootPlan], room: Room, *, faced: bool = False, crowded: bool = False,
) -> dict[str, float]:  # fmt: skip
    """Solve both legs in q, in place; returns what each foot misses its place by (m).

    faced: somebody sits opposite, so that toes stay on the own side · crowded: people sit close beside.
    Raises SceneError where a foot does not reach its pedal.
    """
    missed, pushed = {}, 0.0
    towards_middle = 1.0 if seat.design_h_point[1] < 0.0 else -1.0
    first = 0 if towards_middle * math.cos(seat.facing_yaw) > 0.0 else 1  # the inner foot makes room for the tunnel
    for side in (first, 1 - first):
        plan, name = plans[side], "lr"[side] + "foot"
        if plan.pedal is None:
            outer = max(-towards_middle * pushed - _FEET_CLOSER_M, 0.0)
            plan = plan._replace(forward=min(plan.forward, 0.0) if faced else plan.forward, out=plan.out + outer)
            ahead = _room_ahead(seat, cabin, faced)
            residual, pushed = on_floor(q, person, root, side, seat, setting, fit, plan, room, ahead=ahead, crowded=crowded)
        else:
            residual = on_pedal(q, person, root, side, cabin.pedals[plan.pedal], seat.floor_z, _ASIDE_M.get(plan.pedal, 0.0))
            if residual.position > MISS_M:
                raise SceneError(
                    f"{name} of a person of {person.stature_m:.2f} m misses the {plan.pedal} by {1e3 * residual.position:.0f} mm"
                    f" in the {seat.slot} seat of the {cabin.name}",
                    hint="choose a taller person for this seat, or one with a wider fore-aft range",
                )
        missed[name] = residual.position
    return missed


def _room_ahead(seat: Seat, cabin: Cabin, faced: bool) -> float:
    """How far (m) toes may reach ahead of the H-point before they meet those opposite, or the base of the seat in front."""
    if faced:
        away = [abs(float(o.design_h_point[0] - seat.design_h_point[0])) for o in cabin.seats.values() if is_opposite(seat, o)]
        return 0.5 * min(away, default=math.inf) - _TOE_GAP_M
    if not seat.slot.startswith("rear") or "driver" not in cabin.seats or cabin.seats["driver"].facing_yaw != seat.facing_yaw:
        return math.inf
    front = cabin.seats["driver"].design_h_point
    return float(front[0] - seat.design_h_point[0]) - _SEAT_BASE_M[0 if front[2] > _HIGH_SEAT_M else 1]


@lru_cache(maxsize=32)
def tunnel_m(cabin: Cabin) -> float:
    """Height of the floor's tunnel along the centre line over the floor beside it, m; 0 in a car without a part "floor"."""
    floor = next((p.surface.vertices for p in cabin.parts if p.name == "floor"), None)
    if floor is None:
        return 0.0
    rear = min(float(s.design_h_point[0]) for s in cabin.seats.values())
    before = (floor[:, 0] > rear) & (floor[:, 0] < rear + _TUNNEL_AHEAD_M)
    across = np.abs(floor[:, 1])
    middle, beside = floor[before & (across < 0.05), 2], floor[before & (across > 0.2) & (across < 0.5), 2]
    return float(middle.max() - np.median(beside)) if len(middle) and len(beside) else 0.0


def is_opposite(seat: Seat, other: Seat) -> bool:
    """Whether two seats face each other."""
    ahead = math.cos(seat.facing_yaw) * float(other.design_h_point[0] - seat.design_h_point[0])
    return math.cos(seat.facing_yaw - other.facing_yaw) < -0.5 and ahead > 0.0


def default_plans(seat: Seat, cabin: Cabin) -> tuple[FootPlan, FootPlan]:
    """Driver: left on the footrest, right on the accelerator; everyone else: both on the floor."""
    if seat.foot_support != "pedals" or "accelerator" not in cabin.pedals:
        return FootPlan(), FootPlan()
    left = "footrest" if "footrest" in cabin.pedals else None
    return FootPlan(left), FootPlan("accelerator")

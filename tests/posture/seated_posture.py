"""A neutral posture: one body in one seat, head level, feet on pedals or floor, hands on the wheel or in the lap."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from cabinpose.core.errors import SceneError
from cabinpose.core.frames import Matrix
from cabinpose.scene.body import DOF_INDEX, Person
from cabinpose.scene.cabin import Cabin, Seat, SeatSetting
from cabinpose.synth.posture.context import SeatContext, Trunk
from cabinpose.synth.posture.feet import MISS_M, default_plans, foot_goals
from cabinpose.synth.posture.frames import frames
from cabinpose.synth.posture.gaze import head_rotation
from cabinpose.synth.posture.goals import TASKS, HandGoal, sitter
from cabinpose.synth.posture.hands import RIM_MISS_M, lying, on_rim, on_thigh, rim_grip
from cabinpose.synth.posture.seat_fit import SeatFit
from cabinpose.synth.posture.solver import solve

Array = NDArray[np.float64]
Hands = Literal["wheel", "lap"]

REST_GRIP = 0.06  # of the fingers' curl
_FLAT = np.array([REST_GRIP] * 5 + [1.1 * REST_GRIP])
_LAP_ALONG, _LAP_INWARD = 0.69, 0.02
_LEVEL_PITCH = np.radians(-4.0)


@dataclass(frozen=True, eq=False)
class SeatedPosture:
    """A person sitting: q (D,) rad within the limits, vehicle_from_root (4, 4), and what was missed.

    residuals_m: "h_point" (how far the femur heads' middle is from the seat's H-point), "lfoot", "rfoot", "lhand",
    "rhand" (m) · fit: trunk and thighs in the seat's frame.
    """

    q: Array
    vehicle_from_root: Matrix
    residuals_m: Mapping[str, float]
    fit: SeatFit


def solve_posture(
    person: Person, seat: Seat, setting: SeatSetting, cabin: Cabin, *, hands: Hands | None = None, wheel_angle: float = 0.0
) -> SeatedPosture:
    """The neutral posture of a person in a seat: back on the backrest, head level, feet on pedals or floor.

    hands: "wheel" (nine and three) or "lap"; left out: the wheel for a driver. Raises SceneError where the pedals or
    the wheel are out of reach, ConfigError for a setting out of range or other hands.
    """
    seat.check(setting)
    has_wheel = seat.slot == "driver" and cabin.steering_wheel is not None
    hands = hands or ("wheel" if has_wheel else "lap")
    seated = SeatContext(person, seat, setting, cabin)
    root, q = seated.vehicle_from_root(0.0), seated.fit.q.copy()
    feet = foot_goals(seated, root, default_plans(seat, cabin))
    trunk = Trunk(seated, q, root, frames(q, person.rest, root), wheel_angle)
    palms, holds = [], hands == "wheel"
    for side in (0, 1):
        if holds:
            if cabin.steering_wheel is None or not has_wheel:
                raise SceneError(f"the {seat.slot} seat of the {cabin.name} has no steering wheel")
            hold = rim_grip(person, cabin.steering_wheel.rim_section_m)
            q[DOF_INDEX["lr"[side] + "hand.grip"]] = hold.grip
            task = on_rim(cabin.steering_wheel, wheel_angle + (np.pi / 2 if side == 0 else -np.pi / 2), hold, 0.5, side)
            palms.append(HandGoal(task, holds_wheel=True))
        else:
            q[DOF_INDEX["lr"[side] + "hand.grip"]] = REST_GRIP
            lies = lying(person, _FLAT)
            task = on_thigh(trunk, side, _LAP_ALONG, _LAP_INWARD, 0.45, lies)
            palms.append(HandGoal(task, "lr"[side] + "thigh"))
    head = head_rotation(seat.facing_yaw, _LEVEL_PITCH)
    who = sitter(trunk, (palms[0], palms[1]), feet, head)
    (left,) = solve([who], None)
    missed = dict(zip(TASKS, left.missed[:, 0].tolist(), strict=True))
    missed["h_point"] = float(np.linalg.norm(who.root[:3, 3] - seat.h_point(setting)))
    for side, name in enumerate(("lhand", "rhand")):
        if holds and missed[name] > RIM_MISS_M:
            raise SceneError(f"{name} misses the steering wheel by {1e3 * missed[name]:.0f} mm")
        foot = TASKS[2 + side]
        if feet[side].must and missed[foot] > MISS_M:
            raise SceneError(f"{foot} misses the pedals by {1e3 * missed[foot]:.0f} mm")
    return SeatedPosture(who.q, who.root, missed, seated.fit)

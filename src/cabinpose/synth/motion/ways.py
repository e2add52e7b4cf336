"""The ways of one person between two poses: straight in joint angles, or through poses that the whole-body solver finds.

Hands that hold something of the car open and come off it before they go anywhere, and come to it open.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import NamedTuple, Protocol

import numpy as np

from cabinpose.core import CABINPOSE, Floats, Matrix, invert, nearest_rigid, transform
from cabinpose.core import reproducible as rp
from cabinpose.scene.body import DOF_INDEX, Person, by_phalanx
from cabinpose.scene.cabin import Cabin, SteeringWheel
from cabinpose.synth.motion.track import Pose, Track
from cabinpose.synth.posture.goals import between as on_the_way
from cabinpose.synth.posture.goals import turning_freely
from cabinpose.synth.posture.grasps import OPEN_HAND
from cabinpose.synth.posture.solver import Sitter, solve
from cabinpose.synth.validate import Seated

_OFF_M, _BACK_M = 0.04, 0.12  # of a hand that has just let go: along the palm's normal, and along the wheel's axis
_NEAR_RIM_M, _MOVES_M = 0.16, 0.16  # of a palm's origin from the rim's axis; by which a hand goes somewhere else
_LOW_M, _LIFTED_M = 0.35, 0.10  # over the pelvis, of hands in a lap; by which they are lifted before they go anywhere
_PELVIS = CABINPOSE.index["hip"]
_OPEN, _SPREAD = 0.05, 0.5  # its grip, and its fingers
HELD_M = 0.03  # a palm that is nearer than this to where it was on the rim has not let go
_GRIP = tuple(DOF_INDEX[side + "hand.grip"] for side in "lr")


class Goal(NamedTuple):
    """A pose, and what its hands hold: the wheel, or anything of the car that fingers are around.

    via: from which a hand comes to a thing in another hand, and to which it leaves it.
    """

    pose: Pose
    holds: tuple[bool, bool]
    closed: tuple[bool, bool]
    via: Pose | None = None


class Around(Protocol):
    """What is around somebody: the car, and the others at a time."""

    cabin: Cabin

    def empty(self, wheel_angle: float) -> Seated:
        """The car with nobody in it."""
        ...

    def sitters(self, slot: str, time_s: float) -> list[Sitter]:
        """Everybody but one, as the solver sees them."""
        ...


class Ways:
    """The ways of the person in a seat's slot."""

    def __init__(self, slot: str, person: Person, around: Around) -> None:
        self._slot, self._person, self._around = slot, person, around

    def between(self, track: Track, now: Goal, goal: Goal, interior: int, time_s: float) -> Floats:
        """(K, 83) states from one pose to another, with poses in between that the solver finds.

        Hands that let go open and come off what they hold before they go anywhere; those that take hold come to it open.
        """
        leaving, after = self._let_go(now, goal, time_s, wary=interior > 0)
        _, before = self._let_go(goal, now, time_s, wary=interior > 0)
        first, last = (after or [now.via or now.pose])[-1], (before or [goal.via or goal.pose])[-1]
        ends = track.state_of(first), track.state_of(last)
        kept = [a and b and side not in leaving for side, (a, b) in enumerate(zip(now.holds, goal.holds, strict=True))]
        states = [track.state_of(pose) for pose in (now.pose, *([now.via] if now.via else []), *after)]
        sitters = self._around.sitters(self._slot, time_s) if interior else []
        for share in np.linspace(0.0, 1.0, interior + 2)[1:-1].tolist():
            straight = track.pose_of((1.0 - share) * ends[0] + share * ends[1])
            palms = [self._on_rim(side, now, goal, straight, share) if kept[side] else None for side in (0, 1)]
            seat = self._around.cabin.seats[self._slot]
            soles = self._soles(first, last, share)
            who = on_the_way(
                self._person, seat, straight.q, straight.root, (palms[0], palms[1]), soles, (kept[0], kept[1])
            )  # fmt: skip
            solve([who, *sitters], self._around.empty(straight.wheel_angle).placed)
            states.append(track.state_of(straight._replace(q=who.q, root=who.root)))
        states += [track.state_of(pose) for pose in (*before[::-1], *([goal.via] if goal.via else []), goal.pose)]
        return np.stack(states)

    def _let_go(self, at: Goal, other: Goal, time_s: float, *, wary: bool) -> tuple[set[int], list[Pose]]:
        """Which hands of a pose leave what they hold, on the way to or from another one, and the poses in which they do so.

        wary: hands that are near the rim, but do not hold it, are drawn back from it too, and those in a lap are lifted.
        """
        wheel = self._around.cabin.steering_wheel if self._slot == "driver" else None
        body, theirs = (self._person.pose(goal.pose.q, goal.pose.root) for goal in (at, other))
        palms = [body.palms[side] for side in "lr"]
        sides = {side for side in (0, 1) if at.closed[side] and not self._stays(side, at, other)}
        by = {side: -_OFF_M * palms[side][:3, 2] for side in sides}
        moves = [side for side, s in enumerate("lr") if rp.norm(palms[side][:3, 3] - theirs.palms[s][:3, 3]) > _MOVES_M]
        for side in moves if wary else ():
            low = palms[side][2, 3] - body.joints[_PELVIS, 2] < _LOW_M
            if wheel is None and low:
                by[side] = np.array((0.0, 0.0, _LIFTED_M))
            elif wheel is not None and not at.closed[side] and rim_distance(wheel, palms[side][:3, 3]) < _NEAR_RIM_M:
                by[side] = _BACK_M * wheel.vehicle_from_wheel[:3, 2]
        if wheel is not None:  # towards the driver
            by |= {side: by[side] + _BACK_M * wheel.vehicle_from_wheel[:3, 2] for side in sides if at.holds[side]}
        if not by or at.via is not None:
            return sides, []
        opened = at.pose._replace(q=at.pose.q.copy(), fingers=_opened(at.pose, sides))
        opened.q[[_GRIP[side] for side in sides]] = _OPEN
        off = self.aside(at, by, time_s, opened)
        return sides, [opened, off] if sides else [off]

    def _stays(self, side: int, one: Goal, two: Goal) -> bool:
        """Whether a hand holds the wheel at the same place of its rim in two poses."""
        wheel = self._around.cabin.steering_wheel
        if wheel is None or not (one.holds[side] and two.holds[side]):
            return False
        local = [self._in_wheel(side, goal.pose) for goal in (one, two)]
        return bool(rp.norm(local[0][:3, 3] - local[1][:3, 3]) < HELD_M)

    def _in_wheel(self, side: int, pose: Pose) -> Matrix:
        """`wheel_from_palm` (4, 4) of a pose, of the wheel as it is turned there."""
        vehicle_from_wheel = self._around.cabin.vehicle_from_wheel(pose.wheel_angle)
        assert vehicle_from_wheel is not None  # of who holds one
        return rp.matmul(invert(vehicle_from_wheel), self._person.pose(pose.q, pose.root).palms["lr"[side]])

    def _on_rim(self, side: int, now: Goal, goal: Goal, between: Pose, share: float) -> Matrix:
        """Where a palm is on its way that goes along with the rim."""
        vehicle_from_wheel = self._around.cabin.vehicle_from_wheel(between.wheel_angle)
        assert vehicle_from_wheel is not None
        mixed = _mixed(self._in_wheel(side, now.pose), self._in_wheel(side, goal.pose), share)
        return rp.matmul(vehicle_from_wheel, mixed)

    def aside(self, goal: Goal, by: Mapping[int, Floats], time_s: float, opened: Pose | None = None) -> Pose:
        """The pose near one in which hands, by side, are `by` (3,) m from where they were.

        opened: the same pose with hands that have let go and turn as they like.
        """
        pose = opened or goal.pose
        body = self._person.pose(pose.q, pose.root)
        palms = [body.palms[s] if goal.holds[hand] or opened is not None else None for hand, s in enumerate("lr")]
        for side, way in by.items():
            palms[side] = rp.matmul(transform(None, way), body.palms["lr"[side]])
        near = on_the_way(
            self._person, self._around.cabin.seats[self._slot], pose.q, pose.root, (palms[0], palms[1]),
            (body.soles["l"], body.soles["r"]), (goal.holds[0] and 0 not in by, goal.holds[1] and 1 not in by),
        )  # fmt: skip
        if opened is not None:
            near = turning_freely(near, by)
        solve([near, *self._around.sitters(self._slot, time_s)], self._around.empty(pose.wheel_angle).placed)
        return pose._replace(q=near.q, root=near.root)

    def _soles(self, start: Pose, end: Pose, share: float) -> tuple[Matrix, Matrix]:
        one, two = (self._person.pose(pose.q, pose.root) for pose in (start, end))
        return _mixed(one.soles["l"], two.soles["l"], share), _mixed(one.soles["r"], two.soles["r"], share)


def rim_distance(wheel: SteeringWheel, point: Floats) -> float:
    """m, of a point (3,) from the axis of a wheel's rim."""
    local = rp.matmul(wheel.vehicle_from_wheel[:3, :3].T, point - wheel.vehicle_from_wheel[:3, 3])
    return float(rp.hypot(rp.hypot(local[0], local[1]) - wheel.rim_radius_m, local[2]))


def _opened(pose: Pose, sides: Iterable[int]) -> Floats:
    """(2, 16) the fingers of a pose, those of some hands wide open."""
    fingers = np.full((2, 16), np.nan) if pose.fingers is None else by_phalanx(pose.fingers).copy()
    fingers[list(sides)] = *np.repeat(OPEN_HAND, 3), _SPREAD
    return fingers


def _mixed(first: Matrix, last: Matrix, share: float) -> Matrix:
    """A rigid transform between two that are near each other."""
    return nearest_rigid((1.0 - share) * first + share * last)

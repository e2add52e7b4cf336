"""Plans one person's motion among the others in a car: activity after activity, every way free at thrice the frame rate.

A way is straight in joint angles. Where that collides, or a hand is on the wheel at both ends, it leads through poses in between
that the whole-body solver finds: near the straight way, hands that hold the wheel on the wheel, the rest pushed out of what is in
the way.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping
from typing import NamedTuple

import numpy as np

from cabinpose.core.arrays import Floats
from cabinpose.core.frames import Matrix, axis_rotation, invert, nearest_rigid, transform
from cabinpose.core.skeleton import INDEX
from cabinpose.scene.body import DOF_INDEX, Person
from cabinpose.scene.cabin import Cabin, SeatSetting
from cabinpose.scene.things import PlacedThing
from cabinpose.synth.motion.activities import Step, inboard_neighbour, steps_of
from cabinpose.synth.motion.track import Pose, Segment, Track, duration, way_through
from cabinpose.synth.posture.actions import inboard_side
from cabinpose.synth.posture.goals import between, given
from cabinpose.synth.posture.sampling import Drawn, settled
from cabinpose.synth.posture.solver import Sitter, solve
from cabinpose.synth.streams import weighted
from cabinpose.synth.validate import Rejection, Seated, Validator, Verdict

CHECKS_PER_FRAME = 3
_INTERIOR = (0, 3, 7)  # poses between the ends of a way that are tried, one number after the other
_TRIES = 6  # activities tried at one moment
_FIRST_S = (0.1, 0.8)  # when the first activity begins
_PAUSE_S = 0.7  # until the next try
_HELD_M = 0.03  # a palm that is nearer than this to where it was on the rim has not let go
_AT_RIM_M = 0.04  # of a palm's origin from the rim's axis
_OFF_RIM_M, _OPEN = 0.05, 0.05  # of a hand that has just let go: along the palm's normal, and its grip
_GRIP = tuple(DOF_INDEX[side + "hand.grip"] for side in "lr")
_FLESH_M = 0.6  # of two people's skins from their joints, at the most
_BREATHS = 8  # poses of a still person that are tried
_ROUNDABOUT = 1.8  # of a way's duration against the straight one's
_SETTLE = 0.5  # of what a hold may be shorter or longer
_IDLE_SHARES = (1.0, 0.4, 0.0)
_TEMPO = (0.25, 0.6, 1.6)  # sigma of its logarithm, and what it is cut at
_WHEEL_SIGMA, _WHEEL_LIMIT = np.radians(11.0), np.radians(28.0)

# The goals of one person: an action, the wheel's angle, a number (other feet and grips with each), the time (s), and where hands
# reach.
DrawGoal = Callable[[str, float, int, float, Floats | None], Drawn]


class Somebody(NamedTuple):
    """Who moves: the seat's slot, the person, and the activities to choose from by their weights."""

    slot: str
    person: Person
    draw: DrawGoal
    activities: Mapping[str, float]


class _Goal(NamedTuple):
    pose: Pose
    holds: tuple[bool, bool]  # the wheel


class Surroundings:
    """The car and everybody in it over time: those whose motion is known, and the others as they sit at first."""

    def __init__(
        self, cabin: Cabin, validator: Validator, settings: Mapping[str, SeatSetting], rate_hz: float,
        things: tuple[PlacedThing, ...] = (),
    ) -> None:  # fmt: skip
        self.cabin, self.validator, self.settings, self.things = cabin, validator, settings, things
        self.step_s = 1.0 / (rate_hz * CHECKS_PER_FRAME)
        self.people: dict[str, tuple[Person, Track]] = {}

    def empty(self, wheel_angle: float) -> Seated:
        """The car with what stands on its seats, and nobody in it."""
        return self.validator.empty(self.settings, wheel_angle, self.things)

    def others(self, slot: str, time_s: float) -> list[tuple[str, Person, Pose]]:
        """Everybody but one, at a time."""
        return [(other, person, track.at(time_s)) for other, (person, track) in self.people.items() if other != slot]

    def verdict(self, slot: str, person: Person, pose: Pose, time_s: float) -> Verdict:
        """Whether a pose is possible at a time: the body with itself, with those around, in the car; and what the hand holds."""
        own = self.people[slot][1]
        body, seated = own.body(person, pose), self.empty(pose.wheel_angle)
        low, high = body.joints.min(axis=0) - _FLESH_M, body.joints.max(axis=0) + _FLESH_M
        for other, who, where in self.others(slot, time_s):
            track = self.people[other][1]
            near = track.body(who, where)
            if (near.joints.max(axis=0) > low).all() and (near.joints.min(axis=0) < high).all():
                seated = self.validator.with_body(seated, (other, who, near))
                for thing in track.held(other, near):
                    seated = self.validator.with_thing(seated, thing)
        verdict, seated = self.validator.admit(seated, (slot, person, body))
        for thing in own.held(slot, body) if verdict.ok else ():
            verdict, seated = self.validator.bring(seated, thing)
        return verdict

    def sitters(self, slot: str, time_s: float) -> list[Sitter]:
        """Everybody but one, at a time, as the solver sees them."""
        return [given(who, self.cabin.seats[other], pose.q, pose.root) for other, who, pose in self.others(slot, time_s)]

    def first_refused(self, slot: str, person: Person, start_s: float, end_s: float) -> Rejection | None:
        """The first reason found against somebody's track between two times, at every third of a frame; None where it is free."""
        track = self.people[slot][1]
        first, last = int(np.ceil(start_s / self.step_s - 1e-9)), int(np.floor(end_s / self.step_s + 1e-9))
        ticks = np.arange(first, last + 1)
        for time_s in (ticks[_coarse_first(len(ticks))] * self.step_s).tolist():
            rejection = self.verdict(slot, person, track.at(time_s), time_s).rejection
            if rejection is not None:
                return rejection
        return None


def _coarse_first(count: int) -> list[int]:
    """0 .. count - 1, every sixteenth first, then those between, so that what is wrong is found early."""
    seen: dict[int, None] = {}
    for step in (16, 4, 1):
        seen |= dict.fromkeys(range(0, count, step))
    return list(seen)


class Planner:
    """Plans the motion of one person; `causes` counts what was in the way, in place."""

    def __init__(
        self, who: Somebody, around: Surroundings, causes: Counter[Rejection], *, lasts_s: float, rng: np.random.Generator
    ) -> None:
        self._who, self._around, self._causes, self._rng, self._lasts_s = who, around, causes, rng, lasts_s
        sigma, low, high = _TEMPO
        self._tempo = float(np.clip(np.exp(sigma * rng.standard_normal()), low, high))
        self.tried = 0

    @property
    def _track(self) -> Track:
        return self._around.people[self._who.slot][1]

    def breathe(self) -> bool:
        """Let somebody who sits still breathe, as much as there is room for; False where not even the still pose holds."""
        for share in _IDLE_SHARES:
            self._track.idle_share = share
            times = np.linspace(0.0, 1.0 / self._track.idle.breath_hz, _BREATHS).tolist()
            verdicts = (self._around.verdict(self._who.slot, self._who.person, self._track.at(t), t) for t in times)
            reason = next((v.rejection for v in verdicts if v.rejection is not None), None)
            if reason is None:
                return True
            self._causes[reason] += 1
        return False

    def move(self) -> bool:
        """Fill the time with activities; False where none was possible at any time."""
        start = self._track.pose_of(self._track.last)
        now = _Goal(start, self._holds_at(start))
        time_s, habit = float(self._rng.uniform(*_FIRST_S)) * min(1.0, self._lasts_s), 0
        if self._refused(0.0, min(time_s, self._lasts_s)) is not None:
            return False
        while time_s < self._lasts_s:
            for number in range(habit, habit + _TRIES):
                found = self._do(self._choose(), now, time_s, number)
                if found is not None:
                    (now, time_s), habit = found, number
                    break
            else:
                if self._refused(time_s, min(time_s + _PAUSE_S, self._lasts_s)) is not None:
                    return False
                time_s += _PAUSE_S
        return bool(self._track.segments)

    def _choose(self) -> str:
        return weighted(self._who.activities, rng=self._rng)

    def _do(self, activity: str, now: _Goal, time_s: float, number: int) -> tuple[_Goal, float] | None:
        """Appends an activity's segments; where it ends, or None where not even its first step is possible.

        What is broken off goes by the names of its steps.
        """
        self.tried += 1
        cabin, segments = self._around.cabin, self._track.segments
        first, done = len(segments), None
        steps = steps_of(activity, cabin.seats[self._who.slot], cabin, self._track.hold)
        for step in steps:
            found = self._step(activity, step, now, time_s, number)
            if found is None:
                segments[first:] = [s._replace(activity=step.action) for s, step in zip(segments[first:], steps, strict=False)]
                break
            done = now, time_s = found
            if time_s >= self._lasts_s:
                break
        return done

    def _step(self, activity: str, step: Step, now: _Goal, time_s: float, number: int) -> tuple[_Goal, float] | None:
        track, tempo = self._track, step.haste * self._tempo
        hold_s = step.hold_s * float(self._rng.uniform(1.0 - _SETTLE, 1.0 + _SETTLE))
        goal = self._goal(step, now, time_s, number)
        if goal is None:
            return None
        reason: Rejection | None = None
        straight_s = duration(way_through(np.stack([track.last, track.state_of(goal.pose)])), tempo)
        for interior in _INTERIOR:
            if interior == 0 and any(a and b for a, b in zip(now.holds, goal.holds, strict=True)):
                continue
            way = way_through(self._between(track, now, goal, interior, time_s))
            lasts_s = duration(way, tempo)
            if lasts_s > _ROUNDABOUT * straight_s + 0.3:
                reason = reason or Rejection("way", self._who.slot, step.action)
                continue
            track.segments.append(Segment(time_s, lasts_s, way, activity))
            reason = self._refused(time_s, min(time_s + lasts_s + hold_s, self._lasts_s))
            if reason is None:
                return goal, time_s + lasts_s + hold_s
            track.segments.pop()
        if reason is not None:
            self._causes[reason] += 1
        return None

    def _refused(self, start_s: float, end_s: float) -> Rejection | None:
        return self._around.first_refused(self._who.slot, self._who.person, start_s, end_s)

    def _holds_at(self, pose: Pose) -> tuple[bool, bool]:
        """Which hands are at the rim."""
        wheel = self._around.cabin.steering_wheel
        if wheel is None or self._who.slot != "driver":
            return False, False
        palms = self._who.person.pose(pose.q, pose.root).palms
        local = [(invert(wheel.vehicle_from_wheel) @ palms[side])[:3, 3] for side in "lr"]
        off = [float(np.hypot(np.hypot(p[0], p[1]) - wheel.rim_radius_m, p[2])) for p in local]
        return off[0] < _AT_RIM_M, off[1] < _AT_RIM_M

    def _goal(self, step: Step, now: _Goal, time_s: float, number: int) -> _Goal | None:
        """A pose for a step that is possible in itself."""
        angle = now.pose.wheel_angle
        if step.steers:
            angle = float(np.clip(angle + _WHEEL_SIGMA * self._rng.standard_normal(), -_WHEEL_LIMIT, _WHEEL_LIMIT))
        point = self._beside(time_s) if step.at_neighbour else None
        drawn = self._who.draw(step.action, angle, number, time_s, point)
        if step.steers and not any(a and b for a, b in zip(now.holds, drawn.sitter.holds, strict=True)):
            drawn = self._who.draw(step.action, now.pose.wheel_angle, number, time_s, point)
            angle = now.pose.wheel_angle
        placed = self._around.empty(angle).placed
        (found,) = settled([drawn], self._around.sitters(self._who.slot, time_s), placed)
        if found.refused:
            self._causes[Rejection("reach", self._who.slot, found.refused, found.held_up_by)] += 1
            return None
        pose = Pose(found.q, found.vehicle_from_root, angle)
        rejection = self._around.verdict(self._who.slot, self._who.person, pose, time_s).rejection
        if rejection is not None:
            self._causes[rejection] += 1
            return None
        return _Goal(pose, drawn.sitter.holds)

    def _beside(self, time_s: float) -> Floats | None:
        """(3,) m on the bone of the near upper arm of whoever sits beside, at a time; None where nobody does.

        The solver keeps a hand that goes there off the skin.
        """
        seats = self._around.cabin.seats
        mine, others = seats[self._who.slot], self._around.others(self._who.slot, time_s)
        name = inboard_neighbour(mine, self._around.cabin, [slot for slot, *_ in others])
        for slot, person, pose in others:
            if slot == name:
                joints, near = person.pose(pose.q, pose.root).joints, "rl"[inboard_side(mine)]
                return np.asarray(0.6 * joints[INDEX[near + "shoulder"]] + 0.4 * joints[INDEX[near + "elbow"]])
        return None

    def _between(self, track: Track, now: _Goal, goal: _Goal, interior: int, time_s: float) -> Floats:
        """(K, 51) states from one pose to another, with poses in between that the solver finds."""
        start, end = now.pose, goal.pose
        ends = track.state_of(start), track.state_of(end)
        shares = np.linspace(0.0, 1.0, interior + 2)
        states = [ends[0]]
        sitters = self._around.sitters(self._who.slot, time_s) if interior else []
        for share in shares[1:-1].tolist():
            straight = track.pose_of((1.0 - share) * ends[0] + share * ends[1])
            lets_go, arrives = share == shares[1], share == shares[-2]
            palms = [self._palm(side, now, goal, straight, share, lets_go=lets_go, arrives=arrives) for side in (0, 1)]
            holds = [a and b for a, b in zip(now.holds, goal.holds, strict=True)]
            for side, palm in enumerate(palms):
                if palm is not None and not holds[side]:
                    straight.q[_GRIP[side]] = min(straight.q[_GRIP[side]], _OPEN)
            seat = self._around.cabin.seats[self._who.slot]
            soles = self._soles(start, end, share)
            who = between(
                self._who.person, seat, straight.q, straight.root, (palms[0], palms[1]), soles, (holds[0], holds[1])
            )  # fmt: skip
            solve([who, *sitters], self._around.empty(straight.wheel_angle).placed)
            states.append(track.state_of(Pose(who.q, who.root, straight.wheel_angle)))
        return np.stack([*states, ends[1]])

    def _palm(
        self, side: int, now: _Goal, goal: _Goal, between: Pose, share: float, *, lets_go: bool, arrives: bool
    ) -> Matrix | None:
        """Where a palm is on its way: with the rim that it holds, off the rim as it lets go or arrives; else None."""
        wheel = self._around.cabin.steering_wheel
        before, after = now.holds[side], goal.holds[side]
        if wheel is None or not (before or after):
            return None
        poses = now.pose, goal.pose, between
        hub = [wheel.vehicle_from_wheel @ transform(axis_rotation("z", pose.wheel_angle)) for pose in poses]
        palm = [self._who.person.pose(pose.q, pose.root).palms["lr"[side]] for pose in poses[:2]]
        first, last = invert(hub[0]) @ palm[0], invert(hub[1]) @ palm[1]
        if before and after and float(np.linalg.norm(first[:3, 3] - last[:3, 3])) < _HELD_M:
            return hub[2] @ _mixed(first, last, share)
        if (before and lets_go) or (after and arrives):
            off = palm[0].copy() if before and lets_go else palm[1].copy()
            off[:3, 3] -= _OFF_RIM_M * off[:3, 2]
            return np.asarray(off)
        return None

    def _soles(self, start: Pose, end: Pose, share: float) -> tuple[Matrix, Matrix]:
        one, two = (self._who.person.pose(pose.q, pose.root) for pose in (start, end))
        return _mixed(one.soles["l"], two.soles["l"], share), _mixed(one.soles["r"], two.soles["r"], share)


def _mixed(first: Matrix, last: Matrix, share: float) -> Matrix:
    """A rigid transform between two that are near each other."""
    return nearest_rigid((1.0 - share) * first + share * last)

"""Plans one person's motion among the others in a car: activity after activity, every way free at thrice the frame rate.

A way is straight in joint angles. Where that collides, or a hand is on the wheel at both ends, it leads through poses in between
that the whole-body solver finds: near the straight way, hands that hold the wheel on the wheel, the rest pushed out of what is in
the way.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, NamedTuple, Protocol

import numpy as np

from cabinpose.core import CABINPOSE, Floats, Matrix, invert
from cabinpose.core import reproducible as rp
from cabinpose.scene.body import Person
from cabinpose.scene.cabin import Cabin, SeatSetting, hanging_tongue
from cabinpose.scene.things import PlacedThing
from cabinpose.synth.motion.activities import BUCKLE_UP, RECEIVE, Step, inboard_neighbour, resting, steps_of
from cabinpose.synth.motion.handover import giving_palm, meeting_place, taken_over, taking_palm
from cabinpose.synth.motion.track import CLOSING_S, Buckling, Held, Pose, Segment, Track, duration, way_through
from cabinpose.synth.motion.ways import HELD_M, Goal, Ways, rim_distance
from cabinpose.synth.posture.actions import inboard_side
from cabinpose.synth.posture.goals import given, holding, staying
from cabinpose.synth.posture.grasps import Hold
from cabinpose.synth.posture.places import Reach
from cabinpose.synth.posture.sampling import Drawn, settled
from cabinpose.synth.posture.solver import Sitter
from cabinpose.synth.scene import Attempts, Tried
from cabinpose.synth.streams import weighted
from cabinpose.synth.validate import Rejection, Seated, Validator, Verdict

if TYPE_CHECKING:
    from scipy.interpolate import PPoly

CHECKS_PER_FRAME = 3
_INTERIOR = (0, 1, 3, 7)  # poses between the ends of a way that are tried, one number after the other
_LED = 3  # of them at least, where a hand stays at the rim
_TRIES, _OTHERS = 6, 2  # activities tried at one moment, and then of those that nobody asked for
_FIRST_S = (0.1, 0.8)  # when the first activity begins
_PAUSE_S = 0.7  # until the next try
_AT_RIM_M = 0.04  # of a palm's origin from the rim's axis
_FLESH_M = 0.6  # of two people's skins from their joints, at the most
_BREATHS = 8  # poses of a still person that are tried
_ROUNDABOUT, _ROUND_HAND = 1.8, 2.7  # of a way's duration against the straight one's; to another one's hand, or from there
_STOP_S = 0.45  # for each pose in which hands let go or draw back
_PLUGGED, _PLUGS_S = 2, 0.1  # steps until a belt's tongue is at its buckle; until it is in there
_SETTLE = 0.5  # of what a hold may be shorter or longer
_IDLE_SHARES = (1.0, 0.4, 0.0)
_TEMPO = (0.25, 0.6, 1.6)  # sigma of its logarithm, and what it is cut at
_HASTE = 1.5  # of who brings or fetches something, against the usual speed
_WAITS_S, _SHORT_S, _MEETS_S = 2.5, 0.1, 0.3  # for who is to take something, at most; any moment; hands beside each other
_ASIDE_M, _LINGERS_S = 0.07, 0.5  # of a hand that comes to a thing in another one; until that one, empty, goes
_WHEEL_SIGMA, WHEEL_LIMIT = np.radians(11.0), np.radians(28.0)

# The goals of one person: an action, the wheel's angle, what is held, a number (other feet and grips with each), the time (s),
# and where hands reach.
DrawGoal = Callable[[str, float, Hold | None, int, float, Reach | None], Drawn]


class Activities(Protocol):
    """The activities of somebody by their weights, with what is held: those that are asked for, or anything."""

    def __call__(self, hold: Hold | None, *, anything: bool) -> Mapping[str, float]:
        """By name."""
        ...


class Somebody(NamedTuple):
    """Who moves: the seat's slot, the person, and the activities to choose from by their weights, with what is held."""

    slot: str
    person: Person
    draw: DrawGoal
    activities: Activities


class Surroundings:
    """The car and everybody in it over time: those whose motion is known, and the others as they sit at first.

    partners: who can take what is handed over, by slot.
    """

    def __init__(
        self, cabin: Cabin, validator: Validator, settings: Mapping[str, SeatSetting], rate_hz: float,
        things: tuple[PlacedThing, ...] = (),
    ) -> None:  # fmt: skip
        self.cabin, self.validator, self.settings, self.things = cabin, validator, settings, things
        self.step_s = 1.0 / (rate_hz * CHECKS_PER_FRAME)
        self.people: dict[str, tuple[Person, Track]] = {}
        self.partners: Mapping[str, Planner] = {}

    def empty(self, wheel_angle: float) -> Seated:
        """The car with what stands on its seats, and nobody in it."""
        return self.validator.empty(self.settings, wheel_angle, self.things)

    def others(self, slot: str, time_s: float) -> list[tuple[str, Person, Pose]]:
        """Everybody but one, at a time."""
        return [(other, person, track.at(time_s)) for other, (person, track) in self.people.items() if other != slot]

    def verdict(self, slot: str, person: Person, pose: Pose, time_s: float) -> Verdict:
        """Whether a pose is possible at a time: the body with itself, with those around, in the car; and what the hand holds."""
        own = self.people[slot][1]
        body, seated = own.body(person, pose, time_s), self.empty(pose.wheel_angle)
        low, high = body.joints.min(axis=0) - _FLESH_M, body.joints.max(axis=0) + _FLESH_M
        for other, who, where in self.others(slot, time_s):
            track = self.people[other][1]
            near = track.body(who, where, time_s)
            if (near.joints.max(axis=0) > low).all() and (near.joints.min(axis=0) < high).all():
                seated = self.validator.with_body(seated, (other, who, near))
                for thing in track.held(other, near, time_s):
                    seated = self.validator.with_thing(seated, thing)
        verdict, seated = self.validator.admit(seated, (slot, person, body))
        for thing in own.held(slot, body, time_s) if verdict.ok else ():
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
    """Plans the motion of one person; `attempts` counts the poses and ways that are judged, in place."""

    def __init__(
        self, who: Somebody, around: Surroundings, attempts: Attempts, *, lasts_s: float, rng: np.random.Generator
    ) -> None:
        self._who, self._around, self._attempts, self._rng, self._lasts_s = who, around, attempts, rng, lasts_s
        self._ways = Ways(who.slot, who.person, around)
        sigma, low, high = _TEMPO
        self._tempo = float(np.clip(rp.exp(sigma * rng.standard_normal()), low, high))
        self.tried = 0
        self.time_s = 0.0
        self._now: Goal | None = None
        self._habit = 0

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
            self._attempts.judge(reason)
            if reason is None:
                return True
        return False

    def advance(self) -> bool:
        """Wait for a moment at first, then do one more activity, or rest where none is free; False where not even that is."""
        if self._now is None:
            start = self._track.pose_of(self._track.last)
            self._now = Goal(start, (holds := self._holds_at(start)), holds)
            self.time_s = float(self._rng.uniform(*_FIRST_S)) * min(1.0, self._lasts_s)
            return self._refused(0.0, min(self.time_s, self._lasts_s)) is None
        for number in range(self._habit, self._habit + _TRIES + _OTHERS):
            choices = self._choices(anything=number - self._habit >= _TRIES)
            activity = weighted(choices, rng=self._rng)
            found = self._do(activity, self._now, self.time_s, number)
            against = "" if found else str(self._attempts.last_refused)
            self._attempts.tried[Tried(self._who.slot, activity, against)] += 1
            if found is not None:
                (self._now, self.time_s), self._habit = found, number
                return True
        if self._refused(self.time_s, min(self.time_s + _PAUSE_S, self._lasts_s)) is not None:
            return False
        self.time_s += _PAUSE_S
        return True

    def _choices(self, *, anything: bool) -> Mapping[str, float]:
        """What may be done now; anything: whatever makes sense, where nothing that is asked for had a free way."""
        choices = self._who.activities(self._track.hold, anything=anything)
        if self._track.buckling or any(s.activity == "belt" for s in self._track.segments):  # the belt is worn by then
            choices = {name: weight for name, weight in choices.items() if name != BUCKLE_UP}
        return choices or {self._rest(self._track.hold).action: 1.0}

    def _do(self, activity: str, now: Goal, time_s: float, number: int) -> tuple[Goal, float] | None:
        """Appends an activity's segments; where it ends, or None where not even its first step is possible.

        What is broken off goes by the names of its steps.
        """
        self.tried += 1
        if activity == "hand_over":
            return self._hand_over(now, time_s)
        cabin, segments = self._around.cabin, self._track.segments
        first, done = len(segments), None
        steps = steps_of(activity, cabin.seats[self._who.slot], cabin, self._track.hold)
        for step in steps:
            found = self._step(activity, step, now, time_s, number)
            if found is None and activity == BUCKLE_UP and len(segments) < first + _PLUGGED:
                del segments[first:]  # a tongue that is not plugged in would be let go
                return None
            if found is None:
                segments[first:] = [s._replace(activity=step.action) for s, step in zip(segments[first:], steps, strict=False)]
                break
            done = now, time_s = found
            if time_s >= self._lasts_s:
                break
        if activity == BUCKLE_UP:
            self._track.buckling = self._buckled(segments[first:])
        return done

    def _buckled(self, steps: Sequence[Segment]) -> Buckling:
        """When a belt's tongue is taken and plugged in by these steps, and by which hand; a sequence may end before that."""
        slot, around, taken = self._who.slot, self._around, steps[0]
        hangs = hanging_tongue(around.cabin.seats[slot], around.settings[slot], around.cabin)
        pose = self._track.pose_of(taken.last)
        palms = self._who.person.pose(pose.q, pose.root).palms
        off = [rp.norm(palms[side][:3, 3] - hangs) for side in "lr"]
        plug_s = steps[1].start_s + steps[1].lasts_s + _PLUGS_S if len(steps) >= _PLUGGED else np.inf
        return Buckling(int(off[1] < off[0]), taken.start_s + taken.lasts_s, plug_s)

    def _step(self, activity: str, step: Step, now: Goal, time_s: float, number: int) -> tuple[Goal, float] | None:
        track, tempo = self._track, step.haste * self._tempo
        hold_s = step.hold_s * float(self._rng.uniform(1.0 - _SETTLE, 1.0 + _SETTLE))
        goal = self._goal(step, now, time_s, number)
        if goal is None:
            return None
        reason: Rejection | None = None
        for interior in _INTERIOR:
            if interior < _LED and _led(now, goal):
                continue
            found = self._way(now, goal, interior, time_s, tempo)
            if found is None:
                reason = reason or Rejection("way", self._who.slot, step.action)
                continue
            way, lasts_s = found
            track.segments.append(Segment(time_s, lasts_s, way, activity))
            reason = self._refused(time_s, min(time_s + lasts_s + hold_s, self._lasts_s))
            if reason is None:
                self._attempts.judge(None)
                return goal, time_s + lasts_s + hold_s
            track.segments.pop()
        if reason is not None:
            self._attempts.judge(reason)
        return None

    def _way(self, now: Goal, goal: Goal, interior: int, time_s: float, tempo: float) -> tuple[PPoly, float] | None:
        """A way through so many poses between two, and how long it takes, s; None for one that is too far round."""
        ends = self._track.last, self._track.state_of(goal.pose)
        way = way_through(self._ways.between(self._track, now, goal, interior, time_s))
        lasts_s = duration(way, tempo)
        passes = self._track.hold is not None and self._track.hold.place.passes_on
        limit = _ROUND_HAND if passes or now.via is not None or goal.via is not None else _ROUNDABOUT
        stops = len(way.x) - 2 - interior
        longest_s = limit * duration(way_through(np.stack(ends)), tempo) + 0.3 + _STOP_S * stops / tempo
        return (way, lasts_s) if lasts_s <= longest_s else None

    def _hand_over(self, now: Goal, time_s: float) -> tuple[Goal, float] | None:
        """Holds out what is held; the neighbour's hand comes, takes it and draws it away; then the empty hand goes back."""
        seats, held = self._around.cabin.seats, self._track.hold
        slot = inboard_neighbour(seats[self._who.slot], self._around.cabin, self._around.people) or ""
        other = self._around.partners.get(slot)
        if other is None or other._now is None or other._track.hold is not None or held is None:
            return None
        if other.time_s - time_s > _WAITS_S:
            return None
        tracks = self._track, other._track
        before = [(list(track.segments), list(track.holds)) for track in tracks]
        for interior in _INTERIOR:
            found = self._meet(other, held, (now, other._now), interior)
            if found is not None:
                other._now, other.time_s = found[1]
                return found[0]
            for track, (segments, holds) in zip(tracks, before, strict=True):
                track.segments[:], track.holds[:] = segments, holds
        return None

    def _meet(
        self, other: Planner, held: Hold, now: tuple[Goal, Goal], interior: int
    ) -> tuple[tuple[Goal, float], tuple[Goal, float]] | None:
        """See `_hand_over`: where both end. What it has planned until it fails stays."""
        people, at_s = (self._who.person, other._who.person), other.time_s
        seat, (side, free) = self._around.cabin.seats[self._who.slot], (held.side, 1 - held.side)
        bodies = people[0].pose(now[0].pose.q, now[0].pose.root), people[1].pose(now[1].pose.q, now[1].pose.root)
        ahead = np.array([rp.cos(seat.facing_yaw), rp.sin(seat.facing_yaw), 0.0])
        place = meeting_place(people, bodies, side, ahead, rng=self._rng)
        gives = self._goal(Step("hand_over"), now[0], at_s, self._habit, Reach(place, side, giving_palm(held, bodies[0], place)))
        way = gives and self._brought(gives, now[0], interior, at_s, "hand_over")
        if gives is None or way is None:
            return None
        out = people[0].pose(gives.pose.q, gives.pose.root).palms["lr"[side]]
        mine, palm = taking_palm(people[1], bodies[1], held, held.placed(out))
        # The goal and the way of who takes, while the thing is held out and the fingers are open.
        self._track.segments.append(Segment(at_s, _SHORT_S, way[0], "hand_over"))
        ready_s = at_s + _SHORT_S
        other._track.holds.append(Held(mine, ready_s + CLOSING_S, ready_s + CLOSING_S))
        takes = other._goal(Step(RECEIVE), now[1], ready_s, other._habit, Reach(palm[:3, 3], free, palm))
        if takes is not None:
            takes = takes._replace(via=other._ways.aside(takes, {free: -_ASIDE_M * palm[:3, 2]}, ready_s))
        back = takes and other._brought(takes, now[1], interior, ready_s, RECEIVE)
        self._track.segments.pop()
        other._track.holds.pop()
        if takes is None or back is None:
            return None
        out_s = max(self.time_s + way[1], other.time_s)
        meet_s = out_s + back[1]
        self._track.segments.append(Segment(out_s - way[1], way[1], way[0], "hand_over"))
        other._track.segments.append(Segment(out_s, back[1], back[0], RECEIVE))
        change_s, until_s = meet_s + _MEETS_S, meet_s + _MEETS_S + CLOSING_S
        refused = self._pass_on(other, held, change_s)
        for planner in (self, other):
            refused = refused or planner._refused(planner.time_s, min(until_s, self._lasts_s))
        self._attempts.judge(refused)
        if refused is not None:
            return None
        # It is drawn out of the open hand, which goes back afterwards as it came.
        takes = takes._replace(via=other._ways.aside(takes, {free: _ASIDE_M * out[:3, 2]}, until_s))
        end = other._step(RECEIVE, other._rest(held), takes, until_s, other._habit)
        if end is None:
            return None
        leave_s = until_s + _LINGERS_S
        self._track.segments.append(Segment(leave_s, way[1], way_through(way[0](way[0].x)[::-1]), "hand_over"))
        refused = self._refused(until_s, min(leave_s + way[1], self._lasts_s))
        self._attempts.judge(refused)
        if refused is not None:
            return None
        return (now[0], leave_s + way[1]), end

    def _brought(self, goal: Goal, now: Goal, interior: int, time_s: float, label: str) -> tuple[PPoly, float] | None:
        found = self._way(now, goal, max(interior, _led(now, goal) * _LED), time_s, _HASTE * self._tempo)
        if found is None:
            self._attempts.judge(Rejection("way", self._who.slot, label))
        return found

    def _rest(self, held: Hold | None) -> Step:
        """Back to rest with something in a hand."""
        cabin = self._around.cabin
        return Step(resting(cabin.seats[self._who.slot], cabin, held), haste=_HASTE)

    def _pass_on(self, other: Planner, held: Hold, time_s: float) -> Rejection | None:
        """Lets the other one hold it from a time on, as it is in that hand then."""
        mine, theirs = (p._track.body(p._who.person, p._track.at(time_s), time_s) for p in (self, other))
        taken = taken_over(held, held.placed(mine.palms["lr"[held.side]]), other._who.person, theirs)
        if taken is None:
            return Rejection("reach", other._who.slot, "rl"[held.side] + "hand", held.kind)
        self._track.holds[-1] = self._track.holds[-1]._replace(end_s=time_s)
        other._track.holds.append(Held(taken, time_s))
        return None

    def _refused(self, start_s: float, end_s: float) -> Rejection | None:
        return self._around.first_refused(self._who.slot, self._who.person, start_s, end_s)

    def _holds_at(self, pose: Pose) -> tuple[bool, bool]:
        """Which hands are at the rim."""
        wheel = self._around.cabin.steering_wheel
        if wheel is None or self._who.slot != "driver":
            return False, False
        palms = self._who.person.pose(pose.q, pose.root).palms
        off = [rim_distance(wheel, palms[side][:3, 3]) for side in "lr"]
        return off[0] < _AT_RIM_M, off[1] < _AT_RIM_M

    def _goal(self, step: Step, now: Goal, time_s: float, number: int, reach: Reach | None = None) -> Goal | None:
        """A pose for a step that is possible in itself; reach: where hands go, in place of a neighbour's arm."""
        angle = now.pose.wheel_angle
        if step.steers:
            angle = float(np.clip(angle + _WHEEL_SIGMA * self._rng.standard_normal(), -WHEEL_LIMIT, WHEEL_LIMIT))
        point = self._beside(time_s) if step.at_neighbour else None
        reach = reach if point is None else Reach(point)
        hold = self._track.hold
        drawn = self._who.draw(step.action, angle, hold, number, time_s, reach)
        if step.steers and not any(a and b for a, b in zip(now.holds, drawn.sitter.holds, strict=True)):
            drawn = self._who.draw(step.action, now.pose.wheel_angle, hold, number, time_s, reach)
            angle = now.pose.wheel_angle
        if reach is not None and reach.side is not None:
            touches = tuple(touch for touch in drawn.touches if touch.side == reach.side)
            stays = staying(drawn.sitter, now.pose.q, now.pose.root, reach.side, now.holds)
            return self._posed(replace(drawn, sitter=stays, touches=touches), angle, time_s)
        kept = self._carried(now, drawn.sitter, angle, near=step.steers)
        if all(palm is None for palm in kept):
            return self._posed(drawn, angle, time_s)
        # Hands stay where they hold the wheel, unless that leaves no way.
        found = self._posed(replace(drawn, sitter=holding(drawn.sitter, kept)), angle, time_s)
        return found or (None if step.steers else self._posed(drawn, angle, time_s))

    def _posed(self, drawn: Drawn, angle: float, time_s: float) -> Goal | None:
        """The pose that somebody's goals lead to, if it is possible in itself."""
        (found,) = settled([drawn], self._around.sitters(self._who.slot, time_s), self._around.empty(angle).placed)
        if found.refused:
            self._attempts.judge(Rejection("reach", self._who.slot, found.refused, found.held_up_by))
            return None
        pose = Pose(found.q, found.vehicle_from_root, angle, found.fingers)
        rejection = self._around.verdict(self._who.slot, self._who.person, pose, time_s).rejection
        self._attempts.judge(rejection)
        if rejection is not None:
            return None
        holds, grasping = drawn.sitter.holds, {touch.side for touch in drawn.touches if touch.grasps}
        return Goal(pose, holds, (holds[0] or 0 in grasping, holds[1] or 1 in grasping))

    def _carried(self, now: Goal, chosen: Sitter, angle: float, *, near: bool) -> tuple[Matrix | None, Matrix | None]:
        """Where a rim that turns to `angle` (rad) takes palms that hold it, and are to; None for a new grip.

        near: only those that were to be near there.
        """
        before, after = (self._around.cabin.vehicle_from_wheel(each) for each in (now.pose.wheel_angle, angle))
        if before is None or after is None:
            return None, None
        palms = self._who.person.pose(now.pose.q, now.pose.root).palms
        result: list[Matrix | None] = [None, None]
        for side in (0, 1):
            if now.holds[side] and chosen.holds[side]:
                palm = rp.matmul(after, rp.matmul(invert(before), palms["lr"[side]]))
                if not near or rp.norm(palm[:3, 3] - chosen.goals.target[side][:3, 3]) < HELD_M:
                    result[side] = palm
        return result[0], result[1]

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
                shoulder, elbow = joints[CABINPOSE.indices((near + "shoulder", near + "elbow"))]
                return np.asarray(0.6 * shoulder + 0.4 * elbow)
        return None


def _led(start: Goal, end: Goal) -> bool:
    """Whether a hand stays at the rim on the way."""
    return any(a and b for a, b in zip(start.holds, end.holds, strict=True))

"""The motion of everybody in a sequence, from poses that hold together."""

from __future__ import annotations

import math
from collections.abc import Mapping
from functools import partial
from typing import NamedTuple

import numpy as np

from cabinpose.scene.body import Person, PosedBody
from cabinpose.synth.casting import Cast
from cabinpose.synth.config import CabinScene
from cabinpose.synth.motion.activities import BUCKLE_UP, RECORDED, activities_for, inboard_neighbour, program_of, resting
from cabinpose.synth.motion.config import SequenceConfig
from cabinpose.synth.motion.planner import WHEEL_LIMIT, Planner, Somebody, Surroundings
from cabinpose.synth.motion.track import Idle, Pose, Track
from cabinpose.synth.posing import Posing
from cabinpose.synth.posture.actions import IN_CHILD_SEAT, OWN_ACTIONS, inboard_side
from cabinpose.synth.posture.grasps import Hold, can_hold, handed, hold
from cabinpose.synth.posture.places import GIVE, Reach
from cabinpose.synth.posture.sampling import Doing, Drawn, OccupantPose
from cabinpose.synth.profiles import MocapProfile
from cabinpose.synth.scene import Attempts
from cabinpose.synth.streams import sequence_rng, weighted
from cabinpose.synth.things import bring_along
from cabinpose.synth.validate import Rejection, Seated

_PROGRAM_WEIGHT = 2.0  # of an activity of several actions, beside the actions' own
_DRAWS = 16  # of one person's habits: streams of a sequence


class SequenceDraw(NamedTuple):
    """One draw of a sequence: which dataset's, its first frame, and how often its scene was drawn before."""

    sequence: SequenceConfig
    seed: int
    first: int
    attempt: int

    def rng(self, stream: int) -> np.random.Generator:
        """A generator of the sequence."""
        return sequence_rng(self.seed, self.first, stream)

    def streams(self, cast: Cast) -> Mapping[str, int]:
        """The first of everybody's `_DRAWS` streams, by slot."""
        return {slot: 1 + _DRAWS * (len(cast.people) * self.attempt + i) for i, slot in enumerate(cast.people)}

    def recorded_index(self, scene: CabinScene, slot: str, time_s: float) -> int:
        """Which pose of a recording somebody follows at a time since the first frame; else the first frame."""
        profile = scene.profile_of(slot)
        if not isinstance(profile, MocapProfile):
            return self.first
        return round((self.first / self.sequence.rate_hz + time_s) * profile.poses_per_s)


def plan_tracks(cast: Cast, posing: Posing, draw: SequenceDraw, attempts: Attempts) -> dict[str, Track] | None:
    """The motion of everybody in a car, from poses that hold together.

    Parameters
    ----------
    cast
        Who sits where, with what is on the seats.
    posing
        Draws the goals of actions; the same randomness gives the same habits: feet, grips, place in the seat.
    draw
        Which sequence.
    attempts
        Counts the poses and activities that were tried and what was in the way, in place.

    Returns
    -------
    dict or None
        Tracks by slot; None where somebody has no free way.
    """
    scene, sequence, people, cabin = posing.scene, draw.sequence, cast.people, cast.cabin
    lasts_s = (sequence.frames - 1) / sequence.rate_hz
    streams = draw.streams(cast)
    plans = {slot: draw.rng(stream) for slot, stream in streams.items()}
    choices = _Choices(cast, scene, sequence)
    holds: dict[str, Hold | None] = {}
    for slot, person in people.items():
        waits = [giver for giver, held in holds.items() if held is not None and held.place is GIVE]
        takes = slot in (inboard_neighbour(cabin.seats[giver], cabin, choices.free) for giver in waits)
        holds[slot] = None
        if slot not in scene.recorded and not takes:
            chosen = choices.of(slot, None, at_first=True)
            holds[slot] = _held(person, chosen, scene, inboard_side(cabin.seats[slot]), rng=plans[slot])
    habits = dict.fromkeys(people, 0)
    actions = {slot: resting(cabin.seats[slot], cabin, holds[slot]) for slot in people}

    def first_goals(slot: str) -> Drawn:
        habits[slot] = habits[slot] % (_DRAWS - 1) + 1
        drawn = goals(slot, actions[slot], None, holds[slot])
        if drawn.wheel_angle is None or abs(drawn.wheel_angle) <= WHEEL_LIMIT:
            return drawn
        return goals(slot, actions[slot], math.copysign(WHEEL_LIMIT, drawn.wheel_angle), holds[slot])

    def goals(
        slot: str, action: str, wheel_angle: float | None, hold: Hold | None, number: int = 0, time_s: float = 0.0,
        reach: Reach | None = None,
    ) -> Drawn:  # fmt: skip
        rng = draw.rng(streams[slot] + (habits[slot] + number - 1) % (_DRAWS - 1) + 1)
        doing = Doing(action, wheel_angle, carried=hold, reach=reach)
        return posing.goals(cast, slot, draw.recorded_index(scene, slot, time_s), doing, rng=rng)

    def bring(slot: str, pose: OccupantPose, body: PosedBody, seated: Seated) -> tuple[Rejection | None, Seated]:
        return bring_along(None, slot, pose, body, cast.validator, seated, rng=plans[slot])

    posed = posing.pose(cast, first_goals, bring, attempts)
    if posed is None:
        return None
    around = Surroundings(cabin, cast.validator, cast.settings, sequence.rate_hz, cast.things)
    planners, followers = {}, []
    for slot, (pose, _) in posed.poses.items():
        who = Somebody(slot, people[slot], partial(goals, slot), partial(choices.of, slot))
        start = Pose(pose.q, pose.vehicle_from_root, pose.wheel_angle or 0.0, pose.fingers)
        if slot in scene.recorded:
            around.people[slot] = people[slot], Track(start, RECORDED, Idle.drawn(rng=plans[slot]), 0.0)
            followers.append(who)
        else:
            around.people[slot] = people[slot], Track(start, actions[slot], Idle.drawn(rng=plans[slot]), 0.0, holds[slot])
            planners[slot] = Planner(who, around, attempts, lasts_s=lasts_s, rng=plans[slot])
    around.partners = {slot: planner for slot, planner in planners.items() if slot in choices.free}
    # One after the other: those whose motion is planned are known over time, the others sit still. Where things are handed over
    # all go on together, so that nobody is far ahead of who waits.
    together = any(hold is not None and hold.place is GIVE for hold in holds.values())
    if followers:
        from cabinpose.synth.motion.replay import replay  # noqa: PLC0415 - scipy's interpolation, for recordings alone
    for who in followers:
        if not replay(who, around, attempts, action=actions[who.slot], lasts_s=lasts_s):
            return None
    possible = all(planner.breathe() for planner in planners.values())
    while possible and (moving := [planner for planner in planners.values() if planner.time_s < lasts_s]):
        possible = min(moving, key=lambda planner: planner.time_s if together else 0.0).advance()
    attempts.proposals += sum(p.tried for p in planners.values())
    return {slot: track for slot, (_, track) in around.people.items()} if possible else None


def _held(
    person: Person, choices: Mapping[str, float], scene: CabinScene, inboard: int, *, rng: np.random.Generator
) -> Hold | None:
    """What a person has in the hand, for an activity drawn of these; None where it needs nothing, or nothing fits."""
    program = program_of(weighted(choices, rng=rng)) if scene.in_hand > 0.0 else None
    place = None if program is None else program.held_at
    if program is None or place is None or rng.random() >= scene.in_hand:
        return None
    side = int(rng.integers(2))
    side = inboard if place is GIVE else side
    for kind, variant in handed(place, scene.held or program.things, rng=rng):
        if can_hold(person, place, kind, variant):
            return hold(person, place, kind, variant, side)
    return None


class _Choices:
    """What everybody may do in a sequence. free: the seats of those who can give and take things."""

    def __init__(self, cast: Cast, scene: CabinScene, sequence: SequenceConfig) -> None:
        self._cast, self._activities, self._weights = cast, sequence.activities or (), scene.weights
        self._empty, self._scene = scene.in_hand == 0.0, scene
        self.free = [slot for slot in cast.people if slot not in scene.recorded and slot not in cast.child_seats]

    def of(self, slot: str, hold: Hold | None, *, at_first: bool = False, anything: bool = False) -> dict[str, float]:
        """Activities by weight; where none of those asked for makes sense in a seat, any that does.

        at_first: when it is drawn what is in the hand, so that empty hands also do what needs a thing. Later they do so where
        there is nothing else to do, or where nobody has anything in the hand · anything: whatever is asked for.
        """
        bare = at_first or self._empty
        cabin, taken, child = self._cast.cabin, self._cast.people, slot in self._cast.child_seats
        seat = cabin.seats[slot]
        weights = self._weights.get(slot)
        asked_for = [*self._activities, *(weights or ())]
        possible = activities_for(seat, cabin, hold, taken, in_child_seat=child, asked_for=asked_for)
        if slot not in self.free or inboard_neighbour(seat, cabin, taken) not in self.free or not (bare or hold):
            possible = tuple(name for name in possible if name != "hand_over")
        given = self._scene.occupant(slot)
        if self._scene.belted == 0.0 or given.belted is False or given.belt == "none":
            possible = tuple(name for name in possible if name != BUCKLE_UP)
        if weights is None and child:
            held = {name: 1.0 for name, action in OWN_ACTIONS.items() if action.in_hand == "always"}
            weights = IN_CHILD_SEAT if bare else {**IN_CHILD_SEAT, **held}
        if weights is None:
            weights = {name: OWN_ACTIONS[name].weight if name in OWN_ACTIONS else _PROGRAM_WEIGHT for name in possible}
        usual = {name: weights[name] for name in possible if weights.get(name, 0.0) > 0.0}
        result = {name: 1.0 for name in possible if name in self._activities and not anything} or usual
        handless = (
            result if bare or hold is not None else {name: w for name, w in result.items() if program_of(name).held_at is None}
        )
        return handless or result

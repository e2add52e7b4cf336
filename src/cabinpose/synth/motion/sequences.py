"""The sequences of a dataset: sequence n is its frames n * frames .. (n + 1) * frames - 1, planned as a whole and once."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Collection, Iterable, Mapping
from functools import partial
from types import MappingProxyType

import numpy as np

from cabinpose.scene.body import Person, PosedBody
from cabinpose.scene.cabin import Cabin, SeatSetting
from cabinpose.scene.things import PlacedThing
from cabinpose.synth.motion.activities import RECORDED, activities_for, inboard_neighbour, program_of, resting
from cabinpose.synth.motion.config import SequenceConfig
from cabinpose.synth.motion.planner import Planner, Somebody, Surroundings
from cabinpose.synth.motion.track import Idle, Pose, Track
from cabinpose.synth.posing import pose_people
from cabinpose.synth.posture.actions import IN_CHILD_SEAT, OWN_ACTIONS, inboard_side
from cabinpose.synth.posture.grasps import Hold, can_hold, handed, hold
from cabinpose.synth.posture.places import GIVE, Reach
from cabinpose.synth.posture.sampling import Drawn, OccupantPose
from cabinpose.synth.streams import sequence_rng, weighted
from cabinpose.synth.things import bring_along
from cabinpose.synth.validate import Rejection, Seated, Validator

_PROGRAM_WEIGHT = 2.0  # of an activity of several actions, beside the actions' own
_DRAWS = 16  # of one person's habits: streams of a sequence

# Draws the goals of whoever sits in a slot: the action, the wheel's angle instead of a drawn one, what is held, where hands
# reach beside the car's own places, the child seat, the time (s) since the first frame, and the source of randomness.
DrawGoals = Callable[
    [str, str, float | None, Hold | None, Reach | None, PlacedThing | None, float, np.random.Generator], Drawn
]  # fmt: skip


def plan_tracks(
    sequence: SequenceConfig,
    people: Mapping[str, Person],
    cabin: Cabin,
    validator: Validator,
    settings: Mapping[str, SeatSetting],
    draw: DrawGoals,
    weights: Mapping[str, Mapping[str, float]] = MappingProxyType({}),
    *,
    recorded: Collection[str] = (),
    things: tuple[PlacedThing, ...] = (),
    in_hand: float = 0.0,
    seed: int,
    first: int,
    attempt: int,
    poses_per_person: int,
    causes: Counter[Rejection],
) -> tuple[dict[str, Track] | None, int]:
    """The motion of everybody in a car, from poses that hold together.

    Parameters
    ----------
    sequence
        How long it lasts and what may be done.
    people
        By slot.
    cabin, validator, settings
        The car, its judge, and how its seats are set.
    draw
        Draws the goals of an action; the same randomness gives the same habits: feet, grips, place in the seat.
    weights
        Of the actions by slot, where they are not the usual ones.
    recorded
        The slots of those whom recordings move.
    things, in_hand
        What stands on the seats, and the share of people with something in the hand, of those who do what needs it.
    seed, first, attempt
        Of the dataset, the sequence's first frame, and how often its scene was drawn before.
    poses_per_person
        Draws of one person's first pose before all is given up.
    causes
        Counts what was in the way, in place.

    Returns
    -------
    dict or None
        Tracks by slot; None where somebody has no free way.
    int
        The number of poses and activities that were tried.
    """
    lasts_s = (sequence.frames - 1) / sequence.rate_hz
    streams = {slot: 1 + _DRAWS * (len(people) * attempt + i) for i, slot in enumerate(people)}
    plans = {slot: sequence_rng(seed, first, stream) for slot, stream in streams.items()}
    on = {thing.slot: thing for thing in things if thing.thing.sitting and thing.slot in people}
    free = [slot for slot in people if slot not in recorded and slot not in on]  # to give and to take

    def choices(slot: str, hold: Hold | None, *, at_first: bool = False) -> dict[str, float]:
        bare = at_first or in_hand == 0.0
        return _choices(sequence, cabin, slot, people, free, weights.get(slot), hold, bare=bare, child=slot in on)

    holds: dict[str, Hold | None] = {}
    for slot, person in people.items():
        waits = [giver for giver, held in holds.items() if held is not None and held.place is GIVE]
        takes = slot in (inboard_neighbour(cabin.seats[giver], cabin, free) for giver in waits)
        holds[slot] = None
        if slot not in recorded and not takes:
            chosen = choices(slot, None, at_first=True)
            holds[slot] = _held(person, chosen, in_hand, inboard_side(cabin.seats[slot]), rng=plans[slot])
    habits = dict.fromkeys(people, 0)
    actions = {slot: resting(cabin.seats[slot], cabin, holds[slot]) for slot in people}

    def first_goals(slot: str) -> Drawn:
        habits[slot] = habits[slot] % (_DRAWS - 1) + 1
        return goals(slot, actions[slot], None, holds[slot])

    def goals(
        slot: str, action: str, wheel_angle: float | None, hold: Hold | None, number: int = 0, time_s: float = 0.0,
        reach: Reach | None = None,
    ) -> Drawn:  # fmt: skip
        rng = sequence_rng(seed, first, streams[slot] + (habits[slot] + number - 1) % (_DRAWS - 1) + 1)
        return draw(slot, action, wheel_angle, hold, reach, on.get(slot), time_s, rng)

    def bring(slot: str, pose: OccupantPose, body: PosedBody, seated: Seated) -> tuple[Rejection | None, Seated]:
        return bring_along(None, slot, pose, body, validator, seated, rng=plans[slot])

    posed, tried = pose_people(
        people, cabin, validator, settings, first_goals, poses_per_person=poses_per_person, causes=causes,
        things=things, bring=bring,
    )  # fmt: skip
    if posed is None:
        return None, tried
    around = Surroundings(cabin, validator, settings, sequence.rate_hz, things)
    planners, followers = {}, []
    for slot, (pose, _) in posed.poses.items():
        who = Somebody(slot, people[slot], partial(goals, slot), partial(choices, slot))
        start = Pose(pose.q, pose.vehicle_from_root, pose.wheel_angle or 0.0)
        if slot in recorded:
            around.people[slot] = people[slot], Track(start, RECORDED, Idle.drawn(rng=plans[slot]), 0.0)
            followers.append(who)
        else:
            around.people[slot] = people[slot], Track(start, actions[slot], Idle.drawn(rng=plans[slot]), 0.0, holds[slot])
            planners[slot] = Planner(who, around, causes, lasts_s=lasts_s, rng=plans[slot])
    around.partners = {slot: planner for slot, planner in planners.items() if slot in free}
    # One after the other: those whose motion is planned are known over time, the others sit still. Where things are handed over
    # all go on together, so that nobody is far ahead of who waits.
    together = any(hold is not None and hold.place is GIVE for hold in holds.values())
    if followers:
        from cabinpose.synth.motion.replay import replay  # noqa: PLC0415 - scipy's interpolation, for recordings alone
    for who in followers:
        if not replay(who, around, causes, action=actions[who.slot], lasts_s=lasts_s):
            return None, tried
    possible = all(planner.breathe() for planner in planners.values())
    while possible and (moving := [planner for planner in planners.values() if planner.time_s < lasts_s]):
        possible = min(moving, key=lambda planner: planner.time_s if together else 0.0).advance()
    tried += sum(p.tried for p in planners.values())
    if not possible:
        return None, tried
    return {slot: track for slot, (_, track) in around.people.items()}, tried


def _held(person: Person, choices: Mapping[str, float], in_hand: float, inboard: int, *, rng: np.random.Generator) -> Hold | None:
    """What a person has in the hand, for an activity drawn of these; None where it needs nothing, or nothing fits."""
    activity = weighted(choices, rng=rng) if in_hand > 0.0 else ""
    place = program_of(activity).held_at if activity else None
    if place is None or rng.random() >= in_hand:
        return None
    side = int(rng.integers(2))
    side = inboard if place is GIVE else side
    for kind, variant in handed(place, rng=rng):
        if can_hold(person, place, kind, variant):
            return hold(person, place, kind, variant, side)
    return None


def _choices(
    sequence: SequenceConfig, cabin: Cabin, slot: str, taken: Iterable[str], free: Collection[str],
    weights: Mapping[str, float] | None, hold: Hold | None, *, bare: bool, child: bool,
) -> dict[str, float]:  # fmt: skip
    """The activities of whoever sits in a slot, by weight; where none of those asked for makes sense there, any that does.

    free: the seats of those who can hand over · bare: whether empty hands also do what needs a thing, and not only where there is
    nothing else to do · child: whether it is somebody in a child seat.
    """
    seat = cabin.seats[slot]
    asked_for = [*(sequence.activities or ()), *(weights or ())]
    possible = activities_for(seat, cabin, hold, taken, in_child_seat=child, asked_for=asked_for)
    if slot not in free or inboard_neighbour(seat, cabin, taken) not in free or not (bare or hold):
        possible = tuple(name for name in possible if name != "hand_over")
    if weights is None and child:
        held = {name: 1.0 for name, action in OWN_ACTIONS.items() if action.in_hand == "always"}
        weights = IN_CHILD_SEAT if bare else {**IN_CHILD_SEAT, **held}
    if weights is None:
        weights = {name: OWN_ACTIONS[name].weight if name in OWN_ACTIONS else _PROGRAM_WEIGHT for name in possible}
    usual = {name: weights[name] for name in possible if weights.get(name, 0.0) > 0.0}
    result = {name: 1.0 for name in possible if name in (sequence.activities or ())} or usual
    handless = result if bare or hold is not None else {name: w for name, w in result.items() if program_of(name).held_at is None}
    return handless or result

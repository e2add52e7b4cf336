"""Poses of the people in one car: row by row, those of a row solved together; a person who does not fit is drawn again.

The solver lets all of a row give way to each other. What the verdict refuses then costs the person it names another draw of an
action and all that goes with it; where it names two, they take turns.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import replace
from types import MappingProxyType
from typing import NamedTuple

from cabinpose.core import SceneError
from cabinpose.scene.body import Person, PosedBody
from cabinpose.scene.cabin import Cabin, SeatSetting
from cabinpose.scene.things import PlacedThing
from cabinpose.synth.posture.goals import given as as_given
from cabinpose.synth.posture.neighbours import beside_each_other, close_seats, half_breadth
from cabinpose.synth.posture.sampling import Drawn, OccupantPose, settled
from cabinpose.synth.posture.solver import Sitter
from cabinpose.synth.validate import Rejection, Seated, Validator

Draw = Callable[[str], Drawn]
Bring = Callable[[str, OccupantPose, PosedBody, Seated], tuple[Rejection | None, Seated]]


class Posed(NamedTuple):
    """Who sits: pose and body by slot, and what the validator knows of them."""

    poses: dict[str, tuple[OccupantPose, PosedBody]]
    seated: Seated


def slimmest_in_the_middle(
    people: Mapping[str, str], cabin: Cabin, person: Callable[[str], Person], *, stay: Collection[str] = ()
) -> dict[str, str]:
    """Names by slot, exchanged so that of three in a row the slimmest sits between the others; not those in slots that `stay`."""
    result = dict(people)
    for slot in people:
        close = [s for s in close_seats(cabin.seats[slot], cabin, tuple(people)) if s not in stay]
        if slot not in stay and len(close) > 1:
            slimmest = min((slot, *close), key=lambda s: half_breadth(person(people[s])))
            result[slot], result[slimmest] = people[slimmest], people[slot]
    return result


def rows_of(slots: Sequence[str], cabin: Cabin) -> list[list[str]]:
    """The slots by rows, each in the order given."""
    rows: list[list[str]] = []
    for slot in slots:
        row = next((r for r in rows if beside_each_other(cabin.seats[slot], cabin.seats[r[0]])), None)
        if row is None:
            rows.append([slot])
        else:
            row.append(slot)
    return rows


def pose_people(
    people: Mapping[str, Person],
    cabin: Cabin,
    validator: Validator,
    settings: Mapping[str, SeatSetting],
    draw: Draw,
    *,
    poses_per_person: int,
    causes: Counter[Rejection],
    given: Mapping[str, OccupantPose] = MappingProxyType({}),
    things: tuple[PlacedThing, ...] = (),
    bring: Bring | None = None,
) -> tuple[Posed | None, int]:
    """Pose everybody in a car, row by row.

    Parameters
    ----------
    people
        By slot.
    cabin, validator, settings
        The car, its judge, and how its seats are set, by slot.
    draw
        Draws the goals of the person in a slot; called again after each rejection of this person.
    poses_per_person
        Draws of one person before all is given up.
    causes
        Counts the rejections, in place.
    given
        Poses by slot that are judged but not solved.
    things
        Child seats and objects on the seats.
    bring
        Puts what somebody who sits has in hand and on the lap to the rest, or says why there is no room for it.

    Returns
    -------
    Posed or None
        None where somebody found no valid pose.
    int
        The number of draws.

    Raises
    ------
    SceneError
        Where a given pose is not valid, whatever the other people do.
    """
    poses = {slot: (pose, people[slot].pose(pose.q, pose.vehicle_from_root, pose.fingers)) for slot, pose in given.items()}
    stay = {slot: as_given(people[slot], cabin.seats[slot], pose.q, pose.vehicle_from_root) for slot, pose in given.items()}
    seated, sitting, draws = validator.empty(settings, things=things), list[Sitter](), 0
    for row in rows_of(tuple(people), cabin):
        fixed, free = [slot for slot in row if slot in given], [slot for slot in row if slot not in given]
        around = [*sitting, *(stay[slot] for slot in fixed)]
        tries: Counter[str] = Counter()
        drawn: dict[str, Drawn] = {}
        wanted: list[str] = free
        while True:
            for slot in wanted:
                tries[slot] += 1
                if tries[slot] > poses_per_person:
                    return None, draws
                drawn[slot] = draw(slot)
                draws += 1
            angles = [*(d.wheel_angle for d in drawn.values()), *(given[slot].wheel_angle for slot in fixed)]
            before = validator.turned(seated, next((a for a in angles if a is not None), seated.wheel_angle))
            for slot in fixed:
                verdict, before = validator.admit(before, (slot, people[slot], poses[slot][1]))
                if verdict.rejection is not None and verdict.rejection.other in (*given, ""):
                    raise SceneError(
                        f"{cabin.name}: the given pose does not hold: {verdict.rejection}, {1000 * verdict.depth_m:.0f} mm deep",
                        hint="change scene.occupants, or leave out `pose` to have one solved",
                    )
                if verdict.rejection is not None:  # in the way of somebody who was drawn
                    causes[verdict.rejection] += 1
                    return None, draws
            if not wanted:
                after = before
                break
            found = settled([drawn[slot] for slot in free], around, before.placed)
            drawn = {slot: replace(d, sitter=d.sitter._replace(stand="settled")) for slot, d in drawn.items()}
            wanted, after = [], before
            for slot, pose in zip(free, found, strict=True):
                if pose.refused:
                    causes[Rejection("reach", slot, pose.refused, pose.held_up_by)] += 1
                    wanted.append(slot)
                    continue
                posed = people[slot].pose(pose.q, pose.vehicle_from_root, pose.fingers)
                verdict, admitted = validator.admit(after, (slot, people[slot], posed))
                refused = verdict.rejection
                if refused is None and bring is not None:
                    refused, admitted = bring(slot, pose, posed, admitted)
                if refused is None:
                    poses[slot], after = (pose, posed), admitted
                    continue
                causes[refused] += 1
                # Of two who do not fit the one who was drawn less often is drawn anew.
                met = refused.other
                wanted.append(met if met in free and tries[met] < tries[slot] else slot)
            wanted = list(dict.fromkeys(wanted))
            if not wanted:
                break
        seated, sitting = after, [*around, *(d.sitter._replace(stand="fixed") for d in drawn.values())]
    return Posed({slot: poses[slot] for slot in people}, seated), draws

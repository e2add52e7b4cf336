"""People take their seats: row after row, those of a row posed together, and who does not fit is drawn anew.

The solver lets all of a row give way to each other. What the verdict refuses then costs the person it names another draw of an
action and all that goes with it; where it names two, they take turns.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import NamedTuple

from cabinpose.scene.body import Person, PosedBody
from cabinpose.scene.cabin import Cabin, SeatSetting
from cabinpose.synth.posture.company import beside_each_other, close_seats, half_breadth
from cabinpose.synth.posture.sampling import Drawn, OccupantPose, settled
from cabinpose.synth.validate import Rejection, Seated, Validator

Draw = Callable[[str], Drawn]


class Posed(NamedTuple):
    """Who sits: pose and body by slot, and what the validator knows of them."""

    poses: dict[str, tuple[OccupantPose, PosedBody]]
    seated: Seated


def slimmest_in_the_middle(people: Mapping[str, str], cabin: Cabin, person: Callable[[str], Person]) -> dict[str, str]:
    """Names by slot, exchanged so that of three in a row the slimmest sits between the others."""
    result = dict(people)
    for slot in people:
        close = close_seats(cabin.seats[slot], cabin, tuple(people))
        if len(close) > 1:
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
) -> tuple[Posed | None, int]:
    """Seat everybody, or None; and the number of poses that were drawn for it. Rejections are counted in `causes`, in place.

    draw: what somebody in a slot seeks, drawn anew at each call.
    """
    poses: dict[str, tuple[OccupantPose, PosedBody]] = {}
    seated, sitting, draws = validator.empty(settings), dict[str, Drawn](), 0
    for row in rows_of(tuple(people), cabin):
        tries: Counter[str] = Counter()
        drawn: dict[str, Drawn] = {}
        wanted: list[str] = list(row)
        while wanted:
            for slot in wanted:
                tries[slot] += 1
                if tries[slot] > poses_per_person:
                    return None, draws
                drawn[slot] = draw(slot)
                draws += 1
            angle = next((d.wheel_angle for d in drawn.values() if d.wheel_angle is not None), seated.wheel_angle)
            before = validator.turned(seated, angle)
            around = [d.sitter._replace(stand="fixed") for d in sitting.values()]
            found = settled([drawn[slot] for slot in row], around, before.placed)
            drawn = {slot: replace(d, sitter=d.sitter._replace(stand="settled")) for slot, d in drawn.items()}
            wanted, after = [], before
            for slot, pose in zip(row, found, strict=True):
                if pose.refused:
                    causes[Rejection("reach", slot, pose.refused, pose.held_up_by)] += 1
                    wanted.append(slot)
                    continue
                posed = people[slot].pose(pose.q, pose.vehicle_from_root)
                verdict, after = validator.admit(after, (slot, people[slot], posed))
                if verdict.rejection is None:
                    poses[slot] = (pose, posed)
                    continue
                causes[verdict.rejection] += 1
                # Of two who do not fit the one who was drawn less often is drawn anew.
                met = verdict.rejection.other
                wanted.append(met if met in row and tries[met] < tries[slot] else slot)
            wanted = list(dict.fromkeys(wanted))
        seated, sitting = after, sitting | drawn
    return Posed({slot: poses[slot] for slot in people}, seated), draws

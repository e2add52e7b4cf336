"""People take their seats one after the other, and who leaves no room for the next is posed again.

Somebody whose pose fails is posed again alone: those who sit were valid and stay. Where it fails against the same neighbour
again and again the neighbour gets up and takes another pose; two who cannot sit side by side at all end the attempt.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from cabinpose.core.errors import SceneError
from cabinpose.core.pose import OCCUPANT_SLOTS
from cabinpose.scene.body import Person, PosedBody
from cabinpose.scene.cabin import Cabin
from cabinpose.synth.posture import OccupantPose
from cabinpose.synth.posture.company import Company, close_seats, company_of, half_breadth
from cabinpose.synth.validate import Seated, Validator

_PATIENCE = 3  # failures against one neighbour before he is posed again
_UPHEAVALS = 3  # of a scene: then other people are drawn

MakePose = Callable[[str, Company | None], OccupantPose]


class Boarded(NamedTuple):
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


def boarding_order(slots: Sequence[str], cabin: Cabin) -> list[str]:
    """The order in which people take their seats: the standard's, in each row the one with most neighbours first."""

    def rank(slot: str) -> tuple[float, int, int]:
        seat = cabin.seats[slot]
        row = min(OCCUPANT_SLOTS.index(slot), *(OCCUPANT_SLOTS.index(s) for s in close_seats(seat, cabin, slots)), 99)
        return row, -len(close_seats(seat, cabin, slots)), OCCUPANT_SLOTS.index(slot)

    return sorted(slots, key=rank)


def board(
    people: Mapping[str, Person],
    cabin: Cabin,
    validator: Validator,
    empty: Seated,
    make_pose: MakePose,
    *,
    poses_per_person: int,
    causes: Counter[str],
    rng: np.random.Generator,
) -> tuple[Boarded | None, int]:
    """Seat everybody, or None; and the number of poses it took. Rejections are counted in `causes`, in place.

    make_pose: gives a pose for a slot among these neighbours, or raises SceneError.
    """
    order = boarding_order(tuple(people), cabin)
    poses: dict[str, tuple[OccupantPose, PosedBody]] = {}
    before = [empty]  # each person
    proposals, upheavals, n = 0, 0, 0
    tries: Counter[str] = Counter()
    against: Counter[str] = Counter()
    company: Company | None = None
    known: str | None = None
    while n < len(order):
        slot = order[n]
        if tries[slot] >= poses_per_person:
            return None, proposals
        if known != slot:
            company = _company(slot, people, cabin, poses, rng)
            known = slot
        tries[slot] += 1
        proposals += 1
        try:
            pose = make_pose(slot, company)
        except SceneError:
            causes["reach"] += 1
            continue
        posed = people[slot].pose(pose.q, pose.vehicle_from_root)
        verdict, seated = validator.admit(before[n], (slot, people[slot], posed), pose.wheel_angle)
        if verdict.ok:
            poses[slot] = (pose, posed)
            before.append(seated)
            against.clear()
            n += 1
            continue
        causes[f"{verdict.cause}: {verdict.detail}"] += 1
        # Whoever collides with himself between neighbours lacks room as well.
        close = [s for s in close_seats(cabin.seats[slot], cabin, order) if s in poses]
        culprit = verdict.other or next(iter(close), "")
        if culprit:
            against[culprit] += 1
            if against[culprit] >= _PATIENCE:
                upheavals += 1
                if upheavals > _UPHEAVALS:
                    return None, proposals
                n = order.index(culprit)
                for later in order[n:]:
                    poses.pop(later, None)
                del before[n + 1 :]
                against.clear()
                known = None
    return Boarded({s: poses[s] for s in people}, before[-1]), proposals


def _company(
    slot: str,
    people: Mapping[str, Person],
    cabin: Cabin,
    poses: Mapping[str, tuple[OccupantPose, PosedBody]],
    rng: np.random.Generator,
) -> Company | None:
    others = {s: person for s, person in people.items() if s != slot}
    skins: dict[str, NDArray[np.float32]] = {s: posed.skin for s, (_, posed) in poses.items()}
    return company_of(people[slot], slot, cabin, others, skins, rng=rng)

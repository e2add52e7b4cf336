"""What the people in one car do, and their poses: row by row, those of a row solved together; who does not fit is drawn again.

The solver lets all of a row give way to each other. What the verdict refuses then costs the person it names another draw of an
action and all that goes with it; where it names two, they take turns.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from cabinpose.core import ConfigError, SceneError
from cabinpose.scene.body import PosedBody
from cabinpose.scene.cabin import Cabin
from cabinpose.synth.casting import Cast
from cabinpose.synth.config import CabinScene
from cabinpose.synth.posture import FREE_POSES, IN_CARRIER, FreePose, draw_free_pose, draw_offset, random_action
from cabinpose.synth.posture.actions import ACTIONS, IN_CHILD_SEAT
from cabinpose.synth.posture.context import SeatContext
from cabinpose.synth.posture.goals import given as as_given
from cabinpose.synth.posture.neighbours import Neighbours, beside_each_other, neighbours_of
from cabinpose.synth.posture.sampling import Doing, Drawn, OccupantPose, Prescribed, draw_pose, settled
from cabinpose.synth.posture.solver import Sitter
from cabinpose.synth.scene import Attempts
from cabinpose.synth.streams import weighted
from cabinpose.synth.validate import Rejection, Seated

Draw = Callable[[str], Drawn]  # the goals of the person in a slot, anew with each call
# Puts what somebody who sits has in hand and on the lap to the rest, or says why there is no room for it.
Bring = Callable[[str, OccupantPose, PosedBody, Seated], tuple[Rejection | None, Seated]]


class Posed(NamedTuple):
    """Who sits: pose and body by slot, and what the validator knows of them."""

    poses: dict[str, tuple[OccupantPose, PosedBody]]
    seated: Seated


class Posing:
    """Draws what people do and poses them.

    poses_per_person: draws of one person before all is given up.
    """

    def __init__(self, scene: CabinScene, poses_per_person: int) -> None:
        self.scene, self._poses_per_person = scene, poses_per_person

    def goals(self, cast: Cast, slot: str, index: int, doing: Doing | None = None, *, rng: np.random.Generator) -> Drawn:
        """What somebody seeks; index: of a profile's combination or pose · doing: what is done, in place of a draw."""
        scene, seat = self.scene, cast.cabin.seats[slot]
        others = {s: person for s, person in cast.people.items() if s != slot}
        on = cast.child_seats.get(slot)
        if (free := self._free_pose(cast, slot, rng)) is not None:
            return draw_free_pose(SeatContext(cast.people[slot], seat, cast.settings[slot], cast.cabin, on=on), free, rng=rng)
        neighbours = neighbours_of(cast.people[slot], slot, cast.cabin, others, rng=rng)
        action = self._action(cast, slot, neighbours, rng) if doing is None else doing.action
        if action in FREE_POSES:  # asked for by `motion`
            where = SeatContext(cast.people[slot], seat, cast.settings[slot], cast.cabin, on=on)
            return draw_free_pose(where, FREE_POSES[action], rng=rng)
        offset = draw_offset(scene.people_jitter_m, np.radians(scene.people_jitter_deg), rng=rng)
        seated = SeatContext(cast.people[slot], seat, cast.settings[slot], cast.cabin, offset, neighbours, on)
        if doing is None:
            doing = Doing(action, in_hand=_in_hand(scene, action, rng), things=scene.held)
        initial = scene.occupant(slot).initial
        return draw_pose(seated, doing, Prescribed(scene.profile_of(slot), initial, index), rng=rng)

    def _free_pose(self, cast: Cast, slot: str, rng: np.random.Generator) -> FreePose | None:
        """What an infant in a carrier does, or a child without a seat; None for who sits."""
        asked, on = self.scene.occupant(slot).action, cast.child_seats.get(slot)
        if slot in cast.doing:
            return FREE_POSES[cast.doing[slot]]
        if asked in FREE_POSES:
            return FREE_POSES[str(asked)]
        if on is None or on.thing.lying is None:
            return None
        weights = {asked: 1.0} if asked is not None else self.scene.motion.get(slot, IN_CARRIER)
        action = weighted(weights, rng=rng)
        if action not in FREE_POSES:
            raise ConfigError(f"'{action}' makes no sense in a carrier", hint=f"there: {', '.join(IN_CARRIER)}")
        return FREE_POSES[action]

    def _action(self, cast: Cast, slot: str, neighbours: Neighbours, rng: np.random.Generator) -> str:
        scene, occupant = self.scene, self.scene.occupant(slot)
        in_child_seat = IN_CHILD_SEAT if slot in cast.child_seats else None
        weights = {occupant.action: 1.0} if occupant.action is not None else scene.motion.get(slot, in_child_seat)
        if weights:
            return weighted(weights, rng=rng)
        return random_action(cast.cabin.seats[slot], cast.cabin, rng=rng, neighbours=neighbours, in_hand=scene.in_hand > 0.0)

    def pose(self, cast: Cast, draw: Draw, bring: Bring, attempts: Attempts) -> Posed | None:
        """Pose everybody in a car, row by row; None where somebody finds no valid pose.

        Parameters
        ----------
        cast
            Who sits where, with what is on the seats. Poses that are given are judged, not solved.
        draw
            Called again after each rejection of a person.
        bring
            Called for everybody whose pose holds.
        attempts
            Counts draws and rejections, in place.

        Raises
        ------
        SceneError
            Where a given pose is not valid, whatever the other people do.
        """
        people, given, validator = cast.people, cast.given, cast.validator
        poses = {slot: (pose, people[slot].pose(pose.q, pose.vehicle_from_root, pose.fingers)) for slot, pose in given.items()}
        stay = {slot: as_given(people[slot], cast.cabin.seats[slot], p.q, p.vehicle_from_root) for slot, p in given.items()}
        seated, sitting = validator.empty(cast.settings, things=cast.things), list[Sitter]()
        for row in rows_of(tuple(people), cast.cabin):
            fixed, free = [slot for slot in row if slot in given], [slot for slot in row if slot not in given]
            around = [*sitting, *(stay[slot] for slot in fixed)]
            tries: Counter[str] = Counter()
            drawn: dict[str, Drawn] = {}
            wanted: list[str] = free
            while True:
                for slot in wanted:
                    tries[slot] += 1
                    if tries[slot] > self._poses_per_person:
                        return None
                    drawn[slot] = draw(slot)
                    attempts.proposals += 1
                    attempts.judged += 1
                angles = [*(d.wheel_angle for d in drawn.values()), *(given[slot].wheel_angle for slot in fixed)]
                before = validator.turned(seated, next((a for a in angles if a is not None), seated.wheel_angle))
                for slot in fixed:
                    verdict, before = validator.admit(before, (slot, people[slot], poses[slot][1]))
                    if verdict.rejection is not None and verdict.rejection.other in (*given, ""):
                        raise SceneError(
                            f"{cast.cabin.name}: the given pose does not hold: {verdict.rejection},"
                            f" {1000 * verdict.depth_m:.0f} mm deep",
                            hint="change scene.occupants, or leave out `pose` to have one solved",
                        )
                    if verdict.rejection is not None:  # in the way of somebody who was drawn
                        attempts.rejections[verdict.rejection] += 1
                        return None
                if not wanted:
                    after = before
                    break
                found = settled([drawn[slot] for slot in free], around, before.placed)
                drawn = {slot: replace(d, sitter=d.sitter._replace(stand="settled")) for slot, d in drawn.items()}
                wanted, after = [], before
                for slot, pose in zip(free, found, strict=True):
                    if pose.refused:
                        attempts.rejections[Rejection("reach", slot, pose.refused, pose.held_up_by)] += 1
                        wanted.append(slot)
                        continue
                    posed = people[slot].pose(pose.q, pose.vehicle_from_root, pose.fingers)
                    verdict, admitted = validator.admit(after, (slot, people[slot], posed))
                    refused = verdict.rejection
                    if refused is None:
                        refused, admitted = bring(slot, pose, posed, admitted)
                    if refused is None:
                        poses[slot], after = (pose, posed), admitted
                        continue
                    attempts.rejections[refused] += 1
                    # Of two who do not fit the one who was drawn less often is drawn anew.
                    met = refused.other
                    wanted.append(met if met in free and tries[met] < tries[slot] else slot)
                refusals, wanted = len(wanted), list(dict.fromkeys(wanted))
                attempts.judged += refusals - len(wanted)  # two in whose way one and the same person is
                if not wanted:
                    break
            seated, sitting = after, [*around, *(d.sitter._replace(stand="fixed") for d in drawn.values())]
        return Posed({slot: poses[slot] for slot in people}, seated)


def _in_hand(scene: CabinScene, action: str, rng: np.random.Generator) -> bool:
    """Whether somebody who does this has something in the hand."""
    how = ACTIONS[action].in_hand
    return how == "always" or (scene.in_hand > 0.0 and how == "sometimes" and rng.random() < scene.in_hand)


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

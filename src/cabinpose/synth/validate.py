"""Whether a scene is possible: bodies with themselves, with each other, with the car, in this order with early exit.

The order and the early exit are those of the thesis (section 5.2.1.3): a cheap test that fails spares the others.
Contact is not collision: flesh yields by `FLESH_M`, that of two people by `BOTH_YIELD_M`, seats by the `give_m` of their parts.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal, NamedTuple

import numpy as np

from cabinpose._native import contact as native
from cabinpose.core import CABINPOSE, Floats, Ints32
from cabinpose.scene.body import SEGMENTS, Person, PosedBody
from cabinpose.scene.contact import (
    FLESH_M,
    OUTSIDE,
    ContactField,
    ContactScene,
    PlacedField,
    PosedSolids,
    SolidTopology,
    person_contact,
    self_contact,
    solid_topology,
)
from cabinpose.scene.things import NOTHING_PLACED, RESTING_M, PlacedThing, in_the_way

AXIS_STEP_M = 0.02
# Limb, its bone from and to a joint, and the first part of it left out: shoulders lean into the backrest.
_AXES = tuple(
    row
    for s in "lr"
    for row in (
        (s + "upper_arm", s + "shoulder", s + "elbow", 0.3),
        (s + "forearm", s + "elbow", s + "wrist", 0.0),
        (s + "hand", s + "wrist", s + "hand", 0.0),
        (s + "shin", s + "knee", s + "ankle", 0.0),
        (s + "foot", s + "ankle", s + "foot", 0.0),
    )
)
_AXIS_ENDS = np.array([(CABINPOSE.index[start], CABINPOSE.index[end]) for _, start, end, _ in _AXES])
_AXIS_SKIPPED = np.array([skipped for *_, skipped in _AXES])
Cause = Literal["self", "person", "car", "reach", "way", "camera", "thing"]


Occupant = tuple[str, Person, PosedBody]


class _Body(NamedTuple):
    """Somebody to be judged: the slot, the solids of the posed body, its joints (20, 3) m."""

    slot: str
    solids: PosedSolids
    joints: Floats


class Rejection(NamedTuple):
    """Why a pose was refused, as codes; `str` gives it in words.

    cause: a body with itself, with another person or with the car; a hand or foot that misses its place ("reach"); a way that is
    too long ("way"); somebody before the lens ("camera"); a thing for which there is no place ("thing") · slot: the occupant,
    other: the one who was met · what: the solid, task or thing, or the action that a way leads to, into: the solid or part that
    was in its way, "" where none was · bone: whether it is the limb's bone, to which foam does not give way.
    """

    cause: Cause
    slot: str = ""
    what: str = ""
    into: str = ""
    other: str = ""
    bone: bool = False

    def __str__(self) -> str:
        if self.cause == "camera":
            return "somebody is right before the camera"
        if self.cause == "way":
            return f"{self.slot}: only a long way round leads to '{self.what}'"
        if self.cause == "reach":
            return f"{self.slot}: {self.what} misses its place" + (f", held up by {self.into}" if self.into else "")
        who = f"{self.slot}, {self.other}" if self.other else self.slot
        if self.into == OUTSIDE:
            return f"{who}: {self.what} reaches behind the car's surfaces"
        return f"{who}: {self.what} {'through' if self.bone else 'in'} {self.into}"


def by_cause(rejections: Mapping[Rejection, int]) -> dict[str, int]:
    """Rejections summed up by their causes, in order of name."""
    totals: Counter[str] = Counter()
    for rejection, count in rejections.items():
        totals[rejection.cause] += count
    return dict(sorted(totals.items()))


def most_common(rejections: Mapping[Rejection, int], count: int) -> str:
    """The most frequent rejections in words, with how often each occurred."""
    return "; ".join(f"{rejection} ({n})" for rejection, n in Counter(rejections).most_common(count))


SITTING = frozenset({"torso", "lthigh", "rthigh"})  # the solids of a body that a seat carries


def sits_too_deep(rejections: Mapping[Rejection, int]) -> bool:
    """Whether most of what the car refused are trunks and thighs: people who sink into what they sit on, or through it."""
    by_car = {rejection: count for rejection, count in rejections.items() if rejection.cause == "car"}
    sitting = sum(count for rejection, count in by_car.items() if rejection.what in SITTING)
    return 2 * sitting > sum(by_car.values())


class Verdict(NamedTuple):
    """Whether a scene holds; else why not: depth_m of the point found, below the surface it went through, where (3,) m."""

    rejection: Rejection | None = None
    depth_m: float = 0.0
    where: Floats | None = None

    @property
    def ok(self) -> bool:
        """Whether nothing was found."""
        return self.rejection is None

    @property
    def cause(self) -> Cause | None:
        """Which test failed."""
        return None if self.rejection is None else self.rejection.cause


@dataclass(frozen=True)
class Seated:
    """People who hold together in a cabin so set: what `Validator.admit` need not test again. Made by `Validator.empty`.

    placed: the cabin's fields there with those of the things in it, None where only bodies are judged.
    """

    settings: Mapping[str, Any]
    wheel_angle: float
    placed: PlacedField | None
    bodies: tuple[_Body, ...] = ()
    things: tuple[PlacedThing, ...] = ()


# People share the faces of their model: one cut serves them all, in every cabin. Known by the array itself, which is kept.
_TOPOLOGIES: dict[int, tuple[Ints32, SolidTopology]] = {}


class Validator:
    """Judges scenes in one cabin (or room), whose fields it holds."""

    def __init__(self, cabin: ContactScene | None, contact: ContactField | None = None) -> None:
        """Builds the cabin's fields, or takes those given; without a cabin only the bodies are tested."""
        self.contact = contact if contact is not None or cabin is None else ContactField(cabin)

    def check(self, occupants: Sequence[Occupant], settings: Mapping[str, Any], wheel_angle: float = 0.0) -> Verdict:
        """The verdict on occupants (slot, person, posed body) with these seat settings and wheel angle (rad)."""
        bodies = [self._body(occupant) for occupant in occupants]
        verdict = _among(bodies, 0)
        if verdict is None and self.contact is not None and bodies:
            verdict = _in_car(self.contact.at(settings, wheel_angle), bodies)
        return verdict or Verdict()

    def empty(self, settings: Mapping[str, Any], wheel_angle: float = 0.0, things: tuple[PlacedThing, ...] = ()) -> Seated:
        """The cabin so set (wheel angle in rad) with things on its seats and nobody in it yet."""
        if self.contact is None:
            return Seated(settings, wheel_angle, None)
        placed = self.contact.at(settings, wheel_angle).with_groups([thing.group() for thing in things])
        return Seated(settings, wheel_angle, placed, things=things)

    def turned(self, seated: Seated, wheel_angle: float) -> Seated:
        """The empty cabin with the wheel at another angle (rad); ValueError where somebody sits already, whom it could touch."""
        if wheel_angle == seated.wheel_angle:
            return seated
        if seated.bodies:
            raise ValueError("the wheel is turned before people sit down")
        return self.empty(seated.settings, wheel_angle, seated.things)

    def with_body(self, seated: Seated, occupant: Occupant) -> Seated:
        """The same with one more person, who was judged before."""
        return replace(seated, bodies=(*seated.bodies, self._body(occupant)))

    def admit(self, seated: Seated, occupant: Occupant) -> tuple[Verdict, Seated]:
        """Whether one more person fits.

        Only what the new person changes is tested: the person alone, with the others, and in the car.

        Parameters
        ----------
        seated
            The cabin and the people who are accepted already.
        occupant
            Slot, person and posed body of the new one.

        Returns
        -------
        Verdict
            As of `check` on all of them.
        Seated
            With the new person where the verdict is ok, else as it was.
        """
        bodies = (*seated.bodies, self._body(occupant))
        verdict = _among(bodies, len(bodies) - 1)
        if verdict is None and seated.placed is not None:
            verdict = _in_car(seated.placed, bodies[-1:])
        if verdict is not None:
            return verdict, seated
        return Verdict(), replace(seated, bodies=bodies)

    def bring(self, seated: Seated, thing: PlacedThing) -> tuple[Verdict, Seated]:
        """Whether a thing has room between the car, the people and the things that are there; if so it counts as there.

        Returns what `admit` does.
        """
        if seated.placed is not None and (obstacle := in_the_way(thing, seated.placed, RESTING_M)) is not None:
            return Verdict(Rejection("thing", thing.slot, thing.thing.kind, obstacle.part), obstacle.excess_m), seated
        alone = NOTHING_PLACED.with_groups([thing.group()])
        for slot, body, _ in seated.bodies:
            found = touched_by(alone, body, FLESH_M)
            if found is not None:
                rejection = Rejection("thing", thing.slot, thing.thing.kind, found[1], slot if slot != thing.slot else "")
                return Verdict(rejection, found[0]), seated
        return Verdict(), self.with_thing(seated, thing)

    def with_thing(self, seated: Seated, thing: PlacedThing) -> Seated:
        """The same with one more thing, which was judged before."""
        placed = None if seated.placed is None else seated.placed.with_groups([thing.group()])
        return replace(seated, placed=placed, things=(*seated.things, thing))

    def _body(self, occupant: Occupant) -> _Body:
        slot, person, posed = occupant
        return _Body(slot, PosedSolids.of(self._topology(person, posed), posed.skin), posed.joints)

    def _topology(self, person: Person, posed: PosedBody) -> SolidTopology:
        known = _TOPOLOGIES.get(id(person.skin_faces))
        if known is None:
            topology = solid_topology(person.skin_faces, person.skin_segment, SEGMENTS, posed.skin)
            known = _TOPOLOGIES[id(person.skin_faces)] = (person.skin_faces, topology)
        return known[1]


def _among(bodies: Sequence[_Body], first: int) -> Verdict | None:
    """Why the bodies from number `first` on do not hold by themselves, or with those before them; None where they do."""
    for slot, body, joints in bodies[first:]:
        found = self_contact(body, joints)
        if found is not None:
            pair, contact = found
            return Verdict(Rejection("self", slot, pair.two, pair.one), contact.depth_m, contact.where)
    for i in range(first, len(bodies)):
        slot, body, _ = bodies[i]
        for other_slot, other, _ in bodies[:i]:
            crossing = person_contact(body, other)
            if crossing is not None:
                which, contact = crossing
                return Verdict(Rejection("person", slot, which, contact.solid, other_slot), contact.depth_m, contact.where)
    return None


def _in_car(placed: PlacedField, bodies: Sequence[_Body]) -> Verdict | None:
    return next((v for body in bodies if (v := _against_car(placed, body)) is not None), None)


def touched_by(alone: PlacedField, body: PosedSolids, tolerance_m: float) -> tuple[float, str] | None:
    """How deep the parts of a field are in a body beyond what they give and `tolerance_m`, and in which solid; None: not."""
    points, vertex = body.skin_points
    touched = alone.deepest(points, tolerance_m)
    if touched is not None:
        return touched.depth_m, body.solid_of(vertex[touched.point])
    probed = alone.deepest_probe(body, tolerance_m)
    return None if probed is None else (probed[1].depth_m, probed[1].solid)


def _against_car(placed: PlacedField, somebody: _Body) -> Verdict | None:
    slot, body, joints = somebody
    points, vertex = body.skin_points
    touched = placed.deepest(points, FLESH_M)
    if touched is not None:
        solid = body.solid_of(vertex[touched.point])
        return Verdict(Rejection("car", slot, solid, touched.part), touched.depth_m, touched.where)
    probed = placed.deepest_probe(body, FLESH_M)
    if probed is not None:
        part, contact = probed
        return Verdict(Rejection("car", slot, contact.solid, part), contact.depth_m, contact.where)
    # Foam gives way to the flesh of a limb, not to its bone.
    axis, limb = native.limb_axes(joints, _AXIS_ENDS, _AXIS_SKIPPED, AXIS_STEP_M)
    pierced = placed.deepest(axis, FLESH_M, give=False)
    if pierced is not None:
        rejection = Rejection("car", slot, _AXES[limb[pierced.point]][0], pierced.part, bone=True)
        return Verdict(rejection, pierced.depth_m, pierced.where)
    return None

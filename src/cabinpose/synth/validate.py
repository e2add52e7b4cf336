"""Whether a scene is possible: bodies with themselves, with each other, with the car, in this order with early exit.

The order and the early exit are those of the thesis (section 5.2.1.3): a cheap test that fails spares the others.
Contact is not collision: flesh yields by `FLESH_M`, seats by the `give_m` of their parts.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from time import perf_counter
from typing import Any, Literal, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from cabinpose.core.skeleton import INDEX
from cabinpose.scene.body.rig import SEGMENTS
from cabinpose.scene.contact import (
    FLESH_M,
    ContactField,
    ContactScene,
    PlacedField,
    PosedSolids,
    SolidTopology,
    person_contact,
    self_contact,
    solid_topology,
)

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
STAGES = ("solids", "self", "person", "car")
Cause = Literal["self", "person", "car"]


class Skinned(Protocol):
    """The part of `scene.body.Person` that contact needs."""

    @property
    def skin_faces(self) -> NDArray[np.int32]: ...
    @property
    def skin_segment(self) -> NDArray[np.uint8]: ...


class Posed(Protocol):
    """The part of `scene.body.PosedBody` that contact needs."""

    @property
    def skin(self) -> NDArray[np.float32]: ...
    @property
    def joints(self) -> NDArray[np.float64]: ...


class Verdict(NamedTuple):
    """Whether a scene holds; else why not.

    cause: which test failed · detail: who and what, such as "driver: lhand in steering_wheel" · depth_m: of the point
    found, below the surface it went through · where: (3,) m, vehicle frame · slot: the occupant.
    """

    ok: bool
    cause: Cause | None = None
    detail: str = ""
    depth_m: float = 0.0
    where: NDArray[np.float64] | None = None
    slot: str = ""


@dataclass
class Tally:
    """What a validator has done so far: scenes, occupants, rejections by cause and detail, seconds by test."""

    scenes: int = 0
    occupants: int = 0
    accepted: int = 0
    rejected: Counter[str] = field(default_factory=Counter)
    details: Counter[str] = field(default_factory=Counter)
    seconds: dict[str, float] = field(default_factory=lambda: dict.fromkeys(STAGES, 0.0))

    def add(self, other: Tally) -> None:
        """Adds what another validator has done."""
        self.scenes += other.scenes
        self.occupants += other.occupants
        self.accepted += other.accepted
        self.rejected.update(other.rejected)
        self.details.update(other.details)
        for stage, spent in other.seconds.items():
            self.seconds[stage] += spent


# People share the faces of their model: one cut serves them all, in every cabin. Known by the array itself, which is kept.
_TOPOLOGIES: dict[int, tuple[NDArray[np.int32], SolidTopology]] = {}


class Validator:
    """Judges scenes in one cabin (or room). Holds the cabin's fields and the tally of what it judged."""

    def __init__(self, cabin: ContactScene | None, contact: ContactField | None = None) -> None:
        """Builds the cabin's fields, or takes those given; without a cabin only the bodies are tested."""
        self.contact = contact if contact is not None or cabin is None else ContactField(cabin)
        self.tally = Tally()

    def check(
        self,
        occupants: Sequence[tuple[str, Skinned, Posed]],
        settings: Mapping[str, Any],
        wheel_angle: float = 0.0,
    ) -> Verdict:
        """The verdict on occupants (slot, person, posed body) with these seat settings and wheel angle (rad)."""
        self.tally.scenes += 1
        self.tally.occupants += len(occupants)
        verdict = self._judge(occupants, settings, wheel_angle)
        if verdict.ok:
            self.tally.accepted += 1
        else:
            self.tally.rejected[str(verdict.cause)] += 1
            self.tally.details[f"{verdict.cause}: {verdict.detail.partition(': ')[2]}"] += 1
        return verdict

    def _judge(self, occupants: Sequence[tuple[str, Skinned, Posed]], settings: Mapping[str, Any], wheel_angle: float) -> Verdict:
        clock = perf_counter()
        bodies = []
        for slot, person, posed in occupants:
            body = PosedSolids.of(self._topology(person, posed), posed.skin)
            bodies.append((slot, body, posed))
        clock = self._lap("solids", clock)
        for slot, body, posed in bodies:
            found = self_contact(body, posed.joints)
            if found is not None:
                pair, contact = found
                clock = self._lap("self", clock)
                return Verdict(False, "self", f"{slot}: {pair.two} in {pair.one}", contact.depth_m, contact.where, slot)
        clock = self._lap("self", clock)
        for i, (slot, body, _) in enumerate(bodies):
            for other_slot, other, _ in bodies[:i]:
                crossing = person_contact(body, other)
                if crossing is not None:
                    which, contact = crossing
                    self._lap("person", clock)
                    detail = f"{slot}, {other_slot}: {which} in {contact.solid}"
                    return Verdict(False, "person", detail, contact.depth_m, contact.where, slot)
        clock = self._lap("person", clock)
        if self.contact is not None and bodies:
            placed = self.contact.at(settings, wheel_angle)
            for slot, body, posed in bodies:
                verdict = self._against_car(placed, slot, body, posed)
                if verdict is not None:
                    self._lap("car", clock)
                    return verdict
            self._lap("car", clock)
        return Verdict(True)

    def _against_car(self, placed: PlacedField, slot: str, body: PosedSolids, posed: Posed) -> Verdict | None:
        points, vertex = body.skin_points()
        touched = placed.deepest(points, FLESH_M)
        if touched is not None:
            solid = body.solid_of(vertex[touched.point])
            return Verdict(False, "car", f"{slot}: {solid} in {touched.part}", touched.depth_m, touched.where, slot)
        probed = placed.deepest_probe(body, FLESH_M)
        if probed is not None:
            part, contact = probed
            return Verdict(False, "car", f"{slot}: {contact.solid} in {part}", contact.depth_m, contact.where, slot)
        axis, limb = _limb_axes(posed.joints)
        pierced = placed.deepest(axis, FLESH_M, give=False)
        if pierced is not None:
            detail = f"{slot}: {limb[pierced.point]} through {pierced.part}"
            return Verdict(False, "car", detail, pierced.depth_m, pierced.where, slot)
        return None

    def _topology(self, person: Skinned, posed: Posed) -> SolidTopology:
        known = _TOPOLOGIES.get(id(person.skin_faces))
        if known is None:
            topology = solid_topology(person.skin_faces, person.skin_segment, SEGMENTS, posed.skin)
            known = _TOPOLOGIES[id(person.skin_faces)] = (person.skin_faces, topology)
        return known[1]

    def _lap(self, stage: str, since: float) -> float:
        now = perf_counter()
        self.tally.seconds[stage] += now - since
        return now


def _limb_axes(joints: NDArray[np.float64]) -> tuple[NDArray[np.float32], list[str]]:
    """Points (N, 3) every `AXIS_STEP_M` along the limbs' bones, and the limb of each.

    Foam gives way to the flesh of a limb, not to its bone: an arm that passes through a backrest is nowhere deeper in
    it than the foam gives, but its axis is inside.
    """
    points, names = [], []
    for name, start, end, skipped in _AXES:
        a, b = joints[INDEX[start]], joints[INDEX[end]]
        count = max(int(np.linalg.norm(b - a) / AXIS_STEP_M), 2)
        points.append(a + np.linspace(skipped, 1.0, count)[:, None] * (b - a))
        names += [name] * count
    return np.concatenate(points).astype(np.float32), names

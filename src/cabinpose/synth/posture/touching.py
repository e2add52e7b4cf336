"""A last correction of solved poses: a hand, or what it holds, is brought onto the surface that it is to touch.

The solver keeps samples of the skin off what is hard, and aims with points of the skeleton; both leave some centimetres. Here the
least distance of the real surfaces is closed along their normal, with the arm alone as far as it reaches, and fingers that grasp
close until each of them touches. What else is in the way then is for the verdict.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache
from typing import NamedTuple

import numpy as np

from cabinpose.core import Floats, Ints, Matrix, apply, invert, transform
from cabinpose.core import reproducible as rp
from cabinpose.scene.body import BONE_INDEX, DOF_INDEX, SEGMENTS, Person, by_phalanx, vertex_segments
from cabinpose.scene.cabin import SteeringWheel, Wearer
from cabinpose.scene.contact import STATIC_GROUP, GroupPart, PlacedField, TriangleMesh, triangle_mesh
from cabinpose.scene.things import make_thing
from cabinpose.synth.posture.context import SeatContext
from cabinpose.synth.posture.frames import frames
from cabinpose.synth.posture.goals import hand_to
from cabinpose.synth.posture.grasps import OPEN_HAND, Hold, fingers_around_rim, fingers_closed_on
from cabinpose.synth.posture.memory import kept_with_person
from cabinpose.synth.posture.solver import Sitter

TOUCH_M = 0.001  # of the skin, pressed in by what it touches
_CLOSE_M = 0.0007  # a distance that is as near to that as this is right
_SEEN_M, _MOST_M = 0.12, 0.10  # how far surfaces are looked for, and hands are moved
_STEPS, _ROUNDS = 8, 3
_PROBE_M = 0.0005  # of the differences that give a distance's direction
_AWAY_M = 0.08  # of the part that is touched from the place that is reached for
_WEBBING_M = 0.002  # felt on both sides of a belt
_FEW, _BESIDE_M = 12, 0.010  # one of so many points tells how far to look; others are deeper by no more than that
_EVERY = 2  # of the vertices of hands
_LEAST_GRIP = 0.01  # with which fingers can still be posed one by one


class Touch(NamedTuple):
    """What a hand (0 left, 1 right), or the thing in it, is to touch.

    point: (3,) m, vehicle frame: the part of the car that is nearest to it · belt: whose belt, in place of that · rim: the wheel
    whose rim the hand holds, and how much less than that each finger, thumb first, is closed (5,); without any of them it is the
    own head · grasps: whether the fingers close around it.
    """

    side: int
    point: Floats | None = None
    belt: SeatContext | None = None
    rim: tuple[SteeringWheel, Floats] | None = None
    grasps: bool = False


class _Meeting(NamedTuple):
    """Points (N, 3) m, vehicle frame, and the surfaces that they are to meet, in a frame of their own.

    moving: +1 where the points go with the hand, -1 where the surfaces do · shell_m: of the surfaces.
    """

    points: Floats
    meshes: Sequence[TriangleMesh]
    mesh_from_vehicle: Matrix
    moving: float = 1.0
    shell_m: float = 0.0

    def distance(self, shift: Floats, rows: Ints | slice = slice(None), seen_m: float = _SEEN_M) -> Floats:
        """(N,) m of the points, with the hand moved by `shift` (3,) m."""
        return self._signed(self.points[rows] + self.moving * shift, seen_m)

    def _signed(self, points: Floats, seen_m: float) -> Floats:
        local = apply(self.mesh_from_vehicle, points)
        return np.asarray(np.min([mesh.signed_distance(local, seen_m) for mesh in self.meshes], axis=0) - self.shell_m)

    def nearest(self, shift: Floats) -> tuple[float, Floats]:
        """The least distance (m), and the direction (3,) in which the hand goes away from it fastest."""
        few = self.distance(shift, slice(None, None, _FEW))
        distance = self.distance(shift, seen_m=min(abs(float(few.min())) + _BESIDE_M + self.shell_m, _SEEN_M))
        point = int(np.argmin(distance))
        away = min(abs(float(distance[point])) + self.shell_m + 2.0 * _PROBE_M, _SEEN_M)
        sides = self._signed(self.points[point] + self.moving * (shift + _PROBES), away)
        return float(distance[point]), np.array([sides[2 * axis] - sides[2 * axis + 1] for axis in range(3)])


def _shift(meetings: Sequence[_Meeting]) -> Floats | None:
    """(3,) m by which a hand meets the first of some surfaces that it comes to; None where it is too far from all of them."""
    shift = np.zeros(3)
    for _ in range(_STEPS):
        distance, grows = min((meeting.nearest(shift) for meeting in meetings), key=lambda found: found[0])
        off, length = distance + TOUCH_M, rp.norm(grows)
        if abs(off) < _CLOSE_M:
            break
        if length < 1e-9:  # nothing is within what is seen
            return None
        shift = shift - off * grows / length
    return shift if rp.norm(shift) < _MOST_M else None


_PROBES = np.concatenate([np.stack((row, -row)) for row in _PROBE_M * np.eye(3)])


def meet(who: Sitter, touch: Touch, fingers: Floats, hold: Hold | None, placed: PlacedField | None) -> Floats:
    """Bring a hand to what it touches, in place of q of somebody whose pose is solved.

    Parameters
    ----------
    who
        Of which the arm, and where it is too short the trunk, is moved.
    touch, hold
        What is touched, and what the hand holds.
    fingers
        (2, 6) or (2, 16) as `Person.pose` takes them.
    placed
        The car's fields; None: without a car.

    Returns
    -------
    Floats
        The fingers, those of a hand that grasps closed around what it touches.
    """
    if touch.rim is not None:
        return _closed_on_rim(who, touch.side, *touch.rim, fingers) if touch.grasps else fingers
    part = None
    if touch.belt is not None:
        part = _belt(who, touch.belt)
    elif touch.point is not None and (part := _nearest_part(touch.point, placed)) is None:
        return fingers
    if touch.grasps:
        fingers = by_phalanx(fingers).copy()
        fingers[touch.side] = (*np.repeat(OPEN_HAND, 3), np.nan)
    bounds = who.goals.lower, who.goals.upper
    for _ in range(_ROUNDS):
        shift = _shift(_meetings(who, touch, fingers, hold, part))
        if shift is None or rp.norm(shift) < _CLOSE_M:
            break
        palm = frames(who.q, who.person.rest, who.root).palms[touch.side]
        who.q[:] = hand_to(who.person, who.q, who.root, touch.side, palm[:3, 3] + shift, bounds=bounds)
    if touch.grasps and part is not None:
        palm = frames(who.q, who.person.rest, who.root).palms[touch.side]
        curl = fingers_closed_on(who.person, part.mesh, palm, touch.side, shell_m=part.shell_m)
        fingers[touch.side] = (*np.repeat(curl, 3), np.nan)
        who.q[DOF_INDEX["lr"[touch.side] + "hand.grip"]] = max(float(curl[1:].min()), _LEAST_GRIP)
    return fingers


def _closed_on_rim(who: Sitter, side: int, wheel: SteeringWheel, loose: Floats, fingers: Floats) -> Floats:
    """(2, 16) fingers, those of one hand around the rim on which its palm lies."""
    fingers = by_phalanx(fingers).copy()
    hand = frames(who.q, who.person.rest, who.root).bone("lr"[side] + "hand")
    curl = fingers_around_rim(who.person, wheel, hand, side) * (1.0 - loose[1:, None])
    fingers[side, 3:15] = curl.reshape(-1)
    return fingers


def _meetings(who: Sitter, touch: Touch, fingers: Floats, hold: Hold | None, part: GroupPart | None) -> list[_Meeting]:
    """What is not to go farther than a touch: the hand into the part, or hand and thing into the head."""
    person, q, root = who.person, who.q, who.root
    skin, here = person.skin_part(_hand_rows(touch.side), fingers)(q, root), frames(q, person.rest, root)
    if part is not None:
        return [_Meeting(skin, [part.mesh], np.eye(4), shell_m=part.shell_m)]
    result = [_Meeting(skin, [_head(person)], invert(here.bone("head")))]
    if hold is not None and hold.side == touch.side:
        thing_from_vehicle = invert(hold.placed(here.palms[touch.side]))
        meshes = [each.mesh for each in make_thing(hold.kind, hold.variant).field.parts]
        result.append(_Meeting(person.skin_part(_head_rows())(q, root), meshes, thing_from_vehicle, -1.0))
    return result


@cache
def _hand_rows(side: int) -> Ints:
    return np.flatnonzero(vertex_segments() == SEGMENTS.index("lr"[side] + "hand"))[::_EVERY]


@cache
def _head_rows() -> Ints:
    return np.flatnonzero(vertex_segments() == SEGMENTS.index("head"))


@kept_with_person
def _head(person: Person) -> TriangleMesh:
    """The skin of the head, in the frame of its bone."""
    inside = np.isin(person.skin_faces, _head_rows()).all(axis=1)
    used, faces = np.unique(person.skin_faces[inside], return_inverse=True)
    bone = BONE_INDEX["head"]
    from_bone = transform(person.rest.frames[bone], person.rest.heads[bone])
    return triangle_mesh(apply(invert(from_bone), person.rest_skin[used]), faces.reshape(-1, 3), closed=True)


def _belt(who: Sitter, seated: SeatContext) -> GroupPart:
    """The belt over somebody as it is worn right."""
    posed = who.person.pose(who.q, who.root)
    belt = Wearer.of(posed.surface(0), posed.joints).belt(seated.seat, seated.setting, seated.cabin)
    return GroupPart("belt", triangle_mesh(belt.vertices, belt.faces, closed=False), 0.0, _WEBBING_M)


def _nearest_part(point: Floats, placed: PlacedField | None) -> GroupPart | None:
    """The part of a car's body that is nearest to a point (3,) m; None where none is near."""
    field = next((field for field, *_ in placed.groups if field.name == STATIC_GROUP), None) if placed is not None else None
    if field is None:
        return None
    beside = np.maximum(field.part_low - point, point - field.part_high).max(axis=1)
    best, nearest = None, _AWAY_M
    for row in np.flatnonzero(beside < _AWAY_M):
        away = abs(float(field.parts[row].mesh.signed_distance(point[None], _AWAY_M)[0]))
        if away < nearest:
            best, nearest = field.parts[row], away
    return best

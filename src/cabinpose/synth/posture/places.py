"""Places of hands: one class each, with everything that being there means for the hand.

The rows of `actions` name a place for each hand. A new place is a class here, or one of another package that an action of that
package names.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from types import MappingProxyType
from typing import ClassVar, Literal, NamedTuple

import numpy as np

from cabinpose.core import Floats, Floats32, Matrix, apply, axis_rotation, cross, transform
from cabinpose.core import reproducible as rp
from cabinpose.scene.body import BONE_INDEX, SEGMENTS, Person
from cabinpose.scene.cabin import Cabin, Seat, SteeringWheel
from cabinpose.synth.posture import hands as at
from cabinpose.synth.posture.context import SeatContext, Trunk
from cabinpose.synth.posture.hands import Fingers, LimbTask

Noise = tuple[float, float, float]  # standard normal numbers of one hand, cut at 2
_UP = np.array([0.0, 0.0, 1.0])
_SOFT_MISS_M = 0.12  # a hand that rests or points may stay this short of its place; one on the wheel may not
_LOOSER = 0.055  # of a grip around the rim, so that its spread presses no finger into it
_BESIDE_DOOR_M = 0.04  # of a palm's middle from the door's armrest point, for half a hand's width
_OVER_ARMREST_M = 0.020
_ARM_BEFORE = np.array((0.12, 0.03))  # along the thigh and inwards: a hand that brings its arm before the body, beside neighbours
_PHONE_M = 0.048  # from the ear to the palm that holds one to it, with what the hand needs
_ADULT_M = 1.75
_HEAD_M, _MOUTH_BELOW_NOSE_M = 0.23, 0.045  # an adult's head from chin to crown
_CARRIED_ALONG, _CARRIED_M = 0.55, 0.14  # of a hand that holds something: share of the thigh, and over its skin
_OVER_THIGH_M = 0.03  # of the lower end of what is carried upright
_REACHED_SIGMA_M = 0.012
# The axis of what is drunk from, above the level of the head: some 20 deg when it is full, more when it is not (assumed).
_RAISED, _FROM_ASIDE, _LIPS_M = (math.radians(22.0), math.radians(9.0)), 0.15, 0.004
_LOWERED = (math.radians(-40.0), math.radians(8.0))  # the same of what is bitten off (assumed)
_OVER_BUCKLE_M, _BESIDE_CUSHION_M = 0.07, 0.30  # of a palm from a belt's buckle, and of fingertips from the seat's middle
# Of a hand that drinks from nothing, and that eats nothing.
_ASSUMED_BOX = np.array(((-0.03, -0.03, 0.0), (0.03, 0.03, 0.2)), np.float32)
_ASSUMED_BITE = np.array(((-0.03, -0.03, 0.0), (0.03, 0.03, 0.08)), np.float32)
_KNOB_IN_PALM_M, _MIRROR_IN_PALM_M = np.array((0.010, 0.0, 0.018)), np.array((0.030, 0.0, 0.010))
_BEHIND_RIM_M, _LEAST_ALONG = 0.01, 0.50  # fingertips that end before the wheel's rim; share of the thigh
_BACK_OUT_M = 0.12  # for a whole thigh: hands nearer to the hips would meet, as thighs do


class Reach(NamedTuple):
    """Where a hand goes that reaches, vehicle frame: (3,) m.

    side: the hand that goes there, None for the inboard one · palm: `vehicle_from_palm` (4, 4) sought there, None for one that
    points · touched: whether the hand touches what of the car is there.
    """

    point: Floats
    side: int | None = None
    palm: Matrix | None = None
    touched: bool = False


class InHand(NamedTuple):
    """A thing in a hand: palm_from_thing (4, 4) of that hand, and how high it stands, m."""

    palm_from_thing: Matrix
    height_m: float


class Hand(NamedTuple):
    """One hand's intent, drawn once: its place, three standard normal numbers, and the angle at which it would hold a wheel that
    stands straight (rad from the top, + left).

    reach: where it goes, of places that reach · fingers: how they lie, (6,) as `Person.pose` takes them, NaN where they follow
    the grip · below_m: how far what it carries upright reaches below the palm, None for what is carried flat · thing: what is in
    it.
    """

    place: HandPlace
    noise: Noise
    clock: float
    reach: Reach | None = None
    fingers: Floats = at.BY_GRIP
    below_m: float | None = None
    thing: InHand | None = None

    @property
    def palm(self) -> Matrix | None:
        """`vehicle_from_palm` (4, 4), where it is given."""
        return None if self.reach is None else self.reach.palm


class Around(NamedTuple):
    """A hand around what stands, its top to the thumb, at a share `level` of its height."""

    level: float

    def turned(self, box: Floats32) -> Matrix:
        """palm_from_thing (4, 4) of a left hand, the middle of a thing in `box` (2, 3) m in the palm's origin."""
        level = self.level * float(box[1, 2])
        return transform(np.array(((1.0, 0.0, 0.0), (0.0, 0.0, 1.0), (0.0, -1.0, 0.0))), (0.0, -level, 0.0))


class Flat(NamedTuple):
    """Something flat in the palm, its face out: its long side y along the fingers, `slant` (rad) from them.

    beyond_m: of its middle beyond the palm's.
    """

    slant: float
    beyond_m: float = 0.0

    def turned(self, box: Floats32) -> Matrix:
        """See `Around.turned`."""
        return transform(axis_rotation("z", self.slant - math.pi / 2.0), (self.beyond_m, 0.0, 0.0))


class HandPlace:
    """A place that hands seek.

    Attributes
    ----------
    name
        By which things say where hands hold them (`Kind.held_at`).
    carried_by
        The bone that takes the place along, {side}: l or r; "" for the vehicle.
    shapes
        How fingers may lie there, () where they follow the grip.
    grip
        By which fingers are closed that nothing else bends, 0 to 1.
    miss_m
        How far a palm may stay from it.
    held
        How a thing lies in a hand there, None where hands hold none.
    spared
        Whether a hand may leave it to hold something.
    reaches, watched
        Whether the trunk turns to its side, and whether a gaze that follows a hand goes there.
    on_wheel
        Whether the hand is closed around the wheel.
    passes_on
        Whether the hand leaves room for another one at what it holds.
    touches
        What the hand there, or what it holds, is brought to once the pose is solved: the car, the belt, the own head, or the rim
        that it lies on.
    grasps
        Whether its fingers close around that.
    """

    name: ClassVar[str]
    carried_by: ClassVar[str] = ""
    shapes: ClassVar[tuple[Fingers, ...]] = ()
    grip: ClassVar[float] = 0.0
    miss_m: ClassVar[float] = _SOFT_MISS_M
    held: ClassVar[Around | Flat | None] = None
    spared: ClassVar[bool] = False
    reaches: ClassVar[bool] = False
    watched: ClassVar[bool] = False
    on_wheel: ClassVar[bool] = False
    passes_on: ClassVar[bool] = False
    touches: ClassVar[Literal["", "car", "belt", "head", "rim"]] = ""
    grasps: ClassVar[bool] = False

    def exists(self, seat: Seat, cabin: Cabin) -> bool:
        """Whether a seat has this place."""
        return True

    def chosen(self, seated: SeatContext, other: HandPlace, inboard: bool, chance: float) -> HandPlace:
        """The place itself, or the one that it stands for in a seat.

        other: the other hand's, as its action says · inboard: whether this is the hand at the inboard side · chance: 0 to 1.
        """
        return self

    def reach(self, seated: SeatContext, target: Floats | None, given: Reach | None, noise: Noise) -> Reach | None:
        """Where the hand goes that reaches; None for places that do not depend on it.

        target: (3,) m, the action's in this cabin · given: in place of one of the cabin's.
        """
        return None

    def fingers(self, noise: Noise, rim: float | None) -> Floats:
        """(6,) fingers of a hand there, as `Person.pose` takes them; NaN where they follow the grip.

        noise: the hand's own, of which they are drawn · rim: the curl that holds the wheel before the seat, None where is none.
        """
        return at.resting_fingers(noise, self.shapes) if self.shapes else at.BY_GRIP

    def task(self, trunk: Trunk, hand: Hand, side: int) -> LimbTask:
        """The target of the palm of a hand (0 left, 1 right), for the trunk as it is now."""
        raise NotImplementedError


class _Wheel(HandPlace):
    """Closed around the rim."""

    name, miss_m, on_wheel, touches = "wheel", at.RIM_MISS_M, True, "rim"

    def exists(self, seat: Seat, cabin: Cabin) -> bool:
        return seat.slot == "driver" and cabin.steering_wheel is not None

    def fingers(self, noise: Noise, rim: float | None) -> Floats:
        return at.BY_GRIP if rim is None else at.fingers_on_rim(noise, rim - _LOOSER)

    def task(self, trunk: Trunk, hand: Hand, side: int) -> LimbTask:
        wheel = trunk.seated.wheel
        assert wheel is not None  # see `exists`
        hold = at.rim_grip(trunk.seated.person, wheel.rim_section_m)
        return at.on_rim(wheel, at.regripped(hand.clock, trunk.wheel_angle), hold, 0.5 + 0.1 * hand.noise[1], side)


class _Thigh(HandPlace):
    """At rest on its own thigh."""

    name, carried_by, shapes, spared = "thigh", "{side}thigh", at.RESTING, True

    def fingers(self, noise: Noise, rim: float | None) -> Floats:
        return at.resting_fingers(noise, self.shapes if rim is None else at.UNDER_WHEEL)

    def task(self, trunk: Trunk, hand: Hand, side: int) -> LimbTask:
        a, b, c = hand.noise
        before = _ARM_BEFORE if trunk.seated.neighbours.close[side] else 0.0
        along, inward = before + np.array((0.69 + 0.06 * a, 0.015 + 0.015 * b))
        if trunk.seated.wheel is not None:
            along = min(along, max(self._behind_rim(trunk, trunk.seated.wheel, side), _LEAST_ALONG) + 0.03 * (a - 2.0))
        inward -= _BACK_OUT_M * max(0.69 - along, 0.0)
        lies = at.lying(trunk.seated.person, hand.fingers)
        return at.on_thigh(trunk, side, float(along), float(inward), 0.45 + 0.15 * c, lies)

    def _behind_rim(self, trunk: Trunk, wheel: SteeringWheel, side: int) -> float:
        """The share of the thigh at which the fingertips end before the wheel's rim."""
        thigh, person = trunk.skeleton.bone("lr"[side] + "thigh"), trunk.seated.person
        ahead = rp.matmul(wheel.grip_point(math.pi) - thigh[:3, 3], trunk.seated.forward) - _BEHIND_RIM_M
        hand = at.HAND_M * person.stature_m / _ADULT_M
        return (float(ahead) - hand) / (
            person.segment_lengths["thigh"] * max(-rp.matmul(thigh[:3, 2], trunk.seated.forward), 0.5)
        )


class _Armrest(HandPlace):
    """At rest on the door's armrest, palm down."""

    name, shapes, spared, touches = "armrest", at.RESTING, True, "car"

    def exists(self, seat: Seat, cabin: Cabin) -> bool:
        return self._point(seat, cabin) is not None

    def _point(self, seat: Seat, cabin: Cabin) -> Floats | None:
        """Of the door beside a seat; None for a middle seat."""
        y = float(seat.design_h_point[1])
        row = "rear_" if seat.slot.startswith("rear") else ""
        return None if abs(y) < 0.05 else cabin.reach_targets.get(f"{row}armrest_{'left' if y > 0 else 'right'}")

    def reach(self, seated: SeatContext, target: Floats | None, given: Reach | None, noise: Noise) -> Reach | None:
        point = self._point(seated.seat, seated.cabin)
        return None if point is None else Reach(point, touched=True)

    def task(self, trunk: Trunk, hand: Hand, side: int) -> LimbTask:
        assert hand.reach is not None  # see `exists`
        s, point = trunk.seated, hand.reach.point
        inward = s.seat.design_h_point - point
        beside = _BESIDE_DOOR_M * np.array([0.0, math.copysign(1.0, inward[1]), 0.0])
        lies = at.lying(s.person, hand.fingers)
        middle = point + (0.10 + 0.02 * hand.noise[0]) * s.forward + beside
        pitched = transform(axis_rotation("y", lies.pitch))
        target = rp.matmul(at.palm_frame(middle + (lies.above + _OVER_ARMREST_M) * _UP, -_UP, s.forward), pitched)
        return LimbTask.firm(target, (0.06, 0.06, 0.02), at.SIDE_ARM)


class _Either(HandPlace):
    """Wherever hands are that have nothing to do: on the wheel, in the lap, on the armrest."""

    name, spared = "either", True

    def chosen(self, seated: SeatContext, other: HandPlace, inboard: bool, chance: float) -> HandPlace:
        if seated.wheel is not None:
            return WHEEL if other is not WHEEL and chance < 0.8 else THIGH
        return ARMREST if not inboard and chance < 0.2 and ARMREST.exists(seated.seat, seated.cabin) else THIGH


class _Ear(HandPlace):
    """A telephone at the own ear: its upper end, which stands out of the hand, at the ear, the lower one towards the mouth."""

    name, carried_by, grip, held, touches = "ear", "head", 0.5, Flat(math.radians(5.0), 0.045), "head"

    def task(self, trunk: Trunk, hand: Hand, side: int) -> LimbTask:
        head, s, skin = trunk.skeleton.bone("head"), 1.0 - 2.0 * side, _skin(trunk.seated.person, "head")
        half, height = float(np.abs(skin[:, 1]).max()), float(np.ptp(skin[:, 2]))
        local = np.array([0.04, s * (half + _PHONE_M - at.PALM_M), -0.1 * height])
        point = rp.matmul(head[:3, :3], local) + head[:3, 3]
        fingers = rp.matmul(head[:3, :3], np.array([-0.4, -0.3 * s, 1.0]))
        target = at.palm_frame(point, rp.matmul(head[:3, :3], np.array([-0.2, -s, -0.3])), fingers)
        return LimbTask.firm(target, (0.04, 0.04, 0.04), at.FACE_ARM)


class _Mouth(HandPlace):
    """At the own mouth, thumb up."""

    name, carried_by, grip, touches = "mouth", "head", 0.5, "head"

    def task(self, trunk: Trunk, hand: Hand, side: int) -> LimbTask:
        head, s = trunk.skeleton.bone("head"), 1.0 - 2.0 * side
        point = head[:3, 3] + rp.matmul(
            head[:3, :3], _mouth(trunk.seated.person) + (0.07 + 0.01 * hand.noise[0], s * 0.035, -0.03)
        )
        inwards = rp.matmul(head[:3, :3], np.array((-0.35, -s, 0.0)))
        fingers = rp.matmul(head[:3, :3], np.array((1.0, -0.35 * s, 0.15)))
        return LimbTask.firm(at.palm_frame(point, inwards, fingers), (0.04, 0.02, 0.04), at.FACE_ARM)


class _Drink(HandPlace):
    """A bottle or a cup at the mouth, its lower end before it and raised as far as it is empty."""

    name, carried_by, grip, held, touches = "drink", "head", 0.4, Around(0.42), "head"
    raised: ClassVar[tuple[float, float]] = _RAISED  # mean and sigma, rad
    assumed: ClassVar[Floats32] = _ASSUMED_BOX  # (2, 3) m, of what is not there

    def task(self, trunk: Trunk, hand: Hand, side: int) -> LimbTask:
        head, s = trunk.skeleton.bone("head"), 1.0 - 2.0 * side
        raised = self.raised[0] + self.raised[1] * hand.noise[2]
        aside = _FROM_ASIDE * s + 0.05 * hand.noise[1]
        to_mouth = -np.array((rp.cos(raised), aside, rp.sin(raised)))  # in the head's frame
        to_mouth = rp.matmul(head[:3, :3], to_mouth / rp.norm(to_mouth))
        lips = head[:3, 3] + rp.matmul(head[:3, :3], _mouth(trunk.seated.person)) - _LIPS_M * to_mouth
        thing = InHand(Around(0.42).turned(self.assumed), float(self.assumed[1, 2])) if hand.thing is None else hand.thing
        top = apply(thing.palm_from_thing, np.array((0.0, 0.0, thing.height_m)))
        # The thing's upright axis is y of the palm: to the thumb of the left hand, away from that of the right one.
        y, inwards = s * to_mouth, rp.matmul(head[:3, :3], np.array((-0.2, -s, 0.35)))
        target = np.eye(4)
        z = inwards - rp.matmul(inwards, y) * y
        target[:3, 1], target[:3, 2] = y, z / rp.norm(z)
        target[:3, 0] = cross(target[:3, 1], target[:3, 2])
        target[:3, 3] = lips - rp.matmul(target[:3, :3], top)
        return LimbTask.firm(target, (0.06, 0.012, 0.06), at.FACE_ARM)


class _Bite(_Drink):
    """What is eaten, its upper end at the mouth and its lower one below it."""

    name, held, raised, assumed = "bite", Around(0.35), _LOWERED, _ASSUMED_BITE


class _Shin(HandPlace):
    """At the own shin, on the way to the floor."""

    name, grip = "shin", 0.06

    def task(self, trunk: Trunk, hand: Hand, side: int) -> LimbTask:
        s, (a, b, _) = trunk.seated, hand.noise
        left = np.array([-s.forward[1], s.forward[0], 0.0])
        below = s.seat.heel_point(s.setting) + (0.30 + 0.03 * b) * _UP + (0.10 - 0.2 * side) * left
        return _pointing_at(below + (0.04 * a - 0.03) * s.forward, _shoulder(trunk, side), at.REACH_ARM)


class _Chest(HandPlace):
    """A telephone before the chest, palm towards the face."""

    name, carried_by, grip, held, watched = "chest", "spine01", 0.5, Flat(math.radians(35.0)), True

    def task(self, trunk: Trunk, hand: Hand, side: int) -> LimbTask:
        a, b, c = hand.noise
        return self._before(trunk, side, 0.33 + 0.03 * a, 0.06 + 0.01 * b, -0.07 + 0.03 * c)

    def _before(self, trunk: Trunk, side: int, forward: float, out: float, up: float) -> LimbTask:
        """A palm at an offset (m) from the upper chest."""
        thorax, s = trunk.skeleton.bone("spine01"), 1.0 - 2.0 * side
        point = thorax[:3, 3] + rp.matmul(thorax[:3, :3], np.array([forward, s * out, up]))
        to_face = trunk.skeleton.bone("head")[:3, 3] - point
        target = at.palm_frame(point, to_face, rp.matmul(thorax[:3, :3], np.array([0.75, -s * 0.55, 0.35])))
        return LimbTask.firm(target, (0.04, 0.04, 0.02), at.FACE_ARM)


class _Book(_Chest):
    """An open book before the chest; it rests on its lower edge's half."""

    name, grip, held = "book", 0.1, Flat(0.0, 0.055)

    def task(self, trunk: Trunk, hand: Hand, side: int) -> LimbTask:
        a, b, c = hand.noise
        return self._before(trunk, side, 0.38 + 0.02 * a, 0.04 + 0.02 * b, 0.02 * c)


class _Carry(HandPlace):
    """Over its own thigh with something in it: what stands thumb up, the rest with the palm to the face."""

    name, carried_by, grip = "carry", "{side}thigh", 0.4

    def task(self, trunk: Trunk, hand: Hand, side: int) -> LimbTask:
        fit, femur = trunk.seated.fit, trunk.seated.person.segment_lengths["thigh"]
        bone, s = trunk.skeleton.bone("lr"[side] + "thigh"), 1.0 - 2.0 * side
        up, ahead, inwards = bone[:3, 0], -bone[:3, 2], -s * bone[:3, 1]
        top = float(np.interp(_CARRIED_ALONG, np.linspace(0.0, 1.0, len(fit.thigh_top)), fit.thigh_top))
        over, normal, fingers = _CARRIED_M, 0.75 * up - 0.65 * ahead, 0.6 * inwards + 0.65 * ahead + 0.4 * up
        if hand.below_m is not None:
            over, normal, fingers = max(_CARRIED_M, hand.below_m + _OVER_THIGH_M), inwards, ahead
        point = bone[:3, 3] + _CARRIED_ALONG * femur * ahead + (top + over) * up + 0.02 * inwards
        target = at.palm_frame(point, normal, fingers)
        return LimbTask.firm(target, (0.04, 0.02, 0.04), at.CARRY_ARM)


class _Belt(HandPlace):
    """At the shoulder belt, in front of the shoulder that it comes from."""

    name, carried_by, grip, watched = "belt", "spine01", 0.6, True
    touches: ClassVar[Literal["", "car", "belt", "head", "rim"]] = "belt"
    aside_m: ClassVar[float] = 0.07  # from the middle of the chest, to the side from which the belt comes

    def exists(self, seat: Seat, cabin: Cabin) -> bool:
        return seat.belt is not None

    def task(self, trunk: Trunk, hand: Hand, side: int) -> LimbTask:
        belt, thorax = trunk.seated.seat.belt, trunk.skeleton.bone("spine01")
        assert belt is not None  # see `exists`
        local = rp.matmul(thorax[:3, :3].T, belt.upper - thorax[:3, 3])
        s = 1.0 if local[1] > 0.0 else -1.0
        depth = float(_skin(trunk.seated.person, "thorax")[:, 0].max()) + 0.065
        point = thorax[:3, 3] + rp.matmul(thorax[:3, :3], np.array([depth, s * self.aside_m, 0.03]))
        back = rp.matmul(thorax[:3, :3], np.array([-1.0, 0.0, 0.15]))
        fingers = rp.matmul(thorax[:3, :3], np.array([0.15, s * 0.8, 0.6]))
        if 1.0 - 2.0 * side == s:  # the hand of the same side comes from below, its fingers to the middle
            fingers = rp.matmul(thorax[:3, :3], np.array([0.1, -s * 0.6, 0.8]))
        target = at.palm_frame(point, back, fingers)
        return LimbTask.firm(target, (0.03, 0.03, 0.02), at.CROSS_ARM)


class _Tongue(_Belt):
    """At the tongue of a belt that is not worn, before the shoulder beside which it hangs."""

    name, grip, touches, aside_m = "tongue", 0.75, "", 0.17


class _Buckle(HandPlace):
    """Over the buckle of the seat's belt, fingers down."""

    name, grip, watched = "buckle", 0.75, True

    def exists(self, seat: Seat, cabin: Cabin) -> bool:
        return seat.belt is not None

    def task(self, trunk: Trunk, hand: Hand, side: int) -> LimbTask:
        anchors, ahead = trunk.seated.seat.belt_anchors(trunk.seated.setting), trunk.seated.forward
        assert anchors is not None  # see `exists`
        inwards = (1.0 - 2.0 * side) * np.array((ahead[1], -ahead[0], 0.0))
        point = anchors.buckle + _OVER_BUCKLE_M * _UP + 0.5 * _OVER_BUCKLE_M * ahead
        return LimbTask.firm(at.palm_frame(point, inwards - 0.5 * _UP, ahead - _UP), (0.01, 0.01, 0.01), at.SIDE_ARM)


class _Beside(HandPlace):
    """Down beside the own seat's cushion."""

    name, grip, reaches, watched = "beside", 0.06, True, True

    def task(self, trunk: Trunk, hand: Hand, side: int) -> LimbTask:
        s, (a, b, _) = trunk.seated, hand.noise
        left = (1.0 - 2.0 * side) * np.array([-s.forward[1], s.forward[0], 0.0])
        point = s.seat.h_point(s.setting) + (0.16 + 0.03 * a) * s.forward + _BESIDE_CUSHION_M * left - (0.12 + 0.02 * b) * _UP
        return _pointing_at(point, _shoulder(trunk, side), at.SIDE_ARM)


class _Reach(HandPlace):
    """At something in the car, or wherever else it is told to reach; in the lap where there is nowhere."""

    name, shapes, reaches, watched, touches = "reach", at.POINTING, True, True, "car"

    def reach(self, seated: SeatContext, target: Floats | None, given: Reach | None, noise: Noise) -> Reach | None:
        return given if target is None else Reach(target + _REACHED_SIGMA_M * np.array(noise), touched=True)

    def task(self, trunk: Trunk, hand: Hand, side: int) -> LimbTask:
        if hand.reach is None:
            return THIGH.task(trunk, hand, side)
        if hand.reach.palm is not None:
            return LimbTask(hand.reach.palm, at.STAYS, np.full(3, 0.3), at.REACH_ARM, at.STIFFNESS)
        shoulder = _shoulder(trunk, side)
        high = hand.reach.point[2] > shoulder[2]
        return self._to(trunk, hand, side, at.UP_ARM if high else at.REACH_ARM)

    def _to(self, trunk: Trunk, hand: Hand, side: int, arm: Floats) -> LimbTask:
        """The hand at where it reaches, coming from its shoulder."""
        assert hand.reach is not None
        tip = None
        if not np.isnan(hand.fingers).any():
            tip = at.fingertip(trunk.seated.person, hand.fingers) * (1.0, 1.0 - 2.0 * side, 1.0)
        return _pointing_at(hand.reach.point, _shoulder(trunk, side), arm, tip)


class _Knob(_Reach):
    """Over a lever's knob, palm down, fingers around it."""

    name, shapes, grasps = "knob", (), True

    def _to(self, trunk: Trunk, hand: Hand, side: int, arm: Floats) -> LimbTask:
        assert hand.reach is not None
        s, ahead = 1.0 - 2.0 * side, trunk.seated.forward
        fingers = ahead + 0.25 * s * np.array((ahead[1], -ahead[0], 0.0)) - 0.25 * _UP
        return _holding(hand.reach.point, -_UP - 0.25 * ahead, fingers, _KNOB_IN_PALM_M, at.LEVER_ARM)


class _Mirror(_Reach):
    """Before a mirror, fingers over its upper edge, thumb under the lower one."""

    name, shapes, grasps = "mirror", (), True

    def _to(self, trunk: Trunk, hand: Hand, side: int, arm: Floats) -> LimbTask:
        assert hand.reach is not None
        s, ahead = 1.0 - 2.0 * side, trunk.seated.forward
        left = np.array((-ahead[1], ahead[0], 0.0))
        return _holding(hand.reach.point, ahead + 0.3 * _UP, _UP - 0.5 * s * left, _MIRROR_IN_PALM_M, at.ROOF_ARM)


class _Visor(_Reach):
    """Under a sun visor, the palm up, its fingers' ends at it."""

    name, shapes = "visor", at.RESTING[1:2]

    def _to(self, trunk: Trunk, hand: Hand, side: int, arm: Floats) -> LimbTask:
        assert hand.reach is not None
        ahead, tip = trunk.seated.forward, at.fingertip(trunk.seated.person, hand.fingers) * (1.0, 1.0 - 2.0 * side, 1.0)
        return _holding(hand.reach.point, _UP - 0.2 * ahead, ahead + 0.5 * _UP, tip, at.ROOF_ARM)


class _Give(_Reach):
    """Holding out what another one's hand takes."""

    name, shapes, held, passes_on = "give", (), Around(0.22), True


class _Take(_Give):
    """Around what was taken from another hand, above it."""

    name, held = "take", Around(0.70)


def _mouth(person: Person) -> Floats:
    """(3,) m in the head's frame: before the lips' middle."""
    skin = _skin(person, "head")
    nose = skin[skin[:, 0].argmax()] - person.rest.heads[BONE_INDEX["head"]]
    size = float(np.ptp(skin[:, 2])) / _HEAD_M
    return np.array((nose[0] - 0.012 * size, 0.0, nose[2] - _MOUTH_BELOW_NOSE_M * size))


def _skin(person: Person, segment: str) -> Floats:
    """(N, 3) m of a segment at rest."""
    return person.rest_skin[person.skin_segment == SEGMENTS.index(segment)].astype(np.float64)


def _shoulder(trunk: Trunk, side: int) -> Floats:
    return trunk.skeleton.bone("lr"[side] + "upperarm")[:3, 3]


def _pointing_at(point: Floats, shoulder: Floats, prior: Floats, tip: Floats | None = None) -> LimbTask:
    """A hand whose fingertips touch `point` (3,), coming from `shoulder` (3,), palm down or inwards as the arm likes.

    tip: (3,) m in the palm, of what touches it; an adult's middle finger where it is not given.
    """
    direction = point - shoulder
    direction = direction / rp.norm(direction)
    if tip is None:
        target = at.palm_frame(point - at.HAND_M * direction, -_UP, direction)
        return LimbTask.firm(target, (0.02, 0.04, 0.04), prior)
    return _holding(point, -_UP, direction, tip, prior, (0.02, 0.04, 0.04))


def _holding(
    point: Floats, normal: Floats, fingers: Floats, in_palm: Floats, prior: Floats,
    turning: tuple[float, float, float] = (0.04, 0.04, 0.03),
) -> LimbTask:  # fmt: skip
    """A palm towards `normal`, its x near `fingers`, in which `in_palm` (3,) m is at `point` (3,)."""
    x = fingers / rp.norm(fingers)
    target = at.palm_frame(point, normal - rp.matmul(normal, x) * x, x)
    target[:3, 3] -= rp.matmul(target[:3, :3], in_palm)
    return LimbTask.firm(target, turning, prior)


WHEEL, THIGH, ARMREST, EITHER, SHIN, CARRY, BELT = _Wheel(), _Thigh(), _Armrest(), _Either(), _Shin(), _Carry(), _Belt()
EAR, MOUTH, DRINK, CHEST, BOOK, GIVE, REACH, TAKE = _Ear(), _Mouth(), _Drink(), _Chest(), _Book(), _Give(), _Reach(), _Take()
KNOB, MIRROR, VISOR = _Knob(), _Mirror(), _Visor()
TONGUE, BUCKLE, BESIDE, BITE = _Tongue(), _Buckle(), _Beside(), _Bite()
_ALL = (
    WHEEL,
    THIGH,
    ARMREST,
    EITHER,
    EAR,
    MOUTH,
    DRINK,
    SHIN,
    CHEST,
    BOOK,
    CARRY,
    BELT,
    GIVE,
    REACH,
    TAKE,
    KNOB,
    MIRROR,
    VISOR,
    *(TONGUE, BUCKLE, BESIDE, BITE),
)
# Where a hand can be, by name.
PLACES: Mapping[str, HandPlace] = MappingProxyType({place.name: place for place in _ALL})

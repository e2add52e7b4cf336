"""Places of hands and the tables that name them: complete, and the same under each name."""

from __future__ import annotations

import numpy as np
import pytest

from cabinpose.core.errors import ConfigError
from cabinpose.scene.body import BONE_INDEX, SUBJECTS, BodyModel, Person
from cabinpose.scene.cabin import build_cabin
from cabinpose.scene.things import CHILD_SEATS, OBJECTS, THINGS
from cabinpose.synth.posture.actions import ACTIONS, OWN_ACTIONS, Action, Gaze, action_named, suits
from cabinpose.synth.posture.children import FREE_POSES
from cabinpose.synth.posture.context import SeatContext, Trunk
from cabinpose.synth.posture.frames import frames
from cabinpose.synth.posture.hands import LimbTask, palm_frame
from cabinpose.synth.posture.places import CARRY, EITHER, PLACES, TAKE, THIGH, Hand, HandPlace, Reach
from cabinpose.synth.posture.sampling import sample_pose
from cabinpose.synth.posture.seating import choose_setting


@pytest.fixture(scope="module")
def person() -> Person:
    return BodyModel.load().person(*SUBJECTS["S01"])


def test_the_tables_are_what_is_registered() -> None:
    """In one order, which messages and menus have; random draws go by the tables themselves."""
    assert ACTIONS.names(own=True) == (*OWN_ACTIONS, *FREE_POSES)
    assert THINGS.names(own=True) == (*CHILD_SEATS, *OBJECTS)
    assert all(ACTIONS[name] is action and action.name == name for name, action in {**OWN_ACTIONS, **FREE_POSES}.items())
    assert all(THINGS[name] is kind for name, kind in {**CHILD_SEATS, **OBJECTS}.items())


def test_things_are_held_where_hands_hold_things() -> None:
    named = {place for kind in OBJECTS.values() for place in kind.held_at}
    assert named == {name for name, place in PLACES.items() if place.held is not None} - {TAKE.name}
    done = {place for action in OWN_ACTIONS.values() for place in (action.inboard, action.outboard)}
    assert done == set(PLACES.values()) - {CARRY, TAKE}  # where hands are that carry what an action has no use for


@pytest.mark.parametrize("name", [name for name in PLACES if name != EITHER.name])
def test_every_place_has_a_palm_near_its_side(name: str, person: Person) -> None:
    cabin, place = build_cabin("sedan"), PLACES[name]
    seated = SeatContext(person, cabin.seats["driver"], cabin.seats["driver"].default, cabin)
    q, root = seated.fit.q.copy(), seated.vehicle_from_root(0.0)
    trunk = Trunk(seated, q, root, frames(q, person.rest, root))
    assert place.exists(seated.seat, cabin)
    given = place.reach(seated, cabin.reach_targets["infotainment"], None, (0.0, 0.0, 0.0))
    for side in (0, 1):
        clock = np.pi / 2 * (1 - 2 * side)
        hand = Hand(place, (0.0, 0.0, 0.0), clock, given, place.fingers((0.1, 0.2, 0.3), 0.3))
        if place.shapes:
            assert not np.isnan(hand.fingers).any()
        task = place.task(trunk, hand, side)
        assert np.linalg.det(task.target[:3, :3]) == pytest.approx(1.0)
        shoulder = trunk.skeleton.bone("lr"[side] + "upperarm")[:3, 3]
        assert 0.1 < np.linalg.norm(task.target[:3, 3] - shoulder) < 1.05
    if place.carried_by:
        assert place.carried_by.format(side="l") in BONE_INDEX


def test_hands_that_reach_nothing_are_in_the_lap(person: Person) -> None:
    cabin = build_cabin("sedan")
    seated = SeatContext(person, cabin.seats["rear_left"], cabin.seats["rear_left"].default, cabin)
    q, root = seated.fit.q.copy(), seated.vehicle_from_root(0.0)
    trunk = Trunk(seated, q, root, frames(q, person.rest, root))
    for name in ("reach", "give", "take"):
        hand = Hand(PLACES[name], (0.0, 0.0, 0.0), 0.0, None, np.full(6, 0.1))
        np.testing.assert_array_equal(PLACES[name].task(trunk, hand, 0).target, THIGH.task(trunk, hand, 0).target)


@pytest.mark.parametrize("name", ["S01", "S04", "S08"])
def test_a_drivers_hands_rest_before_the_wheel(name: str) -> None:
    """The fingertips of a hand on the thigh end on this side of the rim's lowest point, under which a hand has no room."""
    person, cabin = BodyModel.load().person(*SUBJECTS[name]), build_cabin("sedan")
    setting = choose_setting(person, cabin.seats["driver"], cabin, rng=None)
    seated = SeatContext(person, cabin.seats["driver"], setting, cabin)
    q, root = seated.fit.q.copy(), seated.vehicle_from_root(0.0)
    trunk = Trunk(seated, q, root, frames(q, person.rest, root))
    assert cabin.steering_wheel is not None
    rim = cabin.steering_wheel.grip_point(np.pi)[0]
    for side in (0, 1):
        for along in (-2.0, 0.0, 2.0):
            noise = (along, 0.0, 0.0)
            target = THIGH.task(trunk, Hand(THIGH, noise, 0.0, None, THIGH.fingers(noise, 0.3)), side).target
            assert target[0, 3] + 0.095 * person.stature_m / 1.75 * np.cos(0.45) < rim


class _OnHead(HandPlace):
    """On top of one's own head: a place of somebody else's."""

    name, carried_by, grip, watched = "on_head", "head", 0.2, True

    def task(self, trunk: Trunk, hand: Hand, side: int) -> LimbTask:
        head = trunk.skeleton.bone("head")
        palm = palm_frame(head[:3, 3] + 0.22 * head[:3, 2], -head[:3, 2], head[:3, 0])
        return LimbTask(
            palm, np.full(3, 5.0), np.full(3, 0.04), np.radians((80.0, 60.0, 0.0, 110.0, 0.0, 0.0, 0.0)), np.full(7, 0.01)
        )


def test_an_action_with_a_place_of_its_own(person: Person, monkeypatch: pytest.MonkeyPatch) -> None:
    """What an action of another package needs is in its row: nothing else knows of it."""
    action = Action("scratch", _OnHead(), THIGH, Gaze(at_hand=True), seats="front_passenger")
    cabin = build_cabin("sedan")
    monkeypatch.setitem(ACTIONS._loaded, "scratch", action)
    seat = cabin.seats["front_passenger"]
    assert suits(action, seat, cabin)
    assert not suits(action, cabin.seats["rear_left"], cabin)
    pose = sample_pose(SeatContext(person, seat, seat.default, cabin), "scratch", rng=np.random.default_rng(1))
    posed = person.pose(pose.q, pose.vehicle_from_root)
    high = max(palm[2, 3] for palm in posed.palms.values())
    assert high > posed.joints[:, 2].max() - 0.05
    with pytest.raises(ConfigError, match="makes no sense in the rear_left seat"):
        action_named("scratch", cabin.seats["rear_left"], cabin)


def test_a_gaze_follows_a_hand_that_is_somewhere_to_look() -> None:
    with pytest.raises(ValueError, match="the gaze of 'nod' follows a hand"):
        Action("nod", THIGH, THIGH, Gaze(at_hand=True))


def test_a_target_of_the_cabin_comes_before_a_given_one(person: Person) -> None:
    cabin = build_cabin("sedan")
    seated = SeatContext(person, cabin.seats["driver"], cabin.seats["driver"].default, cabin)
    given, target = Reach(np.zeros(3)), np.ones(3)
    assert PLACES["reach"].reach(seated, None, given, (0.0, 0.0, 0.0)) is given
    found = PLACES["reach"].reach(seated, target, given, (0.0, 0.0, 0.0))
    assert found is not None
    np.testing.assert_array_equal(found.point, target)

"""Hands meet what they touch: the gap is measured by trimesh on the posed skin, not by what closes it."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh

from cabinpose.scene.body import BONE_INDEX, DOF_INDEX, SEGMENTS, by_phalanx
from cabinpose.scene.contact import FLESH_M
from cabinpose.synth.config import SynthConfig
from cabinpose.synth.posture.hands import clocks, regripped, turned_wheel
from cabinpose.synth.sample import SceneSampler
from cabinpose.synth.scene import Scene
from cabinpose.synth.streams import frame_rng

TOUCHING_M = 0.006  # of a mesh whose every other vertex is brought near


def scene_of(slot: str, action: str, held: str = "") -> Scene:
    scene = {"kind": "cabin", "cars": ["hatchback"], "occupants": {slot: {"action": action}}, "occupancy": {}}
    if held:
        scene |= {"in_hand": 1.0, "held": [held]}
    return SceneSampler(SynthConfig.model_validate({"scene": scene}), 3).sample(0, rng=frame_rng(3, 0))


def gap_m(scene: Scene, vertices: np.ndarray, faces: np.ndarray) -> float:
    """The signed gap between either hand and a closed surface, negative where a hand is in it."""
    who = scene.people[0]
    hands = np.isin(who.person.skin_segment, [SEGMENTS.index(side + "hand") for side in "lr"])
    mesh = trimesh.Trimesh(vertices, faces, process=False)
    mesh.merge_vertices(merge_norm=True, merge_tex=True)
    near = who.posed.skin[hands].astype(np.float64)
    near = near[np.linalg.norm(near - mesh.bounds.mean(axis=0), axis=1) < np.ptp(mesh.bounds, axis=0).max() + 0.1]
    return float(-trimesh.proximity.signed_distance(mesh, near).max())


@pytest.mark.slow
@pytest.mark.parametrize(
    ("action", "name"), [("gear", "gear lever"), ("adjust_mirror", "rear-view mirror"), ("sun_visor", "sun visors")]
)
def test_a_hand_touches_the_part_that_it_goes_to(action: str, name: str) -> None:
    scene = scene_of("driver", action)
    assert scene.cabin is not None
    part = next(part for part in scene.cabin.parts if part.name == name)
    assert -FLESH_M <= gap_m(scene, part.surface.vertices, part.surface.faces) <= TOUCHING_M


@pytest.mark.slow
@pytest.mark.parametrize(
    ("action", "dof", "given", "held"),
    [("reach_infotainment", "lumbar.flexion", 5.0, np.radians(5.0)), ("gear", "rhand.grip", 0.9, 0.9)],
)
def test_what_a_profile_holds_stays_when_a_hand_is_brought_near(action: str, dof: str, given: float, held: float) -> None:
    profile = {"kind": "gaussian", "axes": {dof: {"mean_deg": given, "sigma_deg": 0.0}}}
    driver = {"action": action, "profile": profile}
    told = {"kind": "cabin", "cars": ["hatchback"], "right_hand_drive": 0.0, "occupants": {"driver": driver}, "occupancy": {}}
    sampler = SceneSampler(SynthConfig.model_validate({"scene": told}), 3)
    for index in range(8):
        scene = sampler.sample(index, rng=frame_rng(3, index))
        assert scene.people[0].posed.q[DOF_INDEX[dof]] == pytest.approx(held, abs=1e-9)


@pytest.mark.slow
@pytest.mark.parametrize(("action", "held"), [("phone_ear", "phone"), ("drink", "bottle"), ("drink", "cup")])
def test_what_is_held_meets_the_head(action: str, held: str) -> None:
    scene = scene_of("front_passenger", action, held)
    who, thing = scene.people[0], next(thing for thing in scene.things if thing.at == "hand").surface(0)
    head = who.posed.skin[who.person.skin_segment == SEGMENTS.index("head")].astype(np.float64)
    mesh = trimesh.Trimesh(thing.vertices, thing.faces, process=False)
    mesh.merge_vertices(merge_norm=True, merge_tex=True)
    _, distance, _ = trimesh.proximity.closest_point(mesh, head)
    assert distance.min() <= TOUCHING_M


def test_hands_seldom_hold_the_rim_alike() -> None:
    drawn = np.degrees([clocks(key, alone=False) for key in np.random.default_rng(0).random(400)])
    assert (drawn[:, 0] > 0.0).all()
    assert (drawn[:, 1] < 0.0).all()
    assert np.mean(np.abs(drawn.sum(axis=1)) < 8.0) < 0.3
    assert np.corrcoef(drawn.T)[0, 1] == pytest.approx(0.0, abs=0.15)


def test_wheels_turn_up_to_their_lock_but_seldom() -> None:
    normal = np.random.default_rng(0).standard_normal(4000)
    turned = np.degrees([turned_wheel(n, driving=True) for n in normal])
    assert np.abs(turned).max() == pytest.approx(450.0)
    assert np.mean(np.abs(turned) <= 10.0) == pytest.approx(0.80, abs=0.03)
    assert np.degrees([turned_wheel(n, driving=False) for n in normal]).max() == pytest.approx(10.0)


def test_no_hand_is_carried_below_the_rims_middle() -> None:
    for angle in np.radians(np.linspace(-450.0, 450.0, 181)):
        for clock in np.radians((90.0, 60.0, -60.0, -90.0)):
            assert abs(regripped(clock, angle)) <= np.radians(125.0)


@pytest.mark.parametrize("side", [0, 1])
def test_fingers_close_around_a_rim(side: int) -> None:
    """The skin, posed again, against a tube around a ring: pulps lie at it, and nothing is deeper in it than flesh gives way."""
    scene = scene_of("driver", "drive")
    assert scene.cabin is not None
    assert scene.cabin.steering_wheel is not None
    who, wheel, hand = scene.people[0], scene.cabin.steering_wheel, "lr"[side]
    x, y, z = ((who.posed.skin - wheel.vehicle_from_wheel[:3, 3]) @ wheel.vehicle_from_wheel[:3, :3]).T
    from_rim = np.hypot(np.hypot(x, y) - wheel.rim_radius_m, z) - wheel.rim_section_m
    leading = who.person.leading_bone
    pulps = [from_rim[leading == BONE_INDEX[f"{hand}finger{finger}_3"]].min() for finger in range(1, 6)]
    assert from_rim[who.person.skin_segment == SEGMENTS.index(hand + "hand")].min() >= -FLESH_M
    assert np.sum(np.array(pulps) < 0.010) >= 3
    fingers = by_phalanx(who.posed.fingers)[side, 3:15].reshape(4, 3)
    assert (fingers >= 0.0).all()
    assert (fingers <= 1.0).all()
    assert who.posed.q[DOF_INDEX[hand + "hand.grip"]] == pytest.approx(fingers.mean())


def test_a_given_grip_stays_beside_fingers_that_close_around_the_rim() -> None:
    """The one hand's fingers follow the grip that is given; the other one's close by themselves, all is finite."""
    driver = {"action": "drive", "subject": "S01", "initial_pose_deg": {"lhand.grip": 0.3}}
    told = {"kind": "cabin", "cars": ["sedan"], "occupants": {"driver": driver}, "occupancy": {}}
    scene = SceneSampler(SynthConfig.model_validate({"scene": told}), 0).sample(0, rng=frame_rng(0, 0))
    posed = scene.people[0].posed
    assert posed.q[DOF_INDEX["lhand.grip"]] == pytest.approx(0.3)
    assert np.isfinite(posed.q).all()
    assert np.isnan(posed.fingers[0]).all()
    assert np.isfinite(posed.fingers[1, 3:15]).all()

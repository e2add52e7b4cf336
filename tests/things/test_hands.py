"""What hands hold and laps carry: touched, not pierced, by trimesh; and what does not fit is named."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh
from exact_contact import exact_penetrations

from cabinpose.core.errors import SceneError
from cabinpose.core.frames import apply, invert
from cabinpose.scene.body import DOF_INDEX, DOFS, SEGMENTS, SUBJECTS, BodyModel, Person
from cabinpose.scene.contact import solid_topology
from cabinpose.scene.things import OBJECTS, make_thing
from cabinpose.synth.config import SynthConfig
from cabinpose.synth.posture.grasps import PRESSED_M, can_hold, hold
from cabinpose.synth.posture.places import DRINK, PLACES, HandPlace
from cabinpose.synth.sample import SceneSampler
from cabinpose.synth.scene import Scene
from cabinpose.synth.streams import frame_rng

HELD = [(PLACES[place], name) for name, kind in OBJECTS.items() for place in kind.held_at]


def somebody(name: str) -> Person:
    return BodyModel.load().person(SUBJECTS[name].phenotype, SUBJECTS[name].outfit)


def depths(person: Person, place: HandPlace, kind: str, side: int) -> np.ndarray:
    """(N,) m that the vertices of a hand are in what it holds, negative outside."""
    held = hold(person, place, kind, 1, side)
    q = np.zeros(len(DOFS))
    q[DOF_INDEX["lr"[side] + "hand.grip"]] = 0.5
    body = person.pose(q, np.eye(4), held.fingers)
    skin = body.skin[person.skin_segment == SEGMENTS.index("lr"[side] + "hand")]
    local = apply(invert(held.placed(body.palms["lr"[side]])), skin)
    pieces = [trimesh.Trimesh(p.solid.vertices, p.solid.faces) for p in make_thing(kind, 1).pieces]
    return np.max([trimesh.proximity.signed_distance(mesh, local) for mesh in pieces], axis=0)


@pytest.mark.parametrize(("place", "kind"), HELD)
@pytest.mark.parametrize("name", ["S03", "S04"])
def test_a_hand_closes_around_what_it_holds(name: str, place: HandPlace, kind: str) -> None:
    into = depths(somebody(name), place, kind, 0)
    assert into.max() < PRESSED_M + 0.002  # every other vertex is measured while the hand closes
    assert (into > -0.006).sum() > 20
    np.testing.assert_allclose(np.sort(into)[-50:], np.sort(depths(somebody(name), place, kind, 1))[-50:], atol=5e-4)


def test_fingers_lie_around_the_bottle() -> None:
    person, held = somebody("S01"), hold(somebody("S01"), DRINK, "bottle", 0, 0)
    q = np.zeros(len(DOFS))
    q[DOF_INDEX["lhand.grip"]] = 0.5
    body = person.pose(q, np.eye(4), held.fingers)
    thing_from_vehicle = invert(held.placed(body.palms["l"]))
    local = apply(thing_from_vehicle, body.skin[person.skin_segment == SEGMENTS.index("lhand")])
    radius = np.linalg.norm(local[:, :2], axis=1)
    near = local[(radius < 0.042) & (local[:, 2] > 0.02) & (local[:, 2] < 0.14)]
    angle = np.sort(np.arctan2(near[:, 1], near[:, 0]))
    gaps = np.diff(np.append(angle, angle[0] + 2 * np.pi))
    assert gaps.max() < np.radians(250.0)  # of flat contact, on one side, it would be 280


def test_what_fits_into_no_hand_is_named() -> None:
    person = somebody("S05")
    assert not can_hold(person, DRINK, "box", 0)
    with pytest.raises(SceneError, match=r"no hand of a person of 1.40 m closes around a box of \d+ x \d+ x \d+ mm") as caught:
        hold(person, DRINK, "box", 0, 0)
    assert caught.value.hint


def exact_excess(scene: Scene) -> float:
    first = scene.people[0]
    topology = solid_topology(first.person.skin_faces, first.person.skin_segment, SEGMENTS, first.posed.skin)
    people = [(p.slot, p.person, p.posed) for p in scene.people]
    found = exact_penetrations(scene.cabin, people, topology, scene.settings, scene.wheel_angle, scene.things)
    assert any(p.cause == "thing" for p in found)  # it is touched
    return max(p.excess_m for p in found)


@pytest.mark.slow
@pytest.mark.parametrize(
    "scene",
    [
        {"motion": {"driver": {"drink": 1.0}}},
        {"motion": {"driver": {"phone_ear": 0.5, "phone_text": 0.5}}, "in_hand": 1.0},
        {"occupancy": {"front_passenger": 1.0}, "objects": {"front_passenger": {"bag": 0.5, "laptop": 0.5}}},
    ],
)
def test_scenes_with_things_hold_exactly(scene: dict[str, object]) -> None:
    base = {"cars": ["sedan"], "occupancy": {"driver": 1.0}, "right_hand_drive": 0.0}
    config = SynthConfig.parse({"scene": base | scene, "people": {"subjects": ["S02", "S10"]}})
    drawn = SceneSampler(config, 4).sample(2, rng=frame_rng(4, 2))
    assert {thing.at for thing in drawn.things} <= {"hand", "lap"}
    assert exact_excess(drawn) < 1e-6


def test_pixels_of_what_is_held_are_its_holders() -> None:
    config = SynthConfig.parse(
        {"scene": {"cars": ["suv"], "occupancy": {"driver": 1.0}, "motion": {"driver": {"drink": 1.0}}, "clutter": 0}}
    )
    scene = SceneSampler(config, 0).sample(0, rng=frame_rng(0, 0))
    (held,) = scene.things
    assert held.at == "hand"
    whole = scene.surface()
    assert set(whole.instance[whole.label == make_thing(held.thing.kind, 0).surface.label[0]]) == {1}

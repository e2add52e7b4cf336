"""Children in child seats: of the proportions of children, on the seat and not in it, held as they should be."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from exact_contact import thing_penetrations

from cabinpose.core.errors import ConfigError
from cabinpose.core.frames import apply, axis_rotation, invert
from cabinpose.core.skeleton import CABINPOSE
from cabinpose.scene.body import DOF_INDEX, DOFS, SEGMENTS, BodyModel, Phenotype
from cabinpose.scene.body.phenotype import age_of, usual_stature_m
from cabinpose.scene.labels import LABEL_ID
from cabinpose.synth import FrameMaker
from cabinpose.synth.config import SynthConfig
from cabinpose.synth.exact import exact_scene
from cabinpose.synth.sample import SceneSampler
from cabinpose.synth.scene import Scene, ScenePerson
from cabinpose.synth.streams import frame_rng

SUV = {"cars": ["suv"], "occupancy": {}, "right_hand_drive": 0.0, "clutter": 0.0}


def config(kind: str, slot: str = "rear_left", **scene: object) -> SynthConfig:
    return SynthConfig.parse({"scene": SUV | {"child_seats": {slot: kind}, "children": 1.0} | scene})


SITTING_RAD = np.radians(15.0)
NOT_PRESSED = 0.02  # of the stature: flesh below the seat bones, which no seat flattens here


# Erect sitting height over stature and mass of the Hybrid III dummies of three and six years, of the small woman (NHTSA).
@pytest.mark.parametrize(("years", "share", "mass_kg"), [(3, 21.5 / 37.2, 15.5), (6, 25.0 / 45.0, 23.4), (25, 31.0 / 59.1, None)])
def test_children_are_no_small_adults(years: float, share: float, mass_kg: float | None) -> None:
    age = age_of(years)
    person = BodyModel.load().person(Phenotype(0.5, age, 0.4, 0.5, 0.45, 0.3, usual_stature_m(0.5, age)[0]))
    q = np.zeros(len(DOFS))
    q[[DOF_INDEX[s + joint] for s in "lr" for joint in ("hip.flexion", "knee.flexion")]] = np.pi / 2
    # Who sits erect has 15 deg less of lumbar lordosis than who stands (Lord 1997): the pelvis leans back by as much.
    q[[DOF_INDEX[s + "hip.flexion"] for s in "lr"]] -= SITTING_RAD
    q[DOF_INDEX["lumbar.flexion"]] = SITTING_RAD
    root = np.eye(4)
    root[:3, :3] = axis_rotation("y", -SITTING_RAD)
    skin = person.pose(q, root).skin
    seated = np.isin(person.skin_segment, [SEGMENTS.index(name) for name in ("pelvis", "lthigh", "rthigh")])
    assert (skin[:, 2].max() - skin[seated, 2].min()) / person.stature_m - NOT_PRESSED == pytest.approx(share, abs=0.01)
    assert mass_kg is None or mass_kg * 0.8 < person.mass_kg < mass_kg  # dummies carry instruments and wear clothes


def drawn(kind: str, slot: str, seed: int = 0, **scene: object) -> tuple[Scene, ScenePerson]:
    found = SceneSampler(config(kind, slot, **{"occupants": {slot: {}}} | scene), seed).sample(0, rng=frame_rng(seed, 0))
    (child,) = found.people
    return found, child


@pytest.mark.parametrize(
    ("kind", "slot"),
    [
        ("booster_cushion", "rear_right"), ("toddler", "rear_left"),
        *(pytest.param("booster", slot, marks=pytest.mark.slow) for slot in ("rear_left", "front_passenger")),
    ],
)  # fmt: skip
def test_a_child_sits_on_the_cushion_and_in_nothing(kind: str, slot: str) -> None:
    scene, child = drawn(kind, slot)
    (seat,) = scene.things
    assert child.child
    low, high = seat.thing.sitting.stature_m
    assert low <= child.person.stature_m <= high
    found = thing_penetrations([(child.slot, child.person, child.posed)], scene.things)
    assert found
    assert max(p.excess_m for p in found) < 1e-6
    local = apply(invert(seat.vehicle_from_thing), child.posed.skin.astype(np.float64))
    sits = local[np.isin(child.person.skin_segment, [SEGMENTS.index(name) for name in ("pelvis", "lthigh", "rthigh")])]
    height, slope = seat.thing.sitting.cushion
    under = sits[:, 2] - height - slope * sits[:, 0]
    assert -0.028 < under.min() < 0.002  # on the padding, or pressed into it


@pytest.mark.slow
def test_shins_hang_clear_of_the_front_of_a_child_seat_and_most_poses_hold() -> None:
    """Of a toddler and of a child on a booster; with shins straight below the knees half of the poses were refused."""
    seats = {"rear_left": "toddler", "rear_right": "booster"}
    scene = SUV | {"child_seats": seats, "occupants": {slot: {} for slot in seats}, "toddlers": 0.5}
    sampler = SceneSampler(SynthConfig.parse({"scene": scene}), 0)
    people = judged = 0
    for index in range(8):
        found = sampler.sample(index, rng=frame_rng(0, index))
        people, judged = people + len(found.people), judged + found.judged
        for who in found.people:
            on = next(t for t in found.things if t.slot == who.slot)
            assert on.thing.sitting is not None
            ankles = apply(invert(on.vehicle_from_thing), who.posed.joints[CABINPOSE.indices(("lankle", "rankle"))])
            assert ankles[:, 0].min() > on.thing.sitting.front_m
    assert people / judged > 0.7


def test_a_driver_makes_room_for_the_feet_of_a_child_behind() -> None:
    """Of a tall driver, whose seat varies with nothing but who is there; the feet stay behind the driver's backrest."""
    fore_aft = {}
    for behind, seats in (("nobody", {}), ("child", {"rear_left": "booster"})):
        scene = SUV | {
            "cars": ["sedan"],
            "seat_variation": 0.0,
            "children": 1.0,
            "child_seats": seats,
            "occupancy": {"driver": 1.0},
        }
        settings = SynthConfig.parse({"scene": scene, "people": {"subjects": ["S04"]}})
        fore_aft[behind] = SceneSampler(settings, 0).sample(0, rng=frame_rng(0, 0)).settings["driver"].fore_aft_m
    assert 0.01 < fore_aft["child"] - fore_aft["nobody"] < 0.081


@pytest.mark.parametrize("kind", ["booster", "booster_cushion"])
def test_the_belt_crosses_the_middle_of_a_childs_shoulder_and_lies_low(kind: str) -> None:
    _, child = drawn(kind, "rear_left", seed=3, belted=1.0, motion={"rear_left": {"rest_lap": 1.0}})
    assert child.belt == "worn"
    at = {name: child.posed.joints[i] for name, i in CABINPOSE.index.items()}
    belt = child.surfaces[1].vertices.astype(np.float64)
    across = at["lshoulder"] - at["neck"]
    share = (belt - at["neck"]) @ across / (across @ across)
    up = at["chest"] - at["hip"]
    beside = np.abs((belt - at["lshoulder"]) @ up / np.linalg.norm(up)) < 0.03
    ahead = np.cross(at["lpelvis"] - at["rpelvis"], up)
    before = (belt - at["neck"]) @ ahead > 0.0
    assert 0.15 < np.median(share[beside & before]) < 0.85  # between the neck and the arm
    lap = belt[-240:]
    middle = np.abs((lap - at["hip"]) @ across / (across @ across)) < 0.3
    pelvis, size = 0.5 * (at["lpelvis"] + at["rpelvis"]), child.person.stature_m / 1.75
    assert np.median((lap[middle] - pelvis) @ up / np.linalg.norm(up)) < 0.15 * size  # below the navel


def test_a_harness_lies_on_a_toddler() -> None:
    scene, child = drawn("toddler", "rear_left")
    assert child.belt == "harness"
    assert scene.things[0].thing.kind == "toddler_in_use"
    assert set(child.surfaces[1].label) == {LABEL_ID["seat_belt"]}
    distance = np.linalg.norm(child.surfaces[1].vertices[:, None, :] - child.surfaces[0].vertices[None, ::7], axis=2).min(axis=1)
    assert (distance < 0.03).mean() > 0.6


@pytest.mark.parametrize(
    ("scene", "message"),
    [
        ({"occupants": {"rear_left": {"subject": "S01"}}}, r"S01 is 1.7\d m tall: a booster holds children of 1.00 to 1.25 m"),
        ({"occupants": {"rear_left": {"subject": "S01"}}, "child_seats": {"rear_left": "infant"}}, "an infant holds children"),
        ({"belt_misuse": {"behind_back": 0.7, "under_arm": 0.7}}, "belt_misuse: the probabilities are 1.4 together"),
        ({"occupants": {"rear_left": {"belted": True, "belt": "none"}}}, "belted and belt say the same"),
        ({"objects": {"driver": {"blanket": 1.0}}}, "nothing is draped over the driver"),
    ],
)  # fmt: skip
def test_what_cannot_be_is_refused(scene: dict[str, object], message: str) -> None:
    with pytest.raises(ConfigError, match=message) as caught:
        SceneSampler(config("booster", **scene), 0).sample(0, rng=frame_rng(0, 0))
    assert caught.value.hint


def test_a_named_child_takes_the_seat() -> None:
    people = {"subjects": ["S01"], "own": {"mia": {"years": 7, "stature_cm": 122, "gender": "female"}}}
    named = SynthConfig.parse(
        {
            "scene": SUV | {"child_seats": {"rear_left": "booster"}, "occupants": {"rear_left": {"subject": "mia"}}},
            "people": people,
        }
    )
    (child,) = SceneSampler(named, 0).sample(0, rng=frame_rng(0, 0)).people
    assert (child.subject, child.person.stature_m) == ("mia", pytest.approx(1.22))


def test_frames_say_who_is_held_by_what_and_are_kept() -> None:
    asked = config(
        "toddler", occupancy={"driver": 1.0}, belt_misuse={"under_arm": 1.0}, belted=1.0, attachments={"belt": 1.0},
        child_seats={"rear_left": "toddler", "rear_right": "infant"}, objects={"front_passenger": {"jacket": 1.0}},
    )  # fmt: skip
    frame, scene = FrameMaker(asked, 1).make(0)
    assert frame["belt"] == ["under_arm", "", "harness", "", ""]
    assert frame["occupancy"] == ["adult", "object", "child_in_child_seat", "empty", "child_seat_empty"]
    assert frame["child_seat_kind"] == ["", "", "toddler", "", "infant"]
    assert frame["child_seat_facing"] == ["", "", "forward", "", "rearward"]
    assert frame["attachment"] == ["", "", "belt", "", "belt"]
    assert frame["things"][1] == "jacket"
    assert len(scene.fastenings) == 2
    kept, _ = FrameMaker(SynthConfig.parse(exact_scene(asked, scene).model_dump(mode="json")), 1).make(0)
    for name in ("depth_clean", "labels", "instance", "belt", "occupancy", "child_seat_kind", "attachment", "things"):
        np.testing.assert_array_equal(kept[name], frame[name])


@pytest.mark.parametrize(("taken", "kind"), [(True, "blanket"), (False, "jacket")])
def test_cloth_lies_on_what_is_below_and_nothing_comes_through(taken: bool, kind: str) -> None:
    import trimesh

    scene_of = {"objects": {"rear_left": {kind: 1.0}}, "child_seats": {}, "motion": {"rear_left": {"rest_lap": 1.0}}}
    occupants = {"rear_left" if taken else "driver": {"subject": "S02"}}
    scene = SceneSampler(config("booster", **scene_of, occupants=occupants), 0).sample(0, rng=frame_rng(0, 0))
    (cloth,) = scene.things
    assert cloth.at == ("lap" if taken else "seat")
    at = scene.cabin.group_transforms(scene.settings)
    cushion = next(part for part in scene.cabin.parts if part.name == "rear_left cushion")
    below = cushion.surface.moved(at[cushion.group]) if not taken else scene.people[0].surfaces[0]
    to_cloth = invert(cloth.vehicle_from_thing)
    mesh = trimesh.Trimesh(apply(to_cloth, below.vertices.astype(np.float64)), below.faces, process=False)
    for piece in cloth.thing.pieces:
        solid = trimesh.Trimesh(piece.solid.vertices, piece.solid.faces, process=False)
        assert solid.is_watertight
        assert solid.volume > 0.0
    sides = cloth.thing.pieces[0].solid.vertices.reshape(2, -1, 3)
    lower = sides[sides[..., 2].mean(axis=1).argmin()][::7]
    rays = np.tile((0.0, 0.0, 1.0), (len(lower), 1))
    assert not mesh.ray.intersects_any(lower, rays).any()  # nothing of the body is above it
    gap = trimesh.proximity.closest_point(mesh, lower)[1]
    assert (gap < 0.03).mean() > 0.5  # and it rests


def test_there_is_no_cloth_where_all_is_high_above_the_thighs() -> None:
    from cabinpose.synth.draping import Ground, draped

    scene, somebody = drawn("booster", "rear_left")
    raised = [replace(surface, vertices=surface.vertices + np.float32((0.25, 0.0, 0.3))) for surface in somebody.surfaces]
    cabin, setting = scene.cabin, scene.settings["rear_left"]
    assert cabin is not None
    ground = Ground.of(cabin.seats["rear_left"], setting, somebody.posed, None, 0)
    assert draped("blanket", 0, ground, raised) is None

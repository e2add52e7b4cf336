"""Who sits where and how, when the user says so: named people, initial and whole poses, every combination once."""

from __future__ import annotations

from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

import cabinpose
from cabinpose.core.errors import ConfigError, SceneError
from cabinpose.scene.body import DOF_INDEX, BodyModel, Phenotype
from cabinpose.scene.cabin import SeatSetting
from cabinpose.scene.sensor import SENSORS
from cabinpose.synth.config import SynthConfig
from cabinpose.synth.exact import exact_config, exact_scene, without_defaults
from cabinpose.synth.frame_maker import FrameMaker
from cabinpose.synth.plan import Plan
from cabinpose.synth.preflight import preflight
from cabinpose.synth.sample import SceneSampler
from cabinpose.synth.scene import Scene
from cabinpose.synth.streams import frame_rng, noise_rng
from cabinpose.synth.subjects import subject_body

ANNA = {"years": 34, "stature_cm": 168, "mass_kg": 62, "gender": "female", "outfit": {"top": "jacket", "hair": "long"}}
SEED = 3


def config(scene: dict[str, Any], **rest: Any) -> SynthConfig:
    return SynthConfig.parse({"scene": {"cars": ["suv"], "right_hand_drive": 0.0} | scene, **rest})


def scenes(of: SynthConfig, frames: range = range(4)) -> list[Scene]:
    preflight(of, frames=len(frames))
    sampler = SceneSampler(of, SEED)
    return [sampler.sample(i, rng=frame_rng(SEED, i)) for i in frames]


# ----------------------------------------------------------------------------------------------------- own people


def test_own_people_are_as_old_tall_and_heavy_as_said() -> None:
    phenotype, outfit = subject_body(config({}, people={"own": {"anna": ANNA}}), SEED, "anna")
    person = BodyModel.load().person(phenotype, outfit)
    assert phenotype.years == pytest.approx(34.0)
    assert person.stature_m == pytest.approx(1.68, abs=1e-5)
    assert person.mass_kg == pytest.approx(62.0, abs=0.1)
    assert (phenotype.gender, outfit.top, outfit.hair) == (1.0, "jacket", "long")


@pytest.mark.parametrize("mass_kg", [58.0, 75.0, 95.0, 115.0])
def test_own_people_of_every_mass(mass_kg: float) -> None:
    own = {"bob": {"years": 45, "stature_cm": 182, "mass_kg": mass_kg, "gender": "male"}}
    phenotype, _ = subject_body(config({}, people={"own": own}), SEED, "bob")
    assert BodyModel.load().person(phenotype).mass_kg == pytest.approx(mass_kg, abs=0.1)


def test_own_people_without_a_stature_have_the_usual_one() -> None:
    """Men of 25 to 40: 175.4 cm, women 161.5 cm (NHANES 2015-2018)."""
    own = {"a": {"years": 25, "gender": "male"}, "b": {"years": 25, "gender": "female"}}
    of = config({}, people={"own": own})
    assert [subject_body(of, SEED, name)[0].stature_m for name in "ab"] == [pytest.approx(1.754), pytest.approx(1.615)]


@pytest.mark.parametrize(
    ("own", "message", "hint"),
    [
        ({"anna": {"mass_kg": 20, "muscle": 0.3}}, "anna: no body of this age, stature and build weighs 20", "muscle 0.3"),
        ({"anna": {"mass_kg": 60, "weight": 0.5}}, "mass_kg and weight say the same of a person", "give one of the two"),
        ({"S01": {}}, "'S01' is the name of somebody else", "another name"),
        ({"anna": {"outfit": {"top": "toga"}}}, "outfit.top", "schema"),
        ({"anna": {"outfit": {"hat": "yes"}}}, "outfit.hat: unknown key", "did you mean people.own.anna.outfit.headwear?"),
        ({"anna": {"age": 34}}, "people.own.anna.age: unknown key", "did you mean people.own.anna.years?"),
        ({"anna": {"years": -1}}, "people.own.anna.years: must be greater than or equal to 0", "From birth"),
    ],
)  # fmt: skip
def test_people_who_cannot_be_are_refused(own: dict[str, Any], message: str, hint: str) -> None:
    with pytest.raises(ConfigError) as caught:
        preflight(config({}, people={"own": own}), frames=1)
    assert message in str(caught.value)
    assert hint in (caught.value.hint or "")


def test_random_people_in_years_and_centimetres() -> None:
    ranges = {"years": {"min": 20, "max": 30}, "stature_cm": {"min": 150, "max": 155}}
    of = config({}, people={"subjects": [], "random": {"count": 40, "ranges": ranges}})
    bodies = [subject_body(of, SEED, name)[0] for name in of.people.names]
    assert all(20 <= body.years <= 30 and 1.5 <= (body.stature_m or 0) <= 1.55 for body in bodies)
    assert np.ptp([body.years for body in bodies]) > 5
    with pytest.raises(ConfigError, match="stature_cm"):
        Phenotype.random({"stature_cm": (1.5, 1.6)}, rng=np.random.default_rng(0))


# ------------------------------------------------------------------------------------------------------ occupants


def test_named_people_sit_where_they_are_put_and_nobody_else() -> None:
    seats = {"driver": {"subject": "anna", "action": "drive"}, "rear_left": {"subject": "S05", "belted": False}}
    for scene in scenes(config({"occupants": seats}, people={"own": {"anna": ANNA}})):
        assert [(p.slot, p.subject) for p in scene.people] == [("driver", "anna"), ("rear_left", "S05")]
        assert scene.people[0].action == "drive"
        assert len(scene.people[1].surfaces) == 1  # no belt


def test_others_join_by_occupancy_and_are_other_people() -> None:
    seats = {"front_passenger": {"subject": "S01"}}
    made = scenes(config({"occupants": seats, "occupancy": {"driver": 1.0}}, people={"subjects": ["S01", "S02"]}))
    assert {tuple((p.slot, p.subject) for p in scene.people) for scene in made} == {
        (("driver", "S02"), ("front_passenger", "S01"))
    }


def test_a_child_drives_where_it_is_asked_to() -> None:
    assert scenes(config({"occupants": {"driver": {"subject": "S05"}}}), range(1))[0].people[0].subject == "S05"


def test_an_initial_pose_stands_and_a_profile_moves_about_it() -> None:
    pose = {"relbow.flexion": 75.0, "rshoulder.flexion": 40.0, "head.rotation": 12.0}
    profile = {"kind": "gaussian", "axes": {"relbow.flexion": {"sigma_deg": 4.0}}}
    driver = {"subject": "S01", "action": "rest_lap", "initial_pose_deg": pose, "profile": profile}
    qs = np.degrees([scene.people[0].posed.q for scene in scenes(config({"occupants": {"driver": driver}}), range(12))])
    for name in ("rshoulder.flexion", "head.rotation"):
        assert qs[:, DOF_INDEX[name]] == pytest.approx(pose[name])
    elbow = qs[:, DOF_INDEX["relbow.flexion"]]
    assert 1.0 < elbow.std() < 8.0
    assert abs(elbow.mean() - 75.0) < 4.0
    assert qs[:, DOF_INDEX["lelbow.flexion"]].std() > 1.0  # what is not named is solved and differs


def test_profiles_of_two_people_are_their_own() -> None:
    def gaussian(mean: float) -> dict[str, Any]:
        return {"profile": {"kind": "gaussian", "axes": {"head.rotation": {"mean_deg": mean, "sigma_deg": 0.0}}}}

    (scene,) = scenes(config({"occupants": {"driver": gaussian(15.0), "front_passenger": gaussian(-10.0)}}), range(1))
    found = [np.degrees(person.posed.q[DOF_INDEX["head.rotation"]]) for person in scene.people]
    assert found == [pytest.approx(15.0), pytest.approx(-10.0)]


STEPS = {"kind": "incremental", "axes": {"lelbow.flexion": {"step_deg": 30.0}}}
FORWARDS = {"fore_aft_m": 0.08, "height_m": 0.0, "torso_angle_rad": 0.4}


@pytest.mark.parametrize(
    ("scene", "message"),
    [
        ({"occupants": {"driver": {"subject": "nobody"}}}, "unknown subject 'nobody'"),
        ({"occupants": {"driver": {"subject": "R0003"}}}, "unknown subject 'R0003'"),
        ({"occupants": {"driver": {"action": "dance"}}}, "unknown action 'dance'"),
        ({"occupants": {"boot": {}}}, "unknown seat 'boot'"),
        ({"occupants": {"driver": {"subject": "S01"}, "rear_left": {"subject": "S01"}}}, "one person sits in two seats"),
        ({"occupants": {"driver": {"initial_pose_deg": {"lelbow.flexion": 400}}}}, "lelbow.flexion: 400 leaves the joint"),
        ({"occupants": {"driver": {"initial_pose_deg": {"tail.flexion": 4}}}}, "unknown degree of freedom 'tail.flexion'"),
        ({"occupants": {"rear_left": {"action": "drive"}}}, "drive makes no sense in the rear_left seat"),
        ({"occupants": {"rear_center": {}}, "cars": ["city_car"]}, "city_car has no rear_center seat"),
        ({"factorial": {"poses": 1}, "occupants": {"driver": {"subject": "S01"}}}, "people take turns in the driver seat"),
        ({"factorial": {"poses": 1}, "occupants": {"rear_left": {"subject": "S01"}}}, "S01 takes turns in the driver seat"),
        ({"factorial": {"poses": 1}, "profile": STEPS}, "not through those of an incremental profile"),
        ({"seats": {"front_passenger": FORWARDS}, "cars": ["suv", "shuttle"]}, "shuttle: seat front_passenger: fore_aft_m"),
        ({"factorial": {"poses": 1}}, "too young for the driver's seat of a factorial dataset: S05"),
    ],
)  # fmt: skip
def test_what_makes_no_sense_is_refused_before_work(scene: dict[str, Any], message: str) -> None:
    with pytest.raises(ConfigError) as caught:
        preflight(config(scene), frames=1)
    assert message in str(caught.value)


# -------------------------------------------------------------------------------------------- scenes written out


@pytest.mark.slow
def test_a_scene_written_out_gives_the_same_bytes(tmp_path: Path) -> None:
    """Cars and people of every kind; through a file, as `config frame` writes it."""
    seats = {"driver": 1.0, "front_passenger": 0.7, "rear_left": 0.5, "rear_right": 0.5}
    people = {"subjects": ["S01", "S04"], "random": {"count": 3}, "own": {"anna": ANNA}}
    drawn = config({"cars": ["suv", "coupe"], "random_cars": 1, "occupancy": seats, "right_hand_drive": 0.5}, people=people)
    met: Counter[str] = Counter()
    for index in range(5):
        told = tmp_path / f"{index}.yaml"
        told.write_text(yaml.safe_dump(exact_config(drawn, SEED, index).model_dump(mode="json")), "utf-8")
        (one,) = cabinpose.generate(frames=1, first=index, seed=SEED, config=drawn)
        (same,) = cabinpose.generate(frames=1, first=index, seed=SEED, config=told)
        (noisy,) = cabinpose.generate(frames=1, first=index + 1, seed=SEED, config=told)
        assert {
            name for name in one if not np.array_equal(one[name], same[name], equal_nan=np.asarray(one[name]).dtype.kind == "f")
        } == set()
        assert np.array_equal(one["depth_clean"], noisy["depth_clean"], equal_nan=True)
        assert not np.array_equal(one["depth"], noisy["depth"], equal_nan=True)
        met.update([one["car"], *filter(None, one["subject"])])
    assert {"C0000", "anna"} <= set(met)


def test_a_scene_written_out_has_no_filter_over_time() -> None:
    (scene,) = scenes(config({"occupancy": {"driver": 1.0}}), range(1))
    drawn = config({"sequence": {}}, camera={"sensor": {"preset": "evk75123", "temporal_median": 5}})
    told = yaml.safe_load(yaml.safe_dump(without_defaults(exact_scene(drawn, scene))))
    assert SynthConfig.parse(told).camera.sensor_model == SENSORS["evk75123"]


def _written_out(made: FrameMaker, index: int) -> tuple[set[str], dict[str, Any]]:
    """The variables that a frame has in other bytes once it is written out and made again, and the scene that is written."""
    one, scene = made.make(index)
    told = yaml.safe_load(yaml.safe_dump(without_defaults(exact_scene(made.config, scene))))
    same, _ = FrameMaker(SynthConfig.parse(told), SEED).make(index)
    return {name for name in one if not _equal(one[name], same[name])}, told["scene"]


@pytest.mark.parametrize(
    ("scene", "frames", "moved"),
    [
        ({"cars": ["sedan", "city_car"], "occupancy": {"driver": 1, "rear_right": 1}}, range(4), {0, 2}),
        ({"child_seats": {"rear_right": "toddler"}, "children": 1.0}, range(3), {0, 1, 2}),
        ({"child_seats": {"rear_right": "infant"}}, range(2), {0, 1}),
    ],
)
def test_empty_seats_stay_where_legs_and_child_seats_had_them(scene: dict[str, Any], frames: range, moved: set[int]) -> None:
    """Knees behind it, a child and an infant carrier move the empty seat of the front passenger."""
    maker = FrameMaker(config({"cars": ["city_car"], "occupancy": {"driver": 1.0}} | scene), SEED)
    made = {index: _written_out(maker, index) for index in frames}
    assert {index: others for index, (others, _) in made.items() if others} == {}
    assert {index for index, (_, told) in made.items() if "front_passenger" in told.get("seats", {})} == moved


def test_a_belt_that_hangs_or_is_drawn_is_written_out() -> None:
    """Frames while somebody buckles up: all bytes but the time since the sequence's start."""
    sequence = {"frames": 80, "rate_hz": 7.0, "activities": ["buckle_up"]}
    maker = FrameMaker(config({"occupancy": {"front_passenger": 1.0}, "sequence": sequence}, people={"subjects": ["S04"]}), SEED)
    buckling = maker.sampler.plan_sequence(0).tracks["front_passenger"].buckling
    assert buckling is not None
    _, grasp_s, plug_s = buckling
    for time_s, how in (
        (0.2, "loose"), (grasp_s - 0.2, "loose"), (grasp_s + 0.2, "drawn"), (plug_s - 0.2, "drawn"), (plug_s + 0.2, "worn"),
    ):  # fmt: skip
        others, told = _written_out(maker, round(7.0 * time_s))
        who = told["occupants"]["front_passenger"]
        assert others == {"sync_ns"}
        assert who["belted"] == (how == "worn")
        assert who["pose"].get("tongue", {"how": "worn"})["how"] == how


_GIVEN = {"driver": (0.01, 0.02, 0.41), "front_passenger": (-0.02, 0.0, 0.36), "rear_center": (0.0, 0.0, 0.4)}
_SEATS = {slot: dict(zip(("fore_aft_m", "height_m", "torso_angle_rad"), at, strict=True)) for slot, at in _GIVEN.items()}


@pytest.mark.parametrize(
    "behind",
    [{"occupancy": {"driver": 1.0, "rear_right": 1.0}}, {"child_seats": {"rear_right": "toddler"}, "children": 1.0}],
    ids=["grown-up", "child"],
)
def test_a_seat_that_is_given_stays(behind: dict[str, Any]) -> None:
    """An empty one and one that somebody takes, with knees behind; this car has no seat in the middle."""
    of = {"cars": ["city_car"], "occupancy": {"driver": 1.0}} | behind
    free, kept = scenes(config(of), range(3)), scenes(config(of | {"seats": _SEATS}), range(3))
    assert any(scene.settings["front_passenger"].fore_aft_m > 0.0 for scene in free)
    for scene in kept:
        assert [scene.settings[slot] for slot in ("driver", "front_passenger")] == [
            SeatSetting(*_GIVEN[slot]) for slot in ("driver", "front_passenger")
        ]


def test_a_seat_that_is_given_makes_no_room_for_a_carrier() -> None:
    of = {"cars": ["city_car"], "occupancy": {"driver": 1.0}, "child_seats": {"rear_right": "infant"}}
    assert all(scene.settings["front_passenger"].fore_aft_m > 0.0 for scene in scenes(config(of), range(2)))
    with pytest.raises(SceneError, match=r"rear_right: infant in front_passenger backrest"):
        scenes(config(of | {"seats": _SEATS}, limits={"scenes_per_frame": 3}), range(1))


def test_a_seat_is_given_within_its_range() -> None:
    seats = {"front_passenger": {"fore_aft_m": 0.9, "height_m": 0.0, "torso_angle_rad": 0.4}}
    with pytest.raises(ConfigError, match=r"seat front_passenger: fore_aft_m = 0\.9 is outside"):
        scenes(config({"seats": seats}), range(1))


def _equal(a: Any, b: Any) -> bool:
    return np.array_equal(a, b, equal_nan=np.asarray(a).dtype.kind == "f")


def test_noise_has_numbers_of_its_own() -> None:
    scene, noise = (rng.random(1000) for rng in (frame_rng(1, 2), noise_rng(1, 2)))
    assert not np.isin(noise, scene).any()
    assert np.array_equal(noise, noise_rng(1, 2).random(1000))


def test_a_pose_by_hand_is_judged() -> None:
    """A forearm pushed through the trunk: refused at once, in words."""
    told = exact_config(config({"occupants": {"driver": {"subject": "S01", "action": "rest_lap"}}}), SEED, 0).model_dump(
        mode="json"
    )
    angles = told["scene"]["occupants"]["driver"]["pose"]["angles_rad"]
    angles.update({"lshoulder.flexion": 0.3, "lshoulder.abduction": 0.0, "lshoulder.rotation": 1.0, "lelbow.flexion": 2.0})
    with pytest.raises(SceneError, match=r"the given pose does not hold: driver: .* mm deep"):
        scenes(SynthConfig.parse(told), range(1))


def test_somebody_drawn_gives_way_to_a_pose_that_is_given() -> None:
    """The driver is as written out; a passenger who is drawn sits beside, differently in each frame."""
    told = exact_config(config({"occupants": {"driver": {"subject": "S08"}}}), SEED, 0).model_dump(mode="json")
    told["scene"]["occupancy"] = {"front_passenger": 1.0}
    made = scenes(SynthConfig.parse(told), range(3))
    drivers = {scene.people[0].posed.q.tobytes() for scene in made}
    passengers = {scene.people[1].posed.q.tobytes() for scene in made}
    assert (len(drivers), len(passengers)) == (1, 3)


# ----------------------------------------------------------------------------------------------------- factorial


def test_every_combination_comes_equally_often() -> None:
    of = config(
        {"cars": ["suv", "sedan"], "factorial": {"poses": 2}},
        people={"subjects": ["S01", "S02"], "own": {"anna": ANNA}},
        camera={"views": {"driver": 1.0, "front_row": 0.3, "rear": 0.0}},
    )
    assert of.frames == 2 * 3 * 2 * 2
    made = scenes(of, range(of.frames))
    counts = Counter((scene.place, scene.people[0].subject, scene.pov) for scene in made)
    assert len(counts) == 12
    assert set(counts.values()) == {2}
    assert len({scene.people[0].posed.q.tobytes() for scene in made}) == 24
    with pytest.raises(ConfigError, match="25 frames are asked for, but all combinations are 24"):
        preflight(of, frames=25)


def test_combinations_have_every_car_once() -> None:
    of = config({"cars": ["C0001"], "random_cars": 3, "factorial": {"poses": 5}}, people={"subjects": ["S01"]})
    assert of.frames == 3 * 2 * 5  # C0000 to C0002, from two views
    assert Plan(of, SEED).cell(of.frames - 1) == ("C0002", "S01", "front_row")


def test_people_take_turns_in_another_seat() -> None:
    of = config(
        {"factorial": {"poses": 1, "seat": "front_passenger"}, "occupancy": {"driver": 1.0}}, people={"subjects": ["S05", "S01"]}
    )
    made = scenes(of, range(4))
    assert [scene.people[1].subject for scene in made] == ["S05", "S05", "S01", "S01"]
    assert all(scene.people[0].subject == "S01" for scene in made[:2])


def test_without_a_number_all_combinations_are_made() -> None:
    assert len(list(cabinpose.generate("scene.cars=[suv]", "scene.factorial.poses=1", "people.subjects=[S01]"))) == 2
    with pytest.raises(ConfigError, match="it is not said how many frames"):
        cabinpose.generate("scene.cars=[suv]")

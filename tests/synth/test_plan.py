"""Which cars, people and rooms the frames of a dataset draw from."""

from __future__ import annotations

from collections import Counter

import numpy as np
import pytest
from synth_scenes import small_config

from cabinpose.core.errors import ConfigError
from cabinpose.scene.cabin import PRESETS
from cabinpose.synth.config import SynthConfig
from cabinpose.synth.people import People, RandomPeople, Range
from cabinpose.synth.plan import CARS_IN_PLAY, PEOPLE_IN_PLAY, Plan
from cabinpose.synth.streams import frame_rng
from cabinpose.synth.subjects import subject_body

SEED = 5


def cars_of(plan: Plan, frames: range) -> list[str]:
    return [plan.car(i, rng=frame_rng(SEED, i))[0] for i in frames]


def test_forty_frames_show_all_seven_cars() -> None:
    assert set(cars_of(Plan(small_config(cars=PRESETS), SEED), range(40))) == set(PRESETS)


def test_of_many_cars_few_are_in_play_and_each_comes_once_a_round() -> None:
    """200 cars, 50 frames for each: every car is met, in one run of frames, and about equally often."""
    cars = cars_of(Plan(small_config(cars=(), random_cars=200), SEED), range(10_000))
    frames = {car: [i for i, c in enumerate(cars) if c == car] for car in sorted(set(cars))}
    assert len(frames) == 200
    within = (CARS_IN_PLAY + 1) * 50
    in_one_run = [f for f in frames.values() if f[-1] - f[0] < within]
    assert len(in_one_run) >= 200 - 2 * CARS_IN_PLAY  # those of the first and the last frames are met twice
    assert all(len(set(cars[i : i + 50])) <= CARS_IN_PLAY + 1 for i in range(0, 9_000, 50))
    counts = np.array([len(f) for f in frames.values()])
    assert abs(counts.mean() - 50) < 1
    assert counts.std() < 1.5 * np.sqrt(50)


def test_people_differ_within_a_frame_and_all_have_their_turn() -> None:
    plan = Plan(SynthConfig(people=People(subjects=(), random=RandomPeople(count=60))), SEED)
    met: Counter[str] = Counter()
    for i in range(7_200):  # twenty rounds
        people = plan.people(i, 5, rng=frame_rng(SEED, i))
        assert len(set(people)) == 5
        met.update(people)
    assert len(met) == 60
    assert max(met.values()) < 1.5 * min(met.values())
    assert len({name for i in range(6) for name in plan.people(i, 5, rng=frame_rng(SEED, i))}) <= PEOPLE_IN_PLAY


def test_too_few_people_are_taken_twice() -> None:
    plan = Plan(SynthConfig(people=People(subjects=("S01", "S02"))), SEED)
    assert set(plan.people(0, 5, rng=frame_rng(SEED, 0))) <= {"S01", "S02"}


def test_children_do_not_drive_unless_asked() -> None:
    """S05 is about ten, S17 about eighteen."""
    plan, rng = Plan(SynthConfig(people=People(subjects=("S05", "S17", "S02"))), SEED), np.random.default_rng(0)
    assert plan.driver_first(0, ["S05", "S17"], rng=rng) == ["S17", "S05"]
    assert plan.driver_first(0, ["S02", "S05"], rng=rng) == ["S02", "S05"]
    assert plan.driver_first(0, ["S05"], rng=rng) in (["S17"], ["S02"])
    anyone = Plan(SynthConfig(people=People(subjects=("S05", "S17"), driver_years=0.0)), SEED)
    assert anyone.driver_first(0, ["S05", "S17"], rng=rng) == ["S05", "S17"]
    children = Plan(SynthConfig(people=People(subjects=("S05",))), SEED)
    assert children.driver_first(0, ["S05"], rng=rng) == ["S05"]


def test_random_people_by_years() -> None:
    ranges = {"years": Range(min=20.0, max=40.0)}
    config = SynthConfig(people=People(subjects=(), random=RandomPeople(count=50, ranges=ranges)))
    years = [subject_body(config, SEED, name)[0].years for name in config.people.names]
    assert 20.0 <= min(years) < 24.0
    assert 36.0 < max(years) <= 40.0
    with pytest.raises(ConfigError, match="age") as caught:
        RandomPeople(count=3, ranges={"age": Range(min=20.0, max=40.0)})
    assert "years" in str(caught.value.hint)


def test_sides_differ_where_they_are_to() -> None:
    """Whoever has a name is the same in all datasets; a crowd is drawn anew."""
    plain = SynthConfig.parse({"people": {"random": {"count": 2}}})
    config = SynthConfig.parse({"people": {"random": {"count": 2}, "asymmetric": True}})
    assert subject_body(plain, 1, "S03")[0].asymmetry == subject_body(plain, 1, "R0001")[0].asymmetry == 0
    one, two = ({name: subject_body(config, seed, name)[0].asymmetry for name in ("S03", "S04", "R0001")} for seed in (1, 2))
    assert 0 not in one.values()
    assert one["S03"] == two["S03"] != one["S04"]
    assert one["R0001"] != two["R0001"]


def test_a_random_car_keeps_its_wheel_on_one_side() -> None:
    """A preset may have it on either; the share is the configured one."""
    plan = Plan(small_config(cars=("sedan",), random_cars=150, right_hand_drive=0.4), SEED)
    sides: dict[str, set[str]] = {}
    for i in range(7_600):
        car, side = plan.car(i, rng=frame_rng(SEED, i))
        sides.setdefault(car, set()).add(side)
    assert sides.pop("sedan") == {"left", "right"}
    assert all(len(s) == 1 for s in sides.values())
    share = np.mean([s == {"right"} for s in sides.values()])
    assert abs(share - 0.4) < 3 * np.sqrt(0.24 / len(sides))

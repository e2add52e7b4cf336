"""Cars drawn at random: what they may be, that a generator's state is all they depend on, low against tall cars."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from cars import random_car

from cabinpose.scene.cabin import CabinDimensions


@cache
def cars() -> list[CabinDimensions]:
    """Many random cars, made when the first test asks for them."""
    return [random_car(seed) for seed in range(3000)]


def column(code: str) -> np.ndarray:
    """(car,) one dimension of every car."""
    return np.array([getattr(car, code) for car in cars()])


def test_dimensions_are_within_the_models_limits() -> None:
    for code, field in CabinDimensions.model_json_schema()["properties"].items():
        if "minimum" in field:
            values = column(code)
            assert values.min() >= field["minimum"], code
            assert values.max() <= field["maximum"], code
    assert (column("w3_mm") >= 2 * column("w20_mm") + 420).all()
    assert (column("l53_mm") - column("l11_mm") >= 300).all()
    assert (column("h25_mm") <= column("h61_mm") - 352).all()


def test_a_car_stands_as_the_same_numbers_in_a_file() -> None:
    """Every car passes the model's own check again, and is not changed by it."""
    for car in cars():
        assert CabinDimensions(**car.model_dump()) == car


def test_the_same_seed_draws_the_same_car() -> None:
    assert [random_car(seed) for seed in range(50)] == cars()[:50]
    assert len({tuple(car.model_dump(exclude={"name"}).values()) for car in cars()}) == len(cars())


@pytest.mark.parametrize(
    ("code", "sign"),
    [("l53_mm", -1), ("a40_deg", -1), ("a27_deg", -1), ("h61_mm", 1), ("a18_deg", 1), ("l11_mm", -1), ("h17_mm", 1),
     ("a121_1_deg", -1), ("a122_deg", -1), ("h30_2_mm", 1)],
)  # fmt: skip
def test_people_sit_more_upright_the_higher_they_sit(code: str, sign: int) -> None:
    assert sign * np.corrcoef(column("h30_mm"), column(code))[0, 1] > 0.8


@pytest.mark.parametrize("code", ["w20_mm", "l50_mm", "w9_mm", "h25_mm", "a121_2_deg", "b_pillar_mm"])
def test_what_does_not_follow_the_height_is_independent_of_it(code: str) -> None:
    """Of 3000 independent pairs the coefficient of correlation has a standard deviation of 0.018."""
    assert abs(np.corrcoef(column("h30_mm"), column(code))[0, 1]) < 0.09


def test_low_and_tall_cars_both_appear() -> None:
    """Heights are spread evenly between those of a sports car and of a van."""
    counts = np.histogram(column("h30_mm"), bins=10, range=(175, 400))[0]
    assert counts.sum() == len(cars())
    assert (np.abs(counts - 300) < 5 * np.sqrt(300)).all()


def test_every_style_appears_and_the_lowest_have_sports_seats() -> None:
    for style, options in (("seat_style", 4), ("rear_style", 3), ("dash_style", 5), ("console_style", 4), ("door_style", 5)):
        assert len(set(column(style))) == options, style
    assert set(column("seat_style")[column("h30_mm") < 229]) == {"sport"}
    assert {2, 3} == set(column("rear_places"))
    assert column("w20_2_mm")[column("rear_places") == 3].min() > column("w20_2_mm")[column("rear_places") == 2].max() - 0.11


def test_captains_chairs_stand_in_high_cars_alone() -> None:
    """Their column is 14 cm tall: in a low car it would stand in the cushion, and nobody could sit there."""
    front, rear = column("seat_style") == "captain", column("rear_style") == "captain"
    assert front.any()
    assert column("h30_mm")[front].min() >= 270
    assert rear.any()
    assert column("h30_2_mm")[rear].min() >= 260

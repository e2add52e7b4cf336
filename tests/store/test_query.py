"""Conditions on frames, against Python's own words run for each frame and person."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from cabinpose.app.cli import main
from cabinpose.core.errors import ConfigError
from cabinpose.store import open_dataset
from cabinpose.store.query import completions, frames_where, query_columns

CARS = ("hatchback", "sedan", "suv")
ACTIONS = ("drive", "phone", "sleep")
SUBJECTS = ("S01", "S02", "S03")
SLOTS = ("driver", "front_passenger")


@pytest.fixture(scope="module")
def columns() -> dict[str, NDArray[Any]]:
    """200 frames of two people at most, and errors, some of them unknown."""
    rng = np.random.default_rng(4)
    there = rng.random((200, 2)) < 0.7
    people = {
        "subject": np.where(there, rng.choice(SUBJECTS, (200, 2)), ""),
        "action": np.where(there, rng.choice(ACTIONS, (200, 2)), ""),
        "person": np.where(there, SLOTS, ""),
    }
    people["age"] = np.where(there, rng.integers(0, 4, (200, 2)), np.nan)
    errors = np.where(rng.random(200) < 0.1, np.nan, rng.exponential(4.0, 200))
    return {"frame": np.arange(200), "car": rng.choice(CARS, 200), "error_cm": errors, "people": there.sum(1), **people}


def brute(columns: Mapping[str, NDArray[Any]], words: str) -> list[bool]:
    """Whether Python finds it true of the frame, or of anybody in it; for conditions without a negation."""
    found = []
    for frame in range(200):
        of = [{name: c[frame] if c.ndim == 1 else c[frame, p] for name, c in columns.items()} for p in range(2)]
        found.append(any(eval(words, {"__builtins__": {}}, values) for values in of))  # noqa: S307 - the oracle
    return found


@pytest.mark.parametrize(
    "words",
    [
        'car == "suv"',
        '"suv" == car',
        'car == "suv" and error_cm > 5',
        "2 < error_cm <= 5",
        "error_cm >= 3 or people < 1",
        'action in ["sleep", "phone"] and car == "sedan"',
        'person == "driver" and action == "sleep"',
        'car in ("suv",) and (subject == "S01" or subject == "S02")',
        "frame < 17",
        "people == 2",
        "error_cm > -1",
        "age < people",
        "people < age",
        "0 < people < age <= 2",
        "age < 1 and people == 2",
        "frame in [3, 5]",
    ],
)
def test_conditions_hold_as_python_says(columns: dict[str, NDArray[Any]], words: str) -> None:
    held = frames_where(columns, words)
    assert held.tolist() == brute(columns, words)
    assert 0 < held.sum() < 200


@pytest.mark.filterwarnings("error")
def test_no_number_is_too_large_to_compare(columns: dict[str, NDArray[Any]]) -> None:
    """Neither for double precision nor, as errors are kept, for single."""
    columns = columns | {"error_cm": columns["error_cm"].astype(np.float32)}
    known = np.isfinite(columns["error_cm"])
    for large in ("1" + 400 * "0", "1e39", "1e400"):
        np.testing.assert_array_equal(frames_where(columns, f"error_cm < {large}"), known)
        np.testing.assert_array_equal(frames_where(columns, f"-{large} < error_cm and frame < {large}"), known)
        assert not frames_where(columns, f"error_cm == {large} or frame == -{large}").any()


def test_an_edge_belongs_to_what_is_at_least_as_much(columns: dict[str, NDArray[Any]]) -> None:
    """Also in single precision, in which 1.9 is a little less than in double."""
    stature = np.array([[1.9, 1.7]] * 200, np.float32)
    for words, held in (("stature >= 1.9", True), ("stature > 1.9", False), ("1.9 <= stature and people < 3", True)):
        assert (frames_where({**columns, "stature": stature}, words) == held).all(), words


@pytest.mark.parametrize(
    ("words", "of"),
    [
        ('subject != "S01"', 'subject == "S01"'),
        ('not action == "sleep"', 'action == "sleep"'),
        ('action not in ["sleep", "phone"]', 'action in ["sleep", "phone"]'),
        ("not error_cm > 5", "error_cm > 5"),
    ],
)
def test_a_negation_means_nobody(columns: dict[str, NDArray[Any]], words: str, of: str) -> None:
    assert (frames_where(columns, words) == ~np.array(brute(columns, of))).all()


def test_who_has_no_joints_is_there_by_their_name(dataset_folder: Path) -> None:
    dataset = open_dataset(dataset_folder)
    columns = query_columns(dataset.assign(visibility=dataset["visibility"] * np.uint8(0)))
    assert columns["people"].tolist() == query_columns(dataset)["people"].tolist()


def test_and_asks_for_the_same_person(columns: dict[str, NDArray[Any]]) -> None:
    both = frames_where(columns, 'person == "driver" and action == "sleep"')
    driver = columns["action"][:, 0] == "sleep"
    anybody = (columns["action"] == "sleep").any(axis=1) & (columns["person"] == "driver").any(axis=1)
    assert (both == driver).all()
    assert anybody.sum() > both.sum()


@pytest.mark.parametrize(
    ("words", "message", "hint"),
    [
        ('car = "suv"', "no condition", "car =="),
        ("car", "no condition", "car =="),
        ('car == "suvv"', 'no frame has car "suvv"', "sedan"),
        ('cars == "suv"', "unknown coordinate", "car"),
        ("car == suv", "suv is no value", "suv"),
        ("car > 3", "is text", "sedan"),
        ("car == 3", "3 is none", "sedan"),
        ('error_cm > "5"', "no number", "error_cm"),
        ("error_cm == True", "no number", "error_cm"),
        ('"u" in car', "no condition", 'car in ["suv"'),
        ("", "no condition", "car =="),
        ('__import__("os").system("true")', "no condition", "car =="),
        ('car.__class__ == "suv"', "no condition", "car =="),
        ("error_cm > max(frame)", "no number", "error_cm"),
        ('[car for car in ["suv"]]', "no condition", "car =="),
        ("(" * 900 + "car" + ")" * 900, "no condition", "car =="),
        ("not " * 600 + 'car == "suv"', "at most", ""),
        ('car == "suv" and\x00 people', "no condition", "car =="),
    ],
)
def test_what_is_no_condition_is_said(columns: dict[str, NDArray[Any]], words: str, message: str, hint: str) -> None:
    with pytest.raises(ConfigError) as told:
        frames_where(columns, words)
    assert message in told.value.in_one_line()
    assert hint in (told.value.hint or "")


def test_completions(columns: dict[str, NDArray[Any]]) -> None:
    assert completions(columns, "ca") == ["car"]
    assert completions(columns, 'car == "s') == ['car == "sedan"', 'car == "suv"']
    assert completions(columns, "car == ") == ['car == "hatchback"', 'car == "sedan"', 'car == "suv"']
    assert completions(columns, 'action in ["sleep", ') == [f'action in ["sleep", "{a}"' for a in ACTIONS]
    assert completions(columns, 'car == "suv" ') == ['car == "suv" and', 'car == "suv" or']
    assert 'car == "suv" and error_cm' in completions(columns, 'car == "suv" and e')
    assert completions(columns, "not pe") == ["not people", "not person"]


def test_where_on_the_command_line(dataset_folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["info", str(dataset_folder), "--where", "frame < 2", "--json"]) == 0
    assert '"selected": 2' in capsys.readouterr().out
    assert main(["info", str(dataset_folder), "--where", "frame > 99"]) == 2
    assert "hint: " in capsys.readouterr().err


def test_columns_of_a_dataset(dataset_folder: Path) -> None:
    dataset = open_dataset(dataset_folder)
    columns = query_columns(dataset) | {"error_cm": np.arange(5.0)}
    assert (columns["view"] == dataset["pov"].values).all()
    assert columns["people"].tolist() == [(frame != "").sum() for frame in columns["person"]]
    assert frames_where(columns, "error_cm > 2 and frame < 4").tolist() == [False, False, False, True, False]
    for name in ("car", "sequence", "subject"):
        value = columns[name].ravel().tolist()[0]
        assert frames_where(columns, f"{name} == {value!r}").any()

"""Images that are turned and depths of another unit are told, by what a model makes of them changed back; true ones are not."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import cabinpose
from cabinpose.core import FrameBatch, PoseBatch
from cabinpose.estimate import load_model
from cabinpose.estimate.alternatives import ALTERNATIVES, Alternatives
from cabinpose.store.itop import read_itop_frames

IN_ROOM, IN_CAR = ("scene.kind=room", "camera.sensor=kinect_v1", "noise={kind: structured_light}"), ("scene.cars=[suv]",)
Change = Callable[[FrameBatch], FrameBatch]


def made(*changes: str, frames: int) -> FrameBatch:
    each = list(cabinpose.generate(*changes, frames=frames, seed=4))
    names = ("depth", "amplitude", "camera_k", "camera_dist")
    return {name: np.stack([frame[name] for frame in each]) for name in names}  # type: ignore[return-value]


@pytest.fixture(scope="module")
def people() -> dict[str, FrameBatch]:
    """By model frames that it knows; read only."""
    return {"room": made(*IN_ROOM, frames=10), "in_car": made(*IN_CAR, frames=10)}


def turned(quarters: int) -> Change:
    """A camera that is mounted so, with its own matrix: the middle of these images is their principal point, all but a pixel."""

    def change(frames: FrameBatch) -> FrameBatch:
        images = {name: np.rot90(frames[name], quarters, axes=(1, 2)) for name in ("depth", "amplitude")}  # type: ignore[literal-required]
        k = frames["camera_k"].copy()
        if quarters % 2:
            k[:, 0, 2], k[:, 1, 2] = frames["camera_k"][:, 1, 2], frames["camera_k"][:, 0, 2]
        return {**frames, **images, "camera_k": k}  # type: ignore[typeddict-item]

    return change


def scaled(factor: float) -> Change:
    return lambda frames: {**frames, "depth": frames["depth"] * np.float32(factor)}


def upside_down(frames: FrameBatch) -> FrameBatch:
    return {**frames, "depth": frames["depth"][:, ::-1], "amplitude": frames["amplitude"][:, ::-1]}


def looked_at(model: str, frames: FrameBatch) -> tuple[PoseBatch, list[str]]:
    predictor = load_model(model, threads=1)
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always", UserWarning)
        found = predictor.predict(frames)
    return found, [str(each.message) for each in caught]


@pytest.mark.parametrize(
    ("model", "wrong", "said"),
    [
        ("room", turned(1), "turned by 90° counter-clockwise"),
        ("room", scaled(0.5), "about 2 times too small"),
        pytest.param("room", turned(2), "turned by 180°, or mirrored upside down", marks=pytest.mark.slow),
        pytest.param("room", turned(3), "turned by 90° clockwise", marks=pytest.mark.slow),
        pytest.param("room", upside_down, "turned by 180°, or mirrored upside down", marks=pytest.mark.slow),
        pytest.param("room", scaled(0.2), "about 5 times too small", marks=pytest.mark.slow),
        pytest.param("room", scaled(2.0), "about 2 times too large", marks=pytest.mark.slow),
        pytest.param("room", scaled(5.0), "about 5 times too large", marks=pytest.mark.slow),
        ("in_car", turned(2), "turned by 180°, or mirrored upside down"),
        pytest.param("in_car", scaled(2.0), "about 2 times too large", marks=pytest.mark.slow),
    ],
    ids=("90", "half", "180", "270", "upside down", "fifth", "twice", "five times", "car 180", "car twice"),
)
def test_turned_images_and_scaled_depths_are_told_once(
    people: dict[str, FrameBatch], model: str, wrong: Change, said: str
) -> None:
    found, warned = looked_at(model, wrong(people[model]))
    (remark,) = [each for each in found.remarks if "seem to be" in each]
    assert said in remark
    assert "Nothing was changed" in remark
    assert warned.count(remark) == 1


@pytest.mark.parametrize("model", ["room", "in_car"])
def test_nothing_is_said_of_frames_as_they_should_be(people: dict[str, FrameBatch], model: str) -> None:
    found, warned = looked_at(model, people[model])
    assert found.remarks == ()
    assert not any("seem to be" in each for each in warned)


def answers(count: int, sure: int) -> tuple[Any, Any]:
    """Presence and expected errors (N, 1, 20) of so many answers in each of which so many joints are sure."""
    expected = np.where(np.arange(20) < sure, 0.01, 0.2)[None, None].repeat(count, axis=0)
    return np.ones(expected.shape), expected


def test_few_frames_are_tried_and_none_once_the_frames_are_familiar() -> None:
    asked = [0]

    def ask() -> tuple[Any, Any]:
        asked[0] += 1
        return answers(len(ALTERNATIVES), 9)

    usual, unknown = np.full(20, 0.01), np.full(20, np.nan)
    doubtful = Alternatives("model", usual)
    for _ in range(1000):
        doubtful.look(*answers(1, 3), ask)
    assert (asked[0], doubtful.told) == (9, "")  # never enough joints: frames 1, 3, 7, 15, ...
    familiar = Alternatives("model", usual)
    for _ in range(16):
        assert familiar.open
        familiar.look(*answers(1, 20), ask)
    assert (asked[0], familiar.open) == (9, False)
    assert not Alternatives("model", unknown).open  # a model without expected errors


def test_an_alternative_needs_votes_of_most_frames() -> None:
    best = np.where(np.arange(len(ALTERNATIVES)) == 1, 18, 2)

    def ask() -> tuple[Any, Any]:
        expected = np.where(np.arange(20) < best[:, None], 0.01, 0.2)[:, None]
        return np.ones(expected.shape), expected

    tried = Alternatives("model", np.full(20, 0.01))
    for n in range(6):  # frames 1, 2, 4 and 6 are tried
        assert (tried.told, tried.open) == ("", True), n
        tried.look(*answers(1, 2), ask)
    assert tried.told.startswith("images seem to be turned by 180°")
    assert "in 4 of 4 frames that were tried model would be sure of far more: 18 joints a frame in place of 2" in tried.told
    # Beside more frames that the model knows, the same frames say nothing.
    mixed = Alternatives("model", np.full(20, 0.01))
    for _ in range(10):
        for sure in (20, 2, 20):
            mixed.look(*answers(1, sure), ask)
    assert not mixed.told


def test_cameras_are_tried_each_for_itself(people: dict[str, FrameBatch]) -> None:
    model = load_model("room", threads=1)
    with pytest.warns(UserWarning, match="turned by 90"):
        assert model.predict(turned(1)(people["room"])).remarks
    assert model.predict(people["room"]).remarks == ()


@pytest.mark.real_data
@pytest.mark.slow
@pytest.mark.parametrize(("model", "view"), [("room", "front"), ("room_top", "top")])
def test_real_frames_are_told_turned_and_scaled_alone(real_data: Callable[[str], Path], model: str, view: str) -> None:
    file = real_data(f"itop/itop_{view}_64.npz")
    frames = read_itop_frames(file)
    assert looked_at(model, frames)[0].remarks == ()
    with np.load(file) as scaled_to_1:
        # The scale that the source of the frames gives is that of one of the two views: the other is 1.55 times as large with it.
        nominal = 4.24 * scaled_to_1["depth01"]
    said = {"front": [], "top": ["depths seem to be about 1.4 times too large"]}[view]
    assert [remark.split(":")[0] for remark in looked_at(model, {**frames, "depth": nominal})[0].remarks] == said
    for factor in (0.3, 0.5, 1.5, 3.0):
        (remark,) = looked_at(model, scaled(factor)(frames))[0].remarks
        assert ("too small" in remark) == (factor < 1)
    turns = {each: looked_at(model, {**frames, "depth": np.rot90(frames["depth"], each, axes=(1, 2))})[0] for each in (1, 2, 3)}
    known = (1, 2, 3) if view == "front" else ()  # from the ceiling people have no up
    assert [each for each, found in turns.items() if found.remarks] == [*known]

"""Answers with names: in words, as a table, as a picture."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cabinpose.core import ConfigError, DependencyError, PoseBatch
from cabinpose.store import PERSON_COLOUR, FoundPeople, Predictions, read_predictions, write_predictions

PEOPLE, JOINTS = ("driver", "rear_left"), ("head", "neck", "rhand")
SIZE = (64, 48)
NAMES = {"persons": PEOPLE, "joints": JOINTS, "model": "mine", "skeleton": "cabinpose"}


def batch(frames: int = 0) -> PoseBatch:
    """A driver whose head and neck are there, nobody else: of one frame where `frames` is 0."""
    shape = (max(frames, 1), 2, 3)
    uv, xyz = np.full((*shape, 2), np.nan, np.float32), np.full((*shape, 3), np.nan, np.float32)
    uv[:, 0, :2], xyz[:, 0, :2] = ((20, 10), (20, 30)), ((0.0, 0.6, 0.8), (0, 0, 0.9))
    presence = np.zeros(shape, np.float32)
    presence[:, 0], presence[:, 1] = (1.0, 0.9, 0.2), 0.1
    error = np.where(presence > 0.5, np.float32(0.02), np.float32(np.nan))
    poses = PoseBatch(uv, xyz, presence, presence, expected_error_m=error)
    return poses if frames else poses.map(lambda values: values[0])


def found(frames: int = 0) -> FoundPeople:
    """The same with names."""
    return FoundPeople(**vars(batch(frames)), **NAMES, size=SIZE)  # type: ignore[arg-type]


def predicted() -> Predictions:
    """The same of frames 4 and 7."""
    return Predictions(**vars(batch(2)), **NAMES, frame=np.array([4, 7]))  # type: ignore[arg-type]


def test_it_tells_joints_units_and_people() -> None:
    assert repr(found()).splitlines() == [
        "FoundPeople of mine: one frame, 2 people x 3 joints (cabinpose), joints_2d in px, joints_3d in m, camera frame",
        "  driver: 2 of 3 joints in the image, 1.00 m away, expected error 2.0 cm",
        "  rear_left: not there",
    ]
    first, driver, _ = repr(predicted()).splitlines()
    assert first.startswith("Predictions of mine: 2 frames, ")
    assert driver.startswith("  driver: in 2 of 2, 2 of 3 joints")
    blind = found()
    blind.reason[...] = "the lens is <covered>"
    assert repr(blind).endswith("nobody can be seen in 1: the lens is <covered>")
    assert "<tr><th>driver</th><td>2 of 3 joints" in blind._repr_html_()
    assert "the lens is &lt;covered&gt;" in blind._repr_html_()


def test_nothing_found_has_its_words() -> None:
    empty = FoundPeople(**vars(batch(0).map(lambda a: a[:0])), **{**NAMES, "persons": ()}, size=SIZE)  # type: ignore[arg-type]
    assert "0 people x 3 joints" in repr(empty)
    assert empty.draw(np.zeros((48, 64))).shape == (480, 640, 3)
    assert len(empty.to_dataframe()) == 0


def test_a_table_has_the_columns_and_numbers_of_the_file(tmp_path: Path) -> None:
    """Held against the rows of a written file, which are made apart."""
    import pandas as pd

    table = predicted().to_dataframe()
    assert table.attrs["z"] == "m"
    rows = pd.read_json(write_predictions(tmp_path / "p.jsonl", predicted()), lines=True).dropna(subset="joint")
    there = table.dropna(subset="u").reset_index(drop=True)
    assert list(table.columns) == ["frame", "person", "joint", "u", "v", "x", "y", "z", "score", "presence", "expected_error_m"]
    for name in table.columns:
        same = there[name].tolist() == rows[name].tolist()
        assert same or np.allclose(there[name], rows[name].astype(float), atol=1e-6)
    assert len(table) == 2 * 2 * 3
    assert table["person"].tolist()[3:6] == ["rear_left"] * 3
    assert found().to_dataframe()["frame"].unique().tolist() == [0]
    assert repr(read_predictions(tmp_path / "p.jsonl")).startswith("Predictions of mine: 2 frames, ")


def test_a_table_needs_pandas(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "pandas", None)
    with pytest.raises(DependencyError, match="to_dataframe needs the Python package pandas, which is not installed") as caught:
        found().to_dataframe()
    assert caught.value.hint == "pip install pandas"


def test_a_picture_has_the_joints_on_their_pixels_and_limbs_between() -> None:
    picture = found().draw(np.zeros((48, 64, 3), np.uint8), scale=10)
    assert picture.shape == (480, 640, 3)
    for u, v in ((20, 10), (20, 30), (20, 20)):  # head, neck, and the limb between them
        assert tuple(picture[v * 10 + 5, u * 10 + 5]) == PERSON_COLOUR[0]
    assert not picture[300:, 300:].any()  # the hand's presence is 0.2
    assert picture[:40, :200].any()  # the names


def test_who_is_not_there_is_grey_and_has_no_skeleton() -> None:
    image = np.zeros((48, 64, 3), np.uint8)
    everybody, nobody = found().draw(image, least=0.5, scale=10), found().draw(image, least=1.1, scale=10)
    coloured, grey = (np.ptp(picture.astype(int), axis=-1) > 40 for picture in (everybody, nobody))  # PERSON_COLOUR[0] is orange
    assert coloured[30:].sum() > 300
    assert coloured[:14, :200].any()  # the driver's name
    assert not coloured[16:30, :200].any()
    assert everybody[16:30, :200].any()  # the name of who is not there
    assert not grey.any()
    assert nobody[:14, :200].any()


def test_depths_are_drawn_in_grey_and_what_is_unknown_is_black() -> None:
    depth = np.linspace(0.5, 1.5, 48 * 64, dtype=np.float32).reshape(48, 64)
    depth[40:, 50:] = np.nan
    picture = found().draw(depth, scale=1)
    assert (picture[42:, 52:] == 0).all()
    assert (picture[30, 40:] == picture[30, 40:, :1]).all()
    assert picture[47, 40, 0] > picture[25, 60, 0] > 0
    assert np.isnan(depth[40, 50])  # as it came


def test_the_given_image_stays_and_a_frame_of_many_is_named() -> None:
    image = np.full((48, 64, 3), 9, np.uint8)
    predicted().draw(image, frame=7)
    assert (image == 9).all()
    with pytest.raises(ConfigError, match="there is no answer on frame 5") as caught:
        predicted().draw(image, frame=5)
    assert caught.value.hint == "numbers of frames: 4 to 7"
    with pytest.raises(ConfigError, match="answers on 2 frames"):
        found(2).draw(image)
    np.testing.assert_array_equal(found(2).draw(image, frame=1), found().draw(image))


@pytest.mark.parametrize(
    "image",
    [np.zeros((48, 63)), np.zeros((96, 128, 3), np.uint8), np.zeros((48, 64, 3)), np.zeros((48, 64), complex), np.zeros(5)],
    ids=["narrow", "larger", "floats", "complex", "a row"],
)
def test_another_image_is_refused(image: np.ndarray[Any, Any]) -> None:
    with pytest.raises(ConfigError, match="image"):
        found().draw(image)

"""Which frames are drawn of datasets that are there, and what counts as the same frame."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import xarray as xr

from cabinpose.app.experiment import frames
from cabinpose.app.experiment.config import FrameSelection, load
from cabinpose.app.experiment.frames import Drawn, SelectedFrames, contents, draw
from cabinpose.app.experiment.pieces import DatasetPiece
from cabinpose.app.experiment.plan import make_plan
from cabinpose.app.experiment.schedule import make_cells
from cabinpose.core.errors import ConfigError, DatasetError
from cabinpose.store import open_dataset

Write = Callable[..., Path]


def selected(monkeypatch: pytest.MonkeyPatch, sequence: list[int], *, still: bool = False, **part: Any) -> SelectedFrames:
    """A part of a dataset in memory whose frames are of these sequences."""
    count = len(sequence)
    dataset = xr.Dataset(
        coords={
            "frame": np.arange(count), "sequence": ("frame", sequence), "pov": ("frame", ["driver", "rear"] * (count // 2)),
            "sync_ns": ("frame", np.zeros(count) if still else np.arange(count)),
        },
        attrs={"frames_id": "one"},
    )  # fmt: skip
    monkeypatch.setattr(frames, "open_dataset", lambda _: dataset)
    piece = DatasetPiece("real", Path("real"), "key", count, frozenset(), frozenset())
    return SelectedFrames(FrameSelection(data="real", **part), (piece,))


def positions(drawn: Drawn) -> list[int]:
    return [int(each) for _, found in drawn for each in found]


def test_nobody_learns_from_a_sequence_that_validation_cuts(monkeypatch: pytest.MonkeyPatch) -> None:
    sequence = np.repeat(range(5), 4)
    judged = draw(selected(monkeypatch, sequence.tolist(), frames=6), [], "v", whole_sequences=True)
    learnt = draw(selected(monkeypatch, sequence.tolist()), [judged], "t", apart=[judged])
    assert len(positions(judged)) == 6
    assert len({*sequence[positions(judged)]}) == 2
    assert {*sequence[positions(learnt)]} == {*range(5)} - {*sequence[positions(judged)]}
    assert len(positions(learnt)) == 12


def test_people_and_cars_of_a_folder_are_those_of_the_selection(monkeypatch: pytest.MonkeyPatch) -> None:
    """Who selects by car is not refused for people that other cars have, and the other way round."""
    shown = {"car": ["a", "a", "b", "b"], "subject": [["P"], ["Q"], ["Q"], ["R"]], "seed": [1, 1, 1, 1]}
    dims = {"subject": ("frame", "slot")}
    frames._shown_in.cache_clear()

    def of(**part: Any) -> SelectedFrames:
        source = selected(monkeypatch, [0] * 4, **part)
        dataset = open_in_memory().assign_coords({name: (dims.get(name, "frame"), values) for name, values in shown.items()})
        monkeypatch.setattr(frames, "open_dataset", lambda _: dataset)
        return source

    def open_in_memory() -> Any:
        return frames.open_dataset(Path("real"))

    first = of(car=("a",))
    assert (first.people, first.cars) == ({("P", None), ("Q", None)}, {("a", None)})
    last = of(subject=("R",))
    assert (last.people, last.cars) == ({("R", None)}, {("b", None)})
    frames._shown_in.cache_clear()


def test_of_one_sequence_what_stands_together_validates(monkeypatch: pytest.MonkeyPatch) -> None:
    judged = positions(draw(selected(monkeypatch, [0] * 20, frames=6), [], "v", whole_sequences=True))
    assert judged == [*range(judged[0], judged[0] + 6)]
    single = positions(draw(selected(monkeypatch, [0] * 20, still=True, frames=6), [], "v", whole_sequences=True))
    assert single != [*range(single[0], single[0] + 6)]


def test_one_wrong_value_among_several_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(DatasetError, match="v: real has no pov 'fornt_row'") as error:
        draw(selected(monkeypatch, [0] * 4, pov=("driver", "fornt_row")), [], "v")
    assert error.value.hint == "it has: driver, rear"


def test_frames_are_the_same_however_many_were_made_and_wherever_they_lie(write: Write, tmp_path: Path) -> None:
    """A stand-in of the same scenes and seed with fewer frames, and a copy of a folder."""
    real = load(write()).data["real"]
    again = {"synth": real.synth, "seed": 3, "frames": {"P1": 2}}
    tests: dict[str, Any] = {"T": {"frames": [{"data": "again"}], "may_share": ["car", "subject"]}}
    plan = make_plan(load(write({"data": {"again": again}, "tests": tests})), "paper", tmp_path / "out", {})
    make_cells(plan.made, 1, lambda *_: None)
    with pytest.raises(ConfigError, match="test T and training R1 share the frame 0, 1"):
        plan.check_frames(plan.cells)
    tests["T"]["frames"][0] |= {"depth": "depth_styled"}
    plan = make_plan(load(write({"data": {"again": again}, "tests": tests})), "paper", tmp_path / "out", {})
    with pytest.raises(DatasetError, match="again/P1 has no depth_styled"):
        plan.check_frames(plan.cells)

    piece = next(cell.piece for cell in plan.made if cell.piece.name == "real/P1")
    shutil.copytree(piece.folder, tmp_path / "copy")
    copy = DatasetPiece("copy", tmp_path / "copy", "other", 4, piece.people, piece.cars)
    here, there = (contents([[(each, np.arange(4))]]) for each in (piece, copy))
    assert here == there
    other = SelectedFrames(FrameSelection(data="copy"), (copy,))
    action = str(open_dataset(piece.folder)["action"].values[0, 0])
    wanted = SelectedFrames(FrameSelection(data="copy", action=(action,)), (copy,))
    assert wanted.frames == int((open_dataset(piece.folder)["action"].values == action).any(axis=1).sum())
    assert SelectedFrames(FrameSelection(data="copy", pov=("rear",)), (copy,)).frames == 0
    assert positions(draw(other, [[(piece, np.array([0, 2]))]], "t")) == [1, 3]

"""The predictions file: what is written is read, in both encodings, and every kind of damage is named."""

from __future__ import annotations

import json
import resource
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cabinpose.core.errors import DependencyError, PredictionsError
from cabinpose.store import predictions as module
from cabinpose.store.predictions import Predictions, read_predictions, write_predictions

HEADER = {
    "format": "cabinpose-predictions", "version": 1, "model": "m", "skeleton": "cabinpose", "joints": ["head", "neck"],
    "persons": ["driver", "rear_left"], "dataset": None,
}  # fmt: skip
ROW = {"frame": 3, "person": "driver", "joint": "head", "u": 10.5, "v": 20, "score": 0.5, "presence": 0.9}
SUFFIXES = (".jsonl", ".parquet")


def drawn(seed: int, frames: int = 4) -> Predictions:
    """Answers with holes of all kinds; every frame has one."""
    rng = np.random.default_rng(seed)
    shape = (frames, 2, 3)
    two, three = rng.normal(100, 50, (*shape, 2)), rng.normal(0, 1, (*shape, 3))
    two[rng.random(shape) < 0.4] = np.nan
    three[rng.random(shape) < 0.4] = np.nan
    two[:, 0, 0] = 1.0
    nothing = np.isnan(two).any(-1) & np.isnan(three).any(-1)
    score, presence = (np.where(nothing, 0, rng.random(shape)) for _ in range(2))
    number = np.sort(rng.choice(10**6, frames, replace=False))
    expected = np.where(nothing | (rng.random(shape) < 0.5), np.nan, rng.random(shape)).astype(np.float32)
    arrays = (x.astype(np.float32) for x in (two, three, score, presence))
    names = ("driver", "rear_left"), ("neck", "head", "chest"), f"model {seed}", "cabinpose", "ds"
    return Predictions(*arrays, number, *names, expected_error_m=expected)


@pytest.mark.parametrize("suffix", SUFFIXES)
@settings(max_examples=15)
@given(seed=st.integers(0, 10**6))
def test_round_trip(tmp_path_factory: pytest.TempPathFactory, suffix: str, seed: int) -> None:
    wanted = drawn(seed)
    path = write_predictions(tmp_path_factory.mktemp("p") / f"p{suffix}", wanted)
    found = read_predictions(path)
    for name, value in vars(wanted).items():
        if isinstance(value, np.ndarray):
            np.testing.assert_array_equal(getattr(found, name), value)
        else:
            assert getattr(found, name) == value


def test_both_encodings_hold_the_same(tmp_path: Path) -> None:
    one, two = (read_predictions(write_predictions(tmp_path / f"p{suffix}", drawn(1))) for suffix in SUFFIXES)
    assert all(np.array_equal(a, b, equal_nan=True) for a, b in zip(vars(one).values(), vars(two).values(), strict=True)
               if isinstance(a, np.ndarray) and a.dtype.kind == "f")  # fmt: skip


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_reasons_and_remarks_are_kept_with_their_frames(tmp_path: Path, suffix: str) -> None:
    reasons = np.array(["", "97.1 % of it is a wall", "", "98.0 % of it is a wall"], object)
    wanted = drawn(3)
    for name in ("joints_2d", "joints_3d"):
        getattr(wanted, name)[reasons != ""] = np.nan
    wanted = replace(wanted, reason=reasons, remarks=("half a hand",))
    found = read_predictions(write_predictions(tmp_path / f"p{suffix}", wanted))
    assert found.frame.tolist() == wanted.frame.tolist()  # a frame without people is no frame that is missing
    assert found.reason.tolist() == reasons.tolist()
    assert found.remarks == ("half a hand",)
    assert found.unseen == {"97.1 % of it is a wall": 2}
    assert found.take(wanted.frame[[3, 0]]).reason.tolist() == [reasons[3], ""]


@pytest.mark.parametrize(
    ("rows", "said"),
    [
        (({"frame": 4, "reason": "dark"}, ROW), "row 1 has a reason and stands before rows of joints"),
        ((ROW, {"frame": 3, "reason": "dark"}), "row 2: frame 3 has rows beside its reason"),
        ((ROW, {"frame": 4, "reason": "dark"}, {"frame": 4, "reason": "dark"}), "row 2: frame 4 has rows beside its reason"),
        ((ROW, {"frame": 4, "reason": " "}), "row 2: a reason is a text beside the frame alone"),
        ((ROW, ROW | {"frame": 4, "reason": "dark"}), "row 2: a reason is a text beside the frame alone"),
    ],
    ids=["before", "beside joints", "twice", "blank", "with a joint"],
)
def test_reasons_that_cannot_be_are_refused(tmp_path: Path, rows: tuple[object, ...], said: str) -> None:
    path = tmp_path / "p.jsonl"
    path.write_text(lines(ROW, {"frame": 4, "reason": "dark"}))
    assert read_predictions(path).reason.tolist() == ["", "dark"]
    path.write_text(lines(*rows))
    with pytest.raises(PredictionsError, match=said):
        read_predictions(path)


def test_take_leaves_unknown_frames_empty() -> None:
    answers = drawn(2)
    wanted = np.array([answers.frame[2], 10**7, answers.frame[0], -1])
    batch = answers.take(wanted)
    np.testing.assert_array_equal(batch.joints_2d[[0, 2]], answers.joints_2d[[2, 0]])
    assert np.isnan(batch.joints_3d[[1, 3]]).all()
    assert not batch.presence[[1, 3]].any()


def lines(*rows: object, header: object = HEADER, end: object = "count") -> str:
    last = [{"rows": len(rows)}] if end == "count" else [] if end is None else [end]
    return "".join(json.dumps(x) + "\n" for x in (header, *rows, *last))


def test_a_file_by_hand(tmp_path: Path) -> None:
    """Score and presence may be left out, coordinates may be null."""
    path = tmp_path / "p.jsonl"
    solid = {"frame": 1, "person": "rear_left", "joint": "neck", "u": None, "x": 0.1, "y": 0.2, "z": 1.5}
    path.write_text(lines(ROW, solid))
    found = read_predictions(path)
    assert found.frame.tolist() == [1, 3]
    assert found.joints_2d[1, 0, 0].tolist() == [10.5, 20]
    assert np.allclose(found.joints_3d[0, 1, 1], (0.1, 0.2, 1.5))
    assert found.presence[0, 1, 1] == found.score[0, 1, 1] == 1
    assert np.isfinite(found.joints_2d).sum() == 2
    path.write_text(lines())
    assert read_predictions(path).frame.size == 0


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "is empty"),
        ("{]\n", r":1: not a line of JSON"),
        (lines(header={"format": "else"}), "is no predictions file"),
        (lines(header=[1]), "is no predictions file"),
        (lines(header={**HEADER, "version": 2}), "version 2"),
        (lines(header={**HEADER, "modell": "x"}), "unknown key modell"),
        (lines(header={**HEADER, "joints": ["a", "a"]}), "'joints' is no list"),
        (lines(header={k: v for k, v in HEADER.items() if k != "model"}), "does not name the model"),
        (lines(ROW, end=None), "is cut short: it has no last line, and 1 rows"),
        (lines(ROW, end={"rows": 5}), "is cut short: it should have 5 rows"),
        (lines(ROW) + json.dumps(ROW) + "\n", "a row behind the last line"),
        (lines(ROW)[:-40], "not a line of JSON"),
        (lines(7), "a row is a JSON object"),
        (lines({**ROW, "w": 1}), "unknown column w"),
        (lines(ROW, {**ROW, "joint": "knee"}), "row 2: unknown joint 'knee'"),
        (lines({**ROW, "person": "roof"}), "row 1: unknown person 'roof'"),
        (lines({**ROW, "frame": -1}), "frame -1 is no frame number"),
        (lines({**ROW, "frame": 1.5}), "frame 1.5 is no frame number"),
        (lines({**ROW, "frame": True}), "frame True is no frame number"),
        (lines({**ROW, "u": float("nan")}), "row 1: u is nan"),
        (lines({**ROW, "score": float("inf")}), "row 1: score is inf"),
        (lines({**ROW, "u": "left"}), "column u holds something that is no number"),
        (lines({**ROW, "u": None}), "row 1 has some of u, v"),
        (lines({**ROW, "x": 1.0, "z": 1.0}), "row 1 has some of x, y, z"),
        (lines({k: v for k, v in ROW.items() if k not in "uv"}), "row 1 has no position"),
        (lines({**ROW, "presence": 1.2}), "row 1: presence is a probability"),
        (lines({**ROW, "expected_error_m": -0.1}), "row 1: expected_error_m is below 0"),
        (lines(ROW, {**ROW, "joint": "neck"}, ROW), "frame 3, driver, head has 2 rows"),
    ],
)
def test_what_is_wrong_is_named(tmp_path: Path, text: str, message: str) -> None:
    path = tmp_path / "p.jsonl"
    path.write_text(text)
    with pytest.raises(PredictionsError, match=message) as caught:
        read_predictions(path)
    assert caught.value.hint


def test_files_that_are_not_there_or_there_already(tmp_path: Path) -> None:
    with pytest.raises(PredictionsError, match="there is no predictions file"):
        read_predictions(tmp_path / "absent.jsonl")
    with pytest.raises(PredictionsError, match="there is no predictions file"):
        read_predictions(tmp_path / "absent.parquet")
    (tmp_path / "p.jsonl").write_bytes(b"\xff\xfe")
    with pytest.raises(PredictionsError, match="cannot read"):
        read_predictions(tmp_path / "p.jsonl")
    with pytest.raises(PredictionsError, match="exists"):
        write_predictions(tmp_path / "p.jsonl", drawn(0))
    assert (tmp_path / "p.jsonl").read_bytes() == b"\xff\xfe"
    write_predictions(tmp_path / "p.jsonl", drawn(0), overwrite=True)
    assert [p.name for p in tmp_path.iterdir()] == ["p.jsonl"]


def test_damaged_parquet(tmp_path: Path) -> None:
    import pyarrow as pa
    import pyarrow.parquet as parquet

    path = write_predictions(tmp_path / "p.parquet", drawn(0))
    whole = path.read_bytes()
    path.write_bytes(whole[: len(whole) // 2])
    with pytest.raises(PredictionsError, match="no whole Parquet file"):
        read_predictions(path)
    parquet.write_table(pa.table({"frame": [1]}), path)
    with pytest.raises(PredictionsError, match="lacks the key"):
        read_predictions(path)
    table = pa.table({"frame": [1], "w": [1]}).replace_schema_metadata({"cabinpose": json.dumps(HEADER)})
    parquet.write_table(table, path)
    with pytest.raises(PredictionsError, match="unknown column w"):
        read_predictions(path)
    words = pa.table({"frame": [1], "u": ["left"]}).replace_schema_metadata({"cabinpose": json.dumps(HEADER)})
    parquet.write_table(words, path)
    with pytest.raises(PredictionsError, match="the column u holds string, no numbers"):
        read_predictions(path)
    deep = words.replace_schema_metadata({"cabinpose": "[" * 100_000})
    parquet.write_table(deep, path)
    with pytest.raises(PredictionsError, match="no whole Parquet file"):
        read_predictions(path)


def test_parquet_that_would_fill_the_memory(tmp_path: Path) -> None:
    """Ten million equal rows take a few kilobytes; a long name stands in a file once."""
    import pyarrow as pa
    import pyarrow.parquet as parquet

    path = tmp_path / "p.parquet"
    parquet.write_table(pa.table({"frame": pa.array(np.ones(10_000_000, np.int8))}), path)
    assert path.stat().st_size < 50_000
    with pytest.raises(PredictionsError, match=r"it would unpack to 1.0 GB"):
        read_predictions(path)
    count, name = 20_000, "x" * 100_000
    columns = {"frame": pa.array(range(count)), "person": pa.array([name]), "u": pa.array([1.0] * count)}
    columns["person"] = pa.DictionaryArray.from_arrays(pa.array([0] * count, pa.int32()), columns["person"])
    parquet.write_table(pa.table(columns).replace_schema_metadata({"cabinpose": json.dumps(HEADER)}), path)
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    with pytest.raises(PredictionsError, match="person"):
        read_predictions(path)
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < 300_000


def test_parquet_without_pyarrow(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    real: Callable[..., Any] = module.find_spec
    monkeypatch.setattr(module, "find_spec", lambda name: None if name == "pyarrow" else real(name))
    with pytest.raises(DependencyError, match="pyarrow") as caught:
        read_predictions(tmp_path / "p.parquet")
    assert "cabinpose[parquet]" in str(caught.value.hint)

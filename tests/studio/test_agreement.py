"""Who labelled what, and how far two agree, against counts by hand."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from cabinpose.app.cli import main
from cabinpose.app.label.agreement import agreement_of
from cabinpose.core.errors import DatasetError
from cabinpose.core.pose import Visibility
from cabinpose.store.labels import JointLabel, Labels

PERSONS, JOINTS = ("driver",), ("head", "neck", "chest", "hip")
NOWHERE = (float("nan"),) * 3
V, O, X = Visibility.VISIBLE, Visibility.OCCLUDED, Visibility.ABSENT


def journal(path: Path, rows: list[tuple[int, str, float, Visibility]], *, role: str = "annotator", dataset: str = "d") -> Path:
    """Labels at (u, 10); one change each."""
    labels = Labels(path, dataset, PERSONS, JOINTS)
    for frame, joint, u, state in rows:
        uv = (np.nan, np.nan) if state == X else (u, 10.0)
        labels.set([((frame, "driver", joint), JointLabel(uv, NOWHERE, state))], role=role, how="placed")
    labels.close()
    return path


@pytest.fixture
def two(tmp_path: Path) -> tuple[Path, Path]:
    mine = [(0, "head", 1, V), (0, "neck", 5, V), (0, "chest", 7, O), (0, "hip", 0, X), (1, "head", 4, V)]
    theirs = [(0, "head", 2, V), (0, "neck", 9, O), (0, "chest", 19, O), (0, "hip", 3, V)]
    return journal(tmp_path / "a.labels.jsonl", mine), journal(tmp_path / "b.labels.jsonl", theirs, role="reviewer")


def test_distances_and_states_by_hand(two: tuple[Path, Path]) -> None:
    """Apart by 1, 4 and 12 px, and once absent for one of them. Alike: 2 of 4; by chance V: 2/4 2/4, O: 1/4 2/4, X: 1/4 0."""
    found = agreement_of(*two)
    assert (found.joints, found.frames, found.alone) == (4, 1, (1, 0))
    assert found.median_px == pytest.approx(4)
    assert found.p90_px == pytest.approx(4 + 0.8 * 8)
    assert found.within == {2.0: pytest.approx(1 / 3), 5.0: pytest.approx(2 / 3), 10.0: pytest.approx(2 / 3)}
    assert found.same_state == 0.5
    chance = 0.5 * 0.5 + 0.25 * 0.5
    assert found.kappa == pytest.approx((0.5 - chance) / (1 - chance))


def test_one_with_himself_agrees_wholly(two: tuple[Path, Path]) -> None:
    found = agreement_of(two[0], two[0])
    assert (found.median_px, found.same_state, found.kappa) == (0.0, 1.0, 1.0)


def test_what_cannot_be_compared_is_said(two: tuple[Path, Path], tmp_path: Path) -> None:
    other = journal(tmp_path / "c.labels.jsonl", [(0, "head", 1, V)], dataset="another")
    with pytest.raises(DatasetError, match="different datasets"):
        agreement_of(two[0], other)
    with pytest.raises(DatasetError, match="no joint in common"):
        agreement_of(two[1], journal(tmp_path / "d.labels.jsonl", [(5, "head", 1, V)]))


def test_the_command_says_who_and_how_far(two: tuple[Path, Path], capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    assert main(["info", str(two[0]), "--against", str(two[1])]) == 0
    said = capsys.readouterr().out
    assert "5 joints of 2" in said
    assert "median 4.0 px" in said
    assert "kappa) 0.20" in said
    assert main(["info", str(two[1]), "--json"]) == 0
    (work,) = json.loads(capsys.readouterr().out)["roles"]
    assert (work["role"], work["frames"], work["joints"], work["how"]) == ("reviewer", 1, 4, {"placed": 4})
    assert work["first"] < work["last"]
    assert main(["info", str(tmp_path), "--against", str(two[1])]) == 2
    assert "hint: give two" in capsys.readouterr().err

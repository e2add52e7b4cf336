"""Folds of an experiment's datasets: nobody is in two of them, and what they share is refused, as early as it can be known."""

from __future__ import annotations

import copy
from collections.abc import Callable
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from cabinpose.app.experiment.config import Experiment, load, merged
from cabinpose.app.experiment.frames import draw
from cabinpose.app.experiment.plan import ExperimentPlan, make_plan
from cabinpose.app.experiment.results import results_of, table_rows
from cabinpose.app.experiment.schedule import make_cells
from cabinpose.core.errors import ConfigError, DatasetError
from cabinpose.store import frame_mask, open_dataset, validated

Write = Callable[..., Path]
PEOPLE = tuple("ABCDEFG")
FOLDS = [{"A", "F"}, {"B", "G"}, {"C"}, {"D"}, {"E"}]  # seven people, dealt out to five by hand


def page_example() -> dict[str, Any]:
    """The example of five folds of the documentation, with people of names in place of a folder."""
    page = (Path(__file__).parents[2] / "docs" / "experiments.md").read_text()
    data: dict[str, Any] = yaml.safe_load(page.partition("### Five folds")[2].partition("```yaml\n")[2].partition("```")[0])
    synth = {"scene": {"cars": ["sedan"], "occupancy": {"driver": 1.0}}, "people": {"own": {name: {} for name in PEOPLE}}}
    ours = {"synth": synth, "frames": {name: 3 + number for number, name in enumerate(PEOPLE)}}
    return data | {"data": {"ours": ours}}


def planned(data: dict[str, Any], out: Path) -> ExperimentPlan:
    return make_plan(validated(Experiment, copy.deepcopy(data), None, hint=""), "small", out, {})


def test_the_example_of_the_page_tests_everybody_once(tmp_path: Path) -> None:
    plan = planned(page_example(), tmp_path / "out")
    people = [set(plan.tested[f"fold {k}", f"people {k}"][0].frames[0].part.subject) for k in range(1, 6)]
    assert people == FOLDS
    frames = {name: 3 + number for number, name in enumerate(PEOPLE)}
    for number, tested in enumerate(people, 1):
        cell = plan.trained[f"fold {number}"][0]
        learnt, judged = ({who for source in side for who, _ in source.people} for side in (cell.train, cell.validation))
        assert sorted(chain(learnt, judged, tested)) == list(PEOPLE)  # each on one side
        assert cell.frame_count == sum(frames[name] for name in learnt)
    assert set(plan.tested) == {(f"fold {k}", f"people {k}") for k in range(1, 6)}
    rows = table_rows(plan, results_of(plan, 0))
    assert (len(rows), rows[1][0]) == (6, "fold 1")
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("change", "error"),
    [
        ({"trainings": {"fold 1": {"train": [{"data": "ours", "subject/5": [1, 3]}]}}}, "training fold 1 share the subject A, F"),
        ({"trainings": {"fold 1": {"train": [{"data": "ours", "subject/5": [2, 3]}]}}}, "its validation share the subject B, G"),
        ({"trainings": {"fold 1": {"train": [{"data": "ours", "subject/9": [8]}]}}}, r"no subject in subject/9: \[8\]"),
        ({"trainings": {"fold 1": {"train": [{"data": "ours", "subject/5": [6]}]}}}, "a part of ours: subject/5 has no fold 6"),
        ({"trainings": {"fold 1": {"train": [{"data": "ours", "colour/5": [1]}]}}}, "selects by 'colour/5'"),
        ({"trainings": {"fold 1": {"train": [{"data": "ours", "folds": {"car": [1]}}]}}}, "folds: car has none"),
        ({"trainings": {"fold 1": {"train": [{"data": "ours", "subject": ["A"], "subject/5": [1]}]}}}, "has subject and"),
        ({"tests": {"people 1": {"trainings": ["fold 9"]}}}, "unknown training 'fold 9'"),
        ({"tests": {"people 1": {"trainings": ["fold 2"]}}}, "no test judges training fold 1"),
        ({"tests": {"people 1": {"trainings": None}}}, "test people 1 and training fold 2 share the subject A, F"),
    ],
)  # fmt: skip
def test_what_folds_share_is_known_by_name(change: dict[str, Any], error: str, tmp_path: Path) -> None:
    with pytest.raises((ConfigError, DatasetError), match=error):
        planned(merged(page_example(), change), tmp_path)


def test_both_spellings_are_one(tmp_path: Path) -> None:
    data = page_example()
    other = copy.deepcopy(data)
    for row in other["trainings"].values():
        for part in chain(row["train"], row["validation"]):
            part["folds"] = {"subject/5": part.pop("subject/5")}
    keys = [[cell.key for cell in planned(each, tmp_path).cells] for each in (data, other)]
    assert keys[0] == keys[1]
    read = validated(Experiment, validated(Experiment, data, None, hint="").model_dump(mode="json"), None, hint="")
    assert [cell.key for cell in make_plan(read, "small", tmp_path, {}).cells] == keys[0]  # as `report` reads it


@pytest.mark.slow
def test_of_random_people_it_is_known_when_they_are_there(write: Write, tmp_path: Path) -> None:
    """Nobody is in two folds, and no frame is lost; the same fold on both sides is refused by the very frames."""

    def file(train: dict[str, Any], validation: dict[str, Any], test: dict[str, Any]) -> ExperimentPlan:
        sides = {"train": [{"data": "real", **train}], "validation": [{"data": "real", **validation}]}
        tests = {"T": {"frames": [{"data": "real", **test}], "may_share": ["car"]}}
        people = {"subjects": [], "own": None, "random": {"count": 4}}
        data = {"real": {"frames": 10, "synth": {"people": people}}}
        return make_plan(load(write({"data": data, "trainings": {"R1": sides}, "tests": tests})), "paper", tmp_path / "out", {})

    apart = file({"subject/3": [1]}, {"subject/3": [2]}, {"subject/3": [3]})
    assert apart.trained["R1"][0].frame_count == 3  # a third of ten is expected
    make_cells(apart.made, 1, lambda *_: None)
    (piece,) = apart.data["real"]
    dataset = open_dataset(piece.folder)
    subject = dataset["subject"].values.astype(str)[:, 0]
    there = sorted(set(subject))
    assert len(there) > 2  # more would tell no more
    apart.check_frames(apart.cells)
    cell = apart.trained["R1"][0]
    sides = [*chain(*cell.drawn()), *apart.tested["R1", "T"][0].drawn()]
    numbers = [positions for each in sides for _, positions in each]
    assert sorted(np.concatenate(numbers).tolist()) == list(range(10))
    for fold, positions in enumerate(numbers):
        assert sorted(set(subject[positions])) == there[fold::3]
        np.testing.assert_array_equal(np.flatnonzero(frame_mask(dataset, {"subject/3": [fold + 1]})), positions)
    same = file({"subject/3": [1]}, {"subject/3": [2]}, {"subject/3": [1]})
    with pytest.raises(ConfigError, match=f"test T and training R1 share the subject {there[0]}"):
        same.check_frames(same.cells)
    mixed = file({}, {"subject/3": [1], "frames": 1}, {"subject/3": [3]})
    with pytest.raises(ConfigError, match="training R1 and its validation share the subject"):
        mixed.check_frames(mixed.cells)
    empty = file({"subject/9": [9]}, {"subject/3": [2]}, {"subject/3": [3]})
    with pytest.raises(ConfigError, match=r"real has no subject in subject/9: \[9\]"):
        draw(empty.trained["R1"][0].train[0], [], "training")


@pytest.mark.slow
def test_folds_of_actions_are_of_all_pieces(write: Write, tmp_path: Path) -> None:
    """Of a stand-in by subject each has its own folder; the folds are of what all of them show."""
    sides = {"train": [{"data": "real", "action/2": [1]}], "validation": [{"data": "real", "action/2": [2]}]}
    changes = {
        "data": {"real": {"frames": {"P1": 1, "P2": 1, "P3": 2}}},
        "trainings": {"R1": {**sides, "may_share": ["subject"]}},
        "tests": {"T": {"frames": [{"data": "real"}], "may_share": ["car", "subject"]}},
        "scales": {"paper": {"steps": 4}},
    }
    plan = make_plan(load(write(changes)), "paper", tmp_path / "out", {})
    make_cells(plan.made, 1, lambda *_: None)
    pieces = plan.data["real"]
    actions = {piece: open_dataset(piece.folder)["action"].values.astype(str)[:, 0] for piece in pieces}
    there = sorted(set(np.concatenate([*actions.values()])))
    assert len(there) > 1
    learnt, judged = plan.trained["R1"][0].drawn()
    for side, wanted in ((learnt, there[0::2]), (judged, there[1::2])):
        found = {piece: positions.tolist() for each in side for piece, positions in each}
        assert found == {piece: at for piece in pieces if (at := np.flatnonzero(np.isin(actions[piece], wanted)).tolist())}

"""What is read of a file, what is refused before anything runs, and the numbers of frames of the thesis' series."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import yaml

from cabinpose.app.experiment import measure
from cabinpose.app.experiment.config import (
    Curve,
    Data,
    Experiment,
    FrameSelection,
    JudgedFrames,
    RunScale,
    TableColumn,
    Training,
    load,
    merged,
    packaged,
)
from cabinpose.app.experiment.frames import contents
from cabinpose.app.experiment.pieces import wanted_frames
from cabinpose.app.experiment.plan import ExperimentPlan, make_plan
from cabinpose.app.experiment.results import frames_of
from cabinpose.app.experiment.schedule import make_cells
from cabinpose.core.errors import ConfigError
from cabinpose.store import validated

Write = Callable[..., Path]
Run = Callable[..., Any]
# Frames learnt from, and tested, as the thesis' tables have them (RE 4.2.2, SE 5.3.2, FM 7.2), read there and not in our files.
TRAINED = {
    "re1": {"M1": 6322, "M2": 94321, "M3": 6322, "M4": 94321 + 6322, "M5": 17991, "M6": 6322, "M7": 17991 + 6322},
    "se1": {
        "R1": 900, "R2": 3600, "R3": 5400, "R4": 9900, "R5": 1800, "R6": 7200, "R7": 10800, "R8": 19800, "R9": 6946, "R10": 32146,
    },
    "fm": {"FT1": 76886, "FT2": 6946, "FT3": 83832, "FT31": 109032, "FT32": 146832, "FT33": 172032},
}  # fmt: skip
TESTED = {"re1": {"S5": 1730}, "se1": {"S3": 2636}, "fm": {"FM1": 8763, "FM2": 2644, "FM3": 11407}}
VALIDATED = {"re1": {"M1": 702}, "se1": {"R10": 900}, "fm": {"FT1": 3430, "FT2": 892, "FT3": 4322}}


def planned(name: str, scale: str, out: Path) -> ExperimentPlan:
    return make_plan(load(packaged()[name]), scale, out, {})


@pytest.mark.parametrize("name", TRAINED)
def test_the_series_have_the_thesis_numbers_of_frames(name: str, tmp_path: Path) -> None:
    plan = planned(name, "paper", tmp_path)
    assert {row: cells[0].frame_count for row, cells in plan.trained.items()} == TRAINED[name]
    assert {test: cells[0].frame_count for (_, test), cells in plan.tested.items()} == TESTED[name]
    validated = {row: sum(source.frames for source in plan.trained[row][0].validation) for row in VALIDATED[name]}
    assert validated == VALIDATED[name]


@pytest.mark.parametrize("name", [*packaged()])
def test_one_car_is_one_for_everybody_and_no_seed_is_used_twice(name: str, tmp_path: Path) -> None:
    plan = planned(name, "paper", tmp_path)
    for pieces in plan.data.values():
        if len(pieces) > 1:
            (cars,) = {piece.cars for piece in pieces}
            assert [seed for _, seed in cars] == [None]
    alike = {name for name, data in plan.experiment.data.items() if data.like}  # whose scenes are meant to be the same ones
    seeds = [piece.seed for name, pieces in plan.data.items() if name not in alike for piece in pieces]
    assert len(seeds) == len(set(seeds))


def test_a_random_car_is_another_one_for_each_person(write: Write, tmp_path: Path) -> None:
    file = write({"data": {"real": {"synth": {"scene": {"cars": ["C0003"]}}}}, "tests": {"T": {"may_share": []}}})
    plan = make_plan(load(file), "paper", tmp_path, {})
    pieces = plan.data["real"]
    assert [set(piece.cars) for piece in pieces] == [{("C0003", 3)}, {("C0003", 4)}, {("C0003", 5)}]
    make_cells(plan.made[:1], 1, lambda *_: None)
    assert contents([[(pieces[0], np.arange(2))]])["car"] == pieces[0].cars


def test_fine_tuning_has_ten_of_a_hundred_epochs(tmp_path: Path) -> None:
    """The thesis: 180 epochs, and 20."""
    cell = planned("re1", "paper", tmp_path).trained["M3"][0]
    assert cell.begins is not None
    assert (cell.begins.recipe["epochs"], cell.recipe["epochs"], cell.begins.frame_count) == (180, 20, 94321)
    assert cell.begins.key in cell.needs


@pytest.mark.parametrize("name", [*packaged()])
@pytest.mark.parametrize("scale", ["small", "paper", "0.37", "1.04"])
def test_every_file_has_the_frames_that_it_draws(name: str, scale: str, tmp_path: Path) -> None:
    plan = planned(name, scale, tmp_path)
    for data, wanted in wanted_frames(plan.experiment, plan.scale).items():
        for subjects, count in wanted.items():
            there = [p for p in plan.data[data] if not subjects or {who for who, _ in p.people} & set(subjects)]
            assert sum(piece.frames for piece in there) >= count
    keys: set[str] = set()
    for cell in plan.cells:
        assert keys.issuperset(cell.needs), f"{cell.name} comes before what it needs"
        keys.add(cell.key)


def test_real_and_synthetic_frames_keep_their_ratios(tmp_path: Path) -> None:
    """The thesis' 1:3, 1:5 and 1:10; the validation stays above the scale's least number."""
    trained = planned("se1", "small", tmp_path).trained
    counts = {row: [source.frames for source in trained[row][0].train] for row in ("R2", "R3", "R4", "R6")}
    assert counts == {"R2": [90, 270], "R3": [90, 450], "R4": [90, 900], "R6": [180, 540]}
    assert trained["R2"][0].validation[0].frames == 200


def test_a_dataset_is_like_another_but_for_its_own_keys(write: Write, tmp_path: Path) -> None:
    synth = {"noise": {"multipath": True, "blur": 0.2}, "camera": {"jitter_m": 0.0}}
    both = {"like": "base", "synth": {"noise": {"blur": None}, "scene": {"clutter": 0.5}}}
    data = {"last": {"like": "both", "frames": 7}, "both": both, "base": {"frames": 9, "seed": 5, "synth": synth}}
    found = load(write({"data": data})).data
    noise = {"multipath": True}
    assert found["base"] == Data(frames=9, seed=5, synth=synth)
    assert found["both"] == Data(like="base", frames=9, seed=5, synth=synth | {"noise": noise, "scene": {"clutter": 0.5}})
    assert found["last"] == found["both"].model_copy(update={"like": "both", "frames": 7})
    with pytest.raises(ConfigError, match="unknown dataset 'bas'"):
        load(write({"data": data | {"both": {"like": "bas"}}}))
    with pytest.raises(ConfigError, match="last is like both is like last"):
        load(write({"data": data | {"both": {"like": "last"}}}))


def test_a_folder_takes_the_place_of_all_of_a_stand_in(write: Write, tmp_path: Path) -> None:
    write()
    rows = {"R1": None, "own": {"train": [{"data": "real"}], "validation": [{"data": "real"}]}}  # and R1's published figures
    change = {"extends": "small", "data": {"real": {"folder": "ours"}}, "trainings": rows}
    (tmp_path / "own.yaml").write_text(yaml.safe_dump(change))
    found = load(tmp_path / "own.yaml")
    assert (found.data["real"], list(found.trainings), found.published) == (Data(folder=tmp_path / "ours"), ["own"], {})


def test_rows_of_a_table_take_the_same_steps(tmp_path: Path) -> None:
    for name in packaged():
        cells = [cells[0] for cells in planned(name, "small", tmp_path).trained.values()]
        samples = set()
        for cell in cells:
            stages = [cell, *filter(None, [cell.begins])]
            samples.add(sum(s.recipe["epochs"] * s.recipe["epoch_steps"] * s.recipe["batch"] for s in stages))
        assert len(samples) == 1
        assert samples.pop() >= 20_000


def test_a_scale_keeps_numbers_above_the_least() -> None:
    scale = RunScale(frames=0.1, least=200)
    assert [scale.count(frames) for frames in (6946, 900, 150)] == [695, 200, 150]
    assert [scale.count(frames, learnt=True) for frames in (6946, 900, 2700, 3)] == [695, 90, 270, 1]
    assert scale.count(20, scaled=False) == 20


def test_a_factor_keeps_the_papers_least_where_it_says_one(write: Write) -> None:
    assert load(write()).scale("0.5").least == 200
    assert load(write({"scales": {"paper": {"least": 50}}})).scale("0.5").least == 50


def test_a_column_is_of_the_rows_that_its_test_judges(write: Write, tmp_path: Path) -> None:
    """Joints and body parts in one file, each with a test of its own."""
    part = {"train": [{"data": "real", "subject": ["P1"]}], "validation": [{"data": "real", "subject": ["P2"]}]}
    parts = {**part, "recipe": {"method": "unet", "settings": None, "batch": None}}
    tests = {name: {"frames": [{"data": "real", "subject": ["P3"]}], "trainings": [row], "may_share": ["car"]}
             for name, row in (("T", "R1"), ("U", "B"))}  # fmt: skip
    columns = [{"title": "PCKh@0.5", "test": "T"}, {"title": "IoU", "test": "U", "measure": "iou"}]
    changes = {"trainings": {"B": parts}, "tests": tests, "columns": columns}
    assert set(make_plan(load(write(changes)), "paper", tmp_path, {}).tested) == {("R1", "T"), ("B", "U")}
    tests["U"]["trainings"] = ["B", "R1"]
    with pytest.raises(ConfigError, match="column IoU: iou is not measured of joints, which R1 finds"):
        make_plan(load(write(changes)), "paper", tmp_path, {})


def test_one_mapping_over_another() -> None:
    assert merged({"a": {"b": 1, "c": 2}, "d": [1]}, {"a": {"b": None, "e": 3}, "d": [2]}) == {"a": {"c": 2, "e": 3}, "d": [2]}


def test_a_file_builds_on_another(write: Write, tmp_path: Path) -> None:
    write()
    (tmp_path / "more.yaml").write_text("extends: small\ntitle: More\nscales: {paper: {repeats: 3}}\n")
    more = load(tmp_path / "more.yaml")
    assert (more.title, more.scales["paper"].repeats, more.scales["paper"].steps) == ("More", 3, 4)
    (tmp_path / "round.yaml").write_text("extends: round\n")
    with pytest.raises(ConfigError, match="too many files"):
        load(tmp_path / "round.yaml")


REFUSED: dict[str, tuple[dict[str, Any], str, str]] = {
    "a person of the test is learnt from": (
        {"tests": {"T": {"frames": [{"data": "real", "subject": ["P1"]}]}}},
        "test T and training R1 share the subject P1", "may_share: [subject] in the test",
    ),
    "a person of the test validates": (
        {"tests": {"T": {"frames": [{"data": "real", "subject": ["P2"]}]}}},
        "test T and training R1 share the subject P2", "may_share: [subject]",
    ),
    "the car of the test is learnt from": (
        {"tests": {"T": {"may_share": []}}}, "test T and training R1 share the car sedan", "may_share: [car]",
    ),
    "people who are learnt from validate": (
        {"trainings": {"R1": {"validation": [{"data": "real", "subject": ["P1"], "frames": 1}]}}},
        "training R1 and its validation share the subject P1", "may_share: [subject] in the training",
    ),
    "the first training of a tuned one is held to it as well": (
        {"trainings": {"R1": {"train": [{"data": "real", "subject": ["P3"]}], "fine_tune": {
            "train": [{"data": "real", "subject": ["P1"]}], "validation": [{"data": "real", "subject": ["P2"]}]}}}},
        "test T and training R1 share the subject P3", "may_share: [subject]",
    ),
    "too few frames": (
        {"trainings": {"R1": {"train": [{"data": "real", "subject": ["P1"], "frames": 5}]}}},
        "training R1: 5 frames of real are asked for at this scale, and the selection has 4", "ask for at most 4",
    ),
    "too few frames to learn from and to validate on": (
        {"trainings": {"R1": {"validation": [{"data": "real", "subject": ["P1"], "frames": 1}], "may_share": ["subject"]}}},
        "training R1 and its validation: 5 frames of real are asked for", "ask for at most 4",
    ),
    "an unknown dataset": (
        {"trainings": {"R1": {"train": [{"data": "reel"}]}}}, "unknown dataset 'reel'", "did you mean real?",
    ),
    "an unknown subject": (
        {"tests": {"T": {"frames": [{"data": "real", "subject": ["P4"]}]}}},
        "test T, data real: unknown subject 'P4'", "known: P1, P2, P3",
    ),
    "an unknown test": ({"columns": [{"title": "A", "test": "U"}], "published": None}, "unknown test 'U'", "known: T"),
    "an unknown column": ({"published": {"R1": {"PCK": 1.0}}}, "unknown column 'PCK'", "PCKh@0.5"),
    "an unknown training": ({"published": {"R9": {"PCKh@0.5": 1.0}}}, "unknown training 'R9'", "known: R1"),
    "an unknown key": ({"trainings": {"R1": {"frames": 3}}}, "trainings.R1.frames: unknown key", ""),
    "a recipe that says what a scale says": ({"recipe": {"epochs": 3}}, "recipe.epochs: a scale says it", "in `scales`"),
    "an unknown key of the recipe": ({"recipe": {"epoch": 3}}, "recipe of R1: epoch: unknown key", ""),
    "scenes that cannot be": (
        {"data": {"real": {"synth": {"scene": {"car": ["sedan"]}}}}}, "data.real/P1.synth: scene", "cars",
    ),
    "a column of no joint": (
        {"columns": [{"title": "A", "test": "T", "joints": "Writs"}], "published": None},
        "unknown set of joints 'Writs'", "Wrist",
    ),
    "a column of parts where joints are found": (
        {"columns": [{"title": "A", "test": "T", "measure": "iou"}], "published": None},
        "column A: iou is not measured of joints",
        "iou or person_iou of parts",
    ),
    "two columns of one title": (
        {"columns": [{"title": "A", "test": "T"}, {"title": "A", "test": "T", "measure": "auc"}], "published": None},
        "columns: 'A' and 'A' are one name", "call one of them otherwise",
    ),
    "two tests of one picture": (
        {"tests": {"a b": {"frames": [{"data": "real", "subject": ["P3"]}]}, "A-b": {"frames": [{"data": "real"}]}}},
        "tests: 'a b' and 'A-b' are one name", "call one of them otherwise",
    ),
    "two rows of one picture": (
        {"trainings": {"r1": {"train": [{"data": "real", "subject": ["P1"]}], "validation": [{"data": "real"}]}}},
        "trainings: 'R1' and 'r1' are one name", "call one of them otherwise",
    ),
    "tuning what has one epoch": (
        {"scales": {"paper": {"steps": 1}}, "trainings": {"R1": {"fine_tune": {
            "train": [{"data": "real", "subject": ["P1"]}], "validation": [{"data": "real", "subject": ["P2"]}]}}}},
        "training R1 has one epoch, and cannot be tuned", "ask for more epochs",
    ),
    "tuning what is fitted in one go": (
        {"recipe": {"method": "walks", "settings": None, "batch": None}, "trainings": {"R1": {"fine_tune": {
            "train": [{"data": "real", "subject": ["P1"]}], "validation": [{"data": "real", "subject": ["P2"]}]}}}},
        "training R1 is of walks, fitted in one go, and cannot be tuned", "leave `fine_tune` out",
    ),
    "pck of no threshold": (
        {"columns": [{"title": "A", "test": "T", "measure": "pck"}], "published": None},
        "column A: pck is within a threshold", "threshold: 10 of px",
    ),
    "a threshold of what has none": (
        {"columns": [{"title": "A", "test": "T", "measure": "auc", "threshold": 0.2}], "published": None},
        "column A: auc has no threshold", "leave threshold out",
    ),
    "no numbers of its own": (
        {"scales": {"paper": None, "small": {"epochs": 2}}}, "scales has no `paper`", "paper: {epochs: 20}",
    ),
    "a dataset of a row that there is not": (
        {"trainings": {"R1": {"train": [{"data": "rael"}]}}}, "training R1: unknown dataset 'rael'", "real",
    ),
    "extends what is no file": ({"extends": 5}, "extends: 5 names no file", "write extends: other"),
    "people that are none": (
        {"data": {"real": {"synth": {"people": [1]}}}}, "data.real/P1.synth: people", "",
    ),
    "own people that are none": (
        {"data": {"real": {"synth": {"people": {"own": 5}}}}}, "data.real/P1.synth: people.own", "",
    ),
    "changes of people that are none": (
        {"data": {"real": {"changes": {"P1": {"people": 5}}}}}, "data.real/P1.synth: people", "",
    ),
    "two sources of a dataset": ({"data": {"real": {"folder": "x"}}}, "a folder or a stand-in", "one of folder and synth"),
}  # fmt: skip


@pytest.mark.parametrize("what", REFUSED)
def test_it_is_refused_before_anything_runs(what: str, write: Write, run: Run, tmp_path: Path) -> None:
    changes, error, hint = REFUSED[what]
    done = run("experiment", "run", write(changes), "--scale", "paper", "--out", tmp_path / "out")
    assert done.code == 2
    assert error in done.err
    assert hint in done.err.partition("hint: ")[2]
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("words", "error"),
    [
        ("se9", "unknown experiment 'se9'"),
        ("se1 --scale tiny", "unknown scale 'tiny'"),
        ("se1 --scale -1", "-1 is no scale"),
        ("se1 --only R11", "unknown cell 'R11'"),
        ("se1 --data reel=x", "unknown dataset 'reel'"),
        ("se1 --data real", "--data real names no folder"),
        ("se1 --resamples -1", "cannot draw -1 resamples"),
        ("se1 --workers 0", "cannot work with 0 workers"),
        ("se1 --workers 2 --scheduler tcp://x:1", "--workers are processes of this machine"),
    ],
)
def test_words_that_name_nothing(words: str, error: str, run: Run, tmp_path: Path) -> None:
    done = run("experiment", "run", *words.split(), "--out", tmp_path / "out")
    assert (done.code, error in done.err) == (2, True), done.err


def test_all_files_are_listed_and_shown(run: Run, tmp_path: Path) -> None:
    told = run("experiment", "list")
    assert told.code == 0
    assert [line.split()[0] for line in told.out.splitlines()[1:]] == [*packaged()]
    shown = run("experiment", "show", "se1", "--out", tmp_path)
    assert shown.code == 0
    assert "R10.3 on S3" in shown.out
    assert "at this scale" not in shown.out
    assert "CPU hours expected" in shown.out.splitlines()[-1]


def test_a_damaged_record_is_none_and_a_damaged_page_is_told(write: Write, run: Run, tmp_path: Path) -> None:
    plan = make_plan(load(write()), "paper", tmp_path, {})
    for cell, text in zip(plan.cells[:2], ("", "{}"), strict=True):
        cell.folder.mkdir(parents=True)
        (cell.folder / "cell.json").write_text(text)
        assert not cell.done
    assert run("experiment", "show", write(), "--scale", "paper", "--out", tmp_path).code == 0
    (tmp_path / "experiment.json").write_text("{}")
    done = run("experiment", "report", tmp_path)
    assert (done.code, "does not say experiment" in done.err) == (2, True), done.err


def test_rows_that_are_one_stand_where_the_first_of_them_stands(write: Write, tmp_path: Path) -> None:
    row: dict[str, Any] = {"train": [{"data": "real", "subject": ["P1"]}], "validation": [{"data": "real", "subject": ["P2"]}]}
    other = merged(row, {"recipe": {"learning_rate": 0.01}})
    plan = make_plan(
        load(write({"trainings": {"R1": None, "A": row, "B": other, "C": row}, "published": None})), "paper", tmp_path, {}
    )
    assert [cell.name for cell in plan.cells][3:] == ["A", "A on T", "B", "B on T"]


def test_a_changed_row_changes_its_own_cells_alone(write: Write, tmp_path: Path) -> None:
    second: dict[str, Any] = {
        "R2": {"train": [{"data": "real", "subject": ["P1"], "frames": 3}], "validation": [{"data": "real", "subject": ["P2"]}]}
    }
    before = make_plan(load(write({"trainings": second})), "paper", tmp_path, {})
    second["R2"]["train"][0] |= {"frames": 2}
    after = make_plan(load(write({"trainings": second})), "paper", tmp_path, {})
    assert {cell.name for cell in after.cells if cell.key not in {c.key for c in before.cells}} == {"R2", "R2 on T"}
    third = make_plan(load(write({"recipe": {"learning_rate": 0.01}})), "paper", tmp_path, {})
    assert {cell.name for cell in third.cells if cell.key not in {c.key for c in before.cells}} == {"R1", "R1 on T"}


def test_the_page_has_files_of_ones_own_and_every_key(tmp_path: Path) -> None:
    page = (Path(__file__).parents[2] / "docs" / "experiments.md").read_text()
    changed, block, *_ = (each.partition("```")[0] for each in page.split("```yaml\n")[1:])
    (tmp_path / "own.yaml").write_text(changed)
    assert load(tmp_path / "own.yaml").data["real"] == Data(folder=tmp_path / "our-car")
    experiment = validated(Experiment, yaml.safe_load(block), None, hint="")
    assert experiment.trainings["tuned"].fine_tune is not None
    for keys in (Experiment, RunScale, Data, Training, JudgedFrames, TableColumn, Curve, FrameSelection):
        for name in keys.model_fields:
            assert f"`{name}`" in page or f"`{name}:" in page or f", `{name}" in page, f"{keys.__name__}.{name}"


def test_only_what_is_named_and_what_it_needs(tmp_path: Path) -> None:
    plan = planned("se1", "small", tmp_path)
    assert [cell.name for cell in plan.chosen(["R1.2"])] == ["data real", "R1.2", "R1.2 on S3"]
    assert plan.chosen(["R1.2 on S3"]) == plan.chosen(["R1.2"])
    assert all(cell in plan.chosen([cell.name]) for cell in plan.cells)
    assert [cell.name for cell in plan.chosen(["synthetic"])] == ["data synthetic"]
    assert frames_of(plan.trained["R10"][0], "synthetic") == 2520


def _in_the_laboratory(**camera: Any) -> dict[str, Any]:
    scenes = {
        "scene": {"sequence": {"frames": 12, "rate_hz": 5, "activities": ["steer", "operate"]}},
        "camera": {"jitter_m": 0.0, "jitter_deg": 0.0, **camera},
    }
    return {"data": {"real": {"lab": {"rig": {"suit_errors": {"length_error": 0.0}}}, "synth": scenes}}}


def test_a_stand_in_may_be_recorded_in_the_laboratory(write: Write, tmp_path: Path) -> None:
    """One session of all subjects, of whom each has the frames that are asked for; another rig is another dataset."""
    plan = make_plan(load(write(_in_the_laboratory())), "paper", tmp_path, {})
    (piece,) = plan.data["real"]
    assert piece.recorded == {"P1": 4, "P2": 2, "P3": 3}
    assert (piece.most(()), piece.most(("P1", "P3")), piece.people) == (9, 7, {("P1", None), ("P2", None), ("P3", None)})
    other = _in_the_laboratory()
    other["data"]["real"]["lab"]["rig"]["suit_errors"]["length_error"] = 0.01
    assert make_plan(load(write(other)), "paper", tmp_path, {}).data["real"][0].key != piece.key
    too_many = _in_the_laboratory() | {"tests": {"T": {"frames": [{"data": "real", "subject": ["P3"], "frames": 4}]}}}
    with pytest.raises(ConfigError, match="4 frames of real are asked for at this scale, and the selection has 3"):
        make_plan(load(write(too_many)), "paper", tmp_path, {})


@pytest.mark.parametrize(
    ("changes", "told"),
    [
        (_in_the_laboratory(jitter_m=0.01), "the laboratory's camera stays where it is"),
        ({"data": {"real": {"lab": {}}}}, "the laboratory records sequences in one car"),
        (
            _in_the_laboratory() | {"recipe": {"method": "unet", "settings": None, "batch": None}},
            "training R1: real is recorded in the laboratory, whose suit labels no parts",
        ),
        ({"data": {"real": {"lab": {}, "frames": None}}}, "the laboratory records one subject after the other"),
        (
            {
                "data": {
                    "real": {
                        "lab": {"rig": {"nothing": 1}},
                        **_in_the_laboratory()["data"]["real"],
                    }
                }
            },
            "",
        ),
    ],
)
def test_what_the_laboratory_cannot_record_is_refused(changes: dict[str, Any], told: str, write: Write, tmp_path: Path) -> None:
    if not told:
        changes["data"]["real"]["lab"] = {"rig": {"nothing": 1}}
        told = "nothing"
    with pytest.raises(ConfigError, match=told):
        make_plan(load(write(changes)), "paper", tmp_path, {})


def test_the_time_is_measured_of_each_recipe_once(write: Write, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Frames times a frame's, samples times a sample's; two repeats, and two people of one dataset, are of one recipe."""
    changes = {"scales": {"paper": {"steps": 4, "epochs": 2, "sample_s": 0.01, "repeats": 2}}}
    plan = make_plan(load(write(changes)), "paper", tmp_path, {})
    generated, trained = [], []

    def made(config: Any, frames: int, out: Path, **rest: Any) -> Any:
        generated.append(out)
        return SimpleNamespace(stages_ms={"render": 30.0, "sensor": 20.0})

    def sample_s(cell: Any, *rest: Any) -> float:
        trained.append(cell)
        return 0.04

    monkeypatch.setattr(measure, "generate", made)
    monkeypatch.setattr(measure, "_sample_s", sample_s)
    found = measure.measured_s(plan)
    assert (len(generated), len(trained)) == (1, 1)
    frames = {cell.name: found[cell.key] / cell.frame_count for cell in plan.made}
    assert frames == pytest.approx(dict.fromkeys(frames, 0.05))
    for cell in plan.trained["R1"]:
        assert found[cell.key] == pytest.approx(4 * cell.expected_s)

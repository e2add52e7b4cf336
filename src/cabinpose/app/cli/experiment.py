"""`cabinpose experiment`: run experiments that files describe, and compare methods as the thesis' Table 6.1 does."""

from __future__ import annotations

import sys
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

from tyro.conf import Positional

from cabinpose.app.cli.arguments import Maybe, PrintsJson, one_of, several, workers_of
from cabinpose.app.cli.output import ProgressReport, every, print_json, print_table, printable, progress
from cabinpose.app.extras import require
from cabinpose.core import ConfigError, unknown_name

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence

    from cabinpose.app.experiment.cells import ExperimentCell
    from cabinpose.app.experiment.plan import ExperimentPlan
    from cabinpose.evaluate import Report


@dataclass(frozen=True, kw_only=True)
class RunExperiment(PrintsJson):
    """Make the datasets, models and tests that a file names, and its page; what is there is not made again.

    What is wrong with the file or the frames is told before anything runs. An interrupted run goes on; it loses an epoch at most.
    """

    name: Positional[str]
    """Name of an experiment of the package, or its file (YAML)."""
    scale: str = "small"
    """Scale of the file: small, paper, or a factor on the paper's frames and steps."""
    only: Annotated[tuple[str, ...], several("CELL [CELL ...]")] = ()
    """Only these trainings, tests, datasets, or repeats (R1.2), and what they need."""
    data: Annotated[tuple[str, ...], several("NAME=FOLDER ...")] = ()
    """Folders of your own datasets in place of those that the file names."""
    out: Path = Path("experiments")
    """Folder of cells, which experiments share, and of a folder with the page of each experiment."""
    workers: Maybe[int] = None
    """Processes of this machine, each on one thread; default: one per core."""
    scheduler: Maybe[str] = None
    """Address of a running Dask cluster that makes the cells; exclusive with --workers."""
    resamples: int = 1000
    """Resamples of the bootstrap for the intervals; 0: no intervals."""


@dataclass(frozen=True, kw_only=True)
class List(PrintsJson):
    """List the experiments of the package."""


@dataclass(frozen=True, kw_only=True)
class Show(PrintsJson):
    """Say what an experiment would make at a scale: its cells, their frames, and the CPU time to expect."""

    name: Positional[str]
    """Name of an experiment of the package, or its file (YAML)."""
    scale: str = "small"
    """Scale of the file: small, paper, or a factor on the paper's frames and steps."""
    data: Annotated[tuple[str, ...], several("NAME=FOLDER ...")] = ()
    """Folders of your own datasets in place of those that the file names."""
    out: Path = Path("experiments")
    """Folder of cells, to say which of them are there."""
    measure: bool = False
    """Measure the CPU time: a few generated frames, and a few steps of training, of each distinct recipe."""


@dataclass(frozen=True, kw_only=True)
class Remake(PrintsJson):
    """Make the page of an experiment again from the cells that are there, also of one that is not finished."""

    folder: Positional[Path]
    """Folder of the page, as `experiment run` names it."""
    resamples: int = 1000
    """Resamples of the bootstrap for the intervals; 0: no intervals."""


@dataclass(frozen=True, kw_only=True)
class Compare(PrintsJson):
    """Train methods that find ITOP's joints on the same data, run them on the same frames, and set their numbers side by side.

    What a step has left in --out is not made again, so that an interrupted experiment goes on. A method is trained by a small
    recipe (networks for 20 epochs at 96x96 px), by that of --recipe, or not at all where --model gives one.
    """

    out: Path
    """Folder of the experiment: models, answers, index.html, report.json, and of each test a page and boxes.png."""
    test: Annotated[tuple[Path, ...], several("TEST [TEST ...]")]
    """Frames to compare on: datasets of scenes in a room, ITOP's files or their folder, or ITOP frames in a .npz."""
    data: Annotated[tuple[Path, ...], several("DATASET [DATASET ...]")] = ()
    """Datasets of scenes in a room to train on; of other people than those of the tests."""
    methods: Maybe[str] = None
    """Methods, with commas between; default: all of the package that find joints in images."""
    model: Annotated[tuple[str, ...], several("METHOD=MODEL ...")] = ()
    """Trained models to take: the name of a packaged one, or a file."""
    recipe: Annotated[tuple[str, ...], several("METHOD=FILE ...")] = ()
    """Configurations of training (YAML) in place of the small ones."""
    epochs: Maybe[int] = None
    """Epochs of every training, in place of the recipe's."""
    correct: Maybe[Literal["head", "torso"]] = None
    """Move the labels of ITOP's files that lie beside the person, as `import --correct` does."""
    resamples: int = 1000
    """Resamples of the bootstrap for the intervals; 0: no intervals."""


COMMAND = one_of(run=RunExperiment, list=List, show=Show, report=Remake, compare=Compare)
_KINDS = ("data", "training", "test")
_COUNTED_S = 5.0  # how often is looked how far cells are


def run(command: RunExperiment | List | Show | Remake | Compare) -> None:
    """Do what the first word says; tables go to stdout, pages to folders."""
    if isinstance(command, RunExperiment):
        _run(command)
    elif isinstance(command, List):
        _list(command)
    elif isinstance(command, Show):
        _show(command)
    elif isinstance(command, Remake):
        _report(command)
    else:
        _compare(command)


def _run(command: RunExperiment) -> None:
    import os

    from cabinpose.app.experiment.cells import DataCell, code_state
    from cabinpose.app.experiment.page import begin, is_written, refuse_other, stale, write_results
    from cabinpose.app.experiment.results import results_of
    from cabinpose.app.experiment.schedule import make_cells

    workers = workers_of(command.workers, command.scheduler, "processes of this machine") or os.cpu_count() or 1
    if command.workers is not None and command.workers < 1:
        raise ConfigError(f"cannot work with {command.workers} workers", hint="ask for at least 1 worker")
    _check_resamples(command.resamples)
    require("train")
    plan, asked = _planned(command.name, command.scale, command.data, command.out)
    folder = command.out / Path(command.name).stem.lower() / command.scale
    refuse_other(folder, asked)
    cells = plan.chosen(command.only)
    missing = [cell for cell in cells if not cell.done]
    there = [cell for cell in cells if cell.done]
    asked |= {"code": code_state(), "resamples": command.resamples}
    whole_s = round(sum(cell.expected_s for cell in cells))
    notes = [""]
    with _going_on(folder), progress(whole_s, "s of work", start=_made_s(cells)) as shown:

        def count() -> None:
            """Of cells under way too, whoever makes them: a training is minutes."""
            shown(_made_s(cells), notes[-1])

        def told(cell: ExperimentCell, record: dict[str, Any]) -> None:
            there.append(cell)
            notes.append(f"{len(there)} of {len(cells)} cells, {cell.name} made in {record['cpu_s']:.0f} CPU s")
            count()

        with every(_COUNTED_S, count):
            datasets = [cell for cell in missing if isinstance(cell, DataCell)]
            make_cells(datasets, workers, told)
            if missing:
                plan.check_frames(cells)
                begin(folder, asked)
            make_cells([cell for cell in missing if not isinstance(cell, DataCell)], workers, told)
    asked["made"] = [cell.key for cell in plan.cells if cell.done]
    if missing or not is_written(folder, asked):
        write_results(folder, plan, results_of(plan, command.resamples), asked)
    if command.as_json:
        print_json({"page": str(folder / "index.html"), "cells": len(cells), "made": len(missing)})
        return
    _tell(folder)
    if told_stale := stale(plan):
        print(told_stale, file=sys.stderr)
    print(f"{len(missing)} of {len(cells)} cells made now; open {folder / 'index.html'}", file=sys.stderr)


@contextmanager
def _going_on(folder: Path) -> Iterator[None]:
    """Tell who ends a run early that nothing is lost."""
    try:
        yield
    except KeyboardInterrupt:
        shown = f", and `cabinpose experiment report {folder}` shows it" if folder.exists() else ""
        print(f"what is made stays: the same command goes on{shown}", file=sys.stderr)
        raise


def _made_s(cells: Sequence[ExperimentCell]) -> int:
    """The CPU seconds that what there is of some cells should have taken: a test is no training."""
    return round(sum(cell.expected_s * cell.made_share for cell in cells))


def _planned(name: str, scale: str, data: tuple[str, ...], out: Path) -> tuple[ExperimentPlan, dict[str, object]]:
    """The plan of an experiment, and what was asked for, as plain data."""
    from cabinpose.app.experiment.config import find, load, packaged
    from cabinpose.app.experiment.plan import make_plan

    given = {key: Path(folder) for key, folder in _named(data, "--data", "real=FOLDER").items()}
    path = find(name)
    experiment = load(path)
    asked: dict[str, object] = {
        "file": name.lower() if path in packaged().values() else str(path.resolve()),
        "experiment": experiment.model_dump(mode="json"), "scale": scale, "out": "../..",  # of the page's folder
        "data": {key: str(folder.resolve()) for key, folder in given.items()},
    }  # fmt: skip
    return make_plan(experiment, scale, out.resolve(), given), asked


def _named(words: Sequence[str], flag: str, example: str) -> dict[str, str]:
    """{"paf": "x.onnx"} of ("paf=x.onnx",); ConfigError for other words. example: of a word, with what it names behind `=`."""
    result = {}
    for word in words:
        name, equals, value = word.partition("=")
        if not equals or not value:
            what = example.partition("=")[2].lower()
            raise ConfigError(f"{flag} {word} names no {what}", hint=f"write {flag} {example}")
        result[name] = value
    return result


def _check_resamples(resamples: int) -> None:
    if resamples < 0:
        raise ConfigError(f"cannot draw {resamples} resamples", hint="ask for some hundred, or for 0: no intervals")


def _tell(folder: Path) -> None:
    """Print the table of a page, and what is to be known before it."""
    print(printable((folder / "table.md").read_text("utf-8")), end="")


def _list(command: List) -> None:
    from cabinpose.app.experiment.config import load, packaged

    known = {name: load(path) for name, path in packaged().items()}
    if command.as_json:
        print_json({"experiments": {name: each.title for name, each in known.items()}})
        return
    print_table([["", "title", "from"], *([name, each.title, each.source] for name, each in known.items())], words=(0, 1, 2))


def _show(command: Show) -> None:
    from cabinpose.app.experiment.cells import DataCell, TestCell
    from cabinpose.app.experiment.plan import same_cells

    plan, _ = _planned(command.name, command.scale, command.data, command.out)
    cells = plan.cells
    kinds = [_KINDS[0 if isinstance(c, DataCell) else 2 if isinstance(c, TestCell) else 1] for c in cells]
    expected = {cell.key: cell.expected_s for cell in cells}
    if command.measure:
        require("train")
        from cabinpose.app.experiment.measure import measured_s

        with progress() as shown:
            expected = measured_s(plan, lambda name: shown.phase(f"measuring {name}"))
    total = sum(expected[cell.key] for cell in cells)
    left = sum(expected[cell.key] for cell in cells if not cell.done)
    if command.as_json:
        told = [
            {
                "cell": c.name,
                "kind": kind,
                "frames": c.frame_count,
                "cpu_s": expected[c.key],
                "done": c.done,
                "folder": str(c.folder),
            }
            for c, kind in zip(cells, kinds, strict=True)
        ]
        print_json({"title": plan.experiment.title, "scale": command.scale, "cells": told, "cpu_s": total, "left_cpu_s": left})
        return
    print(plan.experiment.title)
    rows = [["cell", "kind", "frames", "CPU s expected", ""]]
    for cell, kind in zip(cells, kinds, strict=True):
        took = f"there, took {cell.record['cpu_s']:.0f}" if cell.done else ""
        rows.append([cell.name, kind, str(cell.frame_count), f"{expected[cell.key]:.0f}", took])
    print_table(rows, words=(0, 1, 4))
    for name, other in same_cells([cell for each in plan.trained.values() for cell in each]).items():
        print(f"{name} is {other} at this scale")
    print(f"{len(cells)} cells, {total / 3600:.2f} CPU hours expected, {left / 3600:.2f} of them left")


def _report(command: Remake) -> None:
    from cabinpose.app.experiment.cells import code_state
    from cabinpose.app.experiment.config import Experiment
    from cabinpose.app.experiment.page import PLAN, write_results
    from cabinpose.app.experiment.plan import make_plan
    from cabinpose.app.experiment.results import results_of
    from cabinpose.store import read_mapping, validated

    _check_resamples(command.resamples)
    file = command.folder / PLAN
    if not file.exists():
        raise ConfigError(
            f"{command.folder} is no folder of an experiment's page", hint="give the one that `experiment run` names"
        )
    asked = read_mapping(file, hint="run the experiment again")
    if lacking := [key for key in ("experiment", "scale", "out", "data") if key not in asked]:
        raise ConfigError(f"{file} does not say {lacking[0]}", hint="run the experiment again")
    experiment = validated(Experiment, asked["experiment"], file, hint="run the experiment again")
    given = {name: Path(folder) for name, folder in asked["data"].items()}
    plan = make_plan(experiment, asked["scale"], (command.folder / asked["out"]).resolve(), given)
    asked |= {"code": code_state(), "resamples": command.resamples, "made": [cell.key for cell in plan.cells if cell.done]}
    write_results(command.folder, plan, results_of(plan, command.resamples), asked)
    if command.as_json:
        print_json({"page": str(command.folder / "index.html")})
        return
    _tell(command.folder)
    print(f"open {command.folder / 'index.html'}", file=sys.stderr)


def _compare(command: Compare) -> None:
    from cabinpose.app.cli.evaluate import write_boxes, write_report
    from cabinpose.app.compare import answers, judged, of_joints, open_test
    from cabinpose.app.report.comparison import comparison_html, joint_rows, table_rows
    from cabinpose.app.report.detectors import page_html
    from cabinpose.evaluate import EvaluationOptions

    methods = of_joints(own=True) if command.methods is None else [word for word in command.methods.split(",") if word]
    if not methods or len(set(methods)) < len(methods):
        raise ConfigError(f"--methods {command.methods} names no method, or one twice", hint="write --methods yolo,paf,compact")
    given, recipes = (
        _named(words, flag, f"{methods[0]}=FILE") for words, flag in ((command.model, "--model"), (command.recipe, "--recipe"))
    )
    if unknown := [name for name in (*given, *recipes) if name not in methods]:
        raise unknown_name("method", unknown[0], methods)
    options = EvaluationOptions(resamples=command.resamples)
    tests = {test.name: test for test in (open_test(path, command.out, command.correct) for path in command.test)}
    if len(tests) < len(command.test):
        raise ConfigError("two tests have the same name", hint="rename one of their files")
    models, notes = _models(command, methods, given, recipes)
    reports: dict[str, dict[str, Report]] = {}
    facts: dict[str, dict[str, Any]] = {}
    for name, test in tests.items():
        reports[name], facts[name] = {}, {}
        for method, file in models.items():
            with progress(len(test.reference.frame), "frames") as shown:
                shown.phase(f"{method} on {name}")
                found = answers(file, test, command.out / "found" / name / f"{method}.npz", shown)
            report, unmoved = judged(test, found, method, options)
            reports[name][method] = report
            facts[name][method] = {"poses_per_s": 1 / found.cpu_s, "bytes": file.stat().st_size, "within_10cm_unmoved": unmoved}
        of_test = list(reports[name].values())
        write_report(command.out / name, page_html(of_test, {}, {}), _record(reports[name], facts[name]))
        write_boxes(command.out / name, of_test)
    record = {name: _record(reports[name], facts[name]) for name in tests}
    write_report(command.out, comparison_html(reports, facts, notes), {"models": notes, "tests": record})
    if command.as_json:
        print_json({"models": notes, "tests": record})
        return
    for name, by_method in reports.items():
        print(f"{printable(name)}: {next(iter(by_method.values())).frames} frames")
        print_table(table_rows(by_method, facts[name]))
        for method, fact in facts[name].items():
            if fact["within_10cm_unmoved"] is not None:
                share = f"{fact['within_10cm_unmoved']:.1f} % within 10 cm"
                print(f"{method}, where the model puts the joints of the body, not ITOP's labels: {share}")
        print()
        print_table(joint_rows(by_method))
        print()
    print(f"open {command.out / 'index.html'}", file=sys.stderr)


def _record(reports: Mapping[str, Report], facts: Mapping[str, Any]) -> dict[str, Any]:
    return {method: facts[method] | {"report": report.to_dict()} for method, report in reports.items()}


def _models(
    command: Compare, methods: list[str], given: Mapping[str, str], recipes: Mapping[str, str]
) -> tuple[dict[str, Path], list[str]]:
    """The model file of each method, trained where none is given, and a line on each of where it is from."""
    from cabinpose.app.compare import recipe, train_model
    from cabinpose.estimate import METHODS, packaged_models

    for name in methods:
        METHODS[name]
    to_train = [name for name in methods if name not in given]
    if to_train and not command.data:
        raise ConfigError(
            f"there is nothing to train {', '.join(to_train)} on", hint="give --data DATASET, or --model METHOD=FILE for each"
        )
    if to_train:
        require("train")
    configs = {name: recipe(name, Path(recipes[name]) if name in recipes else None, command.epochs) for name in to_train}
    models, notes = {}, []
    for name in methods:
        if name in given:
            models[name] = packaged_models().get(given[name], Path(given[name]))
            notes.append(f"{name}: {given[name]}, given")
            continue
        with progress(unit="batches") as shown:
            models[name] = train_model(configs[name], command.data, command.out / "models" / name, _teller(name, shown))
        notes.append(f"{name}: trained for {configs[name].epochs} epochs on {', '.join(folder.name for folder in command.data)}")
    return models, notes


def _teller(method: str, shown: ProgressReport) -> Any:
    return lambda done, total, note: shown(done, f"of {total}, {method}, {note}")

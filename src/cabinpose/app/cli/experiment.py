"""`cabinpose experiment`: train and compare methods as the thesis' Table 6.1 does."""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

from tyro.conf import Positional, arg

from cabinpose.app.cli.arguments import Maybe, PrintsJson, several
from cabinpose.app.cli.output import ProgressReport, print_json, print_table, printable, progress
from cabinpose.app.extras import require
from cabinpose.core import ConfigError

if TYPE_CHECKING:
    from collections.abc import Mapping

    from cabinpose.evaluate import Report


@dataclass(frozen=True, kw_only=True)
class Experiment(PrintsJson):
    """Train methods that find ITOP's joints on the same data, run them on the same frames, and set their numbers side by side.

    What a step has left in --out is not made again, so that an interrupted experiment goes on. A method is trained by a small
    recipe (networks for 20 epochs at 96x96 px), by that of --recipe, or not at all where --model gives one.
    """

    name: Annotated[Positional[Literal["compare"]], arg(metavar="compare")]
    """The experiment."""
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


COMMAND = Experiment


def run(command: Experiment) -> None:
    """Train, run and judge what is not there yet; the tables go to stdout, the pages to `out`."""
    from cabinpose.app.cli.evaluate import write_boxes, write_report
    from cabinpose.app.compare import answers, judged, named, of_joints, open_test
    from cabinpose.app.report.comparison import comparison_html, joint_rows, table_rows
    from cabinpose.app.report.detectors import page_html
    from cabinpose.evaluate import EvaluationOptions

    methods = of_joints(own=True) if command.methods is None else [word for word in command.methods.split(",") if word]
    if not methods or len(set(methods)) < len(methods):
        raise ConfigError(f"--methods {command.methods} names no method, or one twice", hint="write --methods yolo,paf,compact")
    given, recipes = named(command.model, "--model", methods), named(command.recipe, "--recipe", methods)
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
    command: Experiment, methods: list[str], given: Mapping[str, str], recipes: Mapping[str, str]
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

"""`cabinpose evaluate`: predictions held against a dataset, as a table, a page and JSON."""

from __future__ import annotations

import json
import sys
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import xarray as xr

from cabinpose.app.cli.commands import Evaluate
from cabinpose.app.cli.output import ProgressReport, print_json, print_table, printable, progress, tell_failed
from cabinpose.app.cli.selection import selected
from cabinpose.app.finite import finite
from cabinpose.app.report.numbers import group_columns, interval, number, people_rows
from cabinpose.core.errors import ConfigError, DatasetError
from cabinpose.core.ports import Predictor
from cabinpose.core.pose import Visibility
from cabinpose.core.skeleton import ITOP_JOINTS
from cabinpose.estimate.remote import open_predictor
from cabinpose.evaluate.offline import check_predictions, common_joints, dataset_id, evaluate, model_name, shared_places
from cabinpose.evaluate.options import EvaluationOptions
from cabinpose.evaluate.report import Report
from cabinpose.store import open_dataset, read_manifest
from cabinpose.store.part import disk_errors
from cabinpose.store.predictions import Predictions, read_predictions


def run(command: Evaluate) -> None:
    """Evaluate every file; the table goes to stdout, the page to `out`."""
    options = _options(command)
    if command.itop_npz is not None:
        _run_itop(command, command.itop_npz, options)
        return
    if command.dataset is None or not (command.predictions or command.model):
        raise ConfigError(
            "there is nothing to evaluate", hint="give DATASET with --predictions or --model, or --itop-npz with --model"
        )
    _check_out(command)
    whole = open_dataset(command.dataset)
    files = [read_predictions(path) for path in command.predictions]
    names = (dataset_id(read_manifest(command.dataset)), command.dataset.resolve().name)
    for file in files:
        check_predictions(file, whole, names)
    models: list[Predictions | Predictor] = [*_named_apart(files, command.predictions), *map(open_predictor, command.model)]
    dataset = selected(whole, command)
    joints = common_joints(dataset, models)
    persons = command.persons or _places(dataset, models)
    frames = dataset.sizes["frame"]
    reports = []
    for model in models:
        with progress(frames, "frames") as show:

            def told(done: int, show: ProgressReport = show) -> None:
                show(done, "" if done < frames else "intervals")

            reports.append(evaluate(dataset, model, options, joints=joints, persons=persons, name=names[1], progress=told))
        tell_failed(model)
    record = {"data": str(command.dataset), "frames": frames, "joints": list(joints), "models": [r.to_dict() for r in reports]}
    if command.out is not None:
        from cabinpose.app.report.frames import frame_figures
        from cabinpose.app.report.page import page_html

        shown = dataset.sel(person=list(persons))
        typical, worst = (
            {r.model: frame_figures(shown, r, m, options, getattr(r, kind)) for r, m in zip(reports, models, strict=True)}
            for kind in ("typical", "worst")
        )
        _write(command.out, page_html(reports, typical, worst), record)
    if command.as_json:
        print_json(record)
        return
    for report in reports:
        print_report(report, everything=command.everything)
    if command.out is not None:
        print(f"open {command.out / 'index.html'}", file=sys.stderr)


def _run_itop(command: Evaluate, frames: Path, options: EvaluationOptions) -> None:
    """One model on ITOP frames, by ITOP's protocol."""
    from cabinpose.evaluate.itop import evaluate_itop, itop_summary
    from cabinpose.store.itop import as_labelled, read_itop_frames, read_itop_reference

    if len(command.model) != 1 or command.predictions or command.dataset is not None:
        raise ConfigError("ITOP frames are scored for one model", hint="give --itop-npz FILE --model NAME alone")
    model = open_predictor(command.model[0])
    if model.joints != ITOP_JOINTS or len(model.persons) != 1:
        raise ConfigError(f"{model.name} does not find ITOP's joints of one person", hint="take the model `room`")
    reference = read_itop_reference(frames)
    found = model.predict(read_itop_frames(frames)).joints_3d[:, 0]
    labelled = evaluate_itop(reference, as_labelled(found), options, model=model.name, name=frames.name)
    anatomical = evaluate_itop(reference, found, replace(options, resamples=0))  # for one number, without its interval
    within = itop_summary(anatomical)["within_10cm"]
    if command.as_json:
        print_json(itop_summary(labelled) | {"within_10cm_anatomical": within})
    else:
        print_report(labelled, everything=command.everything)
        print(f"where the model puts the joints of the body, not ITOP's labels: {within:.1f} % within 10 cm")


def _options(command: Evaluate) -> EvaluationOptions:
    return EvaluationOptions(
        min_visibility=Visibility[command.min_visibility.upper()],
        presence=command.presence,
        head=command.head,
        pck_px=command.pck_px,
        pck_m=tuple(cm / 100 for cm in command.pck_cm),
        pckh=command.pckh,
        match=command.match,
        resamples=command.resamples,
        seed=command.seed,
    )


def _check_out(command: Evaluate) -> None:
    if command.out is None or command.overwrite:
        return
    there = [name for name in ("index.html", "report.json") if (command.out / name).exists()]
    if there:
        raise DatasetError(f"{command.out} already has {' and '.join(there)}", hint="--overwrite replaces them")


def _named_apart(models: Sequence[Predictions], paths: Sequence[Path]) -> list[Predictions]:
    """The models, those that share a name told apart by their files; `ConfigError` for a file given twice."""
    for path in paths:
        if list(paths).count(path) > 1:
            raise ConfigError(f"{path} is given twice", hint="name each predictions file once")
    names = [model_name(m) for m in models]
    shared = {name for name in names if names.count(name) > 1}
    return [
        Predictions(**{**vars(m), "model": f"{m.model} ({path})"}) if m.model in shared else m
        for m, path in zip(models, paths, strict=True)
    ]


def _places(dataset: xr.Dataset, models: Sequence[Predictions | Predictor]) -> tuple[str, ...]:
    """`shared_places`; what is left out is told."""
    shared = shared_places(dataset, models)
    places = [place for place in dataset["person"].values.tolist() if place not in shared]
    left = {place: int((dataset["subject"].sel(person=place) != "").sum()) for place in places}
    if any(left.values()):
        people = ", ".join(f"{count} in {place}" for place, count in left.items() if count)
        print(f"not counted, since no model looks there: {people} (--persons counts them)", file=sys.stderr)
    return shared


def _write(folder: Path, page: str, record: dict[str, Any]) -> None:
    with disk_errors(folder):
        try:
            folder.mkdir(parents=True, exist_ok=True)
        except (FileExistsError, NotADirectoryError):
            raise DatasetError(f"{folder} is no folder", hint="give another folder with --out") from None
        (folder / "index.html").write_text(page, encoding="utf-8")
        (folder / "report.json").write_text(json.dumps(finite(record), allow_nan=False, indent=1) + "\n", encoding="utf-8")


_USUAL = (
    "PCKh@0.5 2D", "AUC of PCKh 2D", "median error 2D", "PCK@10 cm 3D", "MPJPE 3D", "median error 3D", "presence precision",
    "presence recall",
)  # fmt: skip


def print_report(report: Report, *, everything: bool) -> None:
    """The table by joint group, numbers about all joints with their intervals and denominators (the usual eight, or every one),
    and the notes.
    """
    columns = group_columns([report])
    print(f"{printable(report.model)} on {printable(report.dataset)}: {report.frames} frames, {report.people} people")
    rows = [["", *(c.title for c in columns)]]
    rows += [
        [group, *(number(report.value(c.metric, c.space, group, c.threshold)) for c in columns)] for group in report.joint_sets
    ]
    print_table(rows)
    print()
    rows = [["", "value", "95 % interval", "samples", "of what; how averaged"]]
    numbers = list(people_rows(report))
    shown = [(name, v) for name, v in numbers if everything or name in _USUAL]
    rows += [
        [name, f"{number(v)} {v.unit}".rstrip(), interval(v), str(v.samples), f"{v.denominator}; {v.average}"]
        for name, v in shown
    ]
    print_table(rows, words=(0, 4))
    if len(shown) < len(numbers):
        print(f"and {len(numbers) - len(shown)} more with --all")
    for note in report.notes:
        print(printable(note))
    print()

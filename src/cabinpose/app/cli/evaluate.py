"""`cabinpose evaluate`: compare predictions or models with a dataset: a table, a page and JSON."""

from __future__ import annotations

import json
import sys
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Annotated, Any, Literal

from tyro.conf import OmitArgPrefixes, Positional, arg

from cabinpose.app.cli.arguments import DatasetPath, Maybe, RunsModels, SelectsFrames, metres, refuse_existing, renamed, several
from cabinpose.app.cli.frames import ReadsFrames, as_dataset
from cabinpose.app.cli.output import ProgressReport, print_json, print_table, printable, progress, tell_failed
from cabinpose.app.finite import finite
from cabinpose.core import ConfigError, DatasetError, write_together
from cabinpose.evaluate import EvaluationOptions

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    import xarray as xr

    from cabinpose.core import Predictor, Segmenter
    from cabinpose.evaluate import Report
    from cabinpose.store import ClassImages, Predictions

_USUAL = (
    "PCKh@0.5 2D", "AUC of PCKh 2D", "median error 2D", "PCK@10 cm 3D", "MPJPE 3D", "median error 3D", "presence precision",
    "presence recall",
)  # fmt: skip

_OF_DATASETS = (
    "dataset", "predictions", "by", "persons", "places", "joints", "select", "splits", "split", "where", "labels", "out",
)  # fmt: skip
_OF_GROUPS = (("PCKh", "2d"), ("AUC of PCKh", "2d"), ("PCKh", "3d"), ("median error", "3d"))


@dataclass(frozen=True, kw_only=True)
class Evaluate(RunsModels, SelectsFrames, ReadsFrames):
    """Compare predictions, or models, with a dataset: a table by joint group, and with --out a page and report.json.

    Several predictions files and models are compared on the joints that all of them predict. Segmentations of body parts are
    compared with the dataset's pixel classes: IoU by part and the confusion matrix.
    """

    dataset: Annotated[Positional[DatasetPath | None], several("[DATASET]")] = None
    """Folder of the dataset, or frames with labels that are none yet: a COCO folder with 16-bit images of depth."""
    itop_npz: Maybe[Path] = None
    """ITOP frames (.npz with depth01, joints_3d, frame) to score one --model on, in place of a dataset."""
    itop_view: Literal["side", "top"] = "side"
    """Which of ITOP's cameras took the --itop-npz frames: it decides which way its labels lie off the joints."""
    predictions: Annotated[tuple[Path, ...], several("FILE [FILE ...]")] = ()
    """Predictions files (.jsonl or .parquet) or label images of body parts (.zarr), one per model."""
    model: Annotated[tuple[str, ...], several("MODEL [MODEL ...]")] = ()
    """Models to run: names of packaged models, ONNX or .npz files, or models on servers (grpc://HOST:PORT/MODEL)."""
    images: Annotated[tuple[str, ...], several("IMAGE [IMAGE ...]")] = ()
    """Images that models on servers are given, by the names of the dataset's variables: depth, amplitude, confidence, noise,
    depth_styled, labels, rgb, nir, and cloud; default: those that they list."""
    joints_from: Annotated[Maybe[str], arg(name="from", metavar="SOURCE")] = None
    """Where a lifting model gets its 2D joints: `truth` (the default: those of the dataset), a predictions file, or a model."""
    persons: Annotated[tuple[str, ...], several("SLOT [SLOT ...]")] = ()
    """Only people in these slots; default: the slots that all models predict."""
    places: Annotated[tuple[str, ...], several("PLACE=NAME [PLACE=NAME ...]")] = ()
    """Places of the dataset by the names of a model's, as in standing=driver; people in the others do not count."""
    joints: Annotated[tuple[str, ...], several("JOINT=NAME [JOINT=NAME ...]")] = ()
    """Joints of the dataset by the names of a model's, as in itop.head=head, or the set that they are taken of, as in itop; the
    others do not count."""
    by: Annotated[tuple[str, ...], several("LABEL [LABEL ...]")] = ()
    """Tables by groups of people, and the worst of them: by seat, or a label such as stature, age, sex, pov, reflectance:top.
    Numbers are in quarters of the people, or between stated edges: stature=1.6,1.75."""
    training_data: Annotated[tuple[Path, ...], several("FOLDER [FOLDER ...]")] = ()
    """Of --by: datasets that the model was trained on, for each group's share of the people there."""
    labels: Maybe[Path] = None
    """Corrected labels of the dataset, as the studio writes them (.labels.jsonl)."""
    out: Maybe[Path] = None
    """Folder for index.html, report.json, distances.csv (of each joint in each frame) and boxes.png; for body parts parts.png."""
    evaluation: OmitArgPrefixes[EvaluationOptions] = field(default_factory=EvaluationOptions)
    everything: Annotated[bool, arg(name="all")] = False
    """Print every number, not only the usual eight; the page and the JSON always hold all."""
    overwrite: bool = False
    """Replace the report in the folder."""


COMMAND = Evaluate
modernised = partial(renamed, old=MappingProxyType({"--pck-cm": ("--pck-m", metres), "--hit-cm": ("--hit-m", metres)}))


def run(command: Evaluate) -> None:
    """Evaluate all files and models; the tables go to stdout, the page to `out`."""
    options = command.evaluation
    if command.training_data and not command.by:
        raise ConfigError("--training-data is of groups", hint="say which with --by")
    if command.itop_npz is not None:
        _run_itop(command, command.itop_npz, options)
    elif command.dataset is None or not (command.predictions or command.model):
        hint = "give DATASET with --predictions or --model, or --itop-npz with --model"
        raise ConfigError("there is nothing to evaluate", hint=hint)
    else:
        with as_dataset(command.dataset, command) as folder:
            _run_dataset(command, folder, options)


def _run_dataset(command: Evaluate, folder: Path, options: EvaluationOptions) -> None:
    from cabinpose.app.cli.selection import joint_names, new_names, opened, selected
    from cabinpose.app.models import opened_models, tell_drive_side
    from cabinpose.core import Segmenter
    from cabinpose.evaluate import (  # fmt: skip
        check_predictions,
        common_joints,
        frame_distances,
        groupings,
        in_places,
        make_report,
        read_group_by,
        samples_of,
    )
    from cabinpose.store import SUFFIX, as_named, dataset_id, open_dataset, read_class_images, read_manifest, read_predictions

    refuse_existing(command.out, "index.html", "report.json", overwrite=command.overwrite)
    whole = opened(folder, command.labels)
    images = [read_class_images(path) for path in command.predictions if path.suffix == SUFFIX]
    paths = [path for path in command.predictions if path.suffix != SUFFIX]
    files = [read_predictions(path) for path in paths]
    names = (dataset_id(read_manifest(folder)), folder.resolve().name)
    answers: list[Predictions | ClassImages] = [*files, *images]
    for answer in answers:
        check_predictions(answer, whole, names)
    dataset = selected(whole, command)
    _check_labelled(dataset, folder)
    dataset = as_named(dataset, new_names(command.places, "places"), joint_names(command.joints))
    opened_now = opened_models(command.model, dataset, command.joints_from, names, command.images)
    chosen = [*files, *images, *opened_now]
    called = _names(chosen, [*map(str, paths), *(str(path) for path in command.predictions if path not in paths), *command.model])
    tell_drive_side(chosen, command.drive_side)
    segmenters = [model for model in chosen if isinstance(model, Segmenter)]
    models = [model for model in chosen if not isinstance(model, Segmenter)]
    if segmenters and models:
        raise ConfigError("joints and body parts are evaluated apart", hint="run evaluate once for each")
    if segmenters and (command.by or command.persons):
        raise ConfigError("body parts are not counted by people", hint="leave --by and --persons out")
    if segmenters:
        _run_parts(command, dataset, dict(zip(called, segmenters, strict=True)), names[1])
        return
    by, learnt = [read_group_by(word) for word in command.by], [open_dataset(path) for path in command.training_data]
    joints = common_joints(dataset, models)
    persons = command.persons or _places(dataset, models)
    in_view = in_places(dataset, persons)
    frames = dataset.sizes["frame"]
    reports, over_frames = [], {}
    for name, model in zip(called, models, strict=True):
        with progress(frames, "frames") as shown:

            def show(done: int, shown: ProgressReport = shown) -> None:
                shown(done, "" if done < frames else "intervals")

            samples, caveats = samples_of(dataset, model, options, joints=joints, persons=persons, progress=show)
            groups = groupings(samples, in_view, by, options, learnt)
            reports.append(make_report(samples, options, name, names[1], caveats, groups))
        over_frames[reports[-1].model] = {space: frame_distances(samples, space, options) for space in samples.spaces()}
        tell_failed(model)
    record = {"data": str(command.dataset), "frames": frames, "joints": list(joints), "models": [r.to_dict() for r in reports]}
    if command.out is not None:
        from cabinpose.app.report.detectors import page_html
        from cabinpose.app.report.frames import frame_figures
        from cabinpose.app.report.over_frames import write_distances

        typical, worst = (
            {r.model: frame_figures(in_view, r, m, options, getattr(r, kind)) for r, m in zip(reports, models, strict=True)}
            for kind in ("typical", "worst")
        )
        write_report(command.out, page_html(reports, typical, worst, over_frames), record)
        write_distances(command.out / "distances.csv", over_frames)
        write_boxes(command.out, reports)
    if command.as_json:
        print_json(record)
        return
    for report in reports:
        print_report(report, everything=command.everything)
    if command.out is not None:
        print(f"open {command.out / 'index.html'}", file=sys.stderr)


def _check_labelled(dataset: xr.Dataset, folder: Path) -> None:
    """Raise DatasetError for frames that came without labels; generated ones may have nobody in them."""
    if str(dataset.attrs["generator"]).startswith("import ") and not dataset["visibility"].any() and not dataset["subject"].any():
        raise DatasetError(
            f"in none of the frames of {folder.name} is anybody labelled",
            hint="import and label them (the studio's Label tab), and give --labels; `cabinpose predict` needs none",
        )


def _run_parts(command: Evaluate, dataset: xr.Dataset, models: Mapping[str, Segmenter], name: str) -> None:
    """Segmentations, by what they are called, against the dataset's pixel classes."""
    from cabinpose.app.report.parts import parts_page, pictures, write_sheet
    from cabinpose.evaluate import evaluate_parts, trained_words

    reports = []
    for called, model in models.items():
        with progress(dataset.sizes["frame"], "frames") as shown:
            told = command.evaluation
            report = evaluate_parts(dataset, model, name=name, resamples=told.resamples, seed=told.seed, progress=shown)
            reports.append(replace(report, model=called))
    record = {"data": str(command.dataset), "frames": dataset.sizes["frame"], "models": [r.to_dict() for r in reports]}
    if command.out is not None:
        typical, worst = (
            {r.model: pictures(dataset, models[r.model], getattr(r, kind)) for r in reports} for kind in ("typical", "worst")
        )
        write_report(command.out, parts_page(reports, typical, worst), record)
        if all_pictures := [each for r in reports for each in (*typical[r.model], *worst[r.model])]:
            write_sheet(command.out / "parts.png", next(iter(models.values())).parts, all_pictures)
    if command.as_json:
        print_json(record)
        return
    for report in reports:
        print(f"{printable(report.model)} on {printable(report.dataset)}: {report.frames} frames")
        if report.trained_on:
            print(trained_words(report.trained_on, report.frames))
        rows = [
            [f"{v.metric} {v.classes}", f"{v.value:.1f} %", f"{v.low:.1f} to {v.high:.1f}" if v.low == v.low else ""]
            for v in report.values
        ]
        print_table([["", "value", "95 % interval"], *rows])
        print()
    if command.out is not None:
        print(f"open {command.out / 'index.html'}", file=sys.stderr)


def _run_itop(command: Evaluate, frames: Path, options: EvaluationOptions) -> None:
    """One model on ITOP frames, by ITOP's protocol."""
    from cabinpose.core import ITOP
    from cabinpose.estimate.remote import open_predictor
    from cabinpose.evaluate import evaluate_itop, itop_summary
    from cabinpose.store import as_labelled, read_itop_frames, read_itop_reference

    if len(command.model) != 1 or any(getattr(command, name) for name in _OF_DATASETS):
        hint = "give --itop-npz FILE --model NAME alone; `cabinpose import itop` makes a dataset of ITOP's files"
        raise ConfigError("ITOP frames are scored for one model, without a page", hint=hint)
    model = open_predictor(command.model[0])
    if model.joints != ITOP.joints or len(model.persons) != 1:
        raise ConfigError(f"{model.name} does not find ITOP's joints of one person", hint="take the model `room` or `room_top`")
    reference = read_itop_reference(frames)
    found = model.predict(read_itop_frames(frames)).joints_3d[:, 0]
    labelled = evaluate_itop(reference, as_labelled(found, command.itop_view), options, model=model.name, name=frames.name)
    anatomical = evaluate_itop(reference, found, replace(options, resamples=0))  # for one number, without its interval
    within = itop_summary(anatomical)["within_10cm"]
    if command.as_json:
        print_json(itop_summary(labelled) | {"within_10cm_anatomical": within})
    else:
        print_report(labelled, everything=command.everything)
        print(f"where the model puts the joints of the body, not ITOP's labels: {within:.1f} % within 10 cm")


def _names(chosen: Sequence[Predictions | Predictor | ClassImages | Segmenter], words: Sequence[str]) -> list[str]:
    """What reports call them: by their names, with the words by which those were given that share one.

    Raises ConfigError for a word given twice.
    """
    from cabinpose.app.models import told_apart
    from cabinpose.evaluate import model_name

    for word in words:
        if words.count(word) > 1:
            raise ConfigError(f"{word} is given twice", hint="name each file and each model once")
    return told_apart([model_name(each) for each in chosen], words)


def _places(dataset: xr.Dataset, models: Sequence[Predictions | Predictor]) -> tuple[str, ...]:
    """The slots that all models predict; people in the others are counted on stderr."""
    from cabinpose.evaluate import shared_places

    shared = shared_places(dataset, models)
    places = [place for place in dataset["person"].values.tolist() if place not in shared]
    left = {place: int((dataset["subject"].sel(person=place) != "").sum()) for place in places}
    if any(left.values()):
        people = ", ".join(f"{count} in {place}" for place, count in left.items() if count)
        print(f"not counted, since no model looks there: {people} (--persons counts them)", file=sys.stderr)
    return shared


def write_report(folder: Path, page: str, record: dict[str, Any]) -> None:
    """Write a page and its numbers as index.html and report.json; DatasetError where there is no such folder."""
    if folder.exists() and not folder.is_dir():
        raise DatasetError(f"{folder} is no folder", hint="give another folder with --out")
    numbers = json.dumps(finite(record), allow_nan=False, indent=1) + "\n"
    write_together(folder, {"index.html": page, "report.json": numbers})


def write_boxes(folder: Path, reports: Sequence[Report]) -> None:
    """Write the models' box plots as boxes.png, where any of them found anything."""
    from cabinpose.app.report.detectors import box_charts
    from cabinpose.app.report.raster import write_png

    if boxes := box_charts(reports):
        write_png(folder / "boxes.png", boxes, [r.model for r in reports])


def print_report(report: Report, *, everything: bool) -> None:
    """Print the table by joint group, the numbers over all joints (the usual eight and extensions', or all), and notes."""
    from cabinpose.app.report.numbers import group_columns, grouping_rows, interval, number, people_rows, worst_words
    from cabinpose.evaluate import METRICS

    columns, caveats = group_columns([report]), report.caveats
    for explanation in caveats.explanations:
        print(printable(explanation.words))
    if caveats.explanations:
        print("(the numbers below are of the answers as they are)")
    print(f"{printable(report.model)} on {printable(report.dataset)}: {report.frames} frames, {report.people} people")
    if caveats.coverage:
        print(caveats.coverage)
    rows = [["", *(c.title for c in columns)]]
    rows += [
        [group, *(number(report.value(c.metric, c.space, group, c.threshold)) for c in columns)] for group in report.joint_sets
    ]
    print_table(rows)
    print()
    if caveats.coverage:
        print(caveats.coverage)
    numbers = list(people_rows(report))
    added = {metric.name for name, metric in METRICS.items() if name not in METRICS.names(own=True)}
    shown = [(name, v) for name, v in numbers if everything or name in _USUAL or v.metric in added]
    rows = [["", "value", "95 % interval", "samples", "of what; how averaged"]]
    rows += [
        [name, f"{number(v)} {v.unit}".rstrip(), interval(v), str(v.samples), f"{v.denominator}; {v.average}"]
        for name, v in shown
    ]
    print_table(rows, words=(0, 4))
    if len(shown) < len(numbers):
        print(f"and {len(numbers) - len(shown)} more with --all")
    for grouping in report.groupings:
        few = [c for c in columns if (c.metric, c.space) in _OF_GROUPS]
        groups = grouping_rows(grouping, few, lambda v: f"{number(v)} ({interval(v)})" if interval(v) else number(v))
        print_table([[str(cell) for cell in row] for row in groups])
        print(worst_words(grouping) + "\n")
    for note in report.notes:
        print(printable(note))
    print()

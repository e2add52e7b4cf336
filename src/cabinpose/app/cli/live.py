"""`cabinpose live`: run detectors on the frames of a camera, a recording or a dataset as they come."""

from __future__ import annotations

import json
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from tyro.conf import Positional, arg

from cabinpose.app.cli.arguments import Maybe, RunsModels, Smooths, dataset_path, placed, recording_name, several, tell_unsmoothed
from cabinpose.app.cli.interrupt import asked_to_stop
from cabinpose.app.cli.output import print_json, print_table, printable
from cabinpose.app.finite import finite
from cabinpose.core import ConfigError, RecordingError, check_output

if TYPE_CHECKING:
    from cabinpose.app.live.run import Latency, Live, LiveStatus

_REFRESH_S = 0.25
_LOG_EVERY_S = 10.0  # between lines where stderr is no terminal


@dataclass(frozen=True, kw_only=True)
class LiveCommand(RunsModels, Smooths):
    """Run detectors on frames as they come, and say how long each takes from its arrival to its joints.

    Of a camera the newest frame is taken and older ones are left out; of a dataset or a recording every frame is, unless
    --realtime. Ctrl-C ends it.
    """

    source: Annotated[Positional[str], arg(metavar="SOURCE")]
    """Dataset or `sample`, recording (FILE.mcap or FILE.mcap:SOURCE), rig (RIG.yaml or RIG.yaml:SOURCE), file of a camera (such
    as .mkv), or kind of camera, as a rig has it: simulated, or that of a vendor. A word that is none of these lists all kinds."""
    model: Annotated[tuple[str, ...], several("MODEL [MODEL ...]")] = ("in_car",)
    """Models to run, one after the other on each frame: names of packaged models, ONNX or .npz files, or models on
    servers (grpc://HOST:PORT/MODEL)."""
    images: Annotated[tuple[str, ...], several("IMAGE [IMAGE ...]")] = ()
    """Images that models on servers are given: of a camera depth, amplitude, confidence, noise and cloud, of a dataset its own;
    default: those that they list."""
    settings: Annotated[tuple[str, ...], arg(name="set", metavar="KEY=VALUE ...", help_behavior_hint="")] = ()
    """Settings of the source, as in a rig, such as use_case=MODE_9_5FPS_2000 or faults.rate_hz=30."""
    realtime: bool = False
    """Play a dataset or a recording at its own pace, leaving frames out as with a camera."""
    record: Maybe[Path] = None
    """Recording to write of what the camera says meanwhile (.mcap)."""
    predictions: Maybe[Path] = None
    """Predictions file to write (.jsonl or .parquet); of one model."""
    frames: Maybe[int] = None
    """Stop after so many frames."""
    duration: Maybe[float] = None
    """Stop after so many seconds."""
    skip_errors: bool = False
    """Count frames on which a model fails, and go on; otherwise the first ends the run."""
    overwrite: bool = False
    """Replace the predictions file."""


COMMAND = LiveCommand
modernised = partial(placed, flag="--source")


def run(command: LiveCommand) -> int:
    """Look at frames until they or the user end it; 1 where a camera was silent at the end."""
    from cabinpose.app.extras import require

    require("record")
    from cabinpose.app.live.choose import open_feed, parsed_settings
    from cabinpose.app.live.run import Live, found_record
    from cabinpose.app.models import open_detectors, tell_drive_side
    from cabinpose.store import check_new_predictions

    _check(command)
    command = replace(command, source=str(dataset_path(command.source)))
    smoothers = command.smoothers(len(command.model))
    if command.predictions is not None:
        check_output(command.predictions, parents=False)
        check_new_predictions(command.predictions, overwrite=command.overwrite)
    if command.record is not None:
        recording_name("--record", command.record)
        check_output(command.record, RecordingError, parents=False)
    settings = parsed_settings(command.settings)
    feed = open_feed(command.source, settings, realtime=command.realtime, out=command.record)
    models = open_detectors(command.model, command.images)
    tell_drive_side(models, command.drive_side)
    live = Live(feed, models, skip_errors=command.skip_errors, keep=_keeps(command, feed), smoothers=smoothers)
    with asked_to_stop("ending") as asked, _shown() as show:
        feed.start()
        until = time.monotonic() + (command.duration or float("inf"))

        def go_on() -> bool:
            return not asked() and time.monotonic() < until and live.frames != command.frames

        with _written(command, live):
            try:
                for frame, found in live.run(go_on):
                    if command.as_json:
                        print(json.dumps(finite(found_record(frame, found, live.models)), allow_nan=False), flush=True)
                    show(live)
            finally:
                feed.stop()
    status = live.status(whole=True)
    tell_unsmoothed(smoothers)
    reports = _reports(command, live)
    if command.as_json:
        print_json({"summary": asdict(status) | {"metrics": [report.to_dict() for report in reports]}})
    else:
        _print(status)
        for report in reports:
            from cabinpose.app.cli.evaluate import print_report

            print_report(report, everything=False)
    if status.feed.silent:
        print(f"error: {command.source} fell silent: {status.feed.error}", file=sys.stderr)
        print("hint: look at the camera; `cabinpose record --check` says what is missing", file=sys.stderr)
        return 1
    return 0


def _check(command: LiveCommand) -> None:
    for flag, value in (("--frames", command.frames), ("--duration", command.duration)):
        if value is not None and not value > 0:  # not a number as well
            raise ConfigError(f"{flag} {value:g} is nothing to look at", hint=f"give {flag} more than 0")
    if len(set(command.model)) != len(command.model) or not command.model:
        raise ConfigError("each model is named once", hint="--model in_car")
    if command.predictions is not None and len(command.model) > 1:
        raise ConfigError("a predictions file is of one model", hint="leave out --predictions, or name one --model")


def _keeps(command: LiveCommand, feed: Any) -> bool:
    """Whether the answers are needed after the run."""
    from cabinpose.app.live.feed import DatasetFeed

    return command.predictions is not None or isinstance(feed, DatasetFeed)


@contextmanager
def _written(command: LiveCommand, live: Live) -> Iterator[None]:
    """The predictions of what was found within the block are written at its end, also where it ends by an error after some."""
    try:
        yield
    except BaseException:
        if command.predictions is not None and live.answered(live.models[0]):
            _write_predictions(command, live)
            print(f"what was found before is in {command.predictions}", file=sys.stderr)
        raise
    if command.predictions is not None:
        _write_predictions(command, live)


def _write_predictions(command: LiveCommand, live: Live) -> None:
    from cabinpose.app.live.feed import DatasetFeed
    from cabinpose.evaluate import trained_ranges
    from cabinpose.store import dataset_id, read_manifest, write_predictions

    assert command.predictions is not None
    (model,) = live.models
    found = live.predictions(model)
    if isinstance(live.feed, DatasetFeed):
        dataset = dataset_id(read_manifest(Path(command.source)))
        found = replace(found, dataset=dataset, trained_on=trained_ranges(model, live.feed.dataset))
    write_predictions(command.predictions, found, overwrite=command.overwrite)


def _reports(command: LiveCommand, live: Live) -> list[Any]:
    """What `evaluate` says of the frames that were looked at, where the source is a dataset with people in the models' seats."""
    from cabinpose.app.live.feed import DatasetFeed
    from cabinpose.evaluate import EvaluationOptions, common_joints, evaluate, shared_places, trained_ranges

    if not isinstance(live.feed, DatasetFeed) or not live.frames:
        return []
    dataset = live.feed.dataset.isel(frame=slice(0, live.frames))
    models = [replace(live.predictions(model), trained_on=trained_ranges(model, dataset)) for model in live.models]
    joints, persons = common_joints(dataset, models), shared_places(dataset, models)
    options = EvaluationOptions(resamples=0)
    name = Path(command.source).resolve().name
    return [evaluate(dataset, model, options, joints=joints, persons=persons, name=name) for model in models]


def _print(status: LiveStatus) -> None:
    from cabinpose.core import unseen_words

    seen = status.feed.counts
    print(
        f"{status.frames} frames, {status.rate_hz:.1f} a second; "
        f"{status.feed.passed_over} left out for newer ones, {seen.lost} lost before they came, {seen.malformed} malformed"
    )
    if status.feed.setup:
        from cabinpose.record.sources.tof import described

        print(printable(f"set-up: {', '.join(described(status.feed.setup))}"))
    rows = [["ms", "p50", "p95", "p99", "failed"]]
    if status.latency is not None:
        rows.append(["arrival to joints", *_numbers(status.latency), ""])
    rows += [
        [name, *(_numbers(latency) if latency else ("", "", "")), str(status.failed[name])]
        for name, latency in status.models.items()
    ]
    print_table(rows)
    for name, causes in status.causes.items():
        for cause, count in sorted(causes.items(), key=lambda item: -item[1]):
            print(printable(f"{name} failed {count} times: {cause}"), file=sys.stderr)
    for name, reasons in status.unseen.items():
        for words in unseen_words(reasons, status.frames):
            print(printable(f"{name}: {words}"), file=sys.stderr)


def _numbers(latency: Latency) -> tuple[str, str, str]:
    return f"{latency.p50:.2f}", f"{latency.p95:.2f}", f"{latency.p99:.2f}"


def _line(status: LiveStatus) -> str:
    late = f", p95 {status.latency.p95:.1f} ms" if status.latency else ""
    trouble = f"; {status.feed.error}" if status.feed.error else ""
    return f"{status.frames} frames, {status.rate_hz:.1f}/s{late}, {status.feed.passed_over} left out{trouble}"


@contextmanager
def _shown() -> Iterator[Callable[[Live], None]]:
    """What is called after each frame: it keeps a line on a terminal up to date, and elsewhere prints one every ten seconds."""
    from rich.console import Console
    from rich.status import Status

    console = Console(stderr=True)
    every = _REFRESH_S if console.is_terminal else _LOG_EVERY_S
    told = time.monotonic()
    spinner = Status("waiting for frames", console=console) if console.is_terminal else None
    if spinner is not None:
        spinner.start()

    def show(live: Live) -> None:
        nonlocal told
        if time.monotonic() - told < every:
            return
        told = time.monotonic()
        text = _line(live.status())
        if spinner is not None:
            spinner.update(text)
        else:
            print(text, file=sys.stderr)

    try:
        yield show
    finally:
        if spinner is not None:
            spinner.stop()

"""`cabinpose adapt`: hold your own frames without labels against what a model was trained for, and fine-tune it to them."""

from __future__ import annotations

import json
import shlex
import sys
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from tyro.conf import Positional

from cabinpose.app.cli.arguments import Maybe, refuse, refuse_existing
from cabinpose.app.cli.frames import FramesArgument, ReadsFrames, as_dataset
from cabinpose.app.cli.output import print_json, print_table, printable, progress
from cabinpose.app.extras import require
from cabinpose.core import ConfigError, check_output, make_folder, write_together

if TYPE_CHECKING:
    from cabinpose.app.adapt.page import Adaptation, FirstLook
    from cabinpose.estimate import JointPredictor

_FILES = ("index.html", "report.json")
_LABELS = "pseudo-labels.jsonl"
_ADAPTED, _MADE, _RUN = "adapted.onnx", "generated", "run"
_LEARNT: Literal["both"] = "both"  # by default
_MINUTES = 3  # of the default budget
_LEAST = {"frames": 20, "epochs": 1, "look": 8, "threads": 1}


@dataclass(frozen=True, kw_only=True)
class Adapt(ReadsFrames):
    """Hold your own frames without labels against what a model was trained for, and fine-tune it to them.

    The first call takes seconds, needs no torch and says what differs: a page (index.html), the figures (report.json), and the
    answers that may stand for labels (pseudo-labels.jsonl). With --train, frames are generated as your camera would see them,
    the model learns from these and from its own sure answers, and a rule on frames that it has not learnt from says whether to
    take the result (adapted.onnx). Labels that the frames have are not learnt from: they tell the errors before and after.
    """

    model: Positional[str]
    """Name of a packaged model, or an ONNX file."""
    dataset: FramesArgument
    out: Path
    """Folder of the results."""
    train: bool = False
    """Fine-tune; needs the extra `train`."""
    learn: Literal["both", "generated", "pseudo-labels"] = _LEARNT
    """With --train: what is learnt from."""
    frames: int = 600
    """With --train: frames to generate."""
    epochs: int = 4
    """With --train: passes over the frames."""
    scenes: Maybe[Path] = None
    """With --train: scene configuration (YAML), such as of your car and the camera's place in it; sensor and noise are
    replaced."""
    noise: Maybe[Path] = None
    """With --train: configuration that `calibrate-noise` wrote of your camera; default: fitted to what stands still."""
    threads: Maybe[int] = None
    """With --train: threads of the training; default: those that torch takes."""
    seed: int = 1
    """With --train: of scenes and training."""
    rate_hz: Maybe[float] = None
    """Frames a second, of frames without times."""
    look: int = 300
    """Frames of yours that are looked at, at most, in rows."""
    reference: Maybe[Path] = None
    """Dataset of frames like those that the model was trained on; default: of models in cars the frames of the package."""
    resume: bool = False
    """Go on with what is in the folder."""
    overwrite: bool = False
    """Replace the report in the folder."""


COMMAND = Adapt


def run(command: Adapt) -> None:
    """Look, train if asked to, write the page and print what it says."""
    check_output(command.out)
    _check(command)
    with as_dataset(command.dataset, command) as folder:
        _run(command, folder)


def _check(command: Adapt) -> None:
    """What is wrong with the words, before any frame is read."""
    from cabinpose.synth import check_seed

    of_scenes = {"--scenes": command.scenes, "--noise": command.noise}
    if not command.train:
        learn = None if command.learn == _LEARNT else command.learn
        refuse({**of_scenes, "--threads": command.threads, "--learn": learn}, "{} is of --train")
    elif command.learn == "pseudo-labels":
        refuse(of_scenes, "{} is of generated frames, and --learn pseudo-labels has none")
    check_seed(command.seed)
    for name, least in _LEAST.items():
        value = getattr(command, name)
        if value is not None and value < least:
            raise ConfigError(f"--{name} {value} is too few", hint=f"give {least} or more")
    if command.rate_hz is not None and not command.rate_hz > 0:
        raise ConfigError(f"--rate-hz {command.rate_hz:g} is no rate", hint="give the frames a second, such as 30")
    refuse_existing(command.out, *_FILES, _LABELS, overwrite=command.overwrite or command.resume)
    if command.train:
        require("train")
        if not command.resume:
            refuse_existing(command.out, _MADE, _RUN, _ADAPTED, overwrite=False)


def _run(command: Adapt, folder: Path) -> None:
    """folder: of the dataset of the frames."""
    from cabinpose.app.adapt.page import adapt_page, plain
    from cabinpose.app.adapt.stages import kept_labels, looked_at, some_rows
    from cabinpose.app.finite import finite
    from cabinpose.estimate import load_model
    from cabinpose.store import dataset_id, open_dataset, read_manifest, write_predictions

    model = load_model(command.model)
    if command.train:
        from cabinpose.app.adapt.tuning import check_tunable

        check_tunable(model)
    whole = open_dataset(folder)
    dataset = whole.isel(frame=some_rows(whole, command.look)).assign_attrs(dataset_id=dataset_id(read_manifest(folder)))
    with progress(dataset.sizes["frame"], "frames") as report:
        look = looked_at(model, dataset, command.dataset.resolve().name, command.rate_hz, command.reference, report)
    outcome = _trained(command, model, look) if command.train else None
    told = finite(dict(plain(look, outcome)))
    page = {"index.html": adapt_page(look, outcome), "report.json": json.dumps(told, allow_nan=False, indent=2) + "\n"}
    make_folder(command.out)
    write_predictions(command.out / _LABELS, kept_labels(look), overwrite=True)
    write_together(command.out, page)
    if command.as_json:
        print_json({"out": str(command.out), **told})
        return
    _tell(command, look, outcome)


def _trained(command: Adapt, model: JointPredictor, look: FirstLook) -> Adaptation:
    """Generate, fine-tune, export, and hold both models against each other on the frames that judge."""
    import numpy as np

    from cabinpose.app.adapt.decision import compared_errors, decide
    from cabinpose.app.adapt.page import Adaptation
    from cabinpose.app.adapt.pseudo_labels import course_of, labelled
    from cabinpose.app.adapt.stages import by_labels, exchanged, replace_rows, scenes_for
    from cabinpose.app.adapt.tuning import Budget, generated, held_out_of, tuned
    from cabinpose.estimate import Observers, load_model
    from cabinpose.evaluate import predict_dataset
    from cabinpose.synth import SynthConfig

    budget = Budget(
        frames=command.frames, epochs=command.epochs, learn=command.learn, seed=command.seed, threads=command.threads
    )  # fmt: skip
    made, noise = None, "none were generated"
    if command.learn != "pseudo-labels":
        base, measured = (None if path is None else SynthConfig.load(path) for path in (command.scenes, command.noise))
        scenes, found_noise = scenes_for(look, base, measured, command.seed)
        noise = found_noise.words
        with progress(command.frames, "frames generated") as report:
            made = generated(scenes, budget, command.out / _MADE, look.theirs, resume=command.resume, show=report)
    part = len(look.chosen.frames)
    theirs = None
    if command.learn != "generated":
        first = replace_rows(look.found, np.arange(part))
        learnt_from = look.dataset.isel(frame=slice(part))
        theirs = labelled(learnt_from, first, look.chosen, exchanged(model, learnt_from, first))
    with ExitStack() as stack:
        report, counted = stack.enter_context(progress()), False
        report.phase("loading torch")

        def show(done: int, total: int, note: str) -> None:
            nonlocal report, counted
            if total and not counted:
                stack.close()
                report, counted = stack.enter_context(progress(total, "batches", start=done)), True
            if counted:
                report(done, note)
            else:
                report.phase(note)

        adapted = tuned(
            model, Path(command.model), (made, theirs), command.out, budget, resume=command.resume,
            observers=Observers(progress=show),
        )  # fmt: skip
    rest = np.arange(part, len(look.found.frame))
    dataset = look.dataset.isel(frame=rest)
    before = replace_rows(look.found, rest)
    new = load_model(adapted, threads=command.threads)
    after = predict_dataset(dataset, new, dataset_id=look.found.dataset)
    errors = None
    if made is not None:
        held = held_out_of(made)
        errors = compared_errors(held, predict_dataset(held, model), predict_dataset(held, new), command.seed)
    course = course_of(dataset, command.rate_hz)
    decision = decide(dataset, before, after, course, generated=errors, seed=command.seed)
    learnt = {
        "generated": command.frames if made is not None else 0,
        "pseudo-labelled": 0 if theirs is None else theirs.sizes["frame"],
    }
    words = f"{' and '.join(f'{count} {name} frames' for name, count in learnt.items() if count)}, {command.epochs} epochs"
    return Adaptation(noise, words, decision, by_labels(dataset, (before, after)))


def _tell(command: Adapt, look: FirstLook, outcome: Adaptation | None) -> None:
    """What the page says, in short, and what to do next."""
    print_table([["", "your frames", "reference", ""], *look.rows], words=(0, 3))
    chosen = look.chosen
    why = ", ".join(f"{count} {words}" for words, count in chosen.left_out.items() if count)
    print(
        f"\n{int(chosen.frames.sum())} of {len(chosen.frames)} frames may be learnt from" + (f"; left out: {why}" if why else "")
    )
    for remark in look.found.remarks:
        print(printable(remark))
    if outcome is not None:
        print()
        rows = [["", "before", "after", "difference, 95 %", ""]]
        for name, each in outcome.decision.measures.items():
            span = f"{each.low:+.2f} to {each.high:+.2f} {each.unit}" if each.frames else "too few frames"
            rows.append([name, f"{each.before:.2f}", f"{each.after:.2f}", span, each.said if each.frames else ""])
        print_table(rows, words=(0, 4))
        print(outcome.decision.words)
    print(command.out / _FILES[0])
    if outcome is not None:
        print(f"hold it against labelled frames: cabinpose evaluate DATASET --model {command.out / _ADAPTED}", file=sys.stderr)
    else:
        print(f"fine-tune to them (about {_MINUTES} CPU minutes): {_next_command(command)}", file=sys.stderr)


def _next_command(command: Adapt) -> str:
    """The same command with --train, for a shell."""
    looked = {name: getattr(command, name) for name in ("frames", "epochs", "seed", "rate_hz", "look", "reference")}
    given = command.said() | {name: value for name, value in looked.items() if value != getattr(Adapt, name)}
    words = ["cabinpose", "adapt", command.model, str(command.dataset), "--out", str(command.out)]
    for name, value in given.items():
        words += [f"--{name.replace('_', '-')}", *map(str, value if isinstance(value, tuple) else (value,))]
    return shlex.join([*words, "--train", "--resume"])

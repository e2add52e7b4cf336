"""The packaged models, trained once more, in pieces that fit into an hour: `campaign.py VERB MODEL --folder FOLDER`.

    campaign.py measure in_car --folder F           what a frame and a training sample cost here, and so the whole campaign
    campaign.py run in_car --folder F --minutes 50  goes on where it stopped: frames, then round after round of training
    campaign.py test in_car --folder F              the frozen test frames, and what the packaged model finds on them
    campaign.py ship in_car --folder F              the best weights so far beside the packaged ones, which they replace if better

What is made and trained stands in docs/models/campaign.yaml, the frozen test frames in docs/models/test-frames.yaml, the plan and
its cost in docs/models/campaign.md. FOLDER keeps frames, checkpoints and figures. What is interrupted goes on with the same
command: frames by the dataset's parts, training by its last whole epoch.
"""

from __future__ import annotations

import argparse
import csv
import json
import os
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
import torch
import yaml
from lightning.pytorch.callbacks import Callback
from pydantic import BaseModel, ConfigDict, Field

import cabinpose
from cabinpose.app.models import opened_models
from cabinpose.app.training import stored_frames
from cabinpose.app.training_split import individuals
from cabinpose.core import (
    CabinposeError,
    ConfigError,
    DatasetError,
    FrameBatch,
    Segmenter,
    Visibility,
    make_folder,
    unknown_name,
    whole_file,
)
from cabinpose.estimate import (
    JointPredictor,
    Machines,
    Observers,
    Start,
    export_onnx,
    fit,
    frame_spec,
    read_train_config,
    write_copy,
)
from cabinpose.estimate.onnx_model import OnnxModel
from cabinpose.evaluate import (
    PEOPLE,
    EvaluationOptions,
    evaluate,
    evaluate_itop,
    evaluate_parts,
    itop_summary,
    predict_dataset,
)
from cabinpose.scene.sensor import SENSORS
from cabinpose.store import (
    Predictions,
    as_labelled,
    open_dataset,
    read_itop_frames,
    read_itop_reference,
    read_mapping,
    validated,
    with_drive_side,
)

ROOT = Path(__file__).resolve().parents[1]
RECIPES, PACKAGE = ROOT / "docs" / "models", ROOT / "src" / "cabinpose" / "estimate" / "models"
FEW = 10  # batches after which it is known whether an epoch fits into the time that is left
PRESENT = 0.5  # presence of a joint at which somebody is found
_HINT = "docs/models/campaign.md says what the file holds"
_END_S = 60.0  # most that generation takes to end after it was asked to
EXCHANGED = "in another's place"
# By name: metric, space, group of joints and threshold of `Report.value`.
FIGURES: Mapping[str, tuple[str, str, str, float | None]] = {
    "PCKh@0.5 2D": ("PCKh", "2d", "All", 0.5),
    "AUC 2D": ("AUC of PCKh", "2d", "All", None),
    "wrists": ("PCKh", "2d", "Wrist", 0.5),
    "within 10 cm": ("PCK", "3d", "All", 10.0),
    "median 3D, cm": ("median error", "3d", "All", None),
    EXCHANGED: ("people found in another's place", "image", PEOPLE, None),
}
DECIDES = ("AUC 2D", "within 10 cm", "mean IoU")  # the first of them that a model has: a model without 2D answers has the second


class _Table(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)


class FrameSet(_Table):
    """Frames of `cabinpose synth`: a file of scenes beside the table, what is changed of it, how many, of which seed."""

    scenes: str
    frames: Annotated[int, Field(ge=1)]
    seed: int
    set: tuple[str, ...] = ()


class Row(_Table):
    """A row of the frozen test frames, see test-frames.yaml."""

    models: tuple[str, ...]
    frames: Annotated[int, Field(ge=1)]
    seed: int
    scenes: str = ""
    set: tuple[str, ...] = ()
    persons: tuple[str, ...] | None = None
    top_reflects_below: float | None = None
    empty: bool = False
    blind: Literal["", "nan", "wall", "hand"] = ""
    itop: Literal["", "side", "top"] = ""


class Round(_Table):
    """A run of training over some frames."""

    frames: Annotated[tuple[str, ...], Field(min_length=1)]
    epochs: Annotated[int, Field(ge=1)]
    learning_rate: float
    seed: int


class Plan(_Table):
    """How a model is trained: its recipe, whether it begins with the packaged weights, who validates, and its rounds."""

    config: str
    validate_: Annotated[str, Field(alias="validate")]
    rounds: Annotated[tuple[Round, ...], Field(min_length=1)]
    init: bool = False
    mirrored: bool = False


class Table(_Table):
    """campaign.yaml."""

    version: Literal[1]
    frames: dict[str, FrameSet]
    models: dict[str, Plan]


class Rows(_Table):
    """test-frames.yaml."""

    version: Literal[1]
    rows: dict[str, Row]


class OutOfTimeError(Exception):
    """What is begun does not fit into the time that is left."""


class Deadline(Callback):
    """When to stop.

    As a callback of training it raises OutOfTimeError once the first batches of an epoch say that it does not fit.
    """

    def __init__(self, minutes: float) -> None:
        self._end, self._began = time.monotonic() + 60 * minutes, 0.0

    @property
    def left_s(self) -> float:
        """Seconds that are left; negative when the time is over."""
        return self._end - time.monotonic()

    def on_train_epoch_start(self, *_: Any) -> None:
        """Begin to count."""
        self._began = time.monotonic()

    def on_train_batch_end(self, trainer: Any, _module: Any, _outputs: Any, _batch: Any, index: int) -> None:
        """Look whether the time is over, and once an epoch whether it will end in time; a tenth is added for validation."""
        spent_s = time.monotonic() - self._began
        whole_s = 1.1 * spent_s / (index + 1) * trainer.num_training_batches
        known = index + 1 == min(FEW, trainer.num_training_batches)
        if self.left_s < 0 or (known and whole_s > self.left_s + spent_s):
            raise OutOfTimeError(f"an epoch takes {whole_s / 60:.1f} minutes, and {max(self.left_s, 0) / 60:.1f} are left")


class Costs(Callback):
    """CPU seconds between the ends of batches."""

    def __init__(self) -> None:
        self.batches: list[float] = []

    def on_train_batch_end(self, *_: Any) -> None:
        """Note the time."""
        self.batches.append(time.process_time())


class Campaign:
    """The campaign of one model: its tables, and the folder that keeps what is made."""

    def __init__(
        self, model: str, folder: Path, *, recipes: Path = RECIPES, package: Path = PACKAGE, most: int | None = None
    ) -> None:
        """most: frames of each set at most, to try the campaign itself."""
        table = validated(Table, read_mapping(recipes / "campaign.yaml", hint=_HINT), recipes / "campaign.yaml", hint=_HINT)
        rows = validated(Rows, read_mapping(recipes / "test-frames.yaml", hint=_HINT), recipes / "test-frames.yaml", hint=_HINT)
        if model not in table.models:
            raise unknown_name("model", model, list(table.models))
        # What is tried with few frames has a folder of its own: the whole sets would be taken for them.
        self.folder = folder if most is None else folder / f"most-{most}"
        self.model, self.recipes, self.package, self.most = model, recipes, package, most
        self.plan, self.frames = table.models[model], table.frames
        self.rows = {name: row for name, row in rows.rows.items() if model in row.models}

    # ------------------------------------------------------------------------------------------------------------ frames

    def made(self, name: str, frames: FrameSet | Row, part: str, deadline: Deadline) -> Path:
        """The folder of a set of frames, made as far as it is not there. Raises OutOfTimeError where the time is over before."""
        out, count = self.folder / part / name, min(frames.frames, self.most or frames.frames)
        if _is_whole(out, count):
            return out
        make_folder(out.parent)
        command = [
            sys.executable,
            "-m",
            "cabinpose",
            "synth",
            "--config",
            str(self.recipes / frames.scenes),
            "--frames",
            str(count),
        ]
        command += ["--seed", str(frames.seed), "--out", str(out), *(["--resume"] if out.exists() else []), *frames.set]
        print(f"{name}: {count} frames", flush=True)
        process = subprocess.Popen(command, stderr=subprocess.DEVNULL, stdout=subprocess.DEVNULL)
        try:
            code = process.wait(max(deadline.left_s, 0.1))
        except subprocess.TimeoutExpired as error:
            process.send_signal(signal.SIGINT)
            process.wait(_END_S)
            raise OutOfTimeError(f"{name} is not whole yet") from error
        if code:
            raise DatasetError(f"frames of {name} cannot be made", hint=f"see: {' '.join(command[2:])}")
        return out

    # ---------------------------------------------------------------------------------------------------------- training

    def train(self, index: int, deadline: Deadline, *more: Callback) -> Path:
        """The folder of a round, trained to its end. Raises OutOfTimeError where the time is over before."""
        plan, out = self.plan.rounds[index], self.folder / self.model / f"round-{index + 1}"
        if _epochs(out) >= plan.epochs:
            return out
        sets = {name: open_dataset(self.made(name, self.frames[name], "frames", deadline)) for name in plan.frames}
        held = self.plan.validate_
        validation = {held: open_dataset(self.made(held, self.frames[held], "frames", deadline))}
        shared = set().union(*map(individuals, sets.values())) & individuals(validation[held])
        if shared:
            raise ConfigError(f"{held} shows {len(shared)} people of the training", hint="give it another seed")
        config = read_train_config(self.recipes / self.plan.config, None).model_copy(
            update={"epochs": plan.epochs, "learning_rate": plan.learning_rate, "seed": plan.seed}
        )
        training, validating = stored_frames((sets, validation), frame_spec(config))
        init = (
            self.folder / self.model / f"round-{index}" / "best.ckpt" if index else Path(self.model) if self.plan.init else None
        )
        fit(
            config, training, validating, out, start=Start(resume=(out / "last.ckpt").exists(), init=init),
            machines=Machines(1), observers=Observers(callbacks=(deadline, *more)),
        )  # fmt: skip
        return out

    def run(self, minutes: float) -> bool:
        """Go on for about so long. Returns whether all rounds are done."""
        deadline = Deadline(minutes)
        for index, plan in enumerate(self.plan.rounds):
            try:
                out = self.train(index, deadline)
            except OutOfTimeError as over:
                done = _epochs(self.folder / self.model / f"round-{index + 1}")
                print(f"round {index + 1}, {done} of {plan.epochs} epochs: {over}. Go on with the same command")
                return False
            print(f"round {index + 1} of {len(self.plan.rounds)}: {out / 'best.ckpt'}", flush=True)
        return True

    def measure(self, frames: int = 24) -> dict[str, float]:
        """CPU seconds a frame and a training sample on one thread, and CPU hours of all frames and samples of the campaign.

        A frame costs what three times as many take more; a sample the median of the batches after the first.
        """
        name, taken = self.plan.rounds[0].frames[0], []
        for count in (frames, 4 * frames):
            began = _children_s()
            small = self.frames[name].model_copy(update={"frames": count})
            self.made(name, small, f"measured-{count}", Deadline(60))
            taken.append(_children_s() - began)
        frame_s = (taken[1] - taken[0]) / (3 * frames)
        data, costs = open_dataset(self.folder / f"measured-{4 * frames}" / name), Costs()
        config = read_train_config(self.recipes / self.plan.config, None).model_copy(update={"epochs": 2, "precision": "32-true"})
        training, validating = stored_frames(({name: data}, {name: data.isel(frame=slice(4))}), frame_spec(config))
        torch.set_num_threads(1)  # those that wait for each other count as busy
        with tempfile.TemporaryDirectory() as out:
            init = Path(self.model) if self.plan.init else None
            fit(
                config, training, validating, Path(out) / "run", start=Start(init=init), machines=Machines(1),
                observers=Observers(callbacks=(costs,)),
            )  # fmt: skip
        sample_s = float(np.median(np.diff(costs.batches))) / config.batch
        distinct = {self.plan.validate_, *(name for plan in self.plan.rounds for name in plan.frames)}
        made = sum(self.frames[name].frames for name in distinct)
        samples = sum(plan.epochs * self.frames[name].frames for plan in self.plan.rounds for name in plan.frames)
        return {
            "frames": made, "CPU s a frame": frame_s, "CPU h of frames": made * frame_s / 3600, "samples": samples,
            "CPU ms a sample": 1000 * sample_s, "CPU h of training": samples * sample_s / 3600,
        }  # fmt: skip

    # ------------------------------------------------------------------------------------------------------------ figures

    def judged(self, path: Path) -> dict[str, dict[str, float]]:
        """What a model's file reaches on each row of its frozen test frames, by figure."""
        figures = {}
        for name, row in self.rows.items():
            if row.blind:
                frames = blind_frames(row.blind, min(row.frames, self.most or row.frames), rng=_rng(row.seed))
                presence = cabinpose.load_model(path).predict(frames).presence
                figures[name] = {"false people": 100.0 * float((presence >= PRESENT).any(axis=-1).mean())}
            elif row.itop:
                figures[name] = _itop_figures(path, row.itop)
            else:
                figures[name] = _figures(open_dataset(self.made(name, row, "test", Deadline(600))), path, row)
            print(f"{path.stem}, {name}: {_told(figures[name])}", flush=True)
        return figures

    def ship(self, *, anyway: bool = False) -> bool:
        """Put the best weights so far into the package with their card, if they are better. Returns whether they are."""
        rounds = [i for i in range(len(self.plan.rounds)) if (self.folder / self.model / f"round-{i + 1}" / "best.ckpt").exists()]
        if not rounds:
            raise ConfigError(f"nothing of {self.model} is trained", hint=f"campaign.py run {self.model} --folder {self.folder}")
        checkpoint = self.folder / self.model / f"round-{rounds[-1] + 1}" / "best.ckpt"
        card_file = self.recipes / f"{self.model}-card.yaml"
        card = read_mapping(card_file, hint=_HINT)
        out = self.folder / self.model / f"{self.model}.onnx"
        export_onnx(checkpoint, out, name=self.model, card=card, mirrored=self.plan.mirrored, half=True, overwrite=True)
        if OnnxModel(out).method.task == "joints":
            self._calibrate(out)
        packaged = self.package / f"{self.model}.onnx"
        before, after = self.judged(packaged), self.judged(out)
        first = next(iter(self.rows))
        decides = next(name for name in DECIDES if name in after[first])
        better = after[first][decides] > before[first].get(decides, -np.inf)
        told = {"checkpoint": checkpoint.parent.name, "decides": f"{first}, {decides}", "before": before, "after": after}
        _write(self.folder / self.model / "figures.json", json.dumps(told, indent=1))
        print(_table(before, after))
        if better or anyway:
            card |= {"figures": {row: _told(values) for row, values in after.items()}}
            card["trained"] = f"{str(card['trained']).strip()} {self._sentence(rounds)}"
            card["tested on"] = "The frozen test frames of docs/models/test-frames.yaml, row by row."
            card["command"] = f"python tools/campaign.py test {self.model} --folder FOLDER"
            write_copy(OnnxModel(out), packaged, card=card)
            _write(card_file, yaml.safe_dump(card, sort_keys=False, allow_unicode=True, width=120))
        print(f"{first}, {decides}: {before[first].get(decides, np.nan):.2f} -> {after[first][decides]:.2f}; "
              + ("in the package" if better or anyway else "the package keeps its weights"))  # fmt: skip
        return better

    def _calibrate(self, path: Path) -> None:
        """Have a model say expected errors, from the frames that validated; few of them leave it without."""
        held = self.made(self.plan.validate_, self.frames[self.plan.validate_], "frames", Deadline(600))
        command = [sys.executable, "-m", "cabinpose", "calibrate-confidence", str(held), "--model", str(path)]
        done = subprocess.run([*command, "--out", str(path), "--overwrite"], capture_output=True, text=True, check=False)
        if done.returncode:
            print(f"no expected errors: {done.stderr.strip()}", file=sys.stderr)

    def _sentence(self, rounds: Sequence[int]) -> str:
        """What the campaign has trained, for the card."""
        each = [
            f"{_epochs(self.folder / self.model / f'round-{i + 1}')} epochs over {', '.join(self.plan.rounds[i].frames)}"
            f" (learning rate {self.plan.rounds[i].learning_rate:g}, seed {self.plan.rounds[i].seed})"
            for i in rounds
        ]
        return f"Then by docs/models/campaign.yaml: {'; '.join(each)}."


def blind_frames(kind: str, count: int, *, rng: np.random.Generator) -> FrameBatch:
    """Frames (N, H, W) in which nobody can be, of the camera of the in-car models, with the amplitudes of such surfaces.

    kind: "nan", nothing measured; "wall", a bare one at an angle, 0.4 to 1.6 m away, with 5 mm of noise; "hand", at 3 to 12 cm,
    over all of the picture in every other frame, else over two thirds of it before such a wall.
    """
    camera = SENSORS["pico_monstar_105/4"].camera
    v, u = np.mgrid[: camera.height, : camera.width]
    x, y = (u - camera.cx) / camera.fx, (v - camera.cy) / camera.fy
    depth = np.full((count, camera.height, camera.width), np.nan)
    for i in range(count if kind != "nan" else 0):
        away, tilt = rng.uniform(0.4, 1.6), rng.uniform(-0.3, 0.3, 2)
        depth[i] = away / np.maximum(1 - tilt[0] * x - tilt[1] * y, 0.3)
        if kind == "hand":
            covered = np.ones(u.shape, np.bool_) if i % 2 == 0 else u < camera.width * rng.uniform(0.6, 0.75)
            depth[i][covered] = rng.uniform(0.03, 0.12)
    depth += 0.005 * rng.standard_normal(depth.shape)
    amplitude = np.nan_to_num(np.minimum(150.0 / np.maximum(depth, 0.02) ** 2, 60_000.0))
    return FrameBatch(
        depth=depth.astype(np.float32),
        camera_k=camera.k,
        camera_dist=np.array(camera.dist),
        amplitude=amplitude.astype(np.uint16),
    )


def _itop_figures(path: Path, view: Literal["side", "top"]) -> dict[str, float]:
    """The figures of a model on ITOP's real frames below the folder of CABINPOSE_REAL_DATA; {} without it.

    Joints are brought to where the labels lie (docs/itop-comparison.md); "not moved", they are not.
    """
    if not (folder := os.environ.get("CABINPOSE_REAL_DATA")):
        return {}
    file = Path(folder) / "itop" / f"itop_{'front' if view == 'side' else 'top'}_64.npz"
    reference, found = read_itop_reference(file), cabinpose.load_model(path).predict(read_itop_frames(file)).joints_3d[:, 0]
    options = EvaluationOptions(resamples=0)
    moved, still = (itop_summary(evaluate_itop(reference, joints, options)) for joints in (as_labelled(found, view), found))
    return {
        "within 10 cm": moved["within_10cm"], "not moved": still["within_10cm"], "mean 3D, cm": moved["mean_cm"],
        "frames": moved["frames"],
    }  # fmt: skip


def _figures(dataset: Any, path: Path, row: Row) -> dict[str, float]:
    """The figures of a model on a row of frames."""
    if row.top_reflects_below is not None:
        top = dataset["reflectance"].sel(person="driver", worn="top").values
        dataset = dataset.isel(frame=np.flatnonzero(top < row.top_reflects_below))
        if not dataset.sizes["frame"]:
            return {"frames": 0.0}
    dataset = with_drive_side(dataset)
    (model,) = opened_models([str(path)], dataset)
    if isinstance(model, Segmenter):
        parts = evaluate_parts(dataset, model, resamples=0)
        return {
            "mean IoU": parts.value("mean IoU"), "IoU of people": parts.value("IoU", "people"),
            "frames": float(dataset.sizes["frame"]),
        }  # fmt: skip
    found = model if isinstance(model, Predictions) else predict_dataset(dataset, model)
    persons = row.persons or tuple(p for p in found.persons if p in dataset["person"].values)
    columns = [found.persons.index(name) for name in persons]
    said = np.any(found.presence[:, columns] >= PRESENT, axis=-1)
    nobody = np.all(dataset["visibility"].sel(person=list(persons)).values == Visibility.ABSENT, axis=-1)
    values = {"false people": 100.0 * float(said[nobody].mean())} if nobody.any() else {}
    if not row.empty:
        report = evaluate(dataset, found, EvaluationOptions(resamples=0), persons=persons)
        known = {name: report.value(metric, space, joints, at) for name, (metric, space, joints, at) in FIGURES.items()}
        values = {name: float(value.value) for name, value in known.items() if value is not None} | values
    if isinstance(model, JointPredictor) and model.seats_by_place and not row.empty:
        seen = predict_dataset(dataset.drop_vars("drive_side"), model)
        metric, space, joints, at = FIGURES[EXCHANGED]
        value = evaluate(dataset, seen, EvaluationOptions(resamples=0), persons=persons).value(metric, space, joints, at)
        values |= {} if value is None else {f"{EXCHANGED}, untold": float(value.value)}
    return values | {"frames": float(dataset.sizes["frame"])}


def _table(before: Mapping[str, Mapping[str, float]], after: Mapping[str, Mapping[str, float]]) -> str:
    """Both as a table in Markdown, before → after; how many frames a row has stands once."""
    names = list(dict.fromkeys(name for row in after.values() for name in row))
    lines = [f"| | {' | '.join(names)} |", f"|---|{'---|' * len(names)}"]
    for row, values in after.items():
        both = {
            name: f"{_number(name, before[row].get(name, np.nan))} → {_number(name, value)}" for name, value in values.items()
        }
        cells = (both | {name: _number(name, value) for name, value in values.items() if name == "frames"}).get
        lines.append(f"| {row} | {' | '.join(str(cells(name, '–')) for name in names)} |")
    return "\n".join(lines)


def _told(values: Mapping[str, float]) -> str:
    return ", ".join(f"{name} {_number(name, value)}" for name, value in values.items())


def _number(name: str, value: float) -> str:
    """A figure with as many digits as it deserves."""
    digits = 0 if name == "frames" else 2 if name.endswith(", cm") else 1
    return f"{value:.{digits}f}"


def _rng(seed: int) -> np.random.Generator:
    return np.random.Generator(np.random.Philox(key=seed))


def _is_whole(folder: Path, frames: int) -> bool:
    """Whether a dataset is there with all of its frames."""
    try:
        return bool(open_dataset(folder).sizes["frame"] >= frames)
    except DatasetError:
        return False


def _epochs(out: Path) -> int:
    """Whole epochs of a run."""
    file = out / "log" / "metrics.csv"
    return len(list(csv.DictReader(file.open(encoding="utf-8")))) if file.exists() else 0


def _children_s() -> float:
    import resource

    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def _write(path: Path, text: str) -> None:
    with whole_file(path) as partial:
        partial.write_text(text, encoding="utf-8")


def main(arguments: Sequence[str] | None = None) -> int:
    """One verb of one model."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("verb", choices=("measure", "run", "test", "ship"))
    parser.add_argument("model")
    parser.add_argument("--folder", type=Path, required=True, help="keeps frames, checkpoints and figures")
    parser.add_argument("--minutes", type=float, default=50.0, help="of `run`")
    parser.add_argument("--most", type=int, help="frames of each set at most, to try the campaign itself")
    parser.add_argument("--anyway", action="store_true", help="of `ship`: into the package even if they are not better")
    parser.add_argument("--recipes", type=Path, default=RECIPES, help="folder of tables, recipes and cards")
    parser.add_argument("--package", type=Path, default=PACKAGE, help="folder of the packaged models")
    given = parser.parse_args(arguments)
    campaign = Campaign(given.model, given.folder, recipes=given.recipes, package=given.package, most=given.most)
    if given.verb == "run":
        return 0 if campaign.run(given.minutes) else 3
    if given.verb == "measure":
        print(json.dumps(campaign.measure(), indent=1))
    elif given.verb == "test":
        campaign.judged(given.package / f"{given.model}.onnx")
    else:
        return 0 if campaign.ship(anyway=given.anyway) else 1
    return 0


if __name__ == "__main__":
    try:
        sys.exit(main())
    except CabinposeError as problem:
        sys.exit(f"error: {problem}\nhint: {problem.hint}")

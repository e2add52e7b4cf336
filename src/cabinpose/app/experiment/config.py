"""The file of an experiment: its keys, how one file builds on another, and the scales that it can be run at."""

from __future__ import annotations

import copy
from collections.abc import Callable, Mapping
from importlib.resources import files
from operator import not_
from pathlib import Path
from typing import Annotated, Any, Literal, Self

from pydantic import BaseModel, ConfigDict, Field, model_validator

from cabinpose.core import ConfigError, unknown_name
from cabinpose.evaluate import Measure
from cabinpose.store import JointNames, parse_selection, read_mapping, validated

HINT = "docs/experiments.md lists the keys"
_DEPTH = 8  # files that build on each other
Positive = Annotated[int, Field(ge=1)]
Shared = Literal["subject", "car", "sequence"]


class Keys(BaseModel):
    """Base of all keys: frozen, unknown ones refused."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)


class Laboratory(Keys):
    """How the virtual laboratory records the scenes of a stand-in."""

    rig: Mapping[str, Any] = Field({}, description="Keys of a rig of `lab` that are otherwise: errors, clocks.")
    views: int = Field(24, ge=6, description="Poses of the checkerboard by which it is calibrated.")


class Data(Keys):
    """A dataset: a folder, or a stand-in that is generated."""

    like: str = Field("", exclude_if=not_, description="Another dataset of the file, which this one is but for its own keys.")
    folder: Path | None = Field(None, description="Folder of a dataset; relative to the file.")
    synth: Mapping[str, Any] | None = Field(None, description="Configuration of the scenes of a stand-in, as of `synth`.")
    lab: Laboratory | None = Field(None, description="The scenes of `synth` are recorded in the virtual laboratory.")
    seed: int = Field(0, ge=0, description="Seed of a stand-in.")
    frames: Positive | Mapping[str, Positive] | None = Field(
        None, description="Of a stand-in: in all, or by subject; left out: all of scene.factorial."
    )
    changes: Mapping[str, Mapping[str, Any]] = Field({}, description="By subject: what is otherwise in their frames' scenes.")
    stands_for: str = Field("", description="What a stand-in stands for, in words.")

    @model_validator(mode="after")
    def _one_source(self) -> Self:
        if (self.folder is None) == (self.synth is None):
            raise ConfigError("a dataset is a folder or a stand-in", hint="give one of folder and synth")
        if self.lab is not None and not isinstance(self.frames, Mapping):
            raise ConfigError("the laboratory records one subject after the other", hint="give `frames` by subject, and `synth`")
        if unknown := [name for name in self.changes if not isinstance(self.frames, Mapping) or name not in self.frames]:
            raise unknown_name("subject", unknown[0], list(self.frames) if isinstance(self.frames, Mapping) else [])
        return self


class FrameSelection(Keys):
    """Some frames of a dataset; keys such as subject/5 are folds, as in files of splits."""

    data: str = Field(description="Name of a dataset of the file.")
    frames: Positive | None = Field(None, description="How many are drawn; left out: all that the selection has.")
    scaled: bool = Field(True, description="Whether a scale changes that number.")
    subject: tuple[str, ...] = Field((), description="Everybody in the frame is one of these.")
    car: tuple[str, ...] = Field((), description="Cars.")
    action: tuple[str, ...] = Field((), description="Everybody in the frame does one of these.")
    pov: tuple[str, ...] = Field((), description="Views.")
    sequence: tuple[int, ...] = Field((), description="Sequences, by number.")
    folds: Mapping[str, tuple[int, ...]] = Field({}, exclude_if=not_, description="Folds of one of these: subject/5: [1].")
    depth: Literal["depth", "depth_styled", "depth_clean"] = Field("depth", description="The image that is read as depth.")
    places: Mapping[str, str] = Field({}, description="Places of the dataset by new names: {standing: driver}; the others go.")
    joints: JointNames = Field(
        {},
        exclude_if=not_,
        description="Joints of the dataset by new names, or their set: itop; others are not labelled.",
    )

    @model_validator(mode="before")
    @classmethod
    def _gathered(cls, data: Any) -> Any:
        """The keys of folds, which are without number, as one."""
        if not isinstance(data, Mapping) or not (own := {key: data[key] for key in data if "/" in str(key)}):
            return data
        return {**{key: value for key, value in data.items() if key not in own}, "folds": {**data.get("folds", {}), **own}}

    @model_validator(mode="after")
    def _one_of_each(self) -> Self:
        where = f"a part of {self.data}"
        for key in parse_selection(self.folds, where) if self.folds else ():
            name, folds, _ = key.partition("/")
            if not folds:
                raise ConfigError(f"{where}: folds: {name} has none", hint=f"write {name}/5: [1], without `folds`")
            if getattr(self, name):
                raise ConfigError(f"{where} has {name} and {key}", hint="give one of them")
        return self

    @property
    def selection(self) -> dict[str, tuple[Any, ...]]:
        """What the frames are selected by; see `store.frame_mask`."""
        names = ("subject", "car", "action", "pov", "sequence")
        return {name: values for name in names if (values := getattr(self, name))} | self.unknown_folds

    @property
    def unknown_folds(self) -> dict[str, tuple[int, ...]]:
        """Folds of what is known when the data are made, and not before."""
        return {key: wanted for key, wanted in self.folds.items() if not getattr(self, key.partition("/")[0])}


class FineTuning(Keys):
    """A second training that begins with the weights of the first one."""

    train: tuple[FrameSelection, ...] = Field(min_length=1, description="Frames to learn from.")
    validation: tuple[FrameSelection, ...] = Field(min_length=1, description="Frames that decide on the best epoch.")
    share: float = Field(0.1, gt=0, lt=1, description="Of the training's epochs; the first one has the rest.")


class Training(Keys):
    """A row of the tables."""

    train: tuple[FrameSelection, ...] = Field(min_length=1, description="Frames to learn from; several parts are mixed.")
    validation: tuple[FrameSelection, ...] = Field(min_length=1, description="Frames that decide on the best epoch.")
    fine_tune: FineTuning | None = Field(None, description="What follows on other frames.")
    recipe: Mapping[str, Any] = Field({}, description="Changes to the experiment's recipe.")
    may_share: tuple[Literal["subject"], ...] = Field(
        (), description="subject: other frames of people who are learnt from validate, as the thesis has it."
    )


class JudgedFrames(Keys):
    """Frames that models are judged on."""

    frames: tuple[FrameSelection, ...] = Field(min_length=1, description="The frames; several parts follow each other.")
    may_share: tuple[Shared, ...] = Field((), description="What they may share with frames of trainings.")
    trainings: tuple[str, ...] = Field((), description="Rows that are judged on them; left out: all.")


MEAN_ERRORS = ("mean_error", "root_relative_error")
"""Measures of joints that were found, whose share stands beside them; less is better."""


class TableColumn(Keys):
    """A column of the table."""

    title: str = Field(description="What stands above it.")
    test: str = Field(description="Name of a test.")
    measure: Measure = Field("pckh", description="What is measured.")
    space: Literal["2d", "3d"] = Field("2d", description="In px or in m.")
    threshold: float | None = Field(None, gt=0, description="Of pckh in head sizes, 0.5 if left out; of pck in px or m.")
    joints: str = Field("All", description="All, a group of joints, or a joint.")

    @model_validator(mode="after")
    def _threshold(self) -> Self:
        if self.measure == "pck" and self.threshold is None:
            raise ConfigError(f"column {self.title}: pck is within a threshold", hint="give threshold: 10 of px, 0.1 of m")
        if self.measure == "root_relative_error" and self.space == "2d":
            raise ConfigError(f"column {self.title}: {self.measure} is in space", hint="give space: 3d")
        if self.measure not in ("pck", "pckh") and self.threshold is not None:
            raise ConfigError(f"column {self.title}: {self.measure} has no threshold", hint="leave threshold out")
        return self


class Curve(Keys):
    """A column drawn over numbers of frames."""

    title: str = Field(description="What stands above it.")
    column: str = Field(description="Title of the column.")
    over: str = Field(description="Dataset whose training frames are counted along x.")
    lines: Mapping[str, tuple[str, ...]] = Field(description="Trainings by the name of their line.")


class RunScale(Keys):
    """How large an experiment is run."""

    frames: float = Field(1.0, gt=0, description="Factor on all numbers of frames.")
    least: Positive = Field(
        1, description="Numbers of frames to validate on and to test on that are scaled down stay above this, or as they are."
    )
    steps: Positive | None = Field(None, description="Batches of every training; left out: whole passes, `epochs` of them.")
    epochs: Positive = Field(20, description="Epochs of every training, after each of which it is validated.")
    repeats: Positive = Field(1, description="Trainings with other seeds, of each row.")
    recipe: Mapping[str, Any] = Field({}, description="Changes to the experiment's recipe.")
    sample_s: float = Field(0.1, gt=0, description="CPU seconds that a sample of training is expected to take.")

    def count(self, frames: int, scaled: bool = True, *, learnt: bool = False) -> int:
        """A number of frames at this scale; of those that are learnt from the ratios stay, whatever the least number."""
        return max(round(frames * self.frames), 1 if learnt else min(self.least, frames)) if scaled else frames


class Experiment(Keys):
    """An experiment."""

    title: str = Field(description="In a line.")
    source: str = Field("", description="Where it is from.")
    about: str = Field("", description="What is to be known of it, on its page.")
    recipe: Mapping[str, Any] = Field({}, description="Keys of a training's configuration, but epochs and seed.")
    scales: Mapping[str, RunScale] = Field({"paper": RunScale()}, description="By name; `paper` has the file's own numbers.")
    data: Mapping[str, Data] = Field(min_length=1, description="The datasets by name.")
    trainings: Mapping[str, Training] = Field(min_length=1, description="The rows by name.")
    tests: Mapping[str, JudgedFrames] = Field(min_length=1, description="The tests by name.")
    columns: tuple[TableColumn, ...] = Field(min_length=1, description="The columns of the table.")
    curves: tuple[Curve, ...] = Field((), description="Columns drawn over numbers of frames.")
    published: Mapping[str, Mapping[str, float]] = Field({}, description="Figures of the source, by training and column.")

    @model_validator(mode="after")
    def _names(self) -> Self:
        titles = [column.title for column in self.columns]
        _apart("columns", titles)
        _apart("curves", [curve.title for curve in self.curves])
        _apart("tests", list(self.tests))
        _apart("trainings", list(self.trainings))
        for name, row in self.trainings.items():
            sides: list[Training | FineTuning] = [row, *([row.fine_tune] if row.fine_tune else [])]
            for part in (part for each in sides for part in (*each.train, *each.validation)):
                _known("dataset", part.data, self.data, f"training {name}")
        for name, test in self.tests.items():
            for part in test.frames:
                _known("dataset", part.data, self.data, f"test {name}")
        for column in self.columns:
            _known("test", column.test, self.tests, f"column {column.title}")
        for curve in self.curves:
            _known("column", curve.column, titles, f"curve {curve.title}")
            _known("dataset", curve.over, self.data, f"curve {curve.title}")
            for name in (name for line in curve.lines.values() for name in line):
                _known("training", name, self.trainings)
        for name in (name for test in self.tests.values() for name in test.trainings):
            _known("training", name, self.trainings)
        judged = {name for test in self.tests.values() for name in test.trainings or self.trainings}
        if idle := [name for name in self.trainings if name not in judged]:
            raise ConfigError(f"no test judges training {idle[0]}", hint="name it in `trainings` of a test, or leave it out")
        for name, figures in self.published.items():
            _known("training", name, self.trainings)
            for title in figures:
                _known("column", title, titles)
        if "paper" not in self.scales:
            raise ConfigError("scales has no `paper`, of the file's own numbers", hint="add it: paper: {epochs: 20}")
        return self

    @property
    def parts(self) -> list[FrameSelection]:
        """Every selection of frames in the file."""
        rows: list[Training | FineTuning] = [*self.trainings.values()]
        rows += [row.fine_tune for row in self.trainings.values() if row.fine_tune]
        return [*(p for row in rows for p in (*row.train, *row.validation)), *(p for t in self.tests.values() for p in t.frames)]

    def with_parts(self, changed: Callable[[FrameSelection], FrameSelection]) -> Self:
        """The same with other selections in place of its own."""

        def sides(row: Training | FineTuning) -> dict[str, Any]:
            return {side: tuple(map(changed, getattr(row, side))) for side in ("train", "validation")}

        trainings = {
            name: row.model_copy(update={**sides(row), "fine_tune": tune and tune.model_copy(update=sides(tune))})
            for name, row in self.trainings.items()
            for tune in (row.fine_tune,)
        }
        tests = {name: test.model_copy(update={"frames": tuple(map(changed, test.frames))}) for name, test in self.tests.items()}
        return self.model_copy(update={"trainings": trainings, "tests": tests})

    def scale(self, name: str) -> RunScale:
        """The scale of a name, or the paper's with frames and batches times a factor; to validate and to test on
        never below its `least`, 200 frames if left out.

        Raises ConfigError for a name that is neither.
        """
        if name in self.scales:
            return self.scales[name]
        try:
            factor = float(name)
        except ValueError:
            raise unknown_name("scale", name, [*self.scales, "a factor, such as 0.5"]) from None
        if not 0 < factor < float("inf"):
            raise ConfigError(f"{name} is no scale", hint=f"give a number above 0, or one of: {', '.join(self.scales)}")
        paper = self.scales["paper"]
        steps = None if paper.steps is None else max(round(paper.steps * factor), 1)
        least = paper.least if "least" in paper.model_fields_set else 200
        return paper.model_copy(update={"frames": paper.frames * factor, "least": least, "steps": steps})


def file_name(name: str) -> str:
    """The part of a picture's file name that a name of a file stands for."""
    return "".join(c if c.isalnum() else "-" for c in name)


def _apart(kind: str, names: list[str]) -> None:
    """Raise ConfigError for two names that are one, in the table or as names of files where case does not count."""
    told: dict[str, str] = {}
    for name in names:
        key = file_name(name).lower() if kind != "columns" else name
        if key in told:
            raise ConfigError(f"{kind}: {told[key]!r} and {name!r} are one name", hint="call one of them otherwise")
        told[key] = name


def _known(kind: str, name: str, names: Any, where: str = "") -> None:
    if name not in names:
        error = unknown_name(kind, name, list(names))
        raise ConfigError(f"{where}: {error}" if where else str(error), hint=error.hint)


def packaged() -> dict[str, Path]:
    """The files of the package by the name of their experiment."""
    folder = files("cabinpose.app.experiment") / "experiments"
    found = sorted(Path(str(path)) for path in folder.iterdir())
    return {path.stem: path for path in found if path.suffix == ".yaml" and not path.name.startswith("_")}


def find(name: str) -> Path:
    """The file that a name or a path stands for. Raises ConfigError where there is none."""
    known = packaged()
    path = known.get(name.lower(), Path(name))
    if path.suffix not in (".yaml", ".yml"):
        raise unknown_name("experiment", name, list(known))
    return path


def load(path: Path) -> Experiment:
    """Read and check a file. Raises ConfigError that names the key."""
    whole = _mapping(path, _DEPTH)
    data = whole.get("data")
    if isinstance(data, dict):
        whole["data"] = {name: _as_like(name, data, ()) for name in data}
    return validated(Experiment, whole, path, hint=HINT)


def _as_like(name: str, data: Mapping[str, Any], before: tuple[str, ...]) -> Any:
    """A dataset's keys, over those of the one that it is like. Raises ConfigError for one that is not there, and for a circle."""
    own = data[name]
    other = own.get("like") if isinstance(own, dict) else None
    if not isinstance(other, str):
        return own  # which is refused if it is no mapping, or names no dataset
    _known("dataset", other, data)
    if name in before:
        raise ConfigError(f"data.{name}: like: {' is like '.join((*before, name))}", hint="end the circle")
    base = _as_like(other, data, (*before, name))
    return merged(base, own) if isinstance(base, dict) else own


def _mapping(path: Path, depth: int) -> dict[str, Any]:
    """What a file says, laid over what it extends; folders relative to it."""
    data = read_mapping(path, hint=HINT)
    for each in _mapping_of(data, "data").values():
        if isinstance(each, dict) and isinstance(each.get("folder"), str):
            each["folder"] = str(path.absolute().parent / each["folder"])
    bases = data.pop("extends", None) or []
    if not isinstance(bases, (str, list)) or not all(isinstance(base, str) for base in bases):
        raise ConfigError(f"{path}: extends: {bases} names no file", hint="write extends: other, or extends: [one, other]")
    if bases and not depth:
        raise ConfigError(f"{path} builds on too many files", hint="leave out `extends`, or end the circle")
    whole: dict[str, Any] = {}
    for base in [bases] if isinstance(bases, str) else bases:
        beside = path.parent / (base if base.endswith((".yaml", ".yml")) else f"{base}.yaml")
        whole = merged(whole, _mapping(beside if beside.exists() else find(base), depth - 1))
    for name, each in _mapping_of(data, "data").items():
        if isinstance(each, dict) and "folder" in each:
            _mapping_of(whole, "data").pop(name, None)  # nothing of a stand-in is true of the folder in its place
    for name, row in _mapping_of(data, "trainings").items():
        if row is None:
            _mapping_of(whole, "published").pop(name, None)
    return merged(whole, data)


def _mapping_of(data: Mapping[str, Any], key: str) -> dict[str, Any]:
    """A key that is a mapping where the file is right."""
    found = data.get(key)
    return found if isinstance(found, dict) else {}


def merged(base: Mapping[str, Any], change: Mapping[str, Any]) -> dict[str, Any]:
    """A mapping with the keys of another one in place of its own, and mappings within it likewise; null takes a key away."""
    result = copy.deepcopy(dict(base))
    for name, value in change.items():
        if value is None:
            result.pop(name, None)
        elif isinstance(value, Mapping) and isinstance(result.get(name), Mapping):
            result[name] = merged(result[name], value)
        else:
            result[name] = copy.deepcopy(value)
    return result

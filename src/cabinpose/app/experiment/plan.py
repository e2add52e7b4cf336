"""From the file of an experiment to its cells: what each depends on, its key, and what is refused before anything runs."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from cabinpose.app.experiment.cells import DataCell, ExperimentCell, TestCell, TrainCell
from cabinpose.app.experiment.config import Experiment, FrameSelection, RunScale, Training, merged
from cabinpose.app.experiment.frames import Drawn, SelectedFrames, check_subjects, contents, dealt_out, opened
from cabinpose.app.experiment.pieces import DatasetPiece, digest, needed, pieces_of, wanted_frames
from cabinpose.app.training_split import said_of
from cabinpose.core import CABINPOSE, ConfigError, unknown_name
from cabinpose.estimate import METHODS, ArrayMethod, TrainConfig
from cabinpose.evaluate import ALL, ModelErrors
from cabinpose.store import validated

FRAME_S = 0.1  # CPU seconds that a generated frame is expected to take
RECORDED_S = 0.25  # and one that the virtual laboratory records
JUDGED_S = 0.02  # and one that a model answers for
_NAMES = 5  # of people in a message
_ITS_VALIDATION = "its validation", "may_share: [subject] in the training"


@dataclass(frozen=True)
class ExperimentPlan:
    """The cells of an experiment at a scale.

    data: the pieces of each dataset that any cell needs · trained: by training, a cell for each repeat · tested: by training and
    test that judges it, likewise.
    """

    experiment: Experiment
    scale: RunScale
    data: Mapping[str, tuple[DatasetPiece, ...]]
    made: tuple[DataCell, ...]
    trained: Mapping[str, tuple[TrainCell, ...]]
    tested: Mapping[tuple[str, str], tuple[TestCell, ...]]

    @property
    def cells(self) -> list[ExperimentCell]:
        """All cells, each once, none before those that it needs; a row's tests before the next row, so that its numbers are."""
        found: dict[str, ExperimentCell] = {cell.key: cell for cell in self.made}
        for row, cells in self.trained.items():
            first = [cell.begins for cell in cells if cell.begins is not None]
            tests = [cell for (of, _), tested in self.tested.items() if of == row for cell in tested]
            for cell in [*first, *cells, *tests]:
                found.setdefault(cell.key, cell)
        return list(found.values())

    def chosen(self, only: Sequence[str]) -> list[ExperimentCell]:
        """The cells of some trainings, tests or datasets by name ("R1", its second repeat "R1.2", "real"), or by their own
        ("R1.2 on S3", "data real/P1"), with what they need.

        Raises ConfigError for a name that none has; no names: all.
        """
        if not only:
            return self.cells
        named: dict[str, list[ExperimentCell]] = {}
        for made in self.made:
            named.setdefault(made.piece.name, []).append(made)
            named.setdefault(made.piece.name.partition("/")[0], []).append(made)
        for (row, test), judged in self.tested.items():
            for number, each in enumerate(judged, 1):
                for name in (row, test, f"{row}.{number}"):
                    named.setdefault(name, []).append(each)
        for cell in self.cells:
            named.setdefault(cell.name, []).append(cell)
        wanted: set[str] = set()
        for name in dict.fromkeys(only):
            if name not in named:
                raise unknown_name("cell", name, list(named))
            wanted |= {cell.key for cell in named[name]}
        cells = self.cells
        for cell in reversed(cells):
            if cell.key in wanted:
                wanted.update(cell.needs)
        return [cell for cell in cells if cell.key in wanted]

    def check_frames(self, cells: Iterable[ExperimentCell]) -> None:
        """Refuse trainings and tests, among cells whose datasets are there, by their very frames, places and images of depth.

        Raises ConfigError, and DatasetError for what a dataset does not have.
        """
        keys = {cell.key for cell in cells}
        seen: dict[str, Any] = {}
        for (row, test), cells_of in self.tested.items():
            cell = next((each for each in cells_of if each.key in keys), None)  # repeats have the same frames
            if cell is None:
                continue
            trained = [cell.trained, *filter(None, [cell.trained.begins])]
            there = _contents(cell.frames, cell.drawn(), cell.trained, f"test {test}", learnt=False)
            seen.setdefault(test, there)
            for each in trained:
                if each.key not in seen:
                    learnt, judged = (
                        _contents(sources, drawn, each, f"training {each.name}")
                        for sources, drawn in zip((each.train, each.validation), each.drawn(), strict=True)
                    )
                    if "subject" not in self.experiment.trainings[row].may_share:
                        _refuse_shared("subject", learnt["subject"] & judged["subject"], f"training {row}", *_ITS_VALIDATION)
                    seen[each.key] = {kind: learnt[kind] | judged[kind] for kind in learnt}
                for kind, shown in seen[test].items():
                    if kind not in self.experiment.tests[test].may_share:
                        _refuse_shared(kind, shown & seen[each.key][kind], f"test {test}", f"training {row}")


def make_plan(experiment: Experiment, scale_name: str, out: Path, given: Mapping[str, Path]) -> ExperimentPlan:
    """The plan of an experiment.

    Parameters
    ----------
    experiment
        The file.
    scale_name
        Name of a scale, or a factor.
    out
        Folder in which cells are kept.
    given
        Folders of the user's in place of datasets, by name.

    Raises
    ------
    ConfigError
        For names that do not exist, too few frames, and people or cars that a test shares with a training.
    """
    for name in given:
        if name not in experiment.data:
            raise unknown_name("dataset", name, list(experiment.data))
    scale = experiment.scale(scale_name)
    folded = {part.data for part in experiment.parts if part.folds}
    whole = {name: pieces_of(name, experiment.data[name], scale, {}, given.get(name), out) for name in folded}
    experiment = experiment.with_parts(lambda part: dealt_out(part, whole[part.data]) if part.folds else part)
    wanted = wanted_frames(experiment, scale)
    data = {name: pieces_of(name, each, scale, wanted[name], given.get(name), out) for name, each in experiment.data.items()}
    plan = _Planner(experiment, scale, data, out)
    rows = {name: plan.training(name, row) for name, row in experiment.trainings.items()}
    trained = {name: tuple(cells) for name, (_, cells) in rows.items()}
    _check_columns(experiment, {name: cells[0] for name, cells in trained.items()})
    first = [cell for before, _ in rows.values() for cell in before]
    tested = {
        (row, name): tuple(plan.test(name, cell) for cell in cells)
        for row, cells in trained.items()
        for name, test in experiment.tests.items()
        if not test.trainings or row in test.trainings
    }
    every = [cell for cells in (*trained.values(), *tested.values(), first) for cell in cells]
    needed = {key for cell in every for key in cell.needs}
    used = {name: tuple(piece for piece in pieces if piece.key in needed or not piece.config) for name, pieces in data.items()}
    made = tuple(plan.made(piece) for pieces in used.values() for piece in pieces if piece.config)
    return ExperimentPlan(experiment, scale, used, made, trained, tested)


class _Planner:
    """What makes the cells of one experiment."""

    def __init__(self, experiment: Experiment, scale: RunScale, data: Mapping[str, tuple[DatasetPiece, ...]], out: Path) -> None:
        self._experiment, self._scale, self._data, self._out = experiment, scale, data, out

    def made(self, piece: DatasetPiece) -> DataCell:
        """The cell that generates a stand-in; its record lies beside the dataset."""
        folder = self._out / "made" / piece.key
        expected_s = piece.frames * (RECORDED_S if piece.recorded else FRAME_S)
        return DataCell(f"data {piece.name}", piece.key, folder, (), expected_s, piece)

    def training(self, name: str, row: Training) -> tuple[list[TrainCell], list[TrainCell]]:
        """The cells of a row, one a repeat, and those that come before them where it is tuned."""
        tune = row.fine_tune
        self._check_sides(name, row.train, row.validation, row.may_share)
        if tune is not None:
            self._check_sides(name, tune.train, tune.validation, row.may_share)
        before, cells = [], []
        for number in range(1, self._scale.repeats + 1):
            config = self._config(name, row, number)
            told = name if self._scale.repeats == 1 else f"{name}.{number}"
            if tune is None:
                cells.append(self._train(told, config, row.train, row.validation))
                continue
            if config.epochs < 2 or isinstance(METHODS[config.method], ArrayMethod):
                why = "has one epoch" if config.epochs < 2 else f"is of {config.method}, fitted in one go"
                hint = "leave `fine_tune` out, or ask for more epochs"
                raise ConfigError(f"training {name} {why}, and cannot be tuned", hint=hint)
            last = min(max(round(config.epochs * tune.share), 1), config.epochs - 1)
            early = config.model_copy(update={"epochs": config.epochs - last})
            before.append(self._train(f"{told}, first", early, row.train, row.validation))
            late = config.model_copy(update={"epochs": last})
            cells.append(self._train(told, late, tune.train, tune.validation, before[-1]))
        return before, cells

    def test(self, name: str, trained: TrainCell) -> TestCell:
        """The cell that judges a model."""
        test = self._experiment.tests[name]
        where = f"test {name}"
        sources = tuple(self._source(part, where) for part in test.frames)
        _check_labelled(sources, trained.recipe["method"], where)
        learnt = [s for each in (trained, trained.begins) if each is not None for s in (*each.train, *each.validation)]
        for kind in ("subject", "car"):
            if kind not in test.may_share:
                here, there = (
                    set().union(*((s.people if kind == "subject" else s.cars) for s in side)) for side in (sources, learnt)
                )
                _refuse_shared(kind, here & there, where, f"training {trained.name}")
        slots = tuple(METHODS[trained.recipe["method"]].settings(trained.recipe["settings"]).slots)
        facts = {"trained": trained.key, "frames": [s.facts for s in sources], "slots": slots, "kept": ModelErrors._fields}
        key = digest(facts)
        told, frames = f"{trained.name} on {name}", sum(s.frames for s in sources)
        return TestCell(
            told, key, self._out / "tested" / key, (trained.key, *_made(sources)), frames * JUDGED_S, trained, sources, slots
        )

    def _train(
        self,
        name: str,
        config: TrainConfig,
        train: Sequence[FrameSelection],
        validation: Sequence[FrameSelection],
        begins: TrainCell | None = None,
    ) -> TrainCell:
        learnt = tuple(self._source(part, f"training {name}", learnt=True) for part in train)
        judged = tuple(self._source(part, f"training {name}") for part in validation)
        _check_labelled((*learnt, *judged), config.method, f"training {name}")
        frames, held = (sum(source.frames for source in side) for side in (learnt, judged))
        recipe = config.model_dump(mode="json")
        facts = {"recipe": recipe, "train": [s.facts for s in learnt], "validation": [s.facts for s in judged]}
        key = digest(facts | ({} if begins is None else {"begins": begins.key}))
        samples = config.epochs * (config.batch * config.epoch_steps if config.epoch_steps else frames)
        expected = samples * self._scale.sample_s + config.epochs * held * self._scale.sample_s / 3  # forwards alone
        needs = (*((begins.key,) if begins else ()), *_made((*learnt, *judged)))
        folder = self._out / "trained" / f"{config.method}-{key}"  # by its key: other rows and files may name it otherwise
        return TrainCell(name, key, folder, needs, expected, recipe, learnt, judged, begins)

    def _source(self, part: FrameSelection, where: str, *, learnt: bool = False) -> SelectedFrames:
        count = None if part.frames is None else self._scale.count(part.frames, part.scaled, learnt=learnt)
        source = SelectedFrames(part.model_copy(update={"frames": count}), self._data[part.data])
        check_subjects(source, where)
        return source

    def _config(self, name: str, row: Training, number: int) -> TrainConfig:
        """The configuration of a repeat: the experiment's, changed by the scale, then by the row."""
        scale = self._scale
        plain = merged(merged(self._experiment.recipe, scale.recipe), row.recipe)
        if "data" in plain:
            raise ConfigError("recipe.data: parts say how places and joints are called", hint="give places and joints in a part")
        for key in ("epochs", "epoch_steps", "seed"):
            if key in plain:
                raise ConfigError(f"recipe.{key}: a scale says it", hint="give steps, epochs and repeats in `scales`")
        epochs = min(scale.epochs, scale.steps or scale.epochs)
        plain |= {"epochs": epochs, "seed": number} | ({"epoch_steps": max(scale.steps // epochs, 1)} if scale.steps else {})
        try:
            return validated(TrainConfig, plain, None, hint="docs/training.md lists the keys")
        except ConfigError as error:
            raise ConfigError(f"recipe of {name}: {error}", hint=error.hint) from error

    def _check_sides(
        self, name: str, train: Sequence[FrameSelection], validation: Sequence[FrameSelection], may_share: Sequence[str]
    ) -> None:
        where = f"training {name}"
        learnt, judged = (set().union(*(self._source(part, where).people for part in side)) for side in (train, validation))
        if "subject" not in may_share:
            _refuse_shared("subject", learnt & judged, where, *_ITS_VALIDATION)
        for (data, subjects), count in needed(self._experiment, self._scale, train, validation).items():
            pieces = self._data[data]
            if count and all(piece.config for piece in pieces):  # of folders the frames are counted
                whole = SelectedFrames(FrameSelection(data=data, subject=subjects, frames=count), pieces)
                check_subjects(whole, f"{where} and its validation")


def _contents(
    sources: Iterable[SelectedFrames], drawn: Sequence[Drawn], cell: TrainCell, where: str, *, learnt: bool = True
) -> dict[str, set[Any]]:
    """What is in the frames of some parts, which can be opened as these say and have what the method of a training reads."""
    from cabinpose.estimate import frame_spec, slot_rows  # noqa: PLC0415 - torch, whose seconds who only looks should not take

    spec = frame_spec(TrainConfig.model_validate(cell.recipe))
    for source, frames in zip(sources, drawn, strict=True):
        for name, dataset in opened(source.part, frames, cell.settings).items():
            with said_of(f"{where}: {name}"):
                slot_rows(dataset, spec, learnt=learnt)
    return contents(drawn)


def _check_labelled(sources: Sequence[SelectedFrames], method: str, where: str) -> None:
    """Raise ConfigError where a method of body parts is to have frames of the laboratory, which are labelled by a suit."""
    recorded = [piece.name for source in sources for piece in source.pieces if piece.recorded]
    if recorded and METHODS[method].task == "parts":
        raise ConfigError(
            f"{where}: {recorded[0]} is recorded in the laboratory, whose suit labels no parts of bodies",
            hint="write `lab: null` beside its `synth`: its frames are generated then, with labels",
        )


def _made(sources: Iterable[SelectedFrames]) -> list[str]:
    """The keys of the cells that make the datasets of some parts."""
    return list(dict.fromkeys(piece.key for source in sources for piece in source.pieces if piece.config))


def _refuse_shared(kind: str, shared: set[Any], one: str, other: str, meant: str = "") -> None:
    """Raise ConfigError where two selections share people, cars, sequences or frames."""
    if not shared:
        return
    names = sorted({str(each[0] if kind in ("subject", "car") else each[1]) for each in shared})
    more = f" and {len(names) - _NAMES} more" if len(names) > _NAMES else ""
    hint = f"select other {kind}s in one of them"
    if kind != "frame":
        hint += f"; if it is meant, write {meant or f'may_share: [{kind}] in the test'}"
    raise ConfigError(f"{one} and {other} share the {kind} {', '.join(names[:_NAMES])}{more}", hint=hint)


def _check_columns(experiment: Experiment, cells: Mapping[str, TrainCell]) -> None:
    """Raise ConfigError for a column that a model's answers say nothing of, which would be found when all is trained."""
    for row, cell in cells.items():
        method = METHODS[cell.recipe["method"]]
        parts = method.task == "parts"
        for column in experiment.columns:
            if row not in (experiment.tests[column.test].trainings or cells):
                continue
            if (column.measure in ("iou", "person_iou")) != parts:
                what = "parts of bodies" if parts else "joints"
                raise ConfigError(
                    f"column {column.title}: {column.measure} is not measured of {what}, which {cell.name} finds",
                    hint="measure iou or person_iou of parts, and anything else of joints",
                )
            if not parts:
                joints_of(column.joints, method.settings(cell.recipe["settings"]).joints)


def joints_of(name: str, there: Sequence[str]) -> list[str]:
    """The joints of a set by its name, those of them that are there. Raises ConfigError for an unknown one."""
    members = there if name == ALL else CABINPOSE.groups.get(name, (name,))
    if not (found := [joint for joint in members if joint in there]):
        raise unknown_name("set of joints", name, [ALL, *CABINPOSE.groups, *there])
    return found


def same_cells(cells: Sequence[TrainCell]) -> dict[str, str]:
    """By the name of a training that is the same cell as one before it at this scale, the name of that one."""
    first: dict[str, str] = {}
    return {cell.name: first[cell.key] for cell in cells if first.setdefault(cell.key, cell.name) != cell.name}

"""The cells of an experiment: a dataset is made, a model trained, a model tested. Each is kept in a folder of its key.

A cell is plain data that a worker on another machine makes from what it reads under the same paths.
"""

from __future__ import annotations

import hashlib
import json
import shutil
import time
from abc import ABC, abstractmethod
from collections import Counter
from collections.abc import Iterable
from contextlib import suppress
from dataclasses import dataclass
from functools import cache, partial
from pathlib import Path
from typing import Any

import numpy as np

from cabinpose.app.experiment.frames import Drawn, SelectedFrames, draw, opened
from cabinpose.app.experiment.pieces import DatasetPiece
from cabinpose.core import SKELETONS, ConfigError, DatasetError, make_folder, read_arrays, whole_file, write_whole
from cabinpose.estimate import METHODS
from cabinpose.evaluate import EvaluationOptions, ModelErrors, clusters_of, errors_of, joined_errors, samples_of
from cabinpose.store import MANIFEST_NAME, read_manifest
from cabinpose.synth import Existing, SynthConfig, generate

RECORD = "cell.json"  # of a cell that is whole
_TOLD = {"cpu_s", "wall_s", "resumed"}  # of every record
_MODELS = ("model.onnx", "best.npz")


@cache
def code_state() -> str:
    """A checksum of the package's modules: cells that were made by different ones are told apart in reports."""
    package = Path(__file__).parents[2]  # of an editable install `files` names no single folder
    found = sorted(path for path in package.rglob("*") if path.suffix in (".py", ".so", ".pyd"))
    total = hashlib.sha256()
    for path in found:
        total.update(path.read_bytes())
    return total.hexdigest()[:16]


@dataclass(frozen=True)
class ExperimentCell(ABC):
    """One step.

    name: as people read it · key: of all that it depends on · folder: where it is kept · needs: keys of cells before it ·
    expected_s: CPU seconds that it should take.
    """

    name: str
    key: str
    folder: Path
    needs: tuple[str, ...]
    expected_s: float

    @property
    def done(self) -> bool:
        """Whether it is there."""
        return bool(self.record)

    @property
    def record(self) -> dict[str, Any]:
        """What it took, and what there is to be known of it; empty where it is not there or damaged."""
        with suppress(OSError, ValueError):
            found = json.loads((self.folder / RECORD).read_text("utf-8"))
            if isinstance(found, dict) and _TOLD.issubset(found):
                return found
        return {}

    @property
    def made_share(self) -> float:
        """How much of it there is, 0 to 1, also of one that is being made, wherever that is."""
        if self.done:
            return 1.0
        with suppress(OSError, ValueError, DatasetError):
            return min(self._begun(), 1.0)
        return 0.0

    def make(self) -> dict[str, Any]:
        """Make it, going on with what an interrupted run has left; its record."""
        make_folder(self.folder)
        resumed = self._left
        wall, cpu = time.perf_counter(), time.process_time()
        facts = self._made()
        spent = {"cpu_s": time.process_time() - cpu, "wall_s": time.perf_counter() - wall, "resumed": resumed}
        record = {"name": self.name, "key": self.key, "code": code_state(), **spent, **facts}
        write_whole(self.folder / RECORD, json.dumps(record, indent=1) + "\n")
        return record

    @property
    @abstractmethod
    def frame_count(self) -> int:
        """How many frames it makes, learns from or judges, as far as it is known before it is made."""

    @property
    def _left(self) -> bool:
        """Whether an earlier run has left something of it."""
        return any(self.folder.iterdir())

    def _begun(self) -> float:
        """How much of it an interrupted run has left, or one that goes on has made; nothing where that is not known."""
        return 0.0

    @abstractmethod
    def _made(self) -> dict[str, Any]:
        """Make it; facts for the record."""


@dataclass(frozen=True)
class DataCell(ExperimentCell):
    """A stand-in is generated, or recorded in the virtual laboratory, on one thread."""

    piece: DatasetPiece

    @property
    def _recordings(self) -> Path:
        return self.folder / "recordings"

    @property
    def done(self) -> bool:
        """Whether the dataset is there as well."""
        return super().done and (self.piece.folder / MANIFEST_NAME).exists()

    @property
    def frame_count(self) -> int:
        return self.piece.frames

    @property
    def _left(self) -> bool:
        return super()._left or self.piece.folder.exists()

    def _begun(self) -> float:
        if not self.piece.recorded:
            return read_manifest(self.piece.folder).frames / self.piece.frames
        from cabinpose.app.lab.filmed import FilmedSession, recorded_share  # noqa: PLC0415 - the same as below

        return recorded_share(FilmedSession.model_validate_json(self.piece.config), self._recordings)

    def _made(self) -> dict[str, Any]:
        if self.piece.recorded:
            return self._recorded()
        config = SynthConfig.model_validate_json(self.piece.config)
        piece, begun = self.piece, (self.piece.folder / MANIFEST_NAME).exists()
        existing: Existing = "resume" if begun else "refuse"
        report = generate(config, piece.frames, piece.folder, seed=piece.seed, workers=1, existing=existing)
        return {"frames": report.frames_total}

    def _recorded(self) -> dict[str, Any]:
        from cabinpose.app.lab.filmed import FilmedSession, record_films  # noqa: PLC0415 - its libraries, for those who record

        if not (self.piece.folder / MANIFEST_NAME).exists():
            record_films(FilmedSession.model_validate_json(self.piece.config), self._recordings, self.piece.folder)
        shutil.rmtree(self._recordings, ignore_errors=True)
        return {"frames": read_manifest(self.piece.folder).frames}


@dataclass(frozen=True)
class TrainCell(ExperimentCell):
    """A model is trained, on one thread of the CPU, so that its weights do not depend on how many are trained at a time.

    recipe: a `TrainConfig` as plain data · begins: the training whose weights it begins with.
    """

    recipe: dict[str, Any]
    train: tuple[SelectedFrames, ...]
    validation: tuple[SelectedFrames, ...]
    begins: TrainCell | None = None

    @property
    def frame_count(self) -> int:
        return sum(source.frames for source in self.train)

    @property
    def settings(self) -> Any:
        """The settings of its method."""
        return METHODS[self.recipe["method"]].settings(self.recipe["settings"])

    def drawn(self) -> tuple[list[Drawn], list[Drawn]]:
        """The frames that are learnt from and those that validate, by part; the latter are drawn first, in whole sequences."""
        judged: list[Drawn] = []
        for source in self.validation:
            judged.append(draw(source, judged, f"validation of {self.name}", whole_sequences=True))
        learnt: list[Drawn] = []
        for source in self.train:
            learnt.append(draw(source, [*judged, *learnt], f"training of {self.name}", apart=judged))
        return learnt, judged

    def model(self) -> Path:
        """The file of the model. Raises ConfigError where there is none."""
        for name in _MODELS:
            if (self.folder / name).exists():
                return self.folder / name
        raise ConfigError(f"{self.folder} has no model", hint=f"remove {self.folder / RECORD} to train it again")

    def _begun(self) -> float:
        rows = (self.folder / "log" / "metrics.csv").read_text("utf-8").splitlines()
        return (len(rows) - 1) / self.recipe["epochs"]

    def _made(self) -> dict[str, Any]:
        from cabinpose.app.report.raster import write_curves  # noqa: PLC0415 - the same as below
        from cabinpose.app.training import stored_frames  # noqa: PLC0415 - the same
        from cabinpose.estimate import (  # noqa: PLC0415 - torch, whose seconds a run that has nothing to do should not take
            Machines,
            Observers,
            Start,
            TrainConfig,
            export_onnx,
            fit,
            frame_spec,
        )

        config = TrainConfig.model_validate(self.recipe)
        learnt, judged = self.drawn()
        sides = (_sides(self.train, learnt, self.settings), _sides(self.validation, judged, self.settings))
        training, validation = stored_frames(sides, frame_spec(config))
        last = self.folder / "last.ckpt"
        best = self.folder / "best.npz"
        if not best.exists():
            init = None if self.begins is None or last.exists() else self.begins.folder / "best.ckpt"
            best = fit(
                config, training, validation, self.folder, start=Start(resume=last.exists(), init=init),
                machines=Machines(threads=1), observers=Observers(draw=partial(write_curves, self.folder / "curves.png")),
            )  # fmt: skip
        if best.suffix == ".ckpt":
            export_onnx(best, self.folder / "model.onnx", name=self.name.replace(" ", "-"), card={}, overwrite=True)
        by_data: Counter[str] = Counter()
        for source, frames in zip(self.train, learnt, strict=True):
            by_data[source.part.data] += _count([frames])
        return {"frames": _count(learnt), "validation_frames": _count(judged), "by_data": by_data}


@dataclass(frozen=True)
class TestCell(ExperimentCell):
    """A model answers for the frames of a test; kept are the errors of every joint, or the pixels by class."""

    trained: TrainCell
    frames: tuple[SelectedFrames, ...]
    slots: tuple[str, ...]

    @property
    def frame_count(self) -> int:
        return sum(source.frames for source in self.frames)

    def drawn(self) -> list[Drawn]:
        """The frames, by part."""
        found: list[Drawn] = []
        for source in self.frames:
            found.append(draw(source, found, f"test of {self.name}", whole_sequences=True))
        return found

    def errors(self) -> tuple[ModelErrors, tuple[str, ...]]:
        """What was found: the errors, and the joints or parts that they are of."""
        arrays = read_arrays(self.folder / "errors.npz")
        return ModelErrors(*(arrays[name] for name in ModelErrors._fields)), tuple(map(str, arrays["names"]))

    def _made(self) -> dict[str, Any]:
        parts, names = [], []
        for source, drawn in zip(self.frames, self.drawn(), strict=True):
            for dataset in opened(source.part, drawn, self.trained.settings).values():
                errors, joints = _judged(dataset, self.trained.model(), self.slots)
                parts.append(errors)
                names.append(joints)
        whole = joined_errors(parts)
        with whole_file(self.folder / "errors.npz") as file:
            np.savez_compressed(file, **whole._asdict(), names=np.array(names[0]))
        return {"frames": whole.frames}


def _sides(sources: Iterable[SelectedFrames], drawn: Iterable[Drawn], settings: Any) -> dict[str, Any]:
    """The frames of some parts by name, each once."""
    result: dict[str, Any] = {}
    for source, frames in zip(sources, drawn, strict=True):
        for name, dataset in opened(source.part, frames, settings).items():
            result[name if name not in result else f"{name} ({len(result)})"] = dataset
    return result


def _count(drawn: Iterable[Drawn]) -> int:
    return sum(len(positions) for each in drawn for _, positions in each)


def _judged(dataset: Any, model: Path, slots: tuple[str, ...]) -> tuple[ModelErrors, tuple[str, ...]]:
    """The errors of a model on a dataset, and the joints or the parts that they are of."""
    from cabinpose.app.models import opened_models  # noqa: PLC0415 - ONNX Runtime
    from cabinpose.core import Segmenter, confusion  # noqa: PLC0415 - with it
    from cabinpose.evaluate import pairs  # noqa: PLC0415 - with it

    (found,) = opened_models([str(model)], dataset)
    if isinstance(found, Segmenter):
        count = len(found.parts) + 1
        counts = [confusion(t, a, count) for truth, answer in pairs(dataset, found) for t, a in zip(truth, answer, strict=True)]
        none, nobody = np.zeros((0, 1)), np.zeros(0)
        drawn_with = clusters_of(*(dataset[name].values.astype(np.int64) for name in ("sequence", "sync_ns")))
        errors = ModelErrors(drawn_with, np.zeros(0, np.int64), none, none, none, nobody, nobody, none, np.stack(counts))
        return errors, tuple(part.name for part in found.parts)
    samples, _ = samples_of(dataset, found, EvaluationOptions(resamples=0), persons=slots)
    joints = tuple(joint for joint in SKELETONS[samples.skeleton.name].joints if joint in found.joints)
    return errors_of(samples, joints), joints  # also those that these frames have nobody with: other parts of a test may

"""What the datasets of an experiment are made of: folders of a user's, and stand-ins of as few frames as are drawn of them."""

from __future__ import annotations

import hashlib
import json
import math
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import xarray as xr

from cabinpose import __version__
from cabinpose.app.experiment.config import Data, Experiment, FineTuning, FrameSelection, Laboratory, RunScale, Training, merged
from cabinpose.app.extras import require
from cabinpose.app.training_split import individuals
from cabinpose.core import ConfigError
from cabinpose.store import dataset_id, open_dataset, read_manifest, validated
from cabinpose.synth import CabinScene, SequenceConfig, SynthConfig, is_random_car

Identity = tuple[str, int | None]
"""A person, or a car, by name; with the seed of their dataset where it drew them at random."""
_ROOM = "room_"  # the names of rooms, which are drawn at random, begin so


@dataclass(frozen=True)
class DatasetPiece:
    """A dataset folder: a user's, or a stand-in that is generated.

    name: of the dataset, and of the subject whose frames alone it has · key: of what is in it · people, cars: who and what may be
    in it · config: of a stand-in, as JSON; "" for a folder of the user's · recorded: frames by subject of one that the virtual
    laboratory records, which its configuration is of.
    """

    name: str
    folder: Path
    key: str
    frames: int
    people: frozenset[Identity]
    cars: frozenset[Identity]
    config: str = ""
    seed: int = 0
    recorded: Mapping[str, int] = field(default_factory=dict, hash=False)

    def most(self, subjects: Sequence[str]) -> int:
        """The frames of some subjects, () = all, as far as they are known to be told apart."""
        return (
            sum(self.recorded[name] for name in subjects if name in self.recorded) if self.recorded and subjects else self.frames
        )


def digest(facts: Any) -> str:
    """A key of plain data, and of the version of this package."""
    text = json.dumps([__version__, facts], sort_keys=True, default=str)
    return hashlib.sha256(text.encode()).hexdigest()[:16]


Wanted = dict[tuple[str, ...], int]
"""The most frames that a training or a test draws of a dataset, by the subjects that it selects; () = of all."""


def wanted_frames(experiment: Experiment, scale: RunScale) -> dict[str, Wanted]:
    """What is drawn of each dataset at a scale."""
    rows: list[Training | FineTuning] = [*experiment.trainings.values()]
    rows += [row.fine_tune for row in experiment.trainings.values() if row.fine_tune]
    result: dict[str, Wanted] = {name: {} for name in experiment.data}
    for learnt, judged in [(row.train, row.validation) for row in rows] + [((), t.frames) for t in experiment.tests.values()]:
        for (name, subjects), count in needed(experiment, scale, learnt, judged).items():
            result[name][subjects] = max(result[name].get(subjects, 0), count)
    return result


def needed(
    experiment: Experiment, scale: RunScale, learnt: Iterable[FrameSelection], judged: Iterable[FrameSelection]
) -> dict[tuple[str, tuple[str, ...]], int]:
    """How many frames a training takes of each dataset and its subjects, with the rest of a sequence that its validation cuts."""
    counts: Counter[tuple[str, tuple[str, ...]]] = Counter()
    for part in learnt:
        counts[part.data, part.subject] += scale.count(part.frames, part.scaled, learnt=True) if part.frames else 0
    for part in judged:
        if part.frames:
            left = _sequence_frames(experiment.data[part.data]) - 1 if (part.data, part.subject) in counts else 0
            counts[part.data, part.subject] += scale.count(part.frames, part.scaled) + left
    return dict(counts)


def _sequence_frames(data: Data) -> int:
    """Frames of a stand-in's sequences; 1: single ones, or not known."""
    scene = (data.synth or {}).get("scene")
    sequence = scene.get("sequence") if isinstance(scene, Mapping) else None
    frames = sequence.get("frames", SequenceConfig.model_fields["frames"].default) if isinstance(sequence, Mapping) else 1
    return frames if isinstance(frames, int) else 1


def pieces_of(name: str, data: Data, scale: RunScale, wanted: Wanted, given: Path | None, out: Path) -> tuple[DatasetPiece, ...]:
    """What a dataset is made of at a scale.

    Parameters
    ----------
    name, data
        The dataset.
    scale
        Of the numbers of frames.
    wanted
        What is drawn of it at this scale: where rounding, or the least number of frames, asks for more, more are made.
    given
        A folder of the user's in its place.
    out
        Where stand-ins are made.

    Raises
    ------
    ConfigError
        For scenes that cannot be made.
    DatasetError
        For a folder without a dataset.
    """
    folder = given or data.folder
    if folder is not None:
        return (_folder_piece(name, folder),)
    plain, counts = dict(data.synth or {}), data.frames
    if isinstance(counts, Mapping):
        scaled = {subject: scale.count(frames, learnt=True) for subject, frames in counts.items()}
        if scale.frames != 1.0:
            for subjects, count in wanted.items():
                who = [subject for subject in scaled if not subjects or subject in subjects]
                if count > sum(scaled[subject] for subject in who):
                    scaled |= {subject: max(scaled[subject], -(-count // len(who))) for subject in who}
        if data.lab is not None:
            return (_recording(name, data, data.lab, scaled, out),)
        return tuple(
            _stand_in(f"{name}/{subject}", _of_subject(name, data, subject), frames, data.seed + number, out)
            for number, (subject, frames) in enumerate(scaled.items())
        )
    most = max(wanted.values(), default=0) if scale.frames != 1.0 else 0
    config = _parsed(name, plain)
    scene = config.scene
    if counts is None and isinstance(scene, CabinScene) and scene.factorial is not None:
        of_each = (config.frames or 1) / scene.factorial.poses
        poses = max(math.ceil(scene.factorial.poses * scale.frames), math.ceil(most / of_each), 1)
        plain = merged(plain, {"scene": {"factorial": {"poses": poses}}})
        config = _parsed(name, plain)
    elif counts is None:
        raise ConfigError(
            f"data.{name}: it is not said how many frames", hint="give `frames`; scenes are drawn at random without end"
        )
    frames = config.frames_or_all(None) if counts is None else max(scale.count(counts, learnt=True), most)
    return (_stand_in(name, config, frames, data.seed, out),)


def _folder_piece(name: str, folder: Path) -> DatasetPiece:
    dataset = open_dataset(folder)
    key = dataset_id(read_manifest(folder))
    people = frozenset(individuals(dataset))
    return DatasetPiece(name, folder.resolve(), key, dataset.sizes["frame"], people, frozenset(cars_of(dataset)))


def _of_subject(name: str, data: Data, subject: str) -> SynthConfig:
    """The scenes of one subject: the dataset's, with nobody else in them."""
    plain = merged(dict(data.synth or {}), data.changes.get(subject, {}))
    people: Any = plain.get("people") or {}
    own: Any = {}
    if isinstance(people, Mapping):
        own = people.get("own") or {}
    if not isinstance(people, Mapping) or not isinstance(own, Mapping):
        return _parsed(f"{name}/{subject}", plain)  # which refuses it
    chosen: dict[str, Any] = (
        {"subjects": [], "own": {subject: own[subject]}} if subject in own else {"subjects": [subject], "own": {}}
    )
    return _parsed(f"{name}/{subject}", plain | {"people": {**people, **chosen}})


def _parsed(name: str, plain: Mapping[str, Any]) -> SynthConfig:
    try:
        return SynthConfig.parse(dict(plain))
    except ConfigError as error:
        raise ConfigError(f"data.{name}.synth: {error}", hint=error.hint) from error


def _stand_in(name: str, config: SynthConfig, frames: int, seed: int, out: Path) -> DatasetPiece:
    text = config.model_dump_json()
    key = digest({"synth": text, "seed": seed, "frames": frames})
    people = config.people
    named = {(who, None) for who in (*people.subjects, *people.own)}
    crowd = {(f"R{number:04d}", seed) for number in range(people.random.count if people.random else 0)}
    cars: set[Identity] = set()
    if isinstance(config.scene, CabinScene):
        cars = {_car(car if isinstance(car, str) else car.name, seed) for car in config.scene.cars}
        cars |= {(f"C{number:04d}", seed) for number in range(config.scene.random_cars)}
    return DatasetPiece(
        name, out / "data" / key, key, frames, frozenset(named | crowd), frozenset(cars), text, seed
    )  # fmt: skip


def _recording(name: str, data: Data, lab: Laboratory, frames: Mapping[str, int], out: Path) -> DatasetPiece:
    """A stand-in that the virtual laboratory records: all subjects in one session, the first activity another for each."""
    require("record")
    from cabinpose.app.lab.filmed import FilmedSession, FilmedSubject  # noqa: PLC0415 - its libraries, for those who record

    subjects, cars = {}, set[Identity]()
    for number, (subject, count) in enumerate(frames.items()):
        config = _of_subject(name, data, subject)
        scene, camera = config.scene, config.camera
        if not isinstance(scene, CabinScene) or scene.sequence is None or len(scene.cars) != 1 or scene.random_cars:
            raise ConfigError(
                f"data.{name}: the laboratory records sequences in one car", hint="give scene.sequence and one of cars"
            )
        if len(camera.views) != 1 or camera.jitter_m or camera.jitter_deg:
            hint = "give one view, and camera.jitter_m and camera.jitter_deg: 0"
            raise ConfigError(f"data.{name}: the laboratory's camera stays where it is", hint=hint)
        many = len(scene.sequence.activities or ())
        first = number * many // len(frames)
        subjects[subject] = FilmedSubject(scenes=config, seed=data.seed + number, frames=count, first=first)
        cars |= {_car(car if isinstance(car, str) else car.name, data.seed) for car in scene.cars}
    asked = {"subjects": subjects, "views": lab.views, "seed": data.seed, **({"rig": dict(lab.rig)} if lab.rig else {})}
    session = validated(FilmedSession, asked, None, hint=f"data.{name}.lab: docs/experiments.md lists the keys")
    text = session.model_dump_json()
    key, people = digest({"lab": text}), frozenset((subject, None) for subject in frames)
    whole = sum(frames.values())
    return DatasetPiece(name, out / "data" / key, key, whole, people, frozenset(cars), text, data.seed, dict(frames))


def _car(name: str, seed: int) -> Identity:
    """A car or a room of a dataset of a seed."""
    return name, seed if is_random_car(name) or name.startswith(_ROOM) else None


def cars_of(dataset: xr.Dataset) -> set[Identity]:
    """The cars, and rooms, of frames."""
    pairs = set(zip(dataset["car"].values.astype(str).tolist(), dataset["seed"].values.tolist(), strict=True))
    return {_car(name, int(seed)) for name, seed in pairs if name}

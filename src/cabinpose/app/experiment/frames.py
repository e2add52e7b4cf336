"""The frames of an experiment: what each dataset is made of, who is in it, and which of its frames a selection draws."""

from __future__ import annotations

import hashlib
import json
import math
from collections import Counter
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from cabinpose import __version__
from cabinpose.app.experiment.config import Data, Experiment, FineTuning, FrameSelection, Laboratory, RunScale, Training, merged
from cabinpose.app.extras import require
from cabinpose.app.training_split import individuals
from cabinpose.core import ConfigError, DatasetError, unknown_name
from cabinpose.store import (
    as_named,
    dataset_id,
    draw_rng,
    frame_mask,
    open_dataset,
    read_manifest,
    unfolded,
    validated,
    values_of,
)
from cabinpose.synth import CabinScene, SequenceConfig, SynthConfig, is_random_car

Identity = tuple[str, int | None]
"""A person, or a car, by name; with the seed of their dataset where it drew them at random."""
_OTHERS = "a file that `extends` this one selects others"  # for whom a folder in place of a stand-in lacks
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


Drawn = list[tuple[DatasetPiece, NDArray[np.int64]]]
"""Positions of frames, rising, by their piece."""


@dataclass(frozen=True)
class SelectedFrames:
    """A part of a dataset as a cell takes it: the numbers of frames are those of the scale."""

    part: FrameSelection
    pieces: tuple[DatasetPiece, ...]

    @property
    def facts(self) -> dict[str, Any]:
        """All that decides on the frames, as plain data."""
        return {"part": self.part.model_dump(mode="json"), "pieces": [piece.key for piece in self.pieces]}

    @property
    def people(self) -> set[Identity]:
        """Who may be in the frames, of a user's folder who is; nobody is known of folds that are not."""
        if self._folded("subject"):
            return set()
        if not self._config:
            return self._shown("subject")
        return {who for piece in self.pieces for who in piece.people if not self.part.subject or who[0] in self.part.subject}

    @property
    def cars(self) -> set[Identity]:
        """Which cars may be in the frames; likewise."""
        if self._folded("car"):
            return set()
        if not self._config:
            return self._shown("car")
        return {car for piece in self._asked for car in piece.cars if not self.part.car or car[0] in self.part.car}

    @property
    def most(self) -> int:
        """No selection can have more frames than this; of a user's folder just as many."""
        selection = tuple(self.part.selection.items())
        return sum(
            p.most(self.part.subject) if p.config or not selection else _count(p.folder, p.key, selection) for p in self._asked
        )

    @property
    def _config(self) -> bool:
        """Whether stand-ins are among the pieces."""
        return any(piece.config for piece in self.pieces)

    def _shown(self, kind: str) -> set[Identity]:
        selection = tuple(self.part.selection.items())
        return set().union(*(_shown_in(piece.folder, piece.key, selection)[kind] for piece in self.pieces))

    def _folded(self, coordinate: str) -> bool:
        return any(key.startswith(f"{coordinate}/") for key in self.part.unknown_folds)

    @property
    def _asked(self) -> list[DatasetPiece]:
        """The pieces that may have frames of the subjects."""
        wanted = self.part.subject
        return [piece for piece in self.pieces if not wanted or any(name in wanted for name, _ in piece.people)]

    @property
    def frames(self) -> int:
        """How many frames are drawn, as far as it is known before they are there."""
        share = math.prod(len(set(wanted)) / int(key.partition("/")[2]) for key, wanted in self.part.unknown_folds.items())
        return round(self.most * share) if self.part.frames is None else self.part.frames


@cache
def _count(folder: Path, key: str, selection: tuple[tuple[str, tuple[Any, ...]], ...]) -> int:  # noqa: ARG001 - of another content
    """How many frames of a folder belong to a selection."""
    return int(_selected(open_dataset(folder), dict(selection)).sum())


@cache
def _shown_in(folder: Path, key: str, selection: tuple[tuple[str, tuple[Any, ...]], ...]) -> dict[str, set[Identity]]:  # noqa: ARG001 - likewise
    """Who ("subject") and what ("car") is in the frames of a folder that belong to a selection."""
    dataset = open_dataset(folder)
    some = dataset.isel(frame=np.flatnonzero(_selected(dataset, dict(selection))))
    return {"subject": individuals(some), "car": _cars(some)}


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
    return DatasetPiece(name, folder.resolve(), key, dataset.sizes["frame"], people, frozenset(_cars(dataset)))


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


def _cars(dataset: xr.Dataset) -> set[Identity]:
    """The cars, and rooms, of frames."""
    pairs = set(zip(dataset["car"].values.astype(str).tolist(), dataset["seed"].values.tolist(), strict=True))
    return {_car(name, int(seed)) for name, seed in pairs if name}


def check_subjects(source: SelectedFrames, where: str) -> None:
    """Raise ConfigError for subjects or cars that the dataset cannot have, or for more frames than there can be."""
    for kind, wanted, there in (
        ("subject", source.part.subject, {name for p in source.pieces for name, _ in p.people}),
        ("car", source.part.car, {name for p in source.pieces for name, _ in p.cars}),
    ):
        for name in wanted:
            if name not in there:
                error = unknown_name(kind, name, sorted(there))
                hint = error.hint if any(p.config for p in source.pieces) else f"{error.hint}; {_OTHERS}"
                raise ConfigError(f"{where}, data {source.part.data}: {error}", hint=hint)
    if not any(piece.config for piece in source.pieces):
        _refuse_unknown([open_dataset(piece.folder) for piece in source.pieces], source.part, where)
    if source.part.frames is not None and source.part.frames > source.most:
        raise _too_few(where, source, source.most)


def _too_few(where: str, source: SelectedFrames, there: int) -> ConfigError:
    part = source.part
    more = f", or make more with data.{part.data}.frames" if any(piece.config for piece in source.pieces) else ""
    return ConfigError(
        f"{where}: {part.frames} frames of {part.data} are asked for at this scale, and the selection has {there}",
        hint=f"ask for at most {there}, or select more of it{more}",
    )


def _origin(piece: DatasetPiece, dataset: xr.Dataset) -> str:
    """Equal where frames of one number are the same frame, however many were made and wherever a copy lies."""
    return str(dataset.attrs["frames_id"] or piece.folder)


def draw(
    source: SelectedFrames, taken: Sequence[Drawn], where: str, *, apart: Sequence[Drawn] = (), whole_sequences: bool = False
) -> Drawn:
    """The frames that a part draws: in an order that depends on the selection alone, without those that others have taken.

    Parameters
    ----------
    source
        The part; its folders are there.
    taken
        What others drew.
    apart
        What others drew whose sequences are left alone as a whole: the rest of one that they cut shows the same as their frames.
    where
        What errors call it.
    whole_sequences
        Draw one sequence after the other, and of a single one what stands together, for frames that shall not be neighbours of
        others.

    Raises
    ------
    ConfigError
        Where there are too few.
    DatasetError
        For a value that the dataset does not have.
    """
    numbers, positions, sequences, moving = [], [], [], False
    datasets = [open_dataset(piece.folder) for piece in source.pieces]
    _refuse_unknown(datasets, source.part, where)
    selection = _of_folds(source.part, lambda name: _values(datasets, name))
    for number, (piece, dataset) in enumerate(zip(source.pieces, datasets, strict=True)):
        free = _selected(dataset, selection) & ~_taken(piece, dataset, taken, apart)
        at = np.flatnonzero(free)
        numbers.append(np.full(len(at), number))
        positions.append(at)
        sequences.append(dataset["sequence"].values[at])
        moving |= len(np.unique(dataset["sync_ns"])) > 1  # single frames are of no time
    of, at, sequence = (np.concatenate(each) for each in (numbers, positions, sequences))
    if not len(at):
        raise ConfigError(
            f"{where}: no frame of {source.part.data} is left", hint="look at the selection, and at `cabinpose info`"
        )
    if source.part.frames is not None and len(at) < source.part.frames:
        raise _too_few(where, source, len(at))
    rng = draw_rng()
    order = rng.permutation(len(at))
    if whole_sequences:
        _, group = np.unique(np.stack((of, sequence)), axis=1, return_inverse=True)
        many = group.max() > of.max() or moving  # single frames are all of one sequence
        order = np.argsort(rng.permutation(group.max() + 1)[group], kind="stable") if many else order[::-1]
    chosen = order[: source.part.frames]
    return [(source.pieces[n], np.sort(at[chosen[of[chosen] == n]])) for n in np.unique(of[chosen]).tolist()]


def _taken(piece: DatasetPiece, dataset: xr.Dataset, taken: Sequence[Drawn], apart: Sequence[Drawn]) -> NDArray[np.bool_]:
    """(frame,) whether others have a frame, or one of its sequence where these are left alone."""
    origin, numbers, sequences = _origin(piece, dataset), dataset["frame"].values, dataset["sequence"].values
    result = np.zeros(len(numbers), bool)
    several = len(np.unique(sequences)) > 1  # single frames are all of one sequence
    for others, whole in ((taken, False), (apart, several)):
        for other, positions in (each for one in others for each in one):
            there = open_dataset(other.folder)
            if _origin(other, there) == origin:
                name, values = ("sequence", sequences) if whole else ("frame", numbers)
                result |= np.isin(values, there[name].values[positions])
    return result


def _selected(dataset: xr.Dataset, selection: Mapping[str, tuple[Any, ...]]) -> NDArray[np.bool_]:
    """(frame,) whether a frame of a piece belongs to the selection; values that only other pieces have select nothing here."""
    known = {name: tuple(value for value in wanted if value in values_of(dataset, name)) for name, wanted in selection.items()}
    if not all(known.values()):
        return np.zeros(dataset.sizes["frame"], bool)
    return frame_mask(dataset, known)


def _values(datasets: Iterable[xr.Dataset], name: str) -> set[Any]:
    return set().union(*(values_of(dataset, name) for dataset in datasets))


def _of_folds(part: FrameSelection, there: Callable[[str], Collection[Any] | None]) -> dict[str, tuple[Any, ...]]:
    """The selection of a part with values in place of folds, see `unfolded`. Raises ConfigError where folds have none."""
    found = unfolded(part.selection, there)
    for name in (name for name, wanted in found.items() if not wanted):
        folds = "; ".join(f"{key}: {list(wanted)}" for key, wanted in part.folds.items() if key.startswith(f"{name}/"))
        values = ", ".join(map(str, sorted(there(name) or ())))
        raise ConfigError(f"{part.data} has no {name} in {folds}", hint=f"ask for fewer folds; it has: {values}")
    return found


def dealt_out(part: FrameSelection, pieces: Sequence[DatasetPiece]) -> FrameSelection:
    """The part with the values of its folds, as far as these are known before stand-ins are made.

    Folds of a folder are of what is in its frames; of a stand-in, of the people and cars that its configuration names, be they in
    a frame or not. Where it has random ones, and of other coordinates, they are of what is in the frames when these are made.
    Raises ConfigError for folds without a value.
    """
    datasets = [open_dataset(piece.folder) for piece in pieces if not piece.config]

    def there(name: str) -> set[str] | None:
        if datasets:
            return _values(datasets, name)
        named = {"subject": [piece.people for piece in pieces], "car": [piece.cars for piece in pieces]}.get(name)
        known = frozenset().union(*named) if named else frozenset()
        return {who for who, _ in known} if known and all(seed is None for _, seed in known) else None

    found = _of_folds(part, there)
    return part.model_copy(update={name: values for name, values in found.items() if "/" not in name})


def _refuse_unknown(datasets: Sequence[xr.Dataset], part: FrameSelection, where: str) -> None:
    """Raise DatasetError for a value of the selection that no piece has; folds may have more than are in the frames."""
    folded = {key.partition("/")[0] for key in part.folds}
    for name, wanted in part.selection.items():
        if name in folded or "/" in name:
            continue
        there = _values(datasets, name)
        if unknown := [value for value in wanted if value not in there]:
            raise DatasetError(
                f"{where}: {part.data} has no {name} {unknown[0]!r}", hint=f"it has: {', '.join(map(str, sorted(there)))}"
            )


def opened(part: FrameSelection, drawn: Drawn, settings: Any) -> dict[str, xr.Dataset]:
    """The frames that were drawn, by the name of their piece, with depth, and places and joints by the part's names.

    settings: of the method that they are for, whose places and set of joints these are.
    """
    result = {}
    for piece, positions in drawn:
        dataset = open_dataset(piece.folder).isel(frame=positions)
        if part.depth != "depth":
            if part.depth not in dataset:
                raise DatasetError(f"{piece.name} has no {part.depth}", hint="leave `depth` out of the part")
            dataset = dataset.drop_vars("depth").rename({part.depth: "depth"})
        result[piece.name] = as_named(dataset, part.places, part.joints, skeleton=settings.joint_set.name, slots=settings.slots)
    return result


def contents(drawn: Iterable[Drawn]) -> dict[str, set[Any]]:
    """Who ("subject") and what ("car", "sequence") is in frames that were drawn, and the frames themselves ("frame").

    Single frames are of no sequence.
    """
    found: dict[str, set[Any]] = {"subject": set(), "car": set(), "sequence": set(), "frame": set()}
    for piece, positions in (each for one in drawn for each in one):
        whole = open_dataset(piece.folder)
        some, origin = whole.isel(frame=positions), _origin(piece, whole)
        found["subject"] |= individuals(some)
        found["car"] |= _cars(some)
        if len(np.unique(whole["sequence"])) > 1:
            found["sequence"] |= {(origin, each) for each in np.unique(some["sequence"]).tolist()}
        found["frame"] |= {(origin, each) for each in some["frame"].values.tolist()}
    return found

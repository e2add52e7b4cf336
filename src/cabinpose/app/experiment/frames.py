"""The frames of an experiment: who and what is in those that a selection takes, and which of them it draws."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from cabinpose.app.experiment.config import FrameSelection
from cabinpose.app.experiment.pieces import DatasetPiece, Identity, cars_of
from cabinpose.app.training_split import individuals
from cabinpose.core import ConfigError, DatasetError, unknown_name
from cabinpose.store import (
    as_named,
    draw_rng,
    frame_mask,
    open_dataset,
    unfolded,
    values_of,
)

_OTHERS = "a file that `extends` this one selects others"  # for whom a folder in place of a stand-in lacks


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
        if not self.stands_in:
            return self._shown("subject")
        return {who for piece in self.pieces for who in piece.people if not self.part.subject or who[0] in self.part.subject}

    @property
    def cars(self) -> set[Identity]:
        """Which cars may be in the frames; likewise."""
        if self._folded("car"):
            return set()
        if not self.stands_in:
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
    def stands_in(self) -> bool:
        """Whether stand-ins are among the pieces, of which it is not known before they are made who is in which frame."""
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
    return {"subject": individuals(some), "car": cars_of(some)}


def check_subjects(source: SelectedFrames, where: str) -> None:
    """Raise ConfigError for subjects or cars that the dataset cannot have, or for more frames than there can be."""
    for kind, wanted, there in (
        ("subject", source.part.subject, {name for p in source.pieces for name, _ in p.people}),
        ("car", source.part.car, {name for p in source.pieces for name, _ in p.cars}),
    ):
        for name in wanted:
            if name not in there:
                error = unknown_name(kind, name, sorted(there))
                hint = error.hint if source.stands_in else f"{error.hint}; {_OTHERS}"
                raise ConfigError(f"{where}, data {source.part.data}: {error}", hint=hint)
    if not source.stands_in:
        _refuse_unknown([open_dataset(piece.folder) for piece in source.pieces], source.part, where)
    if source.part.frames is not None and source.part.frames > source.most:
        raise _too_few(where, source, source.most)


def _too_few(where: str, source: SelectedFrames, there: int) -> ConfigError:
    part = source.part
    more = f", or make more with data.{part.data}.frames" if source.stands_in else ""
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
        found["car"] |= cars_of(some)
        if len(np.unique(whole["sequence"])) > 1:
            found["sequence"] |= {(origin, each) for each in np.unique(some["sequence"]).tolist()}
        found["frame"] |= {(origin, each) for each in some["frame"].values.tolist()}
    return found

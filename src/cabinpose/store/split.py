"""Splits: named selections of frames by their coordinates, kept as YAML, which cannot overlap; and frames by number, as text.

```yaml
train: {subject: [S01, S02, S03], car: [sedan, van]}
test: {subject: [S04]}
```
A frame belongs to a selection if every coordinate that it names has one of the values listed. Of a coordinate that
each person has (`subject`, `action`), all people in the frame need one of them, so that nobody of a test set is
ever seen in training; frames with nobody in them belong to no such selection.

`subject/5: [1]` is the first of five folds of the subjects, of any coordinate likewise; `frames: 500` draws so many of the
frames of each dataset; `datasets: {own-car: {subject: [A]}, scenes: all, lab: none}` says what is otherwise of some datasets.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from functools import partial
from itertools import combinations
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from cabinpose.core import DatasetError, unknown_name

if TYPE_CHECKING:
    import xarray as xr

COORDINATES = ("subject", "car", "pov", "action", "sequence")

FRAMES = "frames"
"""Key of a split: how many of a dataset's frames are drawn."""
DATASETS = "datasets"
"""Key of a split: what is otherwise of some datasets, by the names of their folders."""
_ALL, _NONE = "all", "none"  # of a dataset's frames
_MOST_FOLDS = 1000
_DRAW = 39  # seed of the order in which frames are drawn: of the same selection, more frames are the same ones and others
_HELD_OUT = 0.15  # share of the subjects that validate where no splits are given

Selection = Mapping[str, Any]
"""Values by coordinate, or by folds such as subject/5; `FRAMES`: a number; `DATASETS`: selections of single datasets."""
Splits = Mapping[str, Selection]


def parse_splits(data: Any, source: Path | str) -> dict[str, dict[str, Any]]:
    """The splits that plain data describes; `DatasetError` for unknown keys, empty lists, numbers that cannot be, or overlap."""
    if not isinstance(data, Mapping) or not data:
        raise DatasetError(f"{source} holds no splits", hint="write `name: {coordinate: [values]}`, one line a split")
    splits = {str(name): parse_selection(selection, f"{source}: split '{name}'") for name, selection in data.items()}
    _refuse_overlap(splits, source)
    return splits


def parse_selection(data: Any, where: str) -> dict[str, Any]:
    """The selection that plain data describes; where: what errors call it. `DatasetError` as for `parse_splits`."""
    if not isinstance(data, Mapping) or not data or set(data) == {FRAMES}:
        raise DatasetError(f"{where} selects nothing", hint=f"name some of: {', '.join(COORDINATES)}")
    found: dict[str, Any] = {}
    for key, values in data.items():
        if key == DATASETS:
            found[key] = _by_dataset(values, where)
        elif key == FRAMES:
            if not isinstance(values, int) or isinstance(values, bool) or values < 1:
                raise DatasetError(f"{where}: {values!r} frames cannot be drawn", hint="write frames: 500")
            found[key] = values
        else:
            coordinate, many, _ = str(key).partition("/")  # many: "/" where there are folds
            if coordinate not in COORDINATES or (many and _folds(str(key)) is None):
                known = f"known coordinates: {', '.join(COORDINATES)}; {FRAMES}, {DATASETS}, and folds such as subject/5"
                raise DatasetError(f"{where} selects by '{key}'", hint=known)
            if isinstance(values, str) or not isinstance(values, Sequence) or not values:
                raise DatasetError(f"{where}: {key} is no list of values", hint=f"write {key}: [a, b]")
            if many and (wrong := [value for value in values if value not in range(1, (_folds(str(key)) or 0) + 1)]):
                raise DatasetError(f"{where}: {key} has no fold {wrong[0]!r}", hint="folds are counted from 1")
            found[str(key)] = tuple(values)
    return found


def _by_dataset(data: Any, where: str) -> dict[str, dict[str, Any] | None]:
    """By the name of a dataset's folder: its own selection, {} for all of its frames, None for none of them."""
    if not isinstance(data, Mapping) or not data:
        raise DatasetError(f"{where}: {DATASETS} names none", hint="write datasets: {own-car: {subject: [A]}, scenes: all}")
    found: dict[str, dict[str, Any] | None] = {}
    for name, selection in data.items():
        if selection in (_ALL, _NONE):
            found[str(name)] = {} if selection == _ALL else None
            continue
        found[str(name)] = parse_selection(selection, f"{where}, {name}")
        if DATASETS in (found[str(name)] or {}):
            raise DatasetError(f"{where}: {name} names datasets itself", hint="name them beside each other")
    return found


def _folds(name: str) -> int | None:
    """How many folds a key such as subject/5 has; None for one of none."""
    many = name.partition("/")[2]
    return int(many) if many.isdecimal() and 2 <= int(many) <= _MOST_FOLDS else None


def _refuse_overlap(splits: Splits, source: Path | str) -> None:
    """Two selections are apart if they share no value of at least one coordinate that both of them name, in every dataset."""
    for (name_a, all_a), (name_b, all_b) in combinations(splits.items(), 2):
        for dataset in ("", *dict.fromkeys((*all_a.get(DATASETS, ()), *all_b.get(DATASETS, ())))):
            a, b = _of(all_a, dataset), _of(all_b, dataset)
            if a is None or b is None:
                continue
            shared = {key: [v for v in a[key] if v in b[key]] for key in a if key in b and key != FRAMES}
            if all(shared.values()):
                common = "; ".join(f"{key} {', '.join(map(str, values))}" for key, values in shared.items())
                where = f" of {dataset}" if dataset else ""
                raise DatasetError(
                    f"{source}: splits '{name_a}' and '{name_b}' overlap" + (f" in {common}" if common else "") + where,
                    hint="give them different values of one coordinate that both name",
                )


def _of(selection: Selection, dataset: str) -> Selection | None:
    """What a selection says of a dataset, by the name of its folder; None: none of its frames."""
    own: Mapping[str, Selection | None] = selection.get(DATASETS, {})
    if dataset in own:
        return own[dataset]
    rest = {key: value for key, value in selection.items() if key != DATASETS}
    return None if own and not rest else rest


def _name(dataset: xr.Dataset) -> str:
    """The name of a dataset's folder; "" of one that was not opened from a folder."""
    return Path(str(dataset.encoding.get("source", ""))).name


def read_splits(path: Path | str, names: Sequence[str] | None = None) -> dict[str, dict[str, Any]]:
    """The splits of a YAML file.

    Parameters
    ----------
    path
        The file.
    names
        Which of them, in this order; None: all.

    Raises
    ------
    DatasetError
        As `parse_splits` does.
    ConfigError
        For a name that is not there.
    """
    from cabinpose.core import read_yaml  # noqa: PLC0415 - a model that runs imports this module, and needs no YAML

    splits = parse_splits(read_yaml(Path(path), hint="give a YAML file of splits", error=DatasetError), path)
    for name in names or ():
        if name not in splits:
            raise unknown_name("split", name, list(splits))
    return splits if names is None else {name: splits[name] for name in names}


def frame_mask(dataset: xr.Dataset, selection: Selection) -> NDArray[np.bool_]:
    """(frame,) whether each frame belongs to a selection; `DatasetError` for a value that the dataset does not have."""
    _refuse_unknown([dataset], selection)
    return _mask(dataset, selection)


def _refuse_unknown(datasets: Sequence[xr.Dataset], selection: Selection) -> None:
    """Each value has to be in one of the datasets that it is said of."""
    said: dict[tuple[str, Any], list[xr.Dataset]] = {}
    for dataset in datasets:
        for name, wanted in (_of(selection, _name(dataset)) or {}).items():
            for value in wanted if name != FRAMES else ():
                said.setdefault((name, value), []).append(dataset)
    lacking: dict[str, list[Any]] = {}
    for (name, value), among in said.items():
        if all(value not in _values(dataset, name) for dataset in among):
            lacking.setdefault(name, []).append(value)
    for name, unknown in lacking.items():
        known = sorted(set().union(*(_values(dataset, name) for dataset in said[name, unknown[0]])))
        which, who = ("the dataset has", "it has") if len(datasets) == 1 else ("the datasets have", "they have")
        raise DatasetError(f"{which} no {name} {', '.join(map(repr, unknown))}", hint=f"{who}: {', '.join(map(str, known))}")


def values_of(dataset: xr.Dataset, coordinate: str) -> set[Any]:
    """The values that frames of a dataset have of a coordinate, without those of nobody."""
    return set(dataset[coordinate].values.ravel().tolist()) - {""}


def _values(dataset: xr.Dataset, name: str) -> set[Any]:
    """The values of a coordinate, or the folds that have some of them."""
    coordinate, _, many = name.partition("/")
    there = values_of(dataset, coordinate)
    return set(_dealt_out(there, int(many)).values()) if many else there


def _dealt_out(values: Collection[Any], many: int) -> dict[Any, int]:
    """The fold of each value, from 1: dealt out to the folds one after the other, in their order."""
    return {value: number % many + 1 for number, value in enumerate(sorted(values))}


def unfolded(selection: Selection, there: Callable[[str], Collection[Any] | None]) -> dict[str, Any]:
    """A selection with the values of its folds in place of the folds.

    Parameters
    ----------
    selection
        Of a single dataset. Where it names several of a coordinate, as values or as folds, what they have in common is taken.
    there
        The values of a coordinate that folds are of, all of them; None: not known yet, and its folds stay folds.

    Returns
    -------
    dict
        By coordinate its values; none, (), where a fold has none.
    """
    found: dict[str, Any] = {}
    for key, wanted in selection.items():
        name, folded, many = key.partition("/")
        if folded and (known := there(name)) is not None:
            folds = _dealt_out(known, int(many))
            members = tuple(value for value, fold in folds.items() if fold in wanted)
        else:
            name, members = key, wanted
        found[name] = members if name not in found else tuple(value for value in members if value in found[name])
    return found


def _mask(dataset: xr.Dataset, selection: Selection) -> NDArray[np.bool_]:
    own = _of(selection, _name(dataset))
    mask = np.full(dataset.sizes["frame"], own is not None)
    for name, wanted in unfolded(own or {}, partial(values_of, dataset)).items():
        if name == FRAMES:
            continue
        values, known = dataset[name].values, values_of(dataset, name)
        # A longer name, cut to the width of the dataset's strings, could become another one: only known values are compared.
        chosen = np.isin(values, np.array([value for value in wanted if value in known], dtype=values.dtype))
        if values.ndim == 2:  # (frame, person)
            absent = values == ""
            mask &= (chosen | absent).all(axis=1) & ~absent.all(axis=1)
        else:
            mask &= chosen
    return mask if own is None or FRAMES not in own else _drawn(mask, own[FRAMES], dataset)


def _drawn(mask: NDArray[np.bool_], count: int, dataset: xr.Dataset) -> NDArray[np.bool_]:
    """(frame,) so many of the frames, always the same ones, and of a greater number the same ones and others."""
    at = np.flatnonzero(mask)
    if 0 < len(at) < count:
        of = f" of {_name(dataset)}" if _name(dataset) else ""
        raise DatasetError(f"{count} frames{of} are asked for, and the split has {len(at)}", hint=f"ask for at most {len(at)}")
    result = np.zeros_like(mask)
    result[at[draw_rng().permutation(len(at))[:count]]] = True
    return result


def draw_rng() -> np.random.Generator:
    """What decides on the order in which frames are drawn: it depends on nothing but their number."""
    return np.random.Generator(np.random.Philox(key=_DRAW))


class HeldOut(NamedTuple):
    """Frames to learn from and to validate on. by: the coordinate whose values were held out, or "frame" · words: what to say
    where the two show the same people; "" where nobody is in both.
    """

    train: xr.Dataset
    validate: xr.Dataset
    by: str
    words: str


def held_out(dataset: xr.Dataset, share: float | None = None) -> HeldOut:
    """Frames to learn from and frames to validate on, with nobody in both wherever that can be.

    The subjects held out are 15 % of them, those last in the order of names; frames that show one of them beside others are in
    neither. Where that leaves one of the two empty, or a share is given, they are those people, always together or alone, whose
    frames are nearest to the share of all. Where everybody is seen with everybody else, a car is held out, or the last sequences,
    or the last frames: these show people that are learnt from.

    Parameters
    ----------
    dataset
        The frames.
    share
        Of the frames that validate, 0 to 1.

    Raises
    ------
    DatasetError
        For a single frame.
    """
    subject = dataset["subject"].values.astype(str)
    people = sorted(people_of(dataset))
    last = people[-max(1, round(_HELD_OUT * len(people))) :]
    wanted = (_HELD_OUT if share is None else share) * len(subject)
    usual = _apart(subject, last)
    if share is None and usual[0].any() and usual[1].any():
        return _cut(dataset, *usual, "subject")
    possible = (_apart(subject, who) for who in _together(subject, people))
    candidates = [sides for sides in possible if sides[0].any() and sides[1].any()]
    if candidates:
        lost = [(~(learnt | judged)).sum() for learnt, judged in candidates]
        best = min(range(len(candidates)), key=lambda i: abs(candidates[i][1].sum() - wanted) + lost[i])
        return _cut(dataset, *candidates[best], "subject")
    for name in ("car", "sequence"):
        values = dataset[name].values
        if len(there := np.unique(values)) > 1:
            by_value = min((values == value for value in there), key=lambda held: abs(held.sum() - wanted))
            return _cut(dataset, ~by_value, by_value, name)
    count = min(max(1, round(wanted)), len(subject) - 1)
    if not count:
        raise DatasetError("a single frame cannot be split into training and validation", hint="give more frames")
    tail = np.arange(len(subject)) >= len(subject) - count
    return _cut(dataset, ~tail, tail, "frame")


def _apart(subject: NDArray[np.str_], who: Sequence[str]) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """(F,) the frames that show none of some people, and those that show nobody else; subject: (F, P)."""
    held, there = np.isin(subject, who), subject != ""
    return np.asarray(~held.any(axis=1)), np.asarray((held | ~there).all(axis=1) & there.any(axis=1))


def _together(subject: NDArray[np.str_], people: Sequence[str]) -> Iterator[list[str]]:
    """People whom one may hold out: everybody alone, and the groups of those who are seen together."""
    yield from ([name] for name in people)
    number = np.searchsorted(people, subject)
    groups = np.arange(len(people))
    for frame, there in zip(number, subject != "", strict=True):
        seen = groups[frame[there]]
        groups[np.isin(groups, seen)] = seen.min(initial=len(people))
    for group in np.unique(groups):
        if (groups == group).sum() > 1:
            yield [people[i] for i in np.flatnonzero(groups == group).tolist()]


def _cut(dataset: xr.Dataset, learnt: NDArray[np.bool_], judged: NDArray[np.bool_], by: str) -> HeldOut:
    """The two sides, and what to say of them."""
    words = ""
    if by != "subject":
        what = "the last frames" if by == "frame" else f"a {by}"
        words = (
            f"nobody can be held out, since everybody is seen beside everybody else: validated on {what} ({judged.sum()} frames)"
            " with people that are learnt from, so that figures are better than on people nobody has seen"
        )
    first, second = (dataset.isel(frame=np.flatnonzero(side)) for side in (learnt, judged))
    return HeldOut(first, second, by, words)


def people_of(dataset: xr.Dataset) -> set[str]:
    """The subjects that appear in a dataset."""
    return {str(name) for name in np.unique(dataset["subject"].values.astype(str)) if name}


class ToldApart(NamedTuple):
    """Splits `test` and `train`, and how many frames belong to neither, since they show values of both."""

    splits: Splits
    left_out: int


def told_apart(dataset: xr.Dataset, chosen: NDArray[np.bool_]) -> ToldApart:
    """Splits by values of one coordinate that have chosen frames in `test` and the others in `train`.

    Parameters
    ----------
    dataset
        All frames.
    chosen
        (F,) which of them are chosen.

    Raises
    ------
    DatasetError
        Where no coordinate tells the frames apart.
    """
    for name in COORDINATES:
        values = dataset[name].values.reshape(len(chosen), -1)
        others = set(values[~chosen].ravel().tolist()) - {""}
        own = set(values[chosen].ravel().tolist()) - others - {""}
        if own and others and np.isin(values[chosen], np.array(sorted(own), values.dtype)).any(axis=1).all():
            splits = {"test": {name: tuple(sorted(own))}, "train": {name: tuple(sorted(others))}}
            sides = [_mask(dataset, selection) for selection in splits.values()]
            if all(side.any() for side in sides):
                return ToldApart(splits, int((~np.logical_or(*sides)).sum()))
    raise DatasetError(
        f"no {', '.join(COORDINATES[:-1])} or {COORDINATES[-1]} tells the chosen frames from the others",
        hint="choose by one of them, or make a dataset of the frames",
    )


def split_dataset(dataset: xr.Dataset, splits: Splits) -> dict[str, xr.Dataset]:
    """The lazy parts of a dataset by split; `DatasetError` where one of them is empty."""
    return {name: parts[0] for name, parts in split_datasets([dataset], splits).items()}


def split_datasets(datasets: Sequence[xr.Dataset], splits: Splits) -> dict[str, list[xr.Dataset]]:
    """The lazy parts of several datasets by split.

    Returns
    -------
    dict
        By the name of the split, a part of each dataset, in their order, without frames where none belongs to the split.

    Raises
    ------
    DatasetError
        For a value that none of them has, and for a split that has no frame in any of them.
    """
    result = {}
    for name, selection in splits.items():
        _refuse_unknown(datasets, selection)
        result[name] = [dataset.isel(frame=np.flatnonzero(_mask(dataset, selection))) for dataset in datasets]
        if not any(part.sizes["frame"] for part in result[name]):
            raise DatasetError(f"no frame belongs to split '{name}'", hint="`cabinpose info` counts the frames by coordinate")
    return result


def frame_ranges(numbers: NDArray[np.integer]) -> str:
    """Numbers of frames (n,), rising, as text: "0-84 90 95-120"."""
    runs = np.split(numbers, np.flatnonzero(np.diff(numbers) != 1) + 1)
    return " ".join(f"{run[0]}-{run[-1]}" if len(run) > 1 else f"{run[0]}" for run in runs if len(run))


def merged_ranges(*by_dataset: Mapping[str, str]) -> dict[str, str]:
    """Ranges of the frames in any of these, by dataset."""
    names = dict.fromkeys(name for each in by_dataset for name in each)
    return {name: " ".join(dict.fromkeys(" ".join(each.get(name, "") for each in by_dataset).split())) for name in names}


def number_at_first(selection: Mapping[str, Any], number: int) -> int:
    """The number that a frame had in the first dataset that it was chosen of; selection: `Manifest.selection` of the last."""
    while selection:
        runs = _runs(selection["frames"]).tolist()
        number = int(np.concatenate([np.arange(first, last + 1) for first, last in runs])[number])
        selection = selection.get("before", {})
    return number


def _runs(ranges: str) -> NDArray[np.int64]:
    """First and last number (n, 2) of each run that `frame_ranges` wrote. Raises ValueError for other text."""
    pairs = [(first, last if dash else first) for first, dash, last in (each.partition("-") for each in ranges.split())]
    try:
        return np.array(pairs, dtype=object).reshape(-1, 2).astype(np.int64)
    except (ValueError, OverflowError) as error:
        raise ValueError(f"no ranges of frames such as '0-84 90': {ranges[:40]!r}") from error


def in_ranges(ranges: str, numbers: NDArray[np.integer]) -> NDArray[np.bool_]:
    """(n,) whether frames, by their numbers, are in ranges as `frame_ranges` writes them. Raises ValueError for other text."""
    first, last = _runs(ranges).T
    order = np.argsort(first, kind="stable")
    reach = np.concatenate(([-1], np.maximum.accumulate(last[order])))
    return np.asarray(numbers <= reach[np.searchsorted(first[order], numbers, "right")])

"""Splits: named selections of frames by their coordinates, kept as YAML, which cannot overlap; and frames by number, as text.

```yaml
train: {subject: [S01, S02, S03], car: [sedan, van]}
test: {subject: [S04]}
```
A frame belongs to a selection if every coordinate that it names has one of the values listed. Of a coordinate that
each person has (`subject`, `action`), all people in the frame need one of them, so that nobody of a test set is
ever seen in training; frames with nobody in them belong to no such selection.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from itertools import combinations
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from cabinpose.core import DatasetError, read_yaml, unknown_name

if TYPE_CHECKING:
    import xarray as xr

COORDINATES = ("subject", "car", "pov", "action", "sequence")

_HELD_OUT = 0.15  # share of the subjects that validate where no splits are given

Selection = Mapping[str, tuple[Any, ...]]
Splits = Mapping[str, Selection]


def parse_splits(data: Any, source: Path | str) -> dict[str, dict[str, tuple[Any, ...]]]:
    """The splits that plain data describes; `DatasetError` for unknown coordinates, empty lists, or overlap."""
    if not isinstance(data, Mapping) or not data:
        raise DatasetError(f"{source} holds no splits", hint="write `name: {coordinate: [values]}`, one line a split")
    splits: dict[str, dict[str, tuple[Any, ...]]] = {}
    for name, selection in data.items():
        if not isinstance(selection, Mapping) or not selection:
            raise DatasetError(f"{source}: split '{name}' selects nothing", hint=f"name some of: {', '.join(COORDINATES)}")
        for coordinate, values in selection.items():
            if coordinate not in COORDINATES:
                raise DatasetError(
                    f"{source}: split '{name}' selects by '{coordinate}'", hint=f"known coordinates: {', '.join(COORDINATES)}"
                )
            if isinstance(values, str) or not isinstance(values, Sequence) or not values:
                raise DatasetError(f"{source}: {name}.{coordinate} is no list of values", hint=f"write {coordinate}: [a, b]")
        splits[str(name)] = {str(key): tuple(values) for key, values in selection.items()}
    _refuse_overlap(splits, source)
    return splits


def _refuse_overlap(splits: Splits, source: Path | str) -> None:
    """Two selections are apart if they share no value of at least one coordinate that both of them name."""
    for (name_a, a), (name_b, b) in combinations(splits.items(), 2):
        shared = {key: [v for v in a[key] if v in b[key]] for key in a if key in b}
        if all(shared.values()):
            common = "; ".join(f"{key} {', '.join(map(str, values))}" for key, values in shared.items())
            raise DatasetError(
                f"{source}: splits '{name_a}' and '{name_b}' overlap" + (f" in {common}" if common else ""),
                hint="give them different values of one coordinate that both name",
            )


def read_splits(path: Path | str, names: Sequence[str] | None = None) -> dict[str, dict[str, tuple[Any, ...]]]:
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
    """Each value has to be in one of the datasets."""
    for name, wanted in selection.items():
        known = sorted(set().union(*(_values(dataset, name) for dataset in datasets)))
        unknown = [value for value in wanted if value not in known]
        if unknown:
            which, who = ("the dataset has", "it has") if len(datasets) == 1 else ("the datasets have", "they have")
            raise DatasetError(f"{which} no {name} {', '.join(map(repr, unknown))}", hint=f"{who}: {', '.join(map(str, known))}")


def _values(dataset: xr.Dataset, name: str) -> set[Any]:
    return {value for value in dataset[name].values.ravel().tolist() if value != ""}


def _mask(dataset: xr.Dataset, selection: Selection) -> NDArray[np.bool_]:
    mask = np.ones(dataset.sizes["frame"], bool)
    for name, wanted in selection.items():
        values, known = dataset[name].values, _values(dataset, name)
        # A longer name, cut to the width of the dataset's strings, could become another one: only known values are compared.
        chosen = np.isin(values, np.array([value for value in wanted if value in known], dtype=values.dtype))
        if values.ndim == 2:  # (frame, person)
            absent = values == ""
            mask &= (chosen | absent).all(axis=1) & ~absent.all(axis=1)
        else:
            mask &= chosen
    return mask


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

"""A segmentation against the pixel classes of a dataset: IoU by part, its mean, and the confusion matrix."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from cabinpose.core import DatasetError, Segmenter, class_table, confusion, images_of, intersection_over_union, whole_person
from cabinpose.evaluate.bootstrap import clusters_of, frame_weights, interval, weighted_sums
from cabinpose.evaluate.offline import BATCH, frame_batch, trained_ranges
from cabinpose.store import in_ranges

NOBODY = "nobody"
_SHOWN = 6


@dataclass(frozen=True)
class PartsValue:
    """One number, in per cent. classes: a class, or what it is over; `low`, `high`: its 95 % interval, NaN without one."""

    metric: str
    classes: str
    value: float
    low: float
    high: float


@dataclass(frozen=True)
class PartsReport:
    """Everything about one segmentation on one dataset.

    classes: (C,) names, the first is nobody · confusion: (C, C) pixels by true class (row) and predicted one (column) · worst:
    numbers of the worst frames by mean IoU, worst first · typical: of those nearest to the median frame · trained_on: how many of
    the frames the model is known to have been trained on.
    """

    model: str
    dataset: str
    frames: int
    classes: tuple[str, ...]
    values: tuple[PartsValue, ...]
    confusion: tuple[tuple[int, ...], ...]
    worst: tuple[int, ...]
    typical: tuple[int, ...]
    trained_on: int = 0

    def value(self, metric: str, classes: str = "") -> float:
        """The number of that name; KeyError if there is none."""
        return {(v.metric, v.classes): v.value for v in self.values}[metric, classes or "parts"]

    def to_dict(self) -> dict[str, Any]:
        """Plain data."""
        return asdict(self)


def evaluate_parts(
    dataset: xr.Dataset, model: Segmenter, *, name: str = "", resamples: int = 1000, seed: int = 0,
    progress: Callable[[int], None] | None = None,
) -> PartsReport:  # fmt: skip
    """The report of one segmentation on a dataset or a selection of it, over all pixels of its frames.

    Parameters
    ----------
    dataset
        An open dataset with pixel classes.
    model
        A segmentation that runs, or its label images. Pixels that it does not see count as nobody.
    name
        What the report calls the dataset.
    resamples, seed
        Of the bootstrap over sequences and single frames; 0: no intervals.
    progress
        Called with the number of frames done.

    Returns
    -------
    PartsReport
        With the thesis' mean over the parts (SE4), and the IoU of people as a whole.

    Raises
    ------
    DatasetError
        Where the dataset has no pixel classes.
    """
    classes = (NOBODY, *(part.name for part in model.parts))
    count = len(classes)
    counts = []
    for truth, answer in pairs(dataset, model, progress):
        counts += [confusion(t, a, count) for t, a in zip(truth, answer, strict=True)]
    each = np.stack(counts)  # (F, C, C)
    drawn_with = clusters_of(*(dataset[name].values.astype(np.int64) for name in ("sequence", "sync_ns")))
    weights = frame_weights(drawn_with, resamples, rng=np.random.Generator(np.random.Philox(key=seed)))
    drawn = weighted_sums(weights, each.reshape(len(each), -1).astype(np.float64)).reshape(-1, count, count)
    totals = np.concatenate((each.sum(axis=0)[None].astype(np.float64), drawn))
    iou = intersection_over_union(totals)
    shares = {("IoU", classes[i]): column for i, column in enumerate(iou.T)}
    shares |= {
        ("mean IoU", "parts"): _mean(iou[:, 1:]),
        ("mean IoU", "parts and nobody"): _mean(iou),
        ("IoU", "people"): intersection_over_union(whole_person(totals))[:, 1],
        ("pixels right", "all"): np.trace(totals, axis1=1, axis2=2) / totals.sum(axis=(1, 2)),
    }
    lows, highs = interval(np.stack([values[1:] for values in shares.values()], axis=1))
    numbers = zip(shares.items(), lows.tolist(), highs.tolist(), strict=True)
    values = tuple(PartsValue(*what, float(100 * v[0]), 100 * low, 100 * high) for (what, v), low, high in numbers)
    known = np.flatnonzero(each[:, 1:, 1:].sum(axis=(1, 2)) + each[:, 1:, 0].sum(axis=1) > 0)  # frames that show somebody
    order = known[np.argsort(_mean(intersection_over_union(each[known])[:, 1:]), kind="stable")]
    ranked = dataset["frame"].values[order].tolist()
    middle = max(len(ranked) - _SHOWN, 0) // 2
    return PartsReport(
        model.name, name, len(each), classes, values, tuple(map(tuple, each.sum(axis=0).tolist())),
        worst=tuple(ranked[:_SHOWN]), typical=tuple(ranked[middle : middle + _SHOWN]),
        trained_on=int(in_ranges(trained_ranges(model, dataset), dataset["frame"].values).sum()),
    )  # fmt: skip


def pairs(
    dataset: xr.Dataset, model: Segmenter, progress: Callable[[int], None] | None = None
) -> Iterator[tuple[NDArray[np.uint8], NDArray[np.uint8]]]:
    """The true label images (N, H, W) of some frames after the others, and a segmentation's; DatasetError without true ones."""
    if "labels" not in dataset:
        raise DatasetError("the dataset has no pixel classes (labels)", hint="`cabinpose synth` writes them")
    table = class_table(model.parts)
    frames = dataset.sizes["frame"]
    for start in range(0, frames, BATCH):
        which = slice(start, start + BATCH)
        yield table[dataset["labels"].isel(frame=which).values], model.segment(frame_batch(dataset, which, images_of(model)))
        if progress is not None:
            progress(min(start + BATCH, frames))


def _mean(values: NDArray[np.float64]) -> NDArray[np.float64]:
    """(N,) means of rows (N, C) over what is known; NaN where nothing is."""
    known = np.isfinite(values)
    counted = known.sum(axis=-1)
    return np.where(counted > 0, np.where(known, values, 0).sum(axis=-1) / np.maximum(counted, 1), np.nan)

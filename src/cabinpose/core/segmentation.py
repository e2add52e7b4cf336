"""Classes of pixels: parts that merge classes of a dataset, and how well two label images agree."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray


class Part(NamedTuple):
    """A class of a segmentation and the ids of the dataset's classes (`scene.labels`) that belong to it."""

    name: str
    ids: tuple[int, ...]


def class_table(parts: Sequence[Part]) -> NDArray[np.uint8]:
    """(256,) by a pixel's class in the dataset: 0 = nobody, else 1 + the position of its part."""
    table = np.zeros(256, dtype=np.uint8)
    for number, part in enumerate(parts, 1):
        table[list(part.ids)] = number
    return table


def confusion(truth: NDArray[Any], predicted: NDArray[Any], classes: int) -> NDArray[np.int64]:
    """(classes, classes) pixels by their true class (row) and the predicted one (column)."""
    pairs = truth.astype(np.int64).ravel() * classes + predicted.astype(np.int64).ravel()
    return np.bincount(pairs, minlength=classes * classes).reshape(classes, classes)


def intersection_over_union(counts: NDArray[Any]) -> NDArray[np.float64]:
    """(..., C) IoU of each class (Jaccard index) from confusion matrices (..., C, C); NaN for one neither there nor predicted."""
    both = np.diagonal(counts, axis1=-2, axis2=-1).astype(np.float64)
    union = counts.sum(axis=-2) + counts.sum(axis=-1) - both
    return np.where(union > 0, both / np.where(union > 0, union, 1), np.nan)


def whole_person(counts: NDArray[Any]) -> NDArray[Any]:
    """(..., 2, 2) confusion matrices of nobody and somebody, from those of nobody and the parts (..., C, C)."""
    rows = np.stack((counts[..., 0, :], counts[..., 1:, :].sum(axis=-2)), axis=-2)
    return np.stack((rows[..., 0], rows[..., 1:].sum(axis=-1)), axis=-1)

"""Parts on a tree: what a model knows of them, and the best placement of all of them together.

The score of a placement is a sum of filter responses, springs between a part and its parent, and a bias for each pair of
their types (Yang and Ramanan 2013, eq. 5). Its maximum over all positions and types is found exactly, from the leaves to the
root, with a generalised distance transform for each type of each part (Felzenszwalb and Huttenlocher 2005 and 2012).
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from cabinpose._native import dpm as native
from cabinpose.estimate.dpm.config import DpmConfig
from cabinpose.estimate.dpm.hog import F32, channels, responses

SPRING = 0.1  # of the squared displacement, in spreads: keeps its weight comparable with those of the filters
_SOFTEST = 0.02  # least weight of a squared displacement: a spring never pushes


class Parts(NamedTuple):
    """A model of P parts of T types each.

    weights: (P, T, K) float32, K = s² C + 4 + T: filter (s, s, C), spring (x², x, y², y) and bias with each type of the parent;
    the root has neither spring nor parent, and its bias is the first · anchor, spread: (P, T, 2) where a type lies from its
    parent, cells x and y, and the standard deviation of that · shift: (P, T, 2) cells from where a part is found to where it is,
    the median · ahead: (P, T, 2) m, how far a part lies behind its parent along the view, median and standard deviation · skin:
    (P, T, 2) m, the same from the surface to the part · levels: (L,) m, depths of the pyramid · slots: (S, 3) m, mean place of
    the root in the camera frame by slot, NaN where nobody was.
    """

    weights: F32
    anchor: NDArray[np.float64]
    spread: NDArray[np.float64]
    shift: NDArray[np.float64]
    ahead: NDArray[np.float64]
    skin: NDArray[np.float64]
    levels: NDArray[np.float64]
    slots: NDArray[np.float64]

    @classmethod
    def of(cls, arrays: Mapping[str, NDArray[Any]], config: DpmConfig) -> Parts:
        """A model from arrays by name. Raises KeyError for one that lacks, ValueError for a shape that does not fit."""
        parts, types, k = len(config.tree.parent), config.mixtures, row_length(config)
        shapes = dict.fromkeys(("anchor", "spread", "shift", "ahead", "skin"), (parts, types, 2)) | {
            "weights": (parts, types, k), "levels": (max(arrays["levels"].size, 1),), "slots": (len(config.slots), 3),
        }  # fmt: skip
        for name, shape in shapes.items():
            if arrays[name].shape != shape or arrays[name].dtype.kind != "f":
                raise ValueError(f"{name} is {arrays[name].dtype} {arrays[name].shape} where numbers {shape} are expected")
            if name != "slots" and not np.isfinite(arrays[name]).all():
                raise ValueError(f"{name} has values that are no numbers")
        if not all(
            (values > 0).all() for values in (arrays["levels"], arrays["spread"], arrays["ahead"][..., 1], arrays["skin"][..., 1])
        ):
            raise ValueError("levels and standard deviations are above zero")
        weights, *rest = (arrays[name] for name in cls._fields)
        return cls(weights.astype(np.float32), *(values.astype(np.float64) for values in rest))

    def filters(self, config: DpmConfig) -> F32:
        """(P T, s, s, C) the filters."""
        size = config.filter_cells
        flat = self.weights[..., : size * size * channels(config)]
        return flat.reshape(-1, size, size, channels(config))

    def springs(self, part: int) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Springs (T, 4) of a part's types as `spring_transform` takes them, and what they add (T,)."""
        types = self.weights.shape[1]
        weight = SPRING * self.weights[part, :, -types - 4 : -types].astype(np.float64)
        made, added = np.empty((types, 4)), np.zeros(types)
        for axis in range(2):
            square = np.maximum(weight[:, 2 * axis], SPRING * _SOFTEST)
            linear, spread = weight[:, 2 * axis + 1], self.spread[part, :, axis]
            made[:, 2 * axis] = square / spread**2
            made[:, 2 * axis + 1] = self.anchor[part, :, axis] - 0.5 * linear / square * spread
            added += 0.25 * linear**2 / square
        return made, added

    def pair_bias(self, part: int) -> F32:
        """(T, T) bias of a part's type with its parent's; (T, 1) of the root's."""
        types = self.weights.shape[1]
        bias = self.weights[part, :, -types:]
        return bias if part else bias[:, :1]


class Placement(NamedTuple):
    """score · positions: (P, 2) cells x and y · types: (P,)."""

    score: float
    positions: NDArray[np.int64]
    types: NDArray[np.int64]


class Beliefs(NamedTuple):
    """What the leaves have told, see `upward`: maps (T, rows, columns) of every part.

    belief: the best score of a part and all beyond it, by its type and place · type_of: the part's best type, by its parent's
    type and place · source: where it is best, a flat index, by its own type and its parent's place.
    """

    belief: list[F32]
    type_of: list[NDArray[np.int8]]
    source: list[NDArray[np.int32]]


def row_length(config: DpmConfig) -> int:
    """K: numbers that describe one part of one type in its place."""
    return config.filter_cells**2 * channels(config) + 4 + config.mixtures


def unary(parts: Parts, config: DpmConfig, described: F32) -> F32:
    """(P, T, rows, columns) responses of every filter on a level that `hog.features` describes."""
    maps = responses(described, parts.filters(config))
    return maps.reshape(*parts.weights.shape[:2], *maps.shape[1:])


def upward(parts: Parts, parent: NDArray[np.int64], scores: F32) -> Beliefs:
    """Max-sum from the leaves to the root, from the parts' own scores (P, T, rows, columns); biases and springs are added."""
    count, types = scores.shape[:2]
    belief = list(scores.copy())
    type_of: list[NDArray[np.int8]] = [np.zeros(0, np.int8)] * count
    source: list[NDArray[np.int32]] = [np.zeros(0, np.int32)] * count
    for part in range(count - 1, 0, -1):
        best, source[part] = np.empty_like(belief[part]), np.empty(belief[part].shape, np.int32)
        spring, added = parts.springs(part)
        native.spring_transform(belief[part], spring, best, source[part])
        best += added.astype(np.float32)[:, None, None]
        bias = parts.pair_bias(part)
        message = best[0] + bias[0, :, None, None]
        chosen = np.zeros(message.shape, np.int8)
        for t in range(1, types):
            other = best[t] + bias[t, :, None, None]
            chosen[other > message] = t
            np.maximum(message, other, out=message)
        type_of[part] = chosen
        belief[parent[part]] += message
    belief[0] += parts.pair_bias(0)[:, :, None]
    return Beliefs(belief, type_of, source)


def downward(beliefs: Beliefs, parent: NDArray[np.int64], root: tuple[int, int, int]) -> Placement:
    """The best placement of all parts with the root's type, row and column given."""
    count, columns = len(parent), beliefs.belief[0].shape[2]
    positions, types = np.empty((count, 2), np.int64), np.empty(count, np.int64)
    types[0], positions[0] = root[0], root[:0:-1]
    for part in range(1, count):
        x, y = positions[parent[part]]
        types[part] = beliefs.type_of[part][types[parent[part]], y, x]
        at = beliefs.source[part][types[part], y, x]
        positions[part] = at % columns, at // columns
    return Placement(float(beliefs.belief[0][root]), positions, types)


def rows(parts: Parts, config: DpmConfig, described: F32, positions: NDArray[np.int64], types: NDArray[np.int64]) -> F32:
    """(P, K) what a placement shows of each part: its score is the sum of these times the weights of the parts' types."""
    size, tree = config.filter_cells, config.tree
    made = np.zeros((len(types), row_length(config)), np.float32)
    windows = np.lib.stride_tricks.sliding_window_view(described, (size, size), axis=(0, 1))
    patches = windows[positions[:, 1], positions[:, 0]].transpose(0, 2, 3, 1)  # (P, s, s, C)
    made[:, : size * size * channels(config)] = patches.reshape(len(types), -1)
    part = np.arange(1, len(types))
    away = positions[part] - positions[tree.parent[part]] - parts.anchor[part, types[part]]
    away /= parts.spread[part, types[part]]
    first = size * size * channels(config)
    made[1:, first : first + 4] = -SPRING * np.stack((away[:, 0] ** 2, away[:, 0], away[:, 1] ** 2, away[:, 1]), axis=1)
    made[part, first + 4 + types[tree.parent[part]]] = 1.0
    made[0, first + 4] = 1.0
    return made

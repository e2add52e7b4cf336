"""Which predicted person is which true one: by slot, or by the best assignment for methods that know no slots."""

from __future__ import annotations

import warnings
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from cabinpose.core import PoseBatch, PredictionsError
from cabinpose.evaluate.oks import oks
from cabinpose.evaluate.options import Matching

MIN_OKS = 0.1  # pairs of a lower one are not matched
MAX_DISTANCE_M = 0.5  # mean over the joints that both have
Places = NDArray[np.int64]  # (F, R): which predicted person stands in each of R rows, -1 = none


def slot_places(frames: int, true: Sequence[str], predicted: Sequence[str]) -> Places:
    """Predicted people by the names of their slots, a row for each true slot; `PredictionsError` for an unknown slot."""
    if unknown := [name for name in predicted if name not in true]:
        raise PredictionsError(
            f"the dataset has no slot {', '.join(unknown)}",
            hint=f"its slots are {', '.join(true)}; for a method that knows no slots use --match oks or --match distance",
        )
    row = np.array([predicted.index(name) if name in predicted else -1 for name in true], np.int64)
    return np.broadcast_to(row, (frames, len(true)))


def assigned_places(
    how: Matching, true_2d: NDArray[np.float32], true_3d: NDArray[np.float32], area: NDArray[np.float64],
    sigma: NDArray[np.float64], predicted: PoseBatch,
) -> Places:  # fmt: skip
    """The assignment of the highest total OKS, or the least total mean distance (Kuhn 1955, "Hungarian method").

    true_2d, true_3d: (F, T, J, 2 or 3), NaN where absent · area: (F, T) px². The first T rows are the true people, the P
    behind them hold predicted people that match nobody.
    """
    from scipy.optimize import linear_sum_assignment  # noqa: PLC0415 - it imports for a second; most are matched by their seats

    frames, people = true_2d.shape[:2]
    count = predicted.score.shape[1]
    places = np.full((frames, people + count), -1, np.int64)
    for f in range(frames):
        some_true = np.flatnonzero(np.isfinite(true_2d[f]).any(axis=(1, 2)) | np.isfinite(true_3d[f]).any(axis=(1, 2)))
        found = np.isfinite(predicted.joints_2d[f]).any(axis=(1, 2)) | np.isfinite(predicted.joints_3d[f]).any(axis=(1, 2))
        some = np.flatnonzero(found)
        left = set(some.tolist())
        if how == "oks":
            labelled = np.isfinite(true_2d[f, some_true]).all(axis=-1)
            likeness = oks(predicted.joints_2d[f, some], true_2d[f, some_true], labelled, area[f, some_true], sigma)
            least = MIN_OKS
        else:
            likeness = -_mean_distances(predicted.joints_3d[f, some], true_3d[f, some_true])
            least = -MAX_DISTANCE_M
        good = likeness >= least
        # what is too far apart costs more than all good pairs together: as many good pairs as can be, then the best of them
        worst = 1 + 2 * abs(least) * max(likeness.shape) + likeness.size
        for d, t in zip(*linear_sum_assignment(np.where(good, -likeness, worst)), strict=True):
            if good[d, t]:
                places[f, some_true[t]] = some[d]
                left.discard(int(some[d]))
        places[f, people : people + len(left)] = sorted(left)
    return places


def _mean_distances(predicted: NDArray[np.float32], true: NDArray[np.float32]) -> NDArray[np.float64]:
    """(D, T) mean distance over the joints that both have, m; infinite where there is none."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # nanmean of joints that neither has
        mean = np.nanmean(np.linalg.norm(predicted[:, None] - true[None], axis=-1), axis=-1)
    return np.nan_to_num(mean.astype(np.float64), nan=np.inf)


def placed(batch: PoseBatch, places: Places) -> PoseBatch:
    """The batch with its people in the rows that `places` (F, R) gives them; empty rows have found nothing."""
    rows = np.arange(len(places))[:, None]
    empty = places < 0

    def pick(values: NDArray[np.float32]) -> NDArray[np.float32]:
        if not values.shape[1]:
            values = np.zeros((len(values), 1, *values.shape[2:]), values.dtype)
        chosen = values[rows, places]
        chosen[empty] = np.nan if values.ndim == 4 else 0.0  # a position, or a number of a joint
        return chosen

    return batch.map(pick)

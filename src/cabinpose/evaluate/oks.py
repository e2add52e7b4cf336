"""Object keypoint similarity, and average precision over it, as COCO defines them (cocodataset.org, keypoint evaluation)."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

THRESHOLDS = np.linspace(0.5, 0.95, 10)  # of the OKS
_RECALLS = np.linspace(0.0, 1.0, 101)
_MAX_DETECTIONS = 20  # a frame, the best by score


def oks(predicted: Array, true: Array, labelled: NDArray[np.bool_], area: Array, sigma: Array, box: Array | None = None) -> Array:
    """Object keypoint similarity of predicted and true people.

    The mean over the labelled joints of exp(-d² / (2 s² k²)), with s² the person's area and k = 2 sigma. Of a person without a
    labelled joint, d is the distance of all joints to their box, enlarged to three times its size, as COCO's own code does.

    Parameters
    ----------
    predicted
        (D, J, 2) px; a joint without a prediction (NaN) counts as 0.
    true
        (G, J, 2) px.
    labelled
        (G, J) which joints count.
    area
        (G,) px².
    sigma
        (J,) the joints' falloffs.
    box
        (G, 4) left, top, width, height in px; None: the similarity to people without a labelled joint is 0.

    Returns
    -------
    NDArray
        (D, G), 0 to 1.
    """
    squared = ((predicted[:, None] - true[None]) ** 2).sum(axis=-1)  # (D, G, J)
    if box is not None:
        corner, size = box[None, :, None, :2], box[None, :, None, 2:]
        beyond = np.maximum(corner - size - predicted[:, None], 0) + np.maximum(predicted[:, None] - corner - 2 * size, 0)
        bare = np.asarray(~labelled.any(axis=-1))
        squared = np.where(bare[None, :, None], (beyond**2).sum(axis=-1), squared)
        labelled = labelled | bare[:, None]
    exponent = squared / (2 * sigma) ** 2 / (area[None, :, None] + np.spacing(1)) / 2
    similar = np.where(labelled[None] & np.isfinite(exponent), np.exp(-np.nan_to_num(exponent, nan=np.inf, posinf=np.inf)), 0.0)
    return similar.sum(axis=-1) / np.maximum(labelled.sum(axis=-1), 1)[None]


class Detections(NamedTuple):
    """Predicted people, matched: D of them over some frames.

    frame: (D,) position of the frame · score: (D,) · hit: (D, 10) whether it matches a true person at each threshold ·
    ignored: (D, 10) whether it matches one that does not count · true: (frames,) true people that count.
    """

    frame: NDArray[np.int64]
    score: Array
    hit: NDArray[np.bool_]
    ignored: NDArray[np.bool_]
    true: NDArray[np.int64]


def match_frame(
    similarity: Array, score: Array, counts: NDArray[np.bool_]
) -> tuple[NDArray[np.int64], NDArray[np.bool_], NDArray[np.bool_]]:
    """COCO's greedy matching in one frame of D predicted and G true people, of whom those with `counts` (G,) count.

    Returns the predictions in falling order of score, at most 20, as indices (D'), and `hit`, `ignored` (D', 10) for them.
    """
    order = np.argsort(-score, kind="mergesort")[:_MAX_DETECTIONS]
    true_order = np.argsort(~counts, kind="mergesort")  # those that count first
    hit = np.zeros((len(order), len(THRESHOLDS)), bool)
    ignored = np.zeros_like(hit)
    for t, threshold in enumerate(THRESHOLDS):
        taken = np.zeros(len(counts), bool)
        for row, d in enumerate(order):
            best, match = min(threshold, 1 - 1e-10), -1
            for g in true_order:
                if taken[g]:
                    continue
                if match >= 0 and counts[match] and not counts[g]:
                    break
                if similarity[d, g] >= best:
                    best, match = similarity[d, g], int(g)
            if match >= 0:
                taken[match] = True
                hit[row, t], ignored[row, t] = counts[match], not counts[match]
    return order, hit, ignored


def average_precision(detections: Detections, weights: NDArray[np.int64] | None = None) -> Array:
    """(10,) average precision at each threshold of the OKS: precision at 101 recalls, averaged; NaN without true people.

    weights: (frames,) how often each frame counts, for resampling.
    """
    weights = np.ones(len(detections.true), np.int64) if weights is None else weights
    people = int(weights @ detections.true)
    if people == 0:
        return np.full(len(THRESHOLDS), np.nan)
    order = np.argsort(-detections.score, kind="mergesort")
    weight = weights[detections.frame[order]][:, None]
    hits = np.cumsum(weight * detections.hit[order], axis=0)
    misses = np.cumsum(weight * ~(detections.hit | detections.ignored)[order], axis=0)
    result = np.zeros(len(THRESHOLDS))
    for t in range(len(THRESHOLDS)):
        precision = hits[:, t] / (hits[:, t] + misses[:, t] + np.spacing(1))
        envelope = np.maximum.accumulate(precision[::-1])[::-1]
        at = np.searchsorted(hits[:, t] / people, _RECALLS, side="left")
        result[t] = np.append(envelope, 0.0)[np.minimum(at, len(envelope))].mean()
    return result

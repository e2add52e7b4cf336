"""From the maps of the part affinity fields to people in their places; numpy, the same for torch and ONNX Runtime."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cabinpose.estimate.found import Found, sigmoid
from cabinpose.estimate.paf.assemble import Peaks, assemble, find_peaks
from cabinpose.estimate.paf.config import PafConfig

_STRIDE = 8
_SPARE = 2  # peaks of one joint that are looked at beyond one for each place
WINDOW = 2  # the surface around a joint is read within so many pixels


def decode(outputs: Mapping[str, NDArray[Any]], config: PafConfig, seen: Mapping[str, NDArray[Any]]) -> Found:
    """Joints of the people in N frames.

    outputs: fields (N, 2C, h, w), heat (N, J + 1, h, w) and presence (N, J, K) logits, the first of absence · seen: depth (N, H,
    W) of the view, m, 0 = invalid. A joint's place in the image is its peak; its depth that of the surface there and the joint's
    offset from the skin, NaN where nothing was measured. People go to the places whose anchors their necks are nearest to.
    """
    fields, heat = (np.asarray(outputs[name], dtype=np.float64) for name in ("fields", "heat"))
    logits = np.asarray(outputs["presence"], dtype=np.float64)
    # One minus the softmax of absence; without the branch every joint may be there.
    there = np.asarray(sigmoid(np.logaddexp.reduce(logits[..., 1:], axis=-1) - logits[..., 0]))
    if not config.presence_labels:
        there = np.ones_like(there)
    n, slots, joints = len(heat), len(config.slots), len(config.joints)
    uv, score = np.full((n, slots, joints, 2), np.nan), np.zeros((n, slots, joints))
    for i in range(n):
        found = find_peaks(heat[i, :joints], config.peak, slots + _SPARE)
        peaks = [p if there[i, j] >= config.presence else Peaks.none() for j, p in enumerate(found)]
        people = _single(peaks) if slots == 1 else assemble(peaks, fields[i], config.joint_set.limbs, config.affinity)
        people = people[(people >= 0).sum(axis=1) >= config.min_joints]
        _place(people, peaks, config, uv[i], score[i])
    answered = np.isfinite(uv[..., 0])
    depth = surface_depth(np.asarray(seen["depth"]), uv) + np.array(config.offsets_m)
    presence = np.where(answered, there[:, None], 0.0)
    return Found(uv, config.view.from_view(np.concatenate((uv, depth[..., None]), axis=-1)), presence * score, presence)


def _single(peaks: list[Peaks]) -> NDArray[np.int64]:
    """The thesis' reading, for one person in the image: the greatest peak of every joint."""
    return np.array([[0 if len(p.height) else -1 for p in peaks]], dtype=np.int64)


def _place(
    people: NDArray[np.int64], peaks: list[Peaks], config: PafConfig, uv: NDArray[np.float64], score: NDArray[np.float64]
) -> None:
    """Fill uv (S, J, 2), px of the view, and score (S, J) with people (P, J), rows of their joints' peaks or -1."""
    joints = np.full((*people.shape, 2), np.nan)
    height = np.zeros(people.shape)
    for j, p in enumerate(peaks):
        has = people[:, j] >= 0
        joints[has, j] = p.xy[people[has, j]] * _STRIDE + (_STRIDE - 1) / 2
        height[has, j] = p.height[people[has, j]]
    for person, slot in slots_of(joints, height.sum(axis=1), config):
        uv[slot], score[slot] = joints[person], height[person]


def slots_of(uv: NDArray[np.float64], score: NDArray[np.float64], config: PafConfig) -> list[tuple[int, int]]:
    """Pairs (person, place) for people with joints uv (P, J, 2), NaN where not found, and score (P,).

    The best-scored people, as many as there are anchors, go to the places with the least sum of distances between their
    necks (without one, the mean of their joints) and the places' anchors. Without anchors they fill the places in order of
    their score.
    """
    order = np.argsort(-score, kind="stable")
    if config.slot_anchors is None:
        return [(int(person), slot) for slot, person in enumerate(order[: len(config.slots)])]
    places = [slot for slot in config.slots if slot in config.slot_anchors]
    order = order[: len(places)]
    if not len(order):
        return []
    neck = uv[order, config.joints.index(config.joint_set.spine[0])]
    at = np.where(np.isfinite(neck), neck, np.nanmean(uv[order], axis=1))
    anchors = np.array([config.slot_anchors[slot] for slot in places])
    from scipy.optimize import linear_sum_assignment  # noqa: PLC0415 - takes longer to import than all else here

    rows, columns = linear_sum_assignment(np.linalg.norm(at[:, None] - anchors, axis=-1))
    return [(int(order[r]), config.slots.index(places[c])) for r, c in zip(rows, columns, strict=True)]


def surface_depth(depth: NDArray[Any], uv: NDArray[np.float64]) -> NDArray[np.float64]:
    """Median of the valid depths in the 5x5 pixels around joints uv (N, ..., 2) of depth images (N, H, W), m; NaN where none."""
    h, w = depth.shape[1:]
    result = np.full(uv.shape[:-1], np.nan)
    inside = np.isfinite(uv).all(-1) & (uv > -0.5).all(-1) & (uv[..., 0] < w - 0.5) & (uv[..., 1] < h - 0.5)
    frame = np.nonzero(inside)[0]
    columns, rows = np.round(uv[inside]).astype(int).T[:, :, None] + np.arange(-WINDOW, WINDOW + 1)  # (joints, 5) each
    there = ((rows >= 0) & (rows < h))[:, :, None] & ((columns >= 0) & (columns < w))[:, None]
    windows = depth[frame[:, None, None], np.clip(rows, 0, h - 1)[:, :, None], np.clip(columns, 0, w - 1)[:, None]]
    valid = there & (windows > 0)
    values = np.sort(np.where(valid, windows, np.inf).reshape(len(frame), (2 * WINDOW + 1) ** 2), axis=1)
    count = valid.sum(axis=(1, 2))
    some = np.arange(len(frame))
    middle = (values[some, np.maximum(count - 1, 0) // 2], values[some, count // 2])
    result[inside] = np.where(count > 0, (middle[0] + middle[1]) / 2, np.nan)
    return result

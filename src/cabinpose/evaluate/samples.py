"""From chunks of frames to samples: one row for each person in a frame, true or predicted, with the errors of every joint.

Only these rows are kept (about 60 bytes a joint), never an image, so that a dataset may be larger than memory.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, fields

import numpy as np
from numpy.typing import NDArray

from cabinpose.core.errors import PredictionsError
from cabinpose.core.ports import PoseBatch
from cabinpose.core.pose import Visibility
from cabinpose.evaluate import errors
from cabinpose.evaluate.matching import assigned_places, placed, slot_places
from cabinpose.evaluate.oks import Detections, match_frame, oks
from cabinpose.evaluate.options import THESIS_HEAD_M, THESIS_HEAD_PX, EvaluationOptions
from cabinpose.evaluate.skeletons import EvaluatedSkeleton

Float = NDArray[np.float32]
Bool = NDArray[np.bool_]


@dataclass(frozen=True)
class TruthChunk:
    """The reference of F frames of P slots and J joints.

    frame: (F,) numbers · joints_2d: (F, P, J, 2) px · joints_3d: (F, P, J, 3) m, camera frame, NaN = absent ·
    visibility: (F, P, J) `Visibility` · sequence, sync_ns: (F,) frames of one sequence with numbers in a row and rising times
    follow each other.
    """

    frame: NDArray[np.int64]
    joints_2d: Float
    joints_3d: Float
    visibility: NDArray[np.uint8]
    sequence: NDArray[np.int64]
    sync_ns: NDArray[np.int64]


@dataclass(frozen=True)
class Space:
    """Errors of S samples in one space, px or m, all (S, J), NaN where there is nothing to measure.

    found: whether the joint was found here · error: its distance to the truth · swap: 1 or 0 at the left joint of a pair ·
    jitter: acceleration error a frame² · aligned, bone: in 3D only · head: (S,) head size.
    """

    found: Bool
    error: Float
    aligned: Float
    bone: Float
    swap: Float
    jitter: Float
    head: Float


@dataclass(frozen=True)
class Samples:
    """S samples over F frames, by rising frame, and the predicted people of each frame matched as COCO does.

    frames: (F,) numbers · at: (S,) position of the sample's frame in `frames` · counts: (S, J) joints that count ·
    absent: (S, J) joints that a right prediction leaves out · visibility: (S, J) · found: (S, J) · true, predicted: (S,)
    whether the person is there ·
    oks: (S,). A joint that neither counts nor is absent is hidden too well: it is neither right nor wrong.
    """

    skeleton: EvaluatedSkeleton
    frames: NDArray[np.int64]
    at: NDArray[np.int64]
    visibility: NDArray[np.uint8]
    counts: Bool
    absent: Bool
    found: Bool
    true: Bool
    predicted: Bool
    oks: Float
    px: Space
    m: Space
    detections: Detections


@dataclass
class _Collector:
    skeleton: EvaluatedSkeleton
    options: EvaluationOptions
    frames: list[NDArray[np.int64]] = field(default_factory=list)
    rows: list[dict[str, NDArray[np.generic]]] = field(default_factory=list)
    px: list[Space] = field(default_factory=list)
    m: list[Space] = field(default_factory=list)
    detections: list[Detections] = field(default_factory=list)
    seen: int = 0
    tail: dict[str, NDArray[np.generic]] = field(default_factory=dict)  # of the last two frames, for jitter


def collect(
    chunks: Iterable[tuple[TruthChunk, PoseBatch]],
    skeleton: EvaluatedSkeleton,
    persons: Sequence[str],
    predicted_persons: Sequence[str],
    options: EvaluationOptions,
) -> Samples:
    """Errors of all chunks. Truth and predictions have the joints of `skeleton`, in its order.

    Raises `PredictionsError` where predictions name slots that the dataset does not have, or there are no frames.
    """
    state = _Collector(skeleton, options)
    for truth, batch in chunks:
        _add(state, truth, batch, persons, predicted_persons)
    if not state.frames:
        raise PredictionsError("there are no frames to evaluate", hint="choose another split or selection")
    rows = {name: np.concatenate([row[name] for row in state.rows]) for name in state.rows[0]}
    return Samples(
        skeleton,
        np.concatenate(state.frames),
        px=_joined(state.px),
        m=_joined(state.m),
        detections=Detections(*(np.concatenate([getattr(d, f.name) for d in state.detections]) for f in fields(Detections))),
        **rows,
    )


def _joined(spaces: list[Space]) -> Space:
    return Space(*(np.concatenate([getattr(space, f.name) for space in spaces]) for f in fields(Space)))


def _add(
    state: _Collector, truth: TruthChunk, batch: PoseBatch, persons: Sequence[str], predicted_persons: Sequence[str]
) -> None:
    options, skeleton = state.options, state.skeleton
    frames, slots, _ = truth.visibility.shape
    box = _boxes(truth.joints_2d)  # (F, P, 4)
    batch = _found_only(batch, options.presence)
    if options.match == "slot":
        places = slot_places(frames, persons, predicted_persons)
    else:
        places = assigned_places(
            options.match, truth.joints_2d, truth.joints_3d, box[..., 2:].prod(axis=-1), skeleton.sigma, batch
        )
    batch = placed(batch, places)
    extra = places.shape[1] - slots
    visibility = np.pad(truth.visibility, ((0, 0), (0, extra), (0, 0)))
    true_2d, true_3d = (
        np.pad(x, ((0, 0), (0, extra), (0, 0), (0, 0)), constant_values=np.nan) for x in (truth.joints_2d, truth.joints_3d)
    )
    box = np.pad(box, ((0, 0), (0, extra), (0, 0)))
    area = box[..., 2:].prod(axis=-1)
    heads = _head_sizes(true_2d, THESIS_HEAD_PX, state), _head_sizes(true_3d, THESIS_HEAD_M, state)

    counts = visibility >= options.min_visibility
    outside = (visibility == Visibility.OUTSIDE_IMAGE) & (options.min_visibility > Visibility.OUTSIDE_IMAGE)
    true_2d, true_3d = (np.where(counts[..., None], x, np.nan) for x in (true_2d, true_3d))
    found_2d, found_3d = (errors.finite(x) for x in (batch.joints_2d, batch.joints_3d))
    found = found_2d | found_3d
    true = np.asarray((visibility > Visibility.ABSENT).any(axis=-1))
    predicted = np.asarray(found.any(axis=-1))
    f, p = np.nonzero(true | predicted)

    similarity = np.zeros((frames, places.shape[1]), np.float32)
    for i in range(frames):
        matrix = oks(batch.joints_2d[i], true_2d[i], counts[i], area[i], skeleton.sigma, box[i])
        similarity[i] = np.diagonal(matrix)
        state.detections.append(_detections(state.seen + i, matrix, batch.score[i], found_2d[i], true[i], counts[i].any(axis=-1)))
    offsets_2d, offsets_3d = batch.joints_2d - true_2d, batch.joints_3d - true_3d
    jitter_2d, jitter_3d = _jitter(state, truth, offsets_2d, offsets_3d)
    state.px.append(_space(state, batch.joints_2d[f, p], true_2d[f, p], found_2d[f, p], heads[0][f, p], jitter_2d[f, p]))
    state.m.append(_space(state, batch.joints_3d[f, p], true_3d[f, p], found_3d[f, p], heads[1][f, p], jitter_3d[f, p]))
    state.rows.append(
        {
            "at": (state.seen + f).astype(np.int64),
            "visibility": visibility[f, p],
            "counts": counts[f, p],
            "absent": ((visibility == Visibility.ABSENT) | outside)[f, p],
            "found": found[f, p],
            "true": true[f, p],
            "predicted": predicted[f, p],
            "oks": similarity[f, p],
        }
    )
    state.frames.append(truth.frame)
    state.seen += frames


def _found_only(batch: PoseBatch, presence: float) -> PoseBatch:
    """The batch without the joints whose presence is too improbable."""
    out = batch.presence < presence
    two, three = (np.where(out[..., None], np.float32(np.nan), x) for x in (batch.joints_2d, batch.joints_3d))
    return PoseBatch(two, three, batch.score, batch.presence)


def _space(state: _Collector, predicted: Float, true: NDArray[np.floating], found: Bool, head: Float, jitter: Float) -> Space:
    skeleton = state.skeleton
    p, t = predicted.astype(np.float64), true.astype(np.float64)
    nothing = np.full(found.shape, np.nan, np.float32)
    solid = predicted.shape[-1] == 3
    return Space(
        found,
        errors.distances(p, t).astype(np.float32),
        errors.aligned_distances(p, t).astype(np.float32) if solid else nothing,
        errors.bone_length_errors(p, t, skeleton.limbs).astype(np.float32) if solid else nothing,
        errors.swaps(p, t, skeleton.pairs).astype(np.float32),
        jitter,
        head,
    )


def _jitter(
    state: _Collector, truth: TruthChunk, offsets_2d: NDArray[np.floating], offsets_3d: NDArray[np.floating]
) -> tuple[Float, Float]:
    """(F, P, J) acceleration errors in px and m a frame², at the last of three frames in a row; NaN elsewhere."""
    now = {"frame": truth.frame, "sequence": truth.sequence, "sync_ns": truth.sync_ns, "2d": offsets_2d, "3d": offsets_3d}
    tail = state.tail or {name: values[:0] for name, values in now.items()}
    joined = {name: np.concatenate((tail[name], values)) for name, values in now.items()}
    before = len(tail["frame"])
    state.tail = {name: values[-2:] for name, values in joined.items()}
    follows = np.zeros(len(joined["frame"]), bool)
    step = {name: np.diff(joined[name]) for name in ("frame", "sequence", "sync_ns")}
    follows[1:] = (step["frame"] == 1) & (step["sequence"] == 0) & (step["sync_ns"] > 0)
    result = []
    for name in ("2d", "3d"):
        values = np.full(joined[name].shape[:-1], np.nan, np.float32)
        values[2:] = errors.accelerations(joined[name], follows)
        result.append(values[before:])
    return result[0], result[1]


def _head_sizes(true: NDArray[np.floating], thesis: float, state: _Collector) -> Float:
    """(F, P) head size in the unit of the points (F, P, J, D)."""
    if state.options.head == "thesis":
        return np.full(true.shape[:2], thesis, np.float32)
    if state.skeleton.head is None:
        return np.full(true.shape[:2], np.nan, np.float32)
    a, b = state.skeleton.head
    size = np.linalg.norm(true[:, :, a] - true[:, :, b], axis=-1).astype(np.float32)
    return np.where(size > 0, size, np.float32(np.nan))


def _boxes(joints_2d: Float) -> NDArray[np.float64]:
    """(F, P, 4) left, top, width and height in px of the upright box about a person's joints, 0 without any."""
    there = np.isfinite(joints_2d)
    low = np.where(there, joints_2d, np.inf).min(axis=2)
    high = np.where(there, joints_2d, -np.inf).max(axis=2)
    known = low <= high
    low, high = np.where(known, low, 0), np.where(known, high, 0)
    return np.concatenate((low, high - low), axis=-1).astype(np.float64)


def _detections(at: int, similarity: NDArray[np.float64], score: Float, found: Bool, true: Bool, counts: Bool) -> Detections:
    """One frame's predicted people, matched; a person's score is the mean over the joints found."""
    people, real = np.flatnonzero(found.any(axis=-1)), np.flatnonzero(true)
    scores = np.where(found, score, 0).sum(axis=-1)[people] / found.sum(axis=-1)[people]
    order, hit, ignored = match_frame(similarity[np.ix_(people, real)], scores, counts[real])
    return Detections(np.full(len(order), at, np.int64), scores[order], hit, ignored, np.array([counts[real].sum()], np.int64))

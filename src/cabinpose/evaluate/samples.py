"""From chunks of frames to samples: one row for each person in a frame, true or predicted, with the errors of every joint.

Only these rows are kept (about 60 bytes a joint), never an image, so that a dataset may be larger than memory.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from cabinpose.core import PoseBatch, PredictionsError, Skeleton, Visibility
from cabinpose.evaluate import errors
from cabinpose.evaluate.matching import assigned_places, placed, slot_places
from cabinpose.evaluate.oks import Detections, match_frame, oks
from cabinpose.evaluate.options import THESIS_HEAD_M, THESIS_HEAD_PX, EvaluationOptions

Float = NDArray[np.float32]
Bool = NDArray[np.bool_]

_LIKE = 0.5  # OKS from which an answer is of a person, COCO's loosest threshold


class TruthChunk(NamedTuple):
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


class Space(NamedTuple):
    """Errors of S samples in one space, px or m, all (S, J), NaN where there is nothing to measure.

    found: whether the joint was found here · error: its distance to the truth · swap: 1 or 0 at the left joint of a pair ·
    jitter: acceleration error a frame² · relative, aligned, bone: in 3D only, from the root and by the best similarity ·
    head: (S,) head size · known: whether the truth is known here; in 3D it is not of every joint that counts where labels of
    images were lifted by the depth.
    """

    found: Bool
    error: Float
    relative: Float
    aligned: Float
    bone: Float
    swap: Float
    jitter: Float
    head: Float
    known: Bool


class Samples(NamedTuple):
    """S samples over F frames, by rising frame, and the predicted people of each frame matched as COCO does.

    frames: (F,) numbers · sequence, sync_ns: (F,) as in `TruthChunk` · at: (S,) position of the sample's frame
    in `frames` · place: (S,) position of the slot, beyond them for predicted people whom no true one stands for ·
    visibility: (S, J) · counts: (S, J) joints that count · absent: (S, J) joints that a right prediction leaves out ·
    found: (S, J) · true, predicted: (S,) whether the person is there · oks: (S,) · elsewhere: (S,) whether the person was found,
    but in another's place: an answer for another place is like them (OKS of 0.5 or more) and not like who is there, and the one
    for theirs is not. A joint that neither counts nor is absent is too hidden to judge: it is neither right nor wrong. presence,
    score, expected (m): (S, J) of each joint with a position, however improbable, NaN of the others; near: (S, J) whether that
    position is within d of the truth. People of whom only improbable joints are known have a row as well.
    """

    skeleton: Skeleton
    frames: NDArray[np.int64]
    sequence: NDArray[np.int64]
    sync_ns: NDArray[np.int64]
    at: NDArray[np.int64]
    place: NDArray[np.int64]
    visibility: NDArray[np.uint8]
    counts: Bool
    absent: Bool
    found: Bool
    true: Bool
    predicted: Bool
    oks: Float
    elsewhere: Bool
    px: Space
    m: Space
    detections: Detections
    presence: Float
    score: Float
    expected: Float
    near: Bool

    def space(self, name: str) -> Space:
        """The errors in "2d" (px) or "3d" (m)."""
        return self.px if name == "2d" else self.m

    def spaces(self) -> dict[str, Space]:
        """The errors by space, "2d" (px) and "3d" (m), in which the model answers at all and the truth is known (a COCO file
        knows pixels alone); "2d" where it never answers.
        """
        there = {name: space for name, space in (("2d", self.px), ("3d", self.m)) if space.found.any() and self._known(space)}
        return there or {"2d": self.px}

    def _known(self, space: Space) -> bool:
        """Whether of any joint that counts and was found the truth is known; also where none was."""
        judged = space.error[space.found & self.counts]
        return not judged.size or bool(np.isfinite(judged).any())


def collect(
    chunks: Iterable[tuple[TruthChunk, PoseBatch]], skeleton: Skeleton, persons: Sequence[str], predicted_persons: Sequence[str],
    options: EvaluationOptions,
) -> Samples:  # fmt: skip
    """Errors of all chunks.

    Parameters
    ----------
    chunks
        Truth and predictions of frames in their order, with the joints of `skeleton` in its order.
    skeleton
        The joints that are evaluated.
    persons, predicted_persons
        Names of the slots of truth and predictions.
    options
        What counts, and how people are matched.

    Raises
    ------
    PredictionsError
        Where predictions name slots that the dataset does not have, or there are no frames.
    """
    parts: list[Samples] = []
    last_frames: dict[str, NDArray[np.generic]] = {}
    seen = 0
    for truth, batch in chunks:
        parts.append(_samples(truth, batch, skeleton, (persons, predicted_persons), options, seen, last_frames))
        seen += len(truth.frame)
    if not parts:
        raise PredictionsError("there are no frames to evaluate", hint="choose another split or selection")
    return _concatenated(parts)


def _concatenated(parts: Sequence[Any]) -> Any:
    """Named tuples of arrays, or of such tuples, as one."""
    if isinstance(parts[0], tuple):
        return type(parts[0])(*map(_concatenated, zip(*parts, strict=True)))
    return np.concatenate(parts) if isinstance(parts[0], np.ndarray) else parts[0]


def _samples(
    truth: TruthChunk, batch: PoseBatch, skeleton: Skeleton, persons: tuple[Sequence[str], Sequence[str]],
    options: EvaluationOptions, seen: int, last_frames: dict[str, NDArray[np.generic]],
) -> Samples:  # fmt: skip
    """The samples of a chunk that `seen` frames come before; `last_frames` is updated, see `_jitter`."""
    frames, slots, _ = truth.visibility.shape
    box = _boxes(truth.joints_2d)  # (F, P, 4)
    sigma = np.array([*skeleton.sigma.values()])
    given, batch = batch, found_only(batch, options.presence)
    if options.match == "slot":
        places = slot_places(frames, *persons)
    else:
        area = box[..., 2:].prod(axis=-1)
        places = assigned_places(options.match, truth.joints_2d, truth.joints_3d, area, sigma, batch)
    given, batch = placed(given, places), placed(batch, places)
    more = (0, places.shape[1] - slots)  # rows of predicted people whom no true one stands for
    visibility = np.pad(truth.visibility, ((0, 0), more, (0, 0)))
    true_2d, true_3d = (
        np.pad(x, ((0, 0), more, (0, 0), (0, 0)), constant_values=np.nan) for x in (truth.joints_2d, truth.joints_3d)
    )
    box = np.pad(box, ((0, 0), more, (0, 0)))
    area = box[..., 2:].prod(axis=-1)
    head_2d = _head_sizes(true_2d, THESIS_HEAD_PX, skeleton, options)
    head_3d = _head_sizes(true_3d, THESIS_HEAD_M, skeleton, options)

    counts = visibility >= options.min_visibility
    outside = (visibility == Visibility.OUTSIDE_IMAGE) & (options.min_visibility > Visibility.OUTSIDE_IMAGE)
    near = _near(given, true_2d, true_3d, options)
    true_2d, true_3d = (np.where(counts[..., None], x, np.nan) for x in (true_2d, true_3d))
    found_2d, found_3d = (errors.finite(x) for x in (batch.joints_2d, batch.joints_3d))
    found = found_2d | found_3d
    true = np.asarray((visibility > Visibility.ABSENT).any(axis=-1))
    predicted = np.asarray(found.any(axis=-1))
    answered = errors.finite(given.joints_2d) | errors.finite(given.joints_3d)
    f, p = np.nonzero(true | answered.any(axis=-1))
    told = given.presence, given.score, given.expected_error_m
    presence, score, expected = (np.where(answered, values, np.float32(np.nan))[f, p] for values in told)

    similarity, elsewhere = np.zeros((frames, places.shape[1]), np.float32), np.zeros((frames, places.shape[1]), bool)
    detections = []
    for i in range(frames):
        matrix = oks(batch.joints_2d[i], true_2d[i], counts[i], area[i], sigma, box[i])
        similarity[i] = np.diagonal(matrix)
        right = similarity[i] >= _LIKE  # an answer that is of its own person is nobody else's, who may be behind them
        free = np.where(right[:, None], 0.0, matrix).max(axis=0, initial=0.0)
        elsewhere[i] = counts[i].any(axis=-1) & ~right & (free >= _LIKE)
        detections.append(_detections(seen + i, matrix, batch.score[i], found_2d[i], true[i], counts[i].any(axis=-1)))
    jitter_2d, jitter_3d = _jitter(last_frames, truth, batch.joints_2d - true_2d, batch.joints_3d - true_3d)
    return Samples(
        skeleton,
        truth.frame,
        truth.sequence,
        truth.sync_ns,
        (seen + f).astype(np.int64),
        p.astype(np.int64),
        visibility[f, p],
        counts[f, p],
        ((visibility == Visibility.ABSENT) | outside)[f, p],
        found[f, p],
        true[f, p],
        predicted[f, p],
        similarity[f, p],
        elsewhere[f, p],
        _space(skeleton, batch.joints_2d[f, p], true_2d[f, p], found_2d[f, p], head_2d[f, p], jitter_2d[f, p]),
        _space(skeleton, batch.joints_3d[f, p], true_3d[f, p], found_3d[f, p], head_3d[f, p], jitter_3d[f, p]),
        _concatenated(detections),
        presence,
        score,
        expected,
        near[f, p],
    )


def found_only(batch: PoseBatch, presence: float) -> PoseBatch:
    """The batch without the joints whose presence is too improbable."""
    out = (batch.presence < presence)[..., None]
    two, three = (np.where(out, np.float32(np.nan), x) for x in (batch.joints_2d, batch.joints_3d))
    return replace(batch, joints_2d=two, joints_3d=three)


def _near(given: PoseBatch, true_2d: Float, true_3d: Float, options: EvaluationOptions) -> Bool:
    """(F, P, J) whether a joint is within d of its truth: in 3D, or in the image where the answer has no 3D."""
    with np.errstate(over="ignore"):  # joints beside the lens may be projected to anywhere
        near_2d = np.linalg.norm(given.joints_2d - true_2d, axis=-1) <= options.hit_px
    near_3d = np.linalg.norm(given.joints_3d - true_3d, axis=-1) <= options.hit_m
    return np.where(errors.finite(given.joints_3d), near_3d, near_2d)


def _space(skeleton: Skeleton, predicted: Float, true: NDArray[np.floating], found: Bool, head: Float, jitter: Float) -> Space:
    p, t = predicted.astype(np.float64), true.astype(np.float64)
    relative = aligned = bone = np.full(found.shape, np.nan)
    if predicted.shape[-1] == 3:
        aligned, bone = errors.aligned_distances(p, t), errors.bone_length_errors(p, t, skeleton.limbs)
        if skeleton.root is not None:
            relative = errors.root_relative_distances(p, t, skeleton.index[skeleton.root])
    measured = errors.distances(p, t), relative, aligned, bone, errors.swaps(p, t, skeleton.pairs)
    distance, relative, aligned, bone, swap = (x.astype(np.float32) for x in measured)
    return Space(found, distance, relative, aligned, bone, swap, jitter, head, errors.finite(t))


def _jitter(
    last_frames: dict[str, NDArray[np.generic]], truth: TruthChunk, offsets_2d: NDArray[Any], offsets_3d: NDArray[Any]
) -> list[Float]:
    """(F, P, J) acceleration errors in px and m a frame², at the last of three frames in a row; NaN elsewhere.

    last_frames: what is needed of the two frames before the chunk, {} before the first one; those of the chunk take their place.
    """
    now = {"frame": truth.frame, "sequence": truth.sequence, "sync_ns": truth.sync_ns, "2d": offsets_2d, "3d": offsets_3d}
    joined = {name: np.concatenate((last_frames.get(name, values[:0]), values)) for name, values in now.items()}
    before = len(joined["frame"]) - len(truth.frame)
    last_frames.update({name: values[-2:] for name, values in joined.items()})
    step = {name: np.diff(joined[name]) for name in ("frame", "sequence", "sync_ns")}
    follows = np.zeros(len(joined["frame"]), bool)
    follows[1:] = (step["frame"] == 1) & (step["sequence"] == 0) & (step["sync_ns"] > 0)
    result = []
    for name in ("2d", "3d"):
        values = np.full(joined[name].shape[:-1], np.nan, np.float32)
        values[2:] = errors.accelerations(joined[name], follows)
        result.append(values[before:])
    return result


def _head_sizes(true: NDArray[np.floating], thesis: float, skeleton: Skeleton, options: EvaluationOptions) -> Float:
    """(F, P) head size in the unit of the points (F, P, J, D)."""
    if options.head == "thesis" or skeleton.head is None:
        return np.full(true.shape[:2], thesis if options.head == "thesis" else np.nan, np.float32)
    a, b = skeleton.indices(skeleton.head)
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

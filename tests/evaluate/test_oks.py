"""OKS and average precision, held against COCO's own code."""

from __future__ import annotations

import contextlib
import io
from typing import Any

import numpy as np
import pytest

from cabinpose.evaluate.oks import THRESHOLDS, Detections, average_precision, match_frame, oks

SIGMA = np.array([0.26, 0.25, 0.25, 0.35, 0.35, 0.79, 0.79, 0.72, 0.72, 0.62, 0.62, 1.07, 1.07, 0.87, 0.87, 0.89, 0.89]) / 10


def coco_case(seed: int, images: int = 40) -> tuple[dict[str, Any], list[dict[str, Any]], list[dict[str, Any]]]:
    """Ground truth and results as COCO wants them, and ours: frames with up to 4 true and 5 predicted people."""
    rng = np.random.default_rng(seed)
    annotations, results, frames = [], [], []
    for image in range(1, images + 1):
        count = int(rng.integers(0, 5))
        true = rng.uniform(0, 300, (count, 1, 2)) + rng.normal(0, 40, (count, 17, 2))
        labelled = (rng.random((count, 17)) < 0.7) & (rng.random((count, 1)) < 0.8)  # a fifth has no joint labelled: ignored
        box = np.concatenate((true.min(axis=1), np.ptp(true, axis=1)), axis=1)
        area = rng.uniform(2000, 30000, count)
        noise = rng.choice([1, 3, 8, 25], (count, 1, 1))
        found = true + rng.normal(0, 1, true.shape) * noise
        found = np.concatenate((found[rng.random(count) < 0.85], rng.uniform(0, 400, (int(rng.integers(0, 2)), 17, 2))))
        score = rng.random(len(found)).round(1)  # with ties
        for g in range(count):
            flags = np.where(labelled[g], 2, 0)[:, None]
            points = np.concatenate((np.where(flags > 0, true[g], 0), flags), axis=1)
            annotations.append(
                {
                    "id": len(annotations) + 1, "image_id": image, "category_id": 1, "iscrowd": 0, "area": float(area[g]),
                    "bbox": box[g].tolist(), "num_keypoints": int(labelled[g].sum()), "keypoints": points.ravel().tolist(),
                }
            )  # fmt: skip
        for d in range(len(found)):
            points = np.concatenate((found[d], np.ones((17, 1))), axis=1)
            results.append({"image_id": image, "category_id": 1, "score": float(score[d]), "keypoints": points.ravel().tolist()})
        frames.append({"true": true, "labelled": labelled, "area": area, "box": box, "found": found, "score": score})
    joints = [f"k{i}" for i in range(17)]
    truth = {
        "info": {}, "images": [{"id": i} for i in range(1, images + 1)], "annotations": annotations,
        "categories": [{"id": 1, "name": "person", "keypoints": joints, "skeleton": []}],
    }  # fmt: skip
    return truth, results, frames


@pytest.mark.parametrize("seed", range(4))
def test_like_pycocotools(seed: int) -> None:
    from pycocotools.coco import COCO
    from pycocotools.cocoeval import COCOeval

    truth, results, frames = coco_case(seed)
    with contextlib.redirect_stdout(io.StringIO()):
        reference = COCO()
        reference.dataset = truth
        reference.createIndex()
        theirs = COCOeval(reference, reference.loadRes(results), "keypoints")
        theirs.params.areaRng, theirs.params.areaRngLbl = [[0, 1e10]], ["all"]
        theirs.evaluate()
        theirs.accumulate()
    parts = []
    for i, f in enumerate(frames):
        similarity = oks(f["found"], f["true"], f["labelled"], f["area"], SIGMA, f["box"])
        reference_oks = np.asarray(theirs.ious[i + 1, 1])
        if reference_oks.size:
            order = np.argsort(-f["score"], kind="mergesort")
            assert np.allclose(similarity[order], reference_oks, atol=1e-6)
        order, hit, ignored = match_frame(similarity, f["score"], f["labelled"].any(axis=1))
        people = np.array([f["labelled"].any(axis=1).sum()])
        parts.append((np.full(len(order), i), f["score"][order], hit, ignored, people))
    detections = Detections(*(np.concatenate(x) for x in zip(*parts, strict=True)))
    ours = average_precision(detections)
    assert np.allclose(ours, theirs.eval["precision"][:, :, 0, 0, 0].mean(axis=1), atol=1e-6)
    assert 0.1 < ours.mean() < 0.95


def test_a_weight_is_a_copy_of_the_frame() -> None:
    frame, score = np.array([0, 0, 1, 2]), np.array([0.9, 0.5, 0.8, 0.7])
    hit = np.array([[True], [False], [True], [False]]) & np.ones(10, bool)
    ignored = np.zeros_like(hit)
    once = Detections(frame, score, hit, ignored, np.array([2, 1, 1]))
    weights = np.array([2, 1, 2])
    wanted = [0, 1, 0, 1, 2, 3, 3]
    copies = Detections(frame[wanted], score[wanted], hit[wanted], ignored[wanted], np.array([4, 1, 2]))
    assert np.allclose(average_precision(once, weights), average_precision(copies))
    assert not np.allclose(average_precision(once), average_precision(copies))


def test_no_people_is_no_number() -> None:
    nothing = Detections(np.zeros(0, int), np.zeros(0), np.zeros((0, 10), bool), np.zeros((0, 10), bool), np.array([0, 0]))
    assert np.isnan(average_precision(nothing)).all()
    missed = Detections(nothing.frame, nothing.score, nothing.hit, nothing.ignored, np.array([1, 0]))
    assert average_precision(missed).tolist() == [0.0] * len(THRESHOLDS)


def test_oks_by_hand() -> None:
    """A joint k s away from its truth is worth exp(-1/2); one not found is worth 0."""
    true, sigma = np.zeros((1, 3, 2)), np.array([0.05, 0.1, 0.1])
    predicted = np.array([[[2 * 0.05 * 30, 0.0], [0.0, 0.0], [np.nan, np.nan]]])
    similarity = oks(predicted, true, np.ones((1, 3), bool), np.array([900.0]), sigma)
    assert similarity[0, 0] == pytest.approx((np.exp(-0.5) + 1 + 0) / 3)

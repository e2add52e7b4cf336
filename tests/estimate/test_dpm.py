"""The deformable parts' maths, each against something independent: brute force, scipy, scikit-image, scikit-learn."""

from __future__ import annotations

from itertools import product
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_edt

from cabinpose._native import dpm as native
from cabinpose.estimate.dpm.config import DpmConfig
from cabinpose.estimate.dpm.hog import MARGIN, RELIEF, cell_histograms, features, levels, normalised, responses
from cabinpose.estimate.dpm.learn import Answer, StructuredSvm, nobody
from cabinpose.estimate.dpm.parts import Parts, downward, row_length, rows, unary, upward

ROOM: dict[str, Any] = {"body": "itop", "width": 64, "height": 48, "focal": 51.2, "max_depth_m": 6.0, "slots": ("standing",)}


def generator(seed: int) -> np.random.Generator:
    return np.random.Generator(np.random.Philox(key=(seed, 0)))


def spread(score: NDArray[np.float32], spring: NDArray[np.float64]) -> tuple[NDArray[np.float32], NDArray[np.int32]]:
    best, source = np.empty_like(score), np.empty(score.shape, np.int32)
    native.spring_transform(score, spring, best, source)
    return best, source


def under_spring(score: NDArray[np.float32], spring: NDArray[np.float64]) -> NDArray[np.float64]:
    """(y, x, y', x') score of each place for each place that pulls it; by the definition."""
    rows_, columns = (np.arange(n, dtype=np.float64) for n in score.shape)
    along = spring[0] * (columns - columns[:, None] - spring[1]) ** 2
    down = spring[2] * (rows_ - rows_[:, None] - spring[3]) ** 2
    return score - along[None, :, None, :] - down[:, None, :, None]


def test_the_best_under_a_spring_is_that_of_all_places() -> None:
    rng = generator(1)
    score = rng.normal(size=(5, 9, 13)).astype(np.float32) * 3
    spring = np.column_stack((rng.uniform(0.01, 2, 5), rng.normal(size=5) * 6, rng.uniform(0.01, 2, 5), rng.normal(size=5) * 6))
    best, source = spread(score, spring)
    for k in range(5):
        all_ = under_spring(score[k], spring[k]).reshape(9, 13, -1)
        np.testing.assert_allclose(best[k], all_.max(-1), rtol=1e-5, atol=1e-5)
        np.testing.assert_array_equal(source[k], all_.argmax(-1))


def test_distances_to_marked_cells_are_scipys() -> None:
    marked = generator(2).random((31, 24)) < 0.02
    score = np.where(marked, 0.0, -1e6).astype(np.float32)
    best, source = spread(score[None], np.array([[1.0, 0.0, 1.0, 0.0]]))
    np.testing.assert_allclose(-best[0], distance_transform_edt(~marked) ** 2, rtol=1e-6)
    assert marked.ravel()[source].all()


def parts_of(config: DpmConfig, seed: int) -> Parts:
    """Random weights; some springs whose weights would push, which must be taken as the softest."""
    rng = generator(seed)
    parts, types = len(config.tree.parent), config.mixtures
    weights = rng.normal(size=(parts, types, row_length(config))).astype(np.float32)
    return Parts(
        weights, rng.normal(size=(parts, types, 2)) * 1.5, rng.uniform(0.5, 2, (parts, types, 2)), np.zeros((parts, types, 2)),
        np.full((parts, types, 2), 0.1), np.full((parts, types, 2), 0.1), np.array([2.0]), np.zeros((len(config.slots), 3)),
    )  # fmt: skip


@pytest.mark.parametrize("parent", [(-1, 0, 1), (-1, 0, 0)])
def test_the_best_placement_is_that_of_all_placements(parent: tuple[int, ...]) -> None:
    before = np.array(parent)
    parts = parts_of(DpmConfig(**ROOM, mixtures=2, limb_parts=False), 3)
    scores = generator(4).normal(size=(3, 2, 3, 4)).astype(np.float32)
    pair = [under_spring_of(parts, part, scores[part]) for part in range(3)]  # (parent's type, place; type, place)
    states = list(product(range(2), range(12)))
    root = scores[0].reshape(2, 12) + parts.pair_bias(0)
    best, placed = -np.inf, None
    for a, b, c in product(states, repeat=3):
        of = (a, b, c)
        total = root[a] + pair[1][of[parent[1]]][b] + pair[2][of[parent[2]]][c]
        if total > best:
            best, placed = total, of
    beliefs = upward(parts._replace(weights=parts.weights[:3]), before, scores)
    top = np.unravel_index(np.argmax(beliefs.belief[0]), (2, 3, 4))
    found = downward(beliefs, before, (int(top[0]), int(top[1]), int(top[2])))
    assert found.score == pytest.approx(best, abs=1e-4)
    assert placed == tuple((t, y * 4 + x) for t, (x, y) in zip(found.types, found.positions, strict=True))


def under_spring_of(parts: Parts, part: int, score: NDArray[np.float32]) -> NDArray[np.float64]:
    """(T, 12, T, 12) score of a part's type and place for its parent's, by the weights as they are defined."""
    weight = parts.weights[part].astype(np.float64)
    made = np.empty((2, 12, 2, 12))
    for t, there, mine, here in np.ndindex(made.shape):
        away = (np.array((here % 4, here // 4)) - (there % 4, there // 4) - parts.anchor[part, mine]) / parts.spread[part, mine]
        square, linear = weight[mine, -6:-2:2], weight[mine, -5:-2:2]
        pull = 0.1 * (np.maximum(square, 0.02) * away**2 + linear * away).sum()
        made[t, there, mine, here] = score[mine].ravel()[here] - pull + weight[mine, -2 + t]
    return made


@pytest.mark.parametrize("body", ["upper", "full", "itop"])
@pytest.mark.parametrize("limb_parts", [True, False])
def test_the_tree_ties_each_joint_once(body: str, limb_parts: bool) -> None:
    config = DpmConfig(body=body, limb_parts=limb_parts)
    parent, ends = config.tree
    assert (parent[1:] < np.arange(1, len(parent))).all()
    assert parent[0] == -1
    np.testing.assert_array_equal(ends[config.tree.joints], np.repeat(np.arange(len(config.joints)), 2).reshape(-1, 2))
    between = np.flatnonzero(ends[:, 0] != ends[:, 1])
    assert len(between) == (0 if not limb_parts else 4 if body == "upper" else 8)
    for part in between:  # between its parent and its only child
        (child,) = np.flatnonzero(parent == part)
        assert [ends[parent[part], 0], ends[child, 0]] == ends[part].tolist()


def test_what_a_placement_shows_times_the_weights_is_its_score() -> None:
    config = DpmConfig(**ROOM, mixtures=3)
    parts, tree = parts_of(config, 5), config.tree
    parts.weights[:, :, -7:-3] = np.abs(parts.weights[:, :, -7:-3]) + 0.02  # no softer than springs are
    (level,) = levels(config, np.array([2.0]))
    described = features(config, level, generator(6).uniform(1.5, 2.5, (48, 64)).astype(np.float32))
    beliefs = upward(parts, tree.parent, unary(parts, config, described))
    placed = downward(beliefs, tree.parent, (1, 4, 7))
    shown = rows(parts, config, described, placed.positions, placed.types)
    score = (parts.weights[np.arange(len(placed.types)), placed.types] * shown).sum()
    assert score == pytest.approx(placed.score, rel=1e-4)


def test_cells_are_those_of_scikit_image() -> None:
    """skimage.feature.hog (0.26) of this image: 6 orientations, 4x4 pixels a cell, a cell a block, L2."""
    y, x = np.mgrid[:12, :16]
    image = np.sin(0.7 * x) + np.cos(0.45 * y + 0.2 * x) + 0.03 * x * y
    signed = cell_histograms(image, 4, 12)
    found = signed[..., :6] + signed[..., 6:]  # theirs has no sign
    found /= np.linalg.norm(found, axis=-1, keepdims=True)
    expected = """
        .32437 .58002 .2203 .46481 .54201 0   .99956 0 .02579 .01444 0 0   .90827 .16458 .23578 0 0 .30392
        .29488 0 0 .79176 .53495 0   .47137 .31751 0 .58882 .36355 .4451   .16252 .66865 .29088 .2428 .39324 .4778
        .12582 .99052 .05507 0 0 0   0 0 .21486 .97664 0 0   .86093 .38933 .27772 .17345 0 0
        .19683 .50469 .37062 .75445 0 0   .88555 .46454 0 0 0 0   .39292 0 0 .45493 .44743 .66217"""
    np.testing.assert_allclose(found, np.array(expected.split(), float).reshape(3, 4, 6), atol=1e-4)
    assert (signed[..., :6] > 0).any()
    assert (signed[..., 6:] > 0).any()


def test_steep_edges_count_alike_and_flat_cells_stay_small() -> None:
    image = np.zeros((16, 16))
    image[:, 8:] = 1.0
    low, high = (cell_histograms(image * k, 4, 8, steepest=0.5) for k in (1.0, 3.0))
    np.testing.assert_array_equal(low, high)
    assert low[2, 1, 0] == low[2, 2, 0] == 0.25  # the step is seen from a column at either side
    even = normalised(np.full((5, 5, 8), 1e-4, np.float32))
    assert even.max() < 0.01
    one = np.zeros((5, 5, 8), np.float32)
    one[2, 2, 3] = 9.0
    assert normalised(one).max() == 0.5


def test_a_body_looks_the_same_at_every_distance() -> None:
    config = DpmConfig(**ROOM | {"width": 128, "height": 128, "focal": 140.0})
    described = []
    for z in (2.0, 4.0):
        (level,) = levels(config, np.array([z]))
        rays = config.view.camera.rays * z
        body = (np.abs(rays[..., 0]) < 0.3) & (np.abs(rays[..., 1]) < 0.5)
        made = features(config, level, np.where(body, np.float32(z + 0.1), np.float32(2 * z)))
        r, c = np.array(made.shape[:2]) // 2
        described.append(made[r - 8 : r + 9, c - 8 : c + 9])
    off, moved = (np.abs(described[0] - np.roll(described[1], k, axis=1)).mean() for k in (0, 3))
    assert off < 0.2 * moved
    inner = described[0][8, 8]
    np.testing.assert_allclose(inner[-RELIEF:], (1.0, 0.1, 0.0), atol=1e-3)


def test_cells_and_pixels_are_inverses_and_cells_are_where_their_pixels_are() -> None:
    config = DpmConfig(**ROOM, cell_px=3)
    (level,) = levels(config, np.array([2.6]))
    uv = generator(7).uniform(0, 60, (20, 2))
    np.testing.assert_allclose(level.pixels(level.cells(uv)), uv)
    depth = np.full((48, 64), 3.1, np.float32)
    depth[20:24, 40:44] = 2.6  # a block of about one cell
    made = features(config, level, depth)
    border = config.filter_cells // 2
    y, x = np.unravel_index(np.argmax(made[..., -RELIEF] * (made[..., -RELIEF + 1] < 0.1)), made.shape[:2])
    np.testing.assert_allclose(level.pixels(np.array((x, y)) - border), (41.5, 21.5), atol=2.5)
    assert (made[border + MARGIN, 0, -1], made[y, x, -1]) == (1.0, 0.0)  # outside of the image, inside


def test_responses_are_correlations() -> None:
    rng = generator(8)
    cells, filters = rng.normal(size=(7, 9, 4)).astype(np.float32), rng.normal(size=(3, 3, 3, 4)).astype(np.float32)
    found = responses(cells, filters)
    assert found.shape == (3, 5, 7)
    for f, y, x in ((0, 0, 0), (2, 4, 6), (1, 2, 3)):
        assert found[f, y, x] == pytest.approx((cells[y : y + 3, x : x + 3] * filters[f]).sum(), rel=1e-4)


def binary_problem() -> tuple[NDArray[np.float32], NDArray[np.int64]]:
    i = np.arange(60)
    x = np.stack([np.sin(1 + i * k + 0.1 * k * k) for k in range(1, 9)], axis=1)
    return x, np.where(x[:, 0] + 0.5 * x[:, 1] + 0.6 * np.sin(7.0 * i) > 0, 1, -1)


def test_without_latent_variables_it_is_the_support_vector_machine() -> None:
    """sklearn.svm.LinearSVC (1.9) of this problem: loss hinge, C 0.3, no intercept; its objective is 4.79593."""
    x, label = binary_problem()
    one = np.zeros(1, np.int64)
    shown = [Answer(one, row.astype(np.float32).reshape(1, -1), 0.0) for row in x]
    truths = [answer if y > 0 else nobody(0.0) for answer, y in zip(shown, label, strict=True)]
    svm = StructuredSvm(np.zeros((1, 1, 8), np.float32), truths, 0.3)
    for n, y in enumerate(label):
        svm.add(n, nobody(1.0) if y > 0 else shown[n]._replace(loss=1.0))
    rng = generator(9)
    for _ in range(100):
        svm.sweep(rng.permutation(60))
    primal, dual = svm.objective()
    hinge = np.maximum(0, 1 - label * (x @ svm.weights.ravel())).sum()
    assert primal == pytest.approx(0.5 * (svm.weights**2).sum() + 0.3 * hinge, rel=1e-3)  # answers are kept in half precision
    assert primal == pytest.approx(4.79593, rel=2e-3)
    assert dual <= primal + 1e-6
    assert primal - dual < 0.02
    np.testing.assert_allclose(svm.weights.ravel(), (1.347, 0.807, -0.058, 0.068, 0.353, -0.503, 0.781, -0.25), atol=0.02)


def test_learning_starts_from_the_given_weights_and_leaves_them_where_they_suffice() -> None:
    shown = Answer(np.zeros(1, np.int64), np.array([[1.0, 0.0]], np.float32), 0.0)
    start = np.array([[[2.0, -1.0]]], np.float32)
    svm = StructuredSvm(start, [shown], 10.0)
    svm.add(0, nobody(1.0))  # the score is 2, above the margin
    svm.sweep(np.array([0]))
    np.testing.assert_array_equal(svm.weights, start)
    svm.add(0, nobody(5.0))
    svm.sweep(np.array([0]))
    np.testing.assert_allclose(svm.weights, [[[5.0, -1.0]]], rtol=1e-6)  # 5 − w·Φ = 0, and no farther
    svm.forget(1)
    assert [answer.loss for answer in svm.answers[0]] == [5.0]

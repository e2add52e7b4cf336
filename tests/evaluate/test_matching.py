"""Which predicted person is which true one, held against all permutations."""

from __future__ import annotations

from itertools import permutations

import numpy as np
import pytest

from cabinpose.core.errors import PredictionsError
from cabinpose.core.ports import PoseBatch
from cabinpose.evaluate.matching import MAX_DISTANCE_M, MIN_OKS, assigned_places, placed, slot_places
from cabinpose.evaluate.oks import oks

SIGMA = np.full(6, 0.08)


def batch_of(joints_2d: np.ndarray, joints_3d: np.ndarray) -> PoseBatch:
    there = np.ones(joints_2d.shape[:-1], np.float32)
    return PoseBatch(joints_2d.astype(np.float32), joints_3d.astype(np.float32), there, there)


@pytest.mark.parametrize("how", ["oks", "distance"])
@pytest.mark.parametrize("seed", range(6))
def test_best_of_all_permutations(how: str, seed: int) -> None:
    rng = np.random.default_rng(seed)
    people = rng.normal(0, 0.35, (3, 1, 3)) + rng.normal((0, 0, 2), 0.2, (3, 6, 3))
    found = people[rng.permutation(3)] + rng.normal(0, 0.1, (3, 6, 3))
    pixels = [300 * x[..., :2] / x[..., 2:] + 150 for x in (people, found)]
    area = np.ptp(pixels[0], axis=1).prod(axis=-1)
    true = [x[None].astype(np.float32) for x in (pixels[0], people)]
    batch = batch_of(pixels[1][None], found[None])
    places = assigned_places(how, *true, area[None], SIGMA, batch)[0]  # type: ignore[arg-type]
    if how == "oks":
        likeness, least = oks(pixels[1], pixels[0], np.ones((3, 6), bool), area, SIGMA), MIN_OKS
    else:
        likeness, least = -np.linalg.norm(found[:, None] - people[None], axis=-1).mean(-1), -MAX_DISTANCE_M

    def worth(order: tuple[int, ...]) -> tuple[int, float]:
        good = [likeness[d, t] for t, d in enumerate(order) if likeness[d, t] >= least]
        return len(good), sum(good)

    best = max(permutations(range(3)), key=worth)
    for t, d in enumerate(best):
        assert places[t] == (d if likeness[d, t] >= least else -1)
    assert sorted(p for p in places if p >= 0) == [0, 1, 2]  # who matches nobody stands in a row behind


def test_nobody_and_too_far() -> None:
    true = np.full((3, 2, 6, 3), np.nan)
    true[1:, 0] = (0, 0, 2)
    found = np.full((3, 2, 6, 3), np.nan)
    found[0, 1] = (0, 0, 2)  # nobody is there
    found[1, 0] = (MAX_DISTANCE_M + 0.01, 0, 2)
    found[2, 1] = (MAX_DISTANCE_M - 0.01, 0, 2)
    batch = batch_of(np.full((3, 2, 6, 2), np.nan), found)
    nothing = np.full((3, 2, 6, 2), np.nan, np.float32)
    places = assigned_places("distance", nothing, true.astype(np.float32), np.zeros((3, 2)), SIGMA, batch)
    assert places.tolist() == [[-1, -1, 1, -1], [-1, -1, 0, -1], [1, -1, -1, -1]]
    moved = placed(batch, places)
    np.testing.assert_array_equal(moved.joints_3d[2, 0], found[2, 1].astype(np.float32))
    assert np.isnan(moved.joints_3d[2, 1:]).all()
    assert not moved.presence[2, 1:].any()


def test_slots_by_name() -> None:
    assert slot_places(2, ("a", "b", "c"), ("c", "a")).tolist() == [[1, -1, 0]] * 2
    with pytest.raises(PredictionsError, match="no slot d") as caught:
        slot_places(2, ("a", "b"), ("d", "a"))
    assert "--match oks" in str(caught.value.hint)

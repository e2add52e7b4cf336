"""The chain solver: forward kinematics against scipy's rotations, its inverse, limits, free directions."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from cabinpose._native import pose as native
from cabinpose.core.frames import Matrix, transform
from cabinpose.synth.posture.chain import Chain, Task, solve, tool


def random_chain(rng: np.random.Generator, n: int = 9) -> Chain:
    fixed = np.array([transform(Rotation.random(rng=rng), rng.normal(0, 0.15, 3)) for _ in range(n + 1)])
    axes = rng.normal(size=(n, 3))
    axes /= np.linalg.norm(axes, axis=1, keepdims=True)
    middle = rng.normal(0, 0.3, n)
    return Chain(fixed, axes, middle - 1.2, middle + 1.2, np.arange(n))


def by_scipy(chain: Chain, q: np.ndarray) -> Matrix:
    m = chain.fixed[0]
    for axis, angle, fixed in zip(chain.axes, q, chain.fixed[1:], strict=True):
        m = m @ transform(Rotation.from_rotvec(axis * angle)) @ fixed
    return m


def whole(target: Matrix, n: int, prior: np.ndarray, stiffness: float = 1e-3) -> Task:
    return Task(target, np.ones(3), np.full(3, 0.3), prior, np.full(n, stiffness))


def test_tool_is_the_product_of_the_hinges() -> None:
    rng = np.random.default_rng(1)
    for _ in range(20):
        chain = random_chain(rng)
        q = rng.uniform(-3, 3, 9)
        np.testing.assert_allclose(tool(chain, q), by_scipy(chain, q), atol=1e-12)


@pytest.mark.parametrize("angle", [0.0, 1e-12, 1e-6, 0.7, 3.0, np.pi - 1e-4, np.pi - 1e-9, np.pi])
def test_rotation_vector(angle: float) -> None:
    rng = np.random.default_rng(2)
    for axis in [*np.eye(3), *-np.eye(3), *rng.normal(size=(20, 3))]:
        r = Rotation.from_rotvec(axis / np.linalg.norm(axis) * angle)
        out = np.array(native.rotation_vector(r.as_matrix()))
        assert (Rotation.from_rotvec(out).inv() * r).magnitude() < 1e-7
        assert np.linalg.norm(out) == pytest.approx(angle, abs=1e-6)


def test_inverse_of_the_forward() -> None:
    rng = np.random.default_rng(3)
    missed = []
    for _ in range(200):
        chain = random_chain(rng)
        truth = rng.uniform(chain.lower, chain.upper)
        start = np.clip(truth + rng.normal(0, 0.5, 9), chain.lower, chain.upper)
        q, residual = solve(chain, whole(tool(chain, truth), 9, start), start, iterations=80)
        assert np.all(q >= chain.lower)
        assert np.all(q <= chain.upper)
        error = np.linalg.inv(tool(chain, truth)) @ tool(chain, q)
        assert residual.position == pytest.approx(np.linalg.norm(error[:3, 3]), abs=1e-6)
        missed.append(residual.position + residual.rotation)
    assert np.mean(np.array(missed) < 1e-4) > 0.97  # a few starts end in a corner of the box


def test_unreachable_targets_leave_the_least_error_within_limits() -> None:
    rng = np.random.default_rng(4)
    for _ in range(50):
        chain = random_chain(rng)
        far = transform(None, rng.normal(0, 5, 3))
        start = (chain.lower + chain.upper) / 2
        task = Task(far, np.ones(3), np.zeros(3), start, np.full(9, 1e-4))
        q, residual = solve(chain, task, start, iterations=80)
        assert np.all(q >= chain.lower)
        assert np.all(q <= chain.upper)
        assert residual.rotation == 0.0
        for _ in range(20):  # no neighbour within the box is better
            near = np.clip(q + rng.normal(0, 1e-3, 9), chain.lower, chain.upper)
            assert np.linalg.norm(tool(chain, near)[:3, 3] - far[:3, 3]) > residual.position - 1e-4


def test_free_directions_stay_free() -> None:
    rng = np.random.default_rng(5)
    chain = random_chain(rng)
    truth = rng.uniform(chain.lower, chain.upper) * 0.5
    target = tool(chain, truth) @ transform(Rotation.from_rotvec([0, 0, 1.5]), [0, 0, 0.4])
    task = Task(target, np.array([1.0, 1, 0]), np.array([0.3, 0.3, 0]), truth, np.full(9, 1e-3))
    q, residual = solve(chain, task, truth)
    assert max(residual) < 1e-5
    assert np.linalg.norm(q - truth) < 0.5  # the posture it had already met the task


def test_the_prior_chooses_among_solutions() -> None:
    rng = np.random.default_rng(6)
    chain = random_chain(rng)
    truth = (chain.lower + chain.upper) / 2
    target = tool(chain, truth)
    ends = []
    for side in (-1, 1):
        prior = truth + side * 0.8 * np.eye(9)[3]
        task = Task(target, np.ones(3), np.zeros(3), prior, np.where(np.arange(9) == 3, 1.0, 1e-4))
        q, residual = solve(chain, task, truth, iterations=80)
        assert residual.position < 1e-6  # and it leaves no bias behind
        ends.append(q[3])
    assert ends[1] - ends[0] > 0.5

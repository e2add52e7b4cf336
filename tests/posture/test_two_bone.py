"""The closed form of a limb: exact where limits are wide, within them always, and a start from which the solver arrives."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from cabinpose._native import pose as native
from cabinpose.core.frames import transform
from cabinpose.synth.posture.chain import Chain, Task, solve, tool
from cabinpose.synth.posture.two_bone import seed

X, Y, Z = np.eye(3)


def arm(reach: float) -> Chain:
    """Two clavicle hinges, a ball, a hinge, and a wrist of three, with limits of `reach` (rad) about zero but for the elbow."""
    axes = np.array([X, Z, -Y, X, Z, -Y, Z, Y, X])
    places = [(0, 0.1, 0), (0, 0, 0), (0.01, 0.12, 0), (0, 0, 0), (0, 0, 0), (0, 0.01, -0.3), (0, 0, -0.25), (0, 0, 0), (0, 0, 0)]
    fixed = [transform(None, p) for p in places] + [transform(Rotation.from_euler("xyz", [0.2, 1.3, 0.1]), (0.02, 0, -0.08))]
    lower, upper = np.full(9, -reach), np.full(9, reach)
    lower[5], upper[5] = 0.0, 2.5
    return Chain(np.array(fixed), axes, lower, upper, np.arange(9))


def test_euler_angles_of_every_orthogonal_sequence() -> None:
    rng = np.random.default_rng(1)
    for order in itertools.permutations((X, Y, Z)):
        for signs in itertools.product((1, -1), repeat=3):
            axes = np.array(order) * np.array(signs)[:, None]
            for middle in (None, np.pi / 2, -np.pi / 2, np.pi / 2 - 1e-8):
                angles = rng.uniform(-1.4, 1.4, 3)
                if middle is not None:
                    angles[1] = middle
                r = np.eye(3)
                for a, v in zip(axes, angles, strict=True):
                    r = r @ Rotation.from_rotvec(a * v).as_matrix()
                out = np.array(native.euler_near(r, axes, angles))
                again = np.eye(3)
                for a, v in zip(axes, out, strict=True):
                    again = again @ Rotation.from_rotvec(a * v).as_matrix()
                np.testing.assert_allclose(again, r, atol=1e-6)
                if middle is None:
                    np.testing.assert_allclose(out, angles, atol=1e-9)


def test_exact_where_limits_are_wide() -> None:
    rng = np.random.default_rng(2)
    chain = arm(np.pi)
    stiffness = np.full(9, 1e-2)
    for _ in range(100):
        truth = rng.uniform(np.maximum(chain.lower, -1.2), np.minimum(chain.upper, 1.9))
        prior = np.zeros(9)
        prior[:2] = truth[:2]  # the closed form leaves the clavicle alone
        prior[5] = 0.5
        target = tool(chain, truth)
        q = seed(chain, 2, target, prior, stiffness, oriented=True)
        np.testing.assert_allclose(tool(chain, q), target, atol=1e-9)


def test_position_only_keeps_the_wrist() -> None:
    rng = np.random.default_rng(3)
    chain = arm(np.pi)
    prior = np.zeros(9)
    prior[5:] = 0.4, 0.3, -0.2, 0.1
    for _ in range(50):
        q = prior.copy()
        q[2:6] = rng.uniform(0.1, 1.2, 4)
        target = tool(chain, q)
        found = seed(chain, 2, target, prior, np.full(9, 1e-2), oriented=False)
        np.testing.assert_array_equal(found[6:], prior[6:])
        np.testing.assert_allclose(tool(chain, found)[:3, 3], target[:3, 3], atol=1e-9)


def test_the_solver_arrives_from_the_seed_within_limits() -> None:
    rng = np.random.default_rng(4)
    chain = arm(1.5)
    stiffness = np.full(9, 1e-3)
    missed = []
    for _ in range(200):
        truth = rng.uniform(chain.lower, chain.upper)
        target = tool(chain, truth)
        prior = np.clip(np.array([0, 0, 0.3, 0.2, 0, 0.8, 0, 0, 0.0]), chain.lower, chain.upper)
        start = seed(chain, 2, target, prior, stiffness, oriented=True)
        assert np.all(start >= chain.lower)
        assert np.all(start <= chain.upper)
        _, residual = solve(chain, Task(target, np.ones(3), np.full(3, 0.2), prior, stiffness), start, iterations=60)
        missed.append(residual.position + 0.2 * residual.rotation)
    assert np.mean(np.array(missed) < 1e-3) > 0.95


def test_a_target_out_of_reach_is_pointed_at() -> None:
    chain = arm(np.pi)
    prior = np.zeros(9)
    shoulder = tool(chain._replace(fixed=chain.fixed[:3], axes=chain.axes[:2]), prior[:2])[:3, 3]
    for direction in np.random.default_rng(5).normal(size=(20, 3)):
        direction /= np.linalg.norm(direction)
        q = seed(chain, 2, transform(None, shoulder + 3 * direction), prior, np.full(9, 1e-2), oriented=False)
        pointing = tool(chain, q)[:3, 3] - shoulder
        assert pointing @ direction / np.linalg.norm(pointing) == pytest.approx(1.0, abs=1e-9)

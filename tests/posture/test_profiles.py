"""Profiles: statistics of the Gaussian one against scipy, count and uniqueness of the incremental one, bad input."""

from __future__ import annotations

import math
import pickle
from typing import Any

import numpy as np
import pytest
from pydantic import TypeAdapter, ValidationError
from scipy.stats import kstest, truncnorm

from cabinpose.core.errors import ConfigError
from cabinpose.scene.body import DOF_INDEX, DOFS
from cabinpose.synth.profiles import GaussianProfile, IncrementalProfile, MocapProfile, Profile, limits_deg, truncated_normal

PROFILE: TypeAdapter[Any] = TypeAdapter(Profile)


@pytest.mark.parametrize(
    ("mean", "sigma", "low", "high"),
    [(0.0, 1.0, -8.0, 8.0), (0.3, 0.5, 0.0, 0.4), (0.0, 0.1, 1.0, 1.3), (0.0, 0.1, -1.3, -1.0), (2.0, 3.0, -1.0, 1.0)],
)
def test_truncated_normal_follows_scipys(mean: float, sigma: float, low: float, high: float) -> None:
    n = 20_000
    full = [np.full(n, v) for v in (mean, sigma, low, high)]
    drawn = truncated_normal(*full, rng=np.random.default_rng(3))
    assert low <= drawn.min()
    assert drawn.max() <= high
    reference = truncnorm((low - mean) / sigma, (high - mean) / sigma, loc=mean, scale=sigma)
    assert kstest(drawn, reference.cdf).pvalue > 0.01


def test_zero_sigma_is_the_mean_in_range() -> None:
    one = np.ones(3)
    drawn = truncated_normal(np.array([-5.0, 0.2, 9.0]), 0 * one, -one, one, rng=np.random.default_rng(0))
    np.testing.assert_array_equal(drawn, [-1.0, 0.2, 1.0])


def test_gaussian_profile_moves_only_its_axes() -> None:
    profile = GaussianProfile.model_validate(
        {"axes": {"lelbow.flexion": {"sigma_deg": 8}, "neck.rotation": {"mean_deg": 20, "sigma_deg": 5, "max_deg": 30}}}
    )
    q = np.zeros(len(DOFS))
    q[DOF_INDEX["lelbow.flexion"]] = 1.0
    rng = np.random.default_rng(5)
    drawn = np.array([profile.apply(q, index=0, rng=rng) for _ in range(4000)])
    moved = {DOFS[i].name for i in np.flatnonzero(np.ptp(drawn, axis=0))}
    assert moved == {"lelbow.flexion", "neck.rotation"}
    elbow = np.degrees(drawn[:, DOF_INDEX["lelbow.flexion"]])
    neck = np.degrees(drawn[:, DOF_INDEX["neck.rotation"]])
    assert elbow.mean() == pytest.approx(math.degrees(1.0), abs=0.5)
    assert elbow.std() == pytest.approx(8, rel=0.05)
    assert neck.max() <= 30 + 1e-9
    assert neck.mean() == pytest.approx(truncnorm(-20, 2, loc=20, scale=5).mean(), abs=0.3)
    again = np.random.default_rng(5)
    assert drawn.tobytes() == np.array([profile.apply(q, index=0, rng=again) for _ in range(4000)]).tobytes()


def test_incremental_count_and_uniqueness() -> None:
    profile = IncrementalProfile.model_validate(
        {
            "axes": {
                "relbow.flexion": {"min_deg": 0, "max_deg": 100, "step_deg": 25},
                "neck.lateral": {"min_deg": -10, "max_deg": 12, "step_deg": 5},
                "lhand.grip": {"min_deg": 0, "max_deg": 0.3, "step_deg": 0.1},
            }
        }
    )
    assert profile.count == 5 * 5 * 4
    q = np.zeros(len(DOFS))
    every = np.array([profile.apply(q, index=i, rng=np.random.default_rng(0)) for i in range(profile.count)])
    assert len(np.unique(every, axis=0)) == profile.count
    names = ("relbow.flexion", "neck.lateral", "lhand.grip")
    table = every[:, [DOF_INDEX[n] for n in names]]
    assert [tuple(r) for r in table] == sorted(tuple(r) for r in table)  # lexicographic, the last axis fastest
    np.testing.assert_allclose(np.unique(table[:, 0]), np.radians([0, 25, 50, 75, 100]))
    np.testing.assert_allclose(np.unique(table[:, 2]), [0, 0.1, 0.2, 0.3], atol=1e-12)
    for i in (-1, profile.count):
        with pytest.raises(ConfigError, match="does not exist"):
            profile.combination(i)


def test_incremental_is_lazy_in_its_count() -> None:
    axes = {d.name: {"step_deg": 0.01} for d in DOFS if d.upper - d.lower > 0.2 and not d.name.endswith("grip")}
    profile = IncrementalProfile.model_validate({"axes": axes})
    assert profile.count > 10**60
    last = profile.combination(profile.count - 1)
    for name, value in last.items():
        assert value <= DOFS[DOF_INDEX[name]].upper + 1e-12


BAD = {
    "unknown degree of freedom": ({"kind": "gaussian", "axes": {"lelbow.flex": {"sigma_deg": 1}}}, "unknown degree of freedom"),
    "beyond the limit": (
        {"kind": "incremental", "axes": {"lelbow.flexion": {"max_deg": 300, "step_deg": 5}}},
        "leaves the joint's limits",
    ),
    "min above max": (
        {"kind": "gaussian", "axes": {"lelbow.flexion": {"sigma_deg": 1, "min_deg": 60, "max_deg": 50}}},
        "min_deg 60 is above max_deg 50",
    ),
    "mean outside": (
        {"kind": "gaussian", "axes": {"lelbow.flexion": {"sigma_deg": 1, "mean_deg": 90, "max_deg": 50}}},
        "mean 90 lies outside",
    ),
    "end before start": ({"kind": "mocap", "path": "x.bvh", "start_s": 3, "end_s": 2}, "end_s 2 is not after"),
}


@pytest.mark.parametrize("name", BAD)
def test_bad_profiles(name: str) -> None:
    config, message = BAD[name]
    with pytest.raises(ConfigError, match=message) as caught:
        PROFILE.validate_python(config)
    assert caught.value.hint
    if "unknown" in name:
        assert "lelbow.flexion" in caught.value.hint


@pytest.mark.parametrize(
    "config",
    [
        {"kind": "gauss"},
        {"kind": "gaussian", "axis": {}},
        {"kind": "gaussian", "axes": {"lelbow.flexion": {"sigma_deg": -1}}},
        {"kind": "gaussian", "axes": {"lelbow.flexion": {"sigma_deg": "nan"}}},
        {"kind": "incremental", "axes": {}},
        {"kind": "incremental", "axes": {"lelbow.flexion": {"step_deg": 0}}},
    ],
)
def test_schema_errors(config: dict[str, Any]) -> None:
    with pytest.raises(ValidationError):
        PROFILE.validate_python(config)


def test_profiles_travel_to_workers() -> None:
    for config in (
        {"kind": "gaussian", "axes": {"lelbow.flexion": {"sigma_deg": 4}}},
        {"kind": "incremental", "axes": {"lelbow.flexion": {"step_deg": 30}}},
        {"kind": "mocap", "path": "x.bvh"},
    ):
        profile = PROFILE.validate_python(config)
        if isinstance(profile, GaussianProfile):
            profile.apply(np.zeros(len(DOFS)), index=0, rng=np.random.default_rng(0))
        if isinstance(profile, IncrementalProfile):
            assert profile.count > 1
        assert pickle.loads(pickle.dumps(profile)) == profile
        assert PROFILE.validate_json(profile.model_dump_json()) == profile
    assert PROFILE.json_schema()["discriminator"]["propertyName"] == "kind"
    assert isinstance(profile, MocapProfile)


def test_limits_are_degrees_except_the_grip() -> None:
    assert limits_deg("lelbow.flexion")[1] == pytest.approx(math.degrees(DOFS[DOF_INDEX["lelbow.flexion"]].upper))
    assert limits_deg("lhand.grip") == (0.0, 1.0)

"""Orientation errors in closed form, and on BROAD's trials against the figures published with VQF."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from broad import broad_errors
from scipy.spatial.transform import Rotation

from cabinpose.core.errors import AlignmentError, MocapError
from cabinpose.evaluate.mocap.orientation import orientation_errors

TRUTH = Rotation.random(100, rng=np.random.default_rng(0))


def wxyz(rotation: Rotation) -> np.ndarray:
    return rotation.as_quat(scalar_first=True)


def test_heading_and_inclination_come_apart() -> None:
    level = orientation_errors(wxyz(Rotation.from_rotvec((0, 0, -0.1)) * TRUTH), wxyz(TRUTH))
    assert (level.total_rad, level.heading_rad, level.inclination_rad) == pytest.approx((0.1, 0.1, 0), abs=1e-9)
    tilted = orientation_errors(wxyz(Rotation.from_rotvec((0.03, -0.04, 0)) * TRUTH), -wxyz(TRUTH))
    assert (tilted.total_rad, tilted.heading_rad, tilted.inclination_rad) == pytest.approx((0.05, 0, 0.05), abs=1e-9)


def test_a_constant_heading_is_removed_where_that_is_asked() -> None:
    sway = np.zeros((100, 3))
    sway[:, 2] = 2.0 + 0.02 * np.where(np.arange(100) % 2, 1, -1)
    found = orientation_errors(wxyz(Rotation.from_rotvec(sway) * TRUTH), wxyz(TRUTH), heading="removed")
    assert found.removed_rad == pytest.approx(2.0)
    assert found.total_rad == pytest.approx(0.02)


def test_only_frames_that_count_and_are_known_do() -> None:
    q = wxyz(TRUTH).copy()
    q[:10] = np.nan
    counts = np.arange(100) < 30
    assert orientation_errors(q, wxyz(TRUTH), counts=counts).frames == 20
    with pytest.raises(AlignmentError, match="no frame counts"):
        orientation_errors(q, wxyz(TRUTH), counts=np.arange(100) < 10)
    with pytest.raises(AlignmentError, match="of the same frames"):
        orientation_errors(q[:5], wxyz(TRUTH))


@pytest.mark.real_data
@pytest.mark.parametrize(
    ("trial", "published_deg"),
    [("02_undisturbed_slow_rotation_B", 1.38), ("07_undisturbed_fast_rotation_B", 1.75), ("21_undisturbed_fast_combined", 4.08)],
)
def test_vqf_on_broad_gives_the_published_error(real_data: Callable[[str], Path], trial: str, published_deg: float) -> None:
    path = real_data(f"broad/{trial}.mat")
    pytest.importorskip("vqf")
    found = broad_errors(path)
    assert np.degrees(found.total_rad) == pytest.approx(published_deg, abs=0.05)
    blind = broad_errors(path, magnetometer=False)
    assert blind.inclination_rad == pytest.approx(found.inclination_rad, rel=1e-6)  # the magnetometer turns the heading alone


def test_another_file_is_no_trial(tmp_path: Path) -> None:
    pytest.importorskip("vqf")
    (tmp_path / "a.mat").write_bytes(b"not a file of anybody's")
    with pytest.raises(MocapError, match="cannot be read"):
        broad_errors(tmp_path / "a.mat")

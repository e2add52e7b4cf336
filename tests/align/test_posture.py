"""The correction by a known posture against a body that was put together with known errors."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from cabinpose.align.posture import corrected_orientations, initial_pose_correction, rebuilt
from cabinpose.core.errors import AlignmentError
from cabinpose.core.skeleton import MVN_JOINTS, MVN_SEGMENTS

COUNT = len(MVN_SEGMENTS)
HEAD = MVN_SEGMENTS.index("Head")


def _body(turns: Rotation, offsets: np.ndarray, start: np.ndarray) -> np.ndarray:
    """(S, 3) origins of the segments with orientations (S,), by the tree of MVN's joints."""
    index = {name: s for s, name in enumerate(MVN_SEGMENTS)}
    matrices = turns.as_matrix()
    p = np.zeros((COUNT, 3))
    p[0] = start
    for _, parent, child in MVN_JOINTS:
        p[index[child]] = p[index[parent]] + matrices[index[parent]] @ offsets[index[child]]
    return p


def _take(seed: int, heading_deg: float = 0.0, frames: int = 12):
    """True and measured positions and orientations of a moving body; the first 4 frames hold an upright posture."""
    rng = np.random.default_rng(seed)
    offsets = rng.normal(size=(COUNT, 3)) * 0.2
    error = Rotation.from_rotvec(rng.normal(size=(COUNT, 3)) * np.deg2rad(5))
    known = Rotation.from_rotvec(rng.normal(size=(COUNT, 3)) * 0.3)
    world = Rotation.from_euler("z", heading_deg, degrees=True)
    truth_p, truth_q, p, q = [], [], [], []
    for frame in range(frames):
        true = known if frame < 4 else known * Rotation.from_rotvec(rng.normal(size=(COUNT, 3)) * 0.4)
        start = np.array((0.0, 0.0, 0.9))
        truth_p.append(world.apply(_body(true, offsets, start)))
        truth_q.append((world * true).as_quat(scalar_first=True))
        measured = world * true * error
        p.append(_body(measured, offsets, start))
        q.append(measured.as_quat(scalar_first=True))
    return tuple(np.array(x) for x in (truth_p, truth_q, p, q)), known.as_quat(scalar_first=True), error


def _same(q: np.ndarray, other: np.ndarray) -> float:
    a, b = (Rotation.from_quat(x.reshape(-1, 4), scalar_first=True) for x in (q, other))
    return float((a.inv() * b).magnitude().max())


def test_constant_errors_are_found_and_the_body_is_put_together_anew():
    (true_p, true_q, p, q), known, error = _take(1)
    correction = initial_pose_correction(q[:4], known, free_heading=False)
    assert (Rotation.from_quat(correction.error_wxyz, scalar_first=True).inv() * error).magnitude().max() < 1e-9
    positions, turns = rebuilt(p, q, correction)
    assert _same(turns, true_q) < 1e-9
    relative = true_p - true_p[:, [HEAD]]
    assert np.abs(positions - positions[:, [HEAD]] - relative).max() < 1e-9
    assert np.abs(positions[:, HEAD] - p[:, HEAD]).max() < 1e-12
    assert np.abs(p - p[:, [HEAD]] - relative).max() > 0.05  # there was something to mend


def test_heading_of_the_suit_is_no_error_of_the_segments():
    (_, _, _, q), known, error = _take(2, heading_deg=130)
    correction = initial_pose_correction(q[:4], known)
    # A turn that all errors have in common about the vertical cannot be told from the heading.
    assert np.rad2deg(correction.heading_rad) == pytest.approx(130, abs=3)
    left = (Rotation.from_quat(correction.error_wxyz, scalar_first=True).inv() * error).magnitude()
    assert np.rad2deg(left).max() < 3
    with pytest.raises(AlignmentError, match="another one"):
        initial_pose_correction(q[:4], known, free_heading=False)


def test_segments_without_a_known_posture_stay_as_they_are():
    (_, _, _, q), known, _ = _take(3)
    known[5:] = np.nan
    correction = initial_pose_correction(q[:4], known, free_heading=False)
    turns = corrected_orientations(q, correction)
    assert correction.corrected.tolist() == [True] * 5 + [False] * (COUNT - 5)
    assert _same(turns[:, 5:], q[:, 5:]) < 1e-12
    assert _same(turns[:, :5], q[:, :5]) > 0.01


def test_missing_segments_stay_missing():
    (_, _, p, q), known, _ = _take(4)
    q[6, 3] = np.nan
    correction = initial_pose_correction(q[:4], known, free_heading=False)
    positions, turns = rebuilt(p, q, correction, anchor="Pelvis")
    assert np.isnan(turns[6, 3]).all()
    assert np.isfinite(positions[6, :4]).all()  # the missing segment's own origin hangs on its parent
    assert np.isnan(positions[6, 4]).all()
    assert np.isfinite(np.delete(positions, 6, axis=0)).all()


def test_a_posture_that_was_not_held_is_refused():
    (_, _, _, q), known, _ = _take(5)
    with pytest.raises(AlignmentError, match="not held"):
        initial_pose_correction(q, known)


@pytest.mark.parametrize(
    ("wxyz", "posture", "says"),
    [
        (np.ones((3, 5, 4)), np.ones((5, 4)), "are needed"),
        (np.ones((3, COUNT, 4)), np.full((COUNT, 4), np.nan), "no segment"),
    ],
)
def test_a_posture_that_fits_no_suit_is_refused(wxyz, posture, says):
    with pytest.raises(AlignmentError, match=says):
        initial_pose_correction(wxyz, posture)


def test_an_unknown_anchor_is_refused():
    (_, _, p, q), known, _ = _take(6)
    correction = initial_pose_correction(q[:4], known, free_heading=False)
    with pytest.raises(AlignmentError, match="not there"):
        rebuilt(p, q, correction, anchor="Nose")

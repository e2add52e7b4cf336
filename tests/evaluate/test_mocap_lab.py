"""The evaluations on a take of the virtual laboratory: they find the errors that its suit was given."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from cabinpose.app.cli.evaluate_mocap import EvaluateDfe, EvaluateDse
from cabinpose.app.lab.rig import VirtualRig
from cabinpose.app.lab.takes import Truth, dress_up, write_motion_take
from cabinpose.app.mocap.compare import dfe_runs, dse_runs
from cabinpose.app.mocap.inputs import read_motion
from cabinpose.core.skeleton import MVN_SEGMENTS
from cabinpose.evaluate.mocap.dfe import KABSCH
from cabinpose.evaluate.mocap.pairs import JOINT_PAIRS, SEGMENT_PAIRS
from cabinpose.evaluate.mocap.sfe import find_poses, sfe_run
from cabinpose.signals.resample import resample_positions, resample_rotations
from cabinpose.signals.rotations import angle, since_first

pytest.importorskip("mcap")
pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def take(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Truth]:
    """Movements in all planes, an optical system that measures without noise, and a suit that does not."""
    path = tmp_path_factory.mktemp("lab") / "planes.mcap"
    rng = np.random.Generator(np.random.Philox(key=3))
    return path, write_motion_take(path, VirtualRig(optical_noise_m=0.0, optical_occlusion=False), dress_up(rng=rng), rng=rng)


def test_dse_finds_the_suits_own_errors(take: tuple[Path, Truth]) -> None:
    path, truth = take
    (run,), notes = dse_runs(path, "", EvaluateDse())
    assert "from the turning of 14 segments" in notes[0]
    suit = read_motion(path, source="suit")
    true_s = (truth.suit_ns - truth.suit_ns[0]) / 1e9
    said = since_first(resample_rotations(suit.time_s, suit.orientation_wxyz, true_s, max_gap_s=0.1))
    error = np.abs(angle(said) - angle(since_first(truth.suit_orientation_wxyz)))
    # The optical model's one segment of the trunk turns with the loins: what the suit says of the chest is no error of its own.
    names = {p.name: p.suit for p in SEGMENT_PAIRS if p.name in run.names and p.name != "chest"}
    assert len(names) == 13
    found = [np.nanmedian(run.difference_rad[:, run.names.index(name)]) for name in names]
    expected = [np.nanmedian(error[:, MVN_SEGMENTS.index(suit)]) for suit in names.values()]
    np.testing.assert_allclose(np.degrees(found), np.degrees(expected), atol=0.15)


def test_sfe_finds_where_the_suit_left_the_joints(take: tuple[Path, Truth]) -> None:
    path, truth = take
    suit = read_motion(path, source="suit")
    first, last = find_poses(suit.time_s, suit.position_m, suit.names)
    run = sfe_run(suit.time_s, suit.position_m, suit.orientation_wxyz, suit.names, (first, last))
    spans = (truth.window_ns - truth.suit_ns[0]) / 1e9
    assert first.end_s == pytest.approx(spans[0, 1], abs=0.5)
    assert last.start_s == pytest.approx(spans[-1, 0], abs=0.5)
    true_s = (truth.suit_ns - truth.suit_ns[0]) / 1e9
    position, turned = truth.suit_position, truth.suit_orientation_wxyz
    true = sfe_run(true_s, position, turned, MVN_SEGMENTS, (first, last))
    assert np.median(true.error_m) < 0.002  # the person repeats the pose
    assert 0.001 < np.median(run.error_m) < 0.02


def test_dfe_finds_where_the_suit_puts_the_joints(take: tuple[Path, Truth]) -> None:
    """Held against the true segments in place of the optical model, body laid on body by scipy."""
    path, truth = take
    (run,), _ = dfe_runs(path, "", EvaluateDfe(rate=10.0))
    suit = read_motion(path, source="suit")
    joints = {p.name: p.suit for p in JOINT_PAIRS if p.name in run.names}
    columns = [MVN_SEGMENTS.index(segment) for segment in joints.values()]
    true = truth.suit_position[::6, columns]
    true_s = ((truth.suit_ns - truth.suit_ns[0]) / 1e9)[::6]
    at = [suit.names.index(segment) for segment in joints.values()]
    said = resample_positions(suit.time_s, suit.position_m[:, at], true_s, max_gap_s=0.1)
    error = []
    for a, b in zip(said[1:-1], true[1:-1], strict=True):
        turn, _ = Rotation.align_vectors(a - a.mean(axis=0), b - b.mean(axis=0))
        error.append(np.linalg.norm(a - a.mean(axis=0) - turn.apply(b - b.mean(axis=0)), axis=1))
    expected = np.median(error, axis=0)
    found = np.nanmedian(run.position_error_m(KABSCH), axis=0)
    assert np.median(expected) > 0.008  # there is something to find
    # the optical model's head and chest are other points of the body than the suit's
    same = [n for n, name in enumerate(run.names) if name not in ("head", "neck", "chest", "hip")]
    np.testing.assert_allclose(found[same], expected[same], atol=0.003)


def test_the_commands_read_it(take: tuple[Path, Truth], run: Callable[..., Any]) -> None:
    done = run("evaluate-mocap", "dfe", take[0], "--rate", "10", "--resamples", "10")
    assert done.code == 0
    assert "position, pelvis + ICP" in done.out

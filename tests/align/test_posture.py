"""The correction of the initial pose saidst a body that was put together with known errors."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from cabinpose.align.posture import n_pose, optical_pose, pose_shifts, shifted
from cabinpose.align.suit import CARRIER, JOINT_POINTS, POINTS
from cabinpose.core.errors import AlignmentError

HEAD = POINTS.index("Head")
SHOULDERS = [POINTS.index(f"{side}Shoulder") for side in ("Left", "Right")]


def _put_together(turns: Rotation, offsets: np.ndarray) -> np.ndarray:
    """(25, 4, 4) of points turned like this, each at its offset in its carrier's axes."""
    poses = np.tile(np.eye(4), (len(POINTS), 1, 1))
    poses[:, :3, :3] = turns.as_matrix()
    for point, carrier in enumerate(CARRIER):
        if carrier >= 0:
            poses[point, :3, 3] = poses[carrier, :3, 3] + poses[carrier, :3, :3] @ offsets[point]
    return poses


def _body(seed: int, heading_deg: float = 0.0, error_deg: float = 5.0, longer: float = 0.0, exact: list[int] | None = None):
    """Moments of a body, true and as a suit with constant errors says: 4 of an N-pose with arms 7 degrees off, then 8 others."""
    rng = np.random.default_rng(seed)
    offsets = rng.normal(size=(len(POINTS), 3)) * 0.15
    wrong = rng.normal(size=(len(POINTS), 3)) * np.radians(error_deg)
    wrong[exact or []] = 0.0
    error = Rotation.from_rotvec(wrong)
    upright = np.zeros((len(POINTS), 3))
    for side, sign in (("Left", -1), ("Right", 1)):
        for part in ("UpperArm", "Forearm", "Hand"):
            upright[POINTS.index(side + part), 0] = sign * np.radians(90 - 7)
    world = Rotation.from_euler("z", heading_deg, degrees=True)
    true, said = [], []
    for moment in range(12):
        turns = world * Rotation.from_rotvec(upright)
        if moment >= 4:
            turns = turns * Rotation.from_rotvec(rng.normal(size=(len(POINTS), 3)) * 0.5)
        true.append(_put_together(turns, offsets * (1 + longer)))
        said.append(_put_together(turns * error, offsets))
    return np.array(true), np.array(said)


def _from_head(places: np.ndarray) -> np.ndarray:
    return places - places[:, [HEAD]]


def test_an_optical_truth_of_all_points_mends_turns_and_lengths_in_every_pose():
    true, said = _body(1, longer=0.05)
    shifts = pose_shifts(said[:4], true[:4, :, :3, 3] + (1.0, 2.0, 0.5))  # in which world it stands does not matter
    found, truth = _from_head(shifted(said, shifts)), _from_head(true[..., :3, 3])
    assert np.abs(found - truth).max() < 1e-12
    assert np.abs(_from_head(said[..., :3, 3]) - truth).max() > 0.03  # there was something to mend
    assert np.abs(shifted(said, shifts)[:, HEAD] - said[:, HEAD, :3, 3]).max() < 1e-12


def test_the_n_pose_mends_turns_but_those_of_the_shoulders():
    true, said = _body(2, exact=SHOULDERS)
    shifts = pose_shifts(said[:4], n_pose(said[:4], np.radians(7)))
    truth = _from_head(true[..., :3, 3])
    found = _from_head(shifted(said, shifts))
    # The heading is the mean over all segments: what their errors have in common about the vertical stays.
    assert np.sqrt(np.mean((found - truth) ** 2)) < 0.2 * np.sqrt(np.mean((_from_head(said[..., :3, 3]) - truth) ** 2))
    wrong = _from_head(shifted(said, pose_shifts(said[:4], n_pose(said[:4]))))
    left = POINTS.index("LeftForearm")
    assert np.abs(wrong - truth)[:, left].max() > 3 * np.abs(found - truth)[:, left].max()


def test_the_heading_of_the_suit_is_no_error():
    for heading in (130.0, -60.0):
        _, straight = _body(3, 0.0, error_deg=2.0)
        _, turned = _body(3, heading, error_deg=2.0)
        found = pose_shifts(turned[:4], n_pose(turned[:4], np.radians(7)))
        assert np.abs(found - pose_shifts(straight[:4], n_pose(straight[:4], np.radians(7)))).max() < 1e-9
    true, _ = _body(4, 77.0)
    assert np.abs(pose_shifts(true[:4], n_pose(true[:4], np.radians(7)))).max() < 1e-12


def test_points_without_a_truth_stay_and_the_rest_ends_where_it_is():
    true, said = _body(5)
    places = np.full(true.shape[:2] + (3,), np.nan)
    places[:, JOINT_POINTS] = true[..., :3, 3][:, JOINT_POINTS]
    shifts = pose_shifts(said[:4], places[:4])
    assert np.abs(_from_head(shifted(said[:4], shifts)) - _from_head(true[:4, :, :3, 3]))[:, JOINT_POINTS].max() < 1e-12
    assert (shifts[[POINTS.index(name) for name in ("T12", "LeftShoulder")]] == 0).all()  # nothing says where they are
    elbow, upper = POINTS.index("LeftForearm"), POINTS.index("LeftUpperArm")
    bent = (shifted(said, shifts) - true[..., :3, 3])[:, [upper, elbow]]
    assert np.abs(bent[:, 1] - bent[:, 0]).max() < 1e-12  # a limb between two known joints holds in every pose


def test_the_optical_world_is_turned_to_the_suits_heading_and_to_nothing_else():
    true, said = _body(8)
    world = Rotation.from_euler("z", 200, degrees=True)
    head = world.as_matrix() @ said[:4, HEAD, :3, :3]  # both systems agree on the head
    places = optical_pose(said[:4], world.apply(true[:4, :, :3, 3].reshape(-1, 3)).reshape(4, -1, 3), head)
    assert np.abs(_from_head(places) - _from_head(true[:4, :, :3, 3])).max() < 1e-12
    tilted = Rotation.from_euler("y", 3, degrees=True).as_matrix() @ head  # what skin moves under the sensor
    again = optical_pose(said[:4], world.apply(true[:4, :, :3, 3].reshape(-1, 3)).reshape(4, -1, 3), tilted)
    assert np.abs(again - places).max() < 0.002


def test_missing_moments_are_left_out():
    true, said = _body(6)
    full = pose_shifts(said[:4], true[:4, :, :3, 3])
    places = true[:4, :, :3, 3].copy()
    places[1, 5:] = np.nan
    said[2, 9] = np.nan
    assert np.abs(pose_shifts(said[:4], places) - full).max() < 1e-12
    assert np.isnan(shifted(said, full)[2, 9]).all()


def test_a_pose_that_was_not_held_or_was_another_one_is_refused():
    true, said = _body(7)
    with pytest.raises(AlignmentError, match=r"the pose was not held: \w+ turned by"):
        pose_shifts(said, true[..., :3, 3])
    with pytest.raises(AlignmentError, match=r"the pose was another one: \w+ is \d+ cm off"):
        pose_shifts(said[:4], n_pose(said[:4], np.radians(90)))
    nothing = np.full(true.shape[:2] + (3,), np.nan)
    with pytest.raises(AlignmentError, match="the pose is not known"):
        pose_shifts(said[:4], nothing[:4])

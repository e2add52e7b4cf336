"""DSE: sensors on segments, each with an error that is known."""

from __future__ import annotations

import moving_body
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from cabinpose.core.errors import AlignmentError, ConfigError
from cabinpose.core.skeleton import CABINPOSE, MVN_SEGMENTS
from cabinpose.evaluate.mocap.dse import DIFFERENCE, GEODESIC, dse, dse_run
from cabinpose.evaluate.mocap.pairs import JOINT_PAIRS, SEGMENT_PAIRS, missing, present, replaced

TIME = np.arange(0, 20, 0.05)


def worn(orientation: np.ndarray, *, heading: float = 0.7, seed: int = 4) -> np.ndarray:
    """What sensors say of the segments: mounted anyhow, in a world with another heading."""
    mount = Rotation.random(orientation.shape[1], rng=np.random.default_rng(seed))
    world = Rotation.from_rotvec((0, 0, -heading))
    said = [
        (world * Rotation.from_quat(orientation[:, i], scalar_first=True) * mount[i]).as_quat(scalar_first=True)
        for i in range(orientation.shape[1])
    ]
    return np.stack(said, axis=1)


def test_mounting_heading_and_signs_are_no_error() -> None:
    _, truth = moving_body.moving(TIME)
    said = worn(truth) * np.random.default_rng(0).choice((-1, 1), (*truth.shape[:2], 1))
    run = dse_run(TIME, said, truth, MVN_SEGMENTS)
    assert run.difference_rad.max() < 1e-12
    assert run.geodesic_rad.max() < 1e-12
    assert run.heading_rad == pytest.approx(0.7, abs=1e-12)


def test_a_turn_about_its_own_axis_recovers_the_injected_error() -> None:
    """Truth turns about x by θ(t); the sensor by θ(t) (1 + 2 %): both errors are 2 % of θ, in closed form."""
    theta = np.radians(60) * np.sin(TIME / 3)
    truth, said = (Rotation.from_rotvec(k * theta[:, None] * (1.0, 0, 0)).as_quat(scalar_first=True)[:, None] for k in (1, 1.02))
    run = dse_run(TIME, said, truth, ["thigh"], heading_rad=0.0)
    expected = 0.02 * np.abs(theta)
    np.testing.assert_allclose(run.difference_rad[:, 0], expected, atol=1e-12)
    np.testing.assert_allclose(run.geodesic_rad[:, 0], expected, atol=1e-12)
    row = dse([run], rng=np.random.default_rng(0), resamples=0).summary(DIFFERENCE)
    assert row.mean == pytest.approx(np.degrees(expected.mean()))
    assert row.sd == pytest.approx(np.degrees(expected.std(ddof=1)))


def test_the_difference_of_angles_cannot_see_a_wrong_axis() -> None:
    """Turned by 60° about x, the sensor says 60° about y: no difference; the turns are arccos(...) apart."""
    theta = np.radians(60) * TIME / TIME[-1]
    truth = Rotation.from_rotvec(theta[:, None] * (1.0, 0, 0))
    said = Rotation.from_rotvec(theta[:, None] * (0, 1.0, 0))
    run = dse_run(TIME, *(q.as_quat(scalar_first=True)[:, None] for q in (said, truth)), ["thigh"], heading_rad=0.0)
    assert run.difference_rad.max() < 1e-12
    # product of half-turn quaternions: w = cos² (θ/2)
    np.testing.assert_allclose(run.geodesic_rad[:, 0], 2 * np.arccos(np.cos(theta / 2) ** 2), atol=1e-7)


def test_the_angle_between_the_turns_is_never_the_less() -> None:
    rng = np.random.default_rng(5)
    a, b = (Rotation.random(400, rng=rng).as_quat(scalar_first=True).reshape(100, 4, 4) for _ in range(2))
    run = dse_run(np.arange(100.0), a, b, list("abcd"))
    assert (run.geodesic_rad >= run.difference_rad - 1e-12).all()


def test_planes_are_told_apart_and_the_first_known_frame_counts() -> None:
    _, truth = moving_body.moving(TIME)
    said = worn(truth)
    said[:7, 3] = np.nan
    runs = [dse_run(TIME, said, truth, MVN_SEGMENTS, condition=plane) for plane in ("coronal", "sagittal")]
    assert np.isnan(runs[0].difference_rad[:7, 3]).all()
    assert runs[0].suit_rad[7, 3] == 0
    assert runs[0].optical_rad[7, 3] == 0
    assert np.nanmax(runs[0].difference_rad) < 1e-12
    result = dse(runs, rng=np.random.default_rng(0), resamples=0)
    assert {s.condition for s in result.summaries} == {"All", "coronal", "sagittal"}
    assert result.summary(GEODESIC, "sagittal", MVN_SEGMENTS[3]).samples == len(TIME) - 7


def test_without_a_horizontal_turn_the_heading_stays_unknown() -> None:
    truth = Rotation.from_rotvec(np.stack((0 * TIME, 0 * TIME, TIME / 10), axis=1)).as_quat(scalar_first=True)[:, None]
    run = dse_run(TIME, truth, truth, ["head"])
    assert np.isnan(run.heading_rad)
    assert np.isnan(run.geodesic_rad).all()
    assert run.difference_rad.max() < 1e-12
    assert "heading is not known" in dse([run], rng=np.random.default_rng(0), resamples=0).notes[0]


def test_what_cannot_be_told_is_an_error() -> None:
    _, truth = moving_body.moving(TIME)
    with pytest.raises(AlignmentError, match="are needed"):
        dse_run(TIME, truth[:-1], truth, MVN_SEGMENTS)
    with pytest.raises(AlignmentError, match="no segment is known by both"):
        dse_run(TIME, np.full_like(truth, np.nan), truth, MVN_SEGMENTS)


def test_the_tables_hold_what_the_thesis_has() -> None:
    assert len(SEGMENT_PAIRS) == 17
    assert len({p.name for p in JOINT_PAIRS}) == 20
    assert {p.suit for p in SEGMENT_PAIRS} <= set(MVN_SEGMENTS)
    optical = {p.name: p.optical for p in SEGMENT_PAIRS}
    assert (optical["lshoulder"], optical["rforearm"], optical["chest"]) == ("L_Collar", "R_Elbow", "LowerBack")
    joints = {p.name: (p.suit, p.optical) for p in JOINT_PAIRS}
    assert joints["lelbow"] == ("LeftForearm", "L_Elbow")
    assert {p.optical for p in JOINT_PAIRS} <= {*CABINPOSE.maps["vicon_kinematic_fit"].values(), "R_Collar"}
    # its table 3.2, as names of the kinematic fit: head, elbows, wrists, ends of the hands, legs, neck, chest, pelvis
    sides = ("Elbow", "Wrist", "Wrist_End", "Femur", "Tibia", "Foot", "Toe")
    table = {"Head_End", "Head", "R_Collar", "LowerBack", *(f"{side}_{name}" for side in "LR" for name in sides)}
    assert table <= {p.optical for p in JOINT_PAIRS}
    assert len(table) == 18
    both = [["T8", "Head"], ["R_Collar", "Head"]]
    assert [p.optical for p in present(JOINT_PAIRS, *both)] == ["R_Collar"]
    both[1].append("LowerBack_L_Collar")
    assert [p.optical for p in present(JOINT_PAIRS, *both)] == ["LowerBack_L_Collar"]


def test_pairs_that_were_not_recorded_are_named() -> None:
    optical = [p.optical for p in SEGMENT_PAIRS if p.optical != "Root"]
    found = present(SEGMENT_PAIRS, MVN_SEGMENTS, optical)
    assert len(found) == 16
    assert missing(SEGMENT_PAIRS, found) == "not recorded by both systems: pelvis"
    with pytest.raises(AlignmentError, match=r"0 of 17 pairs .* missing: Head \(optical\), L_Collar") as caught:
        present(SEGMENT_PAIRS, MVN_SEGMENTS, ["torso"])
    assert "the optical system gives: torso" in str(caught.value.hint)
    assert replaced(SEGMENT_PAIRS, {"pelvis": "Hips"})[-1].optical == "Hips"
    with pytest.raises(ConfigError, match="unknown pair 'tail'"):
        replaced(SEGMENT_PAIRS, {"tail": "Hips"})

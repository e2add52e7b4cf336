"""DFE: a suit that is wrong by a known amount, in a world of its own."""

from __future__ import annotations

import moving_body
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from cabinpose.core.errors import AlignmentError
from cabinpose.evaluate.mocap.dfe import (
    DISPLACEMENT,
    ICP,
    KABSCH,
    PELVIS_STAGE,
    POSITION,
    RAW,
    STAGES,
    dfe,
    dfe_run,
    pelvis_frames,
)

NAMES, COLUMNS = zip(*moving_body.STREAMED.items(), strict=True)
TIME = np.arange(0, 6, 0.1)


def body(amplitude: float = 0.5) -> np.ndarray:
    return moving_body.moving(TIME, amplitude=amplitude)[0][:, COLUMNS]


def elsewhere(position: np.ndarray, heading: float = 1.1) -> np.ndarray:
    return Rotation.from_rotvec((0, 0, heading)).apply(position.reshape(-1, 3)).reshape(position.shape) + (3.0, -2.0, 0.1)


def test_another_world_is_an_error_of_the_raw_stage_alone() -> None:
    optical = body()
    run = dfe_run(TIME, elsewhere(optical), optical, NAMES)
    assert run.position_error_m(RAW).min() > 2.0
    for stage in STAGES[1:]:
        assert run.position_error_m(stage).max() < 1e-12
    assert (run.wrong == 0).all()


def test_an_elbow_that_is_off_is_recovered_after_the_pelvis() -> None:
    optical = body()
    suit = optical.copy()
    elbow = NAMES.index("lelbow")
    suit[:, elbow] += (0.0, 0.0, 0.02)
    run = dfe_run(TIME, elsewhere(suit), optical, NAMES)
    error = run.position_error_m(PELVIS_STAGE)
    np.testing.assert_allclose(error[:, elbow], 0.02, atol=1e-12)
    assert np.delete(error, elbow, axis=1).max() < 1e-12
    # Fitted as a whole, 1 of 18 points that is off by d takes part of it: a shift of d/18, and some turn.
    fitted = run.position_error_m(KABSCH)
    assert 0.5 * 0.02 < fitted[:, elbow].min() <= fitted[:, elbow].max() < 0.02 * 17 / 18
    assert (np.square(fitted).sum(axis=1) <= np.square(error).sum(axis=1) + 1e-15).all()


def test_a_turned_pelvis_is_what_the_fits_take_out() -> None:
    """L5 is off: the pelvis' frame pitches by arctan(...), every joint moves, and the rigid fit undoes all but L5's own error."""
    optical = body(0.2)
    suit = optical.copy()
    frame = pelvis_frames(*(optical[:, NAMES.index(n)] for n in ("lpelvis", "rpelvis", "hip")))
    suit[:, NAMES.index("hip")] += 0.01 * frame[:, :3, 0]
    run = dfe_run(TIME, suit, optical, NAMES)
    foot = NAMES.index("lfoot")
    reach = np.linalg.norm(run.optical_m[PELVIS_STAGE][:, foot], axis=-1)
    raised = (run.optical_m[PELVIS_STAGE][:, NAMES.index("hip")])[:, 2]
    pitched = 2 * np.sin(np.arctan2(0.01, raised) / 2)  # the chord of a unit lever square to the axis
    assert (run.position_error_m(PELVIS_STAGE)[:, foot] <= reach * pitched + 1e-12).all()
    assert (run.position_error_m(PELVIS_STAGE)[:, foot] > 0.5 * reach * pitched).all()
    assert run.position_error_m(KABSCH)[:, foot].max() < 0.003
    np.testing.assert_allclose(run.position_error_m(ICP), run.position_error_m(KABSCH), atol=1e-9)


def test_a_constant_difference_of_the_models_drops_out_of_the_displacement() -> None:
    optical = body()
    suit = optical + np.random.default_rng(1).normal(0, 0.02, (1, len(NAMES), 3))  # of the world, the same all the time
    run = dfe_run(TIME, suit, optical, NAMES)
    assert run.displacement_error_m(RAW).max() < 1e-12
    assert run.position_error_m(RAW).mean() > 0.02


def test_displacement_counts_from_the_first_frame_that_both_know() -> None:
    optical = body()
    suit = optical + 0.03 * TIME[:, None, None] * np.array((0.0, 0.6, 0.8))  # drifts by 30 mm/s
    knee = NAMES.index("lknee")
    suit[:4, knee] = np.nan
    error = dfe_run(TIME, suit, optical, NAMES).displacement_error_m(RAW)
    np.testing.assert_allclose(error[:, NAMES.index("head")], 0.03 * TIME, atol=1e-12)
    np.testing.assert_allclose(error[4:, knee], 0.03 * (TIME[4:] - TIME[4]), atol=1e-12)


def test_icp_that_pairs_wrongly_tells_so() -> None:
    optical = body(0.1)
    suit = optical.copy()
    suit[:, NAMES.index("neck")] = optical[:, NAMES.index("head")] + (0, 0, 0.01)  # nearer to the head than the neck
    run = dfe_run(TIME, suit, optical, NAMES)
    assert run.wrong.min() >= 1 / 18
    note = dfe([run], rng=np.random.default_rng(0), resamples=0).notes[0]
    assert "60 of 60 frames" in note
    assert "with another one" in note


def test_noise_of_known_size_is_the_error() -> None:
    """Isotropic noise σ on 15 joints, none on the pelvis': after the pelvis the mean error is σ √(8/π), Maxwell's."""
    optical = np.repeat(body(), 5, axis=0)
    time = np.arange(len(optical)) / 50
    noise = np.random.default_rng(7).normal(0, 0.01, optical.shape)
    fixed = [NAMES.index(n) for n in ("lpelvis", "rpelvis", "hip")]
    noise[:, fixed] = 0
    run = dfe_run(time, optical + noise, optical, NAMES)
    result = dfe([run], rng=np.random.default_rng(0), resamples=50)
    row = result.summary(f"{POSITION}, {PELVIS_STAGE}", name="rhand" if "rhand" in NAMES else "rwrist")
    assert row.mean == pytest.approx(10 * np.sqrt(8 / np.pi), rel=0.06)
    assert row.mean_low < 10 * np.sqrt(8 / np.pi) < row.mean_high
    assert [s.measure for s in result.summaries if s.name == "All"] == [
        f"{w}, {s}" for w in (POSITION, DISPLACEMENT) for s in STAGES
    ]


def test_missing_joints_and_frames_are_left_out() -> None:
    optical = body()
    suit = elsewhere(optical)
    suit[3, NAMES.index("hip")] = np.nan  # no pelvis
    suit[5, NAMES.index("lknee")] = np.nan
    run = dfe_run(TIME, suit, optical, NAMES)
    assert np.isnan(run.position_error_m(PELVIS_STAGE)[3]).all()
    assert np.isfinite(run.position_error_m(RAW)[3]).sum() == 17
    assert np.isfinite(run.position_error_m(ICP)[5]).sum() == 17
    assert np.isnan(run.wrong[3])


def test_swapped_sides_are_an_error() -> None:
    optical = body(0.8)
    suit = elsewhere(optical)
    for left in ("lwrist", "lelbow", "lshoulder"):
        pair = [NAMES.index(left), NAMES.index("r" + left[1:])]
        suit[:, pair] = suit[:, pair[::-1]]
    with pytest.raises(AlignmentError, match="'lshoulder' of one system lies where 'rshoulder' of the other is") as caught:
        dfe_run(TIME, suit, optical, NAMES)
    assert "swapped" in str(caught.value.hint)
    whole = elsewhere(optical)
    sides = {n: "rl"["lr".index(n[0])] + n[1:] if "rl"["lr".index(n[0])] + n[1:] in NAMES else n for n in NAMES if n[0] in "lr"}
    swap = [NAMES.index(sides.get(n, n)) for n in NAMES]
    with pytest.raises(AlignmentError, match="sides of one body"):
        dfe_run(TIME, whole[:, swap], optical, NAMES)


def test_what_cannot_be_told_is_an_error() -> None:
    optical = body()
    keep = [i for i, n in enumerate(NAMES) if n != "hip"]
    with pytest.raises(AlignmentError, match="the pelvis' frame needs hip"):
        dfe_run(TIME, optical[:, keep], optical[:, keep], [NAMES[i] for i in keep])
    with pytest.raises(AlignmentError, match="in no frame do both systems know the pelvis"):
        dfe_run(TIME, np.full_like(optical, np.nan), optical, NAMES)
    with pytest.raises(AlignmentError, match="are needed"):
        dfe_run(TIME[:-1], optical, optical, NAMES)

"""Head alignment against constructed truth, scipy's own solver, and repeated draws of noise."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from cabinpose.align.head import align_head, head_agreement, head_offset, measured_offset
from cabinpose.core.errors import AlignmentError

Y = Rotation.from_euler("xyz", (12, -8, 35), degrees=True)  # object_from_head
X = Rotation.from_euler("z", 70, degrees=True)  # optical world from suit world: both have z up


def _head(amplitudes_deg: tuple[float, float, float] = (25, 35, 60), count: int = 400) -> Rotation:
    """A head that flexes to the sides, nods and turns, one after the other, with a little of the others beside it."""
    t = np.linspace(0, 3, count)
    angles = np.zeros((count, 3))
    for axis, amplitude in enumerate(amplitudes_deg):
        angles[:, axis] = amplitude * np.sin(2 * np.pi * t) * (np.floor(t - 1e-9) == axis)
    return Rotation.from_euler("z", 20, degrees=True) * Rotation.from_euler("xyz", angles, degrees=True)


def _wxyz(rotation: Rotation) -> np.ndarray:
    return rotation.as_quat(scalar_first=True)


def _noise(count: int, sigma_deg: float, rng: np.random.Generator) -> Rotation:
    return Rotation.from_rotvec(rng.normal(size=(count, 3)) * np.deg2rad(sigma_deg))


def _away(fit, truth: Rotation = Y) -> float:
    return float((Rotation.from_matrix(fit.object_from_head[:3, :3]) * truth.inv()).magnitude())


@pytest.mark.parametrize("span", [None, 60])
def test_exact_orientations_give_both_rotations_back(span):
    suit = _head()
    fit = align_head(_wxyz(suit), _wxyz(X * suit * Y.inv()), span=span)
    assert _away(fit) < 1e-9
    assert (Rotation.from_matrix(fit.world_from_suit[:3, :3]) * X.inv()).magnitude() < 1e-9
    assert fit.rms_rad < 1e-9


def test_turns_about_each_axis_are_told():
    suit = _head((10, 30, 50))
    fit = align_head(_wxyz(suit), _wxyz(X * suit * Y.inv()))
    assert np.abs(np.rad2deg(fit.turned_rad) - (20, 60, 100)).max() < 8


def test_no_rotation_fits_better_than_the_one_found():
    """scipy's general least squares from the truth ends where ours does."""
    from scipy.optimize import least_squares

    rng = np.random.default_rng(1)
    suit = _head(count=120)
    seen, optical = suit * _noise(120, 1.0, rng), X * suit * Y.inv()

    def residual(p):
        x, y = Rotation.from_rotvec(p[:3]), Rotation.from_rotvec(p[3:])
        return (x.inv() * optical * y * seen.inv()).as_rotvec().ravel()

    fit = align_head(_wxyz(seen), _wxyz(optical))
    best = least_squares(residual, np.concatenate((X.as_rotvec(), Y.as_rotvec())), xtol=1e-14, ftol=1e-14)
    assert _away(fit, Rotation.from_rotvec(best.x[3:])) < np.deg2rad(0.05)  # Huber's weights take a few of the moments lower
    assert np.linalg.norm(residual(best.x)) <= np.sqrt(120) * fit.rms_rad * (1 + 1e-9)
    assert np.sqrt(120) * fit.rms_rad <= 1.001 * np.linalg.norm(residual(best.x))


def test_missing_moments_and_wild_ones_change_little():
    rng = np.random.default_rng(2)
    suit = _head()
    optical = _wxyz(X * suit * Y.inv())
    wild = rng.choice(400, 20, replace=False)
    optical[wild] = _wxyz(Rotation.random(20, rng=rng))
    optical[100:130] = np.nan
    fit = align_head(_wxyz(suit), optical, max_rms_deg=60)
    assert _away(fit) < np.deg2rad(0.2)
    assert np.isnan(fit.residual_rad[100:130]).all()
    assert np.isfinite(fit.residual_rad).sum() == 370


def test_heading_that_drifts_is_let_go_by_a_span():
    rng = np.random.default_rng(3)
    suit = _head(count=900)
    drift = np.deg2rad(20) * np.linspace(0, 1, 900) ** 2
    drifting = Rotation.from_rotvec(np.outer(drift, (0, 0, 1))) * suit * _noise(900, 0.3, rng)
    optical = _wxyz(X * suit * Y.inv())
    spanned = align_head(_wxyz(drifting), optical, span=60)
    assert _away(spanned) < np.deg2rad(0.15)
    assert _away(align_head(_wxyz(drifting), optical)) > 4 * _away(spanned)
    assert np.ptp(spanned.heading_rad) == pytest.approx(np.deg2rad(20), abs=np.deg2rad(2))


def test_covariance_is_that_of_repeated_draws():
    suit = _head(count=120)
    optical = _wxyz(X * suit * Y.inv())
    errors, said = [], []
    for seed in range(30):
        fit = align_head(_wxyz(suit * _noise(120, 1.0, np.random.default_rng(seed))), optical)
        errors.append((Rotation.from_matrix(fit.object_from_head[:3, :3]) * Y.inv()).as_rotvec())
        said.append(np.trace(fit.covariance))
    drawn = np.mean(np.sum(np.square(errors), axis=1))
    assert 0.6 < np.mean(said) / drawn < 1.7


@pytest.mark.parametrize("turn_deg", [0, 25, -100, 175])
def test_clouds_find_the_heading_between_two_frames_with_one_vertical(turn_deg):
    """The thesis' case: object and head differ by a turn about z alone. A nod forwards is made larger than backwards."""
    suit = _head((20, 30, 50))
    suit = suit * Rotation.from_rotvec(np.outer(np.linspace(0, 0.3, 400) ** 2, (0, 1, 0)))
    about_z = Rotation.from_euler("z", turn_deg, degrees=True)
    fit = align_head(_wxyz(suit), _wxyz(X * suit * about_z.inv()), method="icp")
    assert _away(fit, about_z) < 1e-6


def test_clouds_are_wrong_by_the_tilt_of_the_object_and_pairs_are_not():
    suit = _head()
    optical = _wxyz(X * suit * Y.inv())
    tilt = float(np.arccos(Y.as_matrix()[2, 2]))
    assert _away(align_head(_wxyz(suit), optical, method="icp")) > 0.5 * tilt
    assert _away(align_head(_wxyz(suit), optical)) < 1e-9


@pytest.mark.parametrize("amplitudes", [(0, 0, 0), (0, 35, 0), (0, 0, 60)])
def test_a_head_that_did_not_turn_about_two_axes_is_refused(amplitudes):
    suit = _head(amplitudes) * _noise(400, 0.5, np.random.default_rng(4))
    with pytest.raises(AlignmentError, match="did not turn about two axes"):
        align_head(_wxyz(suit), _wxyz(X * suit * Y.inv()))


def test_two_heads_that_move_differently_are_refused():
    suit = _head()
    late = _wxyz(X * suit[np.roll(np.arange(400), 40)] * Y.inv())
    with pytest.raises(AlignmentError, match="do not move alike"):
        align_head(_wxyz(suit), late)


@pytest.mark.parametrize(
    ("suit", "optical", "says"),
    [
        (np.zeros((5, 4)), np.zeros((6, 4)), "of both systems are needed"),
        (np.full((50, 4), np.nan), np.ones((50, 4)), "0 moments"),
        (np.zeros((50, 4)), np.ones((50, 4)), "0 moments"),
    ],
)
def test_orientations_that_say_nothing_are_refused(suit, optical, says):
    with pytest.raises(AlignmentError, match=says):
        align_head(suit, optical)


C = np.array((-0.03, 0.01, -0.19))  # C1 in the frame of the cap


def test_pivot_of_an_exact_rotation_is_found():
    turn = _head()
    p = np.array((0.4, -0.2, 1.1)) - turn.apply(C)
    p[50:60] = np.nan
    fit = head_offset(p, _wxyz(turn))
    assert np.abs(fit.offset - C).max() < 1e-9
    assert fit.rms_m < 1e-9


def test_pivot_is_found_while_the_trunk_sways_span_by_span():
    rng = np.random.default_rng(5)
    turn = _head(count=800)
    sway = 0.05 * np.sin(np.linspace(0, 5, 800)[:, None] + (0.0, 1.0, 2.0))
    p = sway - turn.apply(C) + rng.normal(size=(800, 3)) * 0.0005
    whole, short = head_offset(p, _wxyz(turn)), head_offset(p, _wxyz(turn), spans=80)
    assert np.linalg.norm(short.offset - C) < 0.006
    assert np.linalg.norm(short.offset - C) < np.linalg.norm(whole.offset - C)
    assert np.linalg.norm(short.offset - C) < 4 * np.sqrt(np.trace(short.covariance))


def test_a_neck_that_bends_pulls_the_pivot_down_unless_the_suit_tells_of_it():
    """A nod of which half comes from a neck of 12 cm below C1."""
    half = _head((25, 35, 60))
    neck = Rotation.from_rotvec(0.5 * half.as_rotvec())
    c1 = neck.apply((0.0, 0.0, 0.12))
    p = c1 - half.apply(C)
    alone = head_offset(p, _wxyz(half))
    told = head_offset(p, _wxyz(half), p_pivot=c1 + (3.0, 1.0, 0.0))
    assert alone.offset[2] < C[2] - 0.02
    assert np.abs(told.offset - C).max() < 1e-9


def test_pivot_about_one_axis_is_refused():
    turn = _head((0, 0, 60))
    with pytest.raises(AlignmentError, match="about one axis only"):
        head_offset(-turn.apply(C), _wxyz(turn))


def test_measured_offset_is_taken_as_it_is():
    fit = measured_offset(C, sigma_m=0.01)
    assert (fit.offset == C).all()
    assert np.allclose(fit.covariance, 1e-4 * np.eye(3))
    with pytest.raises(AlignmentError, match="three finite numbers"):
        measured_offset((0.0, np.nan, 1.0))


def test_agreement_of_heads_that_are_turned_apart_by_a_known_angle() -> None:
    """Half of the moments one way and half the other: the common turn of the worlds stays, and every moment is off by as much."""
    rng = np.random.default_rng(5)
    true = Rotation.random(40, random_state=rng)
    world, inside = Rotation.from_rotvec((0.1, -0.2, 1.1)), Rotation.from_rotvec((0.3, 0.5, -0.2))
    axis = world.inv().apply((0.0, 0.0, 1.0))
    apart = Rotation.from_rotvec(np.where(np.arange(40) % 2, 0.07, -0.07)[:, None] * axis)
    optical, suit = (world * true * inside.inv()).as_quat(scalar_first=True), (apart * true).as_quat(scalar_first=True)
    optical[3] = np.nan
    suit[4] = np.nan
    object_from_head = np.eye(4)
    object_from_head[:3, :3] = inside.as_matrix()
    found = head_agreement(suit, optical, object_from_head)
    assert np.isnan(found[[3, 4]]).all()
    np.testing.assert_allclose(np.delete(found, [3, 4]), 0.07, atol=1e-9)
    assert np.isnan(head_agreement(suit * np.nan, optical, object_from_head)).all()

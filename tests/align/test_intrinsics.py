"""Intrinsics from rendered boards, against the camera that rendered them; corners against their projection."""

from __future__ import annotations

import sys
from pathlib import Path

import cv2
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from cabinpose.align.board import Board
from cabinpose.align.corners import _ordered, corners_or_reason, find_corners
from cabinpose.align.intrinsics import calibrate_from_corners
from cabinpose.core.errors import AlignmentError
from cabinpose.core.frames import apply, transform

sys.path.insert(0, str(Path(__file__).parent))

from boards import BOARD, CAMERA, POSES, corners_seen, picture, poses, render_board


def _truth(k: int) -> np.ndarray:
    return CAMERA.project(apply(POSES[k], BOARD.corners))


def _views(count: int, seed: int, **how: float) -> list[np.ndarray]:
    return [CAMERA.project(apply(p, BOARD.corners)) for p in poses(BOARD, count, seed, **how)]


@pytest.mark.parametrize("k", [0, 1])
def test_corners_are_where_the_lens_puts_them(k):
    away = corners_seen(k, False) - _truth(k)
    assert np.sqrt(np.mean(np.sum(away**2, axis=1))) < 0.03
    assert np.abs(away.mean(axis=0)).max() < 0.008  # no bias, though the light falls by half across the board
    noise = corners_seen(k, True) - _truth(k)
    assert np.sqrt(np.mean(np.sum(noise**2, axis=1))) < 0.05


@pytest.mark.parametrize("turn_deg", [90, 180, 270])
def test_first_corner_is_the_one_at_the_black_square_however_the_board_is_turned(turn_deg):
    turn = Rotation.from_euler("z", turn_deg, degrees=True)
    pose = transform(turn, np.array((0.0, 0.0, 0.95)) - turn.apply(np.append(BOARD.corners.mean(axis=0)[:2], 0.0)))
    found = find_corners(render_board(CAMERA, BOARD, pose, factor=4), BOARD)
    assert np.abs(found.uv - CAMERA.project(apply(pose, BOARD.corners))).max() < 0.1


@pytest.mark.parametrize("wrong", [np.s_[::-1, ::-1], np.s_[:, ::-1], np.s_[::-1]])
def test_corners_found_in_another_order_are_put_right(wrong):
    truth = _truth(0).reshape(BOARD.rows, BOARD.columns, 2)
    assert (_ordered(picture(0), truth[wrong], BOARD) == truth).all()


@pytest.mark.parametrize("taken", [np.s_[:, :7], np.s_[:, 2:], np.s_[:4], np.s_[2:]])
def test_a_part_of_a_larger_board_is_no_board(taken):
    part = _truth(0).reshape(BOARD.rows, BOARD.columns, 2)[taken]
    with pytest.raises(AlignmentError, match="has more than"):
        _ordered(picture(0), part, Board(columns=part.shape[1], rows=part.shape[0]))


def test_refinement_beats_opencv_on_the_samepicture():
    image = picture(0)
    eight = cv2.convertScaleAbs(image, alpha=255 / np.percentile(image, 99))
    found, rough = cv2.findChessboardCornersSB(eight, (BOARD.columns, BOARD.rows), flags=cv2.CALIB_CB_ACCURACY)
    assert found
    theirs = min(np.sqrt(np.mean((c.reshape(-1, 2) - _truth(0)) ** 2)) for c in (rough, rough[::-1]))
    ours = np.sqrt(np.mean((corners_seen(0, False) - _truth(0)) ** 2))
    assert ours < 0.3 * theirs


def test_camera_comes_back_from_exact_corners():
    fit = calibrate_from_corners(_views(12, 4), (CAMERA.width, CAMERA.height), BOARD)
    numbers = np.array((fit.camera.fx, fit.camera.fy, fit.camera.cx, fit.camera.cy))
    assert np.abs(numbers - (CAMERA.fx, CAMERA.fy, CAMERA.cx, CAMERA.cy)).max() < 1e-3  # OpenCV takes pixels as float32
    xy = np.stack(np.meshgrid(np.linspace(-0.8, 0.8, 9), np.linspace(-0.6, 0.6, 9)), axis=-1)
    assert np.abs(fit.camera.distort(xy) - CAMERA.distort(xy)).max() < 1e-5
    assert fit.rms_px < 1e-5
    assert fit.held_out_rms_px < 1e-5


def test_the_same_views_give_the_same_bits():
    """OpenCV's threads would add the views in the order in which they are ready."""
    views = [uv + np.random.default_rng(k).normal(0, 0.1, uv.shape) for k, uv in enumerate(_views(40, 4))]
    before = cv2.getNumThreads()
    cv2.setNumThreads(4)
    try:
        fits = {repr(calibrate_from_corners(views, (352, 287), BOARD, holdout=0).camera) for _ in range(8)}
        assert cv2.getNumThreads() == 4
    finally:
        cv2.setNumThreads(before)
    assert len(fits) == 1


def test_camera_comes_back_from_images():
    found = [corners_seen(k, True) for k in range(10)]
    fit = calibrate_from_corners(found, (352, 287), BOARD, holdout=0.3)
    assert fit.used == tuple(range(10))
    numbers = np.array((fit.camera.fx, fit.camera.fy, fit.camera.cx, fit.camera.cy))
    away = numbers - (CAMERA.fx, CAMERA.fy, CAMERA.cx, CAMERA.cy)
    assert np.abs(away).max() < 0.35
    assert (np.abs(away) < 4 * np.array(fit.std[:4])).all()
    assert fit.rms_px < 0.05
    assert fit.held_out_rms_px < 0.06
    assert sum(np.isfinite(v.held_out_px) for v in fit.views) == 3
    assert 0.1 < fit.coverage < 0.6


def test_standard_deviations_are_those_of_repeated_draws():
    exact = _views(10, 5)
    rng = np.random.default_rng(6)
    fits = [
        calibrate_from_corners([uv + rng.normal(size=uv.shape) * 0.05 for uv in exact], (352, 287), BOARD, holdout=0)
        for _ in range(14)
    ]
    drawn = np.std([f.camera.fx for f in fits])
    assert 0.6 < np.mean([f.std[0] for f in fits]) / drawn < 1.7


def test_each_rejected_view_says_why():
    bad = _views(1, 8)[0] + np.random.default_rng(7).normal(size=(54, 2)) * 3.0
    steep = poses(BOARD, 1, 9)[0]
    steep[:3, :3] = Rotation.from_euler("y", 75, degrees=True).as_matrix()
    oblique = CAMERA.project(apply(steep, BOARD.corners))
    corners = [*_views(10, 4), bad, oblique, None, _views(1, 4)[0] + 0.1]
    fit = calibrate_from_corners(corners, (352, 287), BOARD)
    assert fit.used == tuple(range(10))
    assert "inconsistent" in fit.rejected[10]
    assert "too oblique" in fit.rejected[11]
    assert "no corners" in fit.rejected[12]
    assert "stands as in view 0" in fit.rejected[13]


def test_too_few_views_are_refused_with_the_reasons_counted():
    empty = np.full((287, 352), 50.0)
    found = [corners_or_reason(image, BOARD) for image in (picture(0), empty, empty)]
    with pytest.raises(AlignmentError, match=r"1 of 3 views are usable, 6 needed: 2 x no board of 9 x 6"):
        calibrate_from_corners([uv for uv, _ in found], (352, 287), BOARD, reasons=[why for _, why in found])


def test_boards_that_are_all_parallel_are_refused():
    rng = np.random.default_rng(10)
    turn = Rotation.from_euler("x", 20, degrees=True)
    middle = turn.apply(np.append(BOARD.corners.mean(axis=0)[:2], 0.0))
    exact = [
        CAMERA.project(apply(transform(turn, (*rng.uniform(-0.25, 0.25, 2), z) - middle), BOARD.corners))
        for z in np.linspace(0.6, 1.3, 9)
    ]
    noise = [uv + rng.normal(size=uv.shape) * 0.02 for uv in exact]
    with pytest.raises(AlignmentError, match=r"stand alike|not determined"):
        calibrate_from_corners(noise, (352, 287), BOARD)


@pytest.mark.parametrize("size", [(8, 5), (11, 6), (9, 4), (7, 6)])
def test_a_board_of_another_size_is_refused(size):
    other = Board(columns=size[0], rows=size[1])
    with pytest.raises(AlignmentError, match=r"no board|more than|alternate|grid"):
        find_corners(picture(0), other)


def test_a_covered_board_is_refused():
    image = picture(0).copy()
    u, v = np.rint(_truth(0)[22]).astype(int)
    image[v - 20 : v + 20, u - 20 : u + 20] = 300.0
    with pytest.raises(AlignmentError):
        find_corners(image, BOARD)

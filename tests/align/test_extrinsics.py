"""camera_from_world by markers and by all corners, against the rig that rendered them."""

from __future__ import annotations

import sys
from functools import cache
from pathlib import Path

import cv2
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from cabinpose.align.board import Board
from cabinpose.align.bundle import BoardSightings, refine_camera_from_world
from cabinpose.align.extrinsics import (
    ExtrinsicsResult,
    _outline_middle,
    board_pose,
    camera_from_world,
    check_labels,
    marker_pixels,
    marker_points,
)
from cabinpose.align.intrinsics import calibrate_from_corners
from cabinpose.core.camera import Camera
from cabinpose.core.errors import AlignmentError
from cabinpose.core.frames import apply, invert, look_at, transform

sys.path.insert(0, str(Path(__file__).parent))

from boards import BOARD, CAMERA, POSES, corners_seen, photograph, picture, render_board

WORLD_FROM_CAMERA = look_at((1.2, 0.5, 1.6), (2.2, 0.7, 0.9))
TRUTH = invert(WORLD_FROM_CAMERA)
P_CAMERA = np.stack([apply(p, BOARD.marker_centres) for p in POSES])
P_WORLD = apply(WORLD_FROM_CAMERA, P_CAMERA)
EXACT = np.stack([CAMERA.project(apply(p, BOARD.corners)) for p in POSES]), np.stack([CAMERA.project(p) for p in P_CAMERA])


@cache
def _seen(noise: bool) -> tuple[np.ndarray, np.ndarray]:
    """Corners (V, N, 2) and markers (V, M, 2) of rendered images, with or without noise."""
    corners, markers = [], []
    for k in range(len(POSES)):
        image = photograph(k) if noise else picture(k)
        corners.append(corners_seen(k, noise))
        markers.append(marker_pixels(image, CAMERA, board_pose(CAMERA, corners[-1], BOARD).camera_from_board, BOARD))
    return np.array(corners), np.array(markers)


def _points(corners: np.ndarray, markers: np.ndarray, camera: Camera = CAMERA) -> np.ndarray:
    return np.stack(
        [
            marker_points(camera, m, board_pose(camera, c, BOARD).camera_from_board, BOARD)
            for c, m in zip(corners, markers, strict=True)
        ]
    )


def _away(fit: ExtrinsicsResult) -> tuple[float, float]:
    """Millimetres between the camera's places, degrees between its axes."""
    place = np.linalg.norm(invert(fit.camera_from_world)[:3, 3] - WORLD_FROM_CAMERA[:3, 3])
    return 1e3 * float(place), np.rad2deg(Rotation.from_matrix((fit.camera_from_world @ WORLD_FROM_CAMERA)[:3, :3]).magnitude())


def test_board_pose_from_exact_corners_and_as_opencv_has_it():
    for pose, uv in zip(POSES[:4], EXACT[0], strict=False):
        fit = board_pose(CAMERA, uv, BOARD)
        assert np.abs(fit.camera_from_board - pose).max() < 1e-8
        assert fit.other_rms_px > 100 * fit.rms_px
        shaken = uv + np.random.default_rng(1).normal(size=uv.shape) * 0.1
        _, turn, shift = cv2.solvePnP(BOARD.corners, shaken, CAMERA.k, np.array(CAMERA.dist))
        theirs = transform(Rotation.from_rotvec(turn.ravel()), shift.ravel())
        assert np.abs(board_pose(CAMERA, shaken, BOARD).camera_from_board - theirs).max() < 1e-5


def test_corners_that_are_not_the_boards_are_refused():
    with pytest.raises(AlignmentError, match="do not fit a board"):
        board_pose(CAMERA, EXACT[0][0][:-1], BOARD)
    broken = EXACT[0][0].copy()
    broken[3] = np.nan
    with pytest.raises(AlignmentError, match="missing"):
        board_pose(CAMERA, broken, BOARD)


def test_markers_in_the_image_are_found_to_a_fraction_of_a_pixel():
    away = _seen(False)[1] - EXACT[1]
    assert np.isfinite(away).all()
    assert np.sqrt(np.mean(np.sum(away**2, axis=-1))) < 0.15  # a saturated disc of 2 px
    assert np.abs(away.mean(axis=(0, 1))).max() < 0.05


def test_middle_of_a_large_spheres_outline_is_that_of_its_rays():
    centre, radius = np.array((0.5, -0.3, 0.9)), 0.08
    ray = np.concatenate((CAMERA.scaled(2).rays, np.ones((2 * 287, 2 * 352, 1))), axis=-1)
    ray /= np.linalg.norm(ray, axis=-1, keepdims=True)
    v, u = np.nonzero(np.linalg.norm(np.cross(ray, centre), axis=-1) < radius)
    middle = (np.array((u.mean(), v.mean())) + 0.5) / 2 - 0.5
    assert np.abs(_outline_middle(CAMERA, centre, radius) - middle).max() < 0.03
    assert np.linalg.norm(CAMERA.project(centre) - middle) > 0.3


def test_a_marker_that_does_not_shine_is_missing():
    dull = Board(markers=dict(list(BOARD.markers.items())[:3]))
    image = render_board(CAMERA, dull, POSES[0], factor=2)
    assert np.isnan(marker_pixels(image, CAMERA, POSES[0], BOARD)).any(axis=1).tolist() == [False, False, False, True]


def test_exact_markers_give_the_camera_back():
    fit = camera_from_world(_points(*EXACT), P_WORLD, board=BOARD)
    assert np.abs(fit.camera_from_world - TRUTH).max() < 1e-6
    assert fit.used.shape == (10, 4)
    assert fit.used.all()
    better = refine_camera_from_world(CAMERA, BoardSightings(BOARD, *EXACT, P_WORLD), fit)
    assert np.abs(better.camera_from_world - TRUTH).max() < 1e-9


def test_camera_and_lens_come_back_together():
    off = Camera(352, 287, 174.2, 173.9, 175.0, 143.6, (-0.13, 0.015, 0.001, 0.0, 0.0))
    start = camera_from_world(_points(*EXACT, camera=off), P_WORLD, board=BOARD)
    fit = refine_camera_from_world(off, BoardSightings(BOARD, *EXACT, P_WORLD), start, lens=True)
    assert np.abs(fit.camera_from_world - TRUTH).max() < 1e-6
    assert fit.camera is not None
    assert np.abs(np.subtract(fit.camera.dist, CAMERA.dist)).max() < 1e-5
    assert fit.camera.fx == pytest.approx(CAMERA.fx, abs=1e-4)


@pytest.mark.parametrize(("noise", "limit_mm", "limit_deg"), [(False, 0.5, 0.05), (True, 1.0, 0.1)])
def test_camera_comes_back_from_images(noise, limit_mm, limit_deg):
    corners, markers = _seen(noise)
    world = P_WORLD + noise * np.random.default_rng(2).normal(size=P_WORLD.shape) * 3e-4
    start = camera_from_world(_points(corners, markers), world, board=BOARD)
    assert _away(start)[0] < 2 * limit_mm
    fit = refine_camera_from_world(CAMERA, BoardSightings(BOARD, corners, markers, world), start)
    mm, deg = _away(fit)
    assert mm < limit_mm
    assert deg < limit_deg
    assert fit.held_out_rms_px < 0.1


@pytest.mark.parametrize(("noise", "limit_mm", "limit_deg"), [(False, 0.5, 0.05), (True, 1.0, 0.1)])
def test_camera_and_lens_come_back_from_images(noise, limit_mm, limit_deg):
    """Nothing is known of the lens to begin with."""
    corners, markers = _seen(noise)
    world = P_WORLD + noise * np.random.default_rng(2).normal(size=P_WORLD.shape) * 3e-4
    camera = calibrate_from_corners(list(corners), (CAMERA.width, CAMERA.height), BOARD).camera
    start = camera_from_world(_points(corners, markers, camera), world, board=BOARD)
    mm, deg = _away(refine_camera_from_world(camera, BoardSightings(BOARD, corners, markers, world), start, lens=True))
    assert mm < limit_mm
    assert deg < limit_deg


@pytest.mark.slow
def test_all_corners_do_better_than_markers_on_average():
    """Noise on exact observations, 7 times: 0.03 px on corners, 0.1 px on markers, 0.3 mm in the optical system."""
    by_markers, by_corners, said = [], [], []
    for seed in range(7):
        rng = np.random.default_rng(seed)
        corners = EXACT[0] + rng.normal(size=EXACT[0].shape) * 0.03
        markers = EXACT[1] + rng.normal(size=EXACT[1].shape) * 0.1
        world = P_WORLD + rng.normal(size=P_WORLD.shape) * 3e-4
        start = camera_from_world(_points(corners, markers), world, board=BOARD)
        fit = refine_camera_from_world(CAMERA, BoardSightings(BOARD, corners, markers, world), start, rounds=1)
        by_markers.append(_away(start))
        by_corners.append(_away(fit))
        said.append((np.trace(start.covariance[:3, :3]), np.trace(fit.covariance[:3, :3])))
    turn = np.sqrt(np.mean(np.square(np.array((by_markers, by_corners))[..., 1]), axis=1))
    assert turn[1] < 0.8 * turn[0]
    # The covariances are those of the draws.
    ratio = np.rad2deg(np.sqrt(np.mean(said, axis=0))) / turn
    assert (ratio > 0.55).all()
    assert (ratio < 1.8).all()


def test_one_bad_marker_is_left_out_and_named():
    world = P_WORLD.copy()
    world[4, 2] += (0.0, 0.03, 0.0)
    world[7, 0] = np.nan
    fit = camera_from_world(P_CAMERA, world, board=BOARD)
    assert np.abs(fit.camera_from_world - TRUTH).max() < 1e-9
    assert (~fit.used).sum() == 2
    assert fit.residual_m[4, 2] == pytest.approx(0.03, abs=1e-6)
    assert (np.isfinite(fit.residual_m) & ~fit.used).sum() == 1
    assert np.isnan(fit.residual_m).sum() == 1


def test_a_third_of_the_views_of_another_moment_are_left_out():
    world = P_WORLD.copy()
    world[7:] = apply(transform(Rotation.from_euler("z", 10, degrees=True), (0.1, 0.2, 0.0)), world[7:])
    fit = camera_from_world(P_CAMERA, world, board=BOARD)
    assert np.abs(fit.camera_from_world - TRUTH).max() < 1e-9
    assert not fit.used[7:].any()


def test_swapped_markers_are_told_by_their_distances():
    world = P_WORLD[:, [1, 0, 2, 3]]
    with pytest.raises(AlignmentError, match=r"swapped.*board1 is board2.*board2 is board1"):
        camera_from_world(P_CAMERA, world, board=BOARD)
    order = check_labels(world + np.random.default_rng(3).normal(size=world.shape) * 5e-4, BOARD)
    assert order == (1, 0, 2, 3)
    assert np.allclose(world[:, order], P_WORLD)


@pytest.mark.parametrize("axes", [(-1.0, 1.0, 1.0), (1.0, 1.0, -1.0)])
def test_left_handed_axes_are_refused(axes):
    with pytest.raises(AlignmentError, match="left-handed"):
        camera_from_world(P_CAMERA, P_WORLD * axes, board=BOARD)


def test_millimetres_are_refused():
    with pytest.raises(AlignmentError, match="do not fit the board") as caught:
        camera_from_world(P_CAMERA, P_WORLD * 1000, board=BOARD)
    assert "1000 times" in str(caught.value.hint)


def test_a_board_whose_markers_look_alike_is_refused():
    markers = {"a": (0.0, 0.0, 0.0), "b": (0.5, 0.0, 0.0), "c": (0.5, 0.4, 0.0), "d": (0.0, 0.4, 0.0)}
    square = Board(markers=markers)
    with pytest.raises(AlignmentError, match="looks the same"):
        check_labels(square.marker_centres[None], square)


def _line() -> np.ndarray:
    return np.outer(np.arange(12.0), (0.1, 0.2, 0.1)).reshape(3, 4, 3)


@pytest.mark.parametrize(
    ("camera", "world", "says"),
    [
        (P_CAMERA[:2], P_WORLD[:2], "2 views have three markers"),
        (P_CAMERA[:4], P_WORLD[:5], "of both systems are needed"),
        (_line(), _line(), "on a line"),
        (P_CAMERA[[0, 0, 0]], P_WORLD[[0, 0, 0]], "in a plane"),
        (P_CAMERA[::-1], P_WORLD, "do not fit"),
    ],
)
def test_markers_that_do_not_determine_a_camera_are_refused(camera, world, says):
    with pytest.raises(AlignmentError, match=says):
        camera_from_world(camera, world)


def test_too_few_whole_views_are_refused():
    fit = camera_from_world(P_CAMERA, P_WORLD, board=BOARD)
    corners = EXACT[0].copy()
    corners[2:] = np.nan
    with pytest.raises(AlignmentError, match="2 views have all corners"):
        refine_camera_from_world(CAMERA, BoardSightings(BOARD, corners, EXACT[1], P_WORLD), fit)

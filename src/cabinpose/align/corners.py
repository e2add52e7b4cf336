"""The inner corners of a checkerboard in amplitude images: found by OpenCV, put in the board's order, refined by a model.

Amplitude falls with 1/r^2 and a ToF camera has few pixels, so a square may be 6 px wide with a shade across it. The search runs
on a picture of local contrast. The refinement fits to the amplitudes around each corner what a camera sees of one: two levels,
each with a slope, divided by two blurred straight edges. A gradient of the light then moves no corner, and every pixel counts.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.ndimage import map_coordinates

from cabinpose._native import align
from cabinpose.align.board import Board
from cabinpose.core import AlignmentError

F64 = NDArray[np.float64]

_MISPLACED = 0.2  # of a square
_SEARCH_FLAGS = cv2.CALIB_CB_ADAPTIVE_THRESH | cv2.CALIB_CB_NORMALIZE_IMAGE
_SECTOR_FLAGS = cv2.CALIB_CB_NORMALIZE_IMAGE | cv2.CALIB_CB_EXHAUSTIVE


@dataclass(frozen=True)
class Corners:
    """uv: (N, 2) px in the order of `Board.corners` · side_px: the shortest side of a square · blur_px: sigma of the edges ·
    contrast: (white - black) / (white + black), the median.
    """

    uv: F64
    side_px: float
    blur_px: float
    contrast: float


def find_corners(amplitude: ArrayLike, board: Board, *, min_side_px: float = 4.5) -> Corners:
    """The board's inner corners in an amplitude image (H, W), sub-pixel, the first being the one towards a black outer square.

    Raises AlignmentError where the board is not seen whole, has another number of corners, or its squares are smaller than
    min_side_px: the blur of a pixel then reaches from edge to edge.
    """
    image = np.asarray(amplitude, np.float64)
    if image.ndim != 2 or not np.isfinite(image).any():
        raise AlignmentError(f"an amplitude image (height, width) is needed, not {image.shape}", hint="give one image")
    image = np.where(np.isfinite(image), image, 0.0)
    found = _search(image, (board.columns, board.rows))
    if found is None:
        raise AlignmentError(
            f"no board of {board.columns} x {board.rows} inner corners found",
            hint="all squares have to be in the image, evenly lit, larger than about 6 px; check the board's columns and rows",
        )
    grid = _ordered(image, found.reshape(board.rows, board.columns, 2), board)
    side = min(float(np.linalg.norm(np.diff(grid, axis=axis), axis=-1).min()) for axis in (0, 1))
    # A corner that the quick search misplaced starts where the others put it.
    wrong = _off_the_grid(grid)
    grid = np.where((np.linalg.norm(wrong, axis=-1) > _MISPLACED * side)[..., None], grid - wrong, grid)
    if side < min_side_px:
        raise AlignmentError(
            f"a square is {side:.1f} px wide, {min_side_px:g} needed", hint="hold the board nearer, or less oblique"
        )
    uv, blur, contrast = _refine(image, grid)
    if np.linalg.norm(_off_the_grid(uv), axis=-1).max() > _MISPLACED * side:
        raise AlignmentError("a corner lies off the board's grid", hint="the board is blurred, bent or partly covered")
    return Corners(uv.reshape(-1, 2), side, blur, contrast)


def corners_or_reason(amplitude: ArrayLike, board: Board) -> tuple[F64 | None, str]:
    """The corners (N, 2) px in an image as `find_corners` has them, and ""; or None, and why there are none."""
    try:
        return find_corners(amplitude, board).uv, ""
    except AlignmentError as error:
        return None, str(error)


def local_contrast(amplitude: ArrayLike, window: int = 25) -> NDArray[np.uint8]:
    """An amplitude image (H, W) as 8 bit, each pixel between the darkest and the brightest of its neighbourhood, in logs."""
    log = np.log(np.maximum(np.asarray(amplitude, np.float64), 1.0)).astype(np.float32)
    smooth = cv2.GaussianBlur(log, (0, 0), 0.8)
    box = np.ones((window, window), np.uint8)
    dark, bright = cv2.erode(smooth, box), cv2.dilate(np.minimum(smooth, np.percentile(smooth, 99.0)), box)
    return np.asarray(np.clip((log - dark) / np.maximum(bright - dark, 0.5) * 255, 0, 255), np.uint8)


def _search(image: F64, size: tuple[int, int]) -> F64 | None:
    """Corners (N, 2) to a fraction of a pixel, by the quick detector first and the patient one after it."""
    picture = local_contrast(image)
    for factor, sectors in ((2, False), (1, True), (2, True)):
        large = cv2.resize(picture, None, fx=factor, fy=factor, interpolation=cv2.INTER_CUBIC) if factor > 1 else picture
        if sectors:
            found, corners = cv2.findChessboardCornersSB(large, size, flags=_SECTOR_FLAGS)
        else:
            found, corners = cv2.findChessboardCorners(large, size, flags=_SEARCH_FLAGS)
        if found:
            return np.asarray(((corners.reshape(-1, 2) + 0.5) / factor - 0.5), np.float64)
    return None


def _ordered(image: F64, grid: F64, board: Board) -> F64:
    """The grid (rows, columns, 2) turned so that it is as the board says; raises where the squares are not the board's."""
    along, down = grid[:, -1] - grid[:, 0], grid[-1] - grid[0]
    if np.sum(along.mean(0)[0] * down.mean(0)[1] - along.mean(0)[1] * down.mean(0)[0]) < 0:
        grid = grid[:, ::-1]  # the detector may run through a row backwards: seen from before, the board is never mirrored
    cross = _cross(image, grid, board)
    inner = cross[1:-1, 1:-1]
    if np.nanmedian(inner) < 0:
        grid = grid[::-1, ::-1]
        cross = _cross(image, grid, board)
        inner = cross[1:-1, 1:-1]
    middle = float(np.nanmedian(inner))
    if not np.mean(inner > 0.25 * middle) > 0.9 or middle < 0.1:
        raise AlignmentError(
            "the squares do not alternate", hint="the board is partly covered, or something else was taken for it"
        )
    # At the outer edge of the squares half of the contrast is left; all of it where the pattern goes on.
    for side in (cross[0, 1:-1], cross[-1, 1:-1], cross[1:-1, 0], cross[1:-1, -1]):
        if np.isfinite(side).sum() >= 2 and np.nanmedian(side) > 0.75 * middle:
            raise AlignmentError(
                f"the board has more than {board.columns} x {board.rows} inner corners",
                hint="count the corners where four squares meet, along x and along y",
            )
    return grid


def _cross(image: F64, grid: F64, board: Board) -> F64:
    """(rows + 2, columns + 2): by how much, at each corner and one further on all sides, the squares towards (+-x, +-x) are
    darker.

    In logarithms, halved; positive as the board says, NaN outside the image. It does not see an even gradient of the light.
    """
    flat, _ = cv2.findHomography(board.corners[:, :2] / board.square_m, grid.reshape(-1, 2))
    j, i = np.mgrid[-1.5 : board.rows + 1, -1.5 : board.columns + 1]
    middles = np.stack((i, j, np.ones_like(i)), axis=-1) @ np.asarray(flat).T
    uv = middles[..., :2] / middles[..., 2:]
    value = map_coordinates(np.log(np.maximum(image, 1.0)), (uv[..., 1], uv[..., 0]), order=1, mode="constant", cval=np.nan)
    jj, ii = np.mgrid[: board.rows + 2, : board.columns + 2]
    diagonal = value[1:, :-1] + value[:-1, 1:] - value[:-1, :-1] - value[1:, 1:]
    return np.asarray(0.5 * diagonal * np.where((ii + jj) % 2 == 0, 1.0, -1.0))


def _off_the_grid(grid: F64) -> F64:
    """(rows, columns, 2) by how much each corner leaves a smooth grid: cubic in row and column, which lens and tilt stay within.

    Least absolute distances by reweighting, so that single misplaced corners do not bend it.
    """
    rows, columns = grid.shape[:2]
    j, i = (a.ravel() for a in np.meshgrid(np.linspace(-1, 1, rows), np.linspace(-1, 1, columns), indexing="ij"))
    order = [(a, b) for a in range(4) for b in range(min(4 - a, rows)) if a < columns]
    terms = np.stack([i**a * j**b for a, b in order], axis=-1)
    uv = grid.reshape(-1, 2)
    weight = np.ones(len(uv))
    left = uv
    for _ in range(20):
        fit, *_ = np.linalg.lstsq(terms * weight[:, None], uv * weight[:, None], rcond=None)
        left = uv - terms @ fit
        weight = 1 / np.sqrt(np.maximum(np.linalg.norm(left, axis=1), 1e-3))
    return left.reshape(grid.shape)


def _refine(image: F64, grid: F64) -> tuple[F64, float, float]:
    """Corners (rows, columns, 2) by least squares on the amplitudes around each; the blur (px) and the contrast they share.

    The model is that of `fit_corners` of the compiled core.
    """
    start = grid.reshape(-1, 2)
    along, down = (np.ascontiguousarray(np.gradient(grid, axis=axis).reshape(-1, 2)) for axis in (1, 0))
    offset, levels = np.empty_like(start), np.empty((len(start), 6))
    sigma = align.fit_corners(image, start=np.ascontiguousarray(start), along=along, down=down, offset=offset, levels=levels)
    if np.isnan(sigma):
        raise AlignmentError(
            "a corner has too few pixels around it", hint="hold the board nearer, less oblique, away from the edge"
        )
    if np.abs(offset).max() > 0.35 * min(np.linalg.norm(along, axis=1).min(), np.linalg.norm(down, axis=1).min()):
        raise AlignmentError("a corner is not where the search found it", hint="the board is blurred or partly covered")
    contrast = float(np.median(np.abs(levels[:, 3]) / np.maximum(np.abs(levels[:, 0]), 1e-9)))
    return grid + offset.reshape(grid.shape), sigma, contrast

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
from scipy.special import erf

from cabinpose.align.board import Board
from cabinpose.core.errors import AlignmentError

F64 = NDArray[np.float64]

_REACH = 0.42  # of a square: how far from a corner its pixels are taken; at 0.5 the edges' blur would bring in the next squares
_LARGEST_REACH_PX = 12.0
_ROUNDS = 25
_MISPLACED = 0.2  # of a square
_FEWEST_PIXELS = 16  # of a corner: the model has 11 numbers and the blur is shared
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

    Model: a(u, v) = m + c * E(d1) * E(d2), m and c linear in (u, v), d1 and d2 the distances from two lines through the corner,
    E(d) a step blurred by sigma and by the pixel. Levenberg-Marquardt on all corners at once, (du, dv, two angles, m, c) each,
    sigma in common.
    """
    rows, columns = grid.shape[:2]
    start = grid.reshape(-1, 2)
    along, down = (np.gradient(grid, axis=axis).reshape(-1, 2) for axis in (1, 0))
    reach = min(
        _REACH * float(max(np.linalg.norm(along, axis=1).max(), np.linalg.norm(down, axis=1).max())) * 1.5, _LARGEST_REACH_PX
    )
    span = np.arange(-int(np.ceil(reach)), int(np.ceil(reach)) + 1)
    whole = np.rint(start).astype(int)
    dv, du = (d.ravel() for d in np.meshgrid(span, span, indexing="ij"))
    u, v = whole[:, :1] + du, whole[:, 1:] + dv  # (N, P)
    inside = (u >= 0) & (v >= 0) & (u < image.shape[1]) & (v < image.shape[0])
    value = image[np.clip(v, 0, image.shape[0] - 1), np.clip(u, 0, image.shape[1] - 1)]
    x, y = u - start[:, :1], v - start[:, 1:]
    det = along[:, 0] * down[:, 1] - along[:, 1] * down[:, 0]
    i = (x * down[:, 1:] - y * down[:, :1]) / det[:, None]
    j = (y * along[:, :1] - x * along[:, 1:]) / det[:, None]
    near = np.hypot(x, y) <= _LARGEST_REACH_PX
    weight = (inside & near & (np.abs(i) < _REACH) & (np.abs(j) < _REACH)).astype(np.float64)
    if weight.sum(axis=1).min() < _FEWEST_PIXELS:
        raise AlignmentError(
            "a corner has too few pixels around it", hint="hold the board nearer, less oblique, away from the edge"
        )

    scale = np.sqrt(np.sum(weight * value**2, axis=1) / weight.sum(axis=1))
    value = value / scale[:, None]
    # Normals of the two edges: the distance from the line along x grows with y of the board, and the other way round.
    first, second = np.arctan2(along[:, 0], -along[:, 1]), np.arctan2(-down[:, 0], down[:, 1])
    geometry = np.column_stack((np.zeros((len(start), 2)), first, second))
    sigma, damping = 0.4, 1e-3
    levels = _levels(value, weight, x, y, geometry, sigma)
    cost = _residual(value, weight, x, y, geometry, levels, sigma)[1]
    for _ in range(_ROUNDS):
        step, shared = _step(value, weight, x, y, geometry, levels, sigma, damping)
        tried = (geometry + np.clip(step[:, :4], -0.5, 0.5), levels + step[:, 4:], float(np.clip(sigma + shared, 0.05, 3.0)))
        after = _residual(value, weight, x, y, *tried)[1]
        if after.sum() < cost.sum():
            moved = np.abs(tried[0][:, :2] - geometry[:, :2]).max()
            geometry, levels, sigma, cost, damping = *tried, after, max(damping / 5, 1e-9)
            if moved < 1e-5:
                break
        else:
            damping *= 10
    if np.abs(geometry[:, :2]).max() > 0.35 * min(np.linalg.norm(along, axis=1).min(), np.linalg.norm(down, axis=1).min()):
        raise AlignmentError("a corner is not where the search found it", hint="the board is blurred or partly covered")
    contrast = float(np.median(np.abs(levels[:, 3]) / np.maximum(np.abs(levels[:, 0]), 1e-9)))
    return (start + geometry[:, :2]).reshape(rows, columns, 2), sigma, contrast


def _edges(x: F64, y: F64, geometry: F64, sigma: float) -> tuple[F64, F64, F64, F64, F64, F64]:
    """(N, P) E(d1) and its derivatives by d1 and by sigma, and the same of d2, the distances from both lines."""
    a, b = x - geometry[:, 0:1], y - geometry[:, 1:2]
    d1 = np.cos(geometry[:, 2:3]) * a + np.sin(geometry[:, 2:3]) * b
    d2 = np.cos(geometry[:, 3:4]) * a + np.sin(geometry[:, 3:4]) * b
    return *_edge(d1, sigma), *_edge(d2, sigma)


def _edge(d: F64, sigma: float) -> tuple[F64, F64, F64]:
    """E(d), and its derivatives by d and by sigma: a step from -1 to 1, blurred by sigma, averaged over a pixel's width."""
    far, near = d + 0.5, d - 0.5
    erf_far, erf_near = erf(far / (np.sqrt(2) * sigma)), erf(near / (np.sqrt(2) * sigma))
    bell_far, bell_near = (np.sqrt(2 / np.pi) * np.exp(-0.5 * (x / sigma) ** 2) for x in (far, near))
    value = far * erf_far - near * erf_near + sigma * (bell_far - bell_near)
    return value, erf_far - erf_near, bell_far - bell_near


def _residual(value: F64, weight: F64, x: F64, y: F64, geometry: F64, levels: F64, sigma: float) -> tuple[F64, F64]:
    """(N, P) image less model, and its sum of squares (N,)."""
    e1, _, _, e2, _, _ = _edges(x, y, geometry, sigma)
    m, c, p = levels[:, :3, None], levels[:, 3:, None], e1 * e2
    r = value - (m[:, 0] + m[:, 1] * x + m[:, 2] * y + (c[:, 0] + c[:, 1] * x + c[:, 2] * y) * p)
    return r, np.sum(weight * r**2, axis=1)


def _levels(value: F64, weight: F64, x: F64, y: F64, geometry: F64, sigma: float) -> F64:
    """(N, 6) m and c of given edges: a linear problem each."""
    e1, _, _, e2, _, _ = _edges(x, y, geometry, sigma)
    p = e1 * e2
    columns = np.stack((np.ones_like(x), x, y, p, x * p, y * p), axis=-1)
    normal = np.einsum("npa,np,npb->nab", columns, weight, columns)
    return np.linalg.solve(normal + 1e-9 * np.eye(6), np.einsum("npa,np,np->na", columns, weight, value)[..., None])[..., 0]


def _step(value: F64, weight: F64, x: F64, y: F64, geometry: F64, levels: F64, sigma: float, damping: float) -> tuple[F64, float]:
    """One Levenberg-Marquardt step: (N, 10) of the corners' own numbers, and that of sigma, by the Schur complement."""
    e1, f1, s1, e2, f2, s2 = _edges(x, y, geometry, sigma)
    r, _ = _residual(value, weight, x, y, geometry, levels, sigma)
    p = e1 * e2
    c = levels[:, 3:4] + levels[:, 4:5] * x + levels[:, 5:6] * y
    a, b = x - geometry[:, 0:1], y - geometry[:, 1:2]
    cos1, sin1, cos2, sin2 = (f(geometry[:, k : k + 1]) for k in (2, 3) for f in (np.cos, np.sin))
    by_d1, by_d2 = c * f1 * e2, c * e1 * f2
    own = np.stack(
        (
            -by_d1 * cos1 - by_d2 * cos2,
            -by_d1 * sin1 - by_d2 * sin2,
            by_d1 * (b * cos1 - a * sin1),
            by_d2 * (b * cos2 - a * sin2),
            np.ones_like(x), x, y, p, x * p, y * p,
        ),
        axis=-1,
    )  # fmt: skip
    shared = c * (s1 * e2 + e1 * s2)
    normal = np.einsum("npa,np,npb->nab", own, weight, own)
    diagonal = np.einsum("naa->na", normal)
    normal = normal + np.einsum("na,ab->nab", damping * diagonal + 1e-12, np.eye(10))
    side = np.einsum("npa,np,np->na", own, weight, shared)
    right = np.einsum("npa,np,np->na", own, weight, r)
    solved = np.linalg.solve(normal, np.stack((right, side), axis=-1))
    rest = np.sum(weight * shared**2) * (1 + damping) - np.sum(side * solved[..., 1])
    step = float((np.sum(weight * shared * r) - np.sum(side * solved[..., 0])) / max(rest, 1e-12))
    return solved[..., 0] - step * solved[..., 1], step

"""An analytic picture of the calibration board: rays met with plane and spheres, averaged over each pixel's area."""

from __future__ import annotations

from functools import cache

import numpy as np
from scipy.ndimage import gaussian_filter
from scipy.spatial.transform import Rotation

from cabinpose.align.board import Board
from cabinpose.align.corners import find_corners
from cabinpose.core.camera import Camera
from cabinpose.core.frames import apply, invert, transform

MARGIN_M = 0.04  # of the panel, beyond squares and markers
WHITE, BLACK, PANEL, WALL, MARKER = 0.85, 0.06, 0.80, 8.0, 14.0
FULL_SCALE = 4095.0

CAMERA = Camera(352, 287, 173.646, 173.646, 175.5, 143.0, (-0.133684, 0.02, 0.0, 0.0, 0.0))  # a Pico Monstar's lens
BOARD = Board()


def render_board(
    camera: Camera, board: Board, camera_from_board: np.ndarray, *, factor: int = 6, blur_px: float = 0.0, gain: float = 900.0
) -> np.ndarray:
    """Amplitude (H, W) of the board before an even wall: reflectance * cos / r^2, retro-reflective spheres, saturation.

    Each pixel is the mean of factor^2 rays; distortion is the camera's own. blur_px: sigma of a lens blur.
    """
    centres = board.marker_centres
    x0, y0 = np.minimum(centres.min(0)[:2], -board.square_m) - MARGIN_M
    last = board.corners.max(axis=0)[:2] + board.square_m
    x1, y1 = np.maximum(centres.max(0)[:2], last) + MARGIN_M
    edge = np.linspace(0, 1, 20)
    outline = np.concatenate([np.stack((x0 + edge * (x1 - x0), np.full(20, y)), 1) for y in (y0, y1)])
    outline = np.concatenate((outline, [(x, y) for x in (x0, x1) for y in np.linspace(y0, y1, 20)]))
    uv = camera.project(apply(camera_from_board, np.column_stack((outline, np.zeros(len(outline))))))
    low = np.clip(np.floor(np.nanmin(uv, axis=0)).astype(int) - 3, 0, (camera.width, camera.height))
    high = np.clip(np.ceil(np.nanmax(uv, axis=0)).astype(int) + 4, 0, (camera.width, camera.height))
    image = np.full((camera.height, camera.width), WALL)
    xy = _fine_rays(camera, low, high, factor)
    ray = np.concatenate((xy, np.ones((*xy.shape[:2], 1))), axis=-1)
    board_from_camera = invert(camera_from_board)
    origin = board_from_camera[:3, 3]
    ray = (ray / np.linalg.norm(ray, axis=-1, keepdims=True)) @ board_from_camera[:3, :3].T
    along = np.divide(-origin[2], ray[..., 2])
    x, y = origin[0] + along * ray[..., 0], origin[1] + along * ray[..., 1]
    shade = gain * np.abs(ray[..., 2]) / along**2
    i, j = np.floor(x / board.square_m), np.floor(y / board.square_m)
    squares = (i >= -1) & (i < board.columns) & (j >= -1) & (j < board.rows)
    value = np.where(squares, np.where((i + j) % 2 == 0, BLACK, WHITE), PANEL) * shade
    value = np.where((x > x0) & (x < x1) & (y > y0) & (y < y1) & (along > 0), value, WALL)
    for centre in centres:
        to = centre - origin
        middle = ray @ to
        off = to @ to - middle**2
        near = (off < board.marker_radius_m**2) & (middle > 0)
        value = np.where(near, MARKER * gain / middle**2, value)
    rows, columns = (high - low)[::-1]
    patch = value.reshape(rows, factor, columns, factor).mean(axis=(1, 3))
    image[low[1] : high[1], low[0] : high[0]] = patch
    if blur_px:
        image = gaussian_filter(image, blur_px)
    return np.minimum(image, FULL_SCALE)


def _fine_rays(camera: Camera, low: np.ndarray, high: np.ndarray, factor: int) -> np.ndarray:
    """Ideal (x/z, y/z) of factor^2 rays a pixel: within a pixel the lens is quadratic, to some 1e-8."""
    u, v = np.meshgrid(np.arange(low[0], high[0]), np.arange(low[1], high[1]))
    # A sheared grid: a plain one would round an edge along the pixels to 1/factor, this one rounds to 1/factor^2.
    a, b = np.meshgrid(np.arange(factor), np.arange(factor), indexing="ij")
    at_v, at_u = (a + (b + 0.5) / factor) / factor - 0.5, (b + (a + 0.5) / factor) / factor - 0.5
    nodes = (-0.5, 0.0, 0.5)
    by_v, by_u = (np.stack((2 * x * (x - 0.5), 1 - 4 * x**2, 2 * x * (x + 0.5))) for x in (at_v, at_u))  # Lagrange's
    rows, columns = u.shape
    fine = np.zeros((rows, factor, columns, factor, 2))
    for m, dv in enumerate(nodes):
        for n, du in enumerate(nodes):
            xy = np.stack((u + du - camera.cx, v + dv - camera.cy), axis=-1) / (camera.fx, camera.fy)
            weight = (by_v[m] * by_u[n])[None, :, None, :, None]
            fine += camera.undistort(xy)[:, None, :, None, :] * weight
    return fine.reshape(rows * factor, columns * factor, 2)


def noisy(image: np.ndarray, rng: np.random.Generator, *, floor: float = 4.0, shot: float = 0.5) -> np.ndarray:
    """Amplitude with noise of sigma^2 = floor^2 + shot^2 * amplitude, in whole counts (uint16), saturated."""
    sigma = np.sqrt(floor**2 + shot**2 * image)
    return np.clip(np.rint(image + rng.normal(size=image.shape) * sigma), 0, FULL_SCALE).astype(np.uint16)


def poses(
    board: Board, count: int, seed: int, *, tilt_deg: float = 35.0, near_m: float = 0.65, far_m: float = 1.1
) -> list[np.ndarray]:
    """camera_from_board of a board that is held here and there before the camera, tilted and turned."""
    rng = np.random.default_rng(seed)
    middle = np.append(board.corners.mean(axis=0)[:2], 0.0)
    result = []
    for _ in range(count):
        distance = rng.uniform(near_m, far_m)
        at = np.array([rng.uniform(-0.4, 0.4) * distance, rng.uniform(-0.3, 0.3) * distance, distance])
        axis = rng.normal(size=2)
        tilt = np.append(axis / np.linalg.norm(axis), 0.0) * np.deg2rad(rng.uniform(0.4, 1.0) * tilt_deg)
        turn = Rotation.from_rotvec(tilt) * Rotation.from_euler("z", rng.uniform(-25, 25), degrees=True)
        result.append(transform(turn, at - turn.apply(middle)))
    return result


POSES = poses(BOARD, 10, seed=3)


@cache
def picture(k: int) -> np.ndarray:
    """CAMERA's amplitude of BOARD in POSES[k], noise-free, through a lens that blurs a little; not to be written to."""
    image = render_board(CAMERA, BOARD, POSES[k], factor=5, blur_px=0.4)
    image.flags.writeable = False
    return image


@cache
def photograph(k: int) -> np.ndarray:
    """`picture` with a sensor's noise."""
    return noisy(picture(k), np.random.default_rng(k))


@cache
def corners_seen(k: int, noise: bool) -> np.ndarray:
    """(N, 2) corners found in `photograph` or `picture`."""
    return find_corners(photograph(k) if noise else picture(k), BOARD).uv

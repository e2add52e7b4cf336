"""What parts are matched with: histograms of oriented gradients at several depths, in numpy.

A level of the pyramid is a depth. At it the frame is resampled so that a body there has `pixel_m` a pixel, whatever its distance,
and depths become distances from the level, cut off in front of and behind a body: a wall has the same contrast wherever it is.
"""

from __future__ import annotations

from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from cabinpose.estimate.dpm.config import DpmConfig
from cabinpose.estimate.inputs import InputView

F32 = NDArray[np.float32]

_FRONT_M, _BEHIND_M = 0.9, 0.6  # of a level: what a body with its arms stretched out fills
_STEEP = {"depth": 0.15, "amplitude": 0.6}  # difference over two pixels (m; logarithm of the light) from which on edges are alike
_FLAT = 0.1  # length of a histogram, steep everywhere = 1, below which contrast is not normalised away
_BRIGHTEST = 0.5  # a normalised histogram is cut off there
MARGIN = 2  # cells that parts may lie outside of the image
RELIEF = 3  # channels beside the directions: a surface near the level, its distance from it, outside of the image


class Level(NamedTuple):
    """The grid of cells of a depth z (m): rows × columns with the margin; cell = origin + scale × pixel of the view, (x, y)."""

    z: float
    rows: int
    columns: int
    scale: float
    origin: NDArray[np.float64]

    def cells(self, uv: NDArray[np.floating]) -> NDArray[np.float64]:
        """Cells (..., 2), x and y, of pixels of the view."""
        return self.origin + self.scale * np.asarray(uv, np.float64)

    def pixels(self, cells: NDArray[np.floating]) -> NDArray[np.float64]:
        """The inverse of `cells`."""
        return (np.asarray(cells, np.float64) - self.origin) / self.scale


def channels(config: DpmConfig) -> int:
    """Numbers that describe a cell."""
    return config.orientations + RELIEF


def levels(config: DpmConfig, depths_m: NDArray[np.floating]) -> tuple[Level, ...]:
    """The grids of cells of some depths (L,), m."""
    return tuple(_level(config.view, float(z), config.pixel_m, config.cell_px) for z in depths_m)


@lru_cache(maxsize=64)
def _level(view: InputView, z: float, pixel_m: float, cell_px: int) -> Level:
    scale = z / (view.focal * pixel_m)  # pixels of the level for one of the view
    rows, columns = (int(np.ceil(size * scale / cell_px)) for size in (view.height, view.width))
    centre = np.array((view.camera.cx, view.camera.cy))
    middle = (np.array((columns, rows)) * cell_px - 1) / 2  # pixel of the level that lies on the optical axis
    origin = (middle - scale * centre + 0.5) / cell_px - 0.5 + MARGIN
    return Level(z, rows + 2 * MARGIN, columns + 2 * MARGIN, scale / cell_px, origin)


def features(config: DpmConfig, level: Level, depth: F32, amplitude: F32 | None = None) -> F32:
    """Descriptions of a level's cells, with a border of half a filter around them.

    Parameters
    ----------
    config
        Of the model.
    level
        One of `levels`.
    depth, amplitude
        (h, w) of the view: m, 0 = invalid; light, for a model that reads it.

    Returns
    -------
    ndarray
        (rows + 2 b, columns + 2 b, C) float32, b = filter_cells // 2: directions, and the relief.
    """
    cell = config.cell_px
    inner = (level.rows - 2 * MARGIN) * cell, (level.columns - 2 * MARGIN) * cell
    uv = [
        (((np.arange(count) + 0.5) / cell - 0.5 + MARGIN) - level.origin[axis]) / level.scale
        for axis, count in ((1, inner[0]), (0, inner[1]))
    ]
    at = [np.clip(np.round(p).astype(np.int64), 0, size - 1) for p, size in zip(uv, depth.shape, strict=True)]
    seen = depth[at[0]][:, at[1]]
    relative = np.where(seen > 0, np.clip(seen - np.float32(level.z), -_FRONT_M, _BEHIND_M), np.float32(_BEHIND_M))
    image = relative
    if config.input == "amplitude":
        if amplitude is None:
            raise ValueError("this model reads amplitudes")
        image = np.log1p(amplitude[at[0]][:, at[1]] * seen**2)
    directions = normalised(cell_histograms(image, cell, config.orientations, _STEEP[config.input]))
    near = (relative < _BEHIND_M) & (relative > -_FRONT_M)
    share = _cell_means(near.astype(np.float32), cell)
    distance = _cell_means(np.where(near, relative, np.float32(0)), cell)
    border = MARGIN + config.filter_cells // 2
    made = np.zeros((directions.shape[0] + 2 * border, directions.shape[1] + 2 * border, channels(config)), np.float32)
    made[..., -1] = 1.0
    inside = made[border:-border, border:-border]
    inside[..., : config.orientations] = directions
    inside[..., -3], inside[..., -2], inside[..., -1] = share, distance, 0.0
    return made


def cell_histograms(image: NDArray[np.floating], cell_px: int, orientations: int, steepest: float = np.inf) -> F32:
    """Mean gradient of the cells (rows, columns, orientations) of an image, by its direction over 360 degrees.

    The gradient is the difference over two pixels (Dalal and Triggs 2005), cut off at `steepest` and in its units.
    """
    across, down = np.zeros(image.shape, np.float32), np.zeros(image.shape, np.float32)
    across[:, 1:-1] = image[:, 2:] - image[:, :-2]
    down[1:-1] = image[2:] - image[:-2]
    length = np.hypot(across, down)
    direction = np.arctan2(down, across) * np.float32(orientations / (2 * np.pi))
    bins = np.floor(direction).astype(np.int64) % orientations
    rows, columns = image.shape[0] // cell_px, image.shape[1] // cell_px
    cells = (np.arange(rows * cell_px) // cell_px)[:, None] * columns + np.arange(columns * cell_px) // cell_px
    whole = np.s_[: rows * cell_px, : columns * cell_px]
    weight = np.minimum(length[whole], np.float32(steepest)) / (1.0 if np.isinf(steepest) else steepest)
    counts = np.bincount((cells * orientations + bins[whole]).ravel(), weight.ravel(), rows * columns * orientations)
    return (counts / cell_px**2).astype(np.float32).reshape(rows, columns, orientations)


def normalised(histograms: F32) -> F32:
    """Histograms (rows, columns, B) blurred over neighbouring cells, over their length in 3 × 3 cells, and cut off."""
    blurred = _along(_along(histograms, (0.25, 0.5, 0.25), 0), (0.25, 0.5, 0.25), 1)
    energy = np.square(blurred).sum(-1)
    energy = _along(_along(energy, (1.0, 1.0, 1.0), 0), (1.0, 1.0, 1.0), 1)
    return np.minimum(blurred / np.sqrt(energy + np.float32(_FLAT**2))[..., None], np.float32(_BRIGHTEST))


def _along(values: F32, taps: tuple[float, float, float], axis: int) -> F32:
    """Three taps along an axis; what lies outside is zero."""
    a = np.moveaxis(values, axis, 0)
    out = np.float32(taps[1]) * a
    out[1:] += np.float32(taps[0]) * a[:-1]
    out[:-1] += np.float32(taps[2]) * a[1:]
    return np.moveaxis(out, 0, axis)


def _cell_means(image: F32, cell_px: int) -> F32:
    rows, columns = image.shape[0] // cell_px, image.shape[1] // cell_px
    return image.reshape(rows, cell_px, columns, cell_px).mean((1, 3))


def responses(described: F32, filters: F32) -> F32:
    """Correlation (F, rows, columns) of filters (F, s, s, C) with what describes a level."""
    count, size = filters.shape[:2]
    windows = np.lib.stride_tricks.sliding_window_view(described, (size, size), axis=(0, 1))  # (rows, columns, C, s, s)
    rows, columns = windows.shape[:2]
    flat = windows.transpose(0, 1, 3, 4, 2).reshape(rows * columns, -1)
    return np.ascontiguousarray((filters.reshape(count, -1) @ flat.T).reshape(count, rows, columns))

"""Less noise in path-traced pictures: a wavelet filter that stops at edges, guided by the geometry, which has no noise.

After Dammertz et al., "Edge-avoiding À-Trous wavelet transform for fast global illumination filtering", HPG 2010, and, for the
luminance's weight by its variance, Schied et al., "Spatiotemporal variance-guided filtering", HPG 2017.
"""

from __future__ import annotations

import numpy as np

from cabinpose.core import Floats
from cabinpose.core import reproducible as rp
from cabinpose.synth.pictures.grid import Grid, Hits

_STEPS = 1, 2, 4, 8  # px between taps
_KERNEL = np.array((1.0, 4.0, 6.0, 4.0, 1.0)) / 16.0
_LUMINANCE = np.array((0.2126, 0.7152, 0.0722))
_OF_SIGMA, _NORMAL, _DEPTH = 3.0, 32.0, 0.02  # weights: of differences in luminance, angle and relative depth
_DARKEST = 0.02


def denoised(fine: Floats, albedo: Floats, found: Hits, grid: Grid) -> Floats:
    """Radiance (N, 3) on a grid's samples, with less noise.

    What is filtered is the light that falls on each pixel's surface (the one at its centre), not its colour, so that what
    is printed on a surface stays sharp; every sample then takes the light of the neighbouring pixel that sees its surface.

    Parameters
    ----------
    fine, albedo
        (N, 3) radiance, and the diffuse reflectance of what the samples see.
    found, grid
        What the samples see, and which pixel they belong to; those that see nothing stay as they are.
    """
    shape = grid.camera.height, grid.camera.width
    ground = np.maximum(albedo, _DARKEST)
    light = fine / ground
    centre = grid.centre
    own = centre[np.maximum(grid.pixel, 0)]
    normal, depth = found.normal, found.depth_m.astype(np.float64)
    same = (grid.pixel >= 0) & (depth > 0) & (_unlike(normal, depth, normal[own], depth[own]) < 1.0)
    count = np.maximum(grid.total(same[:, None].astype(np.float64))[..., 0], 1.0)
    luminance = rp.matmul(light, _LUMINANCE)
    sums = grid.total(np.where(same[:, None], np.column_stack((light, luminance, luminance**2)), 0.0)) / count[..., None]
    spread = np.maximum(sums[..., 4] - sums[..., 3] ** 2, 0.0) / np.maximum(count - 1.0, 1.0)
    filtered, normals, depths = sums[..., :3], normal[centre].reshape(*shape, 3), depth[centre].reshape(shape)
    for step in _STEPS:
        filtered, spread = _once(filtered, spread, normals, depths, step)
    return _spread_out(filtered, normals, depths, light, found, grid) * ground


def _spread_out(filtered: Floats, normals: Floats, depths: Floats, light: Floats, found: Hits, grid: Grid) -> Floats:
    """(N, 3): for every sample the light of that pixel, of its own and the eight about it, whose surface is most like its own."""
    hit = np.flatnonzero((grid.pixel >= 0) & (found.depth_m > 0))
    row, column = np.divmod(grid.pixel[hit], filtered.shape[1])
    normal, depth = found.normal[hit], found.depth_m[hit].astype(np.float64)
    least, result = np.full(len(hit), np.inf), light[hit]
    for down in (0, -1, 1):
        for across in (0, -1, 1):
            i, j = np.clip(row + down, 0, filtered.shape[0] - 1), np.clip(column + across, 0, filtered.shape[1] - 1)
            unlike = np.where(depths[i, j] > 0, _unlike(normal, depth, normals[i, j], depths[i, j]), np.inf)
            unlike += 0.1 * (abs(down) + abs(across))  # of equals the nearest
            better = unlike < least
            result[better], least[better] = filtered[i, j][better], unlike[better]
    whole = light.copy()
    whole[hit] = result
    return whole


def _unlike(normal: Floats, depth: Floats, other_normal: Floats, other_depth: Floats) -> Floats:
    """How different two surfaces are (N,): below 1 they count as one."""
    turned = 1.0 - np.einsum("ij,ij->i", normal, other_normal)
    return np.asarray(turned / 0.3 + np.abs(depth - other_depth) / (0.04 * np.maximum(depth, 1e-3)))


def _once(light: Floats, spread: Floats, normal: Floats, depth: Floats, step: int) -> tuple[Floats, Floats]:
    luminance = rp.matmul(light, _LUMINANCE)
    sigma = _OF_SIGMA * np.sqrt(_blurred(spread)) + 1e-6 + 1e-3 * luminance
    total, weights, second = np.zeros_like(light), np.zeros(depth.shape), np.zeros(depth.shape)
    for i, down in enumerate(range(-2, 3)):
        for j, across in enumerate(range(-2, 3)):
            other = [_shifted(a, down * step, across * step) for a in (light, spread, normal, depth, luminance)]
            there = other[3] > 0
            facing = rp.power(np.clip(np.einsum("ijk,ijk->ij", normal, other[2]), 0.0, 1.0), _NORMAL)
            apart = np.abs(other[3] - depth) / (_DEPTH * np.maximum(depth, 1e-3) * np.sqrt(rp.hypot(down, across)) * step + 1e-6)
            weight = _KERNEL[i] * _KERNEL[j] * there * facing * rp.exp(-apart - np.abs(other[4] - luminance) / sigma)
            if down == across == 0:
                weight = np.full(depth.shape, _KERNEL[2] ** 2)
            total += weight[..., None] * other[0]
            second += weight**2 * other[1]
            weights += weight
    return total / weights[..., None], second / weights**2


def _blurred(image: Floats) -> Floats:
    """Mean of 3 x 3 pixels, the nearer ones counting more."""
    for axis in (0, 1):
        image = sum(share * _shifted(image, *((s, 0) if axis == 0 else (0, s))) for s, share in ((-1, 0.25), (0, 0.5), (1, 0.25)))  # type: ignore[assignment]
    return image


def _shifted(image: Floats, down: int, across: int) -> Floats:
    """The image so that each pixel holds what is `down` and `across` of it; the border's own pixels go on beyond it."""
    rows = np.clip(np.arange(image.shape[0]) + down, 0, image.shape[0] - 1)
    columns = np.clip(np.arange(image.shape[1]) + across, 0, image.shape[1] - 1)
    return image[rows[:, None], columns[None]]

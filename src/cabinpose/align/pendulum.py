"""Where a retro-reflective marker is in an amplitude image: the centre of its blob, to a fraction of a pixel.

A marker returns so much light that its pixels are clipped: the brightest pixel (the thesis' eq. 4.2) is any of a plateau. What is
clipped is clipped all round, so that the centroid of the blob above its background, in a round window about itself, stays where
the marker is. Measured on rendered blobs of known place, root mean square of the distance: Gaussians of sigma 1 px and more
0.005 px whole, 0.01 px clipped at a half, 0.02 px clipped at a tenth of their height; discs of radius 1 to 6 px 0.02 to 0.003 px,
0.06 to 0.04 px where twice too bright; 0.1 px on a background that slopes by an eightieth of the blob's height a pixel.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import ndimage

F64 = NDArray[np.float64]

_ROUNDS = 20  # in which the window moves, at most
_WINDOW, _BEYOND_PX = 1.7, 1.5  # radius of the window: so many radii of the blob at half its height, and so much more
_SETTLED_PX = 1e-6
_HALF_STEP = 0.5  # deviation of whole numbers, at least
_TOUCHING = np.ones((3, 3), np.bool_)  # pixels that touch at a corner belong together


def brightest_blob(
    amplitude: ArrayLike, *, min_contrast: float = 20.0, rival: float = 0.6, min_area_px: int = 2, max_area_px: int = 600
) -> F64:
    """The one bright small blob of an image.

    Parameters
    ----------
    amplitude
        (H, W). Pixels that are not numbers, and dark ones within the blob, are taken as clipped: that is how some cameras
        deliver them.
    min_contrast
        How far the blob has to lie above the image's median, in median deviations from it (of noise alone, the brightest of a
        hundred thousand pixels is at about 7); and no less than three times the median.
    rival
        Another blob that reaches this part of the best one's height makes the place unknown.
    min_area_px, max_area_px
        Pixels above half the height; fewer are noise, more (a hand close to the camera, a window) no marker.

    Returns
    -------
    ndarray
        (2,) pixel (u, v); NaN where there is no such blob, or two.
    """
    image = np.array(amplitude, np.float64)
    lost = ~np.isfinite(image)
    nowhere = np.full(2, np.nan)
    if lost.all():
        return nowhere
    values = image[~lost]
    middle, brightest = float(np.median(values)), float(values.max())
    height = brightest - middle
    deviation = max(float(np.median(np.abs(values - middle))), _HALF_STEP)
    if height < min_contrast * deviation or height < 2 * middle:
        return nowhere
    image[lost] = middle
    bright = image > middle + 0.5 * height
    # A lost pixel beside a bright one is of the blob, even where the ring about it is not whole.
    blobs = ndimage.binary_propagation(bright, _TOUCHING, mask=bright | lost) if lost.any() else bright
    box = ndimage.find_objects(blobs.view(np.int8))[0]
    blobs = ndimage.binary_fill_holes(blobs[box])
    image[box][blobs & ~bright[box]] = brightest
    label, count = ndimage.label(blobs, _TOUCHING)
    numbers = np.arange(1, count + 1)
    area = ndimage.sum_labels(blobs, label, numbers)
    counts = (ndimage.maximum(image[box], label, numbers) - middle >= rival * height) & (area >= min_area_px)
    if counts.sum() != 1 or area[counts][0] > max_area_px:
        return nowhere
    v, u = ndimage.center_of_mass(blobs, label, int(numbers[counts][0]))
    return _centroid(image, np.array((u + box[1].start, v + box[0].start)), float(np.sqrt(area[counts][0] / np.pi)))


def _centroid(image: F64, centre: F64, blob_radius: float) -> F64:
    """The centroid (2,) above the background, in a round window that is moved until it is centred on what it finds."""
    radius = _WINDOW * blob_radius + _BEYOND_PX
    reach = int(np.ceil(2 * radius + 3))
    left, top = np.maximum(np.rint(centre).astype(int) - reach, 0)
    part = image[top : top + 2 * reach + 1, left : left + 2 * reach + 1]
    v, u = np.mgrid[: part.shape[0], : part.shape[1]] + np.array((top, left))[:, None, None]
    away = np.hypot(u - centre[0], v - centre[1])
    ring = part[(away > radius + 1) & (away <= radius + 3)]
    light = np.maximum(part - (np.median(ring) if len(ring) else 0.0), 0.0)
    for _ in range(_ROUNDS):
        # A pixel that the window's edge crosses counts in part: a window of whole pixels would jump with it.
        weight = light * np.clip(radius + 0.5 - np.hypot(u - centre[0], v - centre[1]), 0.0, 1.0)
        before, centre = centre, np.array(((weight * u).sum(), (weight * v).sum())) / weight.sum()
        if np.abs(centre - before).max() < _SETTLED_PX:
            break
    return centre

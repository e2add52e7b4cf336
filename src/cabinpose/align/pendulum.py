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

_NOWHERE = (np.nan, np.nan)
_ROUNDS = 20
_WINDOW = 1.7  # radius of the window, in radii of the blob at half its height, and 1.5 px more
_EIGHT = np.ones((3, 3), np.bool_)  # pixels that touch at a corner belong together


def brightest_blob(
    amplitude: ArrayLike, *, min_contrast: float = 20.0, rival: float = 0.6, min_area_px: int = 2, max_area_px: int = 600
) -> F64:
    """(2,) pixel (u, v) of the one bright small blob of an image (H, W); NaN where there is none, or two.

    min_contrast: how far the blob has to lie above the image's median, in median deviations from it (of noise alone, the
    brightest of a hundred thousand pixels is at about 7); and no less than three times the median · rival: another blob that
    reaches this part of the best one's height makes the place unknown · min_area_px, max_area_px: pixels above half the height;
    fewer are noise, more (a hand close to the camera, a window) no marker. Pixels that are not numbers, and dark ones within the
    blob, are taken as clipped: that is how some cameras deliver them.
    """
    image = np.asarray(amplitude, np.float64)
    lost = ~np.isfinite(image)
    if lost.all():
        return np.array(_NOWHERE)
    known = image[~lost]
    middle = float(np.median(known))
    deviation = max(float(np.median(np.abs(known - middle))), 0.5)  # of whole numbers: at least half a step
    height = float(known.max()) - middle
    if height < min_contrast * deviation or height < 2 * middle:
        return np.array(_NOWHERE)
    filled = _filled(np.where(lost, middle, image), lost, middle + 0.5 * height)
    # Blobs are parted at half of the height; one counts if its top reaches `rival` of the height, and more than a pixel does.
    parts, count = ndimage.label(filled > middle + 0.5 * height, _EIGHT)
    index = np.arange(1, count + 1)
    tops = ndimage.maximum(filled, parts, index)
    areas = np.bincount(parts.ravel(), minlength=count + 1)[1:]
    bright = index[(tops - middle >= rival * height) & (areas >= min_area_px)]
    if len(bright) != 1 or areas[bright[0] - 1] > max_area_px:
        return np.array(_NOWHERE)
    return _centroid(filled, parts == bright[0])


def _filled(image: F64, lost: NDArray[np.bool_], level: float) -> F64:
    """The image with clipped pixels, lost or dark within a ring of bright ones, as bright as the brightest."""
    bright = image > level
    # A lost pixel beside a bright one is of the blob, even where the ring about it is not whole.
    clipped = ndimage.binary_propagation(ndimage.binary_dilation(bright, _EIGHT) & lost, mask=lost, structure=_EIGHT)
    holes = ndimage.binary_fill_holes(bright | clipped) & ~bright
    return np.where(holes | clipped, image.max(), image)


def _centroid(image: F64, blob: NDArray[np.bool_]) -> F64:
    """The centroid above the background, in a round window that is moved until it is centred on what it finds."""
    v, u = np.nonzero(blob)
    centre = np.array((u.mean(), v.mean()))
    radius = _WINDOW * np.sqrt(blob.sum() / np.pi) + 1.5
    reach = int(np.ceil(2 * radius + 3))
    top, left = max(round(centre[1]) - reach, 0), max(round(centre[0]) - reach, 0)
    cut = image[top : round(centre[1]) + reach + 1, left : round(centre[0]) + reach + 1]
    rows, columns = np.mgrid[top : top + cut.shape[0], left : left + cut.shape[1]]
    distance = np.hypot(columns - centre[0], rows - centre[1])
    ring = (distance > radius + 1) & (distance <= radius + 3)
    height = np.maximum(cut - (np.median(cut[ring]) if ring.any() else 0.0), 0.0)
    for _ in range(_ROUNDS):
        distance = np.hypot(columns - centre[0], rows - centre[1])
        # A pixel that the window's edge crosses counts in part: a window of whole pixels would jump with it.
        weight = height * np.clip(radius + 0.5 - distance, 0.0, 1.0)
        last, centre = centre, np.array(((weight * columns).sum(), (weight * rows).sum())) / weight.sum()
        if np.abs(centre - last).max() < 1e-6:
            break
    return centre

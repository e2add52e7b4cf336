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

from cabinpose._native import align

F64 = NDArray[np.float64]


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
    uv = np.empty(2)
    align.find_blob(np.ascontiguousarray(amplitude, np.float64), min_contrast, rival, min_area_px, max_area_px, uv)
    return uv

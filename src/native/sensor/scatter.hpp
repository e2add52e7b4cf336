// Light that lens and sensor scatter over the image.
#pragma once

#include "core/array.hpp"

namespace cabinpose {

/// Takes a share of an image (H, W) and spreads it by three Gaussians in equal parts, of deviations s, 2 s and 4 s pixels.
///
/// pixels: rows `pitch` apart. The spread light is worked out in cells of 8 x 8 pixels; what leaves the image is lost.
void scatter(float* pixels, Index height, Index width, Index pitch, float share, double deviation);

}  // namespace cabinpose

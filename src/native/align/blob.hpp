// Where a retro-reflective marker is in an amplitude image.
#pragma once

#include "core/array.hpp"

namespace cabinpose {

/// What counts as a marker's blob, see `align.pendulum.brightest_blob`.
struct BlobLimits {
  double min_contrast;       // of its height above the image's median, in median deviations from it
  double rival;              // share of its height that no other blob may reach
  Index min_area, max_area;  // pixels above half its height
};

/// Into `uv` (2,) the pixel of the one bright small blob of an image (H, W); NaN where there is none, or two.
void find_blob(Array<const double, any, any> image, const BlobLimits& limits, Array<double, 2> uv);

}  // namespace cabinpose

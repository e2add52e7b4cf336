// What a camera's pixels see of simple bodies: one ray a pixel, many where it sees an edge.
#pragma once

#include <vector>

#include "core/array.hpp"
#include "core/fields.hpp"
#include "lab/bodies.hpp"

namespace cabinpose {

/// A camera's rays as x, y at depth 1, NaN outside the lens model: centres (H, W, 2) and corners (H + 1, W + 1, 2) of the pixels;
/// factors: (H * W, 4) range over depth of each of a pixel's parts.
struct PixelRays {
  Array<const double, any, any, 2> centres;
  Array<const double, any, any, 2> corners;
  Array<const float, any, 4> factors;

  CABINPOSE_FIELDS(PixelRays, centres, corners, factors)
};

/// The pixels that see several surfaces, rising: one part for each kind of surface, at the mean range of its light.
struct MixedPixels {
  std::vector<std::int32_t> pixel;   // (M,) row * W + column
  std::vector<float> depth, cosine;  // (M, 4)
};

/// Depth (H, W) m and light over `reflectance` (H, W) by one ray a pixel, 0 where there is nothing; returns the pixels that
/// need more.
MixedPixels cast(const PixelRays& pixels, const SceneArrays& scene, float reflectance, Array<float, any, any> depth,
                 Array<float, any, any> cosine);

}  // namespace cabinpose

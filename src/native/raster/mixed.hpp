// The pixels that have to be seen in parts.
#pragma once

#include "raster/zbuffer.hpp"

namespace cabinpose {

/// Which pixels are seen in parts, beside those that look through something.
enum Which : int { no_pixels, some_pixels, all_pixels };

/// The pixels that have to be seen in parts: their number M, and mixed[:M] their flat indices, strip by strip as in `refine`.
///
/// depth, cosine, material: (H, W) at the pixels' centres · looks: (256,) bits of `Look`; pixels that are looked through always
/// count · looks_through: whether there may be any · which: some: those on the image's border, and those where a neighbour above,
/// below, left or right is of another material or not on one smooth surface with it · per_pixel: parts · before: set as `refine`
/// reads it · bent: work space (strip_rows, W).
Index find_mixed(const Grid& grid, const float* depth, const float* cosine, const std::uint8_t* material,
                 Array<const std::uint8_t, 256> looks, bool looks_through, Which which, int per_pixel, std::int32_t* before,
                 std::int32_t* mixed, std::uint8_t* bent);

/// Put the rays of the parts of pixels into blocks, and NaN behind them.
///
/// part_rays: (H * W, 2, s * s) x and y of the parts of every pixel.
void take_rays(const std::int32_t* mixed, Index count, Array<const float, any, 2, any> part_rays, BlockRays* rays);

}  // namespace cabinpose

#include "raster/mixed.hpp"

#include <algorithm>
#include <cmath>
#include <cstring>
#include <limits>

namespace cabinpose {
namespace {

// A pixel is left whole where, from its neighbours, z bends by no more than this share of itself from pixel to pixel, slopes by
// no more than that, and the cosine of incidence bends by no more than the third.
constexpr float most_bend = 0.003f;
constexpr float most_slope = 0.04f;
constexpr float most_cosine_bend = 0.06f;

/// Where a row of an image may show more than one smooth surface to a pixel, but for the first and last column.
void find_bent(const float* __restrict depth, const float* __restrict cosine, const std::uint8_t* __restrict material, int width,
               std::uint8_t* __restrict bent) {
  for (int c = 1; c < width - 1; ++c) {
    const float z = depth[c], left = depth[c - 1], right = depth[c + 1], up = depth[c - width], down = depth[c + width];
    const float cos = cosine[c], twice = 2.0f * cos;
    const float bend = std::max(std::fabs(left + right - 2.0f * z), std::fabs(up + down - 2.0f * z));
    const float slope = std::max(std::fabs(left - right), std::fabs(up - down));
    const float across = std::fabs(cosine[c - 1] + cosine[c + 1] - twice),
                along = std::fabs(cosine[c - width] + cosine[c + width] - twice);
    const bool smooth =
        (bend <= most_bend * z) & (slope <= 2.0f * most_slope * z) & (std::max(across, along) <= most_cosine_bend * cos);
    bent[c] = smooth ? 0 : 1;
  }
  for (int c = 1; c < width - 1; ++c) {
    const std::uint8_t m = material[c];
    bent[c] |= (material[c - 1] ^ m) | (material[c + 1] ^ m) | (material[c - width] ^ m) | (material[c + width] ^ m);
  }
}

}  // namespace

Index find_mixed(const Grid& grid, const float* depth, const float* cosine, const std::uint8_t* material,
                 Array<const std::uint8_t, 256> looks, bool looks_through, Which which, int per_pixel, std::int32_t* before,
                 std::int32_t* mixed, std::uint8_t* bent) {
  const int width = grid.width, height = grid.height;
  std::int32_t count = 0;
  Index at = 0;
  for (int top = 0; top < height; top += strip_rows) {
    for (int k = 0; k < strip_rows; ++k) {
      const int r = top + k;
      std::uint8_t* row = bent + k * width;
      std::fill_n(row, width, which == no_pixels || r >= height ? 0 : 1);
      if (r >= height) continue;
      const Index first = static_cast<Index>(r) * width;
      if (which == some_pixels && r > 0 && r < height - 1) find_bent(depth + first, cosine + first, material + first, width, row);
      if (looks_through) {
        for (int c = 0; c < width; ++c) row[c] |= looks[material[first + c]] & looked_through;
      }
    }
    for (int c = 0; c < width; ++c) {
      before[at++] = count * per_pixel;
      for (int k = 0; k < strip_rows; ++k) {
        mixed[count] = (top + k) * width + c;
        count += bent[k * width + c] != 0;
      }
    }
  }
  before[at] = count * per_pixel;
  return count;
}

void take_rays(const std::int32_t* mixed, Index count, Array<const float, any, 2, any> part_rays, BlockRays* rays) {
  const Index parts = part_rays.size(2);
  const float* from = part_rays.data();
  Index at = 0;
  if (parts == block_samples / 2) {
    constexpr int half = block_samples / 2;
    for (Index k = 0; k < count; ++k) {
      __builtin_prefetch(from + static_cast<Index>(mixed[std::min(k + 16, count - 1)]) * 2 * half);
      BlockRays& block = rays[k / 2];
      const float* source = from + static_cast<Index>(mixed[k]) * 2 * half;
      std::memcpy(block.x + k % 2 * half, source, half * sizeof(float));
      std::memcpy(block.y + k % 2 * half, source + half, half * sizeof(float));
    }
    at = count * half;
  } else {
    for (Index k = 0; k < count; ++k) {
      const float* source = from + mixed[k] * 2 * parts;
      for (Index j = 0; j < parts; ++j, ++at) {
        rays[at / block_samples].x[at % block_samples] = source[j];
        rays[at / block_samples].y[at % block_samples] = source[parts + j];
      }
    }
  }
  for (; at % block_samples != 0; ++at) {
    rays[at / block_samples].x[at % block_samples] = std::numeric_limits<float>::quiet_NaN();
    rays[at / block_samples].y[at % block_samples] = std::numeric_limits<float>::quiet_NaN();
  }
}

}  // namespace cabinpose

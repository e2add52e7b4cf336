#include "sensor/scatter.hpp"

#include <algorithm>
#include <vector>

#include "core/math.hpp"

namespace cabinpose {

namespace {

constexpr Index cell = 8;      // pixels of its side
constexpr double reach = 3.5;  // deviations
constexpr double widths[] = {1.0, 2.0, 4.0};

struct Memory {
  std::vector<float> cells, rows, spread, kernel;  // (h, w) three times, and half of a kernel
};

/// Mean over the cells (h, w) of an image; beyond its border is no light.
void means(const float* pixels, Index height, Index width, Index pitch, Index w, float* out) {
  for (Index v = 0; v < height; ++v) {
    float* row = out + v / cell * w;
    for (Index u = 0; u < width; ++u) row[u / cell] += pixels[v * pitch + u] * (1.0f / (cell * cell));
  }
}

/// Adds a Gaussian of `deviation` cells about each, times `share`.
void spread(Memory& memory, Index h, Index w, double deviation, float share) {
  const Index radius = static_cast<Index>(reach * deviation) + 1;
  memory.kernel.resize(static_cast<std::size_t>(radius) + 1);
  double total = 0.0;
  for (Index k = 0; k <= radius; ++k) {
    const double t = static_cast<double>(k) / deviation, value = exp(-0.5 * t * t);
    memory.kernel[static_cast<std::size_t>(k)] = static_cast<float>(value);
    total += k == 0 ? value : 2.0 * value;
  }
  for (float& value : memory.kernel) value /= static_cast<float>(total);
  const float *cells = memory.cells.data(), *kernel = memory.kernel.data();
  float *rows = memory.rows.data(), *out = memory.spread.data();
  std::fill_n(rows, h * w, 0.0f);
  for (Index i = 0; i < h; ++i) {
    for (Index k = -radius; k <= radius; ++k) {
      const float weight = kernel[k < 0 ? -k : k];
      for (Index j = std::max<Index>(0, -k); j < std::min(w, w - k); ++j) rows[i * w + j] += weight * cells[i * w + j + k];
    }
  }
  for (Index i = 0; i < h; ++i) {
    for (Index from = std::max<Index>(0, i - radius); from < std::min(h, i + radius + 1); ++from) {
      const float weight = share * kernel[from < i ? i - from : from - i];
      for (Index j = 0; j < w; ++j) out[i * w + j] += weight * rows[from * w + j];
    }
  }
}

/// Where pixel u lies between the middles of two cells: the first of them, and the share of the second.
struct Between {
  Index first, second;
  float share;
  Between(Index u, Index cells) {
    const float at = std::max((static_cast<float>(u) + 0.5f) / cell - 0.5f, 0.0f);
    first = static_cast<Index>(at);
    second = std::min(first + 1, cells - 1);
    share = at - static_cast<float>(first);
  }
};

}  // namespace

void scatter(float* pixels, Index height, Index width, Index pitch, float share, double deviation) {
  thread_local Memory memory;
  const Index h = (height + cell - 1) / cell, w = (width + cell - 1) / cell;
  for (std::vector<float>* image : {&memory.cells, &memory.rows, &memory.spread}) {
    image->assign(static_cast<std::size_t>(h * w), 0.0f);
  }
  means(pixels, height, width, pitch, w, memory.cells.data());
  for (const double times : widths) spread(memory, h, w, times * deviation / cell, share / 3.0f);
  for (Index v = 0; v < height; ++v) {
    const Between rows(v, h);
    const float *above = memory.spread.data() + rows.first * w, *below = memory.spread.data() + rows.second * w;
    float* column = memory.rows.data();  // of cells, in this row of pixels
    for (Index j = 0; j < w; ++j) column[j] = above[j] + rows.share * (below[j] - above[j]);
    float* row = pixels + v * pitch;
    for (Index u = 0; u < width; ++u) {
      const Between columns(u, w);
      row[u] = (1.0f - share) * row[u] + column[columns.first] + columns.share * (column[columns.second] - column[columns.first]);
    }
  }
}

}  // namespace cabinpose

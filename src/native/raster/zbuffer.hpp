// The z-buffer: nearest triangles at the pixels' centres and, of some pixels, at their parts.
//
// A triangle is tested at every sample's own ray, so a distorting lens costs nothing in accuracy. Triangles are drawn in the
// order of their faces and only what is nearer replaces what is there, so of equal 1/z the face with the lower index wins.
//
// A cabin with the faces turned away left out has few layers: of the blocks that are tested three quarters see the triangle or
// miss it. Sorting by depth and a coarse map of what is hidden (Greene et al., "Hierarchical Z-buffer visibility", 1993) cost
// more time than they saved.
#pragma once

#include <cstdint>
#include <vector>

#include "core/array.hpp"
#include "raster/triangles.hpp"

namespace cabinpose {

inline constexpr int block_samples = 8;  // samples lie in memory as blocks, `lanes` of them
inline constexpr int block_columns = 4;  // those of the pixels' centres: blocks of 4 x 2 pixels, the upper row first
inline constexpr int block_rows = 2;
inline constexpr int strip_rows = 2;  // rows of pixels whose parts lie together
inline constexpr int spare_strips =
    4;  // behind the last, where strips are counted: some are read before they are found not to be

/// Rays (x, y, 1) of a block of samples; NaN where there is none, which hits nothing.
struct BlockRays {
  float x[block_samples], y[block_samples];
};

/// What a block of samples sees: 1/z and the number of the triangle, 0 and 0 for nothing.
struct alignas(64) BlockHits {
  float w[block_samples];
  std::int32_t triangle[block_samples];
};

/// The pixels of an image as blocks: `across` of them side by side, `down` one above the other.
struct Grid {
  int width, height, across, down;

  Grid(int columns, int rows)
      : width(columns),
        height(rows),
        across((columns + block_columns - 1) / block_columns),
        down((rows + block_rows - 1) / block_rows) {}

  Index blocks() const { return static_cast<Index>(across) * down; }
};

/// Work space of the two functions below.
struct DrawMemory {
  std::vector<std::int32_t> candidates, blocks;
};

/// Nearest triangles at the pixels' centres, and the triangles of the frame.
///
/// rays, hits: the blocks of the grid · joints: rays through joints, tested by the way; or null.
void rasterise(const View& view, const Grid& grid, const BlockRays* rays, BlockHits* hits, Triangles& triangles,
               JointRays* joints, DrawMemory& memory);

/// Nearest triangles at the parts of some pixels: s x s samples each, one pixel after the other, row by row within a pixel.
///
/// The pixels are in the order of strips of the image `strip_rows` high, and column by column within a strip, so that those that
/// a small triangle may touch lie in few places. before: (strips + spare_strips, width), how many parts precede each column of
/// each strip; of the spare strips only the first column matters · rays, hits: the blocks of parts.
void refine(const View& view, const Triangles& triangles, const std::int32_t* before, Index blocks, const BlockRays* rays,
            BlockHits* hits, DrawMemory& memory);

}  // namespace cabinpose

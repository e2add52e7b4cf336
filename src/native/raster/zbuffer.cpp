#include "raster/zbuffer.hpp"

#include <algorithm>

#include "raster/lanes.hpp"

namespace cabinpose {
namespace {

constexpr int lane_shift = 3, column_shift = 2;
static_assert(block_samples == lanes && 1 << lane_shift == lanes && 1 << column_shift == block_columns);

constexpr float nearest_w = static_cast<float>(1.0 / near_m);
constexpr int chunk = 256;  // faces that are set up together, so that they are drawn from the cache

/// A triangle in all lanes.
struct Broadcast {
  Floats a[3], b[3], c[3], pa, pb, pc;
  Ints number;

  CABINPOSE_INLINE Broadcast(const Triangle& t, std::int32_t n) : pa(t.plane[0]), pb(t.plane[1]), pc(t.plane[2]), number(n) {
    for (int k = 0; k < 3; ++k) {
      a[k] = Floats(t.edge[3 * k]);
      b[k] = Floats(t.edge[3 * k + 1]);
      c[k] = Floats(t.edge[3 * k + 2]);
    }
  }

  /// Note the triangle at the samples of some blocks where it is hit and nearest.
  ///
  /// may_be_near: it may come nearer than the near limit.
  template <bool may_be_near>
  CABINPOSE_INLINE void cover(const std::int32_t* blocks, const std::int32_t* end, const BlockRays* rays, BlockHits* hits) const {
    for (; blocks < end; ++blocks) {
      const BlockRays& ray = rays[*blocks];
      BlockHits& hit = hits[*blocks];
      const Floats x = load(ray.x), y = load(ray.y), w = load(hit.w);
      const Floats depth = pa * x + (pb * y + pc);
      Floats least = a[0] * x + (b[0] * y + c[0]);
      least = min(a[1] * x + (b[1] * y + c[1]), least);
      least = min(a[2] * x + (b[2] * y + c[2]), least);
      Ints mask = (least >= Floats(0.0f)) & (depth > w);
      if constexpr (may_be_near) mask = mask & (depth <= Floats(nearest_w));
      store(max(from_bits(bits(depth) & mask), w), hit.w);  // w is not negative
      store(select(mask, number, load(hit.triangle)), hit.triangle);
    }
  }
};

/// Write the numbers of neighbouring blocks; returns the place behind them.
CABINPOSE_INLINE std::int32_t* write_blocks(std::int32_t* to, std::int32_t first, std::int32_t count) {
  std::int32_t* const behind = to + count;
  FourInts block = first + FourInts{0, 1, 2, 3};
  do {  // nearly always once; what is written behind the last is overwritten
    reinterpret_cast<InMemory<FourInts>*>(to)->value = block;
    block += 4;
    to += 4;
  } while (to < behind);
  return behind;
}

/// Triangles and the blocks that each may cover. The blocks of many are found before any is covered: a processor then need not
/// wait for the bounds of one triangle while it covers another.
class DrawList {
 public:
  /// memory: for the blocks; grows to twice `most`, as many as one triangle may cover.
  DrawList(std::vector<std::int32_t>& memory, Index most) {
    const Index room = 2 * (most + lanes);
    if (memory.size() < static_cast<std::size_t>(room)) memory.resize(room);
    begin_ = end_ = memory.data();
    full_ = begin_ + memory.size() - room / 2;
  }

  bool is_full() const { return count_ == triangles || end_ > full_; }
  /// Where the next triangle's blocks go.
  std::int32_t* place() const { return end_; }
  /// Blocks up to `end` have been added for a triangle.
  CABINPOSE_INLINE void add(std::int32_t number, std::int32_t* end) {
    numbers_[count_] = number;
    ends_[count_] = end;
    count_ += end > end_;
    end_ = end;
  }

  /// Cover all, in their order, and forget them.
  void draw(const Triangle* items, const BlockRays* rays, BlockHits* hits) {
    const std::int32_t* begin = begin_;
    for (int i = 0; i < count_; ++i) {
      const Triangle& triangle = items[numbers_[i]];
      const Broadcast t(triangle, numbers_[i]);
      if (triangle.is_clipped()) {
        t.cover<true>(begin, ends_[i], rays, hits);
      } else {
        t.cover<false>(begin, ends_[i], rays, hits);
      }
      begin = ends_[i];
    }
    count_ = 0;
    end_ = begin_;
  }

 private:
  static constexpr int triangles = 256;
  std::int32_t *begin_, *end_, *full_;
  int count_ = 0;
  std::int32_t numbers_[triangles + 1];
  std::int32_t* ends_[triangles + 1];
};

/// The columns of a triangle in four groups of rows: 0 <= first <= width, -1 <= last < width; first > last where there are none.
struct Columns {
  FourInts first, last;

  /// top, bottom: of each group, counted from the first row of the parts' box · spare: pixels beside them.
  CABINPOSE_INLINE Columns(const Sides& sides, const FourFloats& top, const FourFloats& bottom, float spare,
                           const PixelBox& box) {
    FourFloats low[2], high[2];
    for (int i = 0; i < 2; ++i) {
      const FourFloats a = sides.base[i] + sides.slope[i] * top, b = sides.base[i] + sides.slope[i] * bottom;
      const FourFloats c = sides.base[2 + i] + sides.slope[2 + i] * top, d = sides.base[2 + i] + sides.slope[2 + i] * bottom;
      low[i] = a < b ? a : b;
      high[i] = c > d ? c : d;
    }
    const float begin = static_cast<float>(box.first_column), end = static_cast<float>(box.last_column);
    FourFloats from = (low[0] > low[1] ? low[0] : low[1]) - spare, to = (high[0] < high[1] ? high[0] : high[1]) + spare;
    const FourFloats zero{}, begins = zero + begin, ends = zero + end, limit = ends + 1.0f;
    from = from > begins ? from : begins;
    from = from < limit ? from : limit;
    to = to < ends ? to : ends;
    const FourInts whole = __builtin_convertvector(from, FourInts);
    first = whole - (__builtin_convertvector(whole, FourFloats) < from);
    last = __builtin_convertvector(to, FourInts) | (to < zero);  // -1 before the first column
  }
};

constexpr FourInts counting{0, 1, 2, 3};

/// Add a triangle's blocks of pixels' centres.
CABINPOSE_INLINE void add_pixels(const Triangles& triangles, std::int32_t number, const Grid& grid, DrawList& list) {
  const Boxes& boxes = triangles.boxes[number];
  const int end = boxes.centre.last_row / block_rows + 1;
  std::int32_t* to = list.place();
  for (int first = boxes.centre.first_row / block_rows; first < end; first += 4) {
    const FourInts rows = first * block_rows - boxes.parts.first_row + counting * block_rows;
    const FourFloats top = __builtin_convertvector(rows, FourFloats);
    const Columns columns(triangles.sides[number], top, top + (block_rows - 1.0f), 0.0f, boxes.centre);
    const FourInts none = (columns.first > columns.last) | (counting >= end - first);
    const FourInts block = columns.first >> column_shift, blocks = ((columns.last >> column_shift) - block + 1) & ~none;
    for (int k = 0; k < 4; ++k) to = write_blocks(to, (first + k) * grid.across + block[k], blocks[k]);
  }
  list.add(number, to);
}

/// Add a triangle's blocks of parts; see `refine`.
CABINPOSE_INLINE void add_parts(const Triangles& triangles, std::int32_t number, int width, float reach,
                                const std::int32_t* before, DrawList& list) {
  const PixelBox box = triangles.boxes[number].parts;
  const int end = box.last_row / strip_rows + 1;
  std::int32_t* to = list.place();
  for (int first = box.first_row / strip_rows; first < end; first += 4) {
    const FourInts rows = first * strip_rows - box.first_row + counting * strip_rows;
    const FourFloats top = __builtin_convertvector(rows, FourFloats);
    const Columns columns(triangles.sides[number], top - reach, top + (strip_rows - 1.0f + reach), reach, box);
    FourInts start, stop;
    for (int k = 0; k < 4; ++k) {
      const std::int32_t* row = before + (first + k) * width;
      start[k] = row[columns.first[k]];
      stop[k] = row[columns.last[k] + 1];
    }
    // Blocks may hold neighbours: no harm.
    const FourInts none = (start >= stop) | (columns.first > columns.last) | (counting >= end - first);
    const FourInts block = start >> lane_shift, blocks = (((stop - 1) >> lane_shift) - block + 1) & ~none;
    for (int k = 0; k < 4; ++k) to = write_blocks(to, block[k], blocks[k]);
  }
  list.add(number, to);
}

}  // namespace

void rasterise(const View& view, const Grid& grid, const BlockRays* rays, BlockHits* hits, Triangles& triangles,
               JointRays* joints, DrawMemory& memory) {
  std::fill_n(hits, grid.blocks(), BlockHits{});
  const Index count = find_candidates(view, triangles, memory.candidates);
  DrawList list(memory.blocks, grid.blocks());
  for (Index first = 0; first < count; first += chunk) {
    std::int32_t numbers[chunk + 1];
    const int faces = static_cast<int>(std::min<Index>(chunk, count - first));
    const int drawn = set_up(view, memory.candidates.data() + first, faces, triangles, joints, numbers);
    for (int i = 0; i < drawn; ++i) {
      if (list.is_full()) list.draw(triangles.items.data(), rays, hits);
      add_pixels(triangles, numbers[i], grid, list);
    }
    list.draw(triangles.items.data(), rays, hits);
  }
}

void refine(const View& view, const Triangles& triangles, const std::int32_t* before, Index blocks, const BlockRays* rays,
            BlockHits* hits, DrawMemory& memory) {
  std::fill_n(hits, blocks, BlockHits{});
  const Index strips = (view.height + strip_rows - 1) / strip_rows;
  DrawList list(memory.blocks, blocks + strips);  // the last of a strip may be the first of the next
  for (std::int32_t n = 1; n < triangles.count; ++n) {
    if (triangles.boxes[n].parts.last_column < 0) continue;
    if (list.is_full()) list.draw(triangles.items.data(), rays, hits);
    add_parts(triangles, n, view.width, static_cast<float>(view.reach), before, list);
  }
  list.draw(triangles.items.data(), rays, hits);
}

}  // namespace cabinpose

#include "raster/triangles.hpp"

#include <algorithm>
#include <cmath>

#include "raster/joints.hpp"
#include "raster/lanes.hpp"

namespace cabinpose {
namespace {

constexpr float flat = 32.0f;      // columns a row: edges flatter than this bound no row
constexpr float rounding = 4e-3f;  // pixels: what float32 may lose in the sides of a triangle
constexpr float unbounded = 1e6f;  // pixels: beyond every image

/// The planes beyond which a vertex cannot be projected.
int unprojectable(const Lens& lens) { return lens.distorts() ? 31 : 1; }

/// Corner i of eight faces: x, y, 1/z and outside.
CABINPOSE_INLINE void gather_corners(const std::int32_t (&face)[lanes], int i, const std::int32_t* faces, const Corner* corners,
                                     Floats (&columns)[4]) {
  const float* places[lanes];
  for (int k = 0; k < lanes; ++k) places[k] = &corners[faces[3 * static_cast<Index>(face[k]) + i]].x;
  gather(places, columns);
}

/// The pixels between two coordinates of eight triangles: first and last, first > last where there is none.
struct Range {
  Ints first, last;

  CABINPOSE_INLINE Range(const Floats& low, const Floats& high, int count) {
    const Floats zero(0.0f), end(static_cast<float>(count));
    const Floats from = min(max(low, zero), end), to = min(max(high, zero), end - Floats(1.0f));
    const Ints whole = truncate(from);
    first = whole - (as_floats(whole) < from);
    last = select(high < zero, Ints(-1), truncate(to));
  }

  CABINPOSE_INLINE Ints empty() const { return as_floats(first) > as_floats(last); }
  /// Both as int16 in one word.
  CABINPOSE_INLINE Ints packed() const { return (first & Ints(0xFFFF)) | (last << Ints(16)); }
};

/// Eight triangles that need not be clipped.
struct EightTriangles {
  Floats edge[9], plane[3], weight[3];
  Floats u[3], v[3], margin, left, right, top, bottom;  // pixels: corners, and bounds beyond which no ray hits
  Ints outside;                                         // the planes that they cross

  CABINPOSE_INLINE EightTriangles(const std::int32_t (&face)[lanes], const View& view, bool distorts) {
    const Lens& lens = view.lens;
    Floats x[3], y[3];
    outside = Ints(0);
    for (int i = 0; i < 3; ++i) {
      Floats column[4];
      gather_corners(face, i, view.surface.faces.data(), view.corners, column);
      x[i] = column[0], y[i] = column[1], weight[i] = column[2];
      outside = outside | bits(column[3]);
      if (distorts) {
        std::tie(u[i], v[i]) = lens.pixel(x[i], y[i]);
      } else {
        u[i] = Floats(static_cast<float>(lens.fx)) * x[i] + Floats(static_cast<float>(lens.cx));
        v[i] = Floats(static_cast<float>(lens.fy)) * y[i] + Floats(static_cast<float>(lens.cy));
      }
    }
    Floats a[3], d[3];
    for (int i = 0; i < 3; ++i) {
      const int j = (i + 1) % 3, k = (i + 2) % 3;
      a[i] = y[j] - y[k];
      d[i] = x[k] - x[j];
    }
    const Floats area = d[2] * a[1] - d[1] * a[2];
    const Floats sign = select(area > Floats(0.0f), Floats(1.0f), Floats(-1.0f));
    for (int i = 0; i < 3; ++i) {
      const int j = (i + 1) % 3, k = (i + 2) % 3;
      edge[3 * i] = sign * a[i];
      edge[3 * i + 1] = sign * d[i];
      // x_j y_k - x_k y_j about the middle of the edge: as exact as the edge is short, and the other way round but for the sign.
      edge[3 * i + 2] = sign * (Floats(-0.5f) * ((x[j] + x[k]) * a[i] + (y[j] + y[k]) * d[i]));
    }
    const Floats t1 = (weight[1] - weight[0]) / area, t2 = (weight[2] - weight[0]) / area;
    plane[0] = a[1] * t1 + a[2] * t2;
    plane[1] = d[1] * t1 + d[2] * t2;
    plane[2] = weight[0] - (plane[0] * x[0] + plane[1] * y[0]);
    Floats longest = a[0] * a[0] + d[0] * d[0];
    for (int i = 1; i < 3; ++i) longest = max(a[i] * a[i] + d[i] * d[i], longest);
    margin = lens.bulge(longest);
    left = min(min(u[0], u[1]), u[2]) - margin;
    right = max(max(u[0], u[1]), u[2]) + margin;
    top = min(min(v[0], v[1]), v[2]) - margin;
    bottom = max(max(v[0], v[1]), v[2]) + margin;
  }

  CABINPOSE_INLINE void write(const std::int32_t (&face)[lanes], const std::int32_t (&number)[lanes], Triangle* out) const {
    const Floats columns[4][4] = {{edge[0], edge[1], edge[2], edge[3]},
                                  {edge[4], edge[5], edge[6], edge[7]},
                                  {edge[8], plane[0], plane[1], plane[2]},
                                  {weight[0], weight[1], weight[2], from_bits(load(face))}};
    for (int i = 0; i < 4; ++i) {
      float* places[lanes];
      for (int k = 0; k < lanes; ++k) places[k] = out[number[k]].edge + 4 * i;
      scatter(columns[i], places);
    }
  }

  /// first_row: of the parts' boxes.
  CABINPOSE_INLINE void write(const Floats& first_row, const std::int32_t (&number)[lanes], Sides* out) const {
    Floats base[4] = {Floats(-unbounded), Floats(-unbounded), Floats(unbounded), Floats(unbounded)}, slope[4] = {};
    for (int i = 0; i < 4; ++i) slope[i] = Floats(0.0f);
    for (int i = 0; i < 3; ++i) {
      const int j = (i + 1) % 3, k = (i + 2) % 3;
      const Floats run = u[k] - u[j], rise = v[k] - v[j];
      const Ints steep = abs(run) < Floats(flat) * abs(rise);
      const Floats s = select(steep, run / rise, Floats(0.0f));
      const Floats at = u[j] + s * (first_row - v[j]), spare = (margin + Floats(rounding)) * (Floats(1.0f) + abs(s));
      const Ints is_left = u[i] >= u[j] + s * (v[i] - v[j]);
      // Of the one or two edges on the left the first goes to one place and the last to the other.
      const Ints on_left = steep & is_left, on_right = steep & ~is_left;
      const Ints first_left = on_left & (base[0] == Floats(-unbounded)), first_right = on_right & (base[2] == Floats(unbounded));
      base[0] = select(first_left, at - spare, base[0]);
      slope[0] = select(first_left, s, slope[0]);
      base[1] = select(on_left, at - spare, base[1]);
      slope[1] = select(on_left, s, slope[1]);
      base[2] = select(first_right, at + spare, base[2]);
      slope[2] = select(first_right, s, slope[2]);
      base[3] = select(on_right, at + spare, base[3]);
      slope[3] = select(on_right, s, slope[3]);
    }
    float *bases[lanes], *slopes[lanes];
    for (int k = 0; k < lanes; ++k) bases[k] = out[number[k]].base, slopes[k] = out[number[k]].slope;
    scatter(base, bases);
    scatter(slope, slopes);
  }
};

/// The first whole number at or after x, not negative.
std::int16_t first_after(double x) { return static_cast<std::int16_t>(std::ceil(std::max(x, 0.0))); }

/// The last whole number at or before x, below count; -1 where there is none.
std::int16_t last_before(double x, int count) { return static_cast<std::int16_t>(x < 0.0 ? -1 : std::min(x, count - 1.0)); }

PixelBox box_of(const Polygon& p, double reach, const View& view) {
  const double spare = p.margin + reach;
  const auto [left, right] = std::minmax_element(p.u, p.u + p.size);
  const auto [top, bottom] = std::minmax_element(p.v, p.v + p.size);
  return {first_after(std::min(*left - spare, 32000.0)), last_before(*right + spare, view.width),
          first_after(std::min(*top - spare, 32000.0)), last_before(*bottom + spare, view.height)};
}

/// Sides of a polygon: of its edges the two longest on either side.
Sides sides_of(const Polygon& p, int first_row) {
  Sides sides{{-unbounded, -unbounded, unbounded, unbounded}, {}};
  double turn = 0.0, longest[2][2] = {};
  for (int i = 2; i < p.size; ++i) {
    turn += (p.u[i - 1] - p.u[0]) * (p.v[i] - p.v[0]) - (p.u[i] - p.u[0]) * (p.v[i - 1] - p.v[0]);
  }
  for (int i = 0; i < p.size; ++i) {
    const int j = i + 1 < p.size ? i + 1 : 0;
    const double run = p.u[j] - p.u[i], rise = p.v[j] - p.v[i], length = std::fabs(rise);
    if (!(std::fabs(run) < double{flat} * length)) continue;
    const bool is_left = (rise < 0.0) == (turn > 0.0);
    double* kept = longest[is_left ? 0 : 1];
    const int place = kept[0] <= kept[1] ? 0 : 1;
    if (length <= kept[place]) continue;
    kept[place] = length;
    const double slope = run / rise, spare = (p.margin + double{rounding}) * (1.0 + std::fabs(slope));
    double bound = is_left ? unbounded : -unbounded;  // whatever their order and shape, all corners are on one side
    for (int k = 0; k < p.size; ++k) {
      const double at = p.u[k] + slope * (first_row - p.v[k]);
      bound = is_left ? std::min(bound, at - spare) : std::max(bound, at + spare);
    }
    const int index = is_left ? place : 2 + place;
    sides.base[index] = static_cast<float>(std::clamp<double>(bound, -unbounded, unbounded));
    sides.slope[index] = static_cast<float>(slope);
  }
  return sides;
}

/// A triangle that has to be clipped; false where nothing of it is seen.
bool set_up_clipped(std::int32_t face, const View& view, JointRays* joints, Triangle& triangle, Boxes& boxes, Sides& sides) {
  const Surface& surface = view.surface;
  double p[3][3];
  int crossed = 0;
  for (int i = 0; i < 3; ++i) {
    const std::int32_t vertex = surface.faces(face, i);
    float moved[3];
    view.pose.move(&surface.vertices(vertex, 0), moved);
    std::copy_n(moved, 3, p[i]);
    crossed |= view.corners[vertex].outside;
  }
  double e[3][3];  // edge function i is r . e[i]
  for (int i = 0; i < 3; ++i) {
    const double *a = p[(i + 1) % 3], *b = p[(i + 2) % 3];
    for (int k = 0; k < 3; ++k) e[i][k] = a[(k + 1) % 3] * b[(k + 2) % 3] - a[(k + 2) % 3] * b[(k + 1) % 3];
  }
  const double det = p[0][0] * e[0][0] + p[0][1] * e[0][1] + p[0][2] * e[0][2];
  const bool one_sided = view.closed && !(view.looks[surface.material[face]] & two_sided);
  if (det == 0.0 || (one_sided && det > 0.0)) return false;
  for (int i = 0; i < 3; ++i) {
    for (int k = 0; k < 3; ++k) triangle.edge[3 * i + k] = static_cast<float>(det > 0.0 ? e[i][k] : -e[i][k]);
    triangle.plane[i] = static_cast<float>((e[0][i] + e[1][i] + e[2][i]) / det);
    triangle.weight[i] = 1.0f;
  }
  triangle.face = face;
  const Polygon polygon = clipped(p, crossed, view.lens);
  if (polygon.size == 0) return false;
  boxes = {box_of(polygon, 0.0, view), box_of(polygon, view.reach, view)};
  sides = sides_of(polygon, boxes.parts.first_row);
  if (joints) joints->hit(face, polygon, surface, view.pose);
  return true;
}

/// Test eight triangles, but for those that are clipped, against the rays through joints.
void find_joints(JointRays& joints, const EightTriangles& eight, const std::int32_t (&face)[lanes],
                 const std::int32_t (&clipped)[lanes], int count, const View& view) {
  const Floats* edges[4] = {&eight.left, &eight.right, &eight.top, &eight.bottom};
  std::int32_t cell[4][lanes];
  float edge[4][lanes];
  for (int i = 0; i < 4; ++i) {
    const Floats at = (*edges[i] + Floats(0.5f)) * Floats(i < 2 ? joints.columns_per_pixel() : joints.rows_per_pixel());
    store(truncate(min(max(at, Floats(0.0f)), Floats(JointRays::cells - 1.0f))), cell[i]);
    store(*edges[i], edge[i]);
  }
  for (int k = 0; k < count; ++k) {
    if (clipped[k] || !joints.near(cell[0][k], cell[1][k], cell[2][k], cell[3][k])) continue;
    const Extent extent{edge[0][k], edge[1][k], edge[2][k], edge[3][k], cell[2][k], cell[3][k]};
    joints.hit(face[k], extent, view.surface, view.pose);
  }
}

}  // namespace

Index find_candidates(const View& view, Triangles& triangles, std::vector<std::int32_t>& candidates) {
  const Index count = view.surface.faces.size();
  const std::int32_t* faces = view.surface.faces.data();
  const std::uint8_t *material = view.surface.material.data(), *look = view.looks.data();
  const Floats zero(0.0f);
  const Ints none(0), open(view.closed ? 0 : -1);
  if (candidates.size() < static_cast<std::size_t>(count) + 1) {
    candidates.resize(count + 1);
    triangles.items.resize(count + 2);
    triangles.boxes.resize(count + 2);
    triangles.sides.resize(count + 2);
  }
  triangles.count = 1;
  triangles.looks_through = false;
  std::int32_t* out = candidates.data();
  Index n = 0;
  for (Index first = 0; first < count; first += lanes) {
    const int left = static_cast<int>(std::min<Index>(lanes, count - first));
    std::int32_t face[lanes];
    for (int k = 0; k < lanes; ++k) face[k] = static_cast<std::int32_t>(first) + std::min(k, left - 1);
    Floats p[3][4];
    for (int i = 0; i < 3; ++i) gather_corners(face, i, faces, view.corners, p[i]);
    const Ints o0 = bits(p[0][3]), o1 = bits(p[1][3]), o2 = bits(p[2][3]);
    const Ints maybe_seen = (o0 & o1 & o2) == none;
    if (!any_of(maybe_seen)) continue;
    const Floats a1 = p[2][1] - p[0][1], a2 = p[0][1] - p[1][1], d1 = p[0][0] - p[2][0], d2 = p[1][0] - p[0][0];
    const Floats area = d2 * a1 - d1 * a2;
    const Ints crosses = ~(((o0 | o1 | o2) & Ints(unprojectable(view.lens))) == none);
    // Turned away: y points down, and outside is counter-clockwise. No thickness, or seen edge-on: no area.
    const Ints turned = area > zero;
    std::int32_t kept[lanes];
    store(maybe_seen & (crosses | (area < zero) | (turned & open)), kept);
    std::uint8_t seen_looks = 0;
    for (int k = 0; k < left; ++k) seen_looks |= look[material[first + k]];
    if (seen_looks & two_sided) {
      std::int32_t other_side[lanes];
      store(maybe_seen & turned, other_side);
      for (int k = 0; k < left; ++k) kept[k] |= look[material[first + k]] & two_sided ? other_side[k] : 0;
    }
    for (int k = 0; k < left; ++k) {
      out[n] = static_cast<std::int32_t>(first) + k;
      n -= kept[k];
    }
  }
  return n;
}

int set_up(const View& view, const std::int32_t* faces, int count, Triangles& triangles, JointRays* joints, std::int32_t* drawn) {
  const bool distorts = view.lens.distorts();
  const Ints fold(unprojectable(view.lens));
  const Floats spare(static_cast<float>(view.reach));
  Triangle* items = triangles.items.data();
  Boxes* boxes = triangles.boxes.data();
  Sides* sides = triangles.sides.data();
  std::int32_t n = triangles.count;
  int drawings = 0;
  for (int first = 0; first < count; first += lanes) {
    const int left = std::min(lanes, count - first);
    std::int32_t face[lanes];
    for (int k = 0; k < lanes; ++k) face[k] = faces[first + std::min(k, left - 1)];
    const EightTriangles eight(face, view, distorts);
    const Range columns(eight.left, eight.right, view.width), rows(eight.top, eight.bottom, view.height);
    const Range part_columns(eight.left - spare, eight.right + spare, view.width);
    const Range part_rows(eight.top - spare, eight.bottom + spare, view.height);
    std::int32_t clipped[lanes], kept[lanes], centre[lanes];
    store(eight.outside & fold, clipped);
    store(~(part_columns.empty() | part_rows.empty()), kept);
    store(~(columns.empty() | rows.empty()), centre);
    if (joints) find_joints(*joints, eight, face, clipped, left, view);
    std::int32_t number[lanes];  // where each goes; those that are left out, and those that are clipped, which follow, to 0
    std::uint8_t seen_looks = 0;
    for (int k = 0; k < lanes; ++k) {
      const std::uint8_t look = view.looks[view.surface.material[face[k]]];
      seen_looks |= look;
      number[k] = 0;
      if (k >= left) continue;
      if (clipped[k]) {
        if (!set_up_clipped(face[k], view, joints, items[n], boxes[n], sides[n])) continue;
        const PixelBox& box = boxes[n].centre;
        drawn[drawings] = n++;
        drawings += box.first_column <= box.last_column && box.first_row <= box.last_row;
        continue;
      }
      number[k] = n & kept[k];
      drawn[drawings] = n;
      drawings -= centre[k];
      n -= kept[k];
    }
    eight.write(face, number, items);
    eight.write(as_floats(part_rows.first), number, sides);
    float* places[lanes];
    for (int k = 0; k < lanes; ++k) places[k] = reinterpret_cast<float*>(boxes + number[k]);
    scatter(
        {from_bits(columns.packed()), from_bits(rows.packed()), from_bits(part_columns.packed()), from_bits(part_rows.packed())},
        places);
    if (seen_looks & looked_through) {
      triangles.looks_through = true;
      for (std::int32_t i = triangles.count; i < n; ++i) {
        if (view.looks[view.surface.material[items[i].face]] & looked_through) boxes[i].parts.last_column = -1;
      }
    }
    triangles.count = n;
  }
  return drawings;
}

}  // namespace cabinpose

#include "raster/projection.hpp"

#include <cmath>
#include <limits>

#include "raster/lanes.hpp"

namespace cabinpose {
namespace {

/// Signed distance-like value of a point to plane 0 (near) or 1..4 (sides of the box), not negative inside.
double inside(const double* p, int plane, const Lens& lens) {
  switch (plane) {
    case 0:
      return p[2] - near_m;
    case 1:
      return p[0] - lens.box[0] * p[2];
    case 2:
      return p[1] - lens.box[1] * p[2];
    case 3:
      return lens.box[2] * p[2] - p[0];
    default:
      return lens.box[3] * p[2] - p[1];
  }
}

}  // namespace

void project(Array<const float, any, 3> vertices, const Pose& pose, const Lens& lens, Corner* out) {
  const Floats near(static_cast<float>(near_m)), zero(0.0f), one(1.0f);
  Floats box[4];
  for (int k = 0; k < 4; ++k) box[k] = Floats(static_cast<float>(lens.box[k]));
  const double* __restrict m = pose.m;
  for (Index first = 0; first < vertices.size(); first += lanes) {
    const Index left = std::min<Index>(lanes, vertices.size() - first);
    const float* from = vertices.data() + 3 * first;
    float rest[3 * lanes] = {};
    if (left < lanes) {
      std::copy_n(from, 3 * left, rest);
      from = rest;
    }
    float moved[3][lanes];
    for (int k = 0; k < lanes; ++k) {
      const double a = from[3 * k], b = from[3 * k + 1], c = from[3 * k + 2];
      moved[0][k] = static_cast<float>(m[0] * a + m[1] * b + m[2] * c + m[3]);
      moved[1][k] = static_cast<float>(m[4] * a + m[5] * b + m[6] * c + m[7]);
      moved[2][k] = static_cast<float>(m[8] * a + m[9] * b + m[10] * c + m[11]);
    }
    const Floats px = load(moved[0]), py = load(moved[1]), pz = load(moved[2]);
    const Ints outside = (Ints(1) & (pz <= near)) | (Ints(2) & (px - box[0] * pz < zero)) |
                         (Ints(4) & (py - box[1] * pz < zero)) | (Ints(8) & (box[2] * pz - px < zero)) |
                         (Ints(16) & (box[3] * pz - py < zero));
    const Floats columns[4] = {px / pz, py / pz, one / pz, from_bits(outside)};
    float* places[lanes];
    for (int k = 0; k < lanes; ++k) places[k] = &out[first + k].x;
    scatter(columns, places);
  }
}

Polygon clipped(const double (&corners)[3][3], int crossed, const Lens& lens) {
  // Sutherland and Hodgman, "Reentrant polygon clipping", 1974.
  double points[2][max_corners][3];
  std::copy_n(&corners[0][0], 9, &points[0][0][0]);
  int k = 0, n = 3;
  for (int plane = 0; plane < 5; ++plane) {
    if (!(crossed >> plane & 1)) continue;
    int m = 0;
    for (int i = 0; i < n; ++i) {
      const double *p = points[k][i], *q = points[k][i + 1 < n ? i + 1 : 0];
      const double dp = inside(p, plane, lens), dq = inside(q, plane, lens);
      if (dp >= 0.0) std::copy_n(p, 3, points[1 - k][m++]);
      if ((dp >= 0.0) != (dq >= 0.0)) {
        const double t = dp / (dp - dq);
        for (int c = 0; c < 3; ++c) points[1 - k][m][c] = p[c] + (q[c] - p[c]) * t;
        ++m;
      }
    }
    k = 1 - k;
    n = m;
  }
  Polygon polygon{};
  polygon.size = n;
  double longest = 0.0;
  for (int i = 0; i < n; ++i) {
    const double *p = points[k][i], x = p[0] / p[2], y = p[1] / p[2];
    for (int j = 0; j < i; ++j) {
      const double *q = points[k][j], dx = q[0] / q[2] - x, dy = q[1] / q[2] - y;
      longest = std::max(longest, dx * dx + dy * dy);
    }
    const auto [u, v] = lens.pixel(x, y);
    polygon.u[i] = u;
    polygon.v[i] = v;
  }
  polygon.margin = lens.bulge(longest);
  return polygon;
}

}  // namespace cabinpose

#include "lab/sight.hpp"

#include <algorithm>
#include <cmath>
#include <limits>
#include <vector>

namespace cabinpose {

namespace {

using Codes = std::vector<std::uint8_t>;

Codes& workspace(Index count) {
  thread_local Codes codes;
  codes.resize(static_cast<std::size_t>(count));
  return codes;
}

/// Into `codes` (V,), which planes of a pyramid from an eye about points (P, 3) each vertex is beyond: a bit for each.
///
/// A triangle all of whose corners are beyond one plane is not between the eye and any of the points. No bit where a point lies
/// beside the eye: no pyramid holds it then.
void find_outside(const double* eye, Array<const double, any, 3> points, Array<const float, any, 3> vertices, Codes& codes) {
  const Index count = points.size();
  double sum[3] = {};
  for (Index m = 0; m < count; ++m) {
    for (int i = 0; i < 3; ++i) sum[i] += points(m, i);
  }
  const double ex = eye[0], ey = eye[1], ez = eye[2], number = static_cast<double>(count);
  double wx = sum[0] / number - ex, wy = sum[1] / number - ey, wz = sum[2] / number - ez;
  const double length = std::sqrt(wx * wx + wy * wy + wz * wz);
  wx = wx / length, wy = wy / length, wz = wz / length;
  const bool level = std::fabs(wz) < 0.9;
  double ux = level ? -wy : 0.0, uy = level ? wx : -wz, uz = level ? 0.0 : wy;
  const double norm = std::sqrt(ux * ux + uy * uy + uz * uz);
  ux = ux / norm, uy = uy / norm, uz = uz / norm;
  const double vx = wy * uz - wz * uy, vy = wz * ux - wx * uz, vz = wx * uy - wy * ux;
  constexpr double inf = std::numeric_limits<double>::infinity();
  double low_u = inf, high_u = -inf, low_v = inf, high_v = -inf, far = 0.0;
  std::fill(codes.begin(), codes.end(), std::uint8_t{0});
  for (Index m = 0; m < count; ++m) {
    const double dx = points(m, 0) - ex, dy = points(m, 1) - ey, dz = points(m, 2) - ez;
    const double w = wx * dx + wy * dy + wz * dz;
    if (w <= 0.0) return;
    const double u = (ux * dx + uy * dy + uz * dz) / w, v = (vx * dx + vy * dy + vz * dz) / w;
    low_u = std::min(low_u, u), high_u = std::max(high_u, u), low_v = std::min(low_v, v), high_v = std::max(high_v, v);
    far = std::max(far, w);
  }
  std::uint8_t* out = codes.data();
  const float* at = vertices.data();
  for (Index i = 0; i < vertices.size(); ++i) {
    const double dx = static_cast<double>(at[3 * i]) - ex, dy = static_cast<double>(at[3 * i + 1]) - ey;
    const double dz = static_cast<double>(at[3 * i + 2]) - ez;
    const double w = wx * dx + wy * dy + wz * dz;
    const double u = ux * dx + uy * dy + uz * dz, v = vx * dx + vy * dy + vz * dz;
    // A little to spare for rounding.
    const int left = u<low_u * w - 1e-9, right = u> high_u * w + 1e-9, below = v < low_v * w - 1e-9;
    const int above = v > high_v * w + 1e-9, behind = w > far, before = w < 0.0;
    out[i] = static_cast<std::uint8_t>(left | right << 1 | below << 2 | above << 3 | behind << 4 | before << 5);
  }
}

}  // namespace

void faces_between(Array<const double, any, 3> eyes, Array<const double, any, 3> points, Array<const float, any, 3> vertices,
                   Array<const std::int32_t, any, 3> faces, Array<bool, any> possible) {
  Codes& codes = workspace(vertices.size());
  std::fill_n(possible.data(), possible.size(), false);
  for (Index n = 0; n < eyes.size(); ++n) {
    find_outside(&eyes(n, 0), points, vertices, codes);
    const std::uint8_t* code = codes.data();
    for (Index f = 0; f < faces.size(); ++f) {
      const std::int32_t* corner = &faces(f, 0);
      possible(f) |= (code[corner[0]] & code[corner[1]] & code[corner[2]]) == 0;
    }
  }
}

void see_markers(Array<const double, any, 3> eyes, Array<const double, any, 3> markers, Array<const float, any, 3> vertices,
                 Array<const std::int32_t, any, 3> faces, double ends, Array<bool, any, any> seen) {
  Codes& codes = workspace(vertices.size());
  std::fill_n(seen.data(), seen.count(), true);
  for (Index n = 0; n < eyes.size(); ++n) {
    const double ex = eyes(n, 0), ey = eyes(n, 1), ez = eyes(n, 2);
    find_outside(&eyes(n, 0), markers, vertices, codes);
    const std::uint8_t* code = codes.data();
    for (Index f = 0; f < faces.size(); ++f) {
      const std::int32_t* corner = &faces(f, 0);
      if (code[corner[0]] & code[corner[1]] & code[corner[2]]) continue;
      double a[3], p[3], q[3];
      for (int i = 0; i < 3; ++i) {
        a[i] = static_cast<double>(vertices(corner[0], i));
        p[i] = static_cast<double>(vertices(corner[1], i)) - a[i];
        q[i] = static_cast<double>(vertices(corner[2], i)) - a[i];
      }
      const double sx = ex - a[0], sy = ey - a[1], sz = ez - a[2];
      const double rx = sy * p[2] - sz * p[1], ry = sz * p[0] - sx * p[2], rz = sx * p[1] - sy * p[0];
      const double along = q[0] * rx + q[1] * ry + q[2] * rz;
      for (Index m = 0; m < markers.size(); ++m) {
        if (!seen(n, m)) continue;
        const double dx = markers(m, 0) - ex, dy = markers(m, 1) - ey, dz = markers(m, 2) - ez;
        const double hx = dy * q[2] - dz * q[1], hy = dz * q[0] - dx * q[2], hz = dx * q[1] - dy * q[0];
        const double det = p[0] * hx + p[1] * hy + p[2] * hz;
        if (det == 0.0) continue;
        const double first = (sx * hx + sy * hy + sz * hz) / det, second = (dx * rx + dy * ry + dz * rz) / det;
        if (first < 0.0 || second < 0.0 || first + second > 1.0) continue;
        const double t = along / det;
        if (0.0 < t && t < 1.0 - ends / std::sqrt(dx * dx + dy * dy + dz * dz)) seen(n, m) = false;
      }
    }
  }
}

}  // namespace cabinpose

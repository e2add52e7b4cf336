// Points and triangles: the closest point, vertical lines that cross, and signed distance to a mesh.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <utility>

#include "core/array.hpp"
#include "core/fields.hpp"

namespace cabinpose {

/// Squared distance (m2) from a point to a triangle, the closest point, and its feature: 0 face, 1-3 vertices a, b, c, 4-6 edges
/// ab, bc, ca.
struct Closest {
  double square, x, y, z;
  int feature;
};

/// By Voronoi regions (Ericson 2005, section 5.1.5). a, b, c: three numbers each.
template <class T>
inline Closest closest_on_triangle(T px, T py, T pz, const T* a, const T* b, const T* c) {
  const T abx = b[0] - a[0], aby = b[1] - a[1], abz = b[2] - a[2];
  const T acx = c[0] - a[0], acy = c[1] - a[1], acz = c[2] - a[2];
  const T apx = px - a[0], apy = py - a[1], apz = pz - a[2];
  const T d1 = abx * apx + aby * apy + abz * apz, d2 = acx * apx + acy * apy + acz * apz;
  const T bpx = px - b[0], bpy = py - b[1], bpz = pz - b[2];
  const T d3 = abx * bpx + aby * bpy + abz * bpz, d4 = acx * bpx + acy * bpy + acz * bpz;
  const T cpx = px - c[0], cpy = py - c[1], cpz = pz - c[2];
  const T d5 = abx * cpx + aby * cpy + abz * cpz, d6 = acx * cpx + acy * cpy + acz * cpz;
  const T va = d3 * d6 - d5 * d4, vb = d5 * d2 - d1 * d6, vc = d1 * d4 - d3 * d2;
  const T zero = 0;
  double v = 0.0, w = 0.0;
  int feature = 0;
  if (d1 <= zero && d2 <= zero) {
    feature = 1;
  } else if (d3 >= zero && d4 <= d3) {
    v = 1.0;
    feature = 2;
  } else if (d6 >= zero && d5 <= d6) {
    w = 1.0;
    feature = 3;
  } else if (vc <= zero && d1 >= zero && d3 <= zero) {
    v = static_cast<double>(d1 / (d1 - d3));
    feature = 4;
  } else if (vb <= zero && d2 >= zero && d6 <= zero) {
    w = static_cast<double>(d2 / (d2 - d6));
    feature = 6;
  } else if (va <= zero && d4 - d3 >= zero && d5 - d6 >= zero) {
    w = static_cast<double>((d4 - d3) / ((d4 - d3) + (d5 - d6)));
    v = 1.0 - w;
    feature = 5;
  } else {
    const double s = 1.0 / static_cast<double>(va + vb + vc);
    v = static_cast<double>(vb) * s;
    w = static_cast<double>(vc) * s;
  }
  const double qx = static_cast<double>(a[0]) + static_cast<double>(abx) * v + static_cast<double>(acx) * w;
  const double qy = static_cast<double>(a[1]) + static_cast<double>(aby) * v + static_cast<double>(acy) * w;
  const double qz = static_cast<double>(a[2]) + static_cast<double>(abz) * v + static_cast<double>(acz) * w;
  const double dx = static_cast<double>(px) - qx, dy = static_cast<double>(py) - qy, dz = static_cast<double>(pz) - qz;
  return {dx * dx + dy * dy + dz * dz, qx, qy, qz, feature};
}

template <class T>
inline int edge_crossing(T px, T py, const T* a, const T* b) {
  if (a[1] <= py && py < b[1]) return (b[0] - a[0]) * (py - a[1]) - (b[1] - a[1]) * (px - a[0]) < T(0) ? 0 : 1;
  if (b[1] <= py && py < a[1]) return (a[0] - b[0]) * (py - b[1]) - (a[1] - b[1]) * (px - b[0]) < T(0) ? 0 : -1;
  return 0;
}

/// How often, and in which sense, the vertical line through (px, py) crosses a triangle: 1 where it faces up, -1 down, or 0.
///
/// Every edge is evaluated from its lower end, so that two triangles that share it agree to the last bit and a closed surface
/// never leaks along an edge.
template <class T>
inline int crossing(T px, T py, const T* a, const T* b, const T* c) {
  return edge_crossing(px, py, a, b) + edge_crossing(px, py, b, c) + edge_crossing(px, py, c, a);
}

/// Height (m) of a triangle's plane over (px, py); the vertical line there must cross the triangle.
template <class T>
inline T height_over(T px, T py, const T* a, const T* b, const T* c) {
  const T abx = b[0] - a[0], aby = b[1] - a[1], abz = b[2] - a[2];
  const T acx = c[0] - a[0], acy = c[1] - a[1], acz = c[2] - a[2];
  const T nx = aby * acz - abz * acy, ny = abz * acx - abx * acz, nz = abx * acy - aby * acx;
  return a[2] - (nx * (px - a[0]) + ny * (py - a[1])) / nz;
}

using Corners = Array<const double, any, 3, 3>;
using Cells = Array<const std::int64_t, 3>;  // of a grid, along each axis
using Vector = Array<const double, 3>;

/// Triangles by grid cell, compressed rows: (cells + 1,) starts and the numbers of the triangles.
std::pair<Grown<std::int32_t>, Grown<std::int32_t>> bin_triangles(Corners corners, Vector origin, double cell, Cells dims);

/// The triangles in each cell of a grid, see `bin_triangles`: Python's `scene.contact.triangles.SearchGrid`.
struct SearchGrid {
  Vector origin;
  double cell = 0.0;
  Cells dims;
  Array<const std::int32_t, any> starts, entries;

  CABINPOSE_FIELDS(SearchGrid, origin, cell, dims, starts, entries)
};

/// Triangles prepared for the search of the nearest: Python's `scene.contact.triangles.TriangleMesh`.
///
/// normals: (F, 7, 3) pseudo-normals of face, vertices a b c, edges ab bc ca.
struct Mesh {
  Corners corners;
  Array<const double, any, 7, 3> normals;
  bool closed = false;
  SearchGrid grid;

  CABINPOSE_FIELDS(Mesh, corners, normals, closed, grid)
};

/// Distance of a point (3,) to a mesh, m, negative inside where it is closed; `radius` stands for what is farther away.
///
/// The sign is that of the angle-weighted pseudo-normal of the closest feature (Baerentzen & Aanaes 2005). A distance that is
/// found to be at most `enough` is not pursued.
double signed_distance_to(const double* point, double radius, double enough, const Mesh& mesh);

/// The same (N,) of points (N, 3).
void signed_distance(Array<const double, any, 3> points, double radius, double enough, const Mesh& mesh, Array<double, any> out);

}  // namespace cabinpose

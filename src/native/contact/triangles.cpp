#include "contact/triangles.hpp"

namespace cabinpose {
namespace {

/// What was found of the nearest triangle: squared distance (m2), and whether the point is behind it.
struct Nearest {
  double square;
  bool inside;
};

Nearest nearest_in(Index row, const double* p, Nearest best, const Mesh& mesh) {
  for (Index e = mesh.grid.starts[row]; e < mesh.grid.starts[row + 1]; ++e) {
    const double* t = &mesh.corners(mesh.grid.entries[e], 0, 0);
    const Closest c = closest_on_triangle(p[0], p[1], p[2], t, t + 3, t + 6);
    if (c.square < best.square) {
      const double* n = &mesh.normals(mesh.grid.entries[e], c.feature, 0);
      best = {c.square, (p[0] - c.x) * n[0] + (p[1] - c.y) * n[1] + (p[2] - c.z) * n[2] < 0.0};
    }
  }
  return best;
}

Index clamped(double x, Index count) { return std::min(std::max(static_cast<Index>(std::floor(x)), Index{0}), count - 1); }

}  // namespace

std::pair<Grown<std::int32_t>, Grown<std::int32_t>> bin_triangles(Corners corners, Vector origin, double cell, Cells dims) {
  Grown<std::int32_t> starts, entries;
  starts.resize(static_cast<std::size_t>(dims[0] * dims[1] * dims[2] + 1));
  auto each_cell = [&](auto&& visit) {
    for (Index t = 0; t < corners.size(); ++t) {
      Index low[3], high[3];
      for (int axis = 0; axis < 3; ++axis) {
        const double a = corners(t, 0, axis), b = corners(t, 1, axis), c = corners(t, 2, axis);
        low[axis] = clamped((std::min({a, b, c}) - origin[axis]) / cell, dims[axis]);
        high[axis] = clamped((std::max({a, b, c}) - origin[axis]) / cell, dims[axis]);
      }
      for (Index i = low[0]; i <= high[0]; ++i) {
        for (Index j = low[1]; j <= high[1]; ++j) {
          for (Index k = low[2]; k <= high[2]; ++k) visit(static_cast<std::size_t>((i * dims[1] + j) * dims[2] + k), t);
        }
      }
    }
  };
  each_cell([&](std::size_t row, Index) { ++starts[row + 1]; });
  for (std::size_t row = 1; row < starts.size(); ++row) starts[row] += starts[row - 1];
  entries.resize(static_cast<std::size_t>(starts.back()));
  std::vector<std::int32_t> next(starts.begin(), starts.end() - 1);
  each_cell([&](std::size_t row, Index t) { entries[static_cast<std::size_t>(next[row]++)] = static_cast<std::int32_t>(t); });
  return {std::move(starts), std::move(entries)};
}

double signed_distance_to(const double* p, double radius, double enough, const Mesh& mesh) {
  const double stop = enough * enough, cell = mesh.grid.cell;
  const Vector& origin = mesh.grid.origin;
  const Cells& dims = mesh.grid.dims;
  Index low[3], high[3], own[3];
  for (int axis = 0; axis < 3; ++axis) {
    low[axis] = std::max(static_cast<Index>(std::floor((p[axis] - radius - origin[axis]) / cell)), Index{0});
    high[axis] = std::min(static_cast<Index>(std::floor((p[axis] + radius - origin[axis]) / cell)), dims[axis] - 1);
    own[axis] = clamped((p[axis] - origin[axis]) / cell, dims[axis]);
  }
  auto row = [&](Index i, Index j, Index k) { return (i * dims[1] + j) * dims[2] + k; };
  auto away = [&](Index i, int axis) {
    const double at = origin[axis] + static_cast<double>(i) * cell;
    return std::max({at - p[axis], p[axis] - origin[axis] - static_cast<double>(i + 1) * cell, 0.0});
  };
  // Outwards from the own cell along each axis: what is near is found first, and bounds what is looked at after it.
  auto outwards = [&](int axis, auto&& visit) {
    const Index from = std::min(std::max(own[axis], low[axis]), high[axis]);
    for (Index n = 0; n <= high[axis] - low[axis]; ++n) {
      if (from + n <= high[axis]) visit(from + n);
      if (n > 0 && from - n >= low[axis]) visit(from - n);
    }
  };
  Nearest best{radius * radius, false};
  outwards(0, [&](Index i) {
    const double dx = away(i, 0);
    if (dx * dx >= best.square || best.square <= stop) return;
    outwards(1, [&](Index j) {
      const double dy = away(j, 1);
      if (dx * dx + dy * dy >= best.square || best.square <= stop) return;
      outwards(2, [&](Index k) {
        const double dz = away(k, 2);
        if (dx * dx + dy * dy + dz * dz < best.square && best.square > stop) best = nearest_in(row(i, j, k), p, best, mesh);
      });
    });
  });
  return mesh.closed && best.inside ? -std::sqrt(best.square) : std::sqrt(best.square);
}

void signed_distance(Array<const double, any, 3> points, double radius, double enough, const Mesh& mesh, Array<double, any> out) {
  for (Index n = 0; n < points.size(); ++n) out[n] = signed_distance_to(&points(n, 0), radius, enough, mesh);
}

}  // namespace cabinpose

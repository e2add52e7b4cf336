#include "contact/depth.hpp"

#include <algorithm>
#include <cmath>
#include <limits>

namespace cabinpose {
namespace {

constexpr double infinite = std::numeric_limits<double>::infinity();

/// What a search needs and the next one takes over; one a thread.
struct Workspace {
  std::vector<std::int32_t> inside, over, entries, starts, next, chosen, numbers;
  std::vector<float> bounds, points;  // (n, 5) x0 x1 y0 y1, and the end in z the way the rays go
  std::vector<double> limits;
  std::vector<char> met;
};

Workspace& workspace() {
  thread_local Workspace work;
  return work;
}

std::size_t at(Index i) { return static_cast<std::size_t>(i); }

/// Which of the indexed points are in the box and not in the sphere.
void find_inside(Points points, Indices index, const float* box, Vector centre, double radius,
                 std::vector<std::int32_t>& chosen) {
  chosen.clear();
  const double keep_out = radius * radius;
  for (Index n = 0; n < index.size(); ++n) {
    const float* p = &points(index[n], 0);
    const bool within = box[0] < p[0] && p[0] < box[3] && box[1] < p[1] && p[1] < box[4] && box[2] < p[2] && p[2] < box[5];
    if (!within) continue;
    const double dx = static_cast<double>(p[0]) - centre[0], dy = static_cast<double>(p[1]) - centre[1],
                 dz = static_cast<double>(p[2]) - centre[2];
    if (dx * dx + dy * dy + dz * dz >= keep_out) chosen.push_back(index[n]);
  }
}

/// A box around points, and which way the rays go that tell on which side of a surface they are: the one that meets less of it.
struct Area {
  double low_x = infinite, low_y = infinite, low_z = infinite, high_x = -infinite, high_y = -infinite, high_z = -infinite;
  bool up = true;
};

using Faces = Array<const std::int32_t, any, 3>;
using Leaves = Array<const double, any, 2, 3>;

/// The faces that some vertical ray from the indexed points can meet, with their bounds; and the area of the points.
Area find_over(Points points, Points vertices, Faces faces, Leaves leaves, Workspace& work) {
  Area area;
  for (const std::int32_t v : work.inside) {
    const double x = points(v, 0), y = points(v, 1), z = points(v, 2);
    area = {std::min(area.low_x, x),  std::min(area.low_y, y),  std::min(area.low_z, z),
            std::max(area.high_x, x), std::max(area.high_y, y), std::max(area.high_z, z)};
  }
  const float low_x = static_cast<float>(area.low_x), high_x = static_cast<float>(area.high_x);  // exact: they were float32
  const float low_y = static_cast<float>(area.low_y), high_y = static_cast<float>(area.high_y);
  const float low_z = static_cast<float>(area.low_z), high_z = static_cast<float>(area.high_z);
  auto beside = [&](const double* box) {
    return box[3] < area.low_x || box[0] > area.high_x || box[4] < area.low_y || box[1] > area.high_y;
  };
  Index above = 0, below = 0;
  for (Index leaf = 0; leaf < leaves.size(); ++leaf) {
    const double* box = &leaves(leaf, 0, 0);
    if (beside(box)) continue;
    above += box[5] >= area.low_z;
    below += box[2] <= area.high_z;
  }
  area.up = above <= below;
  work.over.clear();
  work.bounds.clear();
  for (Index leaf = 0; leaf < leaves.size(); ++leaf) {
    const double* box = &leaves(leaf, 0, 0);
    if (beside(box) || (area.up ? box[5] < area.low_z : box[2] > area.high_z)) continue;
    for (Index f = leaf * leaf_faces; f < std::min((leaf + 1) * leaf_faces, faces.size()); ++f) {
      const float *a = &vertices(faces(f, 0), 0), *b = &vertices(faces(f, 1), 0), *c = &vertices(faces(f, 2), 0);
      const float x0 = std::min({a[0], b[0], c[0]}), x1 = std::max({a[0], b[0], c[0]});
      const float y0 = std::min({a[1], b[1], c[1]}), y1 = std::max({a[1], b[1], c[1]});
      const float end = area.up ? std::max({a[2], b[2], c[2]}) : std::min({a[2], b[2], c[2]});
      if (x1 >= low_x && x0 <= high_x && y1 >= low_y && y0 <= high_y && (area.up ? end >= low_z : end <= high_z)) {
        work.over.push_back(static_cast<std::int32_t>(f));
        work.bounds.insert(work.bounds.end(), {x0, x1, y0, y1, end});
      }
    }
  }
  return area;
}

/// Columns of a grid over the area: which of the faces found cover each, compressed rows.
struct Columns {
  double cell;
  Index nx, ny;
  Area area;

  Index column(double x, double origin, Index count) const {
    return std::min(std::max(static_cast<Index>((x - origin) / cell), Index{0}), count - 1);
  }
};

Columns bin_columns(const Area& area, Workspace& work) {
  const double cell = std::max(0.012, std::sqrt((area.high_x - area.low_x) * (area.high_y - area.low_y) / 4096.0));
  const Columns grid{cell, static_cast<Index>((area.high_x - area.low_x) / cell) + 1,
                     static_cast<Index>((area.high_y - area.low_y) / cell) + 1, area};
  work.starts.assign(at(grid.nx * grid.ny + 1), 0);
  auto each_column = [&](auto&& visit) {
    for (std::size_t n = 0; n < work.over.size(); ++n) {
      const float* b = &work.bounds[5 * n];
      const Index i0 = grid.column(static_cast<double>(b[0]), area.low_x, grid.nx);
      const Index i1 = grid.column(static_cast<double>(b[1]), area.low_x, grid.nx);
      const Index j0 = grid.column(static_cast<double>(b[2]), area.low_y, grid.ny);
      const Index j1 = grid.column(static_cast<double>(b[3]), area.low_y, grid.ny);
      for (Index i = i0; i <= i1; ++i) {
        for (Index j = j0; j <= j1; ++j) visit(at(i * grid.ny + j), n);
      }
    }
  };
  each_column([&](std::size_t row, std::size_t) { ++work.starts[row + 1]; });
  for (std::size_t row = 1; row < work.starts.size(); ++row) work.starts[row] += work.starts[row - 1];
  work.entries.resize(at(work.starts.back()));
  work.next.assign(work.starts.begin(), work.starts.end() - 1);
  each_column([&](std::size_t row, std::size_t n) { work.entries[at(work.next[row]++)] = static_cast<std::int32_t>(n); });
  return grid;
}

/// Boxes (n, 2, 3) around every `leaf_faces` consecutive faces of a solid.
Leaves leaves_of(const Solids& body, Index solid) {
  const Index first = body.leaf_rows(solid, 0), count = body.leaf_rows(solid, 1) - first;
  const Leaves boxes(&body.leaves(first, 0, 0), {count, 2, 3});
  if (body.ready[solid]) return boxes;
  body.ready[solid] = true;
  const Index start = body.all_rows(solid, 0), end = body.all_rows(solid, 1);
  for (Index leaf = 0; leaf < count; ++leaf) {
    double* box = &body.leaves(first + leaf, 0, 0);
    std::fill_n(box, 3, infinite);
    std::fill_n(box + 3, 3, -infinite);
    for (Index f = start + leaf * leaf_faces; f < std::min(start + (leaf + 1) * leaf_faces, end); ++f) {
      for (int corner = 0; corner < 3; ++corner) {
        for (int axis = 0; axis < 3; ++axis) {
          const double x = body.vertices(body.faces(f, corner), axis);
          box[axis] = std::min(box[axis], x);
          box[3 + axis] = std::max(box[3 + axis], x);
        }
      }
    }
  }
  return boxes;
}

/// Distance to the nearest face, whose number goes into `hint`; stops as soon as it is known to be at most `enough`.
double distance_to(const float* p, Points vertices, Faces faces, Leaves leaves, Index& hint, double enough) {
  auto square_to = [&](Index f) {
    return closest_on_triangle(p[0], p[1], p[2], &vertices(faces(f, 0), 0), &vertices(faces(f, 1), 0), &vertices(faces(f, 2), 0))
        .square;
  };
  double best = square_to(hint);
  const double x = p[0], y = p[1], z = p[2], stop = enough * enough;
  for (Index leaf = 0; leaf < leaves.size(); ++leaf) {
    if (best <= stop) break;
    const double* box = &leaves(leaf, 0, 0);
    const double dx = std::max({box[0] - x, x - box[3], 0.0}), dy = std::max({box[1] - y, y - box[4], 0.0}),
                 dz = std::max({box[2] - z, z - box[5], 0.0});
    if (dx * dx + dy * dy + dz * dz >= best) continue;
    for (Index f = leaf * leaf_faces; f < std::min((leaf + 1) * leaf_faces, faces.size()); ++f) {
      const double square = square_to(f);
      if (square < best) {
        best = square;
        hint = f;
      }
    }
  }
  return std::sqrt(best);
}

bool overlap(Array<const float, 2, 3> one, Array<const float, 2, 3> two) {
  bool all = true;
  for (int axis = 0; axis < 3; ++axis) all = all && one(0, axis) < two(1, axis) && two(0, axis) < one(1, axis);
  return all;
}

Indices own_of(const Solids& body, Index solid) {
  const Index start = body.own_rows(solid, 0);
  return {&body.own[start], {body.own_rows(solid, 1) - start}};
}

constexpr double origin[3] = {};

}  // namespace

void close_solids(Points skin, Indices ring_vertices, Rows ring_rows, Indices vertices, Rows vertex_rows,
                  Array<float, any, 3> closed, Array<float, any, 2, 3> boxes, Array<float, 2, 3> box) {
  std::copy_n(skin.data(), skin.count(), closed.data());
  for (Index c = 0; c < ring_rows.size(); ++c) {
    double sum[3] = {};
    for (Index r = ring_rows(c, 0); r < ring_rows(c, 1); ++r) {
      for (int axis = 0; axis < 3; ++axis) sum[axis] += static_cast<double>(skin(ring_vertices[r], axis));
    }
    const double n = static_cast<double>(ring_rows(c, 1) - ring_rows(c, 0));
    for (int axis = 0; axis < 3; ++axis) closed(skin.size() + c, axis) = static_cast<float>(sum[axis] / n);
  }
  constexpr float far = std::numeric_limits<float>::infinity();
  std::fill_n(&box(0, 0), 3, far);
  std::fill_n(&box(1, 0), 3, -far);
  for (Index s = 0; s < vertex_rows.size(); ++s) {
    float low[3] = {far, far, far}, high[3] = {-far, -far, -far};
    for (Index r = vertex_rows(s, 0); r < vertex_rows(s, 1); ++r) {
      const float* p = &skin(vertices[r], 0);
      for (int axis = 0; axis < 3; ++axis) {
        low[axis] = std::min(low[axis], p[axis]);
        high[axis] = std::max(high[axis], p[axis]);
      }
    }
    for (int axis = 0; axis < 3; ++axis) {
      boxes(s, 0, axis) = low[axis];
      boxes(s, 1, axis) = high[axis];
      box(0, axis) = std::min(box(0, axis), low[axis]);
      box(1, axis) = std::max(box(1, axis), high[axis]);
    }
  }
}

Deepest deepest_in(Points points, Indices index, Index solid, Vector centre, double radius, Array<const double, any> limits,
                   const Solids& body) {
  const Index start = body.all_rows(solid, 0), skin_count = body.skin_rows(solid, 1) - start;
  Workspace& work = workspace();
  find_inside(points, index, &body.boxes(solid, 0, 0), centre, radius, work.inside);
  if (work.inside.empty() || skin_count == 0) return {};
  const Faces faces(&body.faces(start, 0), {body.all_rows(solid, 1) - start, 3});
  const Faces skin(&body.faces(start, 0), {skin_count, 3});
  const Leaves leaves = leaves_of(body, solid);
  const Area area = find_over(points, body.vertices, faces, leaves, work);
  if (work.over.empty()) return {};
  const Columns grid = bin_columns(area, work);
  Deepest worst;
  Index hint = 0;
  for (const std::int32_t v : work.inside) {
    const float *p = &points(v, 0), x = p[0], y = p[1], z = p[2];
    const Index i = std::min(static_cast<Index>((static_cast<double>(x) - area.low_x) / grid.cell), grid.nx - 1);
    const Index j = std::min(static_cast<Index>((static_cast<double>(y) - area.low_y) / grid.cell), grid.ny - 1);
    const std::size_t row = at(i * grid.ny + j);
    int winding = 0;
    for (std::int32_t e = work.starts[row]; e < work.starts[row + 1]; ++e) {
      const std::size_t n = at(work.entries[at(e)]);
      const float* b = &work.bounds[5 * n];
      if ((area.up ? z > b[4] : z < b[4]) || x < b[0] || x > b[1] || y < b[2] || y > b[3]) continue;
      const Index f = work.over[n];
      const float *p0 = &body.vertices(faces(f, 0), 0), *p1 = &body.vertices(faces(f, 1), 0),
                  *p2 = &body.vertices(faces(f, 2), 0);
      const int sense = crossing(x, y, p0, p1, p2);
      // Of a closed surface as much is crossed upwards as downwards.
      if (sense != 0 && (height_over(x, y, p0, p1, p2) > z) == area.up) winding += area.up ? sense : -sense;
    }
    if (winding <= 0) continue;
    // The last leaf may hold some of the fan: its box is then larger than it need be.
    const double limit = limits.size() > 1 ? limits[v] : limits[0];
    const double depth = distance_to(p, body.vertices, skin, leaves, hint, limit + worst.excess);
    if (depth - limit > worst.excess) worst = {depth - limit, v, depth};
  }
  return worst;
}

Meeting first_of_pairs(const Solids& body, Array<const std::int64_t, any, 2> pairs, Array<const double, any> tolerances,
                       Array<const std::int64_t, any, 2> joint_ends, Array<const double, any> zones,
                       Array<const double, any, 3> joints) {
  for (Index p = 0; p < pairs.size(); ++p) {
    if (!overlap(body.boxes[pairs(p, 0)], body.boxes[pairs(p, 1)])) continue;
    Vector centre(origin);
    double radius = 0.0;
    if (joint_ends(p, 0) >= 0) {
      centre = joints[joint_ends(p, 0)];
      const Vector end = joints[joint_ends(p, 1)];
      const double x = end[0] - centre[0], y = end[1] - centre[1], z = end[2] - centre[2];
      radius = zones[p] * std::sqrt(x * x + y * y + z * z);
    }
    for (int side = 0; side < 2; ++side) {
      const Index into = pairs(p, side), of = pairs(p, 1 - side);
      const Deepest found = deepest_in(body.vertices, own_of(body, of), into, centre, radius, {&tolerances[p], {1}}, body);
      if (found.point >= 0) return {p, into, found};
    }
  }
  return {};
}

Meeting first_between(const Solids& body, const Solids& other, Array<const double, any> limit) {
  for (Index into = 0; into < body.boxes.size(); ++into) {
    for (Index of = 0; of < other.boxes.size(); ++of) {
      if (!overlap(body.boxes[into], other.boxes[of])) continue;
      const Deepest found = deepest_in(other.vertices, own_of(other, of), into, Vector(origin), 0.0, limit, body);
      if (found.point >= 0) return {into, of, found};
    }
  }
  return {};
}

Meeting first_probe(Array<const double, any, 3> probes, Array<const double, any, 4> balls, Array<const double, any> gives,
                    Transform vehicle_from_group, Array<const float, 2, 3> box, double tolerance, const Solids& body,
                    Array<double, 3> where) {
  Workspace& work = workspace();
  const double* m = vehicle_from_group.data();
  const Index solids = body.boxes.size();
  work.points.clear();
  work.chosen.clear();
  work.limits.clear();
  work.numbers.clear();
  work.met.assign(at(solids), 0);
  double low[3], high[3];
  for (int axis = 0; axis < 3; ++axis) {
    low[axis] = box(0, axis);
    high[axis] = box(1, axis);
  }
  double least = infinite;
  for (Index ball = 0; ball < balls.size(); ++ball) {
    const double *c = &balls(ball, 0), r = c[3] + 1e-6;  // rounding
    bool apart = false;
    for (int axis = 0; axis < 3; ++axis) {
      const double* row = m + 4 * axis;
      const double u = row[0] * c[0] + row[1] * c[1] + row[2] * c[2] + row[3];
      apart = apart || u + r < low[axis] || u - r > high[axis];
    }
    if (apart) continue;
    for (Index p = ball * run; p < std::min((ball + 1) * run, probes.size()); ++p) {
      const double* x = &probes(p, 0);
      double u[3];
      bool within = true;
      for (int axis = 0; axis < 3; ++axis) {
        const double* row = m + 4 * axis;
        u[axis] = row[0] * x[0] + row[1] * x[1] + row[2] * x[2] + row[3];
        within = within && low[axis] < u[axis] && u[axis] < high[axis];
      }
      if (!within) continue;
      work.numbers.push_back(static_cast<std::int32_t>(work.chosen.size()));
      work.chosen.push_back(static_cast<std::int32_t>(p));
      work.limits.push_back(gives[p] + tolerance);
      least = std::min(least, work.limits.back());
      for (const double value : u) work.points.push_back(static_cast<float>(value));
      for (Index s = 0; s < solids; ++s) {
        const float* b = &body.boxes(s, 0, 0);
        bool in = true;
        for (int axis = 0; axis < 3; ++axis) {
          in = in && static_cast<double>(b[axis]) < u[axis] && u[axis] < static_cast<double>(b[3 + axis]);
        }
        if (in) work.met[at(s)] = 1;
      }
    }
  }
  if (work.chosen.empty()) return {};
  const Index n = static_cast<Index>(work.chosen.size());
  for (Index solid = 0; solid < solids; ++solid) {
    // Nothing is deeper in a body than half its least extent: a hand need not be asked about foam.
    const float* b = &body.boxes(solid, 0, 0);
    const float extent = std::min({b[3] - b[0], b[4] - b[1], b[5] - b[2]});
    if (!work.met[at(solid)] || !(static_cast<double>(0.5f * extent) > least)) continue;
    Deepest found = deepest_in({work.points.data(), {n, 3}}, {work.numbers.data(), {n}}, solid, Vector(origin), 0.0,
                               {work.limits.data(), {n}}, body);
    if (found.point >= 0) {
      for (Index axis = 0; axis < 3; ++axis) where[axis] = static_cast<double>(work.points[at(3 * found.point + axis)]);
      found.point = work.chosen[at(found.point)];
      return {solid, -1, found};
    }
  }
  return {};
}

SampledSkin sampled_skin(Points skin, Indices order, Array<const std::int32_t, any, 2> edges, double spacing) {
  SampledSkin result;
  auto& [points, owner] = result;
  const float square = static_cast<float>(spacing * spacing);
  auto square_of = [&](Index e) {
    const float *a = &skin(edges(e, 0), 0), *b = &skin(edges(e, 1), 0);
    const float x = b[0] - a[0], y = b[1] - a[1], z = b[2] - a[2];
    return x * x + y * y + z * z;
  };
  points.reserve(at(4 * order.size()));
  owner.reserve(at(4 * order.size() / 3));
  for (Index n = 0; n < order.size(); ++n) {
    const float* p = &skin(order[n], 0);
    points.insert(points.end(), p, p + 3);
    owner.push_back(order[n]);
  }
  for (Index e = 0; e < edges.size(); ++e) {
    const float s = square_of(e);
    if (s <= square) continue;
    const float *a = &skin(edges(e, 0), 0), *b = &skin(edges(e, 1), 0);
    const Index pieces = static_cast<Index>(std::ceil(static_cast<double>(std::sqrt(s)) / spacing));
    for (Index n = 1; n < pieces; ++n) {
      const double t = static_cast<double>(n) / static_cast<double>(pieces);
      for (int axis = 0; axis < 3; ++axis) {
        points.push_back(static_cast<float>(static_cast<double>(a[axis]) + t * static_cast<double>(b[axis] - a[axis])));
      }
      owner.push_back(edges(e, 0));
    }
  }
  return result;
}

SampledSkin limb_axes(Array<const double, any, 3> joints, Array<const std::int64_t, any, 2> ends,
                      Array<const double, any> skipped, double step) {
  SampledSkin result;
  auto& [points, owner] = result;
  for (Index row = 0; row < ends.size(); ++row) {
    const double *a = &joints(ends(row, 0), 0), *b = &joints(ends(row, 1), 0);
    const double x = b[0] - a[0], y = b[1] - a[1], z = b[2] - a[2];
    const Index count = std::max(static_cast<Index>(std::sqrt(x * x + y * y + z * z) / step), Index{2});
    for (Index k = 0; k < count; ++k) {
      const double t = skipped[row] + static_cast<double>(k) * ((1.0 - skipped[row]) / static_cast<double>(count - 1));
      for (int axis = 0; axis < 3; ++axis) points.push_back(static_cast<float>(a[axis] + t * (b[axis] - a[axis])));
      owner.push_back(static_cast<std::int32_t>(row));
    }
  }
  return result;
}

}  // namespace cabinpose

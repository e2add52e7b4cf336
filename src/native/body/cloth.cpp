#include "body/cloth.hpp"

#include <algorithm>
#include <cmath>
#include <vector>

#include "body/skinning.hpp"
#include "core/math.hpp"

namespace cabinpose {

namespace {

constexpr float tether = 0.2f;    // share of a vertex' slip along the body that is taken back in each sweep
constexpr float evened = 0.6f;    // share of a step that the body is evened by, for normals that its hollows do not turn
constexpr float pinned = 0.99f;   // cloth whose mask is no more than this stays where it is
constexpr double row_m = 0.015;   // of the table of radii of `hang`
constexpr double truncate = 4.0;  // standard deviations at which a bell curve ends

// Vectors of a point's coordinates and a 0. Only within functions: passed between them, they are not the same in both builds.
typedef float Float4 __attribute__((vector_size(16)));
typedef double Double4 __attribute__((vector_size(32)));

/// A vertex that moves, and where its neighbours are listed.
struct Moving {
  Index vertex, first, last;
  double share, weight;  // of a step; of each neighbour
};

struct Workspace {
  std::vector<Float4> place, under, normal;
  std::vector<Moving> moving;
  std::vector<float> points, normals, share;
  std::vector<std::int32_t> level, begin;
};

Workspace& workspace() {
  thread_local Workspace own;
  return own;
}

void take(Array<const float, any, 3> points, std::vector<Float4>& into) {
  into.resize(static_cast<std::size_t>(points.size()));
  for (Index v = 0; v < points.size(); ++v) {
    const float* p = &points(v, 0);
    into[static_cast<std::size_t>(v)] = Float4{p[0], p[1], p[2], 0.0f};
  }
}

void give(const std::vector<Float4>& from, Array<float, any, 3> points) {
  for (Index v = 0; v < points.size(); ++v) {
    const Float4 p = from[static_cast<std::size_t>(v)];
    for (int i = 0; i < 3; ++i) points(v, i) = p[i];
  }
}

/// The vertices whose share of a step is above 0, in an order with the results of theirs: a vertex comes after its neighbours of
/// lower number, but not right after them. The processor then need not wait for one step to begin the next.
void find_moving(const Neighbours& neighbours, const float* share, Workspace& work) {
  const Index count = neighbours.start.size() - 1;
  std::vector<std::int32_t>&level = work.level, &begin = work.begin;
  level.assign(static_cast<std::size_t>(count), 0);  // 0: does not move
  begin.assign(1, 0);
  for (Index v = 0; v < count; ++v) {
    if (!(share[v] > 0.0f)) continue;
    std::int32_t latest = 0;
    for (Index k = neighbours.start[v]; k < neighbours.start[v + 1]; ++k) {
      const Index other = neighbours.near[k];
      if (other < v) latest = std::max(latest, level[static_cast<std::size_t>(other)]);
    }
    const auto own = static_cast<std::size_t>(latest + 1);
    level[static_cast<std::size_t>(v)] = latest + 1;
    if (begin.size() <= own) begin.push_back(0);
    ++begin[own];
  }
  for (std::size_t k = 1; k < begin.size(); ++k) begin[k] += begin[k - 1];
  work.moving.resize(static_cast<std::size_t>(begin.back()));
  for (Index v = 0; v < count; ++v) {
    const auto own = static_cast<std::size_t>(level[static_cast<std::size_t>(v)]);
    if (!own) continue;
    const Index first = neighbours.start[v], last = neighbours.start[v + 1];
    work.moving[static_cast<std::size_t>(begin[own - 1]++)] = {v, first, last, static_cast<double>(share[v]), 0.0};
  }
}

/// A bell curve's weights from its middle outwards, which sum to 1 with their mirror images.
std::vector<double> bell(double deviation) {
  std::vector<double> weight(static_cast<std::size_t>(truncate * deviation + 0.5) + 1);
  double sum = 0.0;
  for (std::size_t k = 0; k < weight.size(); ++k) {
    const double x = static_cast<double>(k);
    weight[k] = exp(-0.5 / (deviation * deviation) * (x * x));
    sum += k ? 2.0 * weight[k] : weight[k];
  }
  for (double& w : weight) w /= sum;
  return weight;
}

/// A table (rows, columns) smoothed along its rows, whose ends meet, then along its columns, whose ends go on.
void smooth(std::vector<double>& table, Index rows, Index columns) {
  static const std::vector<double> across = bell(1.2), along = bell(1.5);
  const Index side = static_cast<Index>(across.size()) - 1, reach = static_cast<Index>(along.size()) - 1;
  std::vector<double> smoothed(table.size()), ring(static_cast<std::size_t>(columns + 2 * side));
  for (Index r = 0; r < rows; ++r) {
    const double *row = table.data() + r * columns, *around = ring.data() + side;
    double* to = smoothed.data() + r * columns;
    std::copy_n(row + columns - side, side, ring.data());
    std::copy_n(row, columns, ring.data() + side);
    std::copy_n(row, side, ring.data() + side + columns);
    for (Index c = 0; c < columns; ++c) to[c] = around[c] * across[0];
    for (Index k = side; k > 0; --k) {
      for (Index c = 0; c < columns; ++c) to[c] += (around[c - k] + around[c + k]) * across[static_cast<std::size_t>(k)];
    }
  }
  const double* from = smoothed.data();
  for (Index r = 0; r < rows; ++r) {
    double* row = table.data() + r * columns;
    for (Index c = 0; c < columns; ++c) row[c] = from[r * columns + c] * along[0];
    for (Index k = reach; k > 0; --k) {
      const double *above = from + std::max<Index>(r - k, 0) * columns, *below = from + std::min(r + k, rows - 1) * columns;
      for (Index c = 0; c < columns; ++c) row[c] += (above[c] + below[c]) * along[static_cast<std::size_t>(k)];
    }
  }
}

}  // namespace

void relax(Array<const float, any, 3> points, const Neighbours& neighbours, Array<const float, any> share, int sweeps,
           Array<float, any, 3> out) {
  Workspace& work = workspace();
  take(points, work.place);
  find_moving(neighbours, share.data(), work);
  for (Moving& m : work.moving) m.weight = m.share / static_cast<double>(m.last - m.first);
  Float4* place = work.place.data();
  const std::int32_t* near = neighbours.near.data();
  for (int sweep = 0; sweep < sweeps; ++sweep) {
    for (const Moving& m : work.moving) {
      Float4 sum = {};
      for (Index k = m.first; k < m.last; ++k) sum += place[near[k]];
      const Float4 kept = (1.0f - static_cast<float>(m.share)) * place[m.vertex];
      const Double4 moved = __builtin_convertvector(kept, Double4) + m.weight * __builtin_convertvector(sum, Double4);
      place[m.vertex] = __builtin_convertvector(moved, Float4);
    }
  }
  give(work.place, out);
}

void stretch(Array<const float, any, 3> under, Array<const std::int32_t, any, 3> faces, const Neighbours& neighbours,
             Array<const float, any> mask, float gap, int evening, int sweeps, Array<float, any, 3> out) {
  Workspace& work = workspace();
  const Index count = under.size();
  const auto size = static_cast<std::size_t>(count);
  work.share.resize(size), work.points.resize(3 * size), work.normals.resize(3 * size);
  for (Index v = 0; v < count; ++v) work.share[static_cast<std::size_t>(v)] = evened * mask[v];
  const Array<float, any, 3> even(work.points.data(), {count, 3}), normals(work.normals.data(), {count, 3});
  relax(under, neighbours, Array<const float, any>(work.share.data(), {count}), evening, even);
  vertex_normals(even, faces, normals);
  take(under, work.under);
  take(normals, work.normal);
  work.place.resize(size);
  for (std::size_t v = 0; v < size; ++v) {
    const float m = mask[static_cast<Index>(v)];
    work.place[v] = work.under[v] + gap * m * work.normal[v];
    work.share[v] = m > pinned ? m : 0.0f;
  }
  find_moving(neighbours, work.share.data(), work);
  for (Moving& m : work.moving) m.weight = 1.0 / static_cast<double>(m.last - m.first);
  Float4* place = work.place.data();
  const std::int32_t* near = neighbours.near.data();
  constexpr double keep = static_cast<double>(1.0f - tether);
  for (int sweep = 0; sweep < sweeps; ++sweep) {
    for (const Moving& m : work.moving) {
      Float4 sum = {};
      for (Index k = m.first; k < m.last; ++k) sum += place[near[k]];
      const auto v = static_cast<std::size_t>(m.vertex);
      const Double4 here = __builtin_convertvector(place[v], Double4), body = __builtin_convertvector(work.under[v], Double4);
      const Double4 normal = __builtin_convertvector(work.normal[v], Double4);
      const Double4 slip = here + m.share * (__builtin_convertvector(sum, Double4) * m.weight - here) - body;
      const Double4 outwards = slip * normal;
      const double off = outwards[0] + outwards[1] + outwards[2];
      const double further = std::max(off, static_cast<double>(gap * mask[m.vertex])) - keep * off;
      place[v] = __builtin_convertvector(body + keep * slip + further * normal, Float4);
    }
  }
  give(work.place, out);
}

void refine(Array<const float, any, 3> points, Array<const std::int32_t, any, 3> faces, const Blend& blend,
            Array<float, any, 3> vertices, Array<float, any, 3> normals) {
  const Index count = points.size(), added = blend.start.size() - 1;
  std::copy_n(points.data(), points.count(), vertices.data());
  vertex_normals(points, faces, Array<float, any, 3>(normals.data(), {count, 3}));
  for (Index v = 0; v < added; ++v) {
    const Index first = blend.start[v], last = blend.start[v + 1];
    float flat[3] = {}, mixed[3] = {}, bulge[3] = {};
    for (Index k = first; k < last; ++k) {
      const float w = blend.weight[k], *p = &points(blend.parent[k], 0), *n = &normals(blend.parent[k], 0);
      for (int i = 0; i < 3; ++i) flat[i] += w * p[i], mixed[i] += w * n[i];
    }
    for (Index k = first; k < last; ++k) {
      const float w = blend.weight[k], *p = &points(blend.parent[k], 0), *n = &normals(blend.parent[k], 0);
      const float off = (p[0] - flat[0]) * n[0] + (p[1] - flat[1]) * n[1] + (p[2] - flat[2]) * n[2];
      for (int i = 0; i < 3; ++i) bulge[i] += w * off * n[i];
    }
    const float length = std::sqrt(mixed[0] * mixed[0] + mixed[1] * mixed[1] + mixed[2] * mixed[2]);
    for (int i = 0; i < 3; ++i) {
      vertices(count + v, i) = flat[i] + 0.5f * bulge[i];
      normals(count + v, i) = mixed[i] / std::max(length, 1e-6f);
    }
  }
}

void hang(Array<const double, any> down, Array<const double, any> radius, Array<const double, any> angle,
          Array<const double, any> narrowing, Array<double, any> out) {
  const Index count = down.size(), sectors = narrowing.size();
  if (!count) return;
  const double top = *std::min_element(down.data(), down.data() + count);
  const double bottom = *std::max_element(down.data(), down.data() + count);
  const Index rows = static_cast<Index>((bottom - top) / row_m) + 2;
  auto row_of = [&](Index i) { return (down[i] - top) / row_m; };
  auto sector_of = [&](Index i) { return (angle[i] / (2.0 * pi) + 0.5) * static_cast<double>(sectors); };
  std::vector<double> table(static_cast<std::size_t>(rows * sectors)), besides(static_cast<std::size_t>(sectors));
  for (Index i = 0; i < count; ++i) {
    const Index row = static_cast<Index>(std::nearbyint(row_of(i)));
    const Index sector = static_cast<Index>(std::nearbyint(sector_of(i))) % sectors;
    double& value = table[static_cast<std::size_t>(row * sectors + sector)];
    value = std::max(value, radius[i]);
  }
  for (Index r = 0; r < rows; ++r) {
    double* row = table.data() + r * sectors;
    for (int round = 0; round < 3; ++round) {  // places that no vertex fell into
      for (Index s = 0; s < sectors; ++s) {
        besides[static_cast<std::size_t>(s)] = std::max(row[(s + sectors - 1) % sectors], row[(s + 1) % sectors]);
      }
      for (Index s = 0; s < sectors; ++s) row[s] = row[s] > 0.0 ? row[s] : besides[static_cast<std::size_t>(s)];
    }
    if (r == 0) continue;
    for (Index s = 0; s < sectors; ++s) row[s] = std::max(row[s], row[s - sectors] - narrowing[s] * row_m);
  }
  smooth(table, rows, sectors);
  for (Index i = 0; i < count; ++i) {
    const double row = row_of(i), sector = sector_of(i), whole = std::floor(sector);
    const double share = sector - whole, down_share = row - std::floor(row);
    const Index r = static_cast<Index>(row), s = static_cast<Index>(whole) % sectors, next = (s + 1) % sectors;
    const double *above = table.data() + r * sectors, *below = table.data() + std::min(r + 1, rows - 1) * sectors;
    out[i] = above[s] * (1.0 - down_share) * (1.0 - share) + above[next] * (1.0 - down_share) * share +
             below[s] * down_share * (1.0 - share) + below[next] * down_share * share;
  }
}

void roll_ball(Array<const double, any, 3> points, Array<const double, any, any, 3> origin,
               Array<const double, any, any, 3> direction, double ball, Array<double, any, any> radius,
               Array<std::int64_t, any, any> touched) {
  const std::size_t count = static_cast<std::size_t>(points.size());
  std::vector<double> x(count), y(count), z(count), height(count);  // by axes, so that several points are done at once
  for (std::size_t n = 0; n < count; ++n) {
    const double* point = points.data() + 3 * n;
    x[n] = point[0], y[n] = point[1], z[n] = point[2];
  }
  const double reach = ball * ball;
  for (Index ray = 0; ray < radius.count(); ++ray) {
    const double *from = origin.data() + 3 * ray, *way = direction.data() + 3 * ray;
    const double ox = from[0], oy = from[1], oz = from[2], wx = way[0], wy = way[1], wz = way[2];
    for (std::size_t n = 0; n < count; ++n) {
      const double ax = x[n] - ox, ay = y[n] - oy, az = z[n] - oz;
      const double along = ax * wx + ay * wy + az * wz, beside = ax * ax + ay * ay + az * az - along * along;
      const double out = along - 0.5 * beside / ball;
      height[n] = (along > 0.0 ? out : -1.0) - (beside > reach ? 10.0 : 0.0);
    }
    const auto highest = std::max_element(height.begin(), height.end());
    radius.data()[ray] = *highest;
    touched.data()[ray] = highest - height.begin();
  }
}

}  // namespace cabinpose

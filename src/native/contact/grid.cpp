#include "contact/grid.hpp"

#include <algorithm>
#include <cmath>
#include <limits>

namespace cabinpose {
namespace {

/// Lowers `best` to the clearance in the row beside it and the way from there.
void lower_to_row(const float* other, Index n, float straight, float diagonal, float* best) {
  const Index last = n - 1;
  auto lowered = [&](Index k, float beside) { best[k] = std::min({best[k], std::fabs(other[k]) + straight, beside + diagonal}); };
  const float first = std::fabs(other[std::min(Index{1}, last)]), final = std::fabs(other[std::max(last - 1, Index{0})]);
  lowered(0, first);
  lowered(last, final);
  for (Index k = 1; k < last; ++k) {
    const float aslant = std::min(std::fabs(other[k - 1]), std::fabs(other[k + 1])) + diagonal;
    const float own = std::fabs(other[k]) + straight, low = own < best[k] ? own : best[k];
    best[k] = aslant < low ? aslant : low;
  }
}

/// A word's seeds, carried over the runs of clear nodes that they lie in (parallel prefix, Kogge & Stone 1973).
std::uint64_t spread_along(std::uint64_t seed, std::uint64_t clear) {
  std::uint64_t up = seed, down = seed, way_up = clear, way_down = clear;
  for (int n = 0; n < 6; ++n) {
    const int by = 1 << n;
    up |= way_up & (up << by);
    way_up &= way_up << by;
    down |= way_down & (down >> by);
    way_down &= way_down >> by;
  }
  return up | down;
}

/// Trilinear value (quanta) at a point of the vehicle frame, `outside` beyond the grid.
inline double interpolate(double x, double y, double z, const double* m, const FieldGrid& field, double outside) {
  const Levels& values = field.values;
  const double u = (m[0] * x + m[1] * y + m[2] * z + m[3] - field.origin[0]) / field.step;
  const double v = (m[4] * x + m[5] * y + m[6] * z + m[7] - field.origin[1]) / field.step;
  const double w = (m[8] * x + m[9] * y + m[10] * z + m[11] - field.origin[2]) / field.step;
  const Index ni = values.size(0), nj = values.size(1), nk = values.size(2);
  const bool within = 0.0 <= u && u < static_cast<double>(ni - 1) && 0.0 <= v && v < static_cast<double>(nj - 1) && 0.0 <= w &&
                      w < static_cast<double>(nk - 1);
  if (!within) return outside;
  const Index i = static_cast<Index>(u), j = static_cast<Index>(v), k = static_cast<Index>(w);
  const double fu = u - static_cast<double>(i), fv = v - static_cast<double>(j), fw = w - static_cast<double>(k);
  const std::int8_t *a = &values(i, j, k), *b = &values(i + 1, j, k), *c = a + nk, *d = b + nk;  // of the next j
  double low = (a[0] * (1.0 - fu) + b[0] * fu) * (1.0 - fv);
  low += (c[0] * (1.0 - fu) + d[0] * fu) * fv;
  double high = (a[1] * (1.0 - fu) + b[1] * fu) * (1.0 - fv);
  high += (c[1] * (1.0 - fu) + d[1] * fu) * fv;
  return low * (1.0 - fw) + high * fw;
}

/// Four nodes at a time; each operation is that of one lane four times over, whatever the registers of the build. As values they
/// would not be passed alike by both.
using Four = double __attribute__((vector_size(32)));
using FourFloats = float __attribute__((vector_size(16)));

/// By how much the way to a segment is shorter than to its start, squared: from the product with its direction, and its length.
[[gnu::always_inline]] inline void to_segment(const Four& along, double square, double per_square, Four& shorter) {
  const Four t = along * per_square, zero{}, one = zero + 1.0, share = t < zero ? zero : t > one ? one : t;
  shorter = share * (2.0 * along - share * square);
}

/// By how much numbers are outside of an interval.
[[gnu::always_inline]] inline void outside_of(double low, double high, const Four& x, Four& beside) {
  const Four zero{}, under = low - x, above = x - high, most = under > above ? under : above;
  beside = most > zero ? most : zero;
}

/// Calls `visit(n, value)` for the points (N, 3) whose value is below `threshold` until it returns true; whether it did.
template <class Visit>
bool any_below(Array<const float, any, 3> points, Array<const double, any, 4> balls, Transform group_from_points,
               const FieldGrid& field, double threshold, double seal, Visit&& visit) {
  const double* m = group_from_points.data();
  double ends[3];
  for (std::size_t axis = 0; axis < 3; ++axis) ends[axis] = static_cast<double>(field.values.size(axis)) * field.step;
  for (Index b = 0; b < balls.size(); ++b) {
    const double x = balls(b, 0), y = balls(b, 1), z = balls(b, 2), r = balls(b, 3);
    const double u = m[0] * x + m[1] * y + m[2] * z + m[3] - field.origin[0];
    const double v = m[4] * x + m[5] * y + m[6] * z + m[7] - field.origin[1];
    const double w = m[8] * x + m[9] * y + m[10] * z + m[11] - field.origin[2];
    const bool near = -r < u && u < ends[0] + r && -r < v && v < ends[1] + r && -r < w && w < ends[2] + r;
    if (field.outside_m >= threshold && !near) continue;
    // Clearance changes by no more than the way there: a ball whose centre is clear enough has no point below, nor one behind
    // a gap that counts as closed.
    const double centre = interpolate(x, y, z, m, field, -std::numeric_limits<double>::infinity()) * field.quantum_m;
    if (centre - field.step - r >= std::max(threshold, seal)) continue;
    for (Index n = b * run; n < std::min((b + 1) * run, points.size()); ++n) {
      const double px = points(n, 0), py = points(n, 1), pz = points(n, 2);
      const double value = field.quantum_m * interpolate(px, py, pz, m, field, field.outside_m / field.quantum_m);
      if (value < threshold && visit(n, value)) return true;
    }
  }
  return false;
}

constexpr double tiny = 1e-30;
/// The rectangle in a triangle's plane that is closest around it: the directions of its sides, and their extents from a, m.
///
/// slack: m2 by which squared distances to it, and to the triangle, may be rounded; without bounds for a sliver, whose are not
/// exact.
struct Rectangle {
  double u[3], v[3], u_low, u_high, v_low, v_high, slack;
};

/// size: twice the area of the triangle.
Rectangle rectangle_around(const double* a, const double* b, const double* c, double size) {
  Rectangle r{};
  double along[3] = {}, square = 0.0;  // of the longest side
  for (const auto& [from, to] : {std::pair{a, b}, std::pair{b, c}, std::pair{c, a}}) {
    const double side[3] = {to[0] - from[0], to[1] - from[1], to[2] - from[2]};
    const double own = side[0] * side[0] + side[1] * side[1] + side[2] * side[2];
    if (own > square) square = own, std::copy_n(side, 3, along);
  }
  r.slack = 1e-10;
  if (!(size > 1e-3 * square)) {
    r.slack = std::numeric_limits<double>::infinity();
    return r;
  }
  const double length = std::sqrt(square);
  double n[3];
  for (int i = 0; i < 3; ++i) {
    const int j = (i + 1) % 3, k = (i + 2) % 3;
    n[i] = ((b[j] - a[j]) * (c[k] - a[k]) - (b[k] - a[k]) * (c[j] - a[j])) / size;
    r.u[i] = along[i] / length;
  }
  for (int i = 0; i < 3; ++i) {
    const int j = (i + 1) % 3, k = (i + 2) % 3;
    r.v[i] = n[j] * r.u[k] - n[k] * r.u[j];
  }
  for (const double* corner : {b, c}) {
    double u = 0.0, v = 0.0;
    for (int i = 0; i < 3; ++i) u += r.u[i] * (corner[i] - a[i]), v += r.v[i] * (corner[i] - a[i]);
    r.u_low = std::min(r.u_low, u), r.u_high = std::max(r.u_high, u);
    r.v_low = std::min(r.v_low, v), r.v_high = std::max(r.v_high, v);
  }
  return r;
}

Index ceiled(double x) { return static_cast<Index>(std::ceil(x)); }
Index floored(double x) { return static_cast<Index>(std::floor(x)); }

}  // namespace

void splat(Corners corners, Vector origin, double step, double below, double above, Array<float, any, any, any> distance) {
  const double reach = std::max(below, above), within = reach * reach;
  for (Index t = 0; t < corners.size(); ++t) {
    const double *a = &corners(t, 0, 0), *p = a + 3, *q = a + 6;
    const double bx = p[0] - a[0], by = p[1] - a[1], bz = p[2] - a[2], cx = q[0] - a[0], cy = q[1] - a[1], cz = q[2] - a[2];
    Index low[3], high[3];
    for (int axis = 0; axis < 3; ++axis) {
      const double least = std::min({a[axis], p[axis], q[axis]}), most = std::max({a[axis], p[axis], q[axis]});
      low[axis] = std::max(ceiled((least - reach - origin[axis]) / step), Index{0});
      high[axis] = std::min(floored((most + reach - origin[axis]) / step), distance.size(static_cast<std::size_t>(axis)) - 1);
    }
    const double bb = bx * bx + by * by + bz * bz, bc = bx * cx + by * cy + bz * cz, cc = cx * cx + cy * cy + cz * cz;
    const double nx = by * cz - bz * cy, ny = bz * cx - bx * cz, nz = bx * cy - by * cx;
    const double nn = nx * nx + ny * ny + nz * nz;
    const double size = std::sqrt(nn), per_area = nn > 0.0 ? 1.0 / nn : 0.0;
    const double ee = bb - 2.0 * bc + cc, per_bb = 1.0 / std::max(bb, tiny), per_cc = 1.0 / std::max(cc, tiny),
                 per_ee = 1.0 / std::max(ee, tiny);
    const std::int64_t has_area = nn > 1e-12 * bb * cc ? -1 : 0;
    const Rectangle around = rectangle_around(a, p, q, size);
    const double lowest = -below * size, highest = above * size, rise = nz * step;
    for (Index i = low[0]; i <= high[0]; ++i) {
      const double x = origin[0] + static_cast<double>(i) * step - a[0];
      for (Index j = low[1]; j <= high[1]; ++j) {
        const double y = origin[1] + static_cast<double>(j) * step - a[1], z0 = origin[2] - a[2];
        // The nodes of this column between the planes at `below` and `above`.
        const double over = nx * x + ny * y + nz * z0;
        Index first = low[2], last = high[2];
        if (std::fabs(rise) > 1e-9 * step * size) {
          const double one = (lowest - over) / rise, two = (highest - over) / rise;
          first = std::max(first, ceiled(std::min(one, two)));
          last = std::min(last, floored(std::max(one, two)));
        } else if (!(lowest <= over && over <= highest)) {
          continue;
        }
        if (first > last) continue;
        float* column = &distance(i, j, 0);
        const int from = static_cast<int>(first), to = static_cast<int>(last);
        const double u0 = around.u[0] * x + around.u[1] * y + around.u[2] * z0, u_rise = around.u[2] * step;
        const double v0 = around.v[0] * x + around.v[1] * y + around.v[2] * z0, v_rise = around.v[2] * step;
        for (int start = from; start <= to; start += 4) {
          const int count = std::min(4, to + 1 - start);
          float near[4] = {-1.0f, -1.0f, -1.0f, -1.0f};
          if (count == 4) {
            std::copy_n(column + start, 4, near);
          } else {
            std::copy_n(column + start, count, near);
          }
          const Four own{near[0], near[1], near[2], near[3]};
          const double k0 = start;
          const Four k{k0, k0 + 1.0, k0 + 2.0, k0 + 3.0}, height = over + k * rise;
          // Only where the rectangle around the triangle is nearer than what was found may the triangle be.
          Four beside_u, beside_v;
          outside_of(around.u_low, around.u_high, u0 + k * u_rise, beside_u);
          outside_of(around.v_low, around.v_high, v0 + k * v_rise, beside_v);
          const Four plane = height * height * per_area;
          const Four least = plane + beside_u * beside_u + beside_v * beside_v - around.slack;
          const auto open = (least < own) & (least <= within);
          if (!(open[0] | open[1] | open[2] | open[3])) continue;
          const Four z = z0 + k * step;
          const Four d1 = bx * x + by * y + bz * z, d2 = cx * x + cy * y + cz * z, pp = x * x + y * y + z * z;
          const Four d3 = d1 - bb, d4 = d2 - bc, d5 = d1 - bc, d6 = d2 - cc;
          Four on_b, on_c, on_e;
          to_segment(d1, bb, per_bb, on_b);
          to_segment(d2, cc, per_cc, on_c);
          to_segment(d4 - d3, ee, per_ee, on_e);
          const Four from_a = pp - (on_b > on_c ? on_b : on_c), from_b = pp - 2.0 * d1 + bb - on_e;
          const Four aside = from_a < from_b ? from_a : from_b;
          const auto over_it = has_area & (d1 * d4 >= d3 * d2) & (d5 * d2 >= d1 * d6) & (d3 * d6 >= d5 * d4);
          const Four square = over_it ? plane : aside;
          const FourFloats found = __builtin_convertvector(square > Four{} ? square : Four{}, FourFloats);
          const auto nearer = (square <= within) & (__builtin_convertvector(found, Four) < own);
          for (int n = 0; n < count; ++n) column[start + n] = nearer[n] ? found[n] : near[n];
        }
      }
    }
  }
}

void fill(Array<float, any, any, any> values, Array<const bool, any, any, any> exact, double step, double band) {
  const Index ni = values.size(0), nj = values.size(1), nk = values.size(2);
  const float one = static_cast<float>(step), two = static_cast<float>(step * std::sqrt(2.0));
  const float three = static_cast<float>(step * std::sqrt(3.0));
  std::vector<float> best(static_cast<std::size_t>(nk));
  for (const Index direction : {Index{1}, Index{-1}}) {
    for (Index row = 0; row < ni * nj; ++row) {
      const Index at = direction > 0 ? row : ni * nj - 1 - row, i = at / nj, j = at % nj;
      std::fill(best.begin(), best.end(), static_cast<float>(band));
      const Index before = i - direction;
      if (0 <= before && before < ni) {
        for (Index beside = std::max(j - 1, Index{0}); beside < std::min(j + 2, nj); ++beside) {
          const bool across = beside == j;
          lower_to_row(&values(before, beside, 0), nk, across ? one : two, across ? two : three, best.data());
        }
      }
      if (0 <= j - direction && j - direction < nj) lower_to_row(&values(i, j - direction, 0), nk, one, two, best.data());
      float previous = static_cast<float>(band);
      for (Index n = 0; n < nk; ++n) {
        const Index k = direction > 0 ? n : nk - 1 - n;
        const float own = values(i, j, k);
        if (exact(i, j, k) && own <= 0.0f) {
          previous = -own;
        } else {
          previous = std::min({std::fabs(own), best[static_cast<std::size_t>(k)], previous + one});
          values(i, j, k) = std::copysign(previous, own);
        }
      }
    }
  }
}

void winding_at_nodes(Corners corners, Vector origin, double step, Array<std::int8_t, any, any, any> winding) {
  const Index ni = winding.size(0), nj = winding.size(1), nk = winding.size(2);
  for (Index t = 0; t < corners.size(); ++t) {
    const double *a = &corners(t, 0, 0), *b = a + 3, *c = a + 6;
    const Index i0 = std::max(ceiled((std::min({a[0], b[0], c[0]}) - origin[0]) / step), Index{0});
    const Index i1 = std::min(floored((std::max({a[0], b[0], c[0]}) - origin[0]) / step), ni - 1);
    const Index j0 = std::max(ceiled((std::min({a[1], b[1], c[1]}) - origin[1]) / step), Index{0});
    const Index j1 = std::min(floored((std::max({a[1], b[1], c[1]}) - origin[1]) / step), nj - 1);
    for (Index i = i0; i <= i1; ++i) {
      for (Index j = j0; j <= j1; ++j) {
        const double px = origin[0] + static_cast<double>(i) * step, py = origin[1] + static_cast<double>(j) * step;
        const int sense = crossing(px, py, a, b, c);
        if (sense == 0) continue;
        const Index top = std::min(floored((height_over(px, py, a, b, c) - origin[2]) / step), nk - 1);
        if (top >= 0) winding(i, j, top) = static_cast<std::int8_t>(winding(i, j, top) + sense);
      }
    }
  }
  for (Index i = 0; i < ni; ++i) {
    for (Index j = 0; j < nj; ++j) {
      for (Index k = nk - 2; k >= 0; --k) winding(i, j, k) = static_cast<std::int8_t>(winding(i, j, k) + winding(i, j, k + 1));
    }
  }
}

void merge_part(Array<const float, any, any, any> distance, Levels winding, bool closed, Cells offset, double give, double above,
                Array<float, any, any, any> values, Array<bool, any, any, any> exact) {
  const double farthest = (above * above) * (1.0 + 1e-6);  // distances are rounded to float32
  constexpr double infinite = std::numeric_limits<double>::infinity();
  for (Index i = 0; i < distance.size(0); ++i) {
    for (Index j = 0; j < distance.size(1); ++j) {
      const float* squares = &distance(i, j, 0);
      const std::int8_t* turns = closed ? &winding(i, j, 0) : nullptr;
      float* own = &values(i + offset[0], j + offset[1], offset[2]);
      bool* known = &exact(i + offset[0], j + offset[1], offset[2]);
      for (Index k = 0; k < distance.size(2); ++k) {
        const bool inside = closed && turns[k] > 0;
        const float square = squares[k];
        const bool measured = static_cast<double>(square) < (inside || !closed ? infinite : farthest);
        if (!measured && !inside) continue;
        const float d = std::sqrt(square);
        const double value = static_cast<double>(inside ? -d : d) + give;
        if (value < static_cast<double>(own[k])) {
          own[k] = static_cast<float>(value);
          known[k] = measured;
        }
      }
    }
  }
}

void bit_rows(Array<const float, any, any, any> values, double level, Words bits) {
  const Index nk = values.size(2);
  for (Index i = 0; i < values.size(0); ++i) {
    for (Index j = 0; j < values.size(1); ++j) {
      for (Index w = 0; w < bits.size(2); ++w) {
        std::uint64_t word = 0;
        for (Index k = 64 * w; k < std::min(64 * w + 64, nk); ++k) {
          word |= static_cast<std::uint64_t>(static_cast<double>(values(i, j, k)) >= level) << (k - 64 * w);
        }
        bits(i, j, w) = word;
      }
    }
  }
}

bool flood(Array<const std::uint64_t, any, any, any> clear, Array<const std::int64_t, any, 3> seeds, Index nk, Words reached) {
  const Index ni = clear.size(0), nj = clear.size(1), words = clear.size(2);
  std::fill_n(reached.data(), reached.count(), 0);
  std::vector<Index> queue(static_cast<std::size_t>(ni * nj));
  std::vector<char> queued(queue.size(), 0);
  Index head = 0, waiting = 0;
  auto enqueue = [&](Index row) {
    if (queued[static_cast<std::size_t>(row)]) return;
    queued[static_cast<std::size_t>(row)] = 1;
    queue[static_cast<std::size_t>((head + waiting) % (ni * nj))] = row;
    ++waiting;
  };
  for (Index s = 0; s < seeds.size(); ++s) {
    const Index i = seeds(s, 0), j = seeds(s, 1), k = seeds(s, 2);
    if (0 <= i && i < ni && 0 <= j && j < nj && 0 <= k && k < nk) {
      reached(i, j, k / 64) |= clear(i, j, k / 64) & (std::uint64_t{1} << (k % 64));
      enqueue(i * nj + j);
    }
  }
  bool open_border = false;
  while (waiting > 0) {
    const Index row = queue[static_cast<std::size_t>(head)];
    head = (head + 1) % (ni * nj);
    --waiting;
    queued[static_cast<std::size_t>(row)] = 0;
    const Index i = row / nj, j = row % nj;
    std::uint64_t* own = &reached(i, j, 0);
    const std::uint64_t* free = &clear(i, j, 0);
    for (Index n = 0; n < 2 * words; ++n) {
      const Index w = n < words ? n : 2 * words - 1 - n;
      std::uint64_t seed = own[w];
      if (w > 0) seed |= free[w] & (own[w - 1] >> 63);
      if (w < words - 1) seed |= free[w] & (own[w + 1] << 63);
      own[w] = spread_along(seed, free[w]);
    }
    open_border |= i == 0 || j == 0 || i == ni - 1 || j == nj - 1;
    open_border |= (own[0] & 1) != 0 || (own[words - 1] >> ((nk - 1) % 64)) != 0;
    for (int way = 0; way < 4; ++way) {
      const Index a = i + (way == 0) - (way == 1), b = j + (way == 2) - (way == 3);
      if (a < 0 || a >= ni || b < 0 || b >= nj) continue;
      bool grown = false;
      for (Index w = 0; w < words; ++w) {
        const std::uint64_t more = own[w] & clear(a, b, w) & ~reached(a, b, w);
        reached(a, b, w) |= more;
        grown |= more != 0;
      }
      if (grown) enqueue(a * nj + b);
    }
  }
  return open_border;
}

void shut_off(Array<float, any, any, any> values, Array<const std::uint64_t, any, any, any> reached, double level) {
  for (Index i = 0; i < values.size(0); ++i) {
    for (Index j = 0; j < values.size(1); ++j) {
      for (Index k = 0; k < values.size(2); ++k) {
        const bool far = !((reached(i, j, k / 64) >> (k % 64)) & 1);
        if (far && static_cast<double>(values(i, j, k)) >= level) values(i, j, k) = -values(i, j, k);
      }
    }
  }
}

void quantise(Array<const float, any, any, any> values, double quantum, Array<std::int8_t, any, any, any> out) {
  const float per = static_cast<float>(1.0 / quantum);
  for (Index n = 0; n < values.count(); ++n) {
    const float scaled = std::max(std::min(values.data()[n] * per, 127.0f), -127.0f);
    out.data()[n] = static_cast<std::int8_t>(std::floor(scaled));
  }
}

template <class T>
void sample(Array<const T, any, 3> points, Transform group_from_vehicle, const FieldGrid& field, Array<double, any> clearance) {
  const double* m = group_from_vehicle.data();
  for (Index n = 0; n < points.size(); ++n) {
    const double x = points(n, 0), y = points(n, 1), z = points(n, 2);
    const double value = interpolate(x, y, z, m, field, field.outside_m / field.quantum_m);
    clearance[n] = std::min(clearance[n], value * field.quantum_m);
  }
}

double clearance_at(const FieldGrid& field, Transform group_from_vehicle, Vec3 point, double enough, Vec3& gradient) {
  gradient = {};
  const double* m = group_from_vehicle.data();
  const double per_step = 1.0 / field.step;
  double at[3];  // in steps of the grid
  Index cell[3];
  for (std::size_t i = 0; i < 3; ++i) {
    const double* row = m + 4 * i;
    at[i] = (row[0] * point.x + row[1] * point.y + row[2] * point.z + row[3] - field.origin[static_cast<Index>(i)]) * per_step;
    if (!(at[i] >= 0.0 && at[i] < static_cast<double>(field.values.size(i) - 1))) return field.outside_m;
    cell[i] = static_cast<Index>(at[i]);
    at[i] -= static_cast<double>(cell[i]);
  }
  const Index row = field.values.size(2), slab = field.values.size(1) * row;
  const std::int8_t* v = &field.values(cell[0], cell[1], cell[2]);
  // Clearance changes by no more than the way there, which from a node is a cell's diagonal at most.
  const double least = v[0] * field.quantum_m - 1.75 * field.step;
  if (least > enough) return least;
  double value = 0.0, slope[3] = {};
  for (int corner = 0; corner < 8; ++corner) {
    const bool up[3] = {(corner & 4) != 0, (corner & 2) != 0, (corner & 1) != 0};
    const double level = v[up[0] * slab + up[1] * row + up[2]];
    double share[3];
    for (int i = 0; i < 3; ++i) share[i] = up[i] ? at[i] : 1.0 - at[i];
    value += share[0] * share[1] * share[2] * level;
    for (int i = 0; i < 3; ++i) slope[i] += (up[i] ? level : -level) * share[(i + 1) % 3] * share[(i + 2) % 3];
  }
  const double scale = field.quantum_m / field.step;
  for (int k = 0; k < 3; ++k) {
    for (int i = 0; i < 3; ++i) gradient[k] += scale * slope[i] * m[4 * i + k];
  }
  return value * field.quantum_m;
}

template <class T>
void balls_of(Array<const T, any, 3> points, Array<double, any, 4> balls) {
  for (Index b = 0; b < balls.size(); ++b) {
    T low[3], high[3];
    for (int axis = 0; axis < 3; ++axis) low[axis] = high[axis] = points(b * run, axis);
    for (Index n = b * run + 1; n < std::min((b + 1) * run, points.size()); ++n) {
      for (int axis = 0; axis < 3; ++axis) {
        const T x = points(n, axis);
        low[axis] = std::min(low[axis], x);
        high[axis] = std::max(high[axis], x);
      }
    }
    const T u = high[0] - low[0], v = high[1] - low[1], w = high[2] - low[2];
    for (int axis = 0; axis < 3; ++axis) balls(b, axis) = static_cast<double>(low[axis] + high[axis]) / 2.0;
    balls(b, 3) = static_cast<double>(std::sqrt(u * u + v * v + w * w)) / 2.0;
  }
}

template void sample(Array<const float, any, 3>, Transform, const FieldGrid&, Array<double, any>);
template void sample(Array<const double, any, 3>, Transform, const FieldGrid&, Array<double, any>);
template void balls_of(Array<const float, any, 3>, Array<double, any, 4>);
template void balls_of(Array<const double, any, 3>, Array<double, any, 4>);

Below points_below(Array<const float, any, 3> points, Array<const double, any, 4> balls, Transform group_from_vehicle,
                   const FieldGrid& field, double threshold, double seal) {
  Below found;
  auto& [index, clearance] = found;
  any_below(points, balls, group_from_vehicle, field, threshold, seal, [&](Index n, double value) {
    index.push_back(n);
    clearance.push_back(value);
    return false;
  });
  return found;
}

bool any_deeper(Array<const float, any, 3> points, Array<const double, any, 4> balls, Transform group_from_points,
                const Felt& group) {
  const double* m = group_from_points.data();
  return any_below(points, balls, group_from_points, group.field, group.threshold, group.seal, [&](Index n, double value) {
    if (value < group.lost) return true;
    const double x = points(n, 0), y = points(n, 1), z = points(n, 2);
    double p[3];
    for (int axis = 0; axis < 3; ++axis) {
      const double* row = m + 4 * axis;
      p[axis] = row[0] * x + row[1] * y + row[2] * z + row[3];
    }
    return std::any_of(group.parts.begin(), group.parts.end(), [&](const Yielding& part) {
      for (int axis = 0; axis < 3; ++axis) {
        if (p[axis] <= part.low[axis] || p[axis] >= part.high[axis]) return false;
      }
      // What is nearer than allowed to a closed part is not too deep, on whichever side; to a sheet, near is deep.
      const double enough = part.mesh.closed ? part.allowed : 0.0;
      return part.shell - signed_distance_to(p, part.radius, enough, part.mesh) > part.allowed;
    });
  });
}

}  // namespace cabinpose

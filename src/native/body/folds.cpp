#include "body/folds.hpp"

#include <algorithm>
#include <vector>

#include "core/vector_math.hpp"

namespace cabinpose {

namespace {

constexpr Index block = 128;      // vertices that are worked on together
constexpr double weakest = 0.01;  // strength of a train below which it is left out
constexpr double sway = 2.0;      // rad that noise bends a train by: more makes waves shorter than the mesh shows

/// Smooth step from 0 to 1 about `edge`.
double step(double x, double edge, double width) {
  const double t = std::min(std::max((x - edge) / width + 0.5, 0.0), 1.0);
  return t * t * (3.0 - 2.0 * t);
}

}  // namespace

void fill_noise(Array<const double, any, 3> points, Array<const std::int64_t, any> where, Array<const double, any, any, 3> waves,
                Array<const double, any, any> phases, const Blend& blend, Array<double, any, any> out) {
  const Index fields = waves.size(), each = waves.size(1), count = points.size();
  std::fill_n(out.data(), count * fields, 0.0);
  double x[block], y[block], z[block], total[block];
  for (Index first = 0; first < where.size(); first += block) {
    const Index many = std::min(block, where.size() - first);
    for (Index i = 0; i < many; ++i) {
      const double* p = &points(where[first + i], 0);
      x[i] = p[0], y[i] = p[1], z[i] = p[2];
    }
    for (Index f = 0; f < fields; ++f) {
      std::fill_n(total, many, 0.0);
      for (Index k = 0; k < each; ++k) {
        const double wx = waves(f, k, 0), wy = waves(f, k, 1), wz = waves(f, k, 2), phase = phases(f, k);
        for (Index i = 0; i < many; ++i) total[i] += loops::sin(x[i] * wx + y[i] * wy + z[i] * wz + phase);
      }
      for (Index i = 0; i < many; ++i) out(where[first + i], f) = total[i] / (0.5 * static_cast<double>(each));
    }
  }
  for (Index v = 0; v + 1 < blend.start.size(); ++v) {
    double* to = &out(count + v, 0);
    std::fill_n(to, fields, 0.0);
    for (Index k = blend.start[v]; k < blend.start[v + 1]; ++k) {
      const double w = static_cast<double>(blend.weight[k]), *from = &out(blend.parent[k], 0);
      for (Index f = 0; f < fields; ++f) to[f] += w * from[f];
    }
  }
}

void raise_folds(const Trains& trains, Array<const double, any, any> noise, Array<const std::int64_t, any> where,
                 Array<double, any> out) {
  const Index count = trains.phase.size();
  double height[block], angle[block], wave[block];
  Index chosen[block];
  for (Index first = 0; first < where.size(); first += block) {
    const Index many = std::min(block, where.size() - first);
    std::fill_n(height, many, 0.0);
    for (Index k = 0; k < count; ++k) {
      const double length = trains.length[k], start = trains.start[k];
      Index found = 0;
      for (Index i = 0; i < many; ++i) {
        const Index v = where[first + i];
        if (!(trains.strength(k, v) > weakest)) continue;
        angle[found] = trains.phase(k, v) * length + start + sway * noise(v, k % 3);
        chosen[found] = i, ++found;
      }
      for (Index i = 0; i < found; ++i) wave[i] = loops::sin(angle[i]);
      for (Index i = 0; i < found; ++i) {
        const Index v = where[first + chosen[i]];
        height[chosen[i]] += trains.strength(k, v) * step(noise(v, 3 + k), 0.05, 0.9) * wave[i];
      }
    }
    for (Index i = 0; i < many; ++i) out[first + i] = 0.4 + 0.4 * tanh(1.4 * height[i]);
  }
}

}  // namespace cabinpose

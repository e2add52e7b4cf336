#include "pose/samples.hpp"

#include <algorithm>
#include <cmath>
#include <limits>

namespace cabinpose {

void Samples::pose(const double* q, const RestArrays& rest, const SampleArrays& arrays, const BoneFrames& skeleton) {
  const std::size_t count = static_cast<std::size_t>(arrays.rest.size());
  points_.resize(count);
  normals_.resize(count);
  for (auto* line : {&x_, &y_, &z_}) line->resize(count);
  constexpr std::size_t main = rig::n_main;
  transforms_.resize(main * 12 + rig::n_bones * 12);
  double* const rotations = transforms_.data();
  double* const positions = rotations + main * 9;
  for (std::size_t b = 0; b < main; ++b) {
    std::copy_n(&skeleton.at[b].rotation.m[0][0], 9, rotations + 9 * b);
    std::copy_n(&skeleton.at[b].position.x, 3, positions + 3 * b);
  }
  double* const moved = positions + main * 3;
  skin_transforms(Posture(q), rest, Rotations(rotations), Positions(positions), SkinTransforms(moved));
  const Index bones = arrays.index.size(1);
  for (Index n = 0; n < arrays.rest.size(); ++n) {
    double blend[12] = {};
    for (Index k = 0; k < bones; ++k) {
      const double w = static_cast<double>(arrays.weight(n, k));
      if (w == 0.0) break;  // strongest first
      const double* t = moved + 12 * arrays.index(n, k);
      for (int i = 0; i < 12; ++i) blend[i] += w * t[i];
    }
    const double *r = &arrays.rest(n, 0), *m = &arrays.normal(n, 0);
    Vec3 p, out;
    for (int i = 0; i < 3; ++i) {
      const double* row = blend + 4 * i;
      p[i] = row[0] * r[0] + row[1] * r[1] + row[2] * r[2] + row[3];
      out[i] = row[0] * m[0] + row[1] * m[1] + row[2] * m[2];
    }
    const std::size_t at = static_cast<std::size_t>(n);
    points_[at] = p;
    normals_[at] = (1.0 / std::max(norm(out), 1e-12)) * out;
    x_[at] = static_cast<float>(p.x);
    y_[at] = static_cast<float>(p.y);
    z_[at] = static_cast<float>(p.z);
  }
  for (Index s = 0; s < arrays.rows.size(); ++s) {
    const Index first = arrays.rows(s, 0), end = arrays.rows(s, 1);
    Vec3 low = point(first), high = low;
    for (Index n = first; n < end; ++n) {
      for (int i = 0; i < 3; ++i) {
        low[i] = std::min(low[i], point(n)[i]);
        high[i] = std::max(high[i], point(n)[i]);
      }
    }
    const Vec3 centre = 0.5 * (low + high);
    double radius = 0.0;
    for (Index n = first; n < end; ++n) {
      const Vec3 away = point(n) - centre;
      radius = std::max(radius, dot(away, away));
    }
    balls_[s] = {centre, std::sqrt(radius)};
  }
}

std::pair<Index, double> Samples::nearest(Vec3 p, Index first, Index end) const {
  // Lane by lane, so that the compiler can do eight at once; of equals the first counts.
  constexpr int lanes = 8;
  float best[lanes], second[lanes];
  std::int32_t which[lanes];
  std::fill_n(best, lanes, std::numeric_limits<float>::infinity());
  std::fill_n(second, lanes, std::numeric_limits<float>::infinity());
  std::fill_n(which, lanes, static_cast<std::int32_t>(first));
  const float px = static_cast<float>(p.x), py = static_cast<float>(p.y), pz = static_cast<float>(p.z);
  const float *x = x_.data(), *y = y_.data(), *z = z_.data();
  auto look = [&](Index n, int l) {
    const float u = x[n] - px, v = y[n] - py, w = z[n] - pz, d = u * u + v * v + w * w;
    const bool nearer = d < best[l];
    const float farther = nearer ? best[l] : d;
    second[l] = farther < second[l] ? farther : second[l];
    best[l] = nearer ? d : best[l];
    which[l] = nearer ? static_cast<std::int32_t>(n) : which[l];
  };
  Index n = first;
  for (; n + lanes <= end; n += lanes) {
    for (int l = 0; l < lanes; ++l) look(n + l, l);
  }
  for (; n < end; ++n) look(n, 0);
  int least = 0;
  for (int l = 1; l < lanes; ++l) {
    if (best[l] < best[least] || (best[l] == best[least] && which[l] < which[least])) least = l;
  }
  float next = second[least];
  for (int l = 0; l < lanes; ++l) {
    if (l != least) next = std::min(next, best[l]);
  }
  return {which[least], 0.5 * (std::sqrt(static_cast<double>(next)) - std::sqrt(static_cast<double>(best[least])))};
}

}  // namespace cabinpose

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
  if (reach_.empty()) reach_.assign(arrays.reach.data(), arrays.reach.data() + count);
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
  const Index bones = arrays.skin_index.size(1);
  for (Index n = 0; n < arrays.rest.size(); ++n) {
    double blend[12] = {};
    for (Index k = 0; k < bones; ++k) {
      const double w = static_cast<double>(arrays.skin_weight(n, k));
      if (w == 0.0) break;  // strongest first
      const double* t = moved + 12 * arrays.skin_index(n, k);
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

Nearest Samples::nearest(Vec3 p, const SampleArrays& arrays, Index solid, double near) const {
  constexpr int lanes = 8, most = 64;  // first samples of a solid; lane by lane, so that the compiler can do eight at once
  constexpr float far = std::numeric_limits<float>::infinity();
  const Index first = arrays.rows(solid, 0);
  const int count = std::min(static_cast<int>(arrays.first_end(solid) - first), most);
  const float px = static_cast<float>(p.x), py = static_cast<float>(p.y), pz = static_cast<float>(p.z);
  const float *x = x_.data(), *y = y_.data(), *z = z_.data();
  auto distance = [&](Index n) {
    const float u = x[n] - px, v = y[n] - py, w = z[n] - pz;
    return std::sqrt(u * u + v * v + w * w);
  };
  float to_first[most], at_least[most];
  for (int h = 0; h < count; ++h) to_first[h] = distance(first + h);
  for (int h = 0; h < count; ++h) at_least[h] = to_first[h] - reach_[static_cast<std::size_t>(first + h)];
  const int padded = (count + lanes - 1) / lanes * lanes;
  for (int h = count; h < padded; ++h) to_first[h] = at_least[h] = far;
  float least[lanes], closest[lanes];
  std::fill_n(least, lanes, far);
  std::fill_n(closest, lanes, far);
  for (int h = 0; h < padded; h += lanes) {
    for (int l = 0; l < lanes; ++l) {
      least[l] = at_least[h + l] < least[l] ? at_least[h + l] : least[l];
      closest[l] = to_first[h + l] < closest[l] ? to_first[h + l] : closest[l];
    }
  }
  const float away = *std::min_element(least, least + lanes);
  if (static_cast<double>(away) > near) return {-1, static_cast<double>(away), 0.0};
  float best = *std::min_element(closest, closest + lanes), second = far;
  Index sample = -1;
  for (int h = 0; h < count; ++h) {
    if (at_least[h] > best) {
      second = std::min(second, at_least[h]);
      continue;
    }
    auto look = [&](Index n, float d) {
      if (d < best || (d == best && sample < 0)) {
        if (sample >= 0) second = std::min(second, best);
        best = d;
        sample = n;
      } else {
        second = std::min(second, d);
      }
    };
    look(first + h, to_first[h]);
    for (Index n = arrays.around(first + h, 0); n < arrays.around(first + h, 1); ++n) look(n, distance(n));
  }
  return {sample, static_cast<double>(away), 0.5 * std::max(0.0, static_cast<double>(second) - static_cast<double>(best))};
}

}  // namespace cabinpose

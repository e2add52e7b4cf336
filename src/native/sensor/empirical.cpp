#include "sensor/empirical.hpp"

#include <algorithm>
#include <cmath>
#include <limits>
#include <vector>

namespace cabinpose {

namespace {

constexpr float nan = std::numeric_limits<float>::quiet_NaN(), infinity = std::numeric_limits<float>::infinity();

/// Elements of four rows or columns around a pixel, clamped to the image.
struct Around {
  Index left, right, up, down;  // offsets of flat indices
};

/// Calls f(first, last, around) for stretches of row v whose pixels have the same neighbours `reach` away, seen from themselves.
template <class F>
void for_stretches(Index v, Index height, Index width, Index reach, F f) {
  const Index up = (std::max<Index>(v - reach, 0) - v) * width, down = (std::min(v + reach, height - 1) - v) * width;
  const Index inner = std::min(reach, width), outer = std::max(inner, width - reach);
  const auto clamped = [&](Index u) {
    f(u, u + 1, Around{std::max<Index>(u - reach, 0) - u, std::min(u + reach, width - 1) - u, up, down});
  };
  for (Index u = 0; u < inner; ++u) clamped(u);
  if (inner < outer) f(inner, outer, Around{-reach, reach, up, down});
  for (Index u = outer; u < width; ++u) clamped(u);
}

/// Equation 5.5 for a row, with the noise of abrupt edges added in quadrature; NaN, and infinite sigma, where there is no depth.
void perturb(const float* depth, const float* normals, const Empirical& camera, Index v, Index height, Index width, float* noisy,
             float* sigma) {
  const double a = camera.a, b = camera.b, c = camera.c, threshold = camera.edge_threshold;
  const double edge_variance = camera.edge_sigma * camera.edge_sigma;
  for_stretches(v, height, width, camera.reach, [=](Index first, Index last, Around to) {
    const float* __restrict z_of = depth + v * width;
    float* __restrict noisy_of = noisy + v * width;
    float* __restrict sigma_of = sigma + v * width;
    for (Index u = first; u < last; ++u) {
      const float* at = z_of + u;
      const double z = static_cast<double>(*at);
      const double smooth = a + b * z + c * z * z;
      const float across = std::fabs(at[to.right] - at[to.left]), along = std::fabs(at[to.down] - at[to.up]);
      const bool edge = static_cast<double>(across > along ? across : along) > threshold;
      const double value = edge ? std::sqrt(smooth * smooth + edge_variance) : smooth;
      const bool seen = z > 0.0;
      sigma_of[u] = seen ? static_cast<float>(value) : infinity;
      noisy_of[u] = seen ? static_cast<float>(z + value * static_cast<double>(normals[u])) : nan;
    }
  });
}

/// Equation 5.6 for a row, read as: a pixel before all of its neighbours, or behind all of them, by the threshold is taken out.
void remove_spikes(const float* noisy, const float* depth, double threshold, Index reach, Index v, Index height, Index width,
                   float* __restrict result) {
  for_stretches(v, height, width, reach, [=](Index first, Index last, Around to) {
    const Index offsets[4] = {to.left, to.right, to.up, to.down};
    for (Index u = first; u < last; ++u) {
      const float* at = noisy + v * width + u;
      const float* depth_at = depth + v * width + u;
      const double z = static_cast<double>(*at);
      bool before = true, behind = true;
      for (const Index k : offsets) {
        const double neighbour = static_cast<double>(at[k]);
        const bool missing = !(depth_at[k] > 0.0f);
        before &= missing | (z < neighbour - threshold);
        behind &= missing | (z > neighbour + threshold);
      }
      result[u] = (before | behind) ? nan : *at;
    }
  });
}

}  // namespace

void simulate_empirical(const View& view, const Empirical& camera, Array<const std::uint16_t, any, any> ranks,
                        Array<const float, 65536> quantiles, const Delivered& out) {
  const Index height = view.depth.size(0), width = view.depth.size(1), n = height * width;
  thread_local std::vector<float> memory;
  memory.resize(static_cast<std::size_t>(3 * n + width));
  float *depth = memory.data(), *noisy = depth + n, *sigma = noisy + n, *normals = sigma + n;
  depth_of_one_surface(view, depth);
  const std::uint8_t* material = view.material.data();
  const float* table = camera.table.data();
  if (camera.glass) {
    for (Index i = 0; i < n; ++i) depth[i] = table[3 * material[i] + 1] > 0.0f ? 0.0f : depth[i];
  }
  for (Index v = 0; v < height; ++v) {
    const std::uint16_t* rank = ranks[v].data();
    for (Index u = 0; u < width; ++u) normals[u] = quantiles(rank[u]);
    perturb(depth, normals, camera, v, height, width, noisy, sigma);
  }
  const float near = static_cast<float>(camera.near), far = static_cast<float>(camera.far);
  for (Index v = 0; v < height; ++v) {
    float* result = out.depth[v].data();
    if (camera.remove_spikes) {
      remove_spikes(noisy, depth, camera.edge_threshold, camera.reach, v, height, width, result);
    } else {
      std::copy_n(noisy + v * width, width, result);
    }
    const bool* field = camera.field[v].data();
    for (Index u = 0; u < width; ++u) result[u] = field[u] & !(result[u] < near) & !(result[u] > far) ? result[u] : nan;
  }
  geometric_amplitude(depth, view, camera.range_over_depth.data(), camera.amplitude_scale.data(), table, out.amplitude.data());
  deliver_sigma(sigma, out);
}

}  // namespace cabinpose

// Noise model `empirical`: a measured sigma(z), noise at edges, spikes taken out, circular crop and range window.
#include <algorithm>
#include <cmath>
#include <limits>
#include <utility>
#include <vector>

#include "core/bind.hpp"
#include "sensor/view.hpp"

namespace cabinpose {

/// The effects asked for: `EmpiricalNoise` in scene/sensor/empirical.py, which says what each means.
struct EmpiricalEffects {
  double a_mm, b_mm_per_m, c_mm_per_m2;  // sigma = a + b z + c z^2
  double edge_sigma_mm, edge_threshold_m;
  int edge_width_px;
  bool remove_spikes, glass, range_window, circular_field;

  CABINPOSE_FIELDS(EmpiricalEffects, a_mm, b_mm_per_m, c_mm_per_m2, edge_sigma_mm, edge_threshold_m, edge_width_px, remove_spikes,
                   glass, range_window, circular_field)
};

/// How far a camera sees: `Sensor` in scene/sensor/presets.py.
struct Reach {
  std::pair<double, double> range_m;

  CABINPOSE_FIELDS(Reach, range_m)
};

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
void perturb(const float* depth, const float* normals, const EmpiricalEffects& effects, Index v, Index height, Index width,
             float* noisy, float* sigma) {
  constexpr double mm = 1e-3;
  const double a = effects.a_mm * mm, b = effects.b_mm_per_m * mm, c = effects.c_mm_per_m2 * mm;
  const double threshold = effects.edge_threshold_m, edge_sigma = effects.edge_sigma_mm * mm;
  const double edge_variance = edge_sigma * edge_sigma;
  for_stretches(v, height, width, effects.edge_width_px, [=](Index first, Index last, Around to) {
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

/// One frame. ranks: (H, 4 ceil(W / 4)) random 16-bit numbers, of which a row uses the first W; they rank the standard normal
/// numbers `quantiles`. Source of the equations: Gonçalves (thesis, 2020).
void simulate_empirical(const View& view, const SurfaceOptics& optics, const Reach& sensor, const EmpiricalEffects& effects,
                        Array<const std::uint16_t, any, any> ranks, Array<const float, 65536> quantiles, const Delivered& out) {
  const Index height = view.depth_m.size(0), width = view.depth_m.size(1), n = height * width;
  thread_local std::vector<float> memory;
  memory.resize(static_cast<std::size_t>(3 * n + width));
  float *depth = memory.data(), *noisy = depth + n, *sigma = noisy + n, *normals = sigma + n;
  depth_of_one_surface(view, depth);
  const std::uint8_t* material = view.material.data();
  const bool* panes = optics.panes.data();
  if (effects.glass) {
    for (Index i = 0; i < n; ++i) depth[i] = panes[material[i]] ? 0.0f : depth[i];
  }
  for (Index v = 0; v < height; ++v) {
    const std::uint16_t* rank = ranks[v].data();
    for (Index u = 0; u < width; ++u) normals[u] = quantiles(rank[u]);
    perturb(depth, normals, effects, v, height, width, noisy, sigma);
  }
  const float near = effects.range_window ? static_cast<float>(sensor.range_m.first) : 0.0f;
  const float far = effects.range_window ? static_cast<float>(sensor.range_m.second) : infinity;
  for (Index v = 0; v < height; ++v) {
    float* result = out.depth_m[v].data();
    if (effects.remove_spikes) {
      remove_spikes(noisy, depth, effects.edge_threshold_m, effects.edge_width_px, v, height, width, result);
    } else {
      std::copy_n(noisy + v * width, width, result);
    }
    const bool* field = optics.field[v].data();
    const float* ray = optics.range_over_depth[v].data();
    for (Index u = 0; u < width; ++u) {
      const bool inside = field[u] | (!effects.circular_field & std::isfinite(ray[u]));
      result[u] = inside & !(result[u] < near) & !(result[u] > far) ? result[u] : nan;
    }
  }
  geometric_amplitude(depth, view, optics, out.amplitude.data());
  deliver_sigma(sigma, out);
}

}  // namespace

void bind_empirical(nb::module_& m) {
  describe<EmpiricalEffects, Reach>(m);
  m.def("simulate_empirical", &simulate_empirical, "view"_a, "optics"_a, "sensor"_a, "effects"_a, "ranks"_a, "quantiles"_a,
        "out"_a, unlocked(), "One frame of a camera with measured noise.");
}

}  // namespace cabinpose

// Noise model `structured_light`: depth from a projected dot pattern, as of a Kinect-v1 or Xtion.
#include <algorithm>
#include <cmath>
#include <limits>
#include <utility>
#include <vector>

#include "core/bind.hpp"
#include "core/math.hpp"
#include "sensor/view.hpp"

namespace cabinpose {

/// The effects asked for: `StructuredLightNoise` in scene/sensor/structured_light.py, which says what each means.
struct StructuredLightEffects {
  bool axial;
  double lateral_px;  // of the matcher
  bool quantise;
  double disparity_step_px, min_return;
  bool shadow;
  int fill_px;
  bool range_window;

  CABINPOSE_FIELDS(StructuredLightEffects, axial, lateral_px, quantise, disparity_step_px, min_return, shadow, fill_px,
                   range_window)
};

/// The focal length of the image: `Camera` in core/camera.py.
struct Focal {
  double fx;  // px

  CABINPOSE_FIELDS(Focal, fx)
};

/// The matcher: `Sensor` in scene/sensor/presets.py.
struct Matcher {
  Focal camera;
  double baseline_m, native_scale;
  std::pair<double, double> range_m;

  CABINPOSE_FIELDS(Matcher, camera, baseline_m, native_scale, range_m)
};

namespace {

constexpr float nan = std::numeric_limits<float>::quiet_NaN(), infinity = std::numeric_limits<float>::infinity();

/// Central difference per pixel at element `at` of n depths that lie `stride` apart; 0 at their ends.
double slope(const float* line, Index stride, Index n, Index at) {
  if (at <= 0 || at >= n - 1) return 0.0;
  return (static_cast<double>(line[(at + 1) * stride]) - static_cast<double>(line[(at - 1) * stride])) / 2.0;
}

/// Axial sigma (m) at depth z and cosine of incidence: Nguyen et al. (2012).
double axial_sigma(double z, double cosine) {
  const double angle = acos(std::min(cosine, 1.0)), rest = pi / 2 - angle, beyond = z - 0.4;
  return 0.0012 + 0.0019 * (beyond * beyond) + 0.0001 / std::sqrt(z) * (angle * angle) / (rest * rest);
}

/// What a row of pixels is matched with: surfaces near their centres.
struct Seen {
  std::vector<double> depth, cosine;
  std::vector<float> reflectance;
};

/// Row v: each pixel sees the surface a random step (sigma `lateral`, px) beside its centre. table: by material.
///
/// slots: (H * W) where in `mixed` each pixel is, or -1. A pixel without parts is a smooth surface, continued along its slope.
void look_beside(const View& view, Finishes table, double lateral, const std::uint16_t* ranks, const float* quantiles,
                 const std::int32_t* slots, Index v, Seen& out) {
  const Index height = view.depth_m.size(0), width = view.depth_m.size(1), s = view.supersample;
  const double side = static_cast<double>(s);
  const std::int32_t divisor = view.supersample;
  const float* depth = view.depth_m.data();
  for (Index u = 0; u < width; ++u) {
    const double du = lateral * static_cast<double>(quantiles[ranks[4 * u]]);
    const double dv = lateral * static_cast<double>(quantiles[ranks[4 * u + 1]]);
    const double at_x = (static_cast<double>(u) + 0.5 + du) * side, at_y = (static_cast<double>(v) + 0.5 + dv) * side;
    // Truncated is rounded down, or clamped.
    const auto x = static_cast<std::int32_t>(std::clamp(at_x, 0.0, static_cast<double>(width * s - 1)));
    const auto y = static_cast<std::int32_t>(std::clamp(at_y, 0.0, static_cast<double>(height * s - 1)));
    const Index row = y / divisor, column = x / divisor, pixel = row * width + column, slot = slots[pixel];
    if (slot >= 0) {
      const Index part = slot * s * s + (y - row * s) * s + x - column * s;
      out.depth[u] = static_cast<double>(view.parts_depth_m.data()[part]);
      out.cosine[u] = static_cast<double>(view.parts_cos_incidence.data()[part]);
      out.reflectance[u] = table(view.parts_material.data()[part], 0);
      continue;
    }
    const double beside = (static_cast<double>(x) + 0.5) / side - 0.5 - static_cast<double>(column);
    const double below = (static_cast<double>(y) + 0.5) / side - 0.5 - static_cast<double>(row);
    double z = static_cast<double>(depth[pixel]);
    z += slope(depth + row * width, 1, width, column) * beside;
    z += slope(depth + column, width, height, row) * below;
    out.depth[u] = z;
    out.cosine[u] = static_cast<double>(view.cos_incidence.data()[pixel]);
    out.reflectance[u] = table(view.material.data()[pixel], 0);
  }
}

/// Depth of a row of pixels, each from its own disparity, and its sigma; NaN and infinite where no dot is matched.
///
/// focal_baseline: of the matcher (px m) · grazing_cosine: of incidence, below which the pattern is not matched.
void match(const Seen& seen, const StructuredLightEffects& effects, double focal_baseline, double grazing_cosine,
           const std::uint16_t* ranks, const float* quantiles, Index width, float* __restrict out, float* __restrict sigma_out) {
  const double* __restrict depth = seen.depth.data();
  const double* __restrict cosine = seen.cosine.data();
  const float* __restrict reflectance = seen.reflectance.data();
  const double min_return = effects.min_return;
  const double axial = effects.axial ? 1.0 : 0.0, step = effects.quantise ? effects.disparity_step_px : 0.0;
  for (Index u = 0; u < width; ++u) {
    double z = depth[u];
    const double c = cosine[u];
    // The dots' contrast varies; a third of the threshold makes the border of a hole ragged.
    const double light = static_cast<double>(reflectance[u]) * c / (z * z);
    const double least = min_return * (1.0 + static_cast<double>(quantiles[ranks[4 * u + 3]]) / 3.0);
    const bool matched = (z > 0.0) & !(c < grazing_cosine) & !(light < least);
    const double sigma = axial_sigma(z, c);
    z += axial * (sigma * static_cast<double>(quantiles[ranks[4 * u + 2]]));
    const double disparity = floor_of_small(focal_baseline / z / step + 0.5) * step;
    const double quantised = focal_baseline / disparity;
    z = (step > 0.0) & (z > 0.0) ? (disparity > 0.0 ? quantised : std::numeric_limits<double>::infinity()) : z;
    out[u] = matched ? static_cast<float>(z) : nan;
    sigma_out[u] = matched ? static_cast<float>(sigma) : infinity;
  }
}

/// Takes out of a row what a projector one baseline to the right (camera x) does not see.
///
/// A surface at depth z stands in the projector's image `focal_baseline / z` px left of where the camera has it; from right to
/// left, what does not come out farther left than all before it is hidden behind nearer surfaces.
void cast_shadow(const float* clean, Index width, double focal_baseline, float* out) {
  double leftmost = std::numeric_limits<double>::infinity();
  for (Index u = width - 1; u >= 0; --u) {
    if (!(clean[u] > 0.0f)) continue;
    const double projected = static_cast<double>(u) - focal_baseline / static_cast<double>(clean[u]);
    if (projected < leftmost) {
      leftmost = projected;
    } else {
      out[u] = nan;
    }
  }
}

/// Fills holes of up to `widest` px in a row with the farther of their two ends.
void fill_holes(float* depth, Index width, Index widest) {
  Index start = -1;
  for (Index u = 0; u < width; ++u) {
    if (std::isnan(depth[u])) continue;
    if (start >= 0 && u - start - 1 <= widest) std::fill(depth + start + 1, depth + u, std::max(depth[start], depth[u]));
    start = u;
  }
}

/// One frame. ranks: (H, 4 W) random 16-bit numbers, which rank the standard normal numbers `quantiles`.
void simulate_structured_light(const View& view, const SurfaceOptics& optics, const Matcher& sensor,
                               const StructuredLightEffects& effects, Array<const std::uint16_t, any, any> ranks,
                               Array<const float, 65536> quantiles, const Delivered& out, double grazing_cosine) {
  const Index height = view.depth_m.size(0), width = view.depth_m.size(1), n = height * width;
  thread_local std::vector<float> memory;
  thread_local std::vector<std::int32_t> slots;
  thread_local Seen seen;
  seen.depth.resize(static_cast<std::size_t>(width));
  seen.cosine.resize(static_cast<std::size_t>(width));
  seen.reflectance.resize(static_cast<std::size_t>(width));
  memory.resize(static_cast<std::size_t>(2 * n));
  slots.assign(static_cast<std::size_t>(n), -1);
  float *clean = memory.data(), *sigma = clean + n;
  for (Index k = 0; k < view.mixed.size(); ++k) slots[static_cast<std::size_t>(view.mixed(k))] = static_cast<std::int32_t>(k);
  depth_of_one_surface(view, clean);
  const float near = effects.range_window ? static_cast<float>(sensor.range_m.first) : -infinity;
  const float far = effects.range_window ? static_cast<float>(sensor.range_m.second) : infinity;
  const double lateral = effects.lateral_px / sensor.native_scale;
  const double focal_baseline = sensor.camera.fx * sensor.native_scale * sensor.baseline_m;
  for (Index v = 0; v < height; ++v) {
    float* depth = out.depth_m[v].data();
    look_beside(view, optics.table, lateral, ranks[v].data(), quantiles.data(), slots.data(), v, seen);
    match(seen, effects, focal_baseline, grazing_cosine, ranks[v].data(), quantiles.data(), width, depth, sigma + v * width);
    if (effects.shadow) cast_shadow(clean + v * width, width, sensor.camera.fx * sensor.baseline_m, depth);
    if (effects.fill_px > 0) fill_holes(depth, width, effects.fill_px);
    for (Index u = 0; u < width; ++u) depth[u] = (depth[u] < near) | (depth[u] > far) ? nan : depth[u];
  }
  geometric_amplitude(clean, view, optics, out.amplitude.data());
  deliver_sigma(sigma, out);
}

}  // namespace

void bind_structured_light(nb::module_& m) {
  describe<StructuredLightEffects, Focal, Matcher>(m);
  m.def("simulate_structured_light", &simulate_structured_light, "view"_a, "optics"_a, "sensor"_a, "effects"_a, "ranks"_a,
        "quantiles"_a, "out"_a, "grazing_cosine"_a, unlocked(), "One frame of a camera that matches a projected dot pattern.");
}

}  // namespace cabinpose

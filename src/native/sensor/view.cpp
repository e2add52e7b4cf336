#include "sensor/view.hpp"

#include <algorithm>
#include <cmath>
#include <limits>

namespace cabinpose {

void depth_of_one_surface(const View& view, float* out) {
  constexpr float one_surface = 0.02f;  // parts that differ from the centre by more than this share are of other surfaces
  std::copy_n(view.depth_m.data(), view.depth_m.count(), out);
  const Index count = view.parts_depth_m.size(1);
  for (Index k = 0; k < view.mixed.size(); ++k) {
    const float* parts = view.parts_depth_m.data() + k * count;
    float& depth = out[view.mixed(k)];
    float total = 0.0f;
    bool agree = depth > 0.0f;
    for (Index j = 0; j < count; ++j) {
      total += parts[j];
      agree &= std::fabs(parts[j] - depth) <= one_surface * depth;
    }
    if (agree) depth = total / static_cast<float>(count);
  }
}

void geometric_amplitude(const float* depth, const View& view, const SurfaceOptics& optics, std::uint16_t* __restrict out) {
  const float *range_over_depth = optics.range_over_depth.data(), *scale = optics.amplitude_scale.data();
  const float* table = optics.table.data();
  const float* cosine = view.cos_incidence.data();
  const std::uint8_t* material = view.material.data();
  for (Index i = 0; i < view.depth_m.count(); ++i) {
    const float ray = depth[i] * range_over_depth[i], r = ray > 0.05f ? ray : 0.05f;
    const float amplitude = scale[i] * table[finish_columns * material[i]] * cosine[i] / (r * r);
    const float within = depth[i] > 0.0f && scale[i] > 0.0f ? amplitude : 0.0f;
    out[i] = static_cast<std::uint16_t>(static_cast<std::int32_t>(within < 65535.0f ? within : 65535.0f));
  }
}

void deliver_sigma(const float* sigma, const Delivered& out) {
  const float* depth = out.depth_m.data();
  std::uint8_t* __restrict confidence_out = out.confidence.data();
  float* __restrict noise_out = out.noise_m.data();
  for (Index i = 0; i < out.depth_m.count(); ++i) {
    const float confidence = 255.0f * confidence_sigma / (confidence_sigma + sigma[i]);
    const bool finite = std::fabs(depth[i]) < std::numeric_limits<float>::infinity();
    confidence_out[i] = static_cast<std::uint8_t>(static_cast<std::int32_t>(finite ? confidence : 0.0f));
    noise_out[i] = finite ? sigma[i] : std::numeric_limits<float>::quiet_NaN();
  }
}

}  // namespace cabinpose

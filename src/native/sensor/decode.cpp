#include "sensor/decode.hpp"

#include <cmath>
#include <limits>

#include "sensor/view.hpp"

namespace cabinpose {

void light_of_pixels(const float* signal, float stray, const float* ambient, Index n, float* __restrict total) {
  for (Index u = 0; u < n; ++u) total[u] = signal[u] + stray + ambient[u];
}

void phases_of_row(const float* __restrict total, const float* __restrict in_phase, const float* __restrict quadrature,
                   const float* stray, const Taps& taps, const std::uint16_t* __restrict ranks, const float* __restrict quantiles,
                   float weight, Index n, float* __restrict turns, float* __restrict amplitude, float* __restrict peak) {
  // Twice the content of a tap, and so twice the well and the variance: a factor of two is exact, and one that is not applied
  // costs nothing.
  const float contrast = taps.contrast, shot = taps.shot, variance = 2.0f * taps.read_variance, well = 2.0f * taps.full_well;
  const float stray_x = stray[0], stray_y = stray[1];
  const auto sample = [=](float light, float signal, float normal, float& most) {
    const float difference = contrast * signal;
    const float a = light + difference, b = light - difference;
    const float noisy = (a < well ? a : 0.0f) + (b < well ? b : 0.0f);
    const float higher = b > a ? b : a;
    most = higher > most ? higher : most;
    return ((a < well ? a : well) - (b < well ? b : well)) + std::sqrt(shot * noisy + variance) * normal;
  };
  for (Index u = 0; u < n; ++u) {
    float most = peak[u];
    const float x = sample(total[u], in_phase[u] + stray_x, quantiles[ranks[4 * u]], most);
    const float y = sample(total[u], quadrature[u] + stray_y, quantiles[ranks[4 * u + 1]], most);
    peak[u] = most;
    // atan(q) / (2 pi q) in powers of q^2 for q <= 1, least squares on Chebyshev nodes: error below 1.6e-8 turns
    const float ax = std::fabs(x), ay = std::fabs(y);
    const float low = ay < ax ? ay : ax, high = ay > ax ? ay : ax;
    const float q = low / (high > 1e-30f ? high : 1e-30f);
    const float b = q * q;
    const float p = 0.003940164021947287f + b * -0.0007689043297667616f;
    const float s = -0.022345575062319295f + b * (0.015864443163189378f + b * (-0.00958417188834041f + b * p));
    const float t = q * (0.15915493643847153f + b * (-0.05305000759666022f + b * (0.031789101207354314f + b * s)));
    // Mirrored where it has to be: |0 - t| is t.
    const float octant = std::fabs((ay > ax ? 0.25f : 0.0f) - t);
    const float half = std::fabs((x < 0.0f ? 0.5f : 0.0f) - octant);
    const float whole = std::fabs((y < 0.0f ? 1.0f : 0.0f) - half);
    turns[u] = whole < 1.0f ? whole : 0.0f;
    amplitude[u] += weight * std::sqrt(ax * ax + ay * ay);
  }
}

void unwrap_row(const float* __restrict turns_1, const float* __restrict turns_2, const Unwrapping& unwrapping, Index n,
                float* __restrict range) {
  int inverse_q = 0;
  for (int candidate = 0; candidate < unwrapping.p; ++candidate) {
    if (candidate * unwrapping.q % unwrapping.p == 1) inverse_q = candidate;
  }
  const float p = static_cast<float>(unwrapping.p), q = static_cast<float>(unwrapping.q), inverse = static_cast<float>(inverse_q);
  const float first = unwrapping.weight * unwrapping.wavelength;
  const float second = (1.0f - unwrapping.weight) * unwrapping.wavelength * p / q;
  const float tolerance = unwrapping.tolerance, invalid = std::numeric_limits<float>::quiet_NaN();
  for (Index u = 0; u < n; ++u) {
    const float difference = p * turns_2[u] - q * turns_1[u];
    const float remainder = floor_of_small(difference + 0.5f);
    float n1 = remainder * inverse;
    n1 -= p * floor_of_small(n1 / p);
    const float n2 = (q * n1 - remainder) / p;
    const float r = first * (turns_1[u] + n1) + second * (turns_2[u] + n2);
    range[u] = std::fabs(difference - remainder) <= tolerance ? r : invalid;
  }
}

void unwrap_perfectly(const float* known, float period, Index n, float* __restrict range) {
  for (Index u = 0; u < n; ++u) {
    const float whole = floor_of_small((known[u] - range[u]) / period + 0.5f);
    range[u] = known[u] > 0.0f ? range[u] + period * whole : range[u];
  }
}

void deliver_row(const float* __restrict range, const float* __restrict amplitude, const float* __restrict total,
                 const float* __restrict peak, const float* __restrict gain, const float* __restrict range_over_depth,
                 const Taps& taps, const Limits& limits, Index n, float* __restrict scratch, float* __restrict depth_out,
                 std::uint16_t* __restrict amplitude_out, std::uint8_t* __restrict confidence_out, float* __restrict noise_out) {
  const float shot = taps.shot, read_variance = taps.read_variance, well = 2.0f * taps.full_well;
  const float min_amplitude = limits.min_amplitude, near = limits.near, far = limits.far, sigma_scale = limits.sigma_scale;
  const float invalid = std::numeric_limits<float>::quiet_NaN(), infinite = std::numeric_limits<float>::infinity();
  for (Index u = 0; u < n; ++u) {
    const float a = amplitude[u], z = range[u] / range_over_depth[u];
    const bool valid = (gain[u] > 0.0f) & (peak[u] < well) & (a >= min_amplitude) & (a > 0.0f) & (z >= near) & (z <= far);
    const float sigma = sigma_scale * std::sqrt(shot * total[u] + read_variance);
    depth_out[u] = valid ? z : invalid;
    noise_out[u] = valid ? sigma / (a * range_over_depth[u]) : ((gain[u] > 0.0f) & (peak[u] >= well) ? infinite : invalid);
    scratch[u] = where(valid, (255.0f * confidence_sigma) * a / (confidence_sigma * a + sigma + 1e-30f));
  }
  // Through int, which processors convert several at a time.
  for (Index u = 0; u < n; ++u) confidence_out[u] = static_cast<std::uint8_t>(static_cast<std::int32_t>(scratch[u]));
  for (Index u = 0; u < n; ++u) {
    const float a = amplitude[u] + 0.5f;
    const float most = 65535.0f < a ? 65535.0f : a;
    amplitude_out[u] = static_cast<std::uint16_t>(static_cast<std::int32_t>(gain[u] > 0.0f ? most : 0.0f));
  }
}

}  // namespace cabinpose

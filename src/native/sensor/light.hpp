// Light that reaches the pixels, and its phasors: the first half of the continuous-wave principle, by rows.
//
// One float operation after the other, so that results are the same bytes everywhere. A row is short enough to stay in the
// first cache from one loop to the next.
#pragma once

#include <cmath>

#include "sensor/view.hpp"

namespace cabinpose {

inline constexpr double speed_of_light = 299'792'458.0;  // m/s

/// sin(2 pi a) for |a| <= 1/4, in powers of a^2: least squares on Chebyshev nodes, error below 1e-8.
inline float sine_of_quarter(float a) {
  const float b = a * a;
  return a * (6.283185295f + b * (-41.341685009f + b * (81.602766802f + b * (-76.587869912f + b * 39.809924751f))));
}

/// Cosine and sine of an angle (turns).
inline void cosine_and_sine(float turns, float& cosine, float& sine) {
  const float t = turns - floor_of_small(turns + 0.5f), magnitude = std::fabs(t);  // -1/2 .. 1/2
  cosine = sine_of_quarter(0.25f - magnitude);
  sine = sine_of_quarter(std::copysign(0.25f - std::fabs(magnitude - 0.25f), t));
}

/// Where samples of geometry lie, n of each.
struct Samples {
  const float *depth, *cos_incidence;
  const std::uint8_t* material;
  const float* range_over_depth;  // NaN outside the lens model
};

/// How surfaces return light, relative to a white surface that faces the camera at 1 m.
struct Surfaces {
  Finishes table;
  bool lambert;  // diffuse light returned falls with the cosine of incidence
};

/// Range (m), energy (rho cos / r^2) and ambient light of n samples.
void light_of_samples(const Samples& samples, Index n, const Surfaces& surfaces, float* range, float* energy, float* ambient);

/// Energy x (cos, sin) of the phase of n samples, of a correlation that is part cosine, part `triangle` (0..1).
///
/// per_m: turns of the phase per metre of range, 2 f / c.
void phasors_of_samples(const float* energy, const float* range, Index n, float per_m, double triangle, float* in_phase,
                        float* quadrature);

/// Sets the elements `at` (m,) of a row to the means of their `count` samples.
void means_of_parts(const float* samples, const std::int32_t* at, Index m, Index count, float* row);

/// Blurs a row: each pixel gives `share` of its light to the neighbour on each side; at the ends it keeps what would be lost.
void blur_row(const float* row, Index n, float share, float* out);

/// Blurs across three rows: each gives `share` of its light to the row above and below.
void blur_across(const float* above, const float* here, const float* below, Index n, float share, float* out);

/// The same, times `gain`; returns the sum of the row, added up in eight fixed lanes: fast, and in the same order everywhere.
double blur_and_gain(const float* above, const float* here, const float* below, Index n, float share, const float* gain,
                     float* out);

}  // namespace cabinpose

#include "sensor/light.hpp"

#include <algorithm>
#include <cmath>
#include <cstring>
#include <limits>

namespace cabinpose {

namespace {

constexpr Index finished_at_a_time = 512;  // samples of which all columns of the table stay in the first cache

/// The columns of `table` for n samples.
inline void look_up(const std::uint8_t* material, Index n, const float* table, float* const (&columns)[finish_columns]) {
  for (Index i = 0; i < n; ++i) {
    const float* of = table + finish_columns * material[i];
    for (Index k = 0; k < finish_columns; ++k) columns[k][i] = of[k];
  }
}

constexpr float triangle_peak = static_cast<float>(3.14159265358979323846 * 3.14159265358979323846 / 8);

/// The same of `finished_at_a_time` samples at most.
void light_of_some(const Samples& samples, Index n, const Surfaces& surfaces, float* __restrict range, float* __restrict energy,
                   float* __restrict ambient) {
  const float* __restrict depth = samples.depth;
  const float* __restrict cosine = samples.cos_incidence;
  const float* __restrict factor = samples.range_over_depth;
  const std::uint8_t* __restrict material = samples.material;
  const float* __restrict table = surfaces.table.data();
  const float nothing = table[2];
  const bool lambert = surfaces.lambert;
  alignas(64) float narrowness[finished_at_a_time];
  // Neighbours are mostly of one material. What is looked up is kept for the second loop, which is free of look-ups.
  Index at = 0;
  for (; at + 8 <= n; at += 8) {
    std::uint64_t eight;
    std::memcpy(&eight, material + at, sizeof eight);
    const float* of = table + finish_columns * material[at];
    if (eight == material[at] * 0x0101010101010101u) {
      std::fill_n(range + at, 8, of[0]);
      std::fill_n(energy + at, 8, of[1]);
      std::fill_n(ambient + at, 8, of[2]);
      std::fill_n(narrowness + at, 8, of[3]);
    } else {
      look_up(material + at, 8, table, {range + at, energy + at, ambient + at, narrowness + at});
    }
  }
  look_up(material + at, n - at, table, {range + at, energy + at, ambient + at, narrowness + at});
  for (Index i = 0; i < n; ++i) {
    const float r = depth[i] * factor[i], c = cosine[i];
    const float lobe = 1.0f - (1.0f - c) * narrowness[i];
    const float gloss = lobe > 0.0f ? lobe : 0.0f;
    const bool hit = r > 0.0f;
    const float light = ambient[i];
    energy[i] = where(hit, (range[i] * (lambert ? c : 1.0f) + energy[i] * gloss * gloss) / (r * r));
    ambient[i] = hit ? light : nothing;
    range[i] = where(hit, r);
  }
}

}  // namespace

void light_of_samples(const Samples& samples, Index n, const Surfaces& surfaces, float* range, float* energy, float* ambient) {
  for (Index first = 0; first < n; first += finished_at_a_time) {
    const Samples some{samples.depth + first, samples.cos_incidence + first, samples.material + first,
                       samples.range_over_depth + first};
    light_of_some(some, std::min(finished_at_a_time, n - first), surfaces, range + first, energy + first, ambient + first);
  }
}

void phasors_of_samples(const float* __restrict energy, const float* __restrict range, Index n, float per_m, double triangle,
                        float* __restrict in_phase, float* __restrict quadrature) {
  // The triangle's first harmonic has 8 / pi^2 of its peak.
  const float share = static_cast<float>(triangle) * triangle_peak, keep = static_cast<float>(1.0 - triangle);
  const float four_shares = 4.0f * share;
  for (Index i = 0; i < n; ++i) {
    float t = range[i] * per_m;
    t = t - floor_of_small(t + 0.5f);  // -1/2 .. 1/2
    const float magnitude = std::fabs(t);
    const float fold = std::copysign(0.25f - std::fabs(magnitude - 0.25f), t);
    const float cosine = keep * sine_of_quarter(0.25f - magnitude) + share * (1.0f - 4.0f * magnitude);
    const float sine = keep * sine_of_quarter(fold) + four_shares * fold;
    in_phase[i] = energy[i] * cosine;
    quadrature[i] = energy[i] * sine;
  }
}

void means_of_parts(const float* __restrict samples, const std::int32_t* __restrict at, Index m, Index count,
                    float* __restrict row) {
  const float scale = static_cast<float>(1.0 / static_cast<double>(count));
  if (count == 4) {
    for (Index k = 0; k < m; ++k) {
      const float* part = samples + 4 * k;
      row[at[k]] = ((part[0] + part[1]) + (part[2] + part[3])) * scale;
    }
    return;
  }
  for (Index k = 0; k < m; ++k) {
    float total = 0.0f;
    for (Index j = 0; j < count; ++j) total += samples[count * k + j];
    row[at[k]] = total * scale;
  }
}

void blur_row(const float* __restrict row, Index n, float share, float* __restrict out) {
  const float keep = 1.0f - share - share;
  const Index last = n - 1;
  for (Index u = 1; u < last; ++u) out[u] = keep * row[u] + share * (row[u - 1] + row[u + 1]);
  out[0] = (keep + share) * row[0] + share * row[std::min<Index>(1, last)];
  out[last] = (keep + share) * row[last] + share * row[std::max<Index>(last - 1, 0)];
}

void blur_across(const float* above, const float* here, const float* below, Index n, float share, float* __restrict out) {
  const float keep = 1.0f - share - share;
  for (Index u = 0; u < n; ++u) out[u] = keep * here[u] + share * (above[u] + below[u]);
}

double blur_and_gain(const float* __restrict above, const float* __restrict here, const float* __restrict below, Index n,
                     float share, const float* __restrict gain, float* __restrict out) {
  const float keep = 1.0f - share - share;
  float lanes[8] = {};
  Index u = 0;
  for (; u + 8 <= n; u += 8) {
    for (int k = 0; k < 8; ++k) {
      out[u + k] = gain[u + k] * (keep * here[u + k] + share * (above[u + k] + below[u + k]));
      lanes[k] += out[u + k];
    }
  }
  double total = 0.0;
  for (const float lane : lanes) total += static_cast<double>(lane);
  for (; u < n; ++u) {
    out[u] = gain[u] * (keep * here[u] + share * (above[u] + below[u]));
    total += static_cast<double>(out[u]);
  }
  return total;
}

}  // namespace cabinpose

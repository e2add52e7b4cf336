// Noise model `physical`: a continuous-wave Time-of-Flight camera.
#include <nanobind/stl/vector.h>

#include <algorithm>
#include <cmath>
#include <limits>
#include <type_traits>
#include <utility>
#include <vector>

#include "core/bind.hpp"
#include "core/math.hpp"
#include "sensor/decode.hpp"
#include "sensor/light.hpp"
#include "sensor/scatter.hpp"
#include "sensor/view.hpp"

namespace cabinpose {

/// The effects asked for: `PhysicalNoise` in scene/sensor/physical.py, which says what each means.
struct PhysicalEffects {
  bool shot_noise, read_noise, full_well, flying_pixels;
  double blur;
  bool wrapping, consistency;
  double wiggling, stray_light, lens_scatter, lens_scatter_px;
  bool incidence, low_amplitude;
  double low_amplitude_spread;

  CABINPOSE_FIELDS(PhysicalEffects, shot_noise, read_noise, full_well, flying_pixels, blur, wrapping, consistency, wiggling,
                   stray_light, lens_scatter, lens_scatter_px, incidence, low_amplitude, low_amplitude_spread)
};

/// The pixels of a camera: `Sensor` in scene/sensor/presets.py.
struct Electronics {
  double contrast, read_noise_e, full_well_e, min_amplitude_e;

  CABINPOSE_FIELDS(Electronics, contrast, read_noise_e, full_well_e, min_amplitude_e)
};

/// Lens and light of a camera; images (H, W). `_ContinuousWave` in scene/sensor/physical.py.
struct ContinuousWave {
  Array<const float, any, any> range_over_depth;        // NaN outside the lens model
  Array<const float, any, any> parts_range_over_depth;  // (H * W, n) at the parts of all pixels
  Array<const float, any, any> gain;                    // electrons per unit of energy, 0 outside the field
  Array<const float, any, any> ambient_gain;            // electrons per unit of ambient light
  Finishes table;
  Array<const double, any> frequencies;  // Hz: one, or two
  std::pair<int, int> frequency_ratio;   // p : q of the two
  double near, far;                      // m along the axis
  Array<const float, any, any, any>
      indirect;  // (H, 1 + 2 F, W) energy and (cos, sin) a frequency of indirect light, or (0, ., .)

  CABINPOSE_FIELDS(ContinuousWave, range_over_depth, parts_range_over_depth, gain, ambient_gain, table, frequencies,
                   frequency_ratio, near, far, indirect)
};

namespace {

constexpr Index most_frequencies = 2;
// Of p t2 - q t1 from a whole number, in turns; half a turn is the most there can be, and makes the unwrapping wrong. Phases
// at the sensor's floor are two sigma inside; mixtures of a dim near and a bright far surface may be outside.
constexpr double phase_tolerance = 0.25;
// What is kept of a row of pixels: energy, ambient light, (cos, sin) a frequency and, where it is asked for, the range.
constexpr Index energy = 0, ambient = 1, phasors = 2;
constexpr Index samples_at_a_time = 512;  // of parts: what is computed of them stays in the first cache
constexpr Index decoded_rows = 7;         // of memory that `decode` needs
constexpr Index line = 16;                // floats in a cache line

Index whole_lines(Index floats) { return (floats + line - 1) / line * line; }

/// Memory that a thread uses again for its next frame.
struct Workspace {
  std::vector<float> floats;
  std::vector<std::uint8_t> material;           // of parts
  std::vector<std::int32_t> column;             // of the pixels whose parts they are
  std::vector<std::int32_t> row, order, first;  // see `sort_by_rows`
  float* next = nullptr;

  /// Makes room for `size` floats, which `take` hands out.
  void reserve(Index size) {
    if (floats.size() < static_cast<std::size_t>(size + line)) floats.resize(static_cast<std::size_t>(size + line));
    const auto at = static_cast<Index>(reinterpret_cast<std::uintptr_t>(floats.data()) / sizeof(float) % line);
    next = floats.data() + (line - at) % line;
  }
  float* take(Index size) {
    float* taken = next;
    next += whole_lines(size);
    return taken;
  }
};

/// Sorts pixels (M,), flat indices, by rows of the image: those of row v are order[first[v]] .. order[first[v + 1] - 1].
void sort_by_rows(Array<const std::int32_t, any> pixels, Index height, Index width, Workspace& to) {
  const Index n = pixels.size();
  to.row.resize(static_cast<std::size_t>(n));
  to.order.resize(static_cast<std::size_t>(n));
  to.first.assign(static_cast<std::size_t>(height) + 2, 0);
  std::int32_t *row = to.row.data(), *first = to.first.data();
  const std::int32_t* pixel = pixels.data();
  const double rows_per_pixel = 1.0 / static_cast<double>(width);
  // The half pixel keeps whole numbers of rows away from what rounding could change.
  for (Index k = 0; k < n; ++k) row[k] = static_cast<std::int32_t>((static_cast<double>(pixel[k]) + 0.5) * rows_per_pixel);
  for (Index k = 0; k < n; ++k) ++first[row[k] + 2];
  for (Index v = 0; v < height; ++v) first[v + 2] += first[v + 1];
  for (Index k = 0; k < n; ++k) to.order[static_cast<std::size_t>(first[row[k] + 1]++)] = static_cast<std::int32_t>(k);
}

void moments(const float* energies, const float* ranges, Index n, float* out) {
  for (Index i = 0; i < n; ++i) out[i] = energies[i] * ranges[i];
}

/// Samples of the parts of some mixed pixels of one row.
struct Parts {
  float *depth, *cos_incidence, *range_over_depth, *range, *energy, *ambient, *in_phase, *quadrature;
  std::uint8_t* material;
  std::int32_t* column;  // of each pixel
};

/// The light of a frame, by rows; see `collect`, `stray`. Of several moments, the planes are means, each with shares of its own.
struct Light {
  const std::vector<View>& views;
  Array<const double, any, any> shares;
  const ContinuousWave& camera;
  const PhysicalEffects& effects;
  Workspace& memory;
  View view = views[0];
  Index height = view.depth_m.size(0), width = view.depth_m.size(1), stride = whole_lines(width);
  Index frequencies = camera.frequencies.size();
  Index planes = phasors + 2 * frequencies + (effects.wrapping ? 0 : 1);
  Index parts = view.parts_depth_m.size(1), most_pixels = std::max<Index>(1, samples_at_a_time / parts);
  Surfaces surfaces{camera.table, effects.incidence};
  float share = static_cast<float>(effects.blur);
  float per_m[most_frequencies] = {};                 // turns of the phase per metre of range
  double total[phasors + 2 * most_frequencies] = {};  // of each plane over the image (electrons)
  float* kept = nullptr;                              // (H, planes, stride): all rows, finished
  float* raw = nullptr;                               // (planes, stride): one row before the blur
  float* blurred[3] = {};                             // (planes, stride): three rows, blurred along themselves
  float* range = nullptr;                             // (stride,)
  float* finished = nullptr;                          // (stride,): one row of one moment
  Parts part{};

  /// Plane `which` of row v, in electrons; the range in m, NaN where there is no light.
  float* row(Index v, Index which) const { return kept + (v * planes + which) * stride; }

  /// Works out all rows.
  void collect() {
    const Index samples = most_pixels * parts;
    memory.reserve((height + 4) * planes * stride + (2 + decoded_rows) * stride + 8 * whole_lines(samples));
    memory.material.resize(static_cast<std::size_t>(samples));
    memory.column.resize(static_cast<std::size_t>(most_pixels));
    kept = memory.take(height * planes * stride);
    raw = memory.take(planes * stride);
    for (float*& rows : blurred) rows = memory.take(planes * stride);
    range = memory.take(stride);
    finished = memory.take(stride);
    part = {memory.take(samples), memory.take(samples), memory.take(samples), memory.take(samples),   memory.take(samples),
            memory.take(samples), memory.take(samples), memory.take(samples), memory.material.data(), memory.column.data()};
    for (Index k = 0; k < frequencies; ++k) per_m[k] = static_cast<float>(2.0 * camera.frequencies(k) / speed_of_light);
    for (Index moment = 0; moment < static_cast<Index>(views.size()); ++moment) collect_moment(moment);
  }

  void collect_moment(Index moment) {
    view = views[static_cast<std::size_t>(moment)];
    if (effects.flying_pixels) sort_by_rows(view.mixed, height, width, memory);
    for (Index v = 0; v < height; ++v) {
      collect_pixels(v, raw);
      if (effects.flying_pixels) collect_parts(v, raw);
      if (v < camera.indirect.size()) add_indirect(v, raw);
      for (Index k = 0; k < planes; ++k) blur_row(raw + k * stride, width, share, blurred[v % 3] + k * stride);
      if (v > 0) finish_row(v - 1, moment);
    }
    finish_row(height - 1, moment);
  }

  /// One row (planes, stride), each pixel seen as one surface.
  void collect_pixels(Index v, float* out) const {
    const Index at = v * width;
    const Samples samples{view.depth_m.data() + at, view.cos_incidence.data() + at, view.material.data() + at,
                          camera.range_over_depth.data() + at};
    light_of_samples(samples, width, surfaces, range, out + energy * stride, out + ambient * stride);
    for (Index k = 0; k < frequencies; ++k) {
      float* phasor = out + (phasors + 2 * k) * stride;
      phasors_of_samples(out + energy * stride, range, width, per_m[k], effects.wiggling, phasor, phasor + stride);
    }
    if (!effects.wrapping) moments(out + energy * stride, range, width, out + (planes - 1) * stride);
  }

  /// Sets the mixed pixels of a row to the means of their parts.
  void collect_parts(Index v, float* out) const {
    const Samples samples{part.depth, part.cos_incidence, part.material, part.range_over_depth};
    const Index last = memory.first[static_cast<std::size_t>(v) + 1];
    for (Index k = memory.first[static_cast<std::size_t>(v)]; k < last; k += most_pixels) {
      const Index m = std::min(most_pixels, last - k), n = m * parts;
      const std::int32_t* which = memory.order.data() + k;
      parts == 4 ? gather(which, m, v, std::integral_constant<Index, 4>{}) : gather(which, m, v, parts);
      const auto set = [&](const float* of_parts, Index plane) {
        means_of_parts(of_parts, part.column, m, parts, out + plane * stride);
      };
      light_of_samples(samples, n, surfaces, part.range, part.energy, part.ambient);
      set(part.energy, energy);
      set(part.ambient, ambient);
      for (Index f = 0; f < frequencies; ++f) {
        phasors_of_samples(part.energy, part.range, n, per_m[f], effects.wiggling, part.in_phase, part.quadrature);
        set(part.in_phase, phasors + 2 * f);
        set(part.quadrature, phasors + 2 * f + 1);
      }
      if (!effects.wrapping) {
        moments(part.energy, part.range, n, part.in_phase);
        set(part.in_phase, planes - 1);
      }
    }
  }

  /// Adds indirect light to a row.
  void add_indirect(Index v, float* out) const {
    for (Index k = 0; k <= 2 * frequencies; ++k) {
      float* plane = out + (k == 0 ? energy : phasors + k - 1) * stride;
      const float* light = &camera.indirect(v, k, 0);
      for (Index u = 0; u < width; ++u) plane[u] += light[u];
    }
    if (effects.wrapping) return;
    const float* light = &camera.indirect(v, 0, 0);
    for (Index u = 0; u < width; ++u) out[(planes - 1) * stride + u] += light[u] * range[u];  // unwrapped by the direct light
  }

  /// Copies the samples of m pixels of row v, elements `which` of `mixed`, beside each other.
  template <class Count>
  void gather(const std::int32_t* which, Index m, Index v, Count count) const {
    const Index n = count;
    const float *depth = view.parts_depth_m.data(), *cosine = view.parts_cos_incidence.data();
    const float* factor = camera.parts_range_over_depth.data();
    const std::uint8_t* material = view.parts_material.data();
    const std::int32_t *mixed = view.mixed.data(), first = static_cast<std::int32_t>(v * width);
    const Parts to = part;
    for (Index i = 0; i < m; ++i) {
      const Index from = which[i] * n, pixel = mixed[which[i]];
      __builtin_prefetch(factor + mixed[which[std::min(i + 8, m - 1)]] * n);
      to.column[i] = static_cast<std::int32_t>(pixel) - first;
      std::copy_n(depth + from, n, to.depth + i * n);
      std::copy_n(cosine + from, n, to.cos_incidence + i * n);
      std::copy_n(factor + pixel * n, n, to.range_over_depth + i * n);
      std::copy_n(material + from, n, to.material + i * n);
    }
  }

  /// Blurs row v across its neighbours, all of which are blurred along themselves, and counts its electrons.
  void finish_row(Index v, Index moment) {
    const float* here = blurred[v % 3];
    const float* above = v > 0 ? blurred[(v + 2) % 3] : here;  // beyond the image is the row itself
    const float* below = v + 1 < height ? blurred[(v + 1) % 3] : here;
    const bool one = views.size() == 1;
    for (Index k = 0; k < phasors + 2 * frequencies; ++k) {
      const float* gain = (k == ambient ? camera.ambient_gain : camera.gain)[v].data();
      const Index at = k * stride;
      float* to = one ? row(v, k) : finished;
      total[k] += shares(moment, k) * blur_and_gain(above + at, here + at, below + at, width, share, gain, to);
      if (!one) add_share(finished, moment, k, v);
    }
    if (effects.wrapping) return;
    const Index at = (planes - 1) * stride;
    float *known = one ? row(v, planes - 1) : finished, *light = range;
    blur_across(above + at, here + at, below + at, width, share, known);
    blur_across(above + energy * stride, here + energy * stride, below + energy * stride, width, share, light);
    for (Index u = 0; u < width; ++u) known[u] /= light[u];
    if (!one) add_share(finished, moment, planes - 1, v);
  }

  /// Adds the share that a moment's row has in a plane.
  void add_share(const float* of, Index moment, Index plane, Index v) {
    const float weight = static_cast<float>(shares(moment, plane));
    float* to = row(v, plane);
    if (moment == 0) std::fill_n(to, width, 0.0f);
    for (Index u = 0; u < width; ++u) to[u] += weight * of[u];
  }

  /// Scatters the active light of all pixels.
  void scatter_light() const {
    for (Index k = 0; k <= 2 * frequencies; ++k) {
      scatter(row(0, k == 0 ? energy : phasors + k - 1), height, width, planes * stride, static_cast<float>(effects.lens_scatter),
              effects.lens_scatter_px);
    }
  }

  /// Stray light (electrons): a share of the mean over the image of energy and of (cos, sin) a frequency, (1 + 2 F,).
  void stray(float* out) const {
    for (Index k = 0; k <= 2 * frequencies; ++k) {
      const double mean = total[k == 0 ? energy : phasors + k - 1] / static_cast<double>(height * width);
      out[k] = static_cast<float>(effects.stray_light * mean);
    }
  }
};

/// Decodes all rows.
void decode(const Light& light, const Electronics& sensor, Array<const std::uint16_t, any, any> ranks, const float* quantiles,
            const Delivered& out) {
  const ContinuousWave& camera = light.camera;
  const PhysicalEffects& effects = light.effects;
  const auto [p, q] = camera.frequency_ratio;
  const Index width = light.width;
  const bool two = light.frequencies == 2;
  const double f1 = camera.frequencies(0), f2 = two ? camera.frequencies(1) : 0.0, squares = f1 * f1 + f2 * f2;
  const float wavelength = static_cast<float>(speed_of_light / (2.0 * f1)), period = wavelength * static_cast<float>(p);
  const Unwrapping unwrapping{.p = p,
                              .q = q,
                              .wavelength = wavelength,
                              .weight = static_cast<float>(f1 * f1 / squares),
                              .tolerance = static_cast<float>(effects.consistency ? phase_tolerance : 0.5)};
  const double read_noise = effects.read_noise ? sensor.read_noise_e : 0.0;
  const double full_well = effects.full_well ? sensor.full_well_e : std::numeric_limits<double>::infinity();
  const Taps taps{.contrast = static_cast<float>(sensor.contrast),
                  .shot = effects.shot_noise ? 1.0f : 0.0f,
                  .read_variance = static_cast<float>(read_noise * read_noise),
                  .full_well = static_cast<float>(full_well)};
  const bool one_minimum = effects.low_amplitude && effects.low_amplitude_spread == 0.0;  // the same for all pixels
  const Limits limits{.min_amplitude = static_cast<float>(one_minimum ? sensor.min_amplitude_e : 0.0),
                      .near = static_cast<float>(camera.near),
                      .far = static_cast<float>(camera.far),
                      .sigma_scale = static_cast<float>(speed_of_light / (4.0 * pi * std::sqrt(2.0 * squares)))};
  if (effects.lens_scatter > 0.0) light.scatter_light();
  float stray[1 + 2 * most_frequencies];
  light.stray(stray);
  Workspace& memory = light.memory;
  float *total = memory.take(width), *amplitude = memory.take(width), *peak = memory.take(width);
  float *range = memory.take(width), *scratch = memory.take(width);
  float* turns[most_frequencies] = {memory.take(width), memory.take(width)};
  for (Index v = 0; v < light.height; ++v) {
    light_of_pixels(light.row(v, energy), stray[0], light.row(v, ambient), width, total);
    std::fill_n(amplitude, width, 0.0f);
    std::fill_n(peak, width, 0.0f);
    for (Index k = 0; k < light.frequencies; ++k) {
      phases_of_row(total, light.row(v, phasors + 2 * k), light.row(v, phasors + 2 * k + 1), stray + 1 + 2 * k, taps,
                    ranks[v].data() + 2 * k, quantiles, two ? 0.25f : 0.5f, width, turns[k], amplitude, peak);
    }
    if (two) {
      unwrap_row(turns[0], turns[1], unwrapping, width, range);
    } else {
      for (Index u = 0; u < width; ++u) range[u] = turns[0][u] * wavelength;
    }
    if (!effects.wrapping) unwrap_perfectly(light.row(v, light.planes - 1), period, width, range);
    deliver_row(range, amplitude, total, peak, camera.gain[v].data(), camera.range_over_depth[v].data(), taps, limits, width,
                scratch, out.depth_m[v].data(), out.amplitude[v].data(), out.confidence[v].data(), out.noise_m[v].data());
  }
}

/// One frame: phasors of pixels and of the parts of mixed ones, blur, stray light, four noisy samples of the correlation a
/// frequency, decoding to depth, amplitude and confidence.
///
/// views: the geometry while the samples were exposed, at least one and all of one size. A sample is linear in the light, and so
/// is the difference of two: the planes of energy, ambient light, (cos, sin) a frequency and, without `wrapping`, the range are
/// means over these views with `shares` (M, planes), which add up to 1. Noise and full wells go by the mean light. ranks: (H, 4
/// W) random 16-bit numbers, which rank the standard normal numbers `quantiles`. The light is relative to a white surface that
/// faces the camera at 1 m until `gain` turns it into electrons.
void simulate_continuous_wave(const std::vector<View>& views, Array<const double, any, any> shares, const ContinuousWave& camera,
                              const Electronics& sensor, const PhysicalEffects& effects,
                              Array<const std::uint16_t, any, any> ranks, Array<const float, 65536> quantiles,
                              const Delivered& out) {
  thread_local Workspace memory;
  Light light{views, shares, camera, effects, memory};
  light.collect();
  decode(light, sensor, ranks, quantiles.data(), out);
}

}  // namespace

void bind_continuous_wave(nb::module_& m) {
  describe<PhysicalEffects, Electronics, ContinuousWave>(m);
  m.def("simulate_continuous_wave", &simulate_continuous_wave, "views"_a, "shares"_a, "camera"_a, "sensor"_a, "effects"_a,
        "ranks"_a, "quantiles"_a, "out"_a, unlocked(), "One frame of a continuous-wave Time-of-Flight camera.");
}

}  // namespace cabinpose

// Noise model `physical`: a continuous-wave Time-of-Flight camera.
#pragma once

#include <vector>

#include "sensor/view.hpp"

namespace cabinpose {

/// A camera and the effects asked for; images (H, W). See `ContinuousWave` in `scene/sensor/physical.py`.
struct ContinuousWave {
  Array<const float, any, any> range_over_depth;        // NaN outside the lens model
  Array<const float, any, any> parts_range_over_depth;  // (H * W, n) at the parts of all pixels
  Array<const float, any, any> gain;                    // electrons per unit of energy, 0 outside the field
  Array<const float, any, any> ambient_gain;            // electrons per unit of ambient light
  Array<const float, 256, 3> table;                     // by material: diffuse reflectance, specular peak, ambient light
  Array<const double, any> frequencies;                 // Hz: one, or two in the ratio p : q
  int p, q;
  double gloss_width;    // 1 - cosine of the width of the specular lobe
  double triangle;       // share of a triangular correlation, 0..1
  double blur;           // share of a pixel's light that goes to each neighbour
  double stray_light;    // share of the image's mean light that reaches every pixel
  double contrast;       // of the demodulation
  double read_noise;     // of one tap difference (electrons)
  double full_well;      // of one tap (electrons)
  double min_amplitude;  // below which a pixel is invalid (electrons)
  double near, far;      // m along the axis
  double tolerance;      // of p t2 - q t1 from a whole number (turns)
  bool parts;            // a pixel of `mixed` is the mean of its parts
  bool lambert;          // light returned falls with the cosine of incidence
  bool shot_noise;
  bool wrapping;      // the phase repeats beyond the unambiguous range
  double scatter;     // share of a pixel's light that lens and sensor scatter
  double scatter_px;  // least deviation of the scattered light, see `scatter`
  Array<const float, any, any, any>
      indirect;  // (H, 1 + 2 F, W) energy and (cos, sin) a frequency of indirect light, or (0, ., .)

  auto members() {
    return std::tie(range_over_depth, parts_range_over_depth, gain, ambient_gain, table, frequencies, p, q, gloss_width, triangle,
                    blur, stray_light, contrast, read_noise, full_well, min_amplitude, near, far, tolerance, parts, lambert,
                    shot_noise, wrapping, scatter, scatter_px, indirect);
  }
};

/// One frame: phasors of pixels and of the parts of mixed ones, blur, stray light, four noisy samples of the correlation a
/// frequency, decoding to depth, amplitude and confidence.
///
/// views: the geometry while the samples were exposed, at least one and all of one size. A sample is linear in the light, and so
/// is the difference of two: the planes of energy, ambient light, (cos, sin) a frequency and, without `wrapping`, the range are
/// means over these views with `shares` (M, planes), which add up to 1. Noise and full wells go by the mean light. ranks: (H, 4
/// W) random 16-bit numbers, which rank the standard normal numbers `quantiles`. The light is relative to a white surface that
/// faces the camera at 1 m until `gain` turns it into electrons.
void simulate_continuous_wave(const std::vector<View>& views, Array<const double, any, any> shares, const ContinuousWave& camera,
                              Array<const std::uint16_t, any, any> ranks, Array<const float, 65536> quantiles,
                              const Delivered& out);

}  // namespace cabinpose

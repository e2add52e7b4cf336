// Noise model `empirical`: a measured sigma(z), noise at edges, spikes taken out, circular crop and range window.
#pragma once

#include "sensor/view.hpp"

namespace cabinpose {

/// A camera and its measured noise; images (H, W). See `scene/sensor/empirical.py`.
struct Empirical {
  Array<const float, any, any> range_over_depth;
  Array<const float, any, any> amplitude_scale;  // electrons of a white surface that faces the camera at 1 m, 0 outside the field
  Array<const bool, any, any> field;             // where depth is delivered
  Array<const float, 256, 3> table;              // by material: diffuse reflectance, specular peak of panes, (unused)
  double a, b, c;                                // sigma (m) = a + b z + c z^2
  double edge_sigma, edge_threshold;             // m
  int reach;                                     // of the differences that find edges (px)
  bool remove_spikes, glass;
  double near, far;  // m along the axis

  auto members() {
    return std::tie(range_over_depth, amplitude_scale, field, table, a, b, c, edge_sigma, edge_threshold, reach, remove_spikes,
                    glass, near, far);
  }
};

/// One frame. ranks: (H, 4 ceil(W / 4)) random 16-bit numbers, of which a row uses the first W; they rank the standard normal
/// numbers `quantiles`. Source of the equations: Gonçalves (thesis, 2020).
void simulate_empirical(const View& view, const Empirical& camera, Array<const std::uint16_t, any, any> ranks,
                        Array<const float, 65536> quantiles, const Delivered& out);

}  // namespace cabinpose

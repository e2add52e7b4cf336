// Noise model `structured_light`: depth from a projected dot pattern, as of a Kinect-v1 or Xtion.
#pragma once

#include "sensor/view.hpp"

namespace cabinpose {

/// A camera and the effects asked for; images (H, W). See `scene/sensor/structured_light.py`.
struct StructuredLight {
  Array<const float, any, any> range_over_depth;
  Array<const float, any, any> amplitude_scale;  // electrons of a white surface that faces the camera at 1 m, 0 outside the field
  Array<const float, 256, 3> table;              // by material: diffuse reflectance, (unused), (unused)
  int supersample;                               // parts of a pixel along a side
  bool axial;                                    // axial noise
  double lateral;                                // sigma of the place where a pixel is matched (px)
  double focal_baseline;                         // of the matcher (px m)
  double step;                                   // of the disparity (px of the matcher), 0 where it has none
  double grazing_cosine;                         // of incidence, below which the pattern is not matched
  double min_return;                             // light, relative to a white surface at 1 m, below which no dot is seen
  double shadow;                                 // focal length x baseline of the image (px m), 0 for no shadow
  int fill;                                      // widest hole that is filled (px)
  double near, far;                              // m along the axis

  auto members() {
    return std::tie(range_over_depth, amplitude_scale, table, supersample, axial, lateral, focal_baseline, step, grazing_cosine,
                    min_return, shadow, fill, near, far);
  }
};

/// One frame. ranks: (H, 4 W) random 16-bit numbers, which rank the standard normal numbers `quantiles`.
void simulate_structured_light(const View& view, const StructuredLight& camera, Array<const std::uint16_t, any, any> ranks,
                               Array<const float, 65536> quantiles, const Delivered& out);

}  // namespace cabinpose

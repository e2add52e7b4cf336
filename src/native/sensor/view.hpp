// What every noise model starts from: the rendered geometry of a view.
#pragma once

#include <bit>

#include "core/array.hpp"
#include "core/fields.hpp"

namespace cabinpose {

/// Python's `GeometryBuffers`: geometry (H, W) at the pixels' centres, and at the n parts of the pixels `mixed` (M,), flat
/// indices in any order. Depths in m along the axis, 0 where nothing was hit.
struct View {
  int supersample;  // parts of a pixel along a side
  Array<const float, any, any> depth_m, cos_incidence;
  Array<const std::uint8_t, any, any> material;
  Array<const std::int32_t, any> mixed;
  Array<const float, any, any> parts_depth_m, parts_cos_incidence;
  Array<const std::uint8_t, any, any> parts_material;

  CABINPOSE_FIELDS(View, supersample, depth_m, cos_incidence, material, mixed, parts_depth_m, parts_cos_incidence, parts_material)
};

/// How surfaces return light, by material: diffuse reflectance, specular peak, ambient light returned, 1 / width of the specular
/// lobe.
inline constexpr Index finish_columns = 4;
using Finishes = Array<const float, 256, finish_columns>;

/// Lens and light of a camera whose noise model sees one surface a pixel, images (H, W): Python's `SurfaceOptics`.
struct SurfaceOptics {
  Array<const float, any, any> range_over_depth;
  Array<const float, any, any> amplitude_scale;  // electrons of a white surface that faces the camera at 1 m, 0 outside the field
  Array<const bool, any, any> field;             // inside the image circle
  Finishes table;
  Array<const bool, 256> panes;  // which materials are panes of glass

  CABINPOSE_FIELDS(SurfaceOptics, range_over_depth, amplitude_scale, field, table, panes)
};

/// What a camera delivers, each (H, W): Python's `SensorFrame`.
struct Delivered {
  Array<float, any, any> depth_m;
  Array<std::uint16_t, any, any> amplitude;
  Array<std::uint8_t, any, any> confidence;
  Array<float, any, any> noise_m;  // sigma of the depth (m), NaN where invalid, infinite where a tap is full

  CABINPOSE_FIELDS(Delivered, depth_m, amplitude, confidence, noise_m)
};

/// A sigma at which the delivered confidence, 255 c / (c + sigma), is half of its scale (m).
inline constexpr float confidence_sigma = 0.010f;

/// x where a condition holds and 0 elsewhere; loops with it have no branch, whatever it costs to work out x.
inline float where(bool holds, float x) {
  return std::bit_cast<float>(std::bit_cast<std::int32_t>(x) & -static_cast<std::int32_t>(holds));
}

/// Rounds down, |x| < 2^22: in a loop as fast without SSE 4.1 as with it.
inline float floor_of_small(float x) {
  constexpr float round = 0x1.8p23f;  // added and taken away, leaves a whole number
  const float nearest = (x + round) - round;
  return nearest - where(nearest > x, 1.0f);
}

/// The same, |x| < 2^51.
inline double floor_of_small(double x) {
  constexpr double round = 0x1.8p52;
  const double nearest = (x + round) - round;
  return nearest > x ? nearest - 1.0 : nearest;
}

/// Depth (H * W) of one surface a pixel: the mean of a pixel's parts where they lie on one surface, and that of its centre
/// where they do not. Depths of two surfaces are never mixed.
void depth_of_one_surface(const View& view, float* out);

/// Amplitude (H * W) without noise (electrons) of one surface a pixel.
///
/// depth: (H * W).
void geometric_amplitude(const float* depth, const View& view, const SurfaceOptics& optics, std::uint16_t* out);

/// Confidence, 0 where the depth is not finite, and noise of depths that have a sigma (m).
void deliver_sigma(const float* sigma, const Delivered& out);

}  // namespace cabinpose

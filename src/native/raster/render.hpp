// What a camera sees of a surface, in one call.
#pragma once

#include "raster/joints.hpp"
#include "raster/mixed.hpp"
#include "raster/zbuffer.hpp"

namespace cabinpose {

/// A camera as the renderer needs it.
///
/// rays: blocks of the pixels' centres, see `BlockRays`, NaN beyond the image · part_rays: (H * W, 2, s * s) x and y of the parts
/// of every pixel · looks: (256,) bits of `Look` of each material · which: see `Which`.
struct Eye {
  int width, height, supersample;
  Lens lens;
  Array<const float, any, 2, block_samples> rays;
  Array<const float, any, 2, any> part_rays;
  Array<const std::uint8_t, 256> looks;
  int which;

  CABINPOSE_FIELDS(Eye, width, height, supersample, lens, rays, part_rays, looks, which)
};

/// Images (H, W) of the pixels' centres: depth (m), label, instance, face; 0, and -1 for the face, where nothing is seen.
struct Images {
  Array<float, any, any> depth;
  Array<std::uint8_t, any, any> label, instance;
  Array<std::int32_t, any, any> face;

  CABINPOSE_FIELDS(Images, depth, label, instance, face)
};

/// What the sensor model reads: depth, cosine of incidence and material of the pixels (H, W); flat indices of the mixed pixels,
/// at least H * W + 1; the same three of their parts, H * W * s * s.
struct Buffers {
  Array<float, any, any> depth, cosine;
  Array<std::uint8_t, any, any> material;
  Array<std::int32_t, any> mixed;
  Array<float, any> parts_depth, parts_cosine;
  Array<std::uint8_t, any> parts_material;

  CABINPOSE_FIELDS(Buffers, depth, cosine, material, mixed, parts_depth, parts_cosine, parts_material)
};

/// Render a surface: fill the images, the buffers and the states (P, 20) of the joints; returns how many pixels are mixed.
///
/// closed: all its parts are closed and the camera is in none of them, so that faces turned away are never seen.
Index render(const Surface& surface, Array<const double, 4, 4> camera_from_vehicle, bool closed, const Eye& eye,
             const Joints& joints, const Images& images, const Buffers& buffers, Array<std::uint8_t, any, joint_count> states);

}  // namespace cabinpose

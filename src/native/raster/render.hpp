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

/// What the sensor model reads, Python's `GeometryBuffers`: depth, cosine of incidence and material of the pixels (H, W); room
/// for flat indices of all pixels and one more, of those that are mixed, and for the same three of their parts.
struct Buffers {
  Array<float, any, any> depth_m, cos_incidence;
  Array<std::uint8_t, any, any> material;
  Array<std::int32_t, any> mixed;
  Array<float, any, any> parts_depth_m, parts_cos_incidence;
  Array<std::uint8_t, any, any> parts_material;

  CABINPOSE_FIELDS(Buffers, depth_m, cos_incidence, material, mixed, parts_depth_m, parts_cos_incidence, parts_material)
};

/// Python's `RenderedFrame`: images (H, W) of the pixels' centres (depth in m, label, instance, face; 0, and -1 for the face,
/// where nothing is seen), buffers, and states (P, 20) of the joints.
struct Rendered {
  Array<float, any, any> depth_clean;
  Array<std::uint8_t, any, any> labels, instance;
  Array<std::int32_t, any, any> face_id;
  Buffers buffers;
  Array<std::uint8_t, any, joint_count> visibility;

  CABINPOSE_FIELDS(Rendered, depth_clean, labels, instance, face_id, buffers, visibility)
};

/// Render a surface: fill a frame; returns how many pixels are mixed.
///
/// closed: all its parts are closed and the camera is in none of them, so that faces turned away are never seen.
Index render(const Surface& surface, Array<const double, 4, 4> camera_from_vehicle, bool closed, const Eye& eye,
             const Joints& joints, const Rendered& frame);

}  // namespace cabinpose

// Nearest triangles to what a camera and its sensor model read: depth, incidence, material, labels.
#pragma once

#include <vector>

#include "raster/zbuffer.hpp"

namespace cabinpose {

/// How a triangle looks: a 3x3 matrix, row by row, that takes a ray of the camera to the normal in the vehicle frame that is
/// interpolated where it hits, times any scale; the face; and its label, instance and material, 8 bits each from the lowest on.
struct alignas(16) Appearance {
  float normal[9];
  std::int32_t face, kind, unused;
};

/// Appearances by triangle, made for those that are seen alone; number 0 is nobody's.
class Appearances {
 public:
  void start(const Triangles& triangles);
  /// Make those that some hits need and that are not made yet.
  void make(const BlockHits* hits, Index blocks, const Triangles& triangles, const Surface& surface);
  const Appearance* data() const { return items_.data(); }

 private:
  std::vector<Appearance> items_;
  std::vector<std::uint8_t> seen_, made_;
  std::vector<std::int32_t> list_;
};

/// What the sensor model reads of samples: depth z (m), |cos| of incidence, and material; 0 where nothing is hit.
struct Samples {
  float *depth, *cosine;
  std::uint8_t* material;
};

/// The pixel images: depth, label and instance (0 for nothing), face (-1 for nothing).
struct Classes {
  float* depth;
  std::uint8_t *label, *instance;
  std::int32_t* face;
};

/// The pixels' centres: images (H, W).
void shade_pixels(const Grid& grid, const BlockRays* rays, const BlockHits* hits, const Appearance* appearances, const Pose& pose,
                  const Samples& samples, const Classes& classes);

/// Any `count` samples, one after the other.
void shade_samples(Index count, const BlockRays* rays, const BlockHits* hits, const Appearance* appearances, const Pose& pose,
                   const Samples& samples);

}  // namespace cabinpose

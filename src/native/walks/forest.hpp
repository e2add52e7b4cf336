// Random tree walks on depth images (Jung, Lee, Heo and Yun, CVPR 2015): features, growth of trees, leaves, walks.
//
// Points are in the camera frame (m), views are focal length and principal point (px), depth images z along the optical axis.
#pragma once

#include <algorithm>
#include <cstdint>

#include "core/array.hpp"
#include "core/fields.hpp"

namespace cabinpose {

using View = Array<const float, 3>;
using Splits = Array<const float, any, 4>;  // two offsets from the point, x and y each, m

inline constexpr int feature_bins = 256;
inline constexpr float feature_reach = 0.6F;  // m: surfaces that far before or behind the point, or more, are alike

/// The surface around a point, in the image of a frame or in its mirror image. Offsets shrink with depth, as things do.
template <class Pixel>
class Surroundings {
 public:
  Surroundings(const Pixel* image, Index height, Index width, View view, const float* point, bool mirrored = false)
      : image_(image),
        width_(width),
        mirrored_(mirrored),
        right_(static_cast<float>(width) - 0.5F),
        below_(static_cast<float>(height) - 0.5F),
        z_(point[2]),
        scale_(view(0) / point[2]),
        u_(view(1) + point[0] * scale_),
        v_(view(2) + point[1] * scale_) {}

  /// The difference of the surface's depths at two offsets, in bins; with equal offsets, that of the surface and the point.
  int feature(const float* split) const {
    float difference = beyond(split[0], split[1]);
    if (split[0] != split[2] || split[1] != split[3]) difference -= beyond(split[2], split[3]);
    constexpr float per_metre = feature_bins / (4.0F * feature_reach);
    return std::clamp(static_cast<int>((difference + 2.0F * feature_reach) * per_metre), 0, feature_bins - 1);
  }

 private:
  /// How far the surface at an offset lies behind the point, m; what is invalid or outside of the image lies far behind.
  float beyond(float x, float y) const {
    const float u = u_ + x * scale_, v = v_ + y * scale_;
    if (!(u > -0.5F && v > -0.5F && u < right_ && v < below_)) return feature_reach;
    const auto column = static_cast<Index>(u + 0.5F), row = static_cast<Index>(v + 0.5F);
    const float depth = metres(image_[row * width_ + (mirrored_ ? width_ - 1 - column : column)]);
    return depth > 0.0F ? std::clamp(depth - z_, -feature_reach, feature_reach) : feature_reach;
  }
  static float metres(std::uint16_t ticks) { return static_cast<float>(ticks) * 1e-4F; }
  static float metres(float depth) { return depth; }

  const Pixel* image_;
  Index width_;
  bool mirrored_;
  float right_, below_, z_, scale_, u_, v_;
};

/// A regression tree. offsets, thresholds, children: of its nodes; those whose feature is below the threshold go to the left
/// child, which is numbered `children`, the others to the next; negative: -1 - leaf · leaf: of each sample.
struct Tree {
  Grown<float, 4> offsets;
  Grown<std::int32_t> thresholds, children, leaf;

  auto result() const { return std::make_tuple(offsets, thresholds, children, leaf); }
};

/// Grows a tree that tells targets (S, 3) from the surface around points (S, 3), with the least variance behind every split.
///
/// depth: (N, h, w), 0.1 mm, 0 = invalid · frame: (S,) of each sample, N and above: the mirror images · pool: the features, of
/// which each node tries the next `tried`, on at most `most` of its samples, evenly spread · least: samples of a leaf.
Tree grow(Array<const std::uint16_t, any, any, any> depth, View view, Array<const std::int32_t, any> frame,
          Array<const float, any, 3> points, Array<const float, any, 3> targets, Splits pool, Index tried, Index most,
          Index least, Index deepest);

/// Clusters the targets of each leaf by k-means (Lloyd), which begins with targets far apart.
///
/// order: samples by leaf, of which leaf l has those from starts[l] to starts[l + 1] · directions: (L, K, 3) unit mean of each
/// cluster, zero where it is empty · shares: (L, K) cumulative shares of the samples.
void cluster(Array<const float, any, 3> targets, Array<const std::int64_t, any> order, Array<const std::int64_t, any> starts,
             Index rounds, Array<float, any, any, 3> directions, Array<float, any, any> shares);

/// Trees of J joints as one: roots (J,), nodes as in `Tree` with leaves numbered through, leaves as of `cluster`.
struct Forest {
  Array<const std::int32_t, any> roots;
  Splits offsets;
  Array<const std::int32_t, any> thresholds, children;
  Array<const float, any, any, 3> directions;
  Array<const float, any, any> shares;

  CABINPOSE_FIELDS(Forest, roots, offsets, thresholds, children, directions, shares)
};

/// Walks to the joints of P people in N frames, with steps of one length (m) in directions that leaves draw by their shares.
///
/// starts: (P, 3), where the walk to each first joint begins · order: joint and the joint at whose place its walk begins, or
/// -1 · skipped: first steps of a walk that do not count for the mean of its places, the joint · places: (N, P, J, steps, 3).
/// Each joint has random numbers of its own, the same in every frame.
void walk(Array<const float, any, any, any> depth, View view, Array<const float, any, 3> starts,
          Array<const std::int32_t, any, 2> order, Forest forest, float step, Index skipped,
          Array<float, any, any, any, any, 3> places, Array<float, any, any, any, 3> joints);

}  // namespace cabinpose

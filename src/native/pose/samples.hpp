// A body as points of its skin with normals, a few hundred, moved with it: what clearance is measured with while it is posed.
#pragma once

#include <cstdint>
#include <tuple>
#include <utility>
#include <vector>

#include "body/kinematics.hpp"
#include "pose/motion.hpp"

namespace cabinpose {

inline constexpr int max_solids = 16;

/// Points of a person's skin at rest, solid after solid: `synth.posture.samples.Samples`.
struct SampleArrays {
  Array<const double, any, 3> rest;
  Array<const double, any, 3> normal;
  Array<const std::uint8_t, any, any> index;
  Array<const float, any, any> weight;
  Array<const std::int32_t, any> bone;
  Array<const std::int64_t, any, 2> rows;
  Array<const double, any> cover;

  auto members() { return std::tie(rest, normal, index, weight, bone, rows, cover); }

  /// Where the first samples of a solid end, which lie far from each other all over it: no other is farther than `cover` from
  /// one.
  Index first_end(Index solid) const { return rows(solid, 0) + (rows(solid, 1) - rows(solid, 0) + 3) / 4; }
};

/// A ball around something.
struct Ball {
  Vec3 centre;
  double radius = 0.0;
};

/// The samples in a posture, vehicle frame.
class Samples {
 public:
  /// Linear blend skinning of points and normals, and a ball around each solid.
  void pose(const double* q, const RestArrays& rest, const SampleArrays& arrays, const BoneFrames& skeleton);
  Vec3 point(Index n) const { return points_[static_cast<std::size_t>(n)]; }
  Vec3 normal(Index n) const { return normals_[static_cast<std::size_t>(n)]; }
  const Ball& ball(Index solid) const { return balls_[solid]; }
  /// The number of the sample from `first` to before `end` that is nearest to p, and how far p and the samples may move against
  /// each other before another one can be (m).
  std::pair<Index, double> nearest(Vec3 p, Index first, Index end) const;

 private:
  std::vector<Vec3> points_, normals_;
  std::vector<float> x_, y_, z_;
  std::vector<double> transforms_;
  Ball balls_[max_solids];
};

}  // namespace cabinpose

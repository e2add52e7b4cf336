// A body as points of its skin with normals, a few hundred, moved with it: what clearance is measured with while it is posed.
#pragma once

#include <cstdint>
#include <vector>

#include "body/kinematics.hpp"
#include "pose/motion.hpp"

namespace cabinpose {

inline constexpr int max_solids = 16;

/// Points of a person's skin at rest, solid after solid: `synth.posture.samples.Samples`.
struct SampleArrays {
  Array<const double, any, 3> rest;
  Array<const double, any, 3> normal;
  Array<const std::uint8_t, any, any> skin_index;
  Array<const float, any, any> skin_weight;
  Array<const std::int32_t, any> bone;
  Array<const std::int64_t, any, 2> rows;
  Array<const std::int64_t, any, 2> around;
  Array<const double, any> reach;

  CABINPOSE_FIELDS(SampleArrays, rest, normal, skin_index, skin_weight, bone, rows, around, reach)

  /// Where the first samples of a solid end, which lie all over it; the others are `around` these, no farther than `reach`.
  Index first_end(Index solid) const { return rows(solid, 0) + (rows(solid, 1) - rows(solid, 0) + 3) / 4; }
};

/// A ball around something.
struct Ball {
  Vec3 centre;
  double radius = 0.0;
};

/// The sample nearest to a point, -1 where all are farther than asked for; how far they are away at least; how far point and
/// samples may move against each other before another one can be nearest (m).
struct Nearest {
  Index sample = -1;
  double away = 0.0, margin = 0.0;
};

/// The samples in a posture, vehicle frame.
class Samples {
 public:
  /// Linear blend skinning of points and normals, and a ball around each solid.
  void pose(const double* q, const RestArrays& rest, const SampleArrays& arrays, const BoneFrames& skeleton);
  Vec3 point(Index n) const { return points_[static_cast<std::size_t>(n)]; }
  Vec3 normal(Index n) const { return normals_[static_cast<std::size_t>(n)]; }
  const Ball& ball(Index solid) const { return balls_[solid]; }
  /// The sample of a solid that is nearest to p, where the solid is no farther than `near` (m).
  Nearest nearest(Vec3 p, const SampleArrays& arrays, Index solid, double near) const;

 private:
  std::vector<Vec3> points_, normals_;
  std::vector<float> x_, y_, z_, reach_;
  std::vector<double> transforms_;
  Ball balls_[max_solids];
};

}  // namespace cabinpose

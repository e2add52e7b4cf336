// How the bones of a skeleton move when one of its degrees of freedom does.
#pragma once

#include "body/kinematics.hpp"

namespace cabinpose {

/// The unknowns of a body: its pelvis' shift and turn (vehicle axes, about its own origin), then the degrees of freedom.
inline constexpr int n_root = 6, n_unknown = n_root + rig::n_dofs;

/// A rigid body's velocity: that of a point p is turn x p + shift.
struct Twist {
  Vec3 turn, shift;
};

/// A posture's bones.
struct BoneFrames {
  BoneFrame at[rig::n_main];

  /// Forward kinematics.
  void move(const double* q, const RestArrays& rest, const BoneFrame& root);
};

/// Velocities of the bones for each degree of freedom, at one posture.
class Motion {
 public:
  /// By differences of `step` rad, taken where a degree of freedom has an effect.
  void set(const double* q, const RestArrays& rest, const BoneFrames& skeleton);
  /// The rate at which a point of a bone moves along `direction` with every unknown, added to `row` times `factor`.
  void add_point(double* row, int bone, Vec3 point, Vec3 direction, double factor) const;
  /// The rate at which a bone turns about `axis`, likewise.
  void add_turn(double* row, int bone, Vec3 axis, double factor) const;

 private:
  Vec3 root_;
  Twist twists_[rig::n_dofs][rig::n_main];
};

}  // namespace cabinpose

// Serial chains of hinges: forward kinematics, and inverse kinematics within box limits.
//
// The solver is Levenberg-Marquardt with a diagonal damping (Marquardt 1963; Wampler 1986 for manipulators) and an active set
// for the limits: a hinge at its limit whose gradient points outwards is held, steps are cut to the box, and a step is taken
// only where it lowers the cost. A prior pulls towards a comfortable posture; for the last iterations it is taken away, or down
// to a share, so that it chooses among solutions and hardly biases the one that is found.
//
// Angles are radians, lengths metres. Everything lies on the stack.
#pragma once

#include "core/vec.hpp"

namespace cabinpose {

inline constexpr int max_hinges = 12;  // of a chain; an arm has seven

/// A rigid transform, a_from_b.
struct Rigid {
  Mat3 rotation;
  Vec3 position;
};

/// The rigid transform in a matrix (4, 4).
inline Rigid rigid(const double* matrix) { return {mat3(matrix, 4), {matrix[3], matrix[7], matrix[11]}}; }

/// A chain of n hinges. With angles q, base_from_tool = fixed[0] R(axes[0], q[0]) fixed[1] ... R(axes[n-1], q[n-1]) fixed[n].
struct Chain {
  int n = 0;
  Rigid fixed[max_hinges + 1];  // from each hinge's frame to the one before it at angle zero; the last one carries the tool
  Vec3 axes[max_hinges];        // unit vectors in the hinge's own frame
};

/// The box of a chain's angles: n each.
struct Limits {
  const double* lower;
  const double* upper;
};

/// Where a chain's tool shall be.
struct Goal {
  Rigid target;             // base_from_target
  Vec3 position_weight;     // along the target's own axes, 0 where it is free
  Vec3 rotation_weight;     // m/rad, about them
  const double* prior;      // (n), the comfortable posture
  const double* stiffness;  // (n), the weight of departing from it, relative to 1 m of error
};

/// What a solution misses its target by, over the directions with a weight: metres and radians.
struct Residual {
  double position, rotation;
};

/// Rotation by an angle about a unit axis (Rodrigues).
Mat3 hinge_rotation(Vec3 axis, double angle);

/// The rotation vector of a rotation matrix; well-behaved at zero and near half a turn.
Vec3 rotation_vector(const Mat3& r);

/// Frames (n + 1): base_from_hinge of every hinge (before it turns; its axis keeps its direction), then the tool's.
void chain_frames(const Chain& chain, const double* q, Rigid* frames);

/// Improve q (n) in place so that the tool meets its goal; never leaves the limits.
///
/// For the last iterations only the share `kept` of the prior's stiffness stays at work: 0 leaves no bias.
Residual solve_chain(const Chain& chain, const Limits& limits, const Goal& goal, double* q, int iterations, double kept);

}  // namespace cabinpose

// Closed-form arms and legs: a ball joint, a hinge and a wrist (or ankle), with the swivel angle searched.
//
// The middle hinge follows from the distance to the target alone. The ball joint may then still turn about the line from it to
// the target: the swivel (Tolani, Goswami and Badler 2000, "Real-time inverse kinematics techniques for anthropomorphic limbs";
// Kallmann 2008, "Analytical inverse kinematics with body posture control"). A sweep over the swivel takes the angle that
// violates the limits least and, among those within them, lies nearest to a comfortable posture. The result starts the chain
// solver, which removes what is left.
#pragma once

#include "pose/chain.hpp"

namespace cabinpose {

/// Angles of a rotation about three mutually orthogonal axes (3) in turn, r = R(a0) R(a1) R(a2).
///
/// In the frame of the axes this is the x-y-z sequence, mirrored where the axes are left-handed. Of the two solutions the one
/// nearer to `near` is taken; where the middle axis is at a right angle the last angle stays near it.
Vec3 euler_near(const Mat3& r, const Vec3* axes, Vec3 near);

/// Angles (n) that bring the limb's tool near `target` (chain base), into q; returns the cost of the best swivel.
///
/// The chain: any hinges up to `ball` (they stay at the prior), three orthogonal hinges through one point, the middle hinge,
/// then the rest (three orthogonal hinges are solved for the tool's rotation where `oriented`, otherwise all stay at the prior).
/// What the closed form leaves out (an ankle of two hinges, a rest bent by the prior) the chain solver mends.
double seed_limb(const Chain& chain, const Limits& limits, int ball, const Rigid& target, bool oriented, const double* prior,
                 const double* stiffness, int swivels, double* q);

}  // namespace cabinpose

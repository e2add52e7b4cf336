// Arms and legs of a person as chains: palms and soles brought to their targets within the joint limits.
//
// An arm is seven hinges (shoulder 3, elbow, pronation, wrist 2), a leg six (hip 3, knee, ankle 2), with the axes of
// `scene.body.rig`. The clavicle moves the shoulder and follows the raising humerus, so an arm is solved in rounds: the chain
// with the shoulder where it is, then the skeleton again. A target beyond an arm's length draws the shoulder girdle after it.
#pragma once

#include <tuple>

#include "body/kinematics.hpp"
#include "pose/chain.hpp"

namespace cabinpose {

inline constexpr int n_arm = 7, n_leg = 6;

/// Where an arm's seven (a leg's six) angles begin in a posture; side 0 is the left, 1 the right.
constexpr int first_of_arm(int side) { return rig::dof(rig::shoulder_flexion, side); }
constexpr int first_of_leg(int side) { return rig::dof(rig::hip_flexion, side); }

using MovedPosture = Array<double, rig::n_dofs>;  // rad, in the order of `rig.DOFS`, written in place
using JointLimits = Array<const double, rig::n_dofs>;

/// Frames of the main bones, vehicle_from_bone, in memory of their own.
struct Skeleton {
  Mat3 rotation[rig::n_main];
  Vec3 position[rig::n_main];

  Rotations rotations() { return Rotations(&rotation[0].m[0][0]); }
  Positions positions() { return Positions(&position[0].x); }
  /// Forward kinematics of a posture.
  void move(Posture q, const RestArrays& rest, Placement vehicle_from_root) {
    bone_frames(q, rest, vehicle_from_root, rotations(), positions());
  }
};

/// vehicle_from_palm of one side, from the frames of the main bones.
Rigid vehicle_from_palm(const RestArrays& rest, const Skeleton& skeleton, int side);

/// A palm's or sole's target: `synth.posture.limbs.LimbTask`.
template <Index Hinges>
struct LimbTask {
  Array<const double, 4, 4> target;        // vehicle_from_target
  Array<const double, 3> position_weight;  // along the target's axes, 0 where it is free
  Array<const double, 3> rotation_weight;  // m/rad, about them
  Array<const double, Hinges> prior;       // rad, the comfortable posture
  Array<const double, Hinges> stiffness;   // the weight of departing from it, relative to 1 m of error

  auto members() { return std::tie(target, position_weight, rotation_weight, prior, stiffness); }

  /// The same for the chain solver, in the vehicle frame.
  Goal goal() const {
    return {rigid(target.data()), vec3(position_weight.data()), vec3(rotation_weight.data()), prior.data(), stiffness.data()};
  }
};
using ArmTask = LimbTask<n_arm>;
using LegTask = LimbTask<n_leg>;

/// The chain of an arm whose shoulder is at `shoulder`, with `thorax` vehicle_from_thorax.
Chain arm_chain(const RestArrays& rest, int side, const Mat3& thorax, Vec3 shoulder);

/// The chain of a leg whose femur head is at `hip`, with `pelvis` vehicle_from_pelvis.
Chain leg_chain(const RestArrays& rest, int side, const Mat3& pelvis, Vec3 hip);

/// Bring a palm to its target, in place of q, by shoulder girdle, arm and wrist; q's clavicle is the start of the girdle.
Residual solve_arm(MovedPosture q, const RestArrays& rest, Placement vehicle_from_root, int side, JointLimits lower,
                   JointLimits upper, const ArmTask& task);

/// Bring a sole to its target, in place of q, by hip, knee and ankle.
Residual solve_leg(MovedPosture q, const RestArrays& rest, Placement vehicle_from_root, int side, JointLimits lower,
                   JointLimits upper, const LegTask& task);

}  // namespace cabinpose

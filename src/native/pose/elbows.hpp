// Arms that give way: elbows swivel and hands move aside where trunk, thighs or the car's sides are.
//
// An arm whose palm is where it should be may still turn about the line from shoulder to wrist (the swivel of `two_bone`). It
// turns no further than it must: the trouble of `room` is weighed against the angle. A hand that lies in a thigh or in the trim
// moves out by the depth, and its arm follows.
#pragma once

#include "pose/limbs.hpp"
#include "pose/room.hpp"

namespace cabinpose {

/// Turn an arm that `solve_arm` brought to its task out of what is in its way, in place of q; by what the hand then misses (m).
///
/// allowed: how deep it may lie in trunk, thigh and car (m) · moves: the hand itself may move aside, `upwards` or out of what
/// it lies in; what it misses is then its place as moved.
double settle_arm(MovedPosture q, const RestArrays& rest, Placement vehicle_from_root, int side, JointLimits lower,
                  JointLimits upper, const ArmTask& task, const ArmRoom& room, Array<const double, 3> allowed, bool moves,
                  bool upwards);

}  // namespace cabinpose

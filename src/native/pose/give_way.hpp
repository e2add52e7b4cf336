// Trunks that give way: who sits between others leans, moves or turns by as little as makes room for the shoulders.
#pragma once

#include <cstdint>

#include "pose/limbs.hpp"
#include "pose/room.hpp"

namespace cabinpose {

/// Points of a person's trunk that are far from each other, each in the frame of a bone of the spine.
struct Flanks {
  Array<const std::int64_t, any> bone;
  Array<const double, any, 3> local;

  auto members() { return std::tie(bone, local); }
};

/// The sum of squares (cm2) of what trunk and shoulders lie too deep in neighbours and the car's sides.
///
/// It may stop early where `cost` and the sum make no less than `best`.
double squeeze(const ArmRoom& room, const Skeleton& skeleton, const Flanks& flanks, double cost, double best);

/// Turn and bend a trunk out of its neighbours and the car's sides, in place of q and of `vehicle_from_root`.
///
/// The way (forward lean, shift to the left, lateral bend, turn of the chest) is the one of least squeeze and discomfort, one
/// coordinate after the other. forward: cosine of the seat's yaw.
void give_way(MovedPosture q, const RestArrays& rest, Array<double, 4, 4> vehicle_from_root, double forward, const ArmRoom& room,
              const Flanks& flanks, JointLimits lower, JointLimits upper);

}  // namespace cabinpose

// Head and trunk towards something: where a person looks, and how the trunk follows a hand that reaches far.
#pragma once

#include "pose/limbs.hpp"

namespace cabinpose {

/// Turn neck and head in q, in place, so that the head's frame has the rotation of `vehicle_from_head`; what is missed, rad.
double turn_head(MovedPosture q, const RestArrays& rest, Placement vehicle_from_root, Array<const double, 4, 4> vehicle_from_head,
                 JointLimits lower, JointLimits upper);

/// Bend and turn the trunk in q, in place, just so far that the shoulder of `side` comes within `reach` m of a point.
///
/// Returns the distance (m) still missing. Flexion and lateral bend of the loins give most, then rotation.
double lean_to_reach(MovedPosture q, const RestArrays& rest, Placement vehicle_from_root, int side, Array<const double, 3> point,
                     double reach, JointLimits lower, JointLimits upper);

}  // namespace cabinpose

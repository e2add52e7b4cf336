// The room that arms and legs have: how far it is to the car's sides, and where the own trunk and thighs are.
//
// Coarse shapes that answer in nanoseconds, so that an elbow can look for a place while a pose is made. The car's sides are
// height fields: from the middle plane of a seat sideways to the first surface. Trunk and thighs are tubes about a bone's axis:
// the skin's distance from the axis by station and azimuth. Lengths are metres, angles radians, frames those of the vehicle.
#pragma once

#include <cstdint>
#include <tuple>

#include "core/array.hpp"
#include "pose/limbs.hpp"

namespace cabinpose {

// Python reads these from the module: the shapes are made there.
inline constexpr double cell_m = 0.015;                            // of a height field
inline constexpr double back_from_y = -0.30, back_from_z = -0.15;  // first point of a backrest's front, in the back frame
inline constexpr double trunk_from_m = -0.45;  // the trunk's first station, from the thorax' origin along its axis
inline constexpr double trunk_step_m = 0.03;
inline constexpr int thigh_stations = 14;
inline constexpr double on_upper_arm[] = {0.55, 0.8, 1.0}, on_forearm[] = {0.2, 0.5, 0.8};  // stations of `ArmRoom::radii`

/// What surrounds a person's arms in one seat: `synth.posture.room.Room`, which says what each array holds.
struct ArmRoom {
  Array<const double, any, 2, any, any> sides;
  Array<const double, any> middle;
  Array<const double, any, 2> corner;
  Array<const double, any, any> back;
  Array<const double, 4, 4> back_from_vehicle;
  Array<const double, any, any> trunk;
  double trunk_x = 0.0;
  Array<const double, 3> pelvis;
  Array<const double, thigh_stations, any> thigh;
  double femur = 0.0;
  Array<const double, 6> radii;
  Array<const double, 2, any, 3> hand;
  Array<const double, 3> shoe;

  auto members() {
    return std::tie(sides, middle, corner, back, back_from_vehicle, trunk, trunk_x, pelvis, thigh, femur, radii, hand, shoe);
  }
};

/// How deep something lies in the car's sides (negative: clear), and the way out along y.
struct Depth {
  double depth, way;
};

enum Own : int { left_thigh, right_thigh, trunk };

/// Lower a height field (2, X, Z) to a mesh, seen from the plane y = middle to the left and right, in place.
///
/// corner: x, z of the field's first point · beside: nearer to the plane nothing counts.
template <class Real>
void lower_sides(Array<const Real, any, 3> vertices, Array<const std::int32_t, any, 3> faces, double middle,
                 Array<const double, 2> corner, double beside, Array<double, 2, any, any> field);

/// A ball about p of radius r in the car's sides.
Depth beside(const ArmRoom& room, Vec3 p, double r);

/// How deep a ball of radius r about p lies in the own trunk or a thigh; -1 where the tube has no station. `way`: out of it.
double in_own(const ArmRoom& room, const Skeleton& skeleton, Own which, Vec3 p, double r, Vec3& way);

/// How far a point lies behind the backrest's front (negative: before it, or beside the backrest).
double behind_front(const ArmRoom& room, Vec3 p);

/// The sum of squares (m2) of what an arm with its elbow at `elbow` lies too deep in trunk, thighs and the car.
///
/// allowed: how deep it may lie in trunk, thigh and car.
double arm_trouble(const ArmRoom& room, const Skeleton& skeleton, int side, Vec3 elbow, Vec3 allowed);

/// The shift that takes a hand out of thighs, trunk and the car's sides.
Vec3 hand_way_out(const ArmRoom& room, const Skeleton& skeleton, const Rigid& palm, int side, Vec3 allowed);

/// The shift along y that takes a shoe, at `sole`, out of tunnel and doors.
double foot_aside(const ArmRoom& room, Array<const double, 4, 4> sole, int side);

/// The shift along y that takes a leg, thigh to ankle, out of the car's sides and neighbours.
double leg_aside(const ArmRoom& room, Posture q, const RestArrays& rest, Placement vehicle_from_root, int side);

/// Bend the loins, in place of q, away from a door or pillar that a shoulder would go into. forward: cosine of the seat's yaw.
void shoulders_inside(MovedPosture q, const RestArrays& rest, Placement vehicle_from_root, const ArmRoom& room, double forward,
                      JointLimits lower, JointLimits upper);

}  // namespace cabinpose

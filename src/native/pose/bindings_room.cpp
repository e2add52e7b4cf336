#include <algorithm>

#include "core/bind.hpp"
#include "pose/elbows.hpp"
#include "pose/give_way.hpp"
#include "pose/room.hpp"

namespace cabinpose {
namespace {

using MainRotations = Array<const double, rig::n_main, 3, 3>;
using MainPositions = Array<const double, rig::n_main, 3>;
using Point = Array<const double, 3>;

/// The skeleton in two arrays, as `synth.posture.limbs.Frames` has them.
Skeleton skeleton(MainRotations rotation, MainPositions position) {
  Skeleton s;
  std::copy_n(rotation.data(), rotation.count(), s.rotations().data());
  std::copy_n(position.data(), position.count(), s.positions().data());
  return s;
}

std::pair<double, double> beside_point(const ArmRoom& room, Point p, double r) {
  const Depth d = beside(room, vec3(p.data()), r);
  return {d.depth, d.way};
}

double in_own_at(const ArmRoom& room, MainRotations rotation, MainPositions position, int which, Point p, double r) {
  Vec3 way;
  return in_own(room, skeleton(rotation, position), static_cast<Own>(which), vec3(p.data()), r, way);
}

double trouble(const ArmRoom& room, MainRotations rotation, MainPositions position, int side, Point elbow, Point allowed) {
  return arm_trouble(room, skeleton(rotation, position), side, vec3(elbow.data()), vec3(allowed.data()));
}

}  // namespace

void bind_pose_room(nb::module_& m) {
  m.attr("CELL_M") = cell_m;
  m.attr("BACK_FROM_M") = nb::make_tuple(back_from_y, back_from_z);
  m.attr("TRUNK_FROM_M") = trunk_from_m;
  m.attr("TRUNK_STEP_M") = trunk_step_m;
  m.attr("THIGH_STATIONS") = thigh_stations;
  m.attr("ON_UPPER_ARM") = nb::make_tuple(on_upper_arm[0], on_upper_arm[1], on_upper_arm[2]);
  m.attr("ON_FOREARM") = nb::make_tuple(on_forearm[0], on_forearm[1], on_forearm[2]);
  m.def("lower_sides", &lower_sides<double>, "vertices"_a, "faces"_a, "middle"_a, "corner"_a, "beside"_a, "field"_a, unlocked(),
        "Lower a height field to a mesh, in place.");
  m.def("lower_sides", &lower_sides<float>, "vertices"_a, "faces"_a, "middle"_a, "corner"_a, "beside"_a, "field"_a, unlocked());
  m.def("beside", &beside_point, "room"_a, "p"_a, "r"_a, unlocked(),
        "How deep a ball lies in the car's sides (m, negative: clear), and the way out along y.");
  m.def("in_own", &in_own_at, "room"_a, "rotation"_a, "position"_a, "which"_a, "p"_a, "r"_a, unlocked(),
        "How deep a ball lies in the trunk (`which` 2) or a thigh (0 left, 1 right), m.");
  m.def("arm_trouble", &trouble, "room"_a, "rotation"_a, "position"_a, "side"_a, "elbow"_a, "allowed"_a, unlocked(),
        "The sum of squares (m2) of what an arm lies too deep in trunk, thighs and the car.");
  m.def("foot_aside", &foot_aside, "room"_a, "sole"_a, "side"_a, unlocked(),
        "The shift along y (m) that takes a shoe out of tunnel and doors.");
  m.def("leg_aside", &leg_aside, "room"_a, "q"_a, "rest"_a, "vehicle_from_root"_a, "side"_a, unlocked(),
        "The shift along y (m) that takes a leg out of the car's sides and neighbours.");
  m.def("shoulders_inside", &shoulders_inside, "q"_a, "rest"_a, "vehicle_from_root"_a, "room"_a, "forward"_a, "lower"_a,
        "upper"_a, unlocked(), "Bend the loins away from what a shoulder would go into, in place of q.");
  m.def("give_way", &give_way, "q"_a, "rest"_a, "vehicle_from_root"_a, "forward"_a, "room"_a, "flanks"_a, "lower"_a, "upper"_a,
        unlocked(), "Turn and bend a trunk out of its neighbours and the car's sides, in place of q and vehicle_from_root.");
  m.def("settle_arm", &settle_arm, "q"_a, "rest"_a, "vehicle_from_root"_a, "side"_a, "lower"_a, "upper"_a, "task"_a, "room"_a,
        "allowed"_a, "moves"_a, "upwards"_a, unlocked(), "Turn an arm out of what is in its way, in place of q; the miss, m.");
}

}  // namespace cabinpose

// Whole-body inverse kinematics of people in a car: damped least squares over pelvis and every degree of freedom.
//
// What is sought are weighted tasks (palms, soles, head at targets; a comfortable posture; the pelvis in its seat), bounds on
// every axis, and clearance: points of the skin against the car's distance fields, against the own solids and those of others,
// with the indentation that foam, cloth and flesh allow. The stack of weighted tasks is that of robots' inverse kinematics
// (Levenberg 1944, Marquardt 1963; Sugihara 2011 for limits and prioritised errors). People give way to each other in turns,
// step by step. Lengths are metres, angles radians, frames those of the vehicle.
#pragma once

#include <cstdint>
#include <tuple>
#include <vector>

#include "contact/grid.hpp"
#include "pose/samples.hpp"

namespace cabinpose {

/// What one person seeks: `synth.posture.goals.Goals`.
struct GoalArrays {
  Array<const double, rig::n_dofs> posture, stiffness, lower, upper;
  Array<const double, 4, 4> root;
  Array<const double, 6> root_weight;
  Array<const std::int32_t, any> bone;
  Array<const double, any, 4, 4> tool;
  Array<const std::int32_t, any> base;
  Array<const double, any, 4, 4> target;
  Array<const double, any, 6> weight;

  CABINPOSE_FIELDS(GoalArrays, posture, stiffness, lower, upper, root, root_weight, bone, tool, base, target, weight)
};

/// Somebody to be posed, from `q` and `root` on, which are written in place.
struct Mover {
  enum Stand : int {
    fresh,    // goes to its goals first, through everything
    settled,  // has been solved, and gives way from where it is
    fixed     // stays
  };

  RestArrays rest;
  SampleArrays samples;
  GoalArrays goals;
  Array<const double, any, any> leave;  // (S, G) m by which a solid may go deeper into a group; inf: it is not tested
  Array<const double, any> beside;      // (S,) m that a solid keeps from what it does not stand on, beside that
  Array<const double, any, 3> way;      // (G, 3) the only way out of a group that is thin and behind or below; 0: any
  double middle = 0.0;                  // y of the seat's middle
  Array<double, rig::n_dofs> q;
  Array<double, 4, 4> root;
  int stand = fresh;

  CABINPOSE_FIELDS(Mover, rest, samples, goals, leave, beside, way, middle, q, root, stand)
};

/// A group of the car's parts where it stands; bones must stay out of foam that gives by `give` (0: they are not tested).
///
/// walls: whether it is the body with its thin walls, of which the side next to a person's seat counts.
struct PlacedGrid {
  FieldGrid field;
  Array<const double, 4, 4> group_from_vehicle;
  double give = 0.0;
  bool walls = false;

  CABINPOSE_FIELDS(PlacedGrid, field, group_from_vehicle, give, walls)
};

/// Which solids of a body are tested with each other: points of the first against the surface of the second.
struct PairArrays {
  Array<const std::int64_t, any, 2> pairs;
  Array<const double, any> allowed;
  Array<const std::int64_t, any, 2> joint_ends;  // joints of `core.skeleton.JOINTS`, or -1
  Array<const double, any> zones;
  Array<const std::int64_t, any> side;     // +1, -1: the first is the left, the right leg against the other one; else 0
  Array<const std::int64_t, any, 3> axes;  // solid and joints of each bone that must stay out of foam
  Array<const double, any> axis_from;      // the share of it that is left out

  CABINPOSE_FIELDS(PairArrays, pairs, allowed, joint_ends, zones, side, axes, axis_from)
};

/// The worst that is left of a person: what it is with, which two, and by how much more than allowed (m).
struct Squeeze {
  enum Kind : int { none, self, person, car };
  int kind = none;
  std::int64_t solid = -1, other = -1;
  double excess = 0.0;

  auto result() const { return std::tuple(kind, solid, other, excess); }
};

/// Pose everybody at once, through everything where `free`; missed: (T, 2) for each person, what each task is off by (m, rad).
///
/// Throws std::invalid_argument where the arrays do not fit each other.
std::vector<Squeeze> solve_people(const std::vector<Mover>& people, const std::vector<PlacedGrid>& car, const PairArrays& pairs,
                                  double between, bool free, const std::vector<Array<double, any, 2>>& missed);

}  // namespace cabinpose

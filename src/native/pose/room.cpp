#include "pose/room.hpp"

#include <algorithm>
#include <cmath>
#include <vector>

#include "core/math.hpp"

namespace cabinpose {
namespace {

constexpr double calf = 0.75;    // a calf's radius, of the thigh's
constexpr double foam_m = 0.05;  // a backrest gives way to flesh, not to the bone within
constexpr double loins_to_shoulder_m = 0.40;
constexpr double deltoid_m = 0.01;  // more than the upper arm's own radius

/// The whole number at or below x. Neither build has to call the C library for it, as the baseline's `std::floor` does.
Index floor_of(double x) {
  const Index i = static_cast<Index>(x);
  return i - (x < static_cast<double>(i));
}

/// Rows and columns of a height field next to a point.
struct Cell {
  int i_below, i_above, j_below, j_above;
};

Cell cell_at(double i, double j) {
  constexpr double far = 1e9;
  i = std::min(std::max(-far, i), far);
  j = std::min(std::max(-far, j), far);
  const int i_cut = static_cast<int>(i), j_cut = static_cast<int>(j);
  return {i_cut - (i < i_cut), i_cut + (i > i_cut), j_cut - (j < j_cut), j_cut + (j > j_cut)};
}

Vec3 between(Vec3 a, Vec3 b, double t) { return a + t * (b - a); }

/// A tube's radius between stations and azimuths (turns); 0 beyond its ends.
template <class Tube>
double radius_at(const Tube& tube, double station, double turn) {
  const Index n = tube.size(0), m = tube.size(1), i = std::min(static_cast<Index>(station), n - 2);
  const double u = station - static_cast<double>(i);
  const double place = (turn - std::floor(turn)) * static_cast<double>(m) - 0.5;
  const Index j = floor_of(place);
  const double v = place - static_cast<double>(j);
  const Index a = j < 0 ? j + m : j, b = j + 1 < m ? j + 1 : j + 1 - m;
  return (1.0 - u) * ((1.0 - v) * tube(i, a) + v * tube(i, b)) + u * ((1.0 - v) * tube(i + 1, a) + v * tube(i + 1, b));
}

/// How deep the nearer shoulder lies in the car's sides, + at the left.
double shoulder_depth(const ArmRoom& room, const Skeleton& skeleton) {
  double deepest = 0.0, result = 0.0;
  for (int side = 0; side < 2; ++side) {
    const double depth = beside(room, skeleton.position[rig::limb(rig::upperarm, side)], room.radii[0] + deltoid_m).depth;
    if (depth > deepest) {
      deepest = depth;
      result = depth * (1.0 - 2.0 * side);
    }
  }
  return result;
}

}  // namespace

template <class Real>
void lower_sides(Array<const Real, any, 3> vertices, Array<const std::int32_t, any, 3> faces, double middle,
                 Array<const double, 2> corner, double beside, Array<double, 2, any, any> field) {
  const double x0 = corner[0], z0 = corner[1];
  const int nx = static_cast<int>(field.size(1)), nz = static_cast<int>(field.size(2));
  // Rows and columns of the field at and about each vertex: most faces lie between them, and are done with four comparisons.
  thread_local std::vector<Cell> cells;
  cells.resize(static_cast<std::size_t>(vertices.size()));
  Cell* const cell = cells.data();
  for (Index v = 0; v < vertices.size(); ++v) {
    const Real* p = &vertices(v, 0);
    cell[v] = cell_at((static_cast<double>(p[0]) - x0) / cell_m, (static_cast<double>(p[2]) - z0) / cell_m);
  }
  for (Index k = 0; k < faces.size(); ++k) {
    const std::int32_t* f = &faces(k, 0);
    const Cell &ca = cell[f[0]], &cb = cell[f[1]], &cc = cell[f[2]];
    const int i0 = std::max(std::min({ca.i_above, cb.i_above, cc.i_above}), 0);
    const int i1 = std::min(std::max({ca.i_below, cb.i_below, cc.i_below}), nx - 1);
    const int j0 = std::max(std::min({ca.j_above, cb.j_above, cc.j_above}), 0);
    const int j1 = std::min(std::max({ca.j_below, cb.j_below, cc.j_below}), nz - 1);
    if (i0 > i1 || j0 > j1) continue;
    const Vec3 a = vec3(&vertices(f[0], 0)), b = vec3(&vertices(f[1], 0)), c = vec3(&vertices(f[2], 0));
    const double area = (b.x - a.x) * (c.z - a.z) - (c.x - a.x) * (b.z - a.z);
    if (std::fabs(area) < 1e-12) continue;
    for (int i = i0; i <= i1; ++i) {
      for (int j = j0; j <= j1; ++j) {
        const double x = x0 + i * cell_m, z = z0 + j * cell_m;
        const double u = ((x - a.x) * (c.z - a.z) - (c.x - a.x) * (z - a.z)) / area;
        const double v = ((b.x - a.x) * (z - a.z) - (x - a.x) * (b.z - a.z)) / area;
        if (u < -1e-9 || v < -1e-9 || u + v > 1.0 + 1e-9) continue;
        const double away = a.y + u * (b.y - a.y) + v * (c.y - a.y) - middle;
        if (std::fabs(away) > beside) {
          double& nearest = field(away > 0.0 ? 0 : 1, i, j);
          nearest = std::min(nearest, std::fabs(away));
        }
      }
    }
  }
}

template void lower_sides(Array<const float, any, 3>, Array<const std::int32_t, any, 3>, double, Array<const double, 2>, double,
                          Array<double, 2, any, any>);
template void lower_sides(Array<const double, any, 3>, Array<const std::int32_t, any, 3>, double, Array<const double, 2>, double,
                          Array<double, 2, any, any>);

Depth beside(const ArmRoom& room, Vec3 p, double r) {
  Depth deepest{-1.0, 0.0};
  const Index nx = room.sides.size(2), nz = room.sides.size(3);
  // The middle of the ball, and four points on it; of a point there is one.
  const double step = 0.8 * r, dx[] = {0.0, step, -step, 0.0, 0.0}, dz[] = {0.0, 0.0, 0.0, step, -step};
  const int points = r > 0.0 ? 5 : 1;
  for (Index m = 0; m < room.sides.size(); ++m) {
    const double away = p.y - room.middle[m];
    const int side = away > 0.0 ? 0 : 1;
    for (int k = 0; k < points; ++k) {
      const Index i = floor_of((p.x + dx[k] - room.corner(m, 0)) / cell_m + 0.5);
      const Index j = floor_of((p.z + dz[k] - room.corner(m, 1)) / cell_m + 0.5);
      if (i < 0 || j < 0 || i >= nx || j >= nz) continue;
      const double depth = std::fabs(away) + (k == 0 ? r : 0.6 * r) - room.sides(m, side, i, j);
      if (depth > deepest.depth) deepest = {depth, side == 0 ? -1.0 : 1.0};
    }
  }
  return deepest;
}

double in_own(const ArmRoom& room, const Skeleton& skeleton, Own which, Vec3 p, double r, Vec3& way) {
  const int bone = which == trunk ? int{rig::spine01} : rig::limb(rig::thigh, which);
  const Mat3& frame = skeleton.rotation[bone];
  Vec3 local;
  for (int k = 0; k < 3; ++k) {
    for (int i = 0; i < 3; ++i) local[k] += frame[i][k] * (p[i] - skeleton.position[bone][i]);
  }
  double station, twist = 0.0, mirror = 1.0;
  if (which == trunk) {
    station = (local.z - trunk_from_m) / trunk_step_m;
    if (station < 0.0 || station > static_cast<double>(room.trunk.size() - 1)) return -1.0;
    // Pelvis and loins do not follow the thorax as a rigid body: below it the tube goes over into the pelvis.
    const double share = std::min(std::max(local.z / room.pelvis[2], 0.0), 1.0);
    if (share > 0.0) {
      const Mat3& pelvis = skeleton.rotation[rig::pelvis];
      double yaw_x = 0.0, yaw_y = 0.0;
      for (int i = 0; i < 3; ++i) {
        const double away = skeleton.position[rig::pelvis][i] - skeleton.position[bone][i];
        local.x -= share * frame[i][0] * away;
        local.y -= share * frame[i][1] * away;
        yaw_x += frame[i][0] * pelvis[i][0];
        yaw_y += frame[i][1] * pelvis[i][0];
      }
      twist = share * atan2(yaw_y, yaw_x);
    }
    local.x += share * room.pelvis[0] - room.trunk_x;
    local.y += share * room.pelvis[1];
  } else {
    station = -local.z / room.femur * (thigh_stations - 1.0);
    if (station < 0.0 || station > thigh_stations - 1.0) return -1.0;
    mirror = which == left_thigh ? 1.0 : -1.0;  // the tube is the left thigh's
  }
  const double turn = (atan2(mirror * local.y, local.x) - twist) / (2.0 * pi);
  const double radius = which == trunk ? radius_at(room.trunk, station, turn) : radius_at(room.thigh, station, turn);
  if (radius == 0.0) return -1.0;
  const double distance = std::sqrt(local.x * local.x + local.y * local.y);
  for (int i = 0; i < 3; ++i) way[i] = (frame[i][0] * local.x + frame[i][1] * local.y) / std::max(distance, 1e-6);
  return radius + r - distance;
}

double behind_front(const ArmRoom& room, Vec3 p) {
  double local[3];  // in the back frame
  for (int i = 0; i < 3; ++i) {
    const double* m = &room.back_from_vehicle(i, 0);
    local[i] = m[0] * p.x + m[1] * p.y + m[2] * p.z + m[3];
  }
  const Index middle = floor_of((local[1] - back_from_y) / cell_m + 0.5), j = floor_of((local[2] - back_from_z) / cell_m + 0.5);
  double deepest = -1.0;
  for (Index i = middle - 1; i <= middle + 1; ++i) {  // a bolster's edge
    if (i >= 0 && j >= 0 && i < room.back.size(0) && j < room.back.size(1)) {
      deepest = std::max(deepest, room.back(i, j) - local[0]);
    }
  }
  return deepest;
}

double arm_trouble(const ArmRoom& room, const Skeleton& skeleton, int side, Vec3 elbow, Vec3 allowed) {
  const Vec3 shoulder = skeleton.position[rig::limb(rig::upperarm, side)], wrist = skeleton.position[rig::limb(rig::hand, side)];
  double total = 0.0;
  Vec3 way;
  auto add = [&total](double depth) {
    if (depth > 0.0) total += depth * depth;
  };
  for (int k = 0; k < 6; ++k) {
    const Vec3 p = k < 3 ? between(shoulder, elbow, on_upper_arm[k]) : between(elbow, wrist, on_forearm[k - 3]);
    const double r = room.radii[k];
    add(beside(room, p, r).depth - allowed[2]);
    add(behind_front(room, p) + std::max(r - foam_m, 0.0));
    if (k > 0) add(in_own(room, skeleton, trunk, p, r, way) - allowed[0]);
    if (k > 1) {
      add(in_own(room, skeleton, left_thigh, p, r, way) - allowed[1]);
      add(in_own(room, skeleton, right_thigh, p, r, way) - allowed[1]);
    }
  }
  return total;
}

Vec3 hand_way_out(const ArmRoom& room, const Skeleton& skeleton, const Rigid& palm, int side, Vec3 allowed) {
  double deepest[4] = {};  // in the two thighs, the trunk and the car
  Vec3 ways[4];
  for (Index n = 0; n < room.hand.size(1); ++n) {
    const double* point = &room.hand(side, n, 0);
    Vec3 p = palm.position;
    for (int i = 0; i < 3; ++i) {
      for (int k = 0; k < 3; ++k) p[i] += palm.rotation[i][k] * point[k];
    }
    for (const Own which : {left_thigh, right_thigh, trunk}) {
      Vec3 way;
      const double depth = in_own(room, skeleton, which, p, 0.0, way) - (which == trunk ? allowed[0] : allowed[1]);
      if (depth > deepest[which]) {
        deepest[which] = depth;
        ways[which] = way;
      }
    }
    const Depth car = beside(room, p, 0.0);
    if (car.depth - allowed[2] > deepest[3]) {
      deepest[3] = car.depth - allowed[2];
      ways[3].y = car.way;
    }
  }
  Vec3 out;
  for (int k = 0; k < 4; ++k) out = out + deepest[k] * ways[k];
  return out;
}

double foot_aside(const ArmRoom& room, Array<const double, 4, 4> sole, int side) {
  Depth deepest{0.0, 0.0};
  for (int n = 0; n < 6; ++n) {
    const double along[] = {0.0, 0.6, 0.95};
    const double x = along[n % 3] * room.shoe[0], y = room.shoe[1 + n / 3] * (1.0 - 2.0 * side);
    const double px = sole(0, 3) + sole(0, 0) * x + sole(0, 1) * y, py = sole(1, 3) + sole(1, 0) * x + sole(1, 1) * y;
    for (const double up : {0.03, 0.06}) {
      const Depth found = beside(room, {px, py, sole(2, 3) + up}, 0.005);
      if (found.depth > deepest.depth) deepest = found;
    }
  }
  return deepest.way * deepest.depth;
}

double leg_aside(const ArmRoom& room, Posture q, const RestArrays& rest, Placement vehicle_from_root, int side) {
  Skeleton skeleton;
  skeleton.move(q, rest, vehicle_from_root);
  const Vec3 hip = skeleton.position[rig::limb(rig::thigh, side)], knee = skeleton.position[rig::limb(rig::shank, side)],
             ankle = skeleton.position[rig::limb(rig::foot, side)];
  double girth = 0.0;
  for (Index k = 0; k < room.thigh.size(1); ++k) girth += room.thigh(thigh_stations / 2, k);
  girth /= static_cast<double>(room.thigh.size(1));
  const struct {
    Vec3 from, to;
    double along, radius;
  } places[] = {{hip, knee, 0.6, girth},
                {hip, knee, 0.95, girth},
                {knee, ankle, 0.15, calf * girth},
                {knee, ankle, 0.45, calf * girth},
                {knee, ankle, 0.75, calf * girth}};
  Depth deepest{0.0, 0.0};
  for (const auto& place : places) {
    const Depth found = beside(room, between(place.from, place.to, place.along), place.radius);
    if (found.depth > deepest.depth) deepest = found;
  }
  return deepest.way * deepest.depth;
}

void shoulders_inside(MovedPosture q, const RestArrays& rest, Placement vehicle_from_root, const ArmRoom& room, double forward,
                      JointLimits lower, JointLimits upper) {
  constexpr int bend = rig::lumbar_flexion + 1;  // to the side
  Skeleton skeleton;
  for (int round = 0; round < 3; ++round) {
    skeleton.move(q, rest, vehicle_from_root);
    const double depth = shoulder_depth(room, skeleton) * forward;
    if (std::fabs(depth) < 1e-3) return;
    q[bend] = std::min(std::max(q[bend] - depth / loins_to_shoulder_m, lower[bend]), upper[bend]);
  }
}

}  // namespace cabinpose

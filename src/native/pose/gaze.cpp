#include "pose/gaze.hpp"

#include <algorithm>
#include <iterator>

namespace cabinpose {
namespace {

constexpr int n_neck = 6;  // neck's and head's angles are neighbours
constexpr double neck_stiffness[n_neck] = {0.02, 0.03, 0.03, 0.03, 0.06, 0.02};

struct Joint {
  int dof;
  double ease;  // how readily it gives when a hand pulls the trunk along
};

constexpr Joint trunk[] = {
    {rig::lumbar_flexion, 1.0},      {rig::lumbar_flexion + 1, 0.5},  // lateral
    {rig::lumbar_flexion + 2, 0.35},                                  // rotation
    {rig::thorax_flexion, 0.3},      {rig::thorax_flexion + 2, 0.8},  // rotation
};
constexpr int n_trunk = std::size(trunk);
constexpr int lean_rounds = 12;
constexpr double lean_step = 1e-4;  // rad, of the finite differences
constexpr double reached_m = 1e-3;

}  // namespace

double turn_head(MovedPosture q, const RestArrays& rest, Placement vehicle_from_root, Array<const double, 4, 4> vehicle_from_head,
                 JointLimits lower, JointLimits upper) {
  Skeleton skeleton;
  skeleton.move(q, rest, vehicle_from_root);
  Chain chain;
  chain.n = n_neck;
  chain.fixed[0].rotation = skeleton.rotation[rig::spine01];
  for (int i = 1; i <= n_neck; ++i) chain.fixed[i].rotation = identity();
  const Vec3 axes[] = {{0, 1, 0}, {-1, 0, 0}, {0, 0, 1}, {0, 1, 0}, {-1, 0, 0}, {0, 0, 1}};
  std::copy_n(axes, n_neck, chain.axes);
  constexpr double upright[n_neck] = {};
  const Goal goal{rigid(vehicle_from_head.data()), {}, {1.0, 1.0, 1.0}, upright, neck_stiffness};
  double* angles = &q(rig::neck_flexion);
  std::copy_n(upright, n_neck, angles);
  const Limits limits{&lower(rig::neck_flexion), &upper(rig::neck_flexion)};
  return solve_chain(chain, limits, goal, angles, 25, 0.0).rotation;
}

double lean_to_reach(MovedPosture q, const RestArrays& rest, Placement vehicle_from_root, int side, Array<const double, 3> point,
                     double reach, JointLimits lower, JointLimits upper) {
  Skeleton skeleton;
  const auto distance = [&] {
    skeleton.move(q, rest, vehicle_from_root);
    return norm(vec3(point.data()) - skeleton.position[rig::limb(rig::upperarm, side)]);
  };
  double missing = 0.0;
  for (int round = 0; round < lean_rounds; ++round) {
    missing = distance() - reach;
    if (missing < reached_m) return std::max(missing, 0.0);
    double gradient[n_trunk], square = 0.0;
    for (int i = 0; i < n_trunk; ++i) {
      double& angle = q(trunk[i].dof);
      const double old = angle;
      angle = old + lean_step;
      gradient[i] = (distance() - reach - missing) / lean_step;
      angle = old;
      square += trunk[i].ease * gradient[i] * gradient[i];
    }
    if (square < 1e-9) return missing;
    for (int i = 0; i < n_trunk; ++i) {
      const int dof = trunk[i].dof;
      const double step = std::min(std::max(-missing * trunk[i].ease * gradient[i] / square, -0.2), 0.2);
      q(dof) = std::min(std::max(q(dof) + step, lower(dof)), upper(dof));
    }
  }
  return missing;
}

}  // namespace cabinpose

#include "pose/limbs.hpp"

#include <algorithm>
#include <cmath>

#include "pose/two_bone.hpp"

namespace cabinpose {
namespace {

constexpr int rounds = 4, swivels = 36;
constexpr double kept = 0.5;  // of the prior's pull at the end: it settles slants that a task leaves nearly free, for 0.3 mm
constexpr double comfortable_reach = 0.93;  // of the arm's length; beyond it the shoulder girdle takes part
constexpr double half_hand_m = 0.07;

double clamped(double x, double lower, double upper) { return std::min(std::max(x, lower), upper); }

/// A chain of n hinges whose frames coincide, at `base` and `origin`.
Chain hinges(int n, const Mat3& base, Vec3 origin) {
  Chain chain;
  chain.n = n;
  for (int i = 1; i <= n; ++i) chain.fixed[i].rotation = identity();
  chain.fixed[0] = {base, origin};
  return chain;
}

/// Turn the clavicle's two angles, so that the shoulder follows a target that is far, or that the arm alone misses (m).
void draw_girdle(double* girdle, const double* lower, const double* upper, const RestArrays& rest, int side, const Mat3& thorax,
                 Vec3 shoulder, Vec3 target, double missed) {
  const double s = 1.0 - 2.0 * side;
  const double length =
      norm(vec3(&rest.offsets(rig::limb(rig::forearm, side), 0))) + norm(vec3(&rest.offsets(rig::limb(rig::hand, side), 0)));
  // The palm's own place stands for the wrist's: half the hand is a small part of the reach.
  const Vec3 to_target = transposed(thorax) * (target - shoulder);
  const double distance = norm(to_target);
  const double excess = std::max(distance - comfortable_reach * (length + half_hand_m), 0.0) + missed;
  if (!(excess > 0.0 && distance > 0.0)) return;
  const double lever = std::max(norm(vec3(&rest.offsets(rig::limb(rig::upperarm, side), 0))), 0.05);
  const double raised = girdle[0] + excess * to_target.z / distance / lever;
  double forward = girdle[1] + excess * to_target.x / distance / lever;
  if (s * to_target.y < 0.0) forward += 0.5 * excess * std::fabs(to_target.y) / distance / lever;  // across the chest
  girdle[0] = clamped(raised, lower[0], upper[0]);
  girdle[1] = clamped(forward, lower[1], upper[1]);
}

}  // namespace

Rigid vehicle_from_palm(const RestArrays& rest, const Skeleton& skeleton, int side) {
  const int hand = rig::limb(rig::hand, side);
  const Rigid palm = rigid(&rest.palms(side, 0, 0));
  return {skeleton.rotation[hand] * palm.rotation, skeleton.rotation[hand] * palm.position + skeleton.position[hand]};
}

Chain arm_chain(const RestArrays& rest, int side, const Mat3& thorax, Vec3 shoulder) {
  const double s = 1.0 - 2.0 * side;
  Chain chain = hinges(n_arm, thorax, shoulder);
  chain.fixed[3].position = vec3(&rest.offsets(rig::limb(rig::forearm, side), 0));
  chain.fixed[5].position = vec3(&rest.offsets(rig::limb(rig::hand, side), 0));
  chain.fixed[7] = rigid(&rest.palms(side, 0, 0));
  const Vec3 axes[] = {{0, -1, 0}, {s, 0, 0}, {0, 0, -s}, {0, -1, 0}, {0, 0, -s}, {-s, 0, 0}, {0, -1, 0}};
  std::copy_n(axes, n_arm, chain.axes);
  return chain;
}

Chain leg_chain(const RestArrays& rest, int side, const Mat3& pelvis, Vec3 hip) {
  const double s = 1.0 - 2.0 * side;
  Chain chain = hinges(n_leg, pelvis, hip);
  chain.fixed[3].position = vec3(&rest.offsets(rig::limb(rig::shank, side), 0));
  chain.fixed[4].position = vec3(&rest.offsets(rig::limb(rig::foot, side), 0));
  chain.fixed[6] = rigid(&rest.soles(side, 0, 0));
  const Vec3 axes[] = {{0, -1, 0}, {s, 0, 0}, {0, 0, -s}, {0, 1, 0}, {0, -1, 0}, {-s, 0, 0}};
  std::copy_n(axes, n_leg, chain.axes);
  return chain;
}

Residual solve_arm(MovedPosture q, const RestArrays& rest, Placement vehicle_from_root, int side, JointLimits lower,
                   JointLimits upper, const ArmTask& task) {
  const Goal goal = task.goal();
  const int first = first_of_arm(side), girdle = rig::dof(rig::elevation, side);
  const Limits limits{lower.data() + first, upper.data() + first};
  const bool oriented = goal.rotation_weight.x > 0.0 && goal.rotation_weight.z > 0.0;
  Skeleton skeleton;
  Residual residual{};
  for (int round = 0; round < rounds; ++round) {
    skeleton.move(q, rest, vehicle_from_root);
    const Mat3& thorax = skeleton.rotation[rig::spine01];
    const Vec3 shoulder = skeleton.position[rig::limb(rig::upperarm, side)];
    const Chain chain = arm_chain(rest, side, thorax, shoulder);
    double* angles = &q(first);
    if (round == 0) seed_limb(chain, limits, 0, goal.target, oriented, goal.prior, goal.stiffness, swivels, angles);
    residual = solve_chain(chain, limits, goal, angles, round == 0 ? 30 : 12, kept);
    if (round == 0) {
      draw_girdle(&q(girdle), lower.data() + girdle, upper.data() + girdle, rest, side, thorax, shoulder, goal.target.position,
                  residual.position);
    }
  }
  // The last round moved the humerus, and with it the shoulder: what is missed is measured on the skeleton.
  skeleton.move(q, rest, vehicle_from_root);
  const Vec3 away = vehicle_from_palm(rest, skeleton, side).position - goal.target.position;
  double missed = 0.0;
  for (int k = 0; k < 3; ++k) {
    const double along = dot(goal.target.rotation.column(k), away);
    if (goal.position_weight[k] > 0.0) missed += along * along;
  }
  return {std::sqrt(missed), residual.rotation};
}

Residual solve_leg(MovedPosture q, const RestArrays& rest, Placement vehicle_from_root, int side, JointLimits lower,
                   JointLimits upper, const LegTask& task) {
  const Goal goal = task.goal();
  const int first = first_of_leg(side);
  const Limits limits{lower.data() + first, upper.data() + first};
  Skeleton skeleton;
  skeleton.move(q, rest, vehicle_from_root);
  const Chain chain = leg_chain(rest, side, skeleton.rotation[rig::pelvis], skeleton.position[rig::limb(rig::thigh, side)]);
  // The closed form takes the ankle to where the target's sole puts it: the ankle in the sole frame is -R^T t.
  const Rigid& sole = chain.fixed[n_leg];
  const Vec3 ankle = goal.target.position - goal.target.rotation * (transposed(sole.rotation) * sole.position);
  Chain to_ankle = hinges(4, chain.fixed[0].rotation, chain.fixed[0].position);
  std::copy_n(chain.fixed, 5, to_ankle.fixed);
  std::copy_n(chain.axes, 4, to_ankle.axes);
  double* angles = &q(first);
  std::copy_n(goal.prior, n_leg, angles);
  seed_limb(to_ankle, limits, 0, {identity(), ankle}, false, goal.prior, goal.stiffness, swivels, angles);
  return solve_chain(chain, limits, goal, angles, 40, kept);
}

}  // namespace cabinpose

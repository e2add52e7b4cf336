#include "pose/elbows.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>

#include "core/math.hpp"
#include "pose/two_bone.hpp"

namespace cabinpose {
namespace {

constexpr double step = 8.0 * (pi / 180.0);  // of the swivel
constexpr int steps = 13;                    // to either side
// Cost of a squared metre too deep, of a radian beyond a limit, of a radian of swivel.
constexpr double trouble_cost = 100.0, beyond_cost = 10.0, ease_cost = 0.008;
constexpr double troubled_m2 = 1e-6;
constexpr double moved_m = 1e-3;   // a hand that lies less deep than this stays
constexpr double firmer = 4.0;     // the shoulder's stiffness at the place that was found
constexpr double held = 20.0;      // cost of a squared metre by which a hand that holds something leaves it
constexpr double free_cost = 0.3;  // of another hand
constexpr int rounds = 3;

/// One arm, and what it has to mind.
struct Arm {
  const RestArrays& rest;
  Placement root;
  int side;
  JointLimits lower, upper;
  const ArmRoom& room;
  Vec3 allowed;

  Limits limits() const { return {&lower[first_of_arm(side)], &upper[first_of_arm(side)]}; }
  Vec3 elbow(const Skeleton& s) const { return s.position[rig::limb(rig::forearm, side)]; }
  Chain chain(const Skeleton& s) const {
    return arm_chain(rest, side, s.rotation[rig::spine01], s.position[rig::limb(rig::upperarm, side)]);
  }
};

/// Improve an arm that is nearly there, in place of q, from where it is; the skeleton follows.
void follow(MovedPosture q, const Arm& arm, const Goal& goal, Skeleton& skeleton) {
  for (int k = 0; k < 2; ++k) {
    skeleton.move(q, arm.rest, arm.root);
    solve_chain(arm.chain(skeleton), arm.limits(), goal, &q[first_of_arm(arm.side)], 12, 0.5);
  }
  skeleton.move(q, arm.rest, arm.root);
}

/// Set the shoulder's and elbow's angles in `prior` to the swivel of least trouble.
void swivel(MovedPosture q, const Arm& arm, const Skeleton& skeleton, double* prior) {
  const int first = first_of_arm(arm.side);
  const Vec3 shoulder = skeleton.position[rig::limb(rig::upperarm, arm.side)], elbow = arm.elbow(skeleton);
  Vec3 line = skeleton.position[rig::limb(rig::hand, arm.side)] - shoulder;
  const double length = std::max(norm(line), 1e-6);
  line = {line.x / length, line.y / length, line.z / length};
  const Mat3 thorax_from_vehicle = transposed(skeleton.rotation[rig::spine01]);
  const Mat3& bone = skeleton.rotation[rig::limb(rig::upperarm, arm.side)];
  const Chain chain = arm.chain(skeleton);
  const Limits limits = arm.limits();
  double best = std::numeric_limits<double>::infinity();
  // From where the elbow is to both sides, so that most of the far ones need not be looked at.
  for (int n = 0; n <= 2 * steps; ++n) {
    const int k = n % 2 == 0 ? n / 2 : -(n + 1) / 2;
    double cost = ease_cost * ((k * step) * (k * step));
    if (cost >= best) break;  // whatever follows only adds to it
    const Mat3 swing = hinge_rotation(line, k * step);
    const Vec3 place = shoulder + swing * (elbow - shoulder);
    const Vec3 angles = euler_near(thorax_from_vehicle * swing * bone, chain.axes, vec3(&q[first]));
    for (int i = 0; i < 3; ++i) {
      const double beyond = std::max({limits.lower[i] - angles[i], angles[i] - limits.upper[i], 0.0});
      cost += beyond_cost * beyond * beyond;
    }
    if (cost >= best) continue;
    cost += trouble_cost * arm_trouble(arm.room, skeleton, arm.side, place, arm.allowed);
    if (cost < best) {
      best = cost;
      for (int i = 0; i < 3; ++i) prior[i] = angles[i];
    }
  }
  prior[3] = q[first + 3];
}

}  // namespace

double settle_arm(MovedPosture q, const RestArrays& rest, Placement vehicle_from_root, int side, JointLimits lower,
                  JointLimits upper, const ArmTask& task, const ArmRoom& room, Array<const double, 3> allowed, bool moves,
                  bool upwards) {
  const Arm arm{rest, vehicle_from_root, side, lower, upper, room, vec3(allowed.data())};
  std::array<double, n_arm> prior, firm;
  std::copy_n(task.prior.data(), n_arm, prior.begin());
  std::copy_n(task.stiffness.data(), n_arm, firm.begin());
  Goal goal = task.goal();
  goal.prior = prior.data();
  goal.stiffness = firm.data();
  std::array<double, rig::n_dofs> best;
  std::copy_n(q.data(), rig::n_dofs, best.begin());
  double best_cost = std::numeric_limits<double>::infinity(), miss = 0.0;
  Skeleton skeleton;
  skeleton.move(q, rest, vehicle_from_root);
  for (int round = 0;; ++round) {
    const Rigid palm = vehicle_from_palm(rest, skeleton, side);
    const double trouble = arm_trouble(room, skeleton, side, arm.elbow(skeleton), arm.allowed);
    const Vec3 shift = moves ? hand_way_out(room, skeleton, palm, side, arm.allowed) : Vec3{};
    const double depth = norm(shift);
    const Vec3 away = palm.position - goal.target.position;
    const double cost = trouble + depth * depth + (moves ? free_cost : held) * dot(away, away);
    if (cost < best_cost - 1e-7) {
      best_cost = cost;
      miss = norm(away);
      std::copy_n(q.data(), rig::n_dofs, best.begin());
    }
    if (round == rounds || (trouble < troubled_m2 && depth < moved_m)) break;
    if (depth >= moved_m) {
      if (upwards) {
        goal.target.position.z += depth;
      } else {
        goal.target.position = goal.target.position + shift;
      }
    }
    if (trouble >= troubled_m2) {
      swivel(q, arm, skeleton, prior.data());
      for (std::size_t i = 0; i < 4; ++i) firm[i] = (moves ? firmer : 1.0) * task.stiffness[static_cast<Index>(i)];
    }
    follow(q, arm, goal, skeleton);
  }
  std::copy(best.begin(), best.end(), q.data());
  return miss;
}

}  // namespace cabinpose

#include <algorithm>
#include <stdexcept>
#include <string>

#include "core/bind.hpp"
#include "pose/gaze.hpp"
#include "pose/limbs.hpp"
#include "pose/two_bone.hpp"

namespace cabinpose {
namespace {

/// A chain of any length: `synth.posture.chain.Chain`.
struct ChainArrays {
  Array<const double, any, 4, 4> fixed;
  Array<const double, any, 3> axes;
  Array<const double, any> lower;
  Array<const double, any> upper;
  Array<const std::int64_t, any> dofs;

  auto members() { return std::tie(fixed, axes, lower, upper, dofs); }
};

using ChainTask = LimbTask<any>;  // `synth.posture.chain.Task`: the same arrays, for a chain of any length
using Angles = Array<const double, any>;

/// The chain, and that every array (N) belongs to it.
Chain checked(const ChainArrays& arrays, std::initializer_list<Angles> angles) {
  const Index n = arrays.axes.size();
  const bool fit = std::all_of(angles.begin(), angles.end(), [n](const Angles& a) { return a.size() == n; });
  if (n < 1 || n > max_hinges || arrays.fixed.size() != n + 1 || !fit) {
    throw std::invalid_argument("a chain of N hinges has N + 1 fixed frames and N angles; N is at most " +
                                std::to_string(max_hinges));
  }
  Chain chain;
  chain.n = static_cast<int>(n);
  for (Index i = 0; i <= n; ++i) chain.fixed[i] = rigid(&arrays.fixed(i, 0, 0));
  for (Index i = 0; i < n; ++i) chain.axes[i] = vec3(&arrays.axes(i, 0));
  return chain;
}

std::pair<double, double> solve(const ChainArrays& arrays, const ChainTask& task, Array<double, any> q, int iterations) {
  const Chain chain = checked(arrays, {arrays.lower, arrays.upper, task.prior, task.stiffness, q});
  const Limits limits{arrays.lower.data(), arrays.upper.data()};
  const Residual residual = solve_chain(chain, limits, task.goal(), q.data(), iterations, 0.0);
  return {residual.position, residual.rotation};
}

void tool(const ChainArrays& arrays, Angles q, Array<double, 4, 4> base_from_tool) {
  const Chain chain = checked(arrays, {q});
  Rigid frames[max_hinges + 1];
  chain_frames(chain, q.data(), frames);
  const Rigid& last = frames[chain.n];
  for (int i = 0; i < 3; ++i) {
    for (int j = 0; j < 3; ++j) base_from_tool(i, j) = last.rotation[i][j];
    base_from_tool(i, 3) = last.position[i];
    base_from_tool(3, i) = 0.0;
  }
  base_from_tool(3, 3) = 1.0;
}

void seed(const ChainArrays& arrays, int ball, Array<const double, 4, 4> target, Angles prior, Angles stiffness, bool oriented,
          int swivels, Array<double, any> q) {
  const Chain chain = checked(arrays, {arrays.lower, arrays.upper, prior, stiffness, q});
  if (ball < 0 || ball + 3 >= chain.n) throw std::invalid_argument("the chain ends before the hinge that follows the ball joint");
  const Limits limits{arrays.lower.data(), arrays.upper.data()};
  seed_limb(chain, limits, ball, rigid(target.data()), oriented, prior.data(), stiffness.data(), swivels, q.data());
}

std::tuple<double, double, double> numbers(Vec3 v) { return {v.x, v.y, v.z}; }

template <auto solve_limb, class Task>
std::pair<double, double> solved(MovedPosture q, const RestArrays& rest, Placement vehicle_from_root, int side, JointLimits lower,
                                 JointLimits upper, const Task& task) {
  const Residual residual = solve_limb(q, rest, vehicle_from_root, side, lower, upper, task);
  return {residual.position, residual.rotation};
}

void skeleton_frames(Posture q, const RestArrays& rest, Placement vehicle_from_root, Rotations rotation, Positions position,
                     Array<double, 2, 4, 4> palms, Array<double, 2, 4, 4> soles) {
  bone_frames(q, rest, vehicle_from_root, rotation, position);
  end_frames(rest, rotation, position, palms, soles);
}

}  // namespace

void bind_pose_limbs(nb::module_& m) {
  m.def("solve_chain", &solve, "chain"_a, "task"_a, "q"_a, "iterations"_a, unlocked(),
        "Improve a chain's angles, in place; the position (m) and rotation (rad) that are missed.");
  m.def("chain_tool", &tool, "chain"_a, "q"_a, "base_from_tool"_a, unlocked(), "The frame of a chain's tool.");
  m.def("seed_limb", &seed, "chain"_a, "ball"_a, "target"_a, "prior"_a, "stiffness"_a, "oriented"_a, "swivels"_a, "q"_a,
        unlocked(), "A start for the chain solver: the closed form at the best swivel.");
  m.def(
      "rotation_vector", [](Array<const double, 3, 3> r) { return numbers(rotation_vector(mat3(r.data()))); }, "r"_a, unlocked(),
      "The rotation vector of a rotation matrix, rad.");
  m.def(
      "euler_near",
      [](Array<const double, 3, 3> r, Array<const double, 3, 3> axes, Array<const double, 3> near) {
        const Vec3 rows[] = {vec3(&axes(0, 0)), vec3(&axes(1, 0)), vec3(&axes(2, 0))};
        return numbers(euler_near(mat3(r.data()), rows, vec3(near.data())));
      },
      "r"_a, "axes"_a, "near"_a, unlocked(), "Angles of a rotation about three orthogonal axes in turn, near given ones, rad.");
  m.def("skeleton_frames", &skeleton_frames, "q"_a, "rest"_a, "vehicle_from_root"_a, "rotation"_a, "position"_a, "palms"_a,
        "soles"_a, unlocked(), "Frames of main bones, palms and soles.");
  m.def("solve_arm", &solved<solve_arm, ArmTask>, "q"_a, "rest"_a, "vehicle_from_root"_a, "side"_a, "lower"_a, "upper"_a,
        "task"_a, unlocked(), "Bring a palm to its target, in place of q; the position (m) and rotation (rad) that are missed.");
  m.def("solve_leg", &solved<solve_leg, LegTask>, "q"_a, "rest"_a, "vehicle_from_root"_a, "side"_a, "lower"_a, "upper"_a,
        "task"_a, unlocked(), "Bring a sole to its target, in place of q; the position (m) and rotation (rad) that are missed.");
  m.def("turn_head", &turn_head, "q"_a, "rest"_a, "vehicle_from_root"_a, "vehicle_from_head"_a, "lower"_a, "upper"_a, unlocked(),
        "Turn neck and head to a rotation, in place of q; what is missed, rad.");
  m.def("lean_to_reach", &lean_to_reach, "q"_a, "rest"_a, "vehicle_from_root"_a, "side"_a, "point"_a, "reach"_a, "lower"_a,
        "upper"_a, unlocked(), "Lean the trunk to bring a shoulder within reach of a point, in place of q; what is missing, m.");
}

}  // namespace cabinpose

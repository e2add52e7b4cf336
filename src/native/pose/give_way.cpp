#include "pose/give_way.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>

#include "core/math.hpp"

namespace cabinpose {
namespace {

constexpr double degree = pi / 180.0;
constexpr int n_ways = 4;  // forward lean (rad), shift to the left (m), lateral bend and turn of the chest (rad)
// Of each way: the step of the search, what is as uncomfortable as a centimetre of squeeze at one point, and the most.
constexpr double steps[n_ways] = {4.0 * degree, 0.012, 3.0 * degree, 5.0 * degree};
constexpr double eases[n_ways] = {5.0 * degree, 0.015, 4.0 * degree, 7.0 * degree};
constexpr double most[n_ways] = {20.0 * degree, 0.06, 10.0 * degree, 15.0 * degree};
constexpr int sweeps = 3;
constexpr double squeeze_m = 0.006;           // that both put up with
constexpr double deltoid_m = 0.008;           // more than the upper arm's own radius
constexpr Vec3 to_elbow_m{0.14, 0.0, -0.22};  // from the shoulder, in the thorax' frame
constexpr int lateral = rig::lumbar_flexion + 1, rotation = rig::thorax_flexion + 2;

using Way = std::array<double, n_ways>;

/// A posture and its place.
struct Placed {
  std::array<double, rig::n_dofs> q;
  std::array<double, 16> root;

  MovedPosture posture() { return MovedPosture(q.data()); }
  Array<double, 4, 4> placement() { return Array<double, 4, 4>(root.data()); }
};

/// The same with a trunk that gives way.
Placed moved(const Placed& from, double forward, const Way& way) {
  Placed to = from;
  const double c = cos(way[0]), s = sin(way[0]);
  for (std::size_t i = 0; i < 3; ++i) {
    const double x = from.root[4 * i], z = from.root[4 * i + 2];
    to.root[4 * i] = c * x - s * z;
    to.root[4 * i + 2] = s * x + c * z;
  }
  to.root[7] += forward * way[1];
  to.q[lateral] += way[2];
  to.q[rotation] += way[3];
  return to;
}

}  // namespace

double squeeze(const ArmRoom& room, const Skeleton& skeleton, const Flanks& flanks, double cost, double best) {
  double total = 0.0;
  auto add = [&](Vec3 p, double r, double weight) {
    const double depth = beside(room, p, r).depth - squeeze_m;
    if (depth > 0.0) total += weight * ((100.0 * depth) * (100.0 * depth));
  };
  for (Index n = 0; n < flanks.bone.size() && cost + total < best; ++n) {
    const Index bone = flanks.bone[n];
    const Mat3& frame = skeleton.rotation[bone];
    Vec3 p = skeleton.position[bone];
    for (int i = 0; i < 3; ++i) {
      for (int k = 0; k < 3; ++k) p[i] += frame[i][k] * flanks.local(n, k);
    }
    add(p, 0.0, 1.0);
  }
  const double deltoid = room.radii[0] + deltoid_m;
  for (int side = 0; side < 2; ++side) add(skeleton.position[rig::limb(rig::upperarm, side)], deltoid, 3.0);
  for (int side = 0; side < 2; ++side) {  // where an elbow may hang
    Vec3 p = skeleton.position[rig::limb(rig::upperarm, side)];
    for (const int k : {0, 2}) p = p + to_elbow_m[k] * skeleton.rotation[rig::spine01].column(k);
    add(p, deltoid, 3.0);
  }
  return total;
}

void give_way(MovedPosture q, const RestArrays& rest, Array<double, 4, 4> vehicle_from_root, double forward, const ArmRoom& room,
              const Flanks& flanks, JointLimits lower, JointLimits upper) {
  Placed start;
  std::copy_n(q.data(), rig::n_dofs, start.q.begin());
  std::copy_n(vehicle_from_root.data(), 16, start.root.begin());
  Skeleton skeleton;
  skeleton.move(q, rest, vehicle_from_root);
  double best = squeeze(room, skeleton, flanks, 0.0, std::numeric_limits<double>::infinity());
  Way way{};
  for (int sweep = 0; sweep < sweeps; ++sweep) {
    const double before = best;
    for (const std::size_t axis : {1u, 2u, 0u, 3u}) {
      const double from = way[axis];
      for (int k = -5; k <= 5; ++k) {
        Way trial = way;
        trial[axis] = from + k * steps[axis] / (1.0 + sweep);
        if (std::fabs(trial[axis]) > most[axis] || (axis == 0 && trial[0] < 0.0)) continue;
        Placed there = moved(start, forward, trial);
        double outside = 0.0;
        for (const int d : {lateral, rotation}) {
          const double angle = there.q[static_cast<std::size_t>(d)];
          outside += std::max({lower[d] - angle, angle - upper[d], 0.0});
        }
        double cost = 1e3 * outside;
        for (std::size_t i = 0; i < n_ways; ++i) cost += (trial[i] / eases[i]) * (trial[i] / eases[i]);
        if (cost >= best) continue;
        skeleton.move(there.posture(), rest, there.placement());
        cost += squeeze(room, skeleton, flanks, cost, best);
        if (cost < best) {
          best = cost;
          way = trial;
        }
      }
    }
    if (best > 0.99 * before) break;
  }
  const Placed there = moved(start, forward, way);
  std::copy_n(there.q.begin(), rig::n_dofs, q.data());
  std::copy_n(there.root.begin(), 16, vehicle_from_root.data());
}

}  // namespace cabinpose

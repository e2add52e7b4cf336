#include "pose/seated.hpp"

#include <algorithm>
#include <vector>

#include "body/skinning.hpp"
#include "core/math.hpp"

namespace cabinpose {
namespace {

/// The mean of the `count` least of some values, which are reordered.
double lowest(std::vector<double>& values, std::size_t count) {
  const std::size_t n = std::min(count, values.size());
  std::partial_sort(values.begin(), values.begin() + static_cast<Index>(n), values.end());
  double sum = 0.0;
  for (std::size_t i = 0; i < n; ++i) sum += values[i];
  return sum / static_cast<double>(n);
}

}  // namespace

void sink(const RestArrays& rest, const Foam& foam, int rounds, Array<double, 5> state) {
  std::vector<double> q(foam.q.data(), foam.q.data() + foam.q.size());
  std::vector<double> rotation(rig::n_main * 9), position(rig::n_main * 3), transforms(rig::n_bones * 12);
  std::vector<float> skin(static_cast<std::size_t>(foam.rest.count()));
  std::vector<double> lower, upper, seat, thighs;
  const Rotations rotations(rotation.data());
  const Positions positions(position.data());
  const SkinTransforms skinned(transforms.data());
  const Vec3 normal = vec3(foam.normal.data()), up = vec3(foam.up.data()), cushion = vec3(foam.cushion.data());
  double &pitch = state[0], &thigh = state[1], &ahead = state[2], &height = state[4];
  for (int round = 0; round < rounds; ++round) {
    for (int side = 0; side < 2; ++side) {
      q[static_cast<std::size_t>(rig::dof(rig::hip_flexion, side))] = 0.5 * pi - pitch + thigh;
      q[static_cast<std::size_t>(rig::dof(rig::knee_flexion, side))] = 0.5 * pi + thigh;
    }
    const double c = cos(pitch), s = sin(pitch);
    const double root[16] = {c, 0.0, -s, ahead, 0.0, 1.0, 0.0, state[3], s, 0.0, c, height, 0.0, 0.0, 0.0, 1.0};
    bone_frames(Posture(q.data()), rest, Placement(root), rotations, positions);
    skin_transforms(Posture(q.data()), rest, rotations, positions, skinned);
    skin_layers({transforms.data(), {rig::n_bones, 3, 4}}, foam.skin_index, foam.skin_weight,
                {foam.rest.data(), {1, foam.rest.size(), 3}}, {skin.data(), {1, foam.rest.size(), 3}});
    for (auto* each : {&lower, &upper, &seat, &thighs}) each->clear();
    for (Index n = 0; n < foam.rest.size(); ++n) {
      const Vec3 p = vec3(&skin[static_cast<std::size_t>(3 * n)]);
      if (n < foam.n_back) {
        const double along = dot(p, up);
        if (along > -0.02 && along < 0.17 * foam.size) lower.push_back(dot(p, normal));
        if (along > 0.28 * foam.size && along < 0.42 * foam.size) upper.push_back(dot(p, normal));
      } else {
        const double above = dot(p, cushion) - foam.free_cushion, before = p.x - ahead;
        if (before > -0.16 && before < 0.08) seat.push_back(above);
        if (foam.thigh[n - foam.n_back] && before > 0.45 * foam.femur && before < 0.75 * foam.femur) thighs.push_back(above);
      }
    }
    const double low = lowest(lower, 6), high = lowest(upper, 6);
    if (foam.slides) {
      pitch += (high - foam.behind) / (0.35 * foam.size);
    } else {
      pitch += 0.9 * (high + 0.006 - low) / (0.27 * foam.size);
      ahead += (foam.behind - low) / normal.x;
    }
    height -= lowest(seat, 8) + foam.sunk;
    thigh -= 0.8 * (lowest(thighs, 8) + foam.thighs_sunk) / (0.6 * foam.femur);
    pitch = std::clamp(pitch, -0.2, 1.1);
    thigh = std::clamp(thigh, -0.1, 0.7);
  }
}

}  // namespace cabinpose

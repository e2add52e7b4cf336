#include "pose/motion.hpp"

#include <algorithm>

namespace cabinpose {
namespace {

using namespace rig;

constexpr double step = 1e-6;  // rad

/// What moves a bone: degrees of freedom of the trunk before `trunk_end`, and of a side from `from` to before `end`.
struct Movers {
  int trunk_end, from, end;
};

Movers movers(int bone) {
  if (bone == pelvis) return {0, 0, 0};
  if (bone <= spine01) return {6, 0, 0};
  if (bone < left) return {n_central, 0, 0};
  const int side = (bone - left) / n_limb, first = dof(0, side);
  switch ((bone - left) % n_limb) {
    case clavicle:
    case upperarm:
      return {6, first, first + elbow_flexion};  // the clavicle follows the humerus
    case forearm:
      return {6, first, first + elbow_flexion + 1};
    case hand:
      return {6, first, first + grip};
    case thigh:
      return {0, first + hip_flexion, first + knee_flexion};
    case shank:
      return {0, first + hip_flexion, first + ankle_dorsiflexion};
    default:
      return {0, first + hip_flexion, first + n_sided};
  }
}

Twist difference(const BoneFrame& from, const BoneFrame& to) {
  const Mat3 turned = to.rotation * transposed(from.rotation);
  Twist t;
  t.turn = (0.5 / step) * Vec3{turned[2][1] - turned[1][2], turned[0][2] - turned[2][0], turned[1][0] - turned[0][1]};
  t.shift = (1.0 / step) * (to.position - from.position) - cross(t.turn, from.position);
  return t;
}

}  // namespace

void BoneFrames::move(const double* q, const RestArrays& rest, const BoneFrame& root) {
  spine_frames(q, rest, root, at);
  for (int side = 0; side < 2; ++side) {
    arm_frames(q + dof(0, side), rest, side, at[spine01], at + limb(0, side));
    leg_frames(q + dof(0, side), rest, side, at[pelvis], at + limb(0, side));
  }
}

void Motion::set(const double* q, const RestArrays& rest, const BoneFrames& skeleton) {
  root_ = skeleton.at[pelvis].position;
  double moved[n_dofs];
  std::copy_n(q, n_dofs, moved);
  BoneFrame frames[n_main];
  for (int k = 0; k < n_central; ++k) {
    moved[k] = q[k] + step;
    spine_frames(moved, rest, skeleton.at[pelvis], frames);
    moved[k] = q[k];
    for (int b = spine04; b <= head; ++b) twists_[k][b] = difference(skeleton.at[b], frames[b]);
    if (k < 6) {
      for (int side = 0; side < 2; ++side) {
        for (int b = clavicle; b <= hand; ++b) twists_[k][limb(b, side)] = twists_[k][spine01];
      }
    }
  }
  for (int side = 0; side < 2; ++side) {
    const int first = dof(0, side), at = limb(0, side);
    for (int k = first; k < first + n_sided; ++k) {
      if (k == first + grip) continue;
      moved[k] = q[k] + step;
      const bool arm = k < first + grip;
      if (arm) {
        arm_frames(moved + first, rest, side, skeleton.at[spine01], frames + at);
      } else {
        leg_frames(moved + first, rest, side, skeleton.at[pelvis], frames + at);
      }
      moved[k] = q[k];
      for (int b = arm ? clavicle : thigh; b <= (arm ? hand : foot); ++b) {
        twists_[k][at + b] = difference(skeleton.at[at + b], frames[at + b]);
      }
    }
  }
}

void Motion::add_point(double* row, int bone, Vec3 point, Vec3 direction, double factor) const {
  const Vec3 d = factor * direction, about = cross(point - root_, d);
  for (int i = 0; i < 3; ++i) {
    row[i] += d[i];
    row[3 + i] += about[i];
  }
  const Vec3 moment = cross(point, d);  // d . (turn x p) = turn . (p x d)
  const Movers m = movers(bone);
  for (int k = 0; k < m.trunk_end; ++k) {
    row[n_root + k] += dot(moment, twists_[k][bone].turn) + dot(d, twists_[k][bone].shift);
  }
  for (int k = m.from; k < m.end; ++k) {
    row[n_root + k] += dot(moment, twists_[k][bone].turn) + dot(d, twists_[k][bone].shift);
  }
}

void Motion::add_turn(double* row, int bone, Vec3 axis, double factor) const {
  const Vec3 d = factor * axis;
  for (int i = 0; i < 3; ++i) row[3 + i] += d[i];
  const Movers m = movers(bone);
  for (int k = 0; k < m.trunk_end; ++k) row[n_root + k] += dot(d, twists_[k][bone].turn);
  for (int k = m.from; k < m.end; ++k) row[n_root + k] += dot(d, twists_[k][bone].turn);
}

}  // namespace cabinpose

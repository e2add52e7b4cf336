// Numbers of the rig's bones and degrees of freedom: `cabinpose.scene.body.rig` in C++; `pytest tests/body` holds the two
// together.
#pragma once

namespace cabinpose::rig {

// Main bones: the trunk, then each side's limbs.
enum : int { pelvis, spine04, spine03, spine02, spine01, neck01, neck02, neck03, head, left };  // left: where its limbs begin
enum : int { clavicle, upperarm, forearm, hand, thigh, shank, foot, n_limb };
enum : int {
  scapula,
  shoulder_half,
  upperarm_twist,
  elbow_half,
  forearm_near,
  forearm_far,
  wrist_half,
  hip_half,
  thigh_twist,
  knee_half,
  ankle_half,
  n_helpers
};
inline constexpr int n_main = left + 2 * n_limb, n_fingers = 15, first_helper = n_main, first_finger = n_main + 2 * n_helpers;
inline constexpr int n_bones = first_finger + 2 * n_fingers, n_joints = 20;

/// A limb's bone: side 0 is the left, 1 the right.
constexpr int limb(int bone, int side) { return left + side * n_limb + bone; }

// Degrees of freedom: the trunk's twelve, then each side's.
enum : int { lumbar_flexion = 0, thorax_flexion = 3, neck_flexion = 6, head_flexion = 9, n_central = 12 };
enum : int {
  elevation,
  protraction,
  shoulder_flexion,
  shoulder_abduction,
  shoulder_rotation,
  elbow_flexion,
  pronation,
  wrist_flexion,
  wrist_radial,
  grip,
  hip_flexion,
  hip_abduction,
  hip_rotation,
  knee_flexion,
  ankle_dorsiflexion,
  ankle_inversion,
  n_sided
};
inline constexpr int n_dofs = n_central + 2 * n_sided;

/// A side's degree of freedom: side 0 is the left, 1 the right.
constexpr int dof(int name, int side) { return n_central + side * n_sided + name; }

inline constexpr double scapulohumeral = 0.2;  // rad of clavicle elevation per unit of 1 - cos(arm elevation)

}  // namespace cabinpose::rig

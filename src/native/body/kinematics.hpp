// Forward kinematics, for skinning and for inverse kinematics. Axes, signs and orders are those of
// `cabinpose.scene.body.rig`; lengths are metres, angles radians, frames those of the vehicle.
#pragma once

#include <cstdint>

#include "body/rig.hpp"
#include "core/array.hpp"
#include "core/fields.hpp"
#include "core/vec.hpp"

namespace cabinpose {

/// One person's skeleton at rest: `scene.body.kinematics.RestArrays`, which says what each array holds.
struct RestArrays {
  Array<const double, rig::n_main, 3> offsets;
  Array<const double, rig::n_main, 3, 3> frames;
  Array<const double, rig::n_bones, 3> heads;
  Array<const std::int64_t, rig::n_joints> joint_bone;
  Array<const double, rig::n_joints, 3> joint_offset;
  Array<const double, 2, 4, 4> palms;
  Array<const double, 2, 4, 4> soles;
  Array<const double, 2> pronation;
  Array<const double, 2 * rig::n_fingers, 3> finger_axes;
  Array<const double, 2 * rig::n_fingers> finger_curl;

  CABINPOSE_FIELDS(RestArrays, offsets, frames, heads, joint_bone, joint_offset, palms, soles, pronation, finger_axes,
                   finger_curl)
};

using Posture = Array<const double, rig::n_dofs>;          // rad, in the order of `rig.DOFS`
using Placement = Array<const double, 4, 4>;               // vehicle_from_root
using Rotations = Array<double, rig::n_main, 3, 3>;        // vehicle_from_bone
using Positions = Array<double, rig::n_main, 3>;           // origins of the bones
using SkinTransforms = Array<double, rig::n_bones, 3, 4>;  // vehicle_from_mesh of every bone

/// Rotation by an angle about a unit axis (Rodrigues).
Mat3 about(Vec3 axis, double angle);

/// A bone's frame, vehicle_from_bone.
struct BoneFrame {
  Mat3 rotation;
  Vec3 position;
};

/// The parts of `bone_frames`: pelvis to head; an arm (clavicle to hand) and a leg (thigh to foot) of a side, into its limbs.
///
/// q: of the trunk, a: of the side.
void spine_frames(const double* q, const RestArrays& rest, const BoneFrame& root, BoneFrame* out);
void arm_frames(const double* a, const RestArrays& rest, int side, const BoneFrame& thorax, BoneFrame* out);
void leg_frames(const double* a, const RestArrays& rest, int side, const BoneFrame& root, BoneFrame* out);

/// Frames of the main bones. Limits are not applied.
void bone_frames(Posture q, const RestArrays& rest, Placement vehicle_from_root, Rotations rotation, Positions position);

/// The 20 joints of `core.skeleton.JOINTS`, from the frames of `bone_frames`.
void joint_positions(const RestArrays& rest, Rotations rotation, Positions position, Array<double, rig::n_joints, 3> out);

/// vehicle_from_palm and vehicle_from_sole, left and right, from the frames of `bone_frames`.
void end_frames(const RestArrays& rest, Rotations rotation, Positions position, Array<double, 2, 4, 4> palms,
                Array<double, 2, 4, 4> soles);

/// What skinning applies to the mesh at rest, from the frames of `bone_frames`.
///
/// Helper bones turn by a share of the joint they sit at (see `tools/export_body.py`), fingers curl with the grip.
void skin_transforms(Posture q, const RestArrays& rest, Rotations rotation, Positions position, SkinTransforms out);

/// All of the above in one call.
void pose(Posture q, const RestArrays& rest, Placement vehicle_from_root, Rotations rotation, Positions position,
          SkinTransforms vehicle_from_mesh, Array<double, rig::n_joints, 3> joints, Array<double, 2, 4, 4> palms,
          Array<double, 2, 4, 4> soles);

}  // namespace cabinpose

#include "body/kinematics.hpp"

#include <algorithm>

#include "core/math.hpp"
#include "core/vec.hpp"

namespace cabinpose {
namespace {

using namespace rig;

// Shares of a group's rotation that its vertebrae take.
constexpr int n_groups = 4;
constexpr double spine_share[head + 1][n_groups] = {
    {},          {0.4},           {0.4},           {0.2, 0.4},
    {0.0, 0.6},                                                           // pelvis, spine04 .. spine01: lumbar, thorax
    {0, 0, 0.4}, {0.0, 0.0, 0.3}, {0.0, 0.0, 0.3}, {0.0, 0.0, 0.0, 1.0},  // neck01 .. neck03, head: neck, head
};
// Shares of the twist that bones along a limb take up, so that skin turns evenly between its ends.
constexpr double upperarm_share = 0.35, thigh_share = 0.4, forearm_near_share = 0.25, forearm_far_share = 0.7,
                 scapula_share = 0.25;

struct Quaternion {
  double w, x, y, z;
};

/// m times the rotation about a coordinate axis: two columns turn.
void turn(Mat3& m, int axis, double angle) {
  const double c = cos(angle), s = sin(angle);
  const int i = (axis + 1) % 3, j = (axis + 2) % 3;
  for (int row = 0; row < 3; ++row) {
    const double a = m[row][i], b = m[row][j];
    m[row][i] = c * a + s * b;
    m[row][j] = c * b - s * a;
  }
}

/// The quaternion of a rotation matrix, w >= 0 (Shepperd 1978).
Quaternion quaternion(const Mat3& m) {
  const double trace = m[0][0] + m[1][1] + m[2][2];
  if (trace > 0.0) {
    const double r = std::sqrt(1.0 + trace), k = 0.5 / r;
    return {r / 2.0, (m[2][1] - m[1][2]) * k, (m[0][2] - m[2][0]) * k, (m[1][0] - m[0][1]) * k};
  }
  int i = 0;
  if (m[1][1] > m[0][0]) i = 1;
  if (m[2][2] > m[i][i]) i = 2;
  const int j = (i + 1) % 3, n = (i + 2) % 3;
  const double r = std::sqrt(std::max(1.0 + m[i][i] - m[j][j] - m[n][n], 1e-300)), k = 0.5 / r;
  Vec3 v;
  v[i] = r / 2.0;
  v[j] = (m[j][i] + m[i][j]) * k;
  v[n] = (m[n][i] + m[i][n]) * k;
  const double w = (m[n][j] - m[j][n]) * k;
  if (w < 0.0) return {-w, -v.x, -v.y, -v.z};
  return {w, v.x, v.y, v.z};
}

/// The rotation by a share of m's angle about m's axis.
Mat3 share_of(const Mat3& m, double share) {
  const Quaternion q = quaternion(m);
  const double n = std::sqrt(q.x * q.x + q.y * q.y + q.z * q.z);
  if (n < 1e-12) return identity();
  return about({q.x / n, q.y / n, q.z / n}, share * 2.0 * atan2(n, q.w));
}

/// m = swing . twist about the axis a: the whole swing and a share of the twist.
Mat3 swing_and_share_of_twist(const Mat3& m, Vec3 a, double share) {
  const Quaternion q = quaternion(m);
  double twist = 2.0 * atan2(q.x * a.x + q.y * a.y + q.z * a.z, q.w);
  if (twist > pi) twist -= 2.0 * pi;
  return m * about(a, (share - 1.0) * twist);
}

/// A bone's frame before it turns: carried by its parent.
BoneFrame carried(const BoneFrame& parent, const RestArrays& rest, int bone) {
  BoneFrame f = parent;
  for (int i = 0; i < 3; ++i) {
    for (int j = 0; j < 3; ++j) f.position[i] += parent.rotation[i][j] * rest.offsets(bone, j);
  }
  return f;
}

void keep_skin(const Mat3& turned, Vec3 pivot, const double* head, SkinTransforms out, int bone) {
  for (int i = 0; i < 3; ++i) {
    double t = pivot[i];
    for (int j = 0; j < 3; ++j) {
      out(bone, i, j) = turned[i][j];
      t -= turned[i][j] * head[j];
    }
    out(bone, i, 3) = t;
  }
}

/// Where a bone's transform takes a point of the mesh at rest.
Vec3 moved(SkinTransforms transforms, int bone, const double* point) {
  Vec3 p;
  for (int i = 0; i < 3; ++i) {
    p[i] = transforms(bone, i, 3);
    for (int j = 0; j < 3; ++j) p[i] += transforms(bone, i, j) * point[j];
  }
  return p;
}

}  // namespace

Mat3 about(Vec3 a, double angle) {
  const double c = cos(angle), s = sin(angle), t = 1.0 - c;
  return {{{c + t * a.x * a.x, t * a.x * a.y - s * a.z, t * a.x * a.z + s * a.y},
           {t * a.x * a.y + s * a.z, c + t * a.y * a.y, t * a.y * a.z - s * a.x},
           {t * a.x * a.z - s * a.y, t * a.y * a.z + s * a.x, c + t * a.z * a.z}}};
}

void spine_frames(const double* q, const RestArrays& rest, const BoneFrame& root, BoneFrame* out) {
  out[pelvis] = root;
  Mat3 whole[n_groups];
  for (int group = 0; group < n_groups; ++group) {
    whole[group] = identity();
    turn(whole[group], 1, q[3 * group]);
    turn(whole[group], 0, -q[3 * group + 1]);
    turn(whole[group], 2, q[3 * group + 2]);
  }
  for (int b = spine04; b <= head; ++b) {
    out[b] = carried(out[b - 1], rest, b);
    for (int group = 0; group < n_groups; ++group) {
      if (spine_share[b][group] > 0.0) out[b].rotation = out[b].rotation * share_of(whole[group], spine_share[b][group]);
    }
  }
}

void arm_frames(const double* a, const RestArrays& rest, int side, const BoneFrame& thorax, BoneFrame* out) {
  const double s = 1.0 - 2.0 * side;
  // The humerus' angles are against the thorax: moving the clavicle carries the arm along and does not turn it.
  Mat3 humerus = thorax.rotation;
  turn(humerus, 1, -a[shoulder_flexion]);
  turn(humerus, 0, s * a[shoulder_abduction]);
  turn(humerus, 2, -s * a[shoulder_rotation]);
  double cosine = 0.0;
  for (int i = 0; i < 3; ++i) cosine += humerus[i][2] * thorax.rotation[i][2];
  out[clavicle] = carried(thorax, rest, limb(clavicle, side));
  turn(out[clavicle].rotation, 2, -s * a[protraction]);
  turn(out[clavicle].rotation, 0, s * (a[elevation] + scapulohumeral * (1.0 - cosine)));
  out[upperarm] = carried(out[clavicle], rest, limb(upperarm, side));
  out[upperarm].rotation = humerus;
  out[forearm] = carried(out[upperarm], rest, limb(forearm, side));
  turn(out[forearm].rotation, 1, -a[elbow_flexion]);
  out[hand] = carried(out[forearm], rest, limb(hand, side));
  turn(out[hand].rotation, 2, -s * a[pronation]);
  turn(out[hand].rotation, 0, -s * a[wrist_flexion]);
  turn(out[hand].rotation, 1, -a[wrist_radial]);
}

void leg_frames(const double* a, const RestArrays& rest, int side, const BoneFrame& root, BoneFrame* out) {
  const double s = 1.0 - 2.0 * side;
  out[thigh] = carried(root, rest, limb(thigh, side));
  turn(out[thigh].rotation, 1, -a[hip_flexion]);
  turn(out[thigh].rotation, 0, s * a[hip_abduction]);
  turn(out[thigh].rotation, 2, -s * a[hip_rotation]);
  out[shank] = carried(out[thigh], rest, limb(shank, side));
  turn(out[shank].rotation, 1, a[knee_flexion]);
  out[foot] = carried(out[shank], rest, limb(foot, side));
  turn(out[foot].rotation, 1, -a[ankle_dorsiflexion]);
  turn(out[foot].rotation, 0, -s * a[ankle_inversion]);
}

void bone_frames(Posture q, const RestArrays& rest, Placement vehicle_from_root, Rotations rotation, Positions position) {
  const BoneFrame root{mat3(vehicle_from_root.data(), 4),
                       {vehicle_from_root(0, 3), vehicle_from_root(1, 3), vehicle_from_root(2, 3)}};
  BoneFrame bones[n_main];
  spine_frames(q.data(), rest, root, bones);
  for (int side = 0; side < 2; ++side) {
    arm_frames(q.data() + dof(0, side), rest, side, bones[spine01], bones + limb(0, side));
    leg_frames(q.data() + dof(0, side), rest, side, bones[pelvis], bones + limb(0, side));
  }
  for (int b = 0; b < n_main; ++b) {
    std::copy_n(&bones[b].rotation[0][0], 9, &rotation(b, 0, 0));
    for (int i = 0; i < 3; ++i) position(b, i) = bones[b].position[i];
  }
}

void joint_positions(const RestArrays& rest, Rotations rotation, Positions position, Array<double, n_joints, 3> out) {
  for (Index k = 0; k < n_joints; ++k) {
    const std::int64_t b = rest.joint_bone[k];
    for (int i = 0; i < 3; ++i) {
      double value = position(b, i);
      for (int j = 0; j < 3; ++j) value += rotation(b, i, j) * rest.joint_offset(k, j);
      out(k, i) = value;
    }
  }
}

void end_frames(const RestArrays& rest, Rotations rotation, Positions position, Array<double, 2, 4, 4> palms,
                Array<double, 2, 4, 4> soles) {
  for (int side = 0; side < 2; ++side) {
    for (const int name : {int{hand}, int{foot}}) {
      const int b = limb(name, side);
      const auto local = name == hand ? rest.palms[side] : rest.soles[side];
      const auto out = name == hand ? palms[side] : soles[side];
      for (int i = 0; i < 3; ++i) {
        for (int j = 0; j < 4; ++j) {
          double value = j == 3 ? position(b, i) : 0.0;
          for (int k = 0; k < 3; ++k) value += rotation(b, i, k) * local(k, j);
          out(i, j) = value;
          out(3, j) = j == 3 ? 1.0 : 0.0;
        }
      }
    }
  }
}

void skin_transforms(Posture q, const RestArrays& rest, Rotations rotation, Positions position, SkinTransforms out) {
  Mat3 skin[n_main];
  for (int b = 0; b < n_main; ++b) {
    skin[b] = mat3(&rotation(b, 0, 0)) * transposed(mat3(&rest.frames(b, 0, 0)));
    keep_skin(skin[b], vec3(&position(b, 0)), &rest.heads(b, 0), out, b);
  }
  struct Between {  // a helper bone between two main ones, and its share of the angle, or of the twist alone
    int near, far, helper;
    double share;
    bool twist;
  };
  for (int side = 0; side < 2; ++side) {
    const double s = 1.0 - 2.0 * side;
    const int h = first_helper + side * n_helpers, collar = limb(clavicle, side), arm = limb(upperarm, side),
              ulna = limb(forearm, side), palm = limb(hand, side), femur = limb(thigh, side), shin = limb(shank, side);
    const Between between[] = {
        {collar, arm, h + scapula, scapula_share, false},
        {collar, arm, h + shoulder_half, 0.5, false},
        {collar, arm, h + upperarm_twist, upperarm_share, true},
        {arm, ulna, h + elbow_half, 0.5, false},
        {pelvis, femur, h + hip_half, 0.5, false},
        {pelvis, femur, h + thigh_twist, thigh_share, true},
        {femur, shin, h + knee_half, 0.5, false},
        {shin, limb(foot, side), h + ankle_half, 0.5, false},
    };
    for (const Between& b : between) {
      const Mat3 delta = transposed(skin[b.near]) * skin[b.far];
      const Mat3 part = b.twist ? swing_and_share_of_twist(delta, mat3(&rest.frames(b.far, 0, 0)).column(2), b.share)
                                : share_of(delta, b.share);
      const Mat3 turned = skin[b.near] * part;
      if (b.helper == h + scapula) {  // it turns about its own origin, carried by the clavicle
        const double* origin = &rest.heads(b.helper, 0);
        keep_skin(turned, moved(out, b.near, origin), origin, out, b.helper);
      } else {
        keep_skin(turned, vec3(&position(b.far, 0)), &rest.heads(b.far, 0), out, b.helper);
      }
    }
    // The forearm's skin turns about its long axis, more towards the hand.
    const double twist = -s * (q[dof(pronation, side)] - rest.pronation[side]);
    const Vec3 axis = mat3(&rest.frames(ulna, 0, 0)).column(2);
    for (const auto& [helper, share] : {std::pair{h + forearm_near, forearm_near_share}, {h + forearm_far, forearm_far_share}}) {
      keep_skin(skin[ulna] * about(axis, share * twist), vec3(&position(ulna, 0)), &rest.heads(ulna, 0), out, helper);
    }
    const Mat3 far = mat3(&out(h + forearm_far, 0, 0), 4);
    keep_skin(far * share_of(transposed(far) * skin[palm], 0.5), vec3(&position(palm, 0)), &rest.heads(palm, 0), out,
              h + wrist_half);
    for (int k = 0; k < n_fingers; ++k) {
      const int f = side * n_fingers + k, bone = first_finger + f;
      const int near = k % 3 == 0 ? palm : bone - 1;
      const Mat3 curled =
          mat3(&out(near, 0, 0), 4) * about(vec3(&rest.finger_axes(f, 0)), q[dof(grip, side)] * rest.finger_curl[f]);
      keep_skin(curled, moved(out, near, &rest.heads(bone, 0)), &rest.heads(bone, 0), out, bone);
    }
  }
}

void pose(Posture q, const RestArrays& rest, Placement vehicle_from_root, Rotations rotation, Positions position,
          SkinTransforms vehicle_from_mesh, Array<double, n_joints, 3> joints, Array<double, 2, 4, 4> palms,
          Array<double, 2, 4, 4> soles) {
  bone_frames(q, rest, vehicle_from_root, rotation, position);
  joint_positions(rest, rotation, position, joints);
  end_frames(rest, rotation, position, palms, soles);
  skin_transforms(q, rest, rotation, position, vehicle_from_mesh);
}

}  // namespace cabinpose

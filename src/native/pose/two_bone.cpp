#include "pose/two_bone.hpp"

#include <algorithm>
#include <limits>

#include "core/math.hpp"

namespace cabinpose {
namespace {

constexpr double violation = 1e3;  // cost of a squared radian beyond a limit, against 1 for one of discomfort
constexpr double infinity = std::numeric_limits<double>::infinity();

Vec3 unit(Vec3 a) {
  const double length = norm(a);
  return {a.x / length, a.y / length, a.z / length};
}

double clamped(double x, double lower, double upper) { return std::min(std::max(x, lower), upper); }

/// The same angle within -pi .. pi. (The remainder is exact, so it is the same bits everywhere.)
double wrapped(double angle) {
  double rest = std::fmod(angle + pi, 2.0 * pi);
  if (rest < 0.0) rest += 2.0 * pi;
  return rest - pi;
}

/// The hinge angle within the limits at which |elbow + R(axis, angle) wrist| is `distance`, or comes nearest.
///
/// The squared length is a + b cos(angle) + c sin(angle): the part of the wrist along the axis stays, the rest turns.
double hinge_for_distance(Vec3 elbow, Vec3 axis, Vec3 wrist, double distance, double lower, double upper) {
  const double along = dot(axis, wrist);
  const Vec3 across = wrist - along * axis;
  const Vec3 side = cross(axis, across);
  const double a = dot(elbow, elbow) + dot(wrist, wrist) + 2.0 * along * dot(elbow, axis);
  const double b = 2.0 * dot(elbow, across), c = 2.0 * dot(elbow, side);
  const double amplitude = std::sqrt(b * b + c * c), phase = atan2(c, b);
  const double ratio = (distance * distance - a) / std::max(amplitude, 1e-12);
  const double spread = acos(clamped(ratio, -1.0, 1.0)), middle = 0.5 * (lower + upper);
  double best = lower, best_cost = infinity;
  for (const double candidate : {phase + spread, phase - spread, lower, upper}) {
    const double angle = clamped(wrapped(candidate - middle) + middle, lower, upper);
    const double cost = std::fabs(a + b * cos(angle) + c * sin(angle) - distance * distance);
    if (cost < best_cost - 1e-12) {
      best = angle;
      best_cost = cost;
    }
  }
  return best;
}

/// The rotation about the common normal that turns unit vector a onto unit vector b.
Mat3 shortest_rotation(Vec3 a, Vec3 b) {
  const Vec3 normal = cross(a, b);
  const double s = norm(normal);
  if (s > 1e-9) return hinge_rotation(unit(normal), atan2(s, dot(a, b)));
  if (dot(a, b) > 0.0) return identity();
  int least = 0;
  for (int i = 1; i < 3; ++i) {
    if (std::fabs(a[i]) < std::fabs(a[least])) least = i;
  }
  Vec3 other;
  other[least] = 1.0;
  return hinge_rotation(unit(cross(a, other)), pi);
}

}  // namespace

Vec3 euler_near(const Mat3& r, const Vec3* axes, Vec3 near) {
  Mat3 along;  // its rows are the axes
  for (int i = 0; i < 3; ++i) {
    for (int j = 0; j < 3; ++j) along[i][j] = axes[i][j];
  }
  const Mat3 m = along * r * transposed(along);  // r seen along the axes
  const double sign = dot(cross(axes[0], axes[1]), axes[2]) > 0.0 ? 1.0 : -1.0;
  const double first = asin(clamped(m[0][2], -1.0, 1.0));
  Vec3 out;
  double best = infinity;
  for (const double b : {first, pi - first}) {
    const double c = cos(b);
    double a, g;
    if (std::fabs(c) > 1e-6) {
      a = atan2(-m[1][2] / c, m[2][2] / c);
      g = atan2(-m[0][1] / c, m[0][0] / c);
    } else {
      g = sign * near.z;
      a = atan2(m[2][1], m[1][1]) - (m[0][2] > 0.0 ? g : -g);
    }
    const double angles[] = {sign * a, sign * b, sign * g};
    Vec3 away;
    double cost = 0.0;
    for (int i = 0; i < 3; ++i) {
      away[i] = wrapped(angles[i] - near[i]);
      cost += away[i] * away[i];
    }
    if (cost < best) {
      best = cost;
      out = near + away;
    }
  }
  return out;
}

double seed_limb(const Chain& chain, const Limits& limits, int ball, const Rigid& target, bool oriented, const double* prior,
                 const double* stiffness, int swivels, double* q) {
  const int n = chain.n, hinge = ball + 3;
  Rigid frames[max_hinges + 1];
  for (int i = 0; i < n; ++i) q[i] = clamped(prior[i], limits.lower[i], limits.upper[i]);
  const bool full_wrist = oriented && n == ball + 7;
  chain_frames(chain, q, frames);
  // The rest of the chain behind the middle hinge, at the prior: where the wrist sits in the frame of the hinge.
  Vec3 wrist_at = frames[n].position, goal = target.position;
  if (full_wrist) {
    // The wrist's centre does not depend on its own angles, so its place in the tool frame is constant: taken from the tool back.
    wrist_at = frames[n - 1].position;
    goal = target.rotation * (transposed(frames[n].rotation) * (wrist_at - frames[n].position)) + goal;
  }
  const Vec3 in_hinge = transposed(frames[hinge].rotation) * (wrist_at - frames[hinge].position);
  const Vec3 wrist = transposed(hinge_rotation(chain.axes[hinge], q[hinge])) * in_hinge;
  const Mat3& base = frames[ball].rotation;
  const Vec3 to_goal = goal - frames[ball].position;
  const double distance = norm(to_goal);
  // In the frame of the upper bone the hinge sits at `elbow`, turned by `elbow_rotation`.
  const Vec3 elbow = chain.fixed[hinge].position;
  const Mat3& elbow_rotation = chain.fixed[hinge].rotation;
  const double bend = hinge_for_distance(elbow, elbow_rotation * chain.axes[hinge], elbow_rotation * wrist, distance,
                                         limits.lower[hinge], limits.upper[hinge]);
  if (distance < 1e-9) return infinity;
  const Mat3 lower_from_elbow = elbow_rotation * hinge_rotation(chain.axes[hinge], bend);
  const Vec3 aim = transposed(base) * unit(to_goal);
  const Mat3 first = shortest_rotation(unit(elbow + lower_from_elbow * wrist), aim);
  double trial[max_hinges], best = infinity;
  std::copy_n(q, n, trial);
  trial[hinge] = bend;
  for (int k = 0; k < swivels; ++k) {
    const Mat3 rotation = hinge_rotation(aim, 2.0 * pi * k / swivels) * first;
    const Vec3 angles = euler_near(rotation, chain.axes + ball, vec3(prior + ball));
    for (int i = 0; i < 3; ++i) trial[ball + i] = angles[i];
    if (full_wrist) {
      const Mat3 before_wrist = base * rotation * lower_from_elbow * chain.fixed[hinge + 1].rotation;
      const Mat3 rest = transposed(before_wrist) * target.rotation * transposed(chain.fixed[n].rotation);
      const Vec3 wrist_angles = euler_near(rest, chain.axes + hinge + 1, vec3(prior + hinge + 1));
      for (int i = 0; i < 3; ++i) trial[hinge + 1 + i] = wrist_angles[i];
    }
    double cost = 0.0;
    for (int i = ball; i < n; ++i) {
      const double beyond = std::max(std::max(limits.lower[i] - trial[i], trial[i] - limits.upper[i]), 0.0);
      const double away = trial[i] - prior[i];
      cost += violation * beyond * beyond + stiffness[i] * (away * away);
    }
    if (cost < best) {
      best = cost;
      std::copy_n(trial, n, q);
    }
  }
  for (int i = 0; i < n; ++i) q[i] = clamped(q[i], limits.lower[i], limits.upper[i]);
  return best;
}

}  // namespace cabinpose

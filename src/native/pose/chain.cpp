#include "pose/chain.hpp"

#include <algorithm>
#include <utility>

#include "core/math.hpp"

namespace cabinpose {
namespace {

constexpr double prior_share = 0.6;  // of the iterations, with the prior at work
constexpr double first_damping = 1e-4, least_damping = 1e-10, largest_damping = 1e8;

/// The weighted error, position then rotation in the target's frame.
struct Error {
  double e[6];
  double half_square;
};

Error error_of(const Rigid& tool, const Goal& goal) {
  const Mat3& target = goal.target.rotation;
  Error error;
  Mat3 relative;
  for (int a = 0; a < 3; ++a) {
    error.e[a] = 0.0;
    for (int k = 0; k < 3; ++k) error.e[a] += target[k][a] * (tool.position[k] - goal.target.position[k]);
    for (int b = 0; b < 3; ++b) {
      relative[a][b] =
          target[0][a] * tool.rotation[0][b] + target[1][a] * tool.rotation[1][b] + target[2][a] * tool.rotation[2][b];
    }
  }
  const Vec3 turned = rotation_vector(relative);
  error.half_square = 0.0;
  for (int a = 0; a < 3; ++a) {
    error.e[a] *= goal.position_weight[a];
    error.e[3 + a] = turned[a] * goal.rotation_weight[a];
    error.half_square += 0.5 * (error.e[a] * error.e[a] + error.e[3 + a] * error.e[3 + a]);
  }
  return error;
}

double prior_cost(const Goal& goal, const double* q, int n, double share) {
  double cost = 0.0;
  for (int i = 0; i < n; ++i) {
    const double away = q[i] - goal.prior[i];
    cost += 0.5 * share * goal.stiffness[i] * (away * away);
  }
  return cost;
}

/// The derivative of the errors by each hinge's angle, first order in the rotation error.
void jacobian(const Chain& chain, const Rigid* frames, const Goal& goal, double (*by_hinge)[6]) {
  const Mat3& target = goal.target.rotation;
  for (int i = 0; i < chain.n; ++i) {
    const Vec3 w = frames[i].rotation * chain.axes[i];
    const Vec3 v = cross(w, frames[chain.n].position - frames[i].position);
    for (int a = 0; a < 3; ++a) {
      by_hinge[i][a] = goal.position_weight[a] * (target[0][a] * v.x + target[1][a] * v.y + target[2][a] * v.z);
      by_hinge[i][3 + a] = goal.rotation_weight[a] * (target[0][a] * w.x + target[1][a] * w.y + target[2][a] * w.z);
    }
  }
}

/// Solve the free rows of a symmetric positive definite system by Cholesky; held unknowns are 0. Overwrites a and b.
void solve_free(double (*a)[max_hinges], double* b, const bool* held, int n, double* x) {
  for (int i = 0; i < n; ++i) {
    if (!held[i]) continue;
    for (int j = 0; j < n; ++j) a[i][j] = a[j][i] = 0.0;
    a[i][i] = 1.0;
    b[i] = 0.0;
  }
  for (int j = 0; j < n; ++j) {
    double d = a[j][j];
    for (int k = 0; k < j; ++k) d -= a[j][k] * a[j][k];
    a[j][j] = std::sqrt(std::max(d, 1e-300));
    for (int i = j + 1; i < n; ++i) {
      double s = a[i][j];
      for (int k = 0; k < j; ++k) s -= a[i][k] * a[j][k];
      a[i][j] = s / a[j][j];
    }
  }
  for (int i = 0; i < n; ++i) {
    double s = b[i];
    for (int k = 0; k < i; ++k) s -= a[i][k] * x[k];
    x[i] = s / a[i][i];
  }
  for (int i = n - 1; i >= 0; --i) {
    double s = x[i];
    for (int k = i + 1; k < n; ++k) s -= a[k][i] * x[k];
    x[i] = s / a[i][i];
  }
}

}  // namespace

Mat3 hinge_rotation(Vec3 axis, double angle) {
  const double c = cos(angle), s = sin(angle), t = 1.0 - c, x = axis.x, y = axis.y, z = axis.z;
  return {{{t * x * x + c, t * x * y - s * z, t * x * z + s * y},
           {t * x * y + s * z, t * y * y + c, t * y * z - s * x},
           {t * x * z - s * y, t * y * z + s * x, t * z * z + c}}};
}

Vec3 rotation_vector(const Mat3& r) {
  const Vec3 twice_sine{r[2][1] - r[1][2], r[0][2] - r[2][0], r[1][0] - r[0][1]};
  const double s = norm(twice_sine);
  const double angle = atan2(s, r[0][0] + r[1][1] + r[2][2] - 1.0);
  if (angle < pi - 1e-3) return (s < 1e-9 ? 0.5 : angle / s) * twice_sine;
  // Near half a turn the antisymmetric part vanishes: the axis is the largest column of R + I.
  int best = 0;
  for (int i = 1; i < 3; ++i) {
    if (r[i][i] > r[best][best]) best = i;
  }
  Vec3 axis;
  for (int i = 0; i < 3; ++i) axis[i] = 0.5 * (r[i][best] + r[best][i]) + (i == best ? 1.0 : 0.0);
  const double sign = dot(axis, twice_sine) >= 0.0 ? 1.0 : -1.0;
  return sign * angle / norm(axis) * axis;
}

void chain_frames(const Chain& chain, const double* q, Rigid* frames) {
  frames[0] = chain.fixed[0];
  for (int i = 0; i < chain.n; ++i) {
    const Rigid& step = chain.fixed[i + 1];
    const Mat3 turned = frames[i].rotation * hinge_rotation(chain.axes[i], q[i]);
    frames[i + 1] = {turned * step.rotation, turned * step.position + frames[i].position};
  }
}

Residual solve_chain(const Chain& chain, const Limits& limits, const Goal& goal, double* q, int iterations, double kept) {
  const int n = chain.n;
  Rigid frames[max_hinges + 1], trial_frames[max_hinges + 1];
  double by_hinge[max_hinges][6], hessian[max_hinges][max_hinges], gradient[max_hinges], step[max_hinges], trial[max_hinges];
  bool held[max_hinges];
  for (int i = 0; i < n; ++i) q[i] = std::min(std::max(q[i], limits.lower[i]), limits.upper[i]);
  double damping = first_damping, share = 1.0;
  chain_frames(chain, q, frames);
  Error error = error_of(frames[n], goal);
  double cost = error.half_square + prior_cost(goal, q, n, share);
  int with_prior = static_cast<int>(prior_share * iterations);
  for (int iteration = 0; iteration < iterations; ++iteration) {
    if (iteration >= with_prior && share > kept) {
      share = kept;
      damping = first_damping;
      cost = error.half_square + prior_cost(goal, q, n, share);
    }
    if (share <= kept && cost < 1e-14) break;
    jacobian(chain, frames, goal, by_hinge);
    for (int i = 0; i < n; ++i) {
      double g = share * goal.stiffness[i] * (q[i] - goal.prior[i]);
      for (int k = 0; k < 6; ++k) g += by_hinge[i][k] * error.e[k];
      gradient[i] = -g;
      held[i] = (q[i] <= limits.lower[i] && g > 0.0) || (q[i] >= limits.upper[i] && g < 0.0);
      for (int j = 0; j <= i; ++j) {
        double h = 0.0;
        for (int k = 0; k < 6; ++k) h += by_hinge[i][k] * by_hinge[j][k];
        hessian[i][j] = hessian[j][i] = h;
      }
      hessian[i][i] += share * goal.stiffness[i] + damping;
    }
    solve_free(hessian, gradient, held, n, step);
    double largest = 0.0;
    for (int i = 0; i < n; ++i) {
      trial[i] = std::min(std::max(q[i] + step[i], limits.lower[i]), limits.upper[i]);
      largest = std::max(largest, std::fabs(trial[i] - q[i]));
    }
    chain_frames(chain, trial, trial_frames);
    const Error trial_error = error_of(trial_frames[n], goal);
    const double trial_cost = trial_error.half_square + prior_cost(goal, trial, n, share);
    if (trial_cost < cost) {
      std::copy_n(trial, n, q);
      std::copy_n(trial_frames, n + 1, frames);
      error = trial_error;
      cost = trial_cost;
      damping = std::max(damping * 0.2, least_damping);
    } else {
      damping = damping * 6.0;
    }
    if (damping > largest_damping || largest < 1e-9) {
      if (share <= kept) break;
      with_prior = iteration + 1;
    }
  }
  double position = 0.0, rotation = 0.0;
  for (int a = 0; a < 3; ++a) {
    if (goal.position_weight[a] > 0.0) {
      const double missed = error.e[a] / goal.position_weight[a];
      position += missed * missed;
    }
    if (goal.rotation_weight[a] > 0.0) {
      const double missed = error.e[3 + a] / goal.rotation_weight[a];
      rotation += missed * missed;
    }
  }
  return {std::sqrt(position), std::sqrt(rotation)};
}

}  // namespace cabinpose

#include "core/lens.hpp"

#include <algorithm>
#include <cmath>
#include <limits>

namespace cabinpose {

void undistort(Array<const double, any, 2> distorted, Array<const double, 5> dist, int steps, Array<double, any, 2> ideal) {
  constexpr double longest = 0.3, enough = 1e-13, found = 1e-7;
  const double k1 = dist[0], k2 = dist[1], p1 = dist[2], p2 = dist[3], k3 = dist[4];
  for (Index n = 0; n < distorted.size(); ++n) {
    const double u = distorted(n, 0), v = distorted(n, 1);
    double x = u, y = v, off_x = 0.0, off_y = 0.0;
    for (int step = 0;; ++step) {
      const double r2 = x * x + y * y, radial = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3));
      off_x = x * radial + 2.0 * p1 * x * y + p2 * (r2 + 2.0 * x * x) - u;
      off_y = y * radial + p1 * (r2 + 2.0 * y * y) + 2.0 * p2 * x * y - v;
      if (step == steps) break;
      const double slope = 2.0 * (k1 + r2 * (2.0 * k2 + r2 * 3.0 * k3));  // of the radial factor, over x or y
      const double xx = radial + slope * x * x + 2.0 * p1 * y + 6.0 * p2 * x;
      const double xy = slope * x * y + 2.0 * p1 * x + 2.0 * p2 * y;  // the matrix is symmetric
      const double yy = radial + slope * y * y + 6.0 * p1 * y + 2.0 * p2 * x;
      const double det = xx * yy - xy * xy;
      const double step_x = (off_x * yy - off_y * xy) / det, step_y = (off_y * xx - off_x * xy) / det;
      if (std::fabs(step_x) < enough && std::fabs(step_y) < enough) break;
      x -= std::isnan(step_x) ? 0.0 : std::clamp(step_x, -longest, longest);
      y -= std::isnan(step_y) ? 0.0 : std::clamp(step_y, -longest, longest);
    }
    const bool bad = !(off_x * off_x + off_y * off_y <= found * found);
    ideal(n, 0) = bad ? std::numeric_limits<double>::quiet_NaN() : x;
    ideal(n, 1) = bad ? std::numeric_limits<double>::quiet_NaN() : y;
  }
}

}  // namespace cabinpose

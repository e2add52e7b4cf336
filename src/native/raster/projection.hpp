// From the vehicle frame to the image: vertices through the lens, and what of a triangle the image may see.
#pragma once

#include <algorithm>
#include <utility>

#include "core/array.hpp"
#include "core/fields.hpp"

namespace cabinpose {

inline constexpr double near_m = 0.01;  // surfaces closer to the camera plane than this are not seen
inline constexpr int max_corners = 8;   // of a triangle cut by five planes

/// The projection of a camera.
///
/// fx, fy, cx, cy: pixels · dist: k1, k2, p1, p2, k3 as OpenCV's · box: x min, y min, x max, y max of the image's ideal rays, a
/// little widened · curvature: pixels, a bound on the second derivative of the projection in the box; 0 for a pinhole · radius:
/// of the last ideal point that the lens sees, beyond which its polynomial folds; infinite where it does not.
struct Lens {
  double fx, fy, cx, cy;
  Array<const double, 5> dist;
  Array<const double, 4> box;
  double curvature;
  double radius;

  CABINPOSE_FIELDS(Lens, fx, fy, cx, cy, dist, box, curvature, radius)

  bool distorts() const {
    return std::any_of(dist.data(), dist.data() + 5, [](double k) { return k != 0.0; });
  }

  /// Pixel u, v of ideal coordinates. Outside the box, where the distortion polynomial may fold over, they mean nothing.
  template <class T>
  std::pair<T, T> pixel(T x, T y) const {
    const T k1(dist[0]), k2(dist[1]), p1(dist[2]), p2(dist[3]), k3(dist[4]), one(1.0), two(2.0);
    const T r2 = x * x + y * y;
    const T radial = one + r2 * (k1 + r2 * (k2 + r2 * k3));
    const T u = x * radial + two * p1 * x * y + p2 * (r2 + two * x * x);
    const T v = y * radial + p1 * (r2 + two * y * y) + two * p2 * x * y;
    return {T(fx) * u + T(cx), T(fy) * v + T(cy)};
  }

  /// How far (pixels, along u and along v) the lens may move a point of a polygon out of its corners' convex hull.
  ///
  /// By Taylor's theorem f(sum(b_i v_i)) - sum(b_i f(v_i)) is at most M / 2 sum(b_i |v_i - p|^2) <= M L^2 / 6 on a triangle with
  /// longest edge L, where M (`curvature`) bounds the second derivative of the projection f. The constant covers float32.
  template <class T>
  T bulge(T longest_squared) const {
    return T(curvature / 6.0) * longest_squared + T(2e-3);
  }
};

/// A rigid motion from the vehicle frame to the camera frame, row by row (3, 4).
struct Pose {
  double m[12];

  explicit Pose(Array<const double, 4, 4> camera_from_vehicle) { std::copy_n(camera_from_vehicle.data(), 12, m); }

  /// A point of the vehicle frame in the camera frame (m), float32 as the vertices are.
  void move(const float* vertex, float* out) const {
    const double x = vertex[0], y = vertex[1], z = vertex[2];
    for (int k = 0; k < 3; ++k) out[k] = static_cast<float>(m[4 * k] * x + m[4 * k + 1] * y + m[4 * k + 2] * z + m[4 * k + 3]);
  }
};

/// A vertex before the camera: ideal x, y, and 1/z; and a bit in `outside` for each plane beyond which it lies, 1 the near limit,
/// 2 .. 16 the sides of the lens' box. The others mean nothing where it is nearer than `near_m`.
struct alignas(16) Corner {
  float x, y, w;
  std::int32_t outside;
};

/// Vertices (V, 3) of the vehicle frame before the camera; `out` has room for V rounded up to whole `lanes`.
void project(Array<const float, any, 3> vertices, const Pose& pose, const Lens& lens, Corner* out);

/// A convex polygon in the image.
struct Polygon {
  int size;
  double u[max_corners], v[max_corners];
  double margin;  // pixels: how far from it what is drawn may reach
};

/// What the image may see of a triangle of the camera frame that crosses some of its limits: the bits set in `crossed`.
Polygon clipped(const double (&corners)[3][3], int crossed, const Lens& lens);

}  // namespace cabinpose

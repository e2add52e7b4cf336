// Simple bodies, and where rays meet them: planes, capsules, spheres and a plate with a checkerboard.
//
// A ray is t (x, y, 1) from the origin, so that t is the depth. Rays come in blocks: the loops run over a block's rays.
#pragma once

#include <vector>

#include "core/array.hpp"
#include "core/fields.hpp"

namespace cabinpose {

/// The bodies of `app.lab.raycast.Scene` in the camera's frame, m; reflectances are relative to a white Lambertian surface.
///
/// planes: unit normal, distance d of n p = d, reflectance · capsules: two ends, radius, reflectance · spheres: centre, radius,
/// reflectance at its middle · plates (at most one): origin, axes x, y, z; x and y of two opposite corners; x and y of the
/// checkerboard's first corner, its squares along x and along y, their side; reflectances of paper, ink and the back.
struct SceneArrays {
  Array<const double, any, 5> planes;
  Array<const double, any, 8> capsules;
  Array<const double, any, 5> spheres;
  Array<const double, any, 24> plates;

  CABINPOSE_FIELDS(SceneArrays, planes, capsules, spheres, plates)
};

enum class Kind : std::int64_t { background, capsule, plate, sphere };
inline constexpr int kinds = 4;

struct Plane {
  double normal[3], distance, reflectance;
};

struct Capsule {
  double first[3], axis[3], last[3], radius, reflectance;
  double axis_square, axis_first;    // axis . axis, axis . first
  double first_square, last_square;  // end . end - radius^2
};

struct Sphere {
  double centre[3], radius, reflectance;
  double square;  // centre . centre - radius^2
};

struct Plate {
  double origin[3], x[3], y[3], z[3];
  double low_x, low_y, high_x, high_y;
  double squares_x, squares_y, columns, rows, side;
  double paper, ink, back;
};

using Bits = std::uint64_t;  // one for each capsule, then one for each sphere

/// The bodies of a scene, with what all rays have in common worked out. Raises std::length_error for more than fit into `Bits`.
struct Bodies {
  explicit Bodies(const SceneArrays& scene);

  Bits all() const { return (Bits{1} << (capsules.size() + spheres.size())) - 1; }
  Bits all_capsules() const { return (Bits{1} << capsules.size()) - 1; }

  std::vector<Plane> planes;
  std::vector<Capsule> capsules;
  std::vector<Sphere> spheres;
  std::vector<Plate> plates;
};

/// A block of rays: x, y and how many there are come in, the rest is found by `meet`.
struct Rays {
  static constexpr int most = 17 * 17;

  int count = 0;
  double x[most], y[most];
  double length[most];         // of (x, y, 1)
  double depth[most];          // infinite where nothing is met
  double light[most];          // reflectance times the cosine of incidence
  std::int64_t surface[most];  // 64 times its kind, and which of that kind; -1: none

  void add(double ray_x, double ray_y) { x[count] = ray_x, y[count] = ray_y, ++count; }
};

/// Which surface each ray meets first, of all planes, the capsules and spheres of the bits `among`, and a plate (null: none).
void meet(const Bodies& bodies, Bits among, const Plate* plate, Rays& rays);

/// Capsules and spheres of the bits `among` that a ray through a point up to `reach` from (x, y, 1) may meet.
Bits find_near(const Bodies& bodies, Bits among, double x, double y, double reach);

/// Where the rays meet the plate's plane, in its frame; NaN where they do not.
void meet_plane(const Plate& plate, const Rays& rays, double* a, double* b);

}  // namespace cabinpose

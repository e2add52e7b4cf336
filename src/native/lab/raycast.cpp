#include "lab/raycast.hpp"

#include <algorithm>
#include <cmath>
#include <limits>

namespace cabinpose {

namespace {

constexpr int tile = 16;                        // pixels of a side of the squares in which bodies are looked for
constexpr int edge_rays = 8, sphere_rays = 16;  // along a pixel's side, where it sees an edge, a sphere
constexpr double thin_m = 0.005;                // radius of capsules that may pass between the corners of a pixel
constexpr double inf = std::numeric_limits<double>::infinity();

using Places = Array<const double, any, any, 2>;

/// What a pixel needs besides the ray through its centre: so many rays along its side (0: none), against these bodies.
struct Need {
  int rays = 0;
  Bits near = 0;
};

struct Workspace {
  Rays rays;
  std::int64_t surface[Rays::most];     // seen at a tile's corners
  double a[Rays::most], b[Rays::most];  // their places on the plate's plane
  std::vector<Need> need;               // (H * W,)
};

/// The part of an image that is looked at together.
struct Tile {
  Index top, left, rows, columns;

  const double* corner(Places corners, Index k) const { return &corners(top + k / 2 * rows, left + k % 2 * columns, 0); }
};

/// The farthest of the four corners of `size` x `size` pixels from (x, y).
double half_diagonal(Places corners, Index v, Index u, Index size, double x, double y) {
  double farthest = 0.0;
  for (Index dv = 0; dv <= size; dv += size) {
    for (Index du = 0; du <= size; du += size) {
      const double* c = &corners(std::min(v + dv, corners.size(0) - 1), std::min(u + du, corners.size(1) - 1), 0);
      farthest = std::max(farthest, (c[0] - x) * (c[0] - x) + (c[1] - y) * (c[1] - y));
    }
  }
  return std::sqrt(farthest);
}

double least(const double* a) { return std::min(std::min(std::min(a[0], a[1]), a[2]), a[3]); }

double greatest(const double* a) { return std::max(std::max(std::max(a[0], a[1]), a[2]), a[3]); }

/// Whether values (4,) lie on both sides of one of the lines first, first + step, ..., last.
bool lines_between(const double* a, double first, double last, double step) {
  const double line = first + std::max(std::ceil((least(a) - first) / step), 0.0) * step;
  return line <= greatest(a) && line <= last + 1e-9;
}

/// Whether a polygon with its corners at (a, b) (4,) lies on one side of a rectangle; false where a corner is NaN.
bool beside(const double* a, const double* b, double x0, double y0, double x1, double y1) {
  if (std::isnan(a[0] + a[1] + a[2] + a[3])) return false;
  return greatest(a) < x0 || least(a) > x1 || greatest(b) < y0 || least(b) > y1;
}

bool beside(const Plate& p, const double* a, const double* b) { return beside(a, b, p.low_x, p.low_y, p.high_x, p.high_y); }

/// Whether a pixel with its corners at (a, b) (4,) on the plate may see an edge of it or of its squares.
bool sees_a_line(const Plate& p, const double* a, const double* b) {
  if (beside(p, a, b)) return false;
  if (lines_between(a, p.low_x, p.high_x, p.high_x - p.low_x)) return true;
  if (lines_between(b, p.low_y, p.high_y, p.high_y - p.low_y)) return true;
  const double last_x = p.squares_x + p.columns * p.side, last_y = p.squares_y + p.rows * p.side;
  if (beside(a, b, p.squares_x, p.squares_y, last_x, last_y)) return false;
  return lines_between(a, p.squares_x, last_x, p.side) || lines_between(b, p.squares_y, last_y, p.side);
}

/// Whether all rays of a tile meet the same plane first: where the four at its corners do, since such regions are convex.
bool same_plane(Places corners, const Tile& at, const std::vector<Plane>& planes) {
  std::size_t first = 0;
  for (Index k = 0; k < 4; ++k) {
    const double* ray = at.corner(corners, k);
    double nearest = 0.0;
    std::size_t which = planes.size();
    for (std::size_t n = 0; n < planes.size(); ++n) {
      const Plane& p = planes[n];
      const double nearness = (p.normal[0] * ray[0] + p.normal[1] * ray[1] + p.normal[2]) / p.distance;
      if (nearness > nearest) nearest = nearness, which = n;
    }
    if (which == planes.size() || (k > 0 && which != first)) return false;
    first = which;
  }
  return true;
}

/// The bodies that rays of a tile may meet: all where a corner lies outside the lens model.
Bits find_near(const PixelRays& pixels, const Bodies& bodies, const Tile& at) {
  const Places centres = pixels.centres;
  const Index v = std::min(at.top + tile / 2, centres.size(0) - 1), u = std::min(at.left + tile / 2, centres.size(1) - 1);
  const double x = centres(v, u, 0), y = centres(v, u, 1), reach = half_diagonal(pixels.corners, at.top, at.left, tile, x, y);
  return reach < inf ? find_near(bodies, bodies.all(), x, y, reach) : bodies.all();
}

/// The plate where a tile may see it.
const Plate* find_plate(const PixelRays& pixels, const Bodies& bodies, const Tile& at, Workspace& work) {
  if (bodies.plates.empty()) return nullptr;
  const Plate& plate = bodies.plates[0];
  work.rays.count = 0;
  for (Index k = 0; k < 4; ++k) work.rays.add(at.corner(pixels.corners, k)[0], at.corner(pixels.corners, k)[1]);
  meet_plane(plate, work.rays, work.a, work.b);
  return beside(plate, work.a, work.b) ? nullptr : &plate;
}

/// Takes the rays of a part of an image.
void take(Rays& rays, Places places, Index top, Index left, Index rows, Index columns) {
  rays.count = 0;
  for (Index v = top; v < top + rows; ++v) {
    const double* ray = &places(v, left, 0);
    for (Index u = 0; u < columns; ++u) rays.add(ray[2 * u], ray[2 * u + 1]);
  }
}

/// Depth and light of a tile's pixels by the rays through their centres, and what each pixel needs besides.
void look_at(const PixelRays& pixels, const Bodies& bodies, const Tile& at, float reflectance, float* depth, float* cosine,
             Workspace& work) {
  const Bits near = find_near(pixels, bodies, at);
  const Plate* plate = find_plate(pixels, bodies, at, work);
  const bool plain = !near && !plate && same_plane(pixels.corners, at, bodies.planes);
  const Index across = at.columns + 1;
  if (!plain) {
    take(work.rays, pixels.corners, at.top, at.left, at.rows + 1, across);
    meet(bodies, near & bodies.all_capsules(), plate, work.rays);
    std::copy_n(work.rays.surface, work.rays.count, work.surface);
    if (plate) meet_plane(*plate, work.rays, work.a, work.b);
  }
  take(work.rays, pixels.centres, at.top, at.left, at.rows, at.columns);
  meet(bodies, near, plate, work.rays);
  for (Index v = 0; v < at.rows; ++v) {
    for (Index u = 0; u < at.columns; ++u) {
      const Index k = v * at.columns + u, pixel = (at.top + v) * pixels.centres.size(1) + at.left + u;
      depth[pixel] = work.rays.depth[k] < inf ? static_cast<float>(work.rays.depth[k]) : 0.0f;
      cosine[pixel] = static_cast<float>(work.rays.light[k]) / reflectance;
      Need& need = work.need[static_cast<std::size_t>(pixel)];
      need = {};
      if (plain) continue;
      const Index first = v * across + u, corners[4] = {first, first + 1, first + across, first + across + 1};
      const std::int64_t here = work.rays.surface[k];
      if (std::any_of(corners, corners + 4, [&](Index c) { return work.surface[c] != here; })) need.rays = edge_rays;
      if (plate) {
        double a[4], b[4];
        for (int c = 0; c < 4; ++c) a[c] = work.a[corners[c]], b[c] = work.b[corners[c]];
        if (sees_a_line(*plate, a, b)) need.rays = edge_rays;
      }
      if (!near) continue;
      const double x = work.rays.x[k], y = work.rays.y[k];
      need.near = find_near(bodies, near, x, y, half_diagonal(pixels.corners, at.top + v, at.left + u, 1, x, y));
      if (need.near >> bodies.capsules.size()) need.rays = sphere_rays;
      for (std::size_t c = 0; c < bodies.capsules.size(); ++c) {
        const bool passes = (need.near >> c & 1) && bodies.capsules[c].radius < thin_m && work.surface[first] == here;
        if (passes) need.rays = std::max(need.rays, edge_rays);
      }
    }
  }
}

/// Where in a pixel its n x n rays pass: shares of its corners (upper left, upper right, lower left, lower right).
///
/// They have n x n different u and v (a sheared grid), so that an edge along the pixels does not pass many at once.
struct Grid {
  explicit Grid(int side) : rays(side * side) {
    const double n = side;
    for (int j = 0; j < side; ++j) {
      for (int i = 0; i < side; ++i) {
        const double fu = (i + (j + 0.5) / n) / n, fv = (j + (i + 0.5) / n) / n;
        const int k = j * side + i;
        share[0][k] = (1 - fv) * (1 - fu), share[1][k] = (1 - fv) * fu, share[2][k] = fv * (1 - fu), share[3][k] = fv * fu;
      }
    }
  }

  int rays;
  double share[4][sphere_rays * sphere_rays];
};

/// The light of many rays in a pixel: depth (4,) and light over `reflectance` (4,) of each kind of surface.
void look_finely(const PixelRays& pixels, const Bodies& bodies, const Grid& grid, Index pixel, Bits near, float reflectance,
                 Rays& rays, float* depth, float* cosine) {
  const Index width = pixels.centres.size(1), v = pixel / width, u = pixel % width;
  const double *above = &pixels.corners(v, u, 0), *below = &pixels.corners(v + 1, u, 0);
  rays.count = grid.rays;
  for (int k = 0; k < rays.count; ++k) {
    const double w0 = grid.share[0][k], w1 = grid.share[1][k], w2 = grid.share[2][k], w3 = grid.share[3][k];
    rays.x[k] = w0 * above[0] + w1 * above[2] + w2 * below[0] + w3 * below[2];
    rays.y[k] = w0 * above[1] + w1 * above[3] + w2 * below[1] + w3 * below[3];
  }
  meet(bodies, near, bodies.plates.empty() ? nullptr : &bodies.plates[0], rays);
  double range[sphere_rays * sphere_rays], by_square[sphere_rays * sphere_rays], by_range[sphere_rays * sphere_rays];
  for (int k = 0; k < rays.count; ++k) {
    const double r = rays.depth[k] * rays.length[k];
    range[k] = r, by_square[k] = rays.light[k] / (r * r), by_range[k] = rays.light[k] / r;
  }
  double energy[kinds] = {}, moment[kinds] = {}, any_range = 0.0;
  for (int k = 0; k < rays.count; ++k) {
    if (rays.surface[k] < 0) continue;
    const auto kind = static_cast<std::size_t>(rays.surface[k] / 64);
    energy[kind] += by_square[k], moment[kind] += by_range[k];
    any_range = range[k];
  }
  for (int part = 0; part < kinds; ++part) {
    const double r = energy[part] > 0.0 ? moment[part] / energy[part] : any_range;
    depth[part] = static_cast<float>(r / static_cast<double>(pixels.factors(pixel, part)));
    cosine[part] = static_cast<float>(4.0 * energy[part] / rays.count * r * r) / reflectance;
  }
}

}  // namespace

MixedPixels cast(const PixelRays& pixels, const SceneArrays& scene, float reflectance, Array<float, any, any> depth,
                 Array<float, any, any> cosine) {
  thread_local Workspace own;
  Workspace& work = own;
  static const Grid edge(edge_rays), sphere(sphere_rays);
  const Bodies bodies(scene);
  const Index height = pixels.centres.size(0), width = pixels.centres.size(1);
  work.need.resize(static_cast<std::size_t>(height * width));
  for (Index top = 0; top < height; top += tile) {
    for (Index left = 0; left < width; left += tile) {
      const Tile at{top, left, std::min<Index>(tile, height - top), std::min<Index>(tile, width - left)};
      look_at(pixels, bodies, at, reflectance, depth.data(), cosine.data(), work);
    }
  }
  MixedPixels mixed;
  for (std::size_t k = 0; k < work.need.size(); ++k) {
    if (work.need[k].rays) mixed.pixel.push_back(static_cast<std::int32_t>(k));
  }
  mixed.depth.resize(kinds * mixed.pixel.size());
  mixed.cosine.resize(kinds * mixed.pixel.size());
  for (std::size_t m = 0; m < mixed.pixel.size(); ++m) {
    const Need& need = work.need[static_cast<std::size_t>(mixed.pixel[m])];
    look_finely(pixels, bodies, need.rays == edge_rays ? edge : sphere, mixed.pixel[m], need.near, reflectance, work.rays,
                &mixed.depth[kinds * m], &mixed.cosine[kinds * m]);
  }
  return mixed;
}

}  // namespace cabinpose

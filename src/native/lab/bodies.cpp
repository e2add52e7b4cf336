#include "lab/bodies.hpp"

#include <algorithm>
#include <cmath>
#include <limits>
#include <stdexcept>

namespace cabinpose {

namespace {

constexpr double inf = std::numeric_limits<double>::infinity();
constexpr double nan = std::numeric_limits<double>::quiet_NaN();

double dot(const double* a, const double* b) { return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]; }

inline double clipped(double share) {
  const double low = share < 0.0 ? 0.0 : share;
  return low > 1.0 ? 1.0 : low;
}

/// The depth at which a ray enters a body, if it does. Conditions are kept apart from values: the compiler then makes masks of
/// them and runs through several rays at once.
struct Entry {
  bool met;
  double depth;
};

/// Where the ray t (x, y, 1) enters a sphere. a: its length squared · square: of the centre less that of the radius.
inline Entry enter_sphere(double x, double y, double a, const double* centre, double square) {
  const double b = x * centre[0] + y * centre[1] + centre[2];
  const double root = b * b - a * square;
  const bool met = (root > 0.0) & (b > 0.0);
  return {met, (b - std::sqrt(root)) / a};
}

/// Least distance between a ray and a capsule's axis, and the depth there.
struct Passing {
  double distance, depth;
};

inline Passing pass(double x, double y, double a, const Capsule& body) {
  const double b = x * body.axis[0] + y * body.axis[1] + body.axis[2];
  const double d = x * body.first[0] + y * body.first[1] + body.first[2];
  const double determinant = a * body.axis_square - b * b;
  const double share = clipped((b * d - a * body.axis_first) / determinant), s = determinant > 1e-12 ? share : 0.0;
  const double px = body.first[0] + s * body.axis[0], py = body.first[1] + s * body.axis[1];
  const double pz = body.first[2] + s * body.axis[2];
  const double t = (x * px + y * py + pz) / a;
  const double dx = px - t * x, dy = py - t * y, dz = pz - t;
  return {std::sqrt(dx * dx + dy * dy + dz * dz), t};
}

inline Entry enter_capsule(double x, double y, double square, const Capsule& body) {
  const double along = x * body.axis[0] + y * body.axis[1] + body.axis[2];
  // The cylinder: |p - (p e) e / e^2| = radius with p = t d - p0.
  const double start = -body.axis_first;
  const double a = square * body.axis_square - along * along;
  const double b = -(x * body.first[0] + y * body.first[1] + body.first[2]) * body.axis_square - start * along;
  const double c = body.first_square * body.axis_square - start * start;
  const double root = b * b - a * c, t = (-b - std::sqrt(root)) / a, at = start + t * along;
  const bool side = (root > 0.0) & (a > 1e-12) & (0.0 < at) & (at < body.axis_square);
  const Entry first = enter_sphere(x, y, square, body.first, body.first_square);
  const Entry last = enter_sphere(x, y, square, body.last, body.last_square);
  const bool take_last = last.met & (!first.met | (last.depth < first.depth));
  const double end = take_last ? last.depth : first.depth;
  const bool met = (pass(x, y, square, body).distance < body.radius) & (side | first.met | last.met);
  return {met, side ? t : end};
}

void meet_planes(const std::vector<Plane>& planes, Rays& rays) {
  for (std::size_t k = 0; k < planes.size(); ++k) {
    const Plane p = planes[k];
    const std::int64_t surface = 64 * static_cast<std::int64_t>(Kind::background) + static_cast<std::int64_t>(k);
    for (int i = 0; i < rays.count; ++i) {
      const double towards = p.normal[0] * rays.x[i] + p.normal[1] * rays.y[i] + p.normal[2];
      const double t = p.distance / towards, light = p.reflectance * std::fabs(towards) / rays.length[i];
      const bool met = (towards * p.distance > 0.0) & (t < rays.depth[i]);
      rays.surface[i] = met ? surface : rays.surface[i];
      rays.depth[i] = met ? t : rays.depth[i];
      rays.light[i] = met ? light : rays.light[i];
    }
  }
}

/// A point on the plate's plane in its frame, and the depth there, if the ray meets the plane.
struct OnPlane {
  bool met;
  double a, b, depth;
};

inline OnPlane meet_plane(const Plate& p, double x, double y, double towards, double distance) {
  const double t = distance / towards;
  const double qx = t * x - p.origin[0], qy = t * y - p.origin[1], qz = t - p.origin[2];
  const double a = p.x[0] * qx + p.x[1] * qy + p.x[2] * qz, b = p.y[0] * qx + p.y[1] * qy + p.y[2] * qz;
  const bool met = (std::fabs(towards) >= 1e-9) & (t > 0.0);
  return {met, a, b, t};
}

void meet_plate(const Plate& p, Rays& rays) {
  const double distance = dot(p.z, p.origin), ink = p.ink, paper = p.paper, back = p.back;
  for (int i = 0; i < rays.count; ++i) {
    const double x = rays.x[i], y = rays.y[i];
    const double towards = p.z[0] * x + p.z[1] * y + p.z[2];
    const OnPlane at = meet_plane(p, x, y, towards, distance);
    const bool within = (p.low_x <= at.a) & (at.a <= p.high_x) & (p.low_y <= at.b) & (at.b <= p.high_y);
    const bool met = at.met & within & (at.depth < rays.depth[i]);
    const double column = std::floor((at.a - p.squares_x) / p.side), row = std::floor((at.b - p.squares_y) / p.side);
    const double half = 0.5 * (column + row);
    const bool black = (0.0 <= column) & (column < p.columns) & (0.0 <= row) & (row < p.rows) & (half == std::floor(half));
    const double front = black ? ink : paper, reflectance = towards < 0.0 ? back : front;
    const double light = reflectance * std::fabs(towards) / rays.length[i];
    rays.surface[i] = met ? 64 * static_cast<std::int64_t>(Kind::plate) : rays.surface[i];
    rays.depth[i] = met ? at.depth : rays.depth[i];
    rays.light[i] = met ? light : rays.light[i];
  }
}

void meet_capsule(const Capsule& body, std::int64_t surface, Rays& rays) {
  for (int i = 0; i < rays.count; ++i) {
    const double x = rays.x[i], y = rays.y[i], square = x * x + y * y + 1.0;
    const Entry entry = enter_capsule(x, y, square, body);
    const double t = entry.depth;
    const bool met = entry.met & (0.0 < t) & (t < rays.depth[i]);
    const double px = t * x - body.first[0], py = t * y - body.first[1], pz = t - body.first[2];
    const double along = clipped((px * body.axis[0] + py * body.axis[1] + pz * body.axis[2]) / body.axis_square);
    const double nx = px - along * body.axis[0], ny = py - along * body.axis[1], nz = pz - along * body.axis[2];
    const double cosine = -(nx * x + ny * y + nz) / (body.radius * rays.length[i]);
    const double light = body.reflectance * (cosine < 0.0 ? 0.0 : cosine);
    rays.surface[i] = met ? surface : rays.surface[i];
    rays.depth[i] = met ? t : rays.depth[i];
    rays.light[i] = met ? light : rays.light[i];
  }
}

void meet_sphere(const Sphere& body, std::int64_t surface, Rays& rays) {
  for (int i = 0; i < rays.count; ++i) {
    const double x = rays.x[i], y = rays.y[i], square = x * x + y * y + 1.0;
    const Entry entry = enter_sphere(x, y, square, body.centre, body.square);
    const double t = entry.depth;
    const bool met = entry.met & (0.0 < t) & (t < rays.depth[i]);
    const double dx = t * x - body.centre[0], dy = t * y - body.centre[1], dz = t - body.centre[2];
    const double cosine = -(dx * x + dy * y + dz) / (body.radius * rays.length[i]);
    const double light = body.reflectance * (cosine < 0.0 ? 0.0 : cosine);
    rays.surface[i] = met ? surface : rays.surface[i];
    rays.depth[i] = met ? t : rays.depth[i];
    rays.light[i] = met ? light : rays.light[i];
  }
}

}  // namespace

Bodies::Bodies(const SceneArrays& scene) {
  if (scene.capsules.size() + scene.spheres.size() >= 64) throw std::length_error("a scene has at most 63 capsules and spheres");
  for (Index k = 0; k < scene.planes.size(); ++k) {
    const double* p = &scene.planes(k, 0);
    planes.push_back({{p[0], p[1], p[2]}, p[3], p[4]});
  }
  for (Index k = 0; k < scene.capsules.size(); ++k) {
    const double* p = &scene.capsules(k, 0);
    Capsule body{{p[0], p[1], p[2]}, {p[3] - p[0], p[4] - p[1], p[5] - p[2]}, {p[3], p[4], p[5]}, p[6], p[7], 0.0, 0.0, 0.0, 0.0};
    body.axis_square = dot(body.axis, body.axis);
    body.axis_first = dot(body.axis, body.first);
    body.first_square = dot(body.first, body.first) - body.radius * body.radius;
    body.last_square = dot(body.last, body.last) - body.radius * body.radius;
    capsules.push_back(body);
  }
  for (Index k = 0; k < scene.spheres.size(); ++k) {
    const double* p = &scene.spheres(k, 0);
    spheres.push_back({{p[0], p[1], p[2]}, p[3], p[4], dot(p, p) - p[3] * p[3]});
  }
  for (Index k = 0; k < scene.plates.size(); ++k) {
    const double* p = &scene.plates(k, 0);
    plates.push_back({{p[0], p[1], p[2]},
                      {p[3], p[4], p[5]},
                      {p[6], p[7], p[8]},
                      {p[9], p[10], p[11]},
                      p[12],
                      p[13],
                      p[14],
                      p[15],
                      p[16],
                      p[17],
                      p[18],
                      p[19],
                      p[20],
                      p[21],
                      p[22],
                      p[23]});
  }
}

void meet(const Bodies& bodies, Bits among, const Plate* plate, Rays& rays) {
  for (int i = 0; i < rays.count; ++i) {
    rays.length[i] = std::sqrt(rays.x[i] * rays.x[i] + rays.y[i] * rays.y[i] + 1.0);
    rays.depth[i] = inf;
    rays.light[i] = 0.0;
    rays.surface[i] = -1;
  }
  meet_planes(bodies.planes, rays);
  if (plate) meet_plate(*plate, rays);
  const std::size_t capsules = bodies.capsules.size();
  for (std::size_t k = 0; k < capsules; ++k) {
    const std::int64_t surface = 64 * static_cast<std::int64_t>(Kind::capsule) + static_cast<std::int64_t>(k);
    if (among >> k & 1) meet_capsule(bodies.capsules[k], surface, rays);
  }
  for (std::size_t k = 0; k < bodies.spheres.size(); ++k) {
    const std::int64_t surface = 64 * static_cast<std::int64_t>(Kind::sphere) + static_cast<std::int64_t>(k);
    if (among >> (capsules + k) & 1) meet_sphere(bodies.spheres[k], surface, rays);
  }
}

Bits find_near(const Bodies& bodies, Bits among, double x, double y, double reach) {
  Bits found = 0;
  const double square = x * x + y * y + 1.0;
  for (std::size_t k = 0; k < bodies.capsules.size(); ++k) {
    if (!(among >> k & 1)) continue;
    const Capsule& body = bodies.capsules[k];
    if (pass(x, y, square, body).distance < body.radius + reach * (std::max(body.first[2], body.last[2]) + body.radius)) {
      found |= Bits{1} << k;
    }
  }
  for (std::size_t k = 0; k < bodies.spheres.size(); ++k) {
    const std::size_t bit = bodies.capsules.size() + k;
    if (!(among >> bit & 1)) continue;
    const Sphere& body = bodies.spheres[k];
    const double t = std::max((x * body.centre[0] + y * body.centre[1] + body.centre[2]) / square, 0.0);
    const double dx = t * x - body.centre[0], dy = t * y - body.centre[1], dz = t - body.centre[2];
    const double distance = std::sqrt(dx * dx + dy * dy + dz * dz);
    if (distance < body.radius + reach * (body.centre[2] + body.radius)) found |= Bits{1} << bit;
  }
  return found;
}

void meet_plane(const Plate& plate, const Rays& rays, double* __restrict a, double* __restrict b) {
  const double distance = dot(plate.z, plate.origin);
  for (int i = 0; i < rays.count; ++i) {
    const double towards = plate.z[0] * rays.x[i] + plate.z[1] * rays.y[i] + plate.z[2];
    const OnPlane at = meet_plane(plate, rays.x[i], rays.y[i], towards, distance);
    a[i] = at.met ? at.a : nan, b[i] = at.met ? at.b : nan;
  }
}

}  // namespace cabinpose

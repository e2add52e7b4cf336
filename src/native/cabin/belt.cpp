#include "cabin/belt.hpp"

#include <algorithm>
#include <array>
#include <limits>
#include <vector>

#include "core/math.hpp"
#include "core/vec.hpp"

namespace cabinpose {
namespace {

constexpr int n_rows = 3, middle = 1;  // strings of a ribbon: edge, middle, edge
constexpr double largest_tilt = 0.45;  // how much deeper than the highest row another may lie, by the webbing's width

/// A point of a plane, m.
struct Vec2 {
  double x = 0.0, y = 0.0;
};

Vec2 operator+(Vec2 a, Vec2 b) { return {a.x + b.x, a.y + b.y}; }
Vec2 operator-(Vec2 a, Vec2 b) { return {a.x - b.x, a.y - b.y}; }
Vec2 operator*(double s, Vec2 a) { return {s * a.x, s * a.y}; }
double square(Vec2 a) { return a.x * a.x + a.y * a.y; }

using Points = std::vector<Vec2>;

/// A piece of a bone from `start` to `start + along`, m.
struct Piece {
  Vec3 start, along;
  double square_length, square_girth;
};

/// Buffers that are kept between calls.
struct Workspace {
  std::vector<float> signed_distance;  // of the skin's vertices from the middle plane, m
  std::vector<Piece> pieces;
  std::array<Points, n_rows> sections;
  Points cloud, sorted, ring, path;
  std::vector<double> along, angles, path_angles;
  std::vector<std::array<Vec2, n_rows>> lines;
  std::vector<std::array<Vec3, n_rows>> laid;
};

/// The planes of a ribbon's strings, parallel to x and y; x goes from end to end.
struct Planes {
  Vec3 origin, x, y, normal;
  double offsets[n_rows];  // m, along the normal
  Vec2 goal, front;        // the other end, and the direction to the body's side, in a plane
};

Vec3 divided(Vec3 a, double s) { return {a.x / s, a.y / s, a.z / s}; }

/// The pieces of bones, with what distances from them need.
void prepare(const TrunkBones& bones, std::vector<Piece>& pieces) {
  pieces.clear();
  for (Index m = 0; m < bones.girth.size(); ++m) {
    const double *ends = bones.ends[m].data(), girth = bones.girth(m);
    const Vec3 start = vec3(ends), along = vec3(ends + 3) - start;
    pieces.push_back({start, along, dot(along, along), girth * girth});
  }
}

/// Squared distance of a point from a piece, against its girth.
double nearness(Vec3 point, const Piece& piece) {
  const Vec3 p = point - piece.start;
  const double t = std::min(std::max(dot(p, piece.along) / piece.square_length, 0.0), 1.0);
  const Vec3 d = p - (piece.square_length == 0.0 ? 0.0 : t) * piece.along;
  return dot(d, d) / piece.square_girth;
}

/// Whether a point of the skin is the trunk's: one of the first `n_trunk` pieces is nearest.
bool of_trunk(Vec3 point, const std::vector<Piece>& pieces, std::size_t n_trunk) {
  double nearest = std::numeric_limits<double>::infinity();
  for (std::size_t m = 0; m < n_trunk; ++m) nearest = std::min(nearest, nearness(point, pieces[m]));
  for (std::size_t m = n_trunk; m < pieces.size(); ++m) {
    if (nearness(point, pieces[m]) < nearest) return false;
  }
  return true;
}

/// Whether a face of a limb, by its kind and centre, is near enough to the limb's root.
bool near_root(const LainOn& lain_on, int kind, Vec3 center) {
  const double* limb = &lain_on.limbs(kind - 2, 0);
  const Vec3 bone = vec3(limb + 3);
  return dot(center - vec3(limb), bone) / dot(bone, bone) < limb[6];
}

/// Points where the planes cut the trunk's triangles, one list a plane.
void cut_sections(Array<const float, any, 3> skin, Array<const std::int32_t, any, 3> faces, const LainOn& lain_on,
                  const TrunkBones& bones, const Planes& planes, Workspace& work) {
  const Vec3 n = planes.normal;
  const double shift = dot(n, planes.origin);
  work.signed_distance.resize(static_cast<std::size_t>(skin.size()));
  float* __restrict signed_distance = work.signed_distance.data();
  const float* at = skin.data();
  for (Index i = 0; i < skin.size(); ++i) {
    const double x = static_cast<double>(at[3 * i]), y = static_cast<double>(at[3 * i + 1]),
                 z = static_cast<double>(at[3 * i + 2]);
    signed_distance[i] = static_cast<float>(n.x * x + n.y * y + n.z * z - shift);
  }
  const double lowest = planes.offsets[0], highest = planes.offsets[n_rows - 1];
  for (Points& section : work.sections) section.clear();
  prepare(bones, work.pieces);
  const std::size_t n_trunk = std::min(static_cast<std::size_t>(bones.n_trunk), work.pieces.size());
  for (Index f = 0; f < faces.size(); ++f) {
    const int kind = lain_on.kinds(lain_on.labels(f));
    if (kind == 0) continue;
    const std::int32_t* corner = faces[f].data();
    const float da = signed_distance[corner[0]], db = signed_distance[corner[1]], dc = signed_distance[corner[2]];
    const double low = static_cast<double>(std::min(std::min(da, db), dc));
    const double high = static_cast<double>(std::max(std::max(da, db), dc));
    if ((high <= lowest) | (low > highest)) continue;  // without a branch between the two: both are hard to predict
    bool cut = false;
    for (double offset : planes.offsets) cut = cut || (low <= offset && offset < high);
    if (!cut) continue;
    double center[3];
    const float* p[3] = {at + 3 * corner[0], at + 3 * corner[1], at + 3 * corner[2]};
    for (int k = 0; k < 3; ++k) center[k] = static_cast<double>(p[0][k] + p[1][k] + p[2][k]) / 3.0;
    if (kind > 1 && !near_root(lain_on, kind, vec3(center))) continue;
    if (!of_trunk(vec3(center), work.pieces, n_trunk)) continue;
    const double d[3] = {static_cast<double>(da), static_cast<double>(db), static_cast<double>(dc)};
    for (int row = 0; row < n_rows; ++row) {
      for (int i = 0; i < 3; ++i) {
        const int j = i == 2 ? 0 : i + 1;
        const double di = d[i] - planes.offsets[row], dj = d[j] - planes.offsets[row];
        if ((di > 0.0) == (dj > 0.0)) continue;
        const double s = di / (di - dj);
        Vec3 q;
        for (int k = 0; k < 3; ++k) q[k] = static_cast<double>(p[i][k]) + s * static_cast<double>(p[j][k] - p[i][k]);
        q = q - planes.origin;
        work.sections[static_cast<std::size_t>(row)].push_back({dot(q, planes.x), dot(q, planes.y)});
      }
    }
  }
}

/// The convex hull of points, counter-clockwise (Andrew's monotone chain); fewer than three stay as they are. Sorts the points.
void convex_hull(Points& points, Points& hull) {
  hull.clear();
  const std::size_t n = points.size();
  if (n < 3) {
    hull.insert(hull.end(), points.begin(), points.end());
    return;
  }
  std::stable_sort(points.begin(), points.end(), [](Vec2 a, Vec2 b) { return a.x < b.x; });
  for (int chain = 0; chain < 2; ++chain) {
    const std::size_t first = hull.size();
    for (std::size_t r = 0; r < n; ++r) {
      const Vec2 p = points[chain == 0 ? r : n - 1 - r];
      while (hull.size() >= first + 2) {
        const Vec2 q = hull.back(), o = hull[hull.size() - 2];
        if ((q.x - o.x) * (p.y - o.y) - (q.y - o.y) * (p.x - o.x) > 0.0) break;
        hull.pop_back();
      }
      hull.push_back(p);
    }
    hull.pop_back();  // the last point of a chain starts the other
  }
}

/// The string in a plane, into work.path: from the origin to the goal around the section on its front side, `gap` clear of it.
void pull_taut(Points& section, const Planes& planes, double gap, Workspace& work) {
  constexpr int n_grown = 8;  // points around each corner of the hull, which together are the hull grown by the gap
  Vec2 grown[n_grown];
  for (int k = 0; k < n_grown; ++k) grown[k] = 1.08 * gap * Vec2{cos(0.25 * pi * k), sin(0.25 * pi * k)};
  const Vec2 goal = planes.goal;
  Points &ring = work.ring, &path = work.path;
  convex_hull(section, ring);
  work.cloud.clear();
  for (Vec2 corner : ring) {
    for (Vec2 g : grown) work.cloud.push_back(corner + g);
  }
  work.cloud.push_back({});
  work.cloud.push_back(goal);
  convex_hull(work.cloud, ring);
  const Index m = std::ssize(ring);
  const auto corner = [&](Index i) { return ring[static_cast<std::size_t>(i)]; };
  Index i0 = 0, i1 = 0;
  for (Index i = 0; i < m; ++i) {
    if (square(corner(i)) < square(corner(i0))) i0 = i;
    if (square(corner(i) - goal) < square(corner(i1) - goal)) i1 = i;
  }
  const Index forward = (i1 - i0 + m) % m, backward = (i0 - i1 + m) % m;
  double reach[2] = {-1e8, -1e8};
  for (Index k = 0; k <= std::max(forward, backward); ++k) {
    const Vec2 p = corner((i0 + k) % m), q = corner((i0 - k + m) % m);
    if (k <= forward) reach[0] = std::max(reach[0], p.x * planes.front.x + p.y * planes.front.y);
    if (k <= backward) reach[1] = std::max(reach[1], q.x * planes.front.x + q.y * planes.front.y);
  }
  const bool turned = reach[1] > reach[0];
  path.clear();
  path.push_back({});
  for (Index k = 0; k <= (turned ? backward : forward); ++k) path.push_back(corner((turned ? i0 - k + m : i0 + k) % m));
  path.push_back(goal);
}

/// Point `row` of each station at even arc length along work.path.
void resample(Workspace& work, std::size_t row) {
  const Points& path = work.path;
  const std::size_t n = path.size(), steps = work.lines.size();
  work.along.assign(n, 0.0);
  for (std::size_t i = 1; i < n; ++i) work.along[i] = work.along[i - 1] + std::sqrt(square(path[i] - path[i - 1]));
  std::size_t k = 0;
  for (std::size_t s = 0; s < steps; ++s) {
    const double target = work.along[n - 1] * static_cast<double>(s) / static_cast<double>(steps - 1);
    while (k < n - 2 && work.along[k + 1] < target) ++k;
    const double span = work.along[k + 1] - work.along[k];
    const double t = span > 0.0 ? std::min(std::max((target - work.along[k]) / span, 0.0), 1.0) : 0.0;
    work.lines[s][row] = path[k] + t * (path[k + 1] - path[k]);
  }
}

/// Angle of a point seen from the middle of the chord from the origin to the goal, rad: pi at the start, 0 at the goal, either
/// way round.
double angle_of(Vec2 p, Vec2 goal) { return std::fabs(atan2(p.y, p.x - 0.5 * goal.x)); }

/// Point `row` of each station where work.path has the station's angle.
void at_angles(Workspace& work, std::size_t row, Vec2 goal) {
  const Points& path = work.path;
  work.path_angles.clear();
  for (Vec2 p : path) work.path_angles.push_back(angle_of(p, goal));
  const Vec2 middle_of_chord = 0.5 * goal;
  std::size_t k = 0;
  for (std::size_t s = 0; s < work.lines.size(); ++s) {
    const double angle = work.angles[s];
    while (k < path.size() - 2 && work.path_angles[k + 1] > angle) ++k;
    // Where the ray at this angle, on the side that the piece lies on, meets the piece.
    const Vec2 from = path[k] - middle_of_chord, to = path[k + 1] - middle_of_chord;
    const double side = std::fabs(from.y) > std::fabs(to.y) ? from.y : to.y;
    const Vec2 ray{cos(angle), std::copysign(sin(angle), side)};
    const double before = ray.x * from.y - ray.y * from.x, after = ray.x * to.y - ray.y * to.x;
    const double t = before == after ? 0.0 : std::min(std::max(before / (before - after), 0.0), 1.0);
    work.lines[s][row] = path[k] + t * (path[k + 1] - path[k]);
  }
  work.lines.front()[row] = path.front();
  work.lines.back()[row] = path.back();
}

/// Strings in the three planes, (cross-section, row), into work.lines; the cross-sections' points share their angle.
///
/// Seen from the middle of the chord a convex string turns one way, so an angle names one point of each string; the
/// cross-sections are even in length along the middle one.
void draw_lines(const Planes& planes, double gap, Workspace& work) {
  pull_taut(work.sections[middle], planes, gap, work);
  resample(work, middle);
  work.angles.clear();
  for (const auto& line : work.lines) work.angles.push_back(angle_of(line[middle], planes.goal));
  for (int row : {0, 2}) {
    pull_taut(work.sections[static_cast<std::size_t>(row)], planes, gap, work);
    at_angles(work, static_cast<std::size_t>(row), planes.goal);
  }
  const double center = 0.5 * planes.goal.x;
  const double depth = largest_tilt * std::fabs(planes.offsets[n_rows - 1] - planes.offsets[0]);
  for (auto& line : work.lines) {  // webbing tilts at most so far: rows that lie deeper are lifted from the body
    double radius[n_rows];
    for (std::size_t row = 0; row < n_rows; ++row) radius[row] = std::sqrt(square(line[row] - Vec2{center, 0.0}));
    const double floor = std::max(std::max(radius[0], radius[1]), radius[2]) - depth;
    for (std::size_t row = 0; row < n_rows; ++row) {
      if (!(radius[row] < floor)) continue;
      line[row].x = center + (line[row].x - center) * floor / radius[row];
      line[row].y *= floor / radius[row];
    }
  }
}

Planes planes_of(Array<const double, 4, 3> course, double width) {
  const Vec3 start = vec3(&course(0, 0)), through = vec3(&course(1, 0)), end = vec3(&course(2, 0)), front = vec3(&course(3, 0));
  Planes planes;
  const Vec3 chord = end - start, side = through - start;
  planes.origin = start;
  planes.x = divided(chord, norm(chord));
  const Vec3 y = side - dot(side, planes.x) * planes.x;
  planes.y = divided(y, norm(y));
  planes.normal = cross(planes.x, planes.y);
  for (int row = 0; row < n_rows; ++row) planes.offsets[row] = 0.5 * (row - middle) * width;
  planes.goal = {dot(chord, planes.x), 0.0};
  planes.front = {dot(front, planes.x), dot(front, planes.y)};
  return planes;
}

}  // namespace

bool belt_ribbon(Array<const float, any, 3> skin, Array<const std::int32_t, any, 3> faces, const LainOn& lain_on,
                 TrunkBones bones, Array<const double, 4, 3> course, Webbing webbing, Array<float, 2, any, 3, 3> vertices,
                 Array<float, 2, any, 3, 3> normals) {
  static thread_local Workspace work;
  const std::size_t steps = static_cast<std::size_t>(vertices.size(1));
  const Planes planes = planes_of(course, webbing.width);
  work.lines.resize(steps);
  work.laid.resize(steps);
  cut_sections(skin, faces, lain_on, bones, planes, work);
  draw_lines(planes, webbing.gap, work);
  for (std::size_t s = 0; s < steps; ++s) {
    for (std::size_t row = 0; row < n_rows; ++row) {
      const Vec2 p = work.lines[s][row];
      work.laid[s][row] = planes.origin + planes.offsets[row] * planes.normal + (p.x * planes.x + p.y * planes.y);
    }
  }
  const auto normal = [&](std::size_t s, std::size_t row) {
    const auto& at = work.laid;
    const Vec3 along = at[std::min(s + 1, steps - 1)][row] - at[s == 0 ? 0 : s - 1][row];
    const Vec3 over = cross(along, at[s][2] - at[s][0]);
    return divided(over, std::max(norm(over), 1e-12));
  };
  const std::size_t half = steps / 2;  // a string bends around the body, away from the chord of its ends
  const Vec3 inside = planes.origin + 0.5 * (vec3(&course(2, 0)) - planes.origin);
  const bool flip = dot(work.laid[half][middle] - inside, normal(half, middle)) < 0.0;
  for (std::size_t s = 0; s < steps; ++s) {
    for (std::size_t row = 0; row < n_rows; ++row) {
      const Vec3 over = (flip ? -1.0 : 1.0) * normal(s, row), inner = work.laid[s][row], outer = inner + webbing.thickness * over;
      for (int k = 0; k < 3; ++k) {
        vertices(0, s, row, k) = static_cast<float>(outer[k]);
        vertices(1, s, row, k) = static_cast<float>(inner[k]);
        normals(0, s, row, k) = static_cast<float>(over[k]);
        normals(1, s, row, k) = -static_cast<float>(over[k]);
      }
    }
  }
  return flip;
}

bool any_nearer(Array<const float, any, 3> points, Array<const float, 3> place, double distance) {
  const double square_distance = distance * distance;
  for (Index i = 0; i < points.size(); ++i) {
    const float x = points(i, 0) - place(0), y = points(i, 1) - place(1), z = points(i, 2) - place(2);
    if (static_cast<double>(x * x + y * y + z * z) < square_distance) return true;
  }
  return false;
}

}  // namespace cabinpose

// Indirect light: what surfaces that the camera's own light reaches send on to others (multipath).
#include <algorithm>
#include <cmath>
#include <vector>

#include "core/bind.hpp"
#include "core/math.hpp"
#include "core/vec.hpp"
#include "sensor/light.hpp"
#include "sensor/view.hpp"

namespace cabinpose {

/// The light of a camera and what it falls on, images (H, W). `_LitScene` in scene/sensor/indirect.py.
struct LitScene {
  Array<const float, any, any, 2> rays;       // x, y of the rays (x, y, 1), NaN outside the lens model
  Array<const float, any, any> flux;          // (h, w): of the light into each cell of step x step pixels
  Array<const float, any, any> illumination;  // radiant intensity of the light along the rays
  Finishes table;
  Array<const double, any> frequencies;     // Hz
  int step, bounces;                        // pixels of a cell's side; surfaces between the light and what the camera sees
  double unseen, unseen_area, unseen_path;  // reflectance, area (m^2) and length of the way by (m) what the camera does not see

  CABINPOSE_FIELDS(LitScene, rays, flux, illumination, table, frequencies, step, bounces, unseen, unseen_area, unseen_path)
};

namespace {

constexpr Index most = 2;              // frequencies
constexpr double least_cosine = 0.05;  // of a patch seen at a slant

// A patch's light counts at pixels in its plane, to a sixth of its radius.
constexpr double off_plane = 3e-2;
constexpr float least_share = 1e-3f, least_weight = 1e-6f;
// A point between two patches is inside of what the camera sees where it is this much behind that, and not in front of something
// else: as thick as a headrest's edge, an arm, a door's trim. Thicker ones hide too much, thinner ones too little.
constexpr int looks = 6;
constexpr float deep = 0.03f, thick = 0.08f;  // m

/// Light: energy, and a phasor for each frequency.
struct Phasors {
  float energy = 0.0f, re[most] = {}, im[most] = {};

  void add(float weight, const Phasors& other) {
    energy += weight * other.energy;
    for (Index f = 0; f < most; ++f) {
      re[f] += weight * other.re[f];
      im[f] += weight * other.im[f];
    }
  }
  /// Adds light that came a way, whose phase turns it by (cosine, sine).
  void add(float weight, const Phasors& other, const float* cosine, const float* sine) {
    energy += weight * other.energy;
    for (Index f = 0; f < most; ++f) {
      re[f] += weight * (other.re[f] * cosine[f] - other.im[f] * sine[f]);
      im[f] += weight * (other.re[f] * sine[f] + other.im[f] * cosine[f]);
    }
  }
};

/// The surface in the middle of a cell of pixels.
struct Patch {
  Index v, u;                   // its pixel
  float x, y, z;                // m, in the camera
  float nx, ny, nz;             // unit normal, towards the camera
  float disc, reach;            // area / pi, and that times the reflectance (m^2)
  float sharpness;              // 1 / m^2, of what is in its plane
  float open;                   // share of the directions in which it sees no other patch
  Phasors sent, received, all;  // flux / pi, and irradiance, in this bounce; irradiance in all
};

/// Two patches in each other's sight: how much of each one's light arrives at the other, and the phase of the way.
struct Pair {
  std::int32_t a, b;
  float to_a, to_b, cosine[most], sine[most];
};

/// Memory that a thread uses again for its next frame.
struct Workspace {
  std::vector<Patch> patches;
  std::vector<std::int32_t> cell;  // (h, w): which patch, -1 where nothing was hit
  std::vector<Pair> pairs;
  std::vector<float> places, facing;  // x, y, z, nx, ny, nz (6, n) of the patches; how they face one of them
};

struct Scene {
  const View& view;
  const LitScene& lit;
  Index height = view.depth_m.size(0), width = view.depth_m.size(1), down = lit.flux.size(0), across = lit.flux.size(1);
  Index step = lit.step, frequencies = lit.frequencies.size();
  float per_m[most] = {};  // turns of the phase per metre of way

  Scene(const View& of, const LitScene& with) : view(of), lit(with) {
    for (Index f = 0; f < frequencies; ++f) per_m[f] = static_cast<float>(lit.frequencies(f) / speed_of_light);
  }

  bool hit(Index v, Index u) const { return view.depth_m(v, u) > 0.0f && std::isfinite(lit.rays(v, u, 0)); }
  Vec3 point(Index v, Index u) const {
    const double depth = static_cast<double>(view.depth_m(v, u));
    return {depth * static_cast<double>(lit.rays(v, u, 0)), depth * static_cast<double>(lit.rays(v, u, 1)), depth};
  }

  /// From the pixel to its neighbour on one side, or to it from that on the other, whichever is nearer in depth.
  Vec3 slope(Index v, Index u, Index dv, Index du) const {
    const Vec3 here = point(v, u);
    Vec3 best{0.0, 0.0, 1e9};
    for (const Index sign : {1, -1}) {
      const Index row = v + sign * dv, column = u + sign * du;
      if (row < 0 || column < 0 || row >= height || column >= width || !hit(row, column)) continue;
      const Vec3 way = static_cast<double>(sign) * (point(row, column) - here);
      if (std::fabs(way.z) < std::fabs(best.z)) best = way;
    }
    return best;
  }
};

void make_patches(const Scene& scene, Workspace& to) {
  to.patches.clear();
  to.cell.assign(static_cast<std::size_t>(scene.down * scene.across), -1);
  for (Index i = 0; i < scene.down; ++i) {
    for (Index j = 0; j < scene.across; ++j) {
      const Index v = std::min(i * scene.step + scene.step / 2, scene.height - 1);
      const Index u = std::min(j * scene.step + scene.step / 2, scene.width - 1);
      if (!scene.hit(v, u)) continue;
      const Vec3 p = scene.point(v, u);
      Vec3 normal = cross(scene.slope(v, u, 1, 0), scene.slope(v, u, 0, 1));
      const double length = norm(normal), range = norm(p), flux = static_cast<double>(scene.lit.flux(i, j));
      if (!(length > 0.0) || !(flux > 0.0)) continue;
      normal = (dot(normal, p) > 0.0 ? -1.0 : 1.0) / length * normal;
      const double cosine = std::max(-dot(normal, p) / range, least_cosine);
      const double lit = static_cast<double>(scene.lit.illumination(v, u));
      const double rho = static_cast<double>(scene.lit.table(scene.view.material(v, u), 0));
      const double disc = flux / lit * range * range / cosine / pi;
      const auto number = [](double value) { return static_cast<float>(value); };
      Patch patch{v,
                  u,
                  number(p.x),
                  number(p.y),
                  number(p.z),
                  number(normal.x),
                  number(normal.y),
                  number(normal.z),
                  number(disc),
                  number(rho * disc),
                  number(1.0 / (off_plane * disc)),
                  1.0f,
                  {},
                  {},
                  {}};
      const double sent = scene.view.cos_incidence(v, u) > 0.0f ? flux * rho / pi : 0.0;  // 0 in the shadow of the light source
      patch.sent.energy = number(sent);
      for (Index f = 0; f < scene.frequencies; ++f) {
        const double phase = 2.0 * pi * scene.lit.frequencies(f) / speed_of_light * range;
        patch.sent.re[f] = number(sent * cos(phase));
        patch.sent.im[f] = number(sent * sin(phase));
      }
      to.cell[static_cast<std::size_t>(i * scene.across + j)] = static_cast<std::int32_t>(to.patches.size());
      to.patches.push_back(patch);
    }
  }
}

/// Whether nothing that the camera sees is between two patches.
bool in_sight(const Scene& scene, const Patch& a, const Patch& b) {
  const float rows = static_cast<float>(b.v - a.v), columns = static_cast<float>(b.u - a.u);
  for (int k = 1; k <= looks; ++k) {
    const float t = static_cast<float>(k) / (looks + 1), z = a.z + t * (b.z - a.z), share = t * b.z / z;  // in perspective
    const Index v = a.v + static_cast<Index>(share * rows), u = a.u + static_cast<Index>(share * columns);
    const float first = scene.view.depth_m(v, u);
    if (first > 0.0f && z > first + deep && z < first + thick) return false;
  }
  return true;
}

/// Sets cos cos d^2 of the first n patches and one at `to`, 0 where they face away. places: x, y, z, nx, ny, nz (6, room).
void face(const float* places, Index room, Index n, const Patch& to, float* __restrict facing) {
  const float *x = places, *y = x + room, *z = y + room, *nx = z + room, *ny = nx + room, *nz = ny + room;
  const float tx = to.x, ty = to.y, tz = to.z, tnx = to.nx, tny = to.ny, tnz = to.nz;
  for (Index i = 0; i < n; ++i) {
    const float dx = x[i] - tx, dy = y[i] - ty, dz = z[i] - tz;
    const float out = tnx * dx + tny * dy + tnz * dz, in = -(nx[i] * dx + ny[i] * dy + nz[i] * dz);
    facing[i] = (out > 0.0f ? out : 0.0f) * (in > 0.0f ? in : 0.0f);
  }
}

/// All pairs of patches that face each other: cos cos / (pi d^2), of a disc on its axis, without the 1 / pi that `sent` has.
void find_pairs(const Scene& scene, Workspace& to) {
  const Index n = static_cast<Index>(to.patches.size());
  Patch* patches = to.patches.data();
  to.pairs.clear();
  to.facing.resize(static_cast<std::size_t>(n));
  to.places.resize(static_cast<std::size_t>(6 * n));
  float* place = to.places.data();
  for (const auto member : {&Patch::x, &Patch::y, &Patch::z, &Patch::nx, &Patch::ny, &Patch::nz}) {
    for (const Patch& patch : to.patches) *place++ = patch.*member;
  }
  for (Index j = 0; j < n; ++j) {
    Patch& b = patches[j];
    face(to.places.data(), n, j, b, to.facing.data());
    for (Index i = 0; i < j; ++i) {
      Patch& a = patches[i];
      const float facing = to.facing[static_cast<std::size_t>(i)];
      if (!(facing > 0.0f) || !in_sight(scene, a, b)) continue;
      const float dx = a.x - b.x, dy = a.y - b.y, dz = a.z - b.z, square = dx * dx + dy * dy + dz * dz;
      const float cosines = facing / square, distance = std::sqrt(square);
      Pair pair{static_cast<std::int32_t>(i),
                static_cast<std::int32_t>(j),
                cosines / (square + b.disc),
                cosines / (square + a.disc),
                {},
                {}};
      for (Index f = 0; f < scene.frequencies; ++f) cosine_and_sine(distance * scene.per_m[f], pair.cosine[f], pair.sine[f]);
      a.open -= pair.to_a * b.disc;
      b.open -= pair.to_b * a.disc;
      to.pairs.push_back(pair);
    }
  }
  for (Patch& patch : to.patches) patch.open = std::max(patch.open, 0.0f);
}

/// Adds what surfaces that the camera does not see return of the light that they receive, evenly, as in an integrating sphere.
void add_unseen(const Scene& scene, std::vector<Patch>& patches) {
  const LitScene& lit = scene.lit;
  Phasors light, returned;
  for (const Patch& patch : patches) light.add(patch.open, patch.sent);
  float cosine[most] = {}, sine[most] = {};
  for (Index f = 0; f < scene.frequencies; ++f) {
    cosine_and_sine(static_cast<float>(lit.unseen_path) * scene.per_m[f], cosine[f], sine[f]);
  }
  returned.add(static_cast<float>(pi * lit.unseen / lit.unseen_area), light, cosine, sine);
  for (Patch& patch : patches) patch.received.add(patch.open, returned);
}

/// What all patches receive of what all send, and send on.
void bounce(const Scene& scene, Workspace& memory) {
  Patch* patches = memory.patches.data();
  for (Patch& patch : memory.patches) patch.received = Phasors{};
  for (const Pair& pair : memory.pairs) {
    Patch &a = patches[pair.a], &b = patches[pair.b];
    a.received.add(pair.to_a, b.sent, pair.cosine, pair.sine);
    b.received.add(pair.to_b, a.sent, pair.cosine, pair.sine);
  }
  if (scene.lit.unseen > 0.0) add_unseen(scene, memory.patches);
  for (Patch& patch : memory.patches) {
    patch.all.add(1.0f, patch.received);
    patch.sent = Phasors{};
    patch.sent.add(patch.reach, patch.received);
  }
}

/// A few pixels of a row between the same four patches, in loops of a fixed length.
struct Group {
  static constexpr Index size = 16;
  float x[size] = {}, y[size] = {}, z[size] = {}, right[size] = {};  // m; share of the patches to the right
  float total[size] = {}, light[1 + 2 * most][size] = {};

  /// Adds a patch's light: more at pixels on its surface, and at those that `right` and `below` say are near it.
  void add(const Patch& patch, bool is_right, float below) {
    const float px = patch.x, py = patch.y, pz = patch.z, nx = patch.nx, ny = patch.ny, nz = patch.nz;
    const float from = is_right ? 0.0f : below, slope = is_right ? below : -below, sharpness = patch.sharpness;
    const float lights[] = {patch.all.energy, patch.all.re[0], patch.all.im[0], patch.all.re[1], patch.all.im[1]};
    for (Index i = 0; i < size; ++i) {
      const float off = nx * (x[i] - px) + ny * (y[i] - py) + nz * (z[i] - pz), apart = off * off * sharpness;
      const float weight = (from + slope * right[i] + least_share) * (1.0f / (1.0f + apart * apart) + least_weight);
      total[i] += weight;
      for (Index k = 0; k < 1 + 2 * most; ++k) light[k][i] += weight * lights[k];
    }
  }
};

/// Light that arrives at a row of pixels (1 + 2 F, W), each from the four patches about it: those on its surface count.
void at_pixels(const Scene& scene, const Workspace& memory, Index v, float* row) {
  const Index step = scene.step, middle = step / 2, width = scene.width, planes = 1 + 2 * scene.frequencies;
  const Index above = std::max<Index>(v - middle, 0) / step;
  const float scale = 1.0f / static_cast<float>(step);
  const float below = scale * static_cast<float>(std::max<Index>(v - middle, 0) - above * step);
  const float *depth = &scene.view.depth_m(v, 0), *rays = &scene.lit.rays(v, 0, 0);
  for (Index u = 0, m = 0; u < width; u += m) {
    const Index left = std::max<Index>(u - middle, 0) / step;
    m = std::min({Group::size, width - u, (left + 1) * step + middle - u});
    Group group;
    for (Index i = 0; i < m; ++i) {
      group.z[i] = depth[u + i];
      group.x[i] = depth[u + i] * rays[2 * (u + i)];
      group.y[i] = depth[u + i] * rays[2 * (u + i) + 1];
      group.right[i] = scale * static_cast<float>(std::max<Index>(u + i - middle, 0) - left * step);
    }
    for (Index k = 0; k < 4; ++k) {
      const Index down = std::min(above + (k >> 1), scene.down - 1), across = std::min(left + (k & 1), scene.across - 1);
      const std::int32_t which = memory.cell[static_cast<std::size_t>(down * scene.across + across)];
      if (which >= 0) group.add(memory.patches[static_cast<std::size_t>(which)], k & 1, k >> 1 ? below : 1.0f - below);
    }
    for (Index i = 0; i < m; ++i) {
      const bool lit = group.total[i] > 0.0f && group.z[i] > 0.0f;  // and no NaN, which is outside the lens model
      for (Index k = 0; k < planes; ++k) row[k * width + u + i] = lit ? group.light[k][i] / group.total[i] : 0.0f;
    }
  }
}

/// Turns light that arrives at a row of pixels (1 + 2 F, W) into what comes back to the camera.
void to_camera(const Scene& scene, Index v, float* row) {
  const LitScene& lit = scene.lit;
  const Index width = scene.width;
  const float *rays = &lit.rays(v, 0, 0), *illumination = &lit.illumination(v, 0), *table = lit.table.data();
  const float* depth = &scene.view.depth_m(v, 0);
  const std::uint8_t* material = &scene.view.material(v, 0);
  for (Index u = 0; u < width; ++u) row[u] *= table[finish_columns * material[u]] / illumination[u];
  for (Index f = 0; f < scene.frequencies; ++f) {
    float* __restrict re = row + (1 + 2 * f) * width, * __restrict im = row + (2 + 2 * f) * width;
    const float per_m = scene.per_m[f];
    for (Index u = 0; u < width; ++u) {
      const float x = rays[2 * u], y = rays[2 * u + 1], range = depth[u] * std::sqrt(1.0f + x * x + y * y);
      const float own = table[finish_columns * material[u]] / illumination[u], a = own * re[u], b = own * im[u];
      float c, s;
      cosine_and_sine(where(range > 0.0f, range) * per_m, c, s);  // NaN outside the lens model
      re[u] = a * c - b * s;
      im[u] = a * s + b * c;
    }
  }
}

/// Indirect light (H, 1 + 2 F, W) at the pixels' centres: energy, and (cos, sin) a frequency, in the units of direct energy.
void indirect_light(const View& view, const LitScene& lit, Array<float, any, any, any> out) {
  thread_local Workspace memory;
  const Scene scene(view, lit);
  make_patches(scene, memory);
  find_pairs(scene, memory);
  for (int k = 0; k < lit.bounces; ++k) bounce(scene, memory);
  for (Index v = 0; v < scene.height; ++v) {
    float* row = &out(v, 0, 0);
    at_pixels(scene, memory, v, row);
    to_camera(scene, v, row);
  }
}

}  // namespace

void bind_indirect_light(nb::module_& m) {
  describe<LitScene>(m);
  m.def("indirect_light", &indirect_light, "view"_a, "scene"_a, "out"_a, unlocked(),
        "Light that surfaces send on to others, by virtual point lights.");
}

}  // namespace cabinpose

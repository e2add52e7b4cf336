#include "raster/joints.hpp"

#include <algorithm>
#include <cmath>
#include <limits>

namespace cabinpose {
namespace {

/// Depth z where the ray (x, y, 1) meets a triangle; 0 where it does not.
double meet(const float (&p)[3][3], double x, double y) {
  const double ax = p[0][0], ay = p[0][1], az = p[0][2], bx = p[1][0], by = p[1][1], bz = p[1][2];
  const double cx = p[2][0], cy = p[2][1], cz = p[2][2];
  const double e0 = (by * cz - bz * cy) * x + (bz * cx - bx * cz) * y + (bx * cy - by * cx);
  const double e1 = (cy * az - cz * ay) * x + (cz * ax - cx * az) * y + (cx * ay - cy * ax);
  const double e2 = (ay * bz - az * by) * x + (az * bx - ax * bz) * y + (ax * by - ay * bx);
  if (!((e0 >= 0.0 && e1 >= 0.0 && e2 >= 0.0) || (e0 <= 0.0 && e1 <= 0.0 && e2 <= 0.0))) return 0.0;
  const double total = e0 + e1 + e2;
  if (total == 0.0) return 0.0;
  const double det = ax * (by * cz - bz * cy) + ay * (bz * cx - bx * cz) + az * (bx * cy - by * cx);
  return det / total;
}

}  // namespace

bool JointRays::start(const Joints& joints, const Lens& lens, int width, int height) {
  joints_ = joints;
  const Index count = joints.positions.size() * joint_count;
  const bool distorts = lens.distorts();
  const double per_u = static_cast<double>(cells) / width, per_v = static_cast<double>(cells) / height;
  columns_per_pixel_ = static_cast<float>(per_u);
  rows_per_pixel_ = static_cast<float>(per_v);
  rays_.clear();
  for (Index i = 0; i < count; ++i) {
    const double* p = joints.positions.data() + 3 * i;
    if (!(p[2] > 0.0)) continue;
    const double x = p[0] / p[2], y = p[1] / p[2];
    const auto [u, v] = lens.pixel(x, y);
    if (!(u >= -0.5 && u < width - 0.5 && v >= -0.5 && v < height - 0.5)) continue;
    // A distorting lens must also be able to see it: beyond the rays of the image its polynomial may fold back into it.
    if (distorts && !(x >= lens.box[0] && x <= lens.box[2] && y >= lens.box[1] && y <= lens.box[3])) continue;
    if (x * x + y * y > lens.radius * lens.radius) continue;
    const int row = std::clamp(static_cast<int>((v + 0.5) * per_v), 0, cells - 1);
    const int column = std::clamp(static_cast<int>((u + 0.5) * per_u), 0, cells - 1);
    rays_.push_back(
        {x, y, p[2], static_cast<float>(u), static_cast<float>(v), row, column, i, std::numeric_limits<double>::infinity(), -1});
  }
  std::sort(rays_.begin(), rays_.end(),
            [](const Ray& a, const Ray& b) { return a.row != b.row ? a.row < b.row : a.joint < b.joint; });
  std::fill_n(occupied_, cells, 0);
  std::fill_n(row_begin_, cells + 1, 0);
  for (const Ray& ray : rays_) {
    occupied_[ray.row] |= std::uint64_t{1} << ray.column;
    ++row_begin_[ray.row + 1];
  }
  for (int r = 0; r < cells; ++r) row_begin_[r + 1] += row_begin_[r];
  return !rays_.empty();
}

void JointRays::hit(std::int32_t face, const Polygon& p, const Surface& surface, const Pose& pose) {
  const auto [left, right] = std::minmax_element(p.u, p.u + p.size);
  const auto [top, bottom] = std::minmax_element(p.v, p.v + p.size);
  const auto row = [&](double v) { return static_cast<int>(std::clamp((v + 0.5) * double{rows_per_pixel_}, 0.0, cells - 1.0)); };
  const Extent extent{static_cast<float>(*left - p.margin),
                      static_cast<float>(*right + p.margin),
                      static_cast<float>(*top - p.margin),
                      static_cast<float>(*bottom + p.margin),
                      row(*top - p.margin),
                      row(*bottom + p.margin)};
  hit(face, extent, surface, pose);
}

void JointRays::hit(std::int32_t face, const Extent& e, const Surface& surface, const Pose& pose) {
  if (joints_.passed_labels[surface.label[face]] || joints_.passed_materials[surface.material[face]]) return;
  bool moved = false;
  float p[3][3];
  for (int i = row_begin_[e.first_row]; i < row_begin_[e.last_row + 1]; ++i) {
    Ray& ray = rays_[i];
    if (!((ray.u >= e.left) & (ray.u <= e.right) & (ray.v >= e.top) & (ray.v <= e.bottom))) continue;
    if (!moved) {
      for (int k = 0; k < 3; ++k) pose.move(&surface.vertices(surface.faces(face, k), 0), p[k]);
      moved = true;
    }
    const double z = meet(p, ray.x, ray.y);
    if (z >= near_m && z < ray.z && z < ray.hit_z) {
      ray.hit_z = z;
      ray.face = face;
    }
  }
}

void JointRays::decide(const Surface& surface, Array<std::uint8_t, any, joint_count> states) const {
  for (Index i = 0; i < states.count(); ++i) {
    const double* p = joints_.positions.data() + 3 * i;
    const bool present = std::isfinite(p[0]) && std::isfinite(p[1]) && std::isfinite(p[2]);
    states.data()[i] = static_cast<std::uint8_t>(present ? Visibility::outside_image : Visibility::absent);
  }
  for (const Ray& ray : rays_) {
    Visibility state = Visibility::visible;
    if (ray.face >= 0) {
      const Index person = ray.joint / joint_count, joint = ray.joint % joint_count;
      const double length = ray.z * std::sqrt(ray.x * ray.x + ray.y * ray.y + 1.0);
      const double distance = length * (1.0 - ray.hit_z / ray.z);
      if (surface.instance[ray.face] != joints_.instances[person]) {
        state = Visibility::occluded;
      } else if (!joints_.own(joint, surface.label[ray.face]) || distance > joints_.reach[joint]) {
        state = Visibility::self_occluded;
      }
    }
    states.data()[ray.joint] = static_cast<std::uint8_t>(state);
  }
}

}  // namespace cabinpose

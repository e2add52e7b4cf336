// How each joint is seen: the states of `core.pose.Visibility`, decided on the ray through the joint.
//
// The rays are samples of their own of the z-buffer's pass: exact, on no pixel grid. docs/visibility.md defines the states.
#pragma once

#include <cstdint>
#include <vector>

#include "core/array.hpp"
#include "core/fields.hpp"
#include "raster/triangles.hpp"

namespace cabinpose {

inline constexpr Index joint_count = 20;

enum class Visibility : std::uint8_t { absent, outside_image, occluded, self_occluded, visible };

/// The joints of people, and by which rules a surface before one hides it.
///
/// positions: (P, 20, 3) m of the camera frame, NaN where absent · instances: (P,) · own: by joint and label, whether it is the
/// joint's own · reach: (20,) m, how far from the joint its own surface may be · passed_labels, passed_materials: (256,) of what
/// the rays pass through.
struct Joints {
  Array<const double, any, joint_count, 3> positions;
  Array<const std::uint8_t, any> instances;
  Array<const bool, joint_count, 256> own;
  Array<const double, joint_count> reach;
  Array<const bool, 256> passed_labels, passed_materials;

  CABINPOSE_FIELDS(Joints, positions, instances, own, reach, passed_labels, passed_materials)
};

/// Where in the image a triangle may be seen: pixels, and rows of the grid of `JointRays`.
struct Extent {
  float left, right, top, bottom;
  int first_row, last_row;
};

/// The rays through the joints that are in the image, found by the cells of a coarse grid over it.
class JointRays {
 public:
  static constexpr int cells = 64;  // a side of the grid: one bit each of a row's mask

  /// Begin a frame with a camera's width and height; false where no joint is in the image.
  bool start(const Joints& joints, const Lens& lens, int width, int height);

  float columns_per_pixel() const { return columns_per_pixel_; }
  float rows_per_pixel() const { return rows_per_pixel_; }

  /// Whether there is a ray in a rectangle of cells.
  bool near(int first_column, int last_column, int first_row, int last_row) const {
    const std::uint64_t columns = (~std::uint64_t{0} >> (cells - 1 - last_column)) & (~std::uint64_t{0} << first_column);
    std::uint64_t found = 0;
    for (int r = first_row; r <= last_row; ++r) found |= occupied_[r] & columns;
    return found != 0;
  }

  /// Test a face against the rays in its extent.
  void hit(std::int32_t face, const Extent& extent, const Surface& surface, const Pose& pose);
  void hit(std::int32_t face, const Polygon& polygon, const Surface& surface, const Pose& pose);

  /// States (P, 20) from what was hit.
  void decide(const Surface& surface, Array<std::uint8_t, any, joint_count> states) const;

 private:
  struct Ray {
    double x, y, z;  // (x, y, 1) is its direction, z the joint's depth
    float u, v;
    int row, column;
    Index joint;
    double hit_z;
    std::int32_t face;
  };

  Joints joints_;
  std::vector<Ray> rays_;  // by rows of the grid
  int row_begin_[cells + 1];
  std::uint64_t occupied_[cells];
  float columns_per_pixel_ = 0.0f, rows_per_pixel_ = 0.0f;
};

}  // namespace cabinpose

// Head and hands of one person who stands in front of the camera, from a depth image alone.
#pragma once

#include <array>
#include <limits>
#include <span>

struct Point {
  float x = std::numeric_limits<float>::quiet_NaN(), y = x, z = x;  // m, camera frame: x right, y down, z forward
};

struct Joint {
  Point at;            // NaN: not found
  float presence = 0;  // 0 to 1; 0: not found
};

struct Found {
  Joint head, left_hand, right_hand;  // the person's own left and right, while facing the camera
};

struct Intrinsics {
  double fx, fy, cx, cy;  // px
};

// Head and hands in a depth image of height x width (m along the optical axis, row by row, NaN: nothing seen).
//
// The silhouette is the connected surface of a person's size; the ends of head and limbs are where geodesic distance over it is
// greatest (accumulative geodesic extrema: Plagemann et al., ICRA 2010). The camera is about level.
Found find_extremes(std::span<const float> depth, int height, int width, const Intrinsics& camera);

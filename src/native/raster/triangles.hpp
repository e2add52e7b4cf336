// The faces that an image may see, set up for the z-buffer.
//
// With ray r = (x, y, 1) and vertices v_i in the camera frame, the edge functions e_i = r . (v_j x v_k) / det,
// det = v_0 . (v_1 x v_2), are all non-negative exactly where the ray hits, and 1/z is their sum (Olano and Greer, "Triangle scan
// conversion using 2D homogeneous coordinates", 1997): linear in (x, y), and valid for vertices behind the camera too. Those of
// the ideal coordinates of the vertices, used where nothing has to be clipped, are these over z_j z_k.
//
// All but clipping is float32. An edge shared by two triangles has the same coefficients but for the sign, and zero is inside for
// both: a closed mesh shows no cracks. Projected corners only bound the samples to be tested.
#pragma once

#include <cstdint>
#include <vector>

#include "core/array.hpp"
#include "core/fields.hpp"
#include "raster/projection.hpp"

namespace cabinpose {

/// A surface as the caller gives it: vertices and normals (V, 3) of the vehicle frame, faces (F, 3), and what each face is.
struct Surface {
  Array<const float, any, 3> vertices, normals;
  Array<const std::int32_t, any, 3> faces;
  Array<const std::uint8_t, any> label, material, instance;

  CABINPOSE_FIELDS(Surface, vertices, normals, faces, label, material, instance)
};

/// Bits of a material: parts of pixels look through it; it has two sides.
enum Look : std::uint8_t { looked_through = 1, two_sided = 2 };

/// A surface before a camera.
///
/// corners: its vertices, of `project` · looks: (256,) bits of `Look` of each material · closed: faces with one side that are
/// turned away can be left out · width, height: pixels · reach: pixels from a pixel's centre to its outermost part, along u and
/// v.
struct View {
  const Surface& surface;
  const Corner* corners;
  const Pose& pose;
  const Lens& lens;
  Array<const std::uint8_t, 256> looks;
  bool closed;
  int width, height;
  double reach;
};

/// What is drawn of a face.
///
/// edge: for each edge the (a, b, c) of a x + b y + c, not negative inside · plane: the same for 1/z · weight: edge function i
/// times weight i is in proportion to the barycentric coordinate i of the hit; 1/z of corner i, or 1 where it has been clipped.
struct alignas(64) Triangle {
  float edge[9], plane[3], weight[3];
  std::int32_t face;

  /// Whether it may come nearer than the near limit; true for some others too.
  bool is_clipped() const { return weight[0] == 1.0f; }
};

/// First and last column and row of pixels; first > last where there is none.
struct PixelBox {
  std::int16_t first_column, last_column, first_row, last_row;
};

/// The pixels whose centre may see a triangle, and those whose parts may.
struct alignas(16) Boxes {
  PixelBox centre, parts;
};

/// Lines that bound the columns of a triangle in each row: at v pixels below the first row of its parts' box, what it covers lies
/// to the right of base + slope v of the first two and to the left of the other two.
struct alignas(32) Sides {
  float base[4], slope[4];
};

/// The triangles of a frame, in the order of their faces; number 0 is nobody's.
struct Triangles {
  std::vector<Triangle> items;
  std::vector<Boxes> boxes;
  std::vector<Sides> sides;
  std::int32_t count = 0;
  bool looks_through = false;  // whether parts look through any
};

class JointRays;

/// Begin a frame: the faces that the image may see, candidates[:n] in their order; returns n.
Index find_candidates(const View& view, Triangles& triangles, std::vector<std::int32_t>& candidates);

/// Set up some faces behind those before: those that any pixel or part may see.
///
/// joints: rays through joints, tested by the way; or null · drawn: set to the numbers of those that pixels' centres may see,
/// whose count is returned.
int set_up(const View& view, const std::int32_t* faces, int count, Triangles& triangles, JointRays* joints, std::int32_t* drawn);

}  // namespace cabinpose

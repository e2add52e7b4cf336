// Seat belts: a taut ribbon of webbing over a posed body.
#pragma once

#include <cstdint>

#include "core/array.hpp"
#include "core/fields.hpp"

namespace cabinpose {

/// What tells the trunk, on which belts lie, from the other parts of a body: pieces of bones, those of the trunk first.
struct TrunkBones {
  Array<const double, any, 2, 3> ends;  // m
  Array<const double, any> girth;       // of the flesh around each, m
  Index n_trunk = 0;                    // how many are the trunk's

  CABINPOSE_FIELDS(TrunkBones, ends, girth, n_trunk)
};

/// Which faces a ribbon lies on: by their classes all of them, none, or those of a limb near its root.
struct LainOn {
  Array<const std::uint8_t, any> labels;  // of the faces
  Array<const std::uint8_t, 256> kinds;   // of a class: 0 none, 1 all, 2 + n those of limb n
  Array<const double, any, 7> limbs;      // root and direction of the bone (m), the share of its length up to which it is lain on

  CABINPOSE_FIELDS(LainOn, labels, kinds, limbs)
};

/// Width, thickness and clearance from the body, m.
struct Webbing {
  double width = 0.0, thickness = 0.0, gap = 0.0;

  CABINPOSE_FIELDS(Webbing, width, thickness, gap)
};

/// Lay a ribbon over a body; whether it bends towards its inner side, so that its triangles have to be turned.
///
/// skin (V, 3) m, faces (F, 3) and which of them the ribbon lies on · course (4, 3): its first end, a point of the body, its
/// other end (m), and a direction to the side of the body on which it lies. Writes vertices (m) and unit normals of its outer,
/// then its inner side: (side, cross-section, edge - middle - edge, 3).
///
/// The ribbon runs in planes through its ends and the point of the body. In such a plane a taut string around the trunk is the
/// convex hull of the section between the ends. Three parallel planes, at the edges and the middle of the webbing, tilt the
/// ribbon with the body. From an end within the hull (a buckle pressed into a hip) a string goes straight to the nearest corner.
bool belt_ribbon(Array<const float, any, 3> skin, Array<const std::int32_t, any, 3> faces, const LainOn& lain_on,
                 TrunkBones bones, Array<const double, 4, 3> course, Webbing webbing, Array<float, 2, any, 3, 3> vertices,
                 Array<float, 2, any, 3, 3> normals);

/// Whether any of the points (N, 3) is nearer to a place than `distance`, m.
bool any_nearer(Array<const float, any, 3> points, Array<const float, 3> place, double distance);

}  // namespace cabinpose

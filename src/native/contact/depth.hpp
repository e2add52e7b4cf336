// The closed solids of a posed body: which points are inside one, and how deep.
//
// Inside is the winding number along a vertical ray, depth the distance to the nearest triangle of a solid's own skin. Both
// searches pass over runs of `leaf_faces` neighbouring triangles whose box is out of the way.
#pragma once

#include <cstdint>
#include <tuple>
#include <vector>

#include "contact/grid.hpp"
#include "core/array.hpp"
#include "core/fields.hpp"

namespace cabinpose {

inline constexpr Index leaf_faces = 32;  // triangles to a box in the search for the nearest

using Points = Array<const float, any, 3>;
using Indices = Array<const std::int32_t, any>;
using Rows = Array<const std::int64_t, any, 2>;  // (start, end)

/// A posed body; S solids. Python's `scene.contact.solids.SolidArrays`.
struct Solids {
  Points vertices;                      // m: the skin's, then the centres of the rings that close the solids
  Array<const float, any, 2, 3> boxes;  // of the solids
  Array<const std::int32_t, any, 3> faces;
  Rows all_rows, skin_rows;  // faces of each solid with its fans, and without
  Indices own;               // vertices of the skin by solid
  Rows own_rows, leaf_rows;
  Array<double, any, 2, 3> leaves;  // boxes around every `leaf_faces` faces of a solid, made when they are first asked for
  Array<bool, any> ready;

  CABINPOSE_FIELDS(Solids, vertices, boxes, faces, all_rows, skin_rows, own, own_rows, leaf_rows, leaves, ready)
};

/// Vertices (V + C, 3) of a skin (V, 3) with the centres of its C rings, the box of each solid, and that of all.
void close_solids(Points skin, Indices ring_vertices, Rows ring_rows, Indices vertices, Rows vertex_rows,
                  Array<float, any, 3> closed, Array<float, any, 2, 3> boxes, Array<float, 2, 3> box);

/// The worst of some points in a solid: excess beyond its own limit (m), its number, and its depth (m); number -1 where none.
struct Deepest {
  double excess = 0.0;
  std::int64_t point = -1;
  double depth = 0.0;

  auto result() const { return std::tuple(excess, point, depth); }
};

/// The indexed point of (N, 3) that goes farthest beyond its limit into a solid.
///
/// limits: (N,) depth allowed for each point, or (1,) for all. Points within `radius` of `centre` are left out. Depths within
/// the limit are not told apart.
Deepest deepest_in(Points points, Indices index, Index solid, Vector centre, double radius, Array<const double, any> limits,
                   const Solids& body);

/// Where solids meet: the number of the pair, or of the solid gone into, or -1; the solids; and the deepest point.
struct Meeting {
  std::int64_t first = -1, second = -1;
  Deepest deepest;

  auto result() const { return std::tuple(first, second, deepest.excess, deepest.point, deepest.depth); }
};

/// The first of `pairs` (P, 2) that overlaps beyond its tolerance: first the pair's number, second the solid gone into.
///
/// joint_ends: (P, 2) joint and end of the zone (radius `zones` times their distance) that is left out, or -1.
Meeting first_of_pairs(const Solids& body, Array<const std::int64_t, any, 2> pairs, Array<const double, any> tolerances,
                       Array<const std::int64_t, any, 2> joint_ends, Array<const double, any> zones,
                       Array<const double, any, 3> joints);

/// The first solid of `body` with a point of a solid of `other` deeper than the limit (1,): first the one gone into, second the
/// other.
Meeting first_between(const Solids& body, const Solids& other, Array<const double, any> limit);

/// The first solid (`first`) that a probe (N, 3) of a group goes into deeper than its give + `tolerance`; where: its place (3,).
///
/// box: (2, 3) around the body · balls: `balls_of(probes)`. `deepest.point` is the probe's number.
Meeting first_probe(Array<const double, any, 3> probes, Array<const double, any, 4> balls, Array<const double, any> gives,
                    Transform vehicle_from_group, Array<const float, 2, 3> box, double tolerance, const Solids& body,
                    Array<double, 3> where);

/// The vertices in `order`, then points along the edges longer than `spacing` (m); and a vertex near each point.
using SampledSkin = std::pair<Grown<float, 3>, Grown<std::int32_t>>;
SampledSkin sampled_skin(Points skin, Indices order, Array<const std::int32_t, any, 2> edges, double spacing);

/// Points (N, 3) every `step` m along limbs' bones, and the row of `ends` (L, 2) of each.
///
/// Foam gives way to the flesh of a limb, not to its bone: an arm that passes through a backrest is nowhere deeper in it than
/// the foam gives, but its axis is inside. skipped: (L,) the first part of each bone that is left out.
SampledSkin limb_axes(Array<const double, any, 3> joints, Array<const std::int64_t, any, 2> ends,
                      Array<const double, any> skipped, double step);

}  // namespace cabinpose

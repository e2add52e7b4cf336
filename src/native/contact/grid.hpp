// Clearance fields on grids: distances at the nodes, their signs, what lies beyond, interpolation.
#pragma once

#include <cstdint>
#include <vector>

#include "contact/triangles.hpp"
#include "core/array.hpp"
#include "core/fields.hpp"
#include "core/vec.hpp"

namespace cabinpose {

using Words = Array<std::uint64_t, any, any, any>;  // bits of nodes, 64 along the last axis
using Levels = Array<const std::int8_t, any, any, any>;
using Transform = Array<const double, 4, 4>;

inline constexpr Index run = 32;  // points to a ball; meshes number neighbours near each other

/// Lowers the squared distance at the nodes within `below` of each triangle behind it, and within `above` before it, m.
///
/// Of the triangles that are nearest to a node of a closed surface at least one has the node on its proper side. The closest
/// point is found by Voronoi regions (Ericson 2005, section 5.1.5); what does not change over the nodes of a triangle is
/// computed once, and a node is passed over where the triangle's plane is no nearer than what was found before.
void splat(Corners corners, Vector origin, double step, double below, double above, Array<float, any, any, any> distance);

/// Clearance at the nodes that are not exact, summed up step by step from those that are (chamfer, Borgefors 1986).
///
/// Two passes over half of the 26 neighbours each, row by row. A path over neighbours is never shorter than the straight way.
/// Nor is what one part leaves free more than what all do: exact clearance gives way to a path, exact depth does not.
void fill(Array<float, any, any, any> values, Array<const bool, any, any, any> exact, double step, double band);

/// How often the surface winds around each node, from its crossings with the vertical grid lines. winding: 0 at first.
void winding_at_nodes(Corners corners, Vector origin, double step, Array<std::int8_t, any, any, any> winding);

/// Lowers a group's clearance to that of one part: its distance where one was measured, else far outside or inside.
///
/// Outside a closed part distances are measured up to `above` only (see `splat`).
void merge_part(Array<const float, any, any, any> distance, Levels winding, bool closed, Cells offset, double give, double above,
                Array<float, any, any, any> values, Array<bool, any, any, any> exact);

/// Which nodes are at least `level`: (ni, nj, ceil(nk / 64)) words of 64 nodes along the last axis.
void bit_rows(Array<const float, any, any, any> values, double level, Words bits);

/// Nodes reached from the seeds (S, 3) over faces of clear ones, as `bit_rows`; returns whether the grid's border was reached.
bool flood(Array<const std::uint64_t, any, any, any> clear, Array<const std::int64_t, any, 3> seeds, Index nk, Words reached);

/// Turns the clearance of nodes that are at least `level` but not reached into as much depth.
void shut_off(Array<float, any, any, any> values, Array<const std::uint64_t, any, any, any> reached, double level);

/// Clearance (m) in whole quanta, rounded down and cut at 127.
void quantise(Array<const float, any, any, any> values, double quantum, Array<std::int8_t, any, any, any> out);

/// A group's field, Python's `scene.contact.GroupField`: the grid's origin and step (m), the quantum of its values (m), and the
/// clearance (m) beyond the grid.
struct FieldGrid {
  Vector origin;
  double step = 0.0, quantum_m = 0.0, outside_m = 0.0;
  Levels values;

  CABINPOSE_FIELDS(FieldGrid, origin, step, quantum_m, outside_m, values)
};

/// Lowers `clearance` (N,) at points (N, 3) m to the field's value.
template <class T>
void sample(Array<const T, any, 3> points, Transform group_from_vehicle, const FieldGrid& field, Array<double, any> clearance);

/// Clearance (m) at a point, and in `gradient` how it grows (vehicle frame, no unit); beyond the grid that is 0.
///
/// Where it is surely more than `enough` (m), what it is at least is returned, without a gradient.
double clearance_at(const FieldGrid& field, Transform group_from_vehicle, Vec3 point, double enough, Vec3& gradient);

/// Centre and radius (ceil(N / run), 4) of balls around every `run` consecutive points of (N, 3).
template <class T>
void balls_of(Array<const T, any, 3> points, Array<double, any, 4> balls);

/// The points (N, 3) whose value is below `threshold` (m): their numbers and their values (m). balls: `balls_of` them.
using Below = std::pair<Grown<std::int64_t>, Grown<double>>;
Below points_below(Array<const float, any, 3> points, Array<const double, any, 4> balls, Transform group_from_vehicle,
                   const FieldGrid& field, double threshold, double seal);

/// A part of a group that points may be in: its mesh, how far its distance is measured and how deep they may be in it, m, half
/// the thickness of an open surface, and the corners of the box outside of which it is not felt.
struct Yielding {
  Mesh mesh;
  double radius = 0.0, allowed = 0.0, shell = 0.0;
  Vector low, high;

  CABINPOSE_FIELDS(Yielding, mesh, radius, allowed, shell, low, high)
};

/// How deep points may be in a group: Python's `scene.things.placing.Felt`.
///
/// Points whose value is not below `threshold` are in nothing, those below `lost` surely too deep; the others are measured.
struct Felt {
  FieldGrid field;
  double threshold = 0.0, seal = 0.0, lost = 0.0;  // m, see `points_below`
  std::vector<Yielding> parts;

  CABINPOSE_FIELDS(Felt, field, threshold, seal, lost, parts)
};

/// Whether any of the points (N, 3) is deeper in a group than allowed.
bool any_deeper(Array<const float, any, 3> points, Array<const double, any, 4> balls, Transform group_from_points,
                const Felt& group);

}  // namespace cabinpose

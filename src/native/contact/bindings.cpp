#include <nanobind/stl/vector.h>

#include "contact/depth.hpp"
#include "contact/order.hpp"
#include "core/bind.hpp"

namespace cabinpose {
namespace {

void bind_triangles(nb::module_& m) {
  m.def("bin_triangles", &bin_triangles, "corners"_a, "origin"_a, "cell"_a, "dims"_a, unlocked(),
        "Triangles by grid cell: starts of the rows, and numbers of the triangles.");
  m.def("signed_distance", &signed_distance, "points"_a, nb::kw_only(), "radius"_a, "enough"_a, "mesh"_a, "out"_a, unlocked(),
        "Distance of points to triangles, m, negative inside.");
}

void bind_grid(nb::module_& m) {
  m.def("splat", &splat, "corners"_a, "origin"_a, nb::kw_only(), "step"_a, "below"_a, "above"_a, "distance"_a, unlocked(),
        "Lowers squared distances at the nodes near triangles.");
  m.def("fill", &fill, "values"_a, "exact"_a, nb::kw_only(), "step"_a, "band"_a, unlocked(),
        "Clearance at the nodes that are not exact.");
  m.def("winding_at_nodes", &winding_at_nodes, "corners"_a, "origin"_a, "step"_a, "winding"_a, unlocked(),
        "How often a surface winds around each node.");
  m.def("merge_part", &merge_part, "distance"_a, "winding"_a, nb::kw_only(), "closed"_a, "offset"_a, "give"_a, "above"_a,
        "values"_a, "exact"_a, unlocked(), "Lowers a group's clearance to that of one part.");
  m.def("bit_rows", &bit_rows, "values"_a, "level"_a, "bits"_a, unlocked(), "Which nodes are at least a level, 64 to a word.");
  m.def("flood", &flood, "clear"_a, "seeds"_a, "nk"_a, "reached"_a, unlocked(),
        "Nodes reached from the seeds; whether the grid's border was.");
  m.def("shut_off", &shut_off, "values"_a, "reached"_a, "level"_a, unlocked(),
        "Turns the clearance of nodes not reached into depth.");
  m.def("quantise", &quantise, "values"_a, "quantum"_a, "out"_a, unlocked(), "Clearance in whole quanta.");
  m.def("sample", &sample<float>, "points"_a, "group_from_vehicle"_a, "field"_a, "clearance"_a, unlocked(),
        "Lowers clearance at points to the field's.");
  m.def("sample", &sample<double>, "points"_a, "group_from_vehicle"_a, "field"_a, "clearance"_a, unlocked());
  m.def("balls_of", &balls_of<float>, "points"_a, "balls"_a, "Balls around every 32 consecutive points.");
  m.def("balls_of", &balls_of<double>, "points"_a, "balls"_a);
  m.def("points_below", &points_below, "points"_a, "balls"_a, "group_from_vehicle"_a, "field"_a, nb::kw_only(), "threshold"_a,
        "seal"_a, unlocked(), "Numbers and clearance of the points below a threshold.");
  m.def("any_deeper", &any_deeper, "points"_a, "balls"_a, "group_from_points"_a, "group"_a, unlocked(),
        "Whether any point is deeper in a part of a group than allowed.");
}

void bind_depth(nb::module_& m) {
  m.def("by_place", &by_place, "points"_a, "run"_a, "order"_a, unlocked(),
        "An order of points in which every run is close together.");
  m.def("close_solids", &close_solids, "skin"_a, nb::kw_only(), "ring_vertices"_a, "ring_rows"_a, "vertices"_a, "vertex_rows"_a,
        "closed"_a, "boxes"_a, "box"_a, "The vertices of a body's closed solids, and their boxes.");
  m.def("deepest_in", &deepest_in, "points"_a, "index"_a, nb::kw_only(), "solid"_a, "centre"_a, "radius"_a, "limits"_a, "body"_a,
        unlocked(), "Excess, number and depth of the worst point in a solid.");
  m.def("first_of_pairs", &first_of_pairs, "body"_a, nb::kw_only(), "pairs"_a, "tolerances"_a, "joint_ends"_a, "zones"_a,
        "joints"_a, unlocked(), "The first pair of solids that overlaps: pair, solid gone into, excess, point, depth.");
  m.def("first_between", &first_between, nb::kw_only(), "body"_a, "other"_a, "limit"_a, unlocked(),
        "The first solids of two bodies that overlap: into, of, excess, point, depth.");
  m.def("first_probe", &first_probe, "probes"_a, "balls"_a, "gives"_a, "vehicle_from_group"_a, "box"_a, "tolerance"_a, "body"_a,
        "where"_a, unlocked(), "The first solid that a probe goes into: solid, -1, excess, probe, depth.");
  m.def("sampled_skin", &sampled_skin, "skin"_a, "order"_a, "edges"_a, "spacing"_a, unlocked(),
        "Points of a skin no farther apart than a spacing, and a vertex near each.");
  m.def("limb_axes", &limb_axes, "joints"_a, "ends"_a, "skipped"_a, "step"_a, unlocked(),
        "Points along limbs' bones, and the limb of each.");
}

}  // namespace

void bind_contact(nb::module_& m) {
  describe<SearchGrid, Mesh, FieldGrid, Yielding, Felt, Solids>(m);
  bind_triangles(m);
  bind_grid(m);
  bind_depth(m);
}

}  // namespace cabinpose

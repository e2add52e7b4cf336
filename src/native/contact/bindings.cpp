#include "contact/depth.hpp"
#include "contact/order.hpp"
#include "core/bind.hpp"

namespace cabinpose {
namespace {

auto as_pair(SampledSkin skin) {
  const std::size_t n = skin.owner.size();
  return std::pair(owned<float, any, 3>(std::move(skin.points), {n, 3}), owned<std::int32_t, any>(std::move(skin.owner), {n}));
}

/// (first, second, excess, point, depth)
using Found = std::tuple<std::int64_t, std::int64_t, double, std::int64_t, double>;

Found as_found(const Meeting& m) { return {m.first, m.second, m.deepest.excess, m.deepest.point, m.deepest.depth}; }

void bind_triangles(nb::module_& m) {
  m.def(
      "bin_triangles",
      [](Corners corners, Vector origin, double cell, Cells dims) {
        auto [starts, entries] = bin_triangles(corners, origin, cell, dims);
        const std::size_t rows = starts.size(), count = entries.size();
        return std::pair(owned<std::int32_t, any>(std::move(starts), {rows}),
                         owned<std::int32_t, any>(std::move(entries), {count}));
      },
      "corners"_a, "origin"_a, "cell"_a, "dims"_a, "Triangles by grid cell: starts of the rows, and numbers of the triangles.");
  m.def("signed_distance", &signed_distance, "points"_a, "radius"_a, "enough"_a, "corners"_a, "normals"_a, "closed"_a, "origin"_a,
        "cell"_a, "dims"_a, "starts"_a, "entries"_a, "out"_a, unlocked(), "Distance of points to triangles, m, negative inside.");
}

void bind_grid(nb::module_& m) {
  m.def("splat", &splat, "corners"_a, "origin"_a, "step"_a, "below"_a, "above"_a, "distance"_a, unlocked(),
        "Lowers squared distances at the nodes near triangles.");
  m.def("fill", &fill, "values"_a, "exact"_a, "step"_a, "band"_a, unlocked(), "Clearance at the nodes that are not exact.");
  m.def("winding_at_nodes", &winding_at_nodes, "corners"_a, "origin"_a, "step"_a, "winding"_a, unlocked(),
        "How often a surface winds around each node.");
  m.def("merge_part", &merge_part, "distance"_a, "winding"_a, "closed"_a, "offset"_a, "give"_a, "above"_a, "values"_a, "exact"_a,
        unlocked(), "Lowers a group's clearance to that of one part.");
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
  m.def(
      "points_below",
      [](Points points, Array<const double, any, 4> balls, Transform group_from_vehicle, const FieldGrid& field, double threshold,
         double seal) {
        Below found;
        {
          nb::gil_scoped_release release;
          found = points_below(points, balls, group_from_vehicle, field, threshold, seal);
        }
        const std::size_t n = found.index.size();
        return std::pair(owned<std::int64_t, any>(std::move(found.index), {n}),
                         owned<double, any>(std::move(found.clearance), {n}));
      },
      "points"_a, "balls"_a, "group_from_vehicle"_a, "field"_a, "threshold"_a, "seal"_a,
      "Numbers and clearance of the points below a threshold.");
}

void bind_depth(nb::module_& m) {
  m.def("by_place", &by_place, "points"_a, "run"_a, "order"_a, unlocked(),
        "An order of points in which every run is close together.");
  m.def("close_solids", &close_solids, "skin"_a, "ring_vertices"_a, "ring_rows"_a, "vertices"_a, "vertex_rows"_a, "closed"_a,
        "boxes"_a, "box"_a, "The vertices of a body's closed solids, and their boxes.");
  m.def(
      "deepest_in",
      [](Points points, Indices index, Index solid, Vector centre, double radius, Array<const double, any> limits,
         const Solids& body) {
        const Deepest d = deepest_in(points, index, solid, centre, radius, limits, body);
        return std::tuple{d.excess, d.point, d.depth};
      },
      "points"_a, "index"_a, "solid"_a, "centre"_a, "radius"_a, "limits"_a, "body"_a, unlocked(),
      "Excess, number and depth of the worst point in a solid.");
  m.def(
      "first_of_pairs",
      [](const Solids& body, Array<const std::int64_t, any, 2> pairs, Array<const double, any> tolerances,
         Array<const std::int64_t, any, 2> joint_ends, Array<const double, any> zones, Array<const double, any, 3> joints) {
        return as_found(first_of_pairs(body, pairs, tolerances, joint_ends, zones, joints));
      },
      "body"_a, "pairs"_a, "tolerances"_a, "joint_ends"_a, "zones"_a, "joints"_a, unlocked(),
      "The first pair of solids that overlaps: pair, solid gone into, excess, point, depth.");
  m.def(
      "first_between",
      [](const Solids& body, const Solids& other, Array<const double, any> limit) {
        return as_found(first_between(body, other, limit));
      },
      "body"_a, "other"_a, "limit"_a, unlocked(), "The first solids of two bodies that overlap: into, of, excess, point, depth.");
  m.def(
      "first_probe",
      [](Array<const double, any, 3> probes, Array<const double, any, 4> balls, Array<const double, any> gives,
         Transform vehicle_from_group, Array<const float, 2, 3> box, double tolerance, const Solids& body,
         Array<double, 3> where) {
        return as_found(first_probe(probes, balls, gives, vehicle_from_group, box, tolerance, body, where.data()));
      },
      "probes"_a, "balls"_a, "gives"_a, "vehicle_from_group"_a, "box"_a, "tolerance"_a, "body"_a, "where"_a, unlocked(),
      "The first solid that a probe goes into: solid, -1, excess, probe, depth.");
  m.def(
      "sampled_skin",
      [](Points skin, Indices order, Array<const std::int32_t, any, 2> edges, double spacing) {
        SampledSkin found;
        {
          nb::gil_scoped_release release;
          found = sampled_skin(skin, order, edges, spacing);
        }
        return as_pair(std::move(found));
      },
      "skin"_a, "order"_a, "edges"_a, "spacing"_a, "Points of a skin no farther apart than a spacing, and a vertex near each.");
  m.def(
      "limb_axes",
      [](Array<const double, any, 3> joints, Array<const std::int64_t, any, 2> ends, Array<const double, any> skipped,
         double step) { return as_pair(limb_axes(joints, ends, skipped, step)); },
      "joints"_a, "ends"_a, "skipped"_a, "step"_a, "Points along limbs' bones, and the limb of each.");
}

}  // namespace

void bind_contact(nb::module_& m) {
  bind_triangles(m);
  bind_grid(m);
  bind_depth(m);
}

}  // namespace cabinpose

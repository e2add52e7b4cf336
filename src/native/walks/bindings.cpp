#include "core/bind.hpp"
#include "walks/forest.hpp"

namespace cabinpose {

void bind_walks(nb::module_& m) {
  describe<Forest>(m);
  m.def("grow", &grow, "depth"_a, "view"_a, "frame"_a, nb::kw_only(), "points"_a, "targets"_a, "pool"_a, "tried"_a, "most"_a,
        "least"_a, "deepest"_a, unlocked(),
        "A regression tree: offsets, thresholds and children of its nodes, and each sample's leaf.");
  m.def("cluster", &cluster, "targets"_a, nb::kw_only(), "order"_a, "starts"_a, "rounds"_a, "directions"_a, "shares"_a,
        unlocked(), "Clusters the targets of each leaf: unit directions, cumulative shares.");
  m.def("walk", &walk, "depth"_a, "view"_a, "starts"_a, "order"_a, "forest"_a, nb::kw_only(), "step"_a, "skipped"_a, "places"_a,
        "joints"_a, unlocked(), "Walks to the joints of people: the places of every walk, and their means.");
}

}  // namespace cabinpose

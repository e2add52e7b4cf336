#include "cabin/belt.hpp"
#include "core/bind.hpp"

namespace cabinpose {

void bind_cabin(nb::module_& m) {
  describe<LainOn, TrunkBones, Webbing>(m);
  m.def("any_nearer", &any_nearer, "points"_a, "place"_a, "distance"_a, unlocked(),
        "Whether any point is nearer to a place than a distance.");
  m.def("belt_ribbon", &belt_ribbon, "skin"_a, "faces"_a, "lain_on"_a, "bones"_a, "course"_a, "webbing"_a, nb::kw_only(),
        "vertices"_a, "normals"_a, unlocked(), "Lay a taut ribbon over a body; whether its triangles have to be turned.");
}

}  // namespace cabinpose

#include <nanobind/stl/vector.h>

#include "core/bind.hpp"
#include "pose/solver.hpp"

namespace cabinpose {

void bind_pose(nb::module_& m) {
  describe<SampleArrays, GoalArrays, Mover, PlacedGrid, PairArrays>(m);
  m.def("solve_people", &solve_people, "people"_a, "car"_a, "pairs"_a, nb::kw_only(), "between"_a, "free"_a, "missed"_a,
        unlocked(),
        "Poses of people in a car; what is left of each: its kind, a solid, the other solid or group, and the excess.");
}

}  // namespace cabinpose

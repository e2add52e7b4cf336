#include <nanobind/stl/vector.h>

#include "core/bind.hpp"
#include "pose/seated.hpp"
#include "pose/solver.hpp"

namespace cabinpose {

void bind_pose(nb::module_& m) {
  describe<Foam, SampleArrays, GoalArrays, Mover, PlacedGrid, PairArrays>(m);
  m.def("solve_people", &solve_people, "people"_a, "car"_a, "pairs"_a, nb::kw_only(), "between"_a, "free"_a, "missed"_a,
        unlocked(),
        "Poses of people in a car; what is left of each: its kind, a solid, the other solid or group, and the excess.");
  m.def("sink", &sink, "rest"_a, "foam"_a, nb::kw_only(), "rounds"_a, "state"_a, unlocked(),
        "Pitch, angle of the thighs and place of somebody who sinks into a seat.");
}

}  // namespace cabinpose

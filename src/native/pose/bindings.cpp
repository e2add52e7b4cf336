#include <nanobind/stl/vector.h>

#include <stdexcept>

#include "core/bind.hpp"
#include "pose/solver.hpp"

namespace cabinpose {

void bind_pose(nb::module_& m) {
  m.def(
      "solve_people",
      [](const std::vector<Mover>& people, const std::vector<PlacedGrid>& car, const PairArrays& pairs, double between, bool free,
         const std::vector<Array<double, any, 2>>& missed) {
        if (missed.size() != people.size()) throw std::invalid_argument("what is missed: one array for each person");
        for (std::size_t k = 0; k < people.size(); ++k) {
          const bool fit = people[k].samples.rows.size() <= max_solids && missed[k].size() == people[k].goals.bone.size();
          if (!fit) throw std::invalid_argument("a person has too many solids, or what is missed another number of tasks");
        }
        std::vector<std::tuple<int, std::int64_t, std::int64_t, double>> result;
        {
          nb::gil_scoped_release release;
          for (const Squeeze& s : solve_people(people, car, pairs, between, free, missed)) {
            result.emplace_back(s.kind, s.solid, s.other, s.excess);
          }
        }
        return result;
      },
      "people"_a, "car"_a, "pairs"_a, "between"_a, "free"_a, "missed"_a,
      "Poses of people in a car; what is left of each: its kind, a solid, the other solid or group, and the excess.");
}

}  // namespace cabinpose

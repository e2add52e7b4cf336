#include "core/bind.hpp"
#include "dpm/distance.hpp"

namespace cabinpose {

void bind_dpm(nb::module_& m) {
  m.def("spring_transform", &spring_transform, "score"_a, "spring"_a, "best"_a, "source"_a, unlocked(),
        "The best of maps of scores under quadratic springs, and where it is.");
}

}  // namespace cabinpose

#include "align/corners.hpp"
#include "core/bind.hpp"

namespace cabinpose {

void bind_align(nb::module_& m) {
  m.def("fit_corners", &fit_corners, "image"_a, nb::kw_only(), "start"_a, "along"_a, "down"_a, "offset"_a, "levels"_a, unlocked(),
        "Corners of a checkerboard by least squares; returns their blur.");
}

}  // namespace cabinpose

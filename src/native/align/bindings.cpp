#include "align/blob.hpp"
#include "align/corners.hpp"
#include "core/bind.hpp"

namespace cabinpose {

void bind_align(nb::module_& m) {
  m.def(
      "find_blob",
      [](Array<const double, any, any> image, double min_contrast, double rival, Index min_area, Index max_area,
         Array<double, 2> uv) { find_blob(image, {min_contrast, rival, min_area, max_area}, uv); },
      "image"_a, "min_contrast"_a, "rival"_a, "min_area"_a, "max_area"_a, "uv"_a, unlocked(),
      "The pixel of the one bright small blob of an image.");
  m.def("fit_corners", &fit_corners, "image"_a, "start"_a, "along"_a, "down"_a, "offset"_a, "levels"_a, unlocked(),
        "Corners of a checkerboard by least squares; returns their blur.");
}

}  // namespace cabinpose

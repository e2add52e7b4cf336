#include "core/bind.hpp"
#include "raster/render.hpp"

namespace cabinpose {

void bind_raster(nb::module_& m) {
  describe<Surface, Lens, Eye, Joints, Buffers, Rendered>(m);
  m.attr("BLOCK_COLUMNS") = block_columns;
  m.attr("BLOCK_ROWS") = block_rows;
  m.def("render", &render, "surface"_a, "camera_from_vehicle"_a, "closed"_a, "eye"_a, "joints"_a, "frame"_a, unlocked(),
        "Fill the images, buffers and states of joints of one frame; the number of mixed pixels.");
}

}  // namespace cabinpose

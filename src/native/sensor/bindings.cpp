#include "core/bind.hpp"
#include "sensor/view.hpp"

namespace cabinpose {

// Each in the file of its kernel, beside the settings that it takes.
void bind_continuous_wave(nb::module_& m);
void bind_empirical(nb::module_& m);
void bind_indirect_light(nb::module_& m);
void bind_structured_light(nb::module_& m);

void bind_sensor(nb::module_& m) {
  describe<View, SurfaceOptics, Delivered>(m);
  bind_continuous_wave(m);
  bind_indirect_light(m);
  bind_empirical(m);
  bind_structured_light(m);
}

}  // namespace cabinpose

#include <nanobind/stl/vector.h>

#include "core/bind.hpp"
#include "sensor/continuous_wave.hpp"
#include "sensor/empirical.hpp"
#include "sensor/indirect.hpp"
#include "sensor/structured_light.hpp"

namespace cabinpose {

void bind_sensor(nb::module_& m) {
  m.def("simulate_continuous_wave", &simulate_continuous_wave, "views"_a, "shares"_a, "camera"_a, "ranks"_a, "quantiles"_a,
        "out"_a, unlocked(), "One frame of a continuous-wave Time-of-Flight camera.");
  m.def("indirect_light", &indirect_light, "view"_a, "scene"_a, "out"_a, unlocked(),
        "Light that surfaces send on to others, by virtual point lights.");
  m.def("simulate_empirical", &simulate_empirical, "view"_a, "camera"_a, "ranks"_a, "quantiles"_a, "out"_a, unlocked(),
        "One frame of a camera with measured noise.");
  m.def("simulate_structured_light", &simulate_structured_light, "view"_a, "camera"_a, "ranks"_a, "quantiles"_a, "out"_a,
        unlocked(), "One frame of a camera that matches a projected dot pattern.");
}

}  // namespace cabinpose

// The extension module: one submodule a room. Built twice from the same sources, see CMakeLists.txt.
#include "core/bind.hpp"

namespace cabinpose {

void bind_align(nb::module_& m);
void bind_body(nb::module_& m);
void bind_contact(nb::module_& m);
void bind_cabin(nb::module_& m);
void bind_core(nb::module_& m);
void bind_dpm(nb::module_& m);
void bind_estimate(nb::module_& m);
void bind_pose(nb::module_& m);
void bind_lab(nb::module_& m);
void bind_sensor(nb::module_& m);
void bind_raster(nb::module_& m);
void bind_walks(nb::module_& m);

}  // namespace cabinpose

NB_MODULE(CABINPOSE_MODULE, m) {
  m.doc() = "Kernels of cabinpose.";
  m.def(
      "runs_here",
      [] {
#if !defined(__x86_64__)
        return false;
#elif defined(__AVX2__)
        return true;
#else
        return static_cast<bool>(__builtin_cpu_supports("avx2"));
#endif
      },
      "Whether this processor has what the build with AVX2 needs; asked of the baseline build.");
  auto room = [&m](const char* name, void (*bind)(nanobind::module_&)) {
    nanobind::module_ sub = m.def_submodule(name);
    bind(sub);
  };
  room("align", cabinpose::bind_align);
  room("body", cabinpose::bind_body);
  room("contact", cabinpose::bind_contact);
  room("cabin", cabinpose::bind_cabin);
  room("core", cabinpose::bind_core);
  room("dpm", cabinpose::bind_dpm);
  room("estimate", cabinpose::bind_estimate);
  room("pose", cabinpose::bind_pose);
  room("lab", cabinpose::bind_lab);
  room("sensor", cabinpose::bind_sensor);
  room("raster", cabinpose::bind_raster);
  room("walks", cabinpose::bind_walks);
}

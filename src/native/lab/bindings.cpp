#include "core/bind.hpp"
#include "lab/raycast.hpp"
#include "lab/sight.hpp"

namespace cabinpose {

void bind_lab(nb::module_& m) {
  describe<PixelRays, SceneArrays>(m);
  m.def("faces_between", &faces_between, nb::kw_only(), "eyes"_a, "points"_a, "vertices"_a, "faces"_a, "possible"_a, unlocked(),
        "Faces that may come between eyes and points.");
  m.def("see_markers", &see_markers, nb::kw_only(), "eyes"_a, "markers"_a, "vertices"_a, "faces"_a, "ends"_a, "seen"_a,
        unlocked(), "Which eyes see which markers.");
  m.def(
      "cast",
      [](const PixelRays& pixels, const SceneArrays& scene, float reflectance, Array<float, any, any> depth,
         Array<float, any, any> cosine) {
        MixedPixels mixed;
        {
          nb::gil_scoped_release released;
          mixed = cast(pixels, scene, reflectance, depth, cosine);
        }
        const std::size_t count = mixed.pixel.size();
        return std::tuple(owned<std::int32_t, any>(std::move(mixed.pixel), {count}),
                          owned<float, any, 4>(std::move(mixed.depth), {count, 4}),
                          owned<float, any, 4>(std::move(mixed.cosine), {count, 4}));
      },
      "pixels"_a, "scene"_a, "reflectance"_a, nb::kw_only(), "depth"_a, "cosine"_a,
      "Depth and light by one ray a pixel; returns the pixels that see several surfaces, and their parts' depth and light.");
}

}  // namespace cabinpose

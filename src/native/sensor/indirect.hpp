// Indirect light: what surfaces that the camera's own light reaches send on to others (multipath).
#pragma once

#include "sensor/view.hpp"

namespace cabinpose {

/// The light of a camera and what it falls on, images (H, W). See `IndirectLight` in `scene/sensor/indirect.py`.
struct LitScene {
  Array<const float, any, any, 2> rays;       // x, y of the rays (x, y, 1), NaN outside the lens model
  Array<const float, any, any> flux;          // (h, w): of the light into each cell of step x step pixels
  Array<const float, any, any> illumination;  // radiant intensity of the light along the rays
  Array<const float, 256, 3> table;           // by material, diffuse reflectance first
  Array<const double, any> frequencies;       // Hz
  int step, bounces;                          // pixels of a cell's side; surfaces between the light and what the camera sees
  double unseen, unseen_area, unseen_path;    // reflectance, area (m^2) and length of the way by (m) what the camera does not see

  auto members() {
    return std::tie(rays, flux, illumination, table, frequencies, step, bounces, unseen, unseen_area, unseen_path);
  }
};

/// Indirect light (H, 1 + 2 F, W) at the pixels' centres: energy, and (cos, sin) a frequency, in the units of direct energy.
void indirect_light(const View& view, const LitScene& scene, Array<float, any, any, any> out);

}  // namespace cabinpose

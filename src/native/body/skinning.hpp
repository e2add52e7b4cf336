// Bodies at rest, linear blend skinning and vertex normals.
#pragma once

#include "core/array.hpp"

namespace cabinpose {

/// A body at rest: `mean` (V, 3) plus `basis` (R, V, 3) times `coefficients` (R,), into `out` (V, 3) m.
///
/// Summed in double precision and in the basis' order; a library's matrix product leaves the order to its threads.
void blend_shapes(Array<const float, any, 3> mean, Array<const float, any, any, 3> basis, Array<const double, any> coefficients,
                  Array<float, any, 3> out);

/// Every layer (L, V, 3) at rest, posed into `out` (L, V, 3) m: the blend of a vertex is worked out once for all layers.
///
/// transforms: (B, 3, 4) · index, weight: (V, K), strongest first, 0 after the last one in use.
void skin_layers(Array<const double, any, 3, 4> transforms, Array<const std::uint8_t, any, any> index,
                 Array<const float, any, any> weight, Array<const float, any, any, 3> layers, Array<float, any, any, 3> out);

/// Unit normals (V, 3), outward, weighted by the area of the faces around; zero where a vertex has no face.
void vertex_normals(Array<const float, any, 3> vertices, Array<const std::int32_t, any, 3> faces, Array<float, any, 3> out);

}  // namespace cabinpose

#include "body/skinning.hpp"

#include <algorithm>
#include <cmath>

namespace cabinpose {
namespace {

constexpr Index max_bones = 256;  // what an index of eight bits can name

}  // namespace

void blend_shapes(Array<const float, any, 3> mean, Array<const float, any, any, 3> basis, Array<const double, any> coefficients,
                  Array<float, any, 3> out) {
  constexpr Index block = 512;  // numbers whose sums stay in the cache
  for (Index from = 0; from < mean.count(); from += block) {
    const Index n = std::min(block, mean.count() - from);
    double sum[block];
    for (Index i = 0; i < n; ++i) sum[i] = static_cast<double>(mean.data()[from + i]);
    for (Index r = 0; r < coefficients.size(); ++r) {
      const float* values = basis[r].data() + from;
      for (Index i = 0; i < n; ++i) sum[i] += coefficients[r] * static_cast<double>(values[i]);
    }
    for (Index i = 0; i < n; ++i) out.data()[from + i] = static_cast<float>(sum[i]);
  }
}

void skin_layers(Array<const double, any, 3, 4> transforms, Array<const std::uint8_t, any, any> index,
                 Array<const float, any, any> weight, Array<const float, any, any, 3> layers, Array<float, any, any, 3> out) {
  const Index bones = index.size(1);
  float matrix[max_bones][12];
  for (Index b = 0; b < std::min(transforms.size(), max_bones); ++b) {
    for (int i = 0; i < 12; ++i) matrix[b][i] = static_cast<float>(transforms[b].data()[i]);
  }
  for (Index v = 0; v < index.size(); ++v) {
    float blend[12] = {};
    for (Index k = 0; k < bones; ++k) {
      const float w = weight(v, k);
      if (w == 0.0f) break;
      const float* t = matrix[index(v, k)];
      for (int i = 0; i < 12; ++i) blend[i] += w * t[i];
    }
    for (Index layer = 0; layer < layers.size(); ++layer) {
      const float *at = &layers(layer, v, 0), x = at[0], y = at[1], z = at[2];
      float* to = &out(layer, v, 0);
      for (int i = 0; i < 3; ++i) to[i] = blend[4 * i] * x + blend[4 * i + 1] * y + blend[4 * i + 2] * z + blend[4 * i + 3];
    }
  }
}

void vertex_normals(Array<const float, any, 3> vertices, Array<const std::int32_t, any, 3> faces, Array<float, any, 3> out) {
  std::fill_n(out.data(), out.count(), 0.0f);
  for (Index f = 0; f < faces.size(); ++f) {
    const std::int32_t* corner = faces[f].data();
    const float *a = &vertices(corner[0], 0), *b = &vertices(corner[1], 0), *c = &vertices(corner[2], 0);
    const float u[3] = {b[0] - a[0], b[1] - a[1], b[2] - a[2]}, v[3] = {c[0] - a[0], c[1] - a[1], c[2] - a[2]};
    const float n[3] = {u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0]};
    for (int k = 0; k < 3; ++k) {
      for (int i = 0; i < 3; ++i) out(corner[k], i) += n[i];
    }
  }
  for (Index i = 0; i < out.size(); ++i) {
    float* n = &out(i, 0);
    const float length = std::sqrt(n[0] * n[0] + n[1] * n[1] + n[2] * n[2]);
    if (length > 0.0f) {
      for (int k = 0; k < 3; ++k) n[k] /= length;
    }
  }
}

}  // namespace cabinpose

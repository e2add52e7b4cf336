#include "raster/shading.hpp"

#include <algorithm>
#include <cmath>
#include <cstring>

#include "raster/lanes.hpp"

namespace cabinpose {
namespace {

constexpr int chunk_blocks = 64;  // that are shaded together, so that what is noted of them stays in the cache
constexpr int chunk_samples = chunk_blocks * lanes;

/// What some samples show, before the last steps.
struct Chunk {
  alignas(64) float depth[chunk_samples];
  float product[chunk_samples], squared[chunk_samples];  // n . r, and |n|^2 |r|^2
  std::int32_t face[chunk_samples], kind[chunk_samples];
};

/// Shades blocks as one camera sees them.
class Shader {
 public:
  Shader(const Appearance* appearances, const Pose& pose) : appearances_(appearances) {
    for (int k = 0; k < 3; ++k) {
      for (int i = 0; i < 3; ++i) vehicle_from_camera_[k][i] = static_cast<float>(pose.m[4 * i + k]);
    }
  }

  /// Of block b the first half goes to step * b, the other half `apart` samples behind it.
  template <int step, int apart>
  void shade(const BlockRays* rays, const BlockHits* hits, int blocks, Chunk& out) const {
    const Floats zero(0.0f), one(1.0f);
    for (int b = 0; b < blocks; ++b) {
      Floats m[3][4];  // normal, face and kind of each sample
      for (int i = 0; i < 3; ++i) {
        const float* places[lanes];
        for (int k = 0; k < lanes; ++k) places[k] = appearances_[hits[b].triangle[k]].normal + 4 * i;
        gather(places, m[i]);
      }
      const Floats x = load(rays[b].x), y = load(rays[b].y), w = load(hits[b].w);
      const Floats n[3] = {m[0][0] * x + m[0][1] * y + m[0][2], m[0][3] * x + m[1][0] * y + m[1][1],
                           m[1][2] * x + m[1][3] * y + m[2][0]};
      Floats ray[3];  // in the vehicle frame, as the normals are
      for (int k = 0; k < 3; ++k) {
        const float* v = vehicle_from_camera_[k];
        ray[k] = Floats(v[0]) * x + Floats(v[1]) * y + Floats(v[2]);
      }
      const int to = step * b;
      const auto put = [&](const auto& value, auto* array) { store_halves(value, array + to, array + to + apart); };
      put((n[0] * n[0] + n[1] * n[1] + n[2] * n[2]) * (x * x + y * y + one), out.squared);
      put(n[0] * ray[0] + n[1] * ray[1] + n[2] * ray[2], out.product);
      put(select(w > zero, one / w, zero), out.depth);
      put(bits(m[2][1]), out.face);
      put(bits(m[2][2]), out.kind);
    }
  }

 private:
  const Appearance* appearances_;
  float vehicle_from_camera_[3][3];
};

/// Write depth, incidence and material of samples of a chunk to where they are kept.
void finish(const Chunk& from, int first, int count, const Samples& to, Index at) {
  const float* __restrict product = from.product + first, * __restrict squared = from.squared + first;
  const std::int32_t* __restrict kind = from.kind + first;
  float* __restrict cosine = to.cosine + at;
  std::uint8_t* __restrict material = to.material + at;
  std::memcpy(to.depth + at, from.depth + first, count * sizeof(float));
  for (int k = 0; k < count; ++k) {
    const float value = std::fabs(product[k]) / std::sqrt(squared[k]);
    cosine[k] = squared[k] > 0.0f ? (value < 1.0f ? value : 1.0f) : 0.0f;
  }
  for (int k = 0; k < count; ++k) material[k] = static_cast<std::uint8_t>(kind[k] >> 16);
}

void finish(const Chunk& from, int first, int count, const Classes& to, Index at) {
  const std::int32_t* __restrict kind = from.kind + first;
  std::uint8_t* __restrict label = to.label + at, * __restrict instance = to.instance + at;
  std::memcpy(to.depth + at, from.depth + first, count * sizeof(float));
  std::memcpy(to.face + at, from.face + first, count * sizeof(std::int32_t));
  for (int k = 0; k < count; ++k) label[k] = static_cast<std::uint8_t>(kind[k]);
  for (int k = 0; k < count; ++k) instance[k] = static_cast<std::uint8_t>(kind[k] >> 8);
}

}  // namespace

void Appearances::start(const Triangles& triangles) {
  const std::size_t count = static_cast<std::size_t>(triangles.count);
  if (items_.size() < count) {
    items_.resize(count * 3 / 2);
    seen_.resize(count * 3 / 2);
    made_.resize(count * 3 / 2);
    list_.resize(count * 3 / 2 + lanes);
  }
  std::fill_n(seen_.begin(), count, 0);
  std::fill_n(made_.begin(), count, 0);
  items_[0] = Appearance{{}, -1, 0, 0};
}

void Appearances::make(const BlockHits* hits, Index blocks, const Triangles& triangles, const Surface& surface) {
  std::uint8_t *seen = seen_.data(), *done = made_.data();
  std::int32_t* list = list_.data();
  for (Index b = 0; b < blocks; ++b) {
    for (const std::int32_t n : hits[b].triangle) seen[n] = 1;
  }
  Index count = 0;
  for (std::int32_t n = 1; n < triangles.count; ++n) {
    list[count] = n;
    count += seen[n] - done[n];
    done[n] = seen[n];
  }
  if (count == 0) return;
  for (int k = 0; k < lanes; ++k) list[count + k] = list[count - 1];
  for (Index first = 0; first < count; first += lanes) {
    const std::int32_t* number = list + first;
    Floats t[4][4];
    for (int i = 0; i < 4; ++i) {
      const float* places[lanes];
      for (int k = 0; k < lanes; ++k) places[k] = triangles.items[number[k]].edge + 4 * i;
      gather(places, t[i]);
    }
    std::int32_t face[lanes], kind[lanes];
    float normals[3][3][lanes];
    store(bits(t[3][3]), face);
    for (int k = 0; k < lanes; ++k) {
      const Index f = face[k];
      kind[k] = surface.label[f] | surface.instance[f] << 8 | surface.material[f] << 16;
      for (int i = 0; i < 3; ++i) {
        const float* n = &surface.normals(surface.faces(f, i), 0);
        for (int c = 0; c < 3; ++c) normals[i][c][k] = n[c];
      }
    }
    const Floats edge[3][3] = {{t[0][0], t[0][1], t[0][2]}, {t[0][3], t[1][0], t[1][1]}, {t[1][2], t[1][3], t[2][0]}};
    Floats row[3][3] = {};
    for (int i = 0; i < 3; ++i) {
      for (int k = 0; k < 3; ++k) {
        const Floats e = t[3][i] * edge[i][k];
        for (int c = 0; c < 3; ++c) {
          const Floats product = load(normals[i][c]) * e;
          row[c][k] = i == 0 ? product : row[c][k] + product;
        }
      }
    }
    const Floats columns[3][4] = {{row[0][0], row[0][1], row[0][2], row[1][0]},
                                  {row[1][1], row[1][2], row[2][0], row[2][1]},
                                  {row[2][2], from_bits(load(face)), from_bits(load(kind)), Floats(0.0f)}};
    for (int i = 0; i < 3; ++i) {
      float* places[lanes];
      for (int k = 0; k < lanes; ++k) places[k] = items_[number[k]].normal + 4 * i;
      scatter(columns[i], places);
    }
  }
}

void shade_pixels(const Grid& grid, const BlockRays* rays, const BlockHits* hits, const Appearance* appearances, const Pose& pose,
                  const Samples& samples, const Classes& classes) {
  static_assert(block_rows == 2 && block_columns * block_rows == lanes);
  const Shader shader(appearances, pose);
  Chunk chunk;
  for (int r = 0; r < grid.down; ++r) {
    for (int b = 0; b < grid.across; b += chunk_blocks) {
      const Index block = static_cast<Index>(r) * grid.across + b;
      const int blocks = std::min(chunk_blocks, grid.across - b);
      shader.shade<block_columns, chunk_samples / 2>(rays + block, hits + block, blocks, chunk);
      const int columns = std::min(blocks * block_columns, grid.width - b * block_columns);
      for (int i = 0; i < std::min(block_rows, grid.height - r * block_rows); ++i) {
        const Index at = static_cast<Index>(r * block_rows + i) * grid.width + b * block_columns;
        finish(chunk, i * chunk_samples / 2, columns, samples, at);
        finish(chunk, i * chunk_samples / 2, columns, classes, at);
      }
    }
  }
}

void shade_samples(Index count, const BlockRays* rays, const BlockHits* hits, const Appearance* appearances, const Pose& pose,
                   const Samples& samples) {
  const Shader shader(appearances, pose);
  Chunk chunk;
  for (Index first = 0; first < count; first += chunk_samples) {
    const int size = static_cast<int>(std::min<Index>(chunk_samples, count - first));
    shader.shade<lanes, lanes / 2>(rays + first / lanes, hits + first / lanes, (size + lanes - 1) / lanes, chunk);
    finish(chunk, 0, size, samples, first);
  }
}

}  // namespace cabinpose

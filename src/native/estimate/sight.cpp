// What a model's view sees of a frame, counted and added up in one pass: whether it can be a picture of people at all.
#include <algorithm>
#include <cmath>
#include <tuple>
#include <vector>

#include "core/bind.hpp"

namespace cabinpose {

/// What is counted. touching, near, nearer: m · edge, step: changes between neighbours, as shares of the depth · off: distance
/// from one surface, the same · darkest: amplitude x depth² (m) · every: a pixel in so many a side is looked at.
struct SightLimits {
  float touching, near, nearer, edge, step, off, darkest;
  int every;
  CABINPOSE_FIELDS(SightLimits, touching, near, nearer, edge, step, off, darkest, every)
};

/// Counts over the pixels that are looked at: valid, touching, near, nearer; pairs of neighbours in a row, both valid, and steps
/// between them; lit: valid with an amplitude · over all pixels: valid_all, joined (valid with a valid one to the left), odd
/// (amplitudes below the darkest or not finite) · blocks of `every` pixels a side with a depth, pairs of them that follow each
/// other in a row with edges between their mean depths, and those off the surface 1/z = a + b u + c v + d u² + e u v + f v²
/// nearest to all.
struct Sight {
  int valid = 0, touching = 0, near = 0, nearer = 0, pairs = 0, steps = 0, lit = 0, valid_all = 0, joined = 0, odd = 0,
      blocks = 0, block_pairs = 0, edges = 0, off = 0;
  auto result() const {
    return std::tuple(valid, touching, near, nearer, pairs, steps, lit, valid_all, joined, odd, blocks, block_pairs, edges, off);
  }
};

namespace {

constexpr int terms = 6;  // of the surface
constexpr int degree_u[terms] = {0, 1, 0, 2, 1, 0}, degree_v[terms] = {0, 0, 1, 0, 1, 2};
constexpr double ridge = 1e-6;  // keeps blocks in one line from having many surfaces

/// Powers of a coordinate from 0 to 4.
struct Powers {
  double of[5] = {1, 1, 1, 1, 1};
  explicit Powers(double x) {
    for (int k = 1; k < 5; ++k) of[k] = of[k - 1] * x;
  }
};

/// The solution of a symmetric, positive definite system, in place of its right side (Cholesky).
void solve(double (&a)[terms][terms], double (&b)[terms]) {
  for (int j = 0; j < terms; ++j) {
    for (int k = 0; k < j; ++k) a[j][j] -= a[j][k] * a[j][k];
    a[j][j] = std::sqrt(a[j][j]);
    for (int i = j + 1; i < terms; ++i) {
      for (int k = 0; k < j; ++k) a[i][j] -= a[i][k] * a[j][k];
      a[i][j] /= a[j][j];
    }
  }
  for (int i = 0; i < terms; ++i) {
    for (int k = 0; k < i; ++k) b[i] -= a[i][k] * b[k];
    b[i] /= a[i][i];
  }
  for (int i = terms; i-- > 0;) {
    for (int k = i + 1; k < terms; ++k) b[i] -= a[k][i] * b[k];
    b[i] /= a[i][i];
  }
}

/// What is counted among blocks, of mean depths (rows, columns), 0 = none.
void count_blocks(const std::vector<float>& mean, Index rows, Index columns, const SightLimits& limits, Sight& found) {
  const double scale = static_cast<double>(std::max(rows, columns));
  std::vector<Powers> u;
  for (Index j = 0; j < columns; ++j) u.emplace_back(static_cast<double>(j) / scale - 0.5);
  double moments[5][5] = {}, right[3][3] = {};  // sums of u^a v^b, and of them over z
  for (Index i = 0; i < rows; ++i) {
    const float* z = mean.data() + i * columns;
    double row[5] = {}, inverse[3] = {};
    for (Index j = 0; j < columns; ++j) {
      if (!(z[j] > 0.0f)) continue;
      const double d = 1.0 / static_cast<double>(z[j]);
      for (int k = 0; k < 5; ++k) row[k] += u[static_cast<std::size_t>(j)].of[k];
      for (int k = 0; k < 3; ++k) inverse[k] += d * u[static_cast<std::size_t>(j)].of[k];
    }
    const Powers v(static_cast<double>(i) / scale - 0.5);
    for (int a = 0; a < 5; ++a)
      for (int b = 0; a + b < 5; ++b) moments[a][b] += row[a] * v.of[b];
    for (int a = 0; a < 3; ++a)
      for (int b = 0; a + b < 3; ++b) right[a][b] += inverse[a] * v.of[b];
  }
  const double least = static_cast<double>(limits.off);
  double normal[terms][terms], s[terms];
  for (int i = 0; i < terms; ++i) {
    for (int k = 0; k < terms; ++k) normal[i][k] = moments[degree_u[i] + degree_u[k]][degree_v[i] + degree_v[k]];
    normal[i][i] += ridge;
    s[i] = right[degree_u[i]][degree_v[i]];
  }
  solve(normal, s);
  for (Index i = 0; i < rows; ++i) {
    const Powers v(static_cast<double>(i) / scale - 0.5);
    const double c0 = s[0] + s[2] * v.of[1] + s[5] * v.of[2], c1 = s[1] + s[4] * v.of[1];
    const float* z = mean.data() + i * columns;
    float before = 0.0f;  // the last one with a depth: who stands before what is out of range has an edge across the gap
    for (Index j = 0; j < columns; ++j) {
      const double x = u[static_cast<std::size_t>(j)].of[1];
      const bool there = z[j] > 0.0f, both = there && before > 0.0f;
      found.block_pairs += both;
      found.edges += both && std::fabs(z[j] - before) > limits.edge * before;
      if (there) before = z[j];
      found.blocks += there;
      found.off += there && std::fabs((c0 + c1 * x + s[3] * x * x) * static_cast<double>(z[j]) - 1.0) > least;
    }
  }
}

/// What is counted in every row: valid pixels, those that are joined, odd amplitudes.
void count_all(const float* z, const float* light, Index width, const SightLimits& limits, Sight& found) {
  int valid = 0, joined = 0, odd = 0;
  for (Index j = 0; j < width; ++j) valid += z[j] > 0.0f;
  for (Index j = 1; j < width; ++j) joined += (z[j] > 0.0f) & (z[j - 1] > 0.0f);
  if (light != nullptr)
    for (Index j = 0; j < width; ++j)
      odd += !(light[j] * z[j] * z[j] > limits.darkest) | !(light[j] <= 3.402823466e38f);  // NaN is neither
  found.valid_all += valid;
  found.joined += joined;
  found.odd += odd;
}

/// What is counted among a row's pixels that are looked at.
void count_some(const float* z, const float* light, Index width, const SightLimits& limits, Sight& found) {
  int valid = 0, touching = 0, near = 0, nearer = 0, pairs = 0, steps = 0, lit = 0;
  for (Index j = 0; j < width; ++j) {
    const bool there = z[j] > 0.0f;
    valid += there;
    touching += there & (z[j] < limits.touching);
    near += there & (z[j] < limits.near);
    nearer += there & (z[j] < limits.nearer);
  }
  for (Index j = 1; j < width; ++j) {
    const bool both = (z[j] > 0.0f) & (z[j - 1] > 0.0f);
    const float change = std::fabs(z[j] - z[j - 1]);
    pairs += both;
    steps += both & (change > limits.step * z[j - 1]);
  }
  if (light != nullptr)
    for (Index j = 0; j < width; ++j) lit += (z[j] > 0.0f) & (light[j] > 0.0f);
  found.valid += valid;
  found.touching += touching;
  found.near += near;
  found.nearer += nearer;
  found.pairs += pairs;
  found.steps += steps;
  found.lit += lit;
}

/// What is seen of a frame's depth (H, W), m, 0 = invalid, and amplitude (H, W), or (0, 0) for none.
Sight see(Array<const float, any, any> depth, Array<const float, any, any> amplitude, const SightLimits& limits) {
  Sight found;
  const Index height = depth.size(0), width = depth.size(1), every = std::max(1, limits.every);
  const bool reads = amplitude.size(0) == height && amplitude.size(1) == width;
  const Index rows = (height + every - 1) / every, columns = (width + every - 1) / every;
  const auto count = [](Index n) { return static_cast<std::size_t>(n); };
  std::vector<float> mean(count(rows * columns)), sum(count(width)), known(count(width)), z(count(columns)),
      light(count(columns));
  for (Index i = 0; i < height; ++i) {
    const float* row = depth.data() + i * width;
    const float* bright = reads ? amplitude.data() + i * width : nullptr;
    count_all(row, bright, width, limits, found);
    if (i % every == 0) {
      for (Index j = 0; j < columns; ++j) z[count(j)] = row[j * every];
      if (reads)
        for (Index j = 0; j < columns; ++j) light[count(j)] = bright[j * every];
      count_some(z.data(), reads ? light.data() : nullptr, columns, limits, found);
      std::fill(sum.begin(), sum.end(), 0.0f);
      std::fill(known.begin(), known.end(), 0.0f);
    }
    for (Index j = 0; j < width; ++j) {
      sum[count(j)] += row[j];
      known[count(j)] += row[j] > 0.0f ? 1.0f : 0.0f;
    }
    if ((i + 1) % every != 0 && i + 1 != height) continue;
    for (Index j = 0; j < columns; ++j) {
      float total = 0.0f, of = 0.0f;
      for (Index k = j * every; k < std::min((j + 1) * every, width); ++k) {
        total += sum[count(k)];
        of += known[count(k)];
      }
      mean[count(i / every * columns + j)] = of > 0.0f ? total / of : 0.0f;
    }
  }
  count_blocks(mean, rows, columns, limits, found);
  return found;
}

}  // namespace

void bind_estimate(nb::module_& m) {
  describe<SightLimits>(m);
  m.def(
      "see", &see, "depth"_a, nb::kw_only(), "amplitude"_a, "limits"_a, unlocked(),
      "What tells whether a frame can be a picture of people: valid, touching, near, nearer, pairs, steps, lit; over all pixels "
      "valid, joined, odd; blocks, pairs of them, edges, blocks off one surface.");
}

}  // namespace cabinpose

#include "align/corners.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <utility>
#include <vector>

#include "core/vector_math.hpp"

namespace cabinpose {

namespace {

constexpr double reach_of_square = 0.42;  // how far from a corner its pixels are taken; at 0.5 the blur would bring in the next
constexpr double largest_reach_px = 12.0;
constexpr Index fewest_pixels = 16;  // of a corner: the model has 11 numbers and the blur is shared
constexpr int rounds = 25;
constexpr double settled_px = 1e-5;
constexpr int own = 10, linear = 6;  // numbers of a corner's own; of these, those that the amplitudes are linear in

using Geometry = std::array<double, 4>;     // du, dv, angles of the normals of two lines
using Levels = std::array<double, linear>;  // m and c, each with slopes

/// The pixels around all corners: those of corner n are first[n] to first[n + 1] - 1.
struct Pixels {
  std::vector<Index> first;
  std::vector<double> x, y, value;  // from the corner's start; amplitude over the root mean square around the corner
};

/// A blurred edge at every pixel, and its derivatives by the distance and by sigma.
struct Edge {
  std::vector<double> value, by_distance, by_sigma;

  void resize(std::size_t count) { value.resize(count), by_distance.resize(count), by_sigma.resize(count); }
};

/// A state of the fit and how well it does.
struct Fit {
  std::vector<Geometry> geometry;
  std::vector<Levels> levels;
  double sigma = 0.4, cost = 0.0;
  Edge edge[2];
};

/// E(d) at distances (N,): a step from -1 to 1, blurred by sigma, averaged over a pixel's width.
void find_edge(const double* distance, Index count, double sigma, double* value, double* by_distance, double* by_sigma) {
  const double scale = std::sqrt(2.0) * sigma, peak = std::sqrt(2.0 / pi);
  for (Index k = 0; k < count; ++k) {
    const double far = distance[k] + 0.5, near = distance[k] - 0.5, z_far = far / scale, z_near = near / scale;
    const double e_far = loops::exp(-(z_far * z_far)), e_near = loops::exp(-(z_near * z_near));
    const double a_far = std::fabs(z_far), a_near = std::fabs(z_near);
    const double rest_far = e_far * loops::erfc_scaled(a_far > 6.0 ? 6.0 : a_far);
    const double rest_near = e_near * loops::erfc_scaled(a_near > 6.0 ? 6.0 : a_near);
    const double erf_far = std::copysign(1.0 - rest_far, far), erf_near = std::copysign(1.0 - rest_near, near);
    const double bells = peak * e_far - peak * e_near;
    value[k] = far * erf_far - near * erf_near + sigma * bells;
    by_distance[k] = erf_far - erf_near;
    by_sigma[k] = bells;
  }
}

void find_edges(const Pixels& pixels, Fit& fit, std::vector<double>& distance) {
  distance.resize(pixels.x.size());
  for (int line = 0; line < 2; ++line) {
    for (std::size_t n = 0; n < fit.geometry.size(); ++n) {
      const Geometry& g = fit.geometry[n];
      const double c = cos(g[2 + static_cast<std::size_t>(line)]), s = sin(g[2 + static_cast<std::size_t>(line)]);
      for (auto k = static_cast<std::size_t>(pixels.first[n]); k < static_cast<std::size_t>(pixels.first[n + 1]); ++k) {
        distance[k] = c * (pixels.x[k] - g[0]) + s * (pixels.y[k] - g[1]);
      }
    }
    Edge& edge = fit.edge[line];
    edge.resize(distance.size());
    find_edge(distance.data(), static_cast<Index>(distance.size()), fit.sigma, edge.value.data(), edge.by_distance.data(),
              edge.by_sigma.data());
  }
}

double residual(const Pixels& pixels, const Fit& fit, std::size_t n, std::size_t k) {
  const Levels& l = fit.levels[n];
  const double x = pixels.x[k], y = pixels.y[k], p = fit.edge[0].value[k] * fit.edge[1].value[k];
  return pixels.value[k] - (l[0] + l[1] * x + l[2] * y + (l[3] + l[4] * x + l[5] * y) * p);
}

/// The sum of squares of what the model leaves.
double cost_of(const Pixels& pixels, const Fit& fit) {
  double total = 0.0;
  for (std::size_t n = 0; n < fit.geometry.size(); ++n) {
    double sum = 0.0;
    for (auto k = static_cast<std::size_t>(pixels.first[n]); k < static_cast<std::size_t>(pixels.first[n + 1]); ++k) {
      const double r = residual(pixels, fit, n, k);
      sum += r * r;
    }
    total += sum;
  }
  return total;
}

/// Solves a system of `size` equations (rows of `matrix`) for `sides` right sides, which follow in each row; Gauss, with pivots.
template <int size, int sides>
void solve(std::array<std::array<double, size + sides>, size>& matrix) {
  for (std::size_t k = 0; k < size; ++k) {
    std::size_t pivot = k;
    for (std::size_t i = k + 1; i < size; ++i) {
      if (std::fabs(matrix[i][k]) > std::fabs(matrix[pivot][k])) pivot = i;
    }
    std::swap(matrix[k], matrix[pivot]);
    for (std::size_t i = 0; i < size; ++i) {
      if (i == k) continue;
      const double share = matrix[i][k] / matrix[k][k];
      for (std::size_t j = k; j < size + sides; ++j) matrix[i][j] -= share * matrix[k][j];
    }
  }
  for (std::size_t k = 0; k < size; ++k) {
    for (std::size_t j = size; j < size + sides; ++j) matrix[k][j] /= matrix[k][k];
  }
}

/// m and c of given edges: a linear problem for each corner.
void fit_levels(const Pixels& pixels, Fit& fit) {
  for (std::size_t n = 0; n < fit.geometry.size(); ++n) {
    std::array<std::array<double, linear + 1>, linear> normal{};
    for (auto k = static_cast<std::size_t>(pixels.first[n]); k < static_cast<std::size_t>(pixels.first[n + 1]); ++k) {
      const double x = pixels.x[k], y = pixels.y[k], p = fit.edge[0].value[k] * fit.edge[1].value[k];
      const double row[linear + 1] = {1.0, x, y, p, x * p, y * p, pixels.value[k]};
      for (std::size_t a = 0; a < linear; ++a) {
        for (std::size_t b = 0; b < linear + 1; ++b) normal[a][b] += row[a] * row[b];
      }
    }
    for (std::size_t a = 0; a < linear; ++a) normal[a][a] += 1e-9;
    solve<linear, 1>(normal);
    for (std::size_t a = 0; a < linear; ++a) fit.levels[n][a] = normal[a][linear];
  }
}

/// One Levenberg-Marquardt step: the corners' own numbers (N, 10), and that of sigma, by the Schur complement.
double find_step(const Pixels& pixels, const Fit& fit, double damping, std::vector<std::array<double, own>>& step) {
  constexpr std::size_t shared = own, right = own + 1, columns = own + 2;
  const std::size_t count = fit.geometry.size();
  std::vector<std::array<double, own>> side(count);
  step.resize(count);
  double square = 0.0, across = 0.0, reduced = 0.0, solved_side = 0.0;
  for (std::size_t n = 0; n < count; ++n) {
    const Geometry& g = fit.geometry[n];
    const Levels& l = fit.levels[n];
    const double cos1 = cos(g[2]), sin1 = sin(g[2]), cos2 = cos(g[3]), sin2 = sin(g[3]);
    double normal[columns][columns] = {};
    for (auto k = static_cast<std::size_t>(pixels.first[n]); k < static_cast<std::size_t>(pixels.first[n + 1]); ++k) {
      const double x = pixels.x[k], y = pixels.y[k], a = x - g[0], b = y - g[1], c = l[3] + l[4] * x + l[5] * y;
      const double e1 = fit.edge[0].value[k], e2 = fit.edge[1].value[k], p = e1 * e2;
      const double by_d1 = c * fit.edge[0].by_distance[k] * e2, by_d2 = c * e1 * fit.edge[1].by_distance[k];
      const double by_sigma = c * (fit.edge[0].by_sigma[k] * e2 + e1 * fit.edge[1].by_sigma[k]);
      const double row[columns] = {-by_d1 * cos1 - by_d2 * cos2,
                                   -by_d1 * sin1 - by_d2 * sin2,
                                   by_d1 * (b * cos1 - a * sin1),
                                   by_d2 * (b * cos2 - a * sin2),
                                   1.0,
                                   x,
                                   y,
                                   p,
                                   x * p,
                                   y * p,
                                   by_sigma,
                                   residual(pixels, fit, n, k)};
      for (std::size_t i = 0; i < columns; ++i) {
        for (std::size_t j = 0; j < columns; ++j) normal[i][j] += row[i] * row[j];
      }
    }
    std::array<std::array<double, own + 2>, own> system;
    for (std::size_t i = 0; i < own; ++i) {
      for (std::size_t j = 0; j < own; ++j) system[i][j] = normal[i][j];
      system[i][i] += damping * normal[i][i] + 1e-12;
      system[i][own] = normal[i][right], system[i][own + 1] = normal[i][shared];
    }
    solve<own, 2>(system);
    square += normal[shared][shared], across += normal[shared][right];
    for (std::size_t i = 0; i < own; ++i) {
      step[n][i] = system[i][own], side[n][i] = system[i][own + 1];
      reduced += normal[i][shared] * system[i][own], solved_side += normal[i][shared] * system[i][own + 1];
    }
  }
  const double sigma = (across - reduced) / std::max(square * (1.0 + damping) - solved_side, 1e-12);
  for (std::size_t n = 0; n < count; ++n) {
    for (std::size_t i = 0; i < own; ++i) step[n][i] -= sigma * side[n][i];
  }
  return sigma;
}

/// The pixels around each corner within `reach_of_square` along rows and columns.
Pixels take_pixels(Array<const double, any, any> image, Array<const double, any, 2> start, Array<const double, any, 2> along,
                   Array<const double, any, 2> down) {
  double longest = 0.0;
  for (Index n = 0; n < start.size(); ++n) {
    for (const auto& side : {along, down}) {
      longest = std::max(longest, std::sqrt(side(n, 0) * side(n, 0) + side(n, 1) * side(n, 1)));
    }
  }
  const Index reach = static_cast<Index>(std::ceil(std::min(reach_of_square * longest * 1.5, largest_reach_px)));
  Pixels pixels;
  for (Index n = 0; n < start.size(); ++n) {
    pixels.first.push_back(static_cast<Index>(pixels.x.size()));
    const Index column = static_cast<Index>(std::nearbyint(start(n, 0))), row = static_cast<Index>(std::nearbyint(start(n, 1)));
    const double det = along(n, 0) * down(n, 1) - along(n, 1) * down(n, 0);
    double sum = 0.0;
    for (Index v = std::max<Index>(row - reach, 0); v <= std::min(row + reach, image.size(0) - 1); ++v) {
      for (Index u = std::max<Index>(column - reach, 0); u <= std::min(column + reach, image.size(1) - 1); ++u) {
        const double x = static_cast<double>(u) - start(n, 0), y = static_cast<double>(v) - start(n, 1);
        const double i = (x * down(n, 1) - y * down(n, 0)) / det, j = (y * along(n, 0) - x * along(n, 1)) / det;
        const bool near = std::sqrt(x * x + y * y) <= largest_reach_px;
        if (!near || !(std::fabs(i) < reach_of_square) || !(std::fabs(j) < reach_of_square)) continue;
        pixels.x.push_back(x), pixels.y.push_back(y), pixels.value.push_back(image(v, u));
        sum += image(v, u) * image(v, u);
      }
    }
    const auto first = static_cast<std::size_t>(pixels.first.back());
    const double scale = std::sqrt(sum / static_cast<double>(pixels.x.size() - first));
    for (std::size_t k = first; k < pixels.value.size(); ++k) pixels.value[k] /= scale;
  }
  pixels.first.push_back(static_cast<Index>(pixels.x.size()));
  return pixels;
}

double clipped(double value, double low, double high) { return std::min(std::max(value, low), high); }

}  // namespace

double fit_corners(Array<const double, any, any> image, Array<const double, any, 2> start, Array<const double, any, 2> along,
                   Array<const double, any, 2> down, Array<double, any, 2> offset, Array<double, any, 6> levels) {
  const auto count = static_cast<std::size_t>(start.size());
  const Pixels pixels = take_pixels(image, start, along, down);
  for (std::size_t n = 0; n < count; ++n) {
    if (pixels.first[n + 1] - pixels.first[n] < fewest_pixels) return std::numeric_limits<double>::quiet_NaN();
  }
  Fit fit, tried;
  std::vector<double> distance;
  std::vector<std::array<double, own>> step;
  fit.geometry.resize(count), fit.levels.resize(count);
  for (std::size_t n = 0; n < count; ++n) {
    // Normals of the two edges: the distance from the line along x grows with y of the board, and the other way round.
    const auto k = static_cast<Index>(n);
    fit.geometry[n] = {0.0, 0.0, atan2(along(k, 0), -along(k, 1)), atan2(-down(k, 0), down(k, 1))};
  }
  find_edges(pixels, fit, distance);
  fit_levels(pixels, fit);
  fit.cost = cost_of(pixels, fit);
  double damping = 1e-3;
  for (int round = 0; round < rounds; ++round) {
    const double shared = find_step(pixels, fit, damping, step);
    tried.geometry = fit.geometry, tried.levels = fit.levels;
    double moved = 0.0;
    for (std::size_t n = 0; n < count; ++n) {
      for (std::size_t i = 0; i < 4; ++i) tried.geometry[n][i] += clipped(step[n][i], -0.5, 0.5);
      for (std::size_t i = 0; i < linear; ++i) tried.levels[n][i] += step[n][4 + i];
      for (std::size_t i = 0; i < 2; ++i) moved = std::max(moved, std::fabs(tried.geometry[n][i] - fit.geometry[n][i]));
    }
    tried.sigma = clipped(fit.sigma + shared, 0.05, 3.0);
    find_edges(pixels, tried, distance);
    tried.cost = cost_of(pixels, tried);
    if (!(tried.cost < fit.cost)) {
      damping *= 10.0;
      continue;
    }
    std::swap(fit, tried);
    damping = std::max(damping / 5.0, 1e-9);
    if (moved < settled_px) break;
  }
  for (std::size_t n = 0; n < count; ++n) {
    const auto k = static_cast<Index>(n);
    for (std::size_t i = 0; i < 2; ++i) offset(k, i) = fit.geometry[n][i];
    for (std::size_t i = 0; i < linear; ++i) levels(k, i) = fit.levels[n][i];
  }
  return fit.sigma;
}

}  // namespace cabinpose

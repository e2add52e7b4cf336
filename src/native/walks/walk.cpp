#include <array>
#include <cmath>
#include <limits>
#include <vector>

#include "walks/forest.hpp"

namespace cabinpose {
namespace {

using Point = std::array<float, 3>;

float squared(const Point& a, const float* b) {
  const float x = a[0] - b[0], y = a[1] - b[1], z = a[2] - b[2];
  return x * x + y * y + z * z;
}

}  // namespace

void cluster(Array<const float, any, 3> targets, Array<const std::int64_t, any> order, Array<const std::int64_t, any> starts,
             Index rounds, Array<float, any, any, 3> directions, Array<float, any, any> shares) {
  const Index clusters = shares.size(1);
  std::vector<Point> centres(static_cast<std::size_t>(clusters)), sums(centres.size());
  std::vector<Index> counts(centres.size());
  std::vector<float> apart;
  for (Index leaf = 0; leaf < shares.size(); ++leaf) {
    const Index begin = starts(leaf), count = starts(leaf + 1) - begin;
    auto target = [&](Index i) { return targets[order(begin + i)].data(); };
    // The first centre is the mean; each other one the target that is farthest from all before.
    centres[0] = {};
    for (Index i = 0; i < count; ++i)
      for (std::size_t k = 0; k < 3; ++k) centres[0][k] += target(i)[k] / static_cast<float>(count);
    apart.assign(static_cast<std::size_t>(count), std::numeric_limits<float>::max());
    for (std::size_t c = 1; c < centres.size(); ++c) {
      Index farthest = 0;
      for (Index i = 0; i < count; ++i) {
        float& distance = apart[static_cast<std::size_t>(i)];
        distance = std::min(distance, squared(centres[c - 1], target(i)));
        if (distance > apart[static_cast<std::size_t>(farthest)]) farthest = i;
      }
      std::copy_n(target(farthest), 3, centres[c].begin());
    }
    for (Index round = 0; round < rounds; ++round) {
      std::fill(sums.begin(), sums.end(), Point{});
      std::fill(counts.begin(), counts.end(), 0);
      for (Index i = 0; i < count; ++i) {
        std::size_t nearest = 0;
        float least = squared(centres[0], target(i));
        for (std::size_t c = 1; c < centres.size(); ++c) {
          const float distance = squared(centres[c], target(i));
          if (distance < least) {
            least = distance;
            nearest = c;
          }
        }
        for (std::size_t k = 0; k < 3; ++k) sums[nearest][k] += target(i)[k];
        ++counts[nearest];
      }
      for (std::size_t c = 0; c < centres.size(); ++c)
        if (counts[c] > 0)
          for (std::size_t k = 0; k < 3; ++k) centres[c][k] = sums[c][k] / static_cast<float>(counts[c]);
    }
    Index below = 0;
    for (Index c = 0; c < clusters; ++c) {
      const auto at = static_cast<std::size_t>(c);
      const float length = std::sqrt(squared(Point{}, sums[at].data()));
      for (std::size_t k = 0; k < 3; ++k) directions(leaf, c, k) = counts[at] > 0 && length > 0.0F ? sums[at][k] / length : 0.0F;
      below += counts[at];
      shares(leaf, c) = static_cast<float>(below) / static_cast<float>(count);
    }
  }
}

void walk(Array<const float, any, any, any> depth, View view, Array<const float, any, 3> starts,
          Array<const std::int32_t, any, 2> order, Forest forest, float step, Index skipped,
          Array<float, any, any, any, any, 3> places, Array<float, any, any, any, 3> joints) {
  const Index people = starts.size(), steps = places.size(3), clusters = forest.shares.size(1);
  constexpr float nearest = 0.1F;  // m: no walk comes nearer to the camera
  for (Index n = 0; n < depth.size(); ++n)
    for (Index person = 0; person < people; ++person)
      for (Index turn = 0; turn < order.size(); ++turn) {
        const Index joint = order(turn, 0), from = order(turn, 1);
        Point point;
        std::copy_n(from < 0 ? starts[person].data() : joints[n][person][from].data(), 3, point.begin());
        std::uint64_t random = 0x9E3779B97F4A7C15U * static_cast<std::uint64_t>(joint + 1);
        std::array<double, 3> sum{};
        for (Index s = 0; s < steps; ++s) {
          const Surroundings<float> around(depth[n].data(), depth.size(1), depth.size(2), view, point.data());
          Index node = forest.roots(joint);
          while (forest.children(node) >= 0)
            node = forest.children(node) + (around.feature(forest.offsets[node].data()) < forest.thresholds(node) ? 0 : 1);
          const Index leaf = -1 - forest.children(node);
          random = random * 6364136223846793005U + 1442695040888963407U;
          const float drawn = static_cast<float>(random >> 40U) * 0x1p-24F;
          Index which = 0;
          while (which + 1 < clusters && forest.shares(leaf, which) <= drawn) ++which;
          for (std::size_t k = 0; k < 3; ++k) point[k] += step * forest.directions(leaf, which, k);
          point[2] = std::max(point[2], nearest);
          for (std::size_t k = 0; k < 3; ++k) {
            places(n, person, joint, s, k) = point[k];
            if (s >= skipped) sum[k] += static_cast<double>(point[k]);
          }
        }
        for (std::size_t k = 0; k < 3; ++k)
          joints(n, person, joint, k) = static_cast<float>(sum[k] / static_cast<double>(steps - skipped));
      }
}

}  // namespace cabinpose

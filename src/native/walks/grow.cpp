#include <array>
#include <vector>

#include "walks/forest.hpp"

namespace cabinpose {
namespace {

constexpr Index batch = 16;  // features whose histograms stay in the cache while a sample's surroundings do

struct Sum {
  float n = 0.0F, x = 0.0F, y = 0.0F, z = 0.0F;
  void add(const Sum& other) {
    n += other.n;
    x += other.x;
    y += other.y;
    z += other.z;
  }
  Sum without(const Sum& other) const { return {n - other.n, x - other.x, y - other.y, z - other.z}; }
  /// What the samples' mean explains of their squares: the greater over two sides, the less variance is left.
  double explained() const {
    return (static_cast<double>(x) * static_cast<double>(x) + static_cast<double>(y) * static_cast<double>(y) +
            static_cast<double>(z) * static_cast<double>(z)) /
           static_cast<double>(n);
  }
};

struct Split {
  Index feature = -1;
  int threshold = 0;
  double explained = 0.0;
};

struct Node {
  Index number, begin, end, depth;
};

}  // namespace

Tree grow(Array<const std::uint16_t, any, any, any> depth, View view, Array<const std::int32_t, any> frame,
          Array<const float, any, 3> points, Array<const float, any, 3> targets, Splits pool, Index tried, Index most,
          Index least, Index deepest) {
  const Index frames = depth.size(), height = depth.size(1), width = depth.size(2), features = pool.size();
  auto around = [&](Index sample) {
    const Index n = frame(sample);
    return Surroundings<std::uint16_t>(depth[n % frames].data(), height, width, view, points[sample].data(), n >= frames);
  };
  Tree tree;
  auto new_node = [&] {
    tree.offsets.insert(tree.offsets.end(), 4, 0.0F);
    tree.thresholds.push_back(0);
    tree.children.push_back(0);
    return static_cast<Index>(tree.children.size()) - 1;
  };
  tree.leaf.resize(static_cast<std::size_t>(frame.size()));
  std::vector<Index> samples(tree.leaf.size()), right;
  for (std::size_t i = 0; i < samples.size(); ++i) samples[i] = static_cast<Index>(i);
  std::vector<std::array<Sum, feature_bins>> sums(batch);

  auto best_split = [&](const Node& node) {
    const Index count = node.end - node.begin, seen = std::min(count, most);
    const float fewest = static_cast<float>(std::max<Index>(1, least * seen / count));
    auto chosen = [&](Index i) { return samples[static_cast<std::size_t>(node.begin + i * count / seen)]; };
    Sum all;
    for (Index i = 0; i < seen; ++i) all.add({1.0F, targets(chosen(i), 0), targets(chosen(i), 1), targets(chosen(i), 2)});
    Split best{-1, 0, all.explained() * (1.0 + 1e-6)};
    for (Index first = 0; first < tried; first += batch) {
      const Index some = std::min(batch, tried - first);
      for (Index k = 0; k < some; ++k) sums[static_cast<std::size_t>(k)].fill({});
      for (Index i = 0; i < seen; ++i) {
        const Index sample = chosen(i);
        const auto surroundings = around(sample);
        const Sum one{1.0F, targets(sample, 0), targets(sample, 1), targets(sample, 2)};
        for (Index k = 0; k < some; ++k) {
          const float* split = pool[(node.number * tried + first + k) % features].data();
          sums[static_cast<std::size_t>(k)][static_cast<std::size_t>(surroundings.feature(split))].add(one);
        }
      }
      for (Index k = 0; k < some; ++k) {
        Sum left;
        for (int threshold = 1; threshold < feature_bins; ++threshold) {
          const Sum& bin = sums[static_cast<std::size_t>(k)][static_cast<std::size_t>(threshold - 1)];
          if (bin.n == 0.0F) continue;
          left.add(bin);
          const Sum rest = all.without(left);
          if (left.n < fewest) continue;
          if (rest.n < fewest) break;
          const double explained = left.explained() + rest.explained();
          if (explained > best.explained) best = {(node.number * tried + first + k) % features, threshold, explained};
        }
      }
    }
    return best;
  };

  std::int32_t leaves = 0;
  std::vector<Node> open{{new_node(), 0, frame.size(), 0}};
  while (!open.empty()) {
    const Node node = open.back();
    open.pop_back();
    const auto at = static_cast<std::size_t>(node.number);
    Index middle = node.begin;
    Split split;
    if (node.end - node.begin >= 2 * least && node.depth < deepest) split = best_split(node);
    if (split.feature >= 0) {
      right.clear();
      for (Index i = node.begin; i < node.end; ++i) {
        const Index sample = samples[static_cast<std::size_t>(i)];
        if (around(sample).feature(pool[split.feature].data()) < split.threshold)
          samples[static_cast<std::size_t>(middle++)] = sample;
        else
          right.push_back(sample);
      }
      std::copy(right.begin(), right.end(), samples.begin() + middle);
    }
    if (split.feature < 0 || middle == node.begin || middle == node.end) {
      tree.children[at] = -1 - leaves;
      for (Index i = node.begin; i < node.end; ++i)
        tree.leaf[static_cast<std::size_t>(samples[static_cast<std::size_t>(i)])] = leaves;
      ++leaves;
      continue;
    }
    std::copy_n(pool[split.feature].data(), 4, tree.offsets.begin() + 4 * node.number);
    tree.thresholds[at] = split.threshold;
    const Index left = new_node(), other = new_node();
    tree.children[at] = static_cast<std::int32_t>(left);
    open.push_back({other, middle, node.end, node.depth + 1});
    open.push_back({left, node.begin, middle, node.depth + 1});
  }
  return tree;
}

}  // namespace cabinpose

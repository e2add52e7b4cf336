#include "contact/order.hpp"

#include <algorithm>
#include <array>
#include <numeric>
#include <vector>

namespace cabinpose {
namespace {

/// The axis along which some points extend farthest, the first of those that are equal.
Index widest_axis(Array<const double, any, 3> points, const std::int64_t* first, const std::int64_t* last) {
  std::array<double, 3> low{}, high{};
  for (Index axis = 0; axis < 3; ++axis) low[axis] = high[axis] = points(*first, axis);
  for (const std::int64_t* i = first; i != last; ++i) {
    for (Index axis = 0; axis < 3; ++axis) {
      low[axis] = std::min(low[axis], points(*i, axis));
      high[axis] = std::max(high[axis], points(*i, axis));
    }
  }
  Index widest = 0;
  for (Index axis = 1; axis < 3; ++axis) {
    if (high[axis] - low[axis] > high[widest] - low[widest]) widest = axis;
  }
  return widest;
}

}  // namespace

void by_place(Array<const double, any, 3> points, Index run, Array<std::int64_t, any> order) {
  std::iota(order.data(), order.data() + order.size(), 0);
  std::vector<std::pair<Index, Index>> pending{{0, order.size()}};
  while (!pending.empty()) {
    const auto [start, end] = pending.back();
    pending.pop_back();
    if (end - start <= run) continue;
    std::int64_t *first = order.data() + start, *last = order.data() + end;
    const Index axis = widest_axis(points, first, last);
    std::stable_sort(first, last, [&](std::int64_t a, std::int64_t b) { return points(a, axis) < points(b, axis); });
    const Index middle = start + run * std::max<Index>((end - start) / (2 * run), 1);
    pending.emplace_back(start, middle);
    pending.emplace_back(middle, end);
  }
}

}  // namespace cabinpose

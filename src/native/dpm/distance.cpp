#include "dpm/distance.hpp"

#include <algorithm>
#include <limits>
#include <vector>

namespace cabinpose {

namespace {

/// The upper envelope of n parabolas −a (p − q)² + value[q], and what reads and writes it needs.
class Envelope {
 public:
  explicit Envelope(Index n) : value(static_cast<std::size_t>(n)), apex_(value.size()), from_(value.size() + 1) {}

  std::vector<double> value;  // at the grid's points, to be filled before `build`

  void build(double a) {
    a_ = a;
    count_ = 0;
    const Index n = static_cast<Index>(value.size());
    for (Index q = 0; q < n; ++q) {
      double start = -std::numeric_limits<double>::infinity();
      while (count_ > 0) {
        const Index p = apex_[count_ - 1];
        // Where the parabola at q overtakes the one at p, which lies before it.
        start = 0.5 * static_cast<double>(q + p) - (at(q) - at(p)) / (2.0 * a_ * static_cast<double>(q - p));
        if (start > from_[count_ - 1]) break;
        --count_;
        start = -std::numeric_limits<double>::infinity();
      }
      apex_[count_] = q;
      from_[count_] = start;
      ++count_;
    }
    from_[count_] = std::numeric_limits<double>::infinity();
  }

  /// The envelope at the points x + m, x = 0 .. n − 1: take(x, value, apex).
  template <class Take>
  void read(double m, Take take) const {
    std::size_t k = 0;
    const Index n = static_cast<Index>(value.size());
    for (Index x = 0; x < n; ++x) {
      const double p = static_cast<double>(x) + m;
      while (from_[k + 1] < p) ++k;
      const double d = static_cast<double>(apex_[k]) - p;
      take(x, at(apex_[k]) - a_ * d * d, apex_[k]);
    }
  }

 private:
  double at(Index q) const { return value[static_cast<std::size_t>(q)]; }

  double a_ = 1.0;
  std::size_t count_ = 0;
  std::vector<Index> apex_;
  std::vector<double> from_;  // where each parabola begins to be the greatest
};

}  // namespace

void spring_transform(Array<const float, any, any, any> score, Array<const double, any, 4> spring,
                      Array<float, any, any, any> best, Array<std::int32_t, any, any, any> source) {
  const Index maps = score.size(0), height = score.size(1), width = score.size(2);
  Envelope row(width), column(height);
  std::vector<double> along(static_cast<std::size_t>(height * width));
  std::vector<Index> column_of(along.size());
  for (Index k = 0; k < maps; ++k) {
    for (Index y = 0; y < height; ++y) {
      for (Index x = 0; x < width; ++x) row.value[static_cast<std::size_t>(x)] = static_cast<double>(score(k, y, x));
      row.build(spring(k, 0));
      row.read(spring(k, 1), [&](Index x, double value, Index apex) {
        along[static_cast<std::size_t>(y * width + x)] = value;
        column_of[static_cast<std::size_t>(y * width + x)] = apex;
      });
    }
    for (Index x = 0; x < width; ++x) {
      for (Index y = 0; y < height; ++y)
        column.value[static_cast<std::size_t>(y)] = along[static_cast<std::size_t>(y * width + x)];
      column.build(spring(k, 2));
      column.read(spring(k, 3), [&](Index y, double value, Index apex) {
        best(k, y, x) = static_cast<float>(value);
        source(k, y, x) = static_cast<std::int32_t>(apex * width + column_of[static_cast<std::size_t>(apex * width + x)]);
      });
    }
  }
}

}  // namespace cabinpose

#include "align/blob.hpp"

#include <algorithm>
#include <cmath>
#include <limits>
#include <vector>

#include "core/math.hpp"

namespace cabinpose {

namespace {

constexpr double nan = std::numeric_limits<double>::quiet_NaN();
constexpr int rounds = 20;      // in which the window moves, at most
constexpr double window = 1.7;  // radius of the window, in radii of the blob at half its height, and `beyond` px more
constexpr double beyond = 1.5;
constexpr double settled = 1e-6;   // px by which the window no longer moves
constexpr double half_step = 0.5;  // deviation of whole numbers, at least

enum Mark : std::uint8_t { plain = 0, lost = 1, bright = 2, clipped = 4, outside = 8, seen = 16 };

/// A rectangle of pixels, last row and column within it.
struct Box {
  Index top, left, bottom, right;

  bool has(Index v, Index u) const { return v >= top && v <= bottom && u >= left && u <= right; }
  void add(Index v, Index u) {
    top = std::min(top, v), bottom = std::max(bottom, v), left = std::min(left, u), right = std::max(right, u);
  }
};

struct Blob {
  Index area = 0;
  double top = -std::numeric_limits<double>::infinity();  // its brightest pixel
  double u = 0.0, v = 0.0;                                // sums of its pixels' columns and rows
};

struct Workspace {
  std::vector<double> image, sorted;
  std::vector<std::uint8_t> mark;
  std::vector<Index> stack;
  Index width = 0, height = 0;

  std::uint8_t& at(Index k) { return mark[static_cast<std::size_t>(k)]; }
};

/// The middle value, or the mean of the two in the middle; the values change places.
double median(std::vector<double>& values) {
  const auto middle = values.begin() + static_cast<Index>(values.size() / 2);
  std::nth_element(values.begin(), middle, values.end());
  return values.size() % 2 ? *middle : (*std::max_element(values.begin(), middle) + *middle) / 2;
}

/// Visits the pixels that touch one, at a side or also at a corner, within a box.
template <class Visit>
void neighbours(Index pixel, Index width, const Box& box, bool corners, Visit visit) {
  const Index v = pixel / width, u = pixel % width;
  for (Index dv = -1; dv <= 1; ++dv) {
    for (Index du = -1; du <= 1; ++du) {
      if ((corners || dv == 0 || du == 0) && box.has(v + dv, u + du)) visit((v + dv) * width + u + du);
    }
  }
}

/// Marks what is connected to the pixels on the stack and `wanted`, a mask and its value.
void flood(Workspace& work, const Box& box, bool corners, int mask, int wanted, Mark mark) {
  while (!work.stack.empty()) {
    const Index pixel = work.stack.back();
    work.stack.pop_back();
    neighbours(pixel, work.width, box, corners, [&](Index other) {
      std::uint8_t& there = work.at(other);
      if ((there & mask) != wanted || there & mark) return;
      there = static_cast<std::uint8_t>(there | mark);
      work.stack.push_back(other);
    });
  }
}

/// Makes clipped pixels, lost ones or dark ones within a ring of bright ones, as bright as the brightest; returns the box of all.
Box fill(Workspace& work, double level, double brightest) {
  const Box whole{0, 0, work.height - 1, work.width - 1};
  Box box{work.height, work.width, -1, -1};
  for (Index k = 0; k < work.height * work.width; ++k) {
    if (!(work.image[static_cast<std::size_t>(k)] > level)) continue;
    work.at(k) = static_cast<std::uint8_t>(work.at(k) | bright);
    box.add(k / work.width, k % work.width);
    work.stack.push_back(k);
  }
  // A lost pixel beside a bright one is of the blob, even where the ring about it is not whole.
  flood(work, whole, true, lost, lost, clipped);
  for (Index k = 0; k < work.height * work.width; ++k) {
    if (work.at(k) & clipped) box.add(k / work.width, k % work.width);
  }
  // What cannot be reached from outside is a hole. All outside the box can, and so what lies at its sides.
  for (Index v = box.top; v <= box.bottom; ++v) {
    for (Index u = box.left; u <= box.right; ++u) {
      const bool side = v == box.top || v == box.bottom || u == box.left || u == box.right;
      std::uint8_t& here = work.at(v * work.width + u);
      if (!side || here & (bright | clipped)) continue;
      here = static_cast<std::uint8_t>(here | outside);
      work.stack.push_back(v * work.width + u);
    }
  }
  flood(work, box, false, bright | clipped, plain, outside);
  for (Index v = box.top; v <= box.bottom; ++v) {
    for (Index u = box.left; u <= box.right; ++u) {
      const Index k = v * work.width + u;
      if (work.at(k) & (bright | outside)) continue;
      work.at(k) = static_cast<std::uint8_t>(work.at(k) | bright);
      work.image[static_cast<std::size_t>(k)] = brightest;
    }
  }
  return box;
}

/// The blob that a bright pixel belongs to; pixels that touch at a corner belong together. They are left on `work.stack`.
Blob take_blob(Workspace& work, const Box& box, Index pixel) {
  Blob blob;
  work.stack.assign(1, pixel);
  work.at(pixel) = static_cast<std::uint8_t>(work.at(pixel) | seen);
  for (std::size_t k = 0; k < work.stack.size(); ++k) {
    const Index here = work.stack[k];
    ++blob.area;
    blob.top = std::max(blob.top, work.image[static_cast<std::size_t>(here)]);
    blob.u += static_cast<double>(here % work.width), blob.v += static_cast<double>(here / work.width);
    neighbours(here, work.width, box, true, [&](Index other) {
      if ((work.at(other) & (bright | seen)) != bright) return;
      work.at(other) = static_cast<std::uint8_t>(work.at(other) | seen);
      work.stack.push_back(other);
    });
  }
  return blob;
}

/// The centroid above the background, in a round window that is moved until it is centred on what it finds.
void find_centroid(Workspace& work, const Blob& blob, double* centre) {
  const double area = static_cast<double>(blob.area);
  centre[0] = blob.u / area, centre[1] = blob.v / area;
  const double radius = window * std::sqrt(area / pi) + beyond;
  const Index reach = static_cast<Index>(std::ceil(2 * radius + 3));
  const Index row = static_cast<Index>(std::nearbyint(centre[1])), column = static_cast<Index>(std::nearbyint(centre[0]));
  const Box box{std::max<Index>(row - reach, 0), std::max<Index>(column - reach, 0), std::min(row + reach, work.height - 1),
                std::min(column + reach, work.width - 1)};
  auto distance = [&](Index v, Index u) {
    const double x = static_cast<double>(u) - centre[0], y = static_cast<double>(v) - centre[1];
    return std::sqrt(x * x + y * y);
  };
  auto value = [&](Index v, Index u) { return work.image[static_cast<std::size_t>(v * work.width + u)]; };
  work.sorted.clear();
  for (Index v = box.top; v <= box.bottom; ++v) {
    for (Index u = box.left; u <= box.right; ++u) {
      const double d = distance(v, u);
      if (d > radius + 1 && d <= radius + 3) work.sorted.push_back(value(v, u));
    }
  }
  const double background = work.sorted.empty() ? 0.0 : median(work.sorted);
  for (int round = 0; round < rounds; ++round) {
    double sum = 0.0, sum_u = 0.0, sum_v = 0.0;
    for (Index v = box.top; v <= box.bottom; ++v) {
      for (Index u = box.left; u <= box.right; ++u) {
        // A pixel that the window's edge crosses counts in part: a window of whole pixels would jump with it.
        const double share = std::min(std::max(radius + 0.5 - distance(v, u), 0.0), 1.0);
        const double weight = std::max(value(v, u) - background, 0.0) * share;
        sum += weight, sum_u += weight * static_cast<double>(u), sum_v += weight * static_cast<double>(v);
      }
    }
    const double moved = std::max(std::fabs(sum_u / sum - centre[0]), std::fabs(sum_v / sum - centre[1]));
    centre[0] = sum_u / sum, centre[1] = sum_v / sum;
    if (moved < settled) break;
  }
}

}  // namespace

void find_blob(Array<const double, any, any> image, const BlobLimits& limits, Array<double, 2> uv) {
  thread_local Workspace own;
  Workspace& work = own;
  work.height = image.size(0), work.width = image.size(1);
  const auto count = static_cast<std::size_t>(image.count());
  uv[0] = uv[1] = nan;
  work.image.assign(image.data(), image.data() + count);
  work.mark.assign(count, plain);
  work.sorted.clear(), work.stack.clear();
  for (std::size_t k = 0; k < count; ++k) {
    if (std::isfinite(work.image[k])) {
      work.sorted.push_back(work.image[k]);
    } else {
      work.mark[k] = lost;
    }
  }
  if (work.sorted.empty()) return;
  const double brightest = *std::max_element(work.sorted.begin(), work.sorted.end());
  const double middle = median(work.sorted), height = brightest - middle;
  for (double& value : work.sorted) value = std::fabs(value - middle);
  const double deviation = std::max(median(work.sorted), half_step);
  if (height < limits.min_contrast * deviation || height < 2 * middle) return;
  for (std::size_t k = 0; k < count; ++k) work.image[k] = work.mark[k] ? middle : work.image[k];
  // Blobs are parted at half of the height; one counts if its top reaches `rival` of the height, and more than a pixel does.
  const Box box = fill(work, middle + 0.5 * height, brightest);
  Blob best;
  int found = 0;
  for (Index v = box.top; v <= box.bottom; ++v) {
    for (Index u = box.left; u <= box.right; ++u) {
      const Index k = v * work.width + u;
      if ((work.at(k) & (bright | seen)) != bright) continue;
      const Blob blob = take_blob(work, box, k);
      if (blob.top - middle >= limits.rival * height && blob.area >= limits.min_area) best = blob, ++found;
    }
  }
  if (found == 1 && best.area <= limits.max_area) find_centroid(work, best, uv.data());
}

}  // namespace cabinpose

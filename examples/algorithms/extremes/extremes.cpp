#include "extremes.hpp"

#include <algorithm>
#include <cmath>
#include <functional>
#include <numeric>
#include <queue>
#include <utility>
#include <vector>

namespace {

constexpr float kStep = 0.05f;       // m between neighbouring pixels of one surface, at 3 m
constexpr float kFloor = 0.10f;      // m above the floor that are cut off, feet included
constexpr float kCrown = 0.14f;      // m from the crown to the skull base
constexpr double kHandArea = 0.018;  // m²: more than a hand and its wrist show
constexpr int kExtremes = 6;         // head, hands, feet, and one to spare for an elbow or a coat
constexpr int kAround[8][2] = {{0, 1}, {1, 0}, {0, -1}, {-1, 0}, {1, 1}, {1, -1}, {-1, 1}, {-1, -1}};

float distance(const Point& a, const Point& b) { return std::hypot(a.x - b.x, a.y - b.y, a.z - b.z); }

struct Cloud {
  int height, width;
  double pixel;  // m² that a pixel covers at 1 m
  std::vector<Point> points;

  Cloud(std::span<const float> depth, int h, int w, const Intrinsics& k)
      : height(h), width(w), pixel(1 / (k.fx * k.fy)), points(depth.size()) {
    for (int v = 0; v < h; ++v)
      for (int u = 0; u < w; ++u) {
        const float z = depth[v * w + u];
        if (z > 0 && std::isfinite(z)) points[v * w + u] = {float((u - k.cx) / k.fx) * z, float((v - k.cy) / k.fy) * z, z};
      }
  }

  // Calls visit(neighbour, metres) for each neighbour of a pixel on the same surface.
  template <typename Visit>
  void neighbours(int at, Visit visit) const {
    const int v = at / width, u = at % width;
    for (const auto& [dv, du] : kAround) {
      if (v + dv < 0 || v + dv >= height || u + du < 0 || u + du >= width) continue;
      const int next = at + dv * width + du;
      const float step = distance(points[at], points[next]);
      if (step < kStep * std::max(1.0f, (points[at].z + points[next].z) / 6)) visit(next, step);  // false for NaN
    }
  }
};

// Takes the floor away: what lies low, and what faces up below the camera.
void remove_floor(Cloud& cloud) {
  std::vector<float> heights;
  for (const Point& p : cloud.points)
    if (p.y > 0) heights.push_back(p.y);
  if (heights.empty()) return;
  const auto lowest = heights.begin() + std::ptrdiff_t(0.98 * double(heights.size() - 1));
  std::nth_element(heights.begin(), lowest, heights.end());
  const std::vector<Point> before = cloud.points;
  for (int v = 0; v < cloud.height; ++v)
    for (int u = 0; u < cloud.width; ++u) {
      Point& p = cloud.points[v * cloud.width + u];
      bool floor = p.y > *lowest - kFloor;
      if (v + 4 < cloud.height && p.y > 0.4f) {  // four rows lower the floor is hardly lower, but much nearer
        const Point& below = before[(v + 4) * cloud.width + u];
        floor |= p.z - below.z > 2.5f * std::abs(below.y - p.y) && below.y > p.y - 0.02f;
      }
      if (floor) p = Point{};
    }
}

// Pixels of the connected surface that is most like a person: of a person's size, large, and in front of what is around it.
std::vector<int> silhouette(const Cloud& cloud) {
  std::vector<char> seen(cloud.points.size(), 0);
  std::vector<int> best;
  double best_score = 0;
  for (int start = 0; start < int(cloud.points.size()); ++start) {
    if (seen[start] || std::isnan(cloud.points[start].z)) continue;
    std::vector<int> part{start};
    seen[start] = 1;
    for (std::size_t i = 0; i < part.size(); ++i)
      cloud.neighbours(part[i], [&](int next, float) {
        if (!seen[next]) seen[next] = 1, part.push_back(next);
      });
    if (part.size() < 500) continue;
    Point low{1e9f, 1e9f, 1e9f}, high{-1e9f, -1e9f, -1e9f};
    double area = 0;                 // m², seen from the camera
    double in_front = 0, edges = 1;  // of the pixels beside it: those farther away, and all
    for (int i : part) {
      const Point& p = cloud.points[i];
      low = {std::min(low.x, p.x), std::min(low.y, p.y), std::min(low.z, p.z)};
      high = {std::max(high.x, p.x), std::max(high.y, p.y), std::max(high.z, p.z)};
      area += double(p.z) * p.z * cloud.pixel;
      for (int next : {i - 1, i + 1})
        if (next >= 0 && next < int(cloud.points.size()) && std::abs(cloud.points[next].z - p.z) > 2 * kStep)
          ++edges, in_front += cloud.points[next].z > p.z;
    }
    const float tall = high.y - low.y, wide = high.x - low.x, deep = high.z - low.z;
    if (tall < 0.7f || tall > 2.4f || wide > 2.2f || wide < 0.25f || deep > 1.6f || area < 0.2 || area > 1.4) continue;
    const double score = area * std::pow(in_front / edges, 2);
    if (score > best_score) best_score = score, best = std::move(part);
  }
  return best;
}

// Geodesic distance over the cloud from some pixels, added to what `metres` holds; pixels elsewhere stay infinite.
void spread(const Cloud& cloud, int from, std::vector<float>& metres) {
  using Entry = std::pair<float, int>;
  std::priority_queue<Entry, std::vector<Entry>, std::greater<>> front;
  metres[from] = 0;
  front.emplace(0.0f, from);
  while (!front.empty()) {
    const auto [far, at] = front.top();
    front.pop();
    if (far > metres[at]) continue;
    cloud.neighbours(at, [&](int next, float step) {
      if (far + step < metres[next]) metres[next] = far + step, front.emplace(far + step, next);
    });
  }
}

// The mean of the body's points within a radius, moved into the body by so much.
Point mean_around(const Cloud& cloud, const std::vector<int>& body, const Point& at, float radius, float inward) {
  double x = 0, y = 0, z = 0, n = 0;
  for (int i : body) {
    const Point& p = cloud.points[i];
    if (distance(p, at) < radius) x += p.x, y += p.y, z += p.z, ++n;
  }
  if (n == 0) return at;
  return {float(x / n), float(y / n), float(z / n) + inward};
}

}  // namespace

Found find_extremes(std::span<const float> depth, int height, int width, const Intrinsics& camera) {
  Cloud cloud(depth, height, width, camera);
  remove_floor(cloud);
  const std::vector<int> body = silhouette(cloud);
  Found found;
  if (body.empty()) return found;

  Point middle{0, 0, 0};
  for (int i : body) {
    const Point& p = cloud.points[i];
    middle = {middle.x + p.x / body.size(), middle.y + p.y / body.size(), middle.z + p.z / body.size()};
  }
  const int root = *std::min_element(body.begin(), body.end(), [&](int a, int b) {
    return distance(cloud.points[a], middle) < distance(cloud.points[b], middle);
  });
  const Point trunk = cloud.points[root];

  std::vector<float> metres(cloud.points.size(), std::numeric_limits<float>::infinity());
  spread(cloud, root, metres);
  const std::vector<float> from_root = metres;
  std::vector<int> extremes;
  for (int n = 0; n < kExtremes; ++n) {
    extremes.push_back(*std::max_element(body.begin(), body.end(), [&](int a, int b) { return metres[a] < metres[b]; }));
    spread(cloud, extremes.back(), metres);  // the next one is far from this one too
  }

  // The head is up, in the middle and wider than a hand; feet are far down; what is left are hands, the farthest first.
  const auto skull_below = [&](int i) {
    const Point& crown = cloud.points[i];
    return Point{crown.x, crown.y + kCrown, crown.z};
  };
  const auto unlike_a_head = [&](int i) {
    const Point &at = cloud.points[i], skull = skull_below(i);
    double area = 0;
    for (int j : body)
      if (distance(cloud.points[j], skull) < kCrown) area += double(cloud.points[j].z) * cloud.points[j].z * cloud.pixel;
    return std::abs(at.x - trunk.x) + 0.5f * (at.y - trunk.y) + (area < kHandArea ? 1.0f : 0.0f);
  };
  const int head = *std::ranges::min_element(extremes, {}, unlike_a_head);
  if (cloud.points[head].y > trunk.y - 0.25f) return found;
  const Point skull = skull_below(head);
  found.head = {mean_around(cloud, body, skull, 0.12f, 0.06f), 1.0f};

  std::vector<int> hands;
  for (int i : extremes)
    if (i != head && cloud.points[i].y < trunk.y + 0.42f && from_root[i] > 0.4f && distance(cloud.points[i], skull) > 0.25f)
      hands.push_back(i);
  std::ranges::sort(hands, [&](int a, int b) { return from_root[a] > from_root[b]; });
  if (hands.size() > 2) hands.resize(2);
  std::ranges::sort(hands, [&](int a, int b) { return cloud.points[a].x < cloud.points[b].x; });
  for (int i : hands) {
    const bool right = hands.size() == 2 ? i == hands.front() : cloud.points[i].x < trunk.x;
    const float certain = std::clamp((from_root[i] - 0.4f) / 0.3f, 0.1f, 1.0f);
    Joint& hand = right ? found.right_hand : found.left_hand;
    hand = {mean_around(cloud, body, cloud.points[i], 0.08f, 0.02f), certain};
  }
  return found;
}

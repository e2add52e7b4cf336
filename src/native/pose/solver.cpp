#include "pose/solver.hpp"

#include <algorithm>
#include <cmath>
#include <limits>
#include <memory>
#include <stdexcept>

#include "core/math.hpp"

namespace cabinpose {
namespace {

using namespace rig;

// Weight of a metre too deep, against 1 of a task's. First people go where they want to, through everything; then they are
// pushed out, gently at first: a hand that met the door on its way would stay there.
constexpr double pressing[] = {0.0, 8.0, 40.0, 120.0};
constexpr int phases = 4, steps[] = {20, 10, 30, 15};
constexpr double longest_step[] = {1.0, 0.2, 0.2, 0.2};  // rad (a tenth of it m): nobody steps through a backrest
constexpr double near_m = 0.01;                          // what is farther than this from a solid is outside it
constexpr double still = 3e-4;                           // a step of fewer radians (and metres) ends the search
constexpr double hardly[] = {3e-2, 3e-2, 1e-2, 1e-2};    // and so does, twice, a cost that falls by less than this share
constexpr double flat = 0.2;                             // a field that grows less steeply tells no way out
constexpr double beside_m = 0.2, sideways = 0.6;  // walls are farther from a seat's middle, and the way out of them is sideways
constexpr double upwards = 0.7;                   // of a way out that leads off the ground
constexpr double roof_m = 0.45, floor_m = 0.15;   // roofs are farther above a pelvis, floors farther below
constexpr double deep_m = 0.05;                   // in a thing of one side
constexpr double across = 0.2;                    // of a way out that leads through: sideways at least so much
constexpr double past_m = 0.04;                   // more than a depth says that was measured from the wrong side
constexpr double trusted = 0.5;                   // of the way out of a solid that the tangent plane at a sample promises
constexpr double axis_step_m = 0.04;              // along bones that must stay out of foam
constexpr double slight = 0.002;                  // too deep by less is left
constexpr double first_damping[] = {1e-3, 1e-2, 1e-2, 1e-2};
constexpr int trials = 6;  // dampings tried for a step
constexpr int most_uphill = 4;
constexpr double uphill = 1.5;

/// Somewhere that a person is too deep in something.
struct Touch {
  Vec3 point, way;  // where, and which way is out
  double depth = 0.0;
  int bone = 0, against = -1;  // the own bone that carries the surface, -1 where it is not the own body's
  Squeeze what;
};

Vec3 rotation_vector(const Mat3& m) {
  const Vec3 v{m[2][1] - m[1][2], m[0][2] - m[2][0], m[1][0] - m[0][1]};
  const double sine = 0.5 * norm(v), cosine = 0.5 * (m[0][0] + m[1][1] + m[2][2] - 1.0);
  const double angle = atan2(sine, cosine);
  return (sine > 1e-9 ? 0.5 * angle / sine : 0.5) * v;
}

Mat3 turned(Vec3 v) {
  const double angle = norm(v);
  return angle < 1e-12 ? identity() : about((1.0 / angle) * v, angle);
}

BoneFrame frame(const double* matrix) { return {mat3(matrix, 4), {matrix[3], matrix[7], matrix[11]}}; }

BoneFrame operator*(const BoneFrame& a, const BoneFrame& b) {
  return {a.rotation * b.rotation, a.rotation * b.position + a.position};
}

/// A posture and all that follows from it.
struct State {
  double q[n_dofs];
  BoneFrame root;
  BoneFrames skeleton;
  Samples samples;
  std::vector<Touch> touches;
  double cost = 0.0;
};

Vec3 joint(const Mover& who, const State& state, std::int64_t number) {
  const BoneFrame& bone = state.skeleton.at[who.rest.joint_bone[number]];
  return bone.rotation * vec3(&who.rest.joint_offset(number, 0)) + bone.position;
}

/// One person's search.
class Search {
 public:
  Search(const Mover& who, const std::vector<PlacedGrid>& car, const PairArrays& pairs, double between)
      : who_(who), car_(car), pairs_(pairs), between_(between) {
    std::copy_n(who.q.data(), n_dofs, now_.q);
    now_.root = frame(who.root.data());
  }

  bool done() const { return done_; }
  const Samples& samples() const { return now_.samples; }

  /// Begin a phase of the search from where it is; the last one only where somebody is still pressed.
  void begin(int phase) {
    bool pressed = phase + 1 < phases || who_.stand == Mover::settled;
    for (const Touch& t : now_.touches) pressed = pressed || t.depth > slight;
    pressed_ = pressing[phase];
    limit_ = longest_step[phase];
    phase_ = phase;
    damping_ = first_damping[phase];
    hardly_ = uphill_ = 0;
    done_ = !pressed || who_.stand == Mover::fixed || (who_.stand == Mover::settled && phase + 1 < phases);
    pose(now_);
  }

  /// One accepted step, or none where nothing helps.
  void step(const std::vector<std::unique_ptr<Search>>& people) {
    touch(now_, people);
    now_.cost = cost(now_);
    linearise();
    for (int trial = 0; trial < trials; ++trial) {
      double change[n_unknown];
      solve(change);
      advance(change);
      pose(trial_);
      touch(trial_, people);
      trial_.cost = cost(trial_);
      if (trial_.cost < now_.cost) {
        double longest = 0.0;
        for (const double c : change) longest = std::max(longest, std::fabs(c));
        hardly_ = trial_.cost > (1.0 - hardly[phase_]) * now_.cost ? hardly_ + 1 : 0;
        damping_ = std::max(damping_ / 4.0, 1e-6);
        std::swap(now_, trial_);
        done_ = longest < still || hardly_ >= 2;
        return;
      }
      damping_ *= 5.0;
    }
    // Where a touch begins or changes sides the cost leaps: past such a place a little uphill leads on.
    if (pressed_ > 0.0 && uphill_ < most_uphill && trial_.cost < uphill * now_.cost) {
      ++uphill_;
      damping_ = first_damping[phase_];
      std::swap(now_, trial_);
      return;
    }
    done_ = true;
  }

  /// What is left, and what the tasks miss; the posture goes where it came from.
  Squeeze finish(const std::vector<std::unique_ptr<Search>>& people, Array<double, any, 2> missed) {
    if (who_.stand == Mover::fixed) return {};
    touch(now_, people);
    Squeeze worst;
    for (const Touch& t : now_.touches) {
      if (t.what.kind != Squeeze::none && t.depth > worst.excess) {
        worst = t.what;
        worst.excess = t.depth;
      }
    }
    for (Index t = 0; t < who_.goals.bone.size(); ++t) {
      double error[6];
      task(now_, t, error);
      const double* w = &who_.goals.weight(t, 0);
      for (int half = 0; half < 2; ++half) {
        double sum = 0.0;
        for (int i = 3 * half; i < 3 * half + 3; ++i) sum += w[i] > 0.0 ? error[i] * error[i] : 0.0;
        missed(t, half) = std::sqrt(sum);
      }
    }
    std::copy_n(now_.q, n_dofs, who_.q.data());
    for (int i = 0; i < 3; ++i) {
      for (int j = 0; j < 3; ++j) who_.root(i, j) = now_.root.rotation[i][j];
      who_.root(i, 3) = now_.root.position[i];
    }
    return worst;
  }

 private:
  void pose(State& state) const {
    state.skeleton.move(state.q, who_.rest, state.root);
    if (pressed_ > 0.0 || who_.stand != Mover::fresh) state.samples.pose(state.q, who_.rest, who_.samples, state.skeleton);
  }

  BoneFrame target(const State& state, Index t) const {
    const BoneFrame given = frame(&who_.goals.target(t, 0, 0));
    const int base = who_.goals.base[t];
    return base < 0 ? given : state.skeleton.at[base] * given;
  }

  /// How far a frame is from where it shall be, along and about the target's axes.
  static void miss(const BoneFrame& frame, const BoneFrame& target, double* error) {
    const Mat3 back = transposed(target.rotation);
    const Vec3 off = back * (frame.position - target.position), turn = rotation_vector(back * frame.rotation);
    for (int i = 0; i < 3; ++i) {
      error[i] = off[i];
      error[3 + i] = turn[i];
    }
  }

  void task(const State& state, Index t, double* error) const {
    miss(state.skeleton.at[who_.goals.bone[t]] * frame(&who_.goals.tool(t, 0, 0)), target(state, t), error);
  }

  void root_error(const State& state, double* error) const { miss(state.root, frame(who_.goals.root.data()), error); }

  double cost(const State& state) const {
    const GoalArrays& g = who_.goals;
    double total = 0.0, error[6];
    auto add = [&total](double e) { total += e * e; };
    for (int k = 0; k < n_dofs; ++k) add(g.stiffness[k] * (state.q[k] - g.posture[k]));
    root_error(state, error);
    for (int i = 0; i < 6; ++i) add(g.root_weight[i] * error[i]);
    for (Index t = 0; t < g.bone.size(); ++t) {
      task(state, t, error);
      for (int i = 0; i < 6; ++i) add(g.weight(t, i) * error[i]);
    }
    for (const Touch& t : state.touches) add(pressed_ * t.depth);
    return total;
  }

  void touch(State& state, const std::vector<std::unique_ptr<Search>>& people) {
    state.touches.clear();
    if (pressed_ == 0.0) return;
    follow(state.samples);
    touch_car(state);
    touch_foam(state);
    touch_self(state);
    for (std::size_t k = 0; k < people.size(); ++k) {
      if (people[k].get() != this) touch_other(state, *people[k], k);
    }
  }

  /// Adds up how far the samples of each solid have moved at most, from one posture that is looked at to the next.
  void follow(const Samples& samples) {
    const auto& rows = who_.samples.rows;
    const bool known = !last_.empty();
    last_.resize(static_cast<std::size_t>(who_.samples.rest.size()));
    for (Index s = 0; s < rows.size(); ++s) {
      double longest = 0.0;
      for (Index n = rows(s, 0); n < rows(s, 1); ++n) {
        Vec3& last = last_[static_cast<std::size_t>(n)];
        const Vec3 step = samples.point(n) - last;
        longest = std::max(longest, dot(step, step));
        last = samples.point(n);
      }
      if (known) moved_[s] += std::sqrt(longest);
    }
  }

  /// What `moved_` has to come to before a sample can meet a thing, and before another sample of the thing is nearest.
  struct Near {
    double until = 0.0, until_other = 0.0;
    Index nearest = -1;
  };

  /// The samples of a solid and a thing that they may meet: what is far from it is not looked at until enough has moved.
  struct Gap {
    double until = 0.0;        // what `moved_` has to come to before any of the samples can meet it
    std::vector<Near> of_own;  // and each of them
  };

  void touch_car(State& state) {
    const auto& rows = who_.samples.rows;
    const std::size_t solids = static_cast<std::size_t>(rows.size());
    car_gaps_.resize(solids * car_.size());
    for (std::size_t g = 0; g < car_.size(); ++g) {
      const PlacedGrid& group = car_[g];
      const Vec3 way = vec3(&who_.way(static_cast<Index>(g), 0));
      for (Index s = 0; s < rows.size(); ++s) {
        Gap& gap = car_gaps_[g * solids + static_cast<std::size_t>(s)];
        const double leave = who_.leave(s, static_cast<Index>(g));
        const double moved = moved_[s];
        if (gap.until > moved) continue;
        gap.until = moved + beyond(group, state.samples.ball(s)) + leave - who_.beside[s];
        if (gap.until > moved) continue;
        gap.of_own.resize(static_cast<std::size_t>(rows(s, 1) - rows(s, 0)));
        gap.until = std::numeric_limits<double>::infinity();
        for (Index n = rows(s, 0); n < rows(s, 1); ++n) {
          double& until = gap.of_own[static_cast<std::size_t>(n - rows(s, 0))].until;
          if (until <= moved) {
            until = moved + press(state, group, state.samples.point(n), leave, who_.beside[s], way, who_.samples.bone[n],
                                  {Squeeze::car, s, static_cast<std::int64_t>(g), 0.0});
          }
          gap.until = std::min(gap.until, until);
        }
      }
    }
  }

  /// What of clearance from a group every point of a ball has at least; at most 0 where that is not known.
  static double beyond(const PlacedGrid& group, const Ball& ball) {
    Vec3 gradient;
    const double* m = group.group_from_vehicle.data();
    double outside = 0.0;
    for (int i = 0; i < 3; ++i) {
      const double* row = m + 4 * i;
      const double at = row[0] * ball.centre.x + row[1] * ball.centre.y + row[2] * ball.centre.z + row[3] - group.field.origin[i];
      const double end = static_cast<double>(group.field.values.size(static_cast<std::size_t>(i)) - 1) * group.field.step;
      outside = std::max({outside, -at, at - end});
    }
    if (outside > 0.0 && group.field.outside_m <= 0.0) return 0.0;
    if (outside > ball.radius) return outside - ball.radius;
    return clearance_at(group.field, group.group_from_vehicle, ball.centre, 0.1, gradient) - ball.radius - group.field.step;
  }

  /// How much clearance a point has more than it needs; where it is less than 0 the point is pushed out.
  double press(State& state, const PlacedGrid& group, Vec3 p, double leave, double beside, Vec3 only, int bone,
               Squeeze what) const {
    Vec3 gradient;
    const double clear = clearance_at(group.field, group.group_from_vehicle, p, beside - leave, gradient);
    const double depth = -leave - clear + (gradient.z < upwards * norm(gradient) ? beside : 0.0);
    if (depth <= 0.0) return -depth;
    if (group.walls) {
      // Past the middle of a thin wall, roof or floor the nearest way out leads away from the person.
      const double aside = who_.middle - p.y, over = p.z - state.root.position.z, steep = sideways * norm(gradient);
      if (std::fabs(aside) > beside_m && gradient.y * aside < -steep * std::fabs(aside))
        only = {0.0, aside > 0.0 ? 1.0 : -1.0, 0.0};
      if (over > roof_m && gradient.z > steep) only = {0.0, 0.0, -1.0};
      if (over < -floor_m && gradient.z < -steep) only = {0.0, 0.0, 1.0};
    }
    const double slope = norm(gradient);
    if (dot(only, only) > 0.0 && ((slope < flat && depth > deep_m) || dot(gradient, only) < 0.0)) {  // past the middle
      state.touches.push_back({p, only, depth + past_m, bone, -1, what});
      return -depth;
    }
    if (slope > flat) state.touches.push_back({p, (1.0 / slope) * gradient, depth, bone, -1, what});
    return -depth;
  }

  void touch_foam(State& state) const {
    for (std::size_t g = 0; g < car_.size(); ++g) {
      const PlacedGrid& group = car_[g];
      if (group.give <= 0.0) continue;
      for (Index a = 0; a < pairs_.axes.size(); ++a) {
        const std::int64_t solid = pairs_.axes(a, 0);
        if (beyond(group, state.samples.ball(solid)) > group.give) continue;
        const Vec3 from = joint(who_, state, pairs_.axes(a, 1)), to = joint(who_, state, pairs_.axes(a, 2));
        const int pieces = 1 + static_cast<int>(norm(to - from) / axis_step_m);
        for (int k = 1; k <= pieces; ++k) {
          const double share = pairs_.axis_from[a] + (1.0 - pairs_.axis_from[a]) * k / pieces;
          const Vec3 p = from + share * (to - from);
          press(state, group, p, -group.give, 0.0, {}, static_cast<int>(who_.rest.joint_bone[pairs_.axes(a, 1)]),
                {Squeeze::car, solid, static_cast<std::int64_t>(g), 0.0});
        }
      }
    }
  }

  void touch_self(State& state) {
    self_gaps_.resize(static_cast<std::size_t>(pairs_.pairs.size()));
    for (Index k = 0; k < pairs_.pairs.size(); ++k) {
      const Index a = pairs_.pairs(k, 0), b = pairs_.pairs(k, 1);
      const Ball &one = state.samples.ball(a), &two = state.samples.ball(b);
      Gap& gap = self_gaps_[static_cast<std::size_t>(k)];
      const double moved = moved_[a] + moved_[b];
      if (gap.until > moved) continue;
      gap.until = moved + norm(one.centre - two.centre) - one.radius - two.radius;
      if (gap.until > moved) continue;
      double zone = 0.0;  // about a joint whose limits answer for what is in it
      Vec3 centre;
      if (pairs_.joint_ends(k, 0) >= 0) {
        centre = joint(who_, state, pairs_.joint_ends(k, 0));
        zone = pairs_.zones[k] * norm(joint(who_, state, pairs_.joint_ends(k, 1)) - centre);
      }
      const Vec3 outwards = static_cast<double>(pairs_.side[k]) * state.root.rotation.column(1);
      auto left_out = [&](Vec3 p) { return zone > 0.0 && norm(p - centre) < zone; };
      meet(state.samples, a, state.samples, who_.samples, b, pairs_.allowed[k], moved, gap, left_out,
           [&](Touch touch, Index into) {
             if (dot(touch.way, outwards) < -across) {  // through the other limb
               touch.way = outwards;
               touch.depth += past_m;
             }
             touch.against = who_.samples.bone[into];
             touch.what = {Squeeze::self, a, b, 0.0};
             state.touches.push_back(touch);
           });
    }
  }

  /// Looks at the samples of solid `a` that may be in solid `b` of somebody by now, and tells `push` of those that are.
  ///
  /// left_out: which points are not looked at, as long as they are there.
  template <class LeftOut, class Push>
  void meet(const Samples& mine, Index a, const Samples& theirs, const SampleArrays& arrays, Index b, double allowed,
            double moved, Gap& gap, const LeftOut& left_out, const Push& push) const {
    const Index first = who_.samples.rows(a, 0);
    gap.of_own.resize(static_cast<std::size_t>(who_.samples.rows(a, 1) - first));
    auto look = [&](Index n) {  // how far the sample is away at least, with the reserve of `near_m`
      const Vec3 p = mine.point(n);
      if (left_out(p)) return 0.0;
      Near& near = gap.of_own[static_cast<std::size_t>(n - first)];
      if (near.until > moved) return near.until - moved;
      if (near.until_other <= moved) {
        const Nearest found = theirs.nearest(p, arrays, b, near_m);
        if (found.sample < 0) {
          near.until = moved + found.away - near_m;
          return found.away - near_m;
        }
        near.nearest = found.sample;
        near.until_other = moved + found.margin;
      }
      const Vec3 way = theirs.normal(near.nearest);
      const double depth = dot(way, theirs.point(near.nearest) - p) - allowed;
      if (depth > 0.0) {
        push(Touch{p, way, depth, who_.samples.bone[n], -1, {}}, near.nearest);
        return 0.0;
      }
      near.until = moved - trusted * depth;
      return -trusted * depth;
    };
    double least = std::numeric_limits<double>::infinity();
    for (Index head = first; head < who_.samples.first_end(a); ++head) {
      const double away = look(head), reach = who_.samples.reach[head];
      least = std::min(least, std::max(away - reach, 0.0));
      if (away > reach) continue;
      for (Index n = who_.samples.around(head, 0); n < who_.samples.around(head, 1); ++n) least = std::min(least, look(n));
    }
    gap.until = moved + least;
  }

  void touch_other(State& state, const Search& other, std::size_t number) {
    const auto &rows = who_.samples.rows, &theirs = other.who_.samples.rows;
    const double aside = who_.middle - other.who_.middle;
    other_gaps_.resize(std::max(other_gaps_.size(), number + 1));
    std::vector<Gap>& gaps = other_gaps_[number];
    gaps.resize(static_cast<std::size_t>(rows.size() * theirs.size()));
    for (Index a = 0; a < rows.size(); ++a) {
      for (Index b = 0; b < theirs.size(); ++b) {
        const Ball &one = state.samples.ball(a), &two = other.now_.samples.ball(b);
        Gap& gap = gaps[static_cast<std::size_t>(a * theirs.size() + b)];
        const double moved = moved_[a] + other.moved_[b];
        if (gap.until > moved) continue;
        gap.until = moved + norm(one.centre - two.centre) - one.radius - two.radius;
        if (gap.until > moved) continue;
        auto nothing_left_out = [](Vec3) { return false; };
        meet(state.samples, a, other.now_.samples, other.who_.samples, b, between_, moved, gap, nothing_left_out,
             [&](Touch touch, Index) {
               if (touch.depth > two.radius) return;
               if (std::fabs(aside) > beside_m && touch.way.y * aside < -across * std::fabs(aside)) {  // through the other's limb
                 touch.way = {0.0, aside > 0.0 ? 1.0 : -1.0, 0.0};
                 touch.depth += past_m;
               }
               touch.what = {Squeeze::person, a, b, 0.0};
               state.touches.push_back(touch);
             });
      }
    }
  }

  /// The normal equations about the present posture.
  void linearise() {
    motion_.set(now_.q, who_.rest, now_.skeleton);
    std::fill_n(&square_[0][0], n_unknown * n_unknown, 0.0);
    std::fill_n(slope_, n_unknown, 0.0);
    const GoalArrays& g = who_.goals;
    double row[n_unknown], error[6];
    for (int k = 0; k < n_dofs; ++k) {
      const double w = g.stiffness[k] * g.stiffness[k];
      square_[n_root + k][n_root + k] += w;
      slope_[n_root + k] += w * (now_.q[k] - g.posture[k]);
    }
    const BoneFrame root = frame(g.root.data());
    root_error(now_, error);
    for (int i = 0; i < 6; ++i) {
      const double w = g.root_weight[i];
      if (w == 0.0) continue;
      std::fill_n(row, n_unknown, 0.0);
      const Vec3 axis = root.rotation.column(i % 3);
      for (int k = 0; k < 3; ++k) row[(i < 3 ? 0 : 3) + k] = w * axis[k];
      add(row, w * error[i]);
    }
    for (Index t = 0; t < g.bone.size(); ++t) {
      const int bone = g.bone[t], base = g.base[t];
      const Vec3 at = (now_.skeleton.at[bone] * frame(&g.tool(t, 0, 0))).position;
      const BoneFrame to = target(now_, t);
      task(now_, t, error);
      for (int i = 0; i < 6; ++i) {
        const double w = g.weight(t, i);
        if (w == 0.0) continue;
        std::fill_n(row, n_unknown, 0.0);
        const Vec3 axis = to.rotation.column(i % 3);
        if (i < 3) {
          motion_.add_point(row, bone, at, axis, w);
          if (base >= 0) motion_.add_point(row, base, at, axis, -w);
        } else {
          motion_.add_turn(row, bone, axis, w);
          if (base >= 0) motion_.add_turn(row, base, axis, -w);
        }
        add(row, w * error[i]);
      }
    }
    for (const Touch& t : now_.touches) {
      std::fill_n(row, n_unknown, 0.0);
      motion_.add_point(row, t.bone, t.point, t.way, -pressed_);
      if (t.against >= 0) motion_.add_point(row, t.against, t.point, t.way, pressed_);
      add(row, pressed_ * t.depth);
    }
  }

  void add(const double* row, double error) {
    int used[n_unknown], count = 0;
    for (int i = 0; i < n_unknown; ++i) {
      if (row[i] != 0.0) used[count++] = i;
    }
    for (int a = 0; a < count; ++a) {
      const int i = used[a];
      slope_[i] += row[i] * error;
      for (int b = 0; b <= a; ++b) square_[i][used[b]] += row[i] * row[used[b]];
    }
  }

  /// A damped step by Cholesky's factors; an axis at its limit that is pushed outwards is held.
  void solve(double* change) const {
    bool held[n_unknown] = {};
    for (int k = 0; k < n_dofs; ++k) {
      const double q = now_.q[k], down = slope_[n_root + k];
      const bool low = q <= who_.goals.lower[k] && down > 0.0, high = q >= who_.goals.upper[k] && down < 0.0;
      held[n_root + k] = low || high || k == dof(grip, 0) || k == dof(grip, 1);
    }
    // The upper factor, row by row downwards, and forward substitution with it: inner loops run along rows.
    double factor[n_unknown][n_unknown];
    for (int i = 0; i < n_unknown; ++i) {
      change[i] = held[i] ? 0.0 : -slope_[i];
      for (int j = i; j < n_unknown; ++j) factor[i][j] = held[i] || held[j] ? 0.0 : square_[j][i];
      factor[i][i] = held[i] ? 1.0 : factor[i][i] * (1.0 + damping_) + 1e-9;
    }
    for (int k = 0; k < n_unknown; ++k) {
      const double root = std::sqrt(std::max(factor[k][k], 1e-12));
      for (int j = k; j < n_unknown; ++j) factor[k][j] /= root;
      change[k] /= root;
      for (int i = k + 1; i < n_unknown; ++i) {
        const double share = factor[k][i];
        if (share == 0.0) continue;
        for (int j = i; j < n_unknown; ++j) factor[i][j] -= share * factor[k][j];
        change[i] -= share * change[k];
      }
    }
    for (int i = n_unknown - 1; i >= 0; --i) {
      double sum = change[i];
      for (int k = i + 1; k < n_unknown; ++k) sum -= factor[i][k] * change[k];
      change[i] = sum / factor[i][i];
    }
  }

  void advance(double* change) {
    double longest = 0.0;
    for (int i = 0; i < n_unknown; ++i)
      longest = std::max(longest, (i < 3 ? 10.0 : i < n_root ? 2.0 : 1.0) * std::fabs(change[i]));
    if (longest > limit_) {
      for (int i = 0; i < n_unknown; ++i) change[i] *= limit_ / longest;
    }
    for (int k = 0; k < n_dofs; ++k) {
      const double q = std::min(std::max(now_.q[k] + change[n_root + k], who_.goals.lower[k]), who_.goals.upper[k]);
      change[n_root + k] = q - now_.q[k];
      trial_.q[k] = q;
    }
    trial_.root.rotation = turned(vec3(change + 3)) * now_.root.rotation;
    trial_.root.position = now_.root.position + vec3(change);
  }

  const Mover& who_;
  const std::vector<PlacedGrid>& car_;
  const PairArrays& pairs_;
  double between_;
  State now_, trial_;
  Motion motion_;
  std::vector<Vec3> last_;         // the samples where they were looked at last
  double moved_[max_solids] = {};  // by solid, m
  std::vector<Gap> self_gaps_, car_gaps_;
  std::vector<std::vector<Gap>> other_gaps_;
  double square_[n_unknown][n_unknown], slope_[n_unknown], damping_ = 0.0, pressed_ = 0.0, limit_ = 1.0;
  int hardly_ = 0, uphill_ = 0, phase_ = 0;
  bool done_ = false;
};

}  // namespace

std::vector<Squeeze> solve_people(const std::vector<Mover>& people, const std::vector<PlacedGrid>& car, const PairArrays& pairs,
                                  double between, bool free, const std::vector<Array<double, any, 2>>& missed) {
  if (missed.size() != people.size()) throw std::invalid_argument("what is missed: one array for each person");
  for (std::size_t k = 0; k < people.size(); ++k) {
    const bool fit = people[k].samples.rows.size() <= max_solids && missed[k].size() == people[k].goals.bone.size();
    if (!fit) throw std::invalid_argument("a person has too many solids, or what is missed another number of tasks");
  }
  std::vector<std::unique_ptr<Search>> searches;
  for (const Mover& who : people) searches.push_back(std::make_unique<Search>(who, car, pairs, between));
  for (int phase = 0; phase < (free ? 1 : phases); ++phase) {
    for (auto& search : searches) search->begin(phase);
    for (int round = 0; round < steps[phase]; ++round) {
      bool moved = false;
      for (auto& search : searches) {
        if (search->done()) continue;
        search->step(searches);
        moved = true;
      }
      if (!moved) break;
    }
  }
  std::vector<Squeeze> left;
  for (std::size_t k = 0; k < searches.size(); ++k) left.push_back(searches[k]->finish(searches, missed[k]));
  return left;
}

}  // namespace cabinpose

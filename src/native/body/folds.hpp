// Folds of cloth at rest: trains of waves that come and go, see `scene.body.folds`.
#pragma once

#include "body/cloth.hpp"
#include "core/array.hpp"
#include "core/fields.hpp"

namespace cabinpose {

/// Trains of waves on N vertices: phase (T, N) rad and strength (T, N), 0 .. 1, of each; length (T,), by which a person's phases
/// are multiplied, and start (T,) rad.
struct Trains {
  Array<const double, any, any> phase;
  Array<const double, any, any> strength;
  Array<const double, any> length;
  Array<const double, any> start;

  CABINPOSE_FIELDS(Trains, phase, strength, length, start)
};

/// Band-limited noise, about -1 .. 1: F fields of sums of K plane waves (F, K, 3) rad/m with phases (F, K) rad, into `out`
/// (V + N, F).
///
/// It is worked out at the `where` of the points (V, 3) m, 0 elsewhere, and linear between, as the N new vertices are blended.
void fill_noise(Array<const double, any, 3> points, Array<const std::int64_t, any> where, Array<const double, any, any, 3> waves,
                Array<const double, any, any> phases, const Blend& blend, Array<double, any, any> out);

/// Height of the folds, 0 .. 0.8 about 0.4, at the vertices `where` (M,), into `out` (M,).
///
/// noise: (N, 3 + T): three fields that bend the trains, then one for each that lets it come and go.
void raise_folds(const Trains& trains, Array<const double, any, any> noise, Array<const std::int64_t, any> where,
                 Array<double, any> out);

}  // namespace cabinpose

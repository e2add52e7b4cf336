// An order of points in which neighbours in space are neighbours in memory.
#pragma once

#include <cstdint>

#include "core/array.hpp"

namespace cabinpose {

/// The numbers of points (N, 3), N known from `order` (N,), so that every run of `run` is close together: halves along the widest
/// axis, again and again.
void by_place(Array<const double, any, 3> points, Index run, Array<std::int64_t, any> order);

}  // namespace cabinpose

// Generalised distance transforms for deformable parts, see `estimate.dpm`.
#pragma once

#include "core/array.hpp"

namespace cabinpose {

/// The best of K maps of scores (K, H, W) under springs, Felzenszwalb and Huttenlocher (2012), in time that is linear in H W.
///
/// A spring (a_x, m_x, a_y, m_y) of (K, 4), a > 0, lets the value of a point (x, y) be the greatest over all (x', y') of
/// score(y', x') − a_x (x' − x − m_x)² − a_y (y' − y − m_y)²: `best` (K, H, W), and where it is, y' W + x': `source` (K, H, W).
/// Scores are finite.
void spring_transform(Array<const float, any, any, any> score, Array<const double, any, 4> spring,
                      Array<float, any, any, any> best, Array<std::int32_t, any, any, any> source);

}  // namespace cabinpose

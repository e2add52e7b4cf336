// The corners of a checkerboard in an amplitude image, refined by a model of what a camera sees of one.
#pragma once

#include "core/array.hpp"

namespace cabinpose {

/// The corners' places in an image (H, W) by least squares on the amplitudes around each; returns the blur (px) that they share,
/// NaN where a corner has too few pixels around it.
///
/// Model: a(u, v) = m + c * E(d1) * E(d2), m and c linear in (u, v), d1 and d2 the distances from two lines through the corner,
/// E(d) a step blurred by sigma and by the pixel. Levenberg-Marquardt on all corners at once, (du, dv, two angles, m, c) each,
/// sigma in common.
///
/// start: (N, 2) px · along, down: (N, 2) px from a corner to the next of its row, of its column · offset: (N, 2) px, found ·
/// levels: (N, 6) m and c, each with its slopes along u and v, found, in units of the brightness around a corner.
double fit_corners(Array<const double, any, any> image, Array<const double, any, 2> start, Array<const double, any, 2> along,
                   Array<const double, any, 2> down, Array<double, any, 2> offset, Array<double, any, 6> levels);

}  // namespace cabinpose

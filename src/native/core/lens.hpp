// OpenCV's radial-tangential lens distortion (calib3d), five coefficients k1, k2, p1, p2, k3.
#pragma once

#include "core/array.hpp"

namespace cabinpose {

/// Distorted normalised coordinates (N, 2) to ideal ones, by Newton's method; NaN where no ideal point is found, beyond the
/// radius up to which the model is monotonic. steps: at most so many.
void undistort(Array<const double, any, 2> distorted, Array<const double, 5> dist, int steps, Array<double, any, 2> ideal);

}  // namespace cabinpose

// The standard normal distribution, the same bits everywhere.
#pragma once

namespace cabinpose {

/// Probability of values below x; relative errors below 1e-13, in the lower tail too.
double normal_cdf(double x);

/// The value below which a share p, 0 .. 1, of the distribution lies; infinite at 0 and 1 (Wichura 1988, algorithm AS 241).
double normal_quantile(double p);

}  // namespace cabinpose

#include "core/normal.hpp"

#include <cmath>
#include <limits>

#include "core/math.hpp"
#include "core/vector_math.hpp"

namespace cabinpose {
namespace {

/// A polynomial by its coefficients, that of the highest power first.
template <int n>
double polynomial(const double (&coefficients)[n], double x) {
  double value = coefficients[0];
  for (int k = 1; k < n; ++k) value = value * x + coefficients[k];
  return value;
}

}  // namespace

double normal_cdf(double x) {
  if (std::isnan(x)) return x;
  const double a = std::fabs(x);
  double scaled = 0.0;  // the tail beyond a over exp(-a^2 / 2)
  if (a < 8.0) {
    scaled = 0.5 * loops::erfc_scaled(a / std::sqrt(2.0));
  } else {  // Laplace's continued fraction
    double fraction = a;
    for (int k = 20; k > 0; --k) fraction = a + k / fraction;
    scaled = 1.0 / (fraction * std::sqrt(2.0 * pi));
  }
  const double tail = exp(-0.5 * a * a) * scaled;
  return x < 0.0 ? tail : 1.0 - tail;
}

double normal_quantile(double p) {
  const double q = p - 0.5;
  if (std::fabs(q) <= 0.425) {
    const double r = 0.180625 - q * q;
    return q *
           polynomial({2509.0809287301226727, 33430.575583588128105, 67265.770927008700853, 45921.953931549871457,
                       13731.693765509461125, 1971.5909503065514427, 133.14166789178437745, 3.387132872796366608},
                      r) /
           polynomial({5226.495278852854561, 28729.085735721942674, 39307.89580009271061, 21213.794301586595867,
                       5394.1960214247511077, 687.1870074920579083, 42.313330701600911252, 1.0},
                      r);
  }
  const double near = q < 0.0 ? p : 1.0 - p;
  if (!(near > 0.0)) {
    const double far = near == 0.0 ? std::numeric_limits<double>::infinity() : std::numeric_limits<double>::quiet_NaN();
    return q < 0.0 ? -far : far;
  }
  const double r = std::sqrt(-log(near));
  double value = 0.0;
  if (r <= 5.0) {
    value = polynomial({7.7454501427834140764e-4, 0.0227238449892691845833, 0.24178072517745061177, 1.27045825245236838258,
                        3.64784832476320460504, 5.7694972214606914055, 4.6303378461565452959, 1.42343711074968357734},
                       r - 1.6) /
            polynomial({1.05075007164441684324e-9, 5.475938084995344946e-4, 0.0151986665636164571966, 0.14810397642748007459,
                        0.68976733498510000455, 1.6763848301838038494, 2.05319162663775882187, 1.0},
                       r - 1.6);
  } else {
    value = polynomial({2.01033439929228813265e-7, 2.71155556874348757815e-5, 0.0012426609473880784386, 0.026532189526576123093,
                        0.29656057182850489123, 1.7848265399172913358, 5.4637849111641143699, 6.6579046435011037772},
                       r - 5.0) /
            polynomial({2.04426310338993978564e-15, 1.4215117583164458887e-7, 1.8463183175100546818e-5, 7.868691311456132591e-4,
                        0.0148753612908506148525, 0.13692988092273580531, 0.59983220655588793769, 1.0},
                       r - 5.0);
  }
  return q < 0.0 ? -value : value;
}

}  // namespace cabinpose

#include "core/bind.hpp"
#include "core/lens.hpp"
#include "core/math.hpp"
#include "core/normal.hpp"
#include "core/vector_math.hpp"

namespace cabinpose {
namespace {

using Values = Array<const double, any>;
using Results = Array<double, any>;

/// One of the elementary functions at every value.
template <double (*function)(double)>
void at_each(Values x, Results out) {
  for (Index i = 0; i < x.size(); ++i) out[i] = function(x[i]);
}

}  // namespace

void bind_core(nb::module_& m) {
  m.def("undistort", &undistort, "distorted"_a, "dist"_a, "steps"_a, "ideal"_a, unlocked(),
        "Distorted normalised coordinates to ideal ones.");
  m.def("sin", &at_each<sin>, "x"_a, "out"_a, "Sine, the same bits everywhere.");
  m.def("cos", &at_each<cos>, "x"_a, "out"_a, "Cosine, the same bits everywhere.");
  m.def("exp", &at_each<exp>, "x"_a, "out"_a, "Exponential, the same bits everywhere.");
  m.def("log", &at_each<log>, "x"_a, "out"_a, "Natural logarithm, the same bits everywhere.");
  m.def("tanh", &at_each<tanh>, "x"_a, "out"_a, "Hyperbolic tangent, the same bits everywhere.");
  m.def("acos", &at_each<acos>, "x"_a, "out"_a, "Arc cosine, the same bits everywhere.");
  m.def("asin", &at_each<asin>, "x"_a, "out"_a, "Arc sine, the same bits everywhere.");
  m.def("sin_in_loops", &at_each<loops::sin>, "x"_a, "out"_a, "Sine without branches, the same bits.");
  m.def("exp_in_loops", &at_each<loops::exp>, "x"_a, "out"_a, "Exponential without branches, the same bits.");
  m.def("erfc_scaled", &at_each<loops::erfc_scaled>, "x"_a, "out"_a, "exp(x^2) erfc(x) for 0 <= x <= 6.");
  m.def(
      "atan2",
      [](Values y, Values x, Results out) {
        for (Index i = 0; i < x.size(); ++i) out[i] = atan2(y[i], x[i]);
      },
      "y"_a, "x"_a, "out"_a, "Angle of a point, the same bits everywhere.");
  m.def("normal_cdf", &at_each<normal_cdf>, "x"_a, "out"_a, "Probability of values below x, standard normal.");
  m.def("normal_quantile", &at_each<normal_quantile>, "p"_a, "out"_a, "Inverse of normal_cdf.");
}

}  // namespace cabinpose

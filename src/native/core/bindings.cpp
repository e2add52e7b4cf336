#include "core/bind.hpp"
#include "core/lens.hpp"
#include "core/math.hpp"
#include "core/normal.hpp"
#include "core/product.hpp"
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

template <class T>
using Any = nb::ndarray<const T, nb::numpy, nb::device::cpu>;  // of any shape and strides

/// numpy's matmul of arrays that have the same axes but their last two, or of which one has no more than those.
template <class T>
nb::ndarray<nb::numpy, T> matmul(Any<T> a, Any<T> b) {
  const std::size_t da = a.ndim(), db = b.ndim();
  if (da == 0 || db == 0) throw nb::value_error("a product needs arrays, not numbers");
  const auto extent = [](const Any<T>& x, std::size_t k) { return static_cast<Index>(x.shape(k)); };
  const auto stride = [](const Any<T>& x, std::size_t k) { return static_cast<Index>(x.stride(k)); };
  Strided<T> left{a.data(), da > 1 ? extent(a, da - 2) : 1, extent(a, da - 1), da > 1 ? stride(a, da - 2) : 0, stride(a, da - 1)};
  Strided<T> right{b.data(), extent(b, db > 1 ? db - 2 : 0), db > 1 ? extent(b, db - 1) : 1, stride(b, db > 1 ? db - 2 : 0),
                   db > 1 ? stride(b, db - 1) : 1};
  const std::size_t more_a = da > 2 ? da - 2 : 0, more_b = db > 2 ? db - 2 : 0, more = std::max(more_a, more_b);
  bool fits = left.columns == right.rows && (more_a == more_b || more_a == 0 || more_b == 0);
  for (std::size_t k = 0; fits && more_a == more_b && k < more; ++k) fits = a.shape(k) == b.shape(k);
  if (!fits) throw nb::value_error("the shapes of a product do not fit");
  std::vector<std::size_t> shape;
  Index count = 1;
  for (std::size_t k = 0; k < more; ++k) {
    shape.push_back(more_a > 0 ? a.shape(k) : b.shape(k));
    count *= static_cast<Index>(shape.back());
  }
  if (da > 1) shape.push_back(a.shape(da - 2));
  if (db > 1) shape.push_back(b.shape(db - 1));
  const Index size = left.rows * right.columns;
  T* out = new T[static_cast<std::size_t>(std::max<Index>(1, count * size))];
  const nb::capsule owner(out, [](void* p) noexcept { delete[] static_cast<T*>(p); });
  std::vector<Index> at(more, 0);
  for (Index n = 0; n < count; ++n) {
    multiply(left, right, out + n * size);
    for (std::size_t k = more; k-- > 0;) {  // to the next of the stack
      const Index step_a = more_a > 0 ? stride(a, k) : 0, step_b = more_b > 0 ? stride(b, k) : 0;
      left.data += step_a;
      right.data += step_b;
      if (++at[k] < static_cast<Index>(shape[k])) break;
      left.data -= step_a * at[k];
      right.data -= step_b * at[k];
      at[k] = 0;
    }
  }
  return {out, shape.size(), shape.data(), owner};
}

}  // namespace

void bind_core(nb::module_& m) {
  m.def("undistort", &undistort, "distorted"_a, "dist"_a, "steps"_a, "ideal"_a, unlocked(),
        "Distorted normalised coordinates to ideal ones.");
  m.def("matmul", &matmul<double>, nb::kw_only(), "a"_a.noconvert(), "b"_a.noconvert(),
        "numpy's matmul, the same bits everywhere.");
  m.def("matmul_float32", &matmul<float>, nb::kw_only(), "a"_a.noconvert(), "b"_a.noconvert(), "The same of float32.");
  m.def("sin", &at_each<sin>, "x"_a, "out"_a, "Sine, the same bits everywhere.");
  m.def("sin", &sin, "x"_a);
  m.def("cos", &at_each<cos>, "x"_a, "out"_a, "Cosine, the same bits everywhere.");
  m.def("cos", &cos, "x"_a);
  m.def("exp", &at_each<exp>, "x"_a, "out"_a, "Exponential, the same bits everywhere.");
  m.def("exp", &exp, "x"_a);
  m.def("log", &at_each<log>, "x"_a, "out"_a, "Natural logarithm, the same bits everywhere.");
  m.def("log", &log, "x"_a);
  m.def("tanh", &at_each<tanh>, "x"_a, "out"_a, "Hyperbolic tangent, the same bits everywhere.");
  m.def("tanh", &tanh, "x"_a);
  m.def("acos", &at_each<acos>, "x"_a, "out"_a, "Arc cosine, the same bits everywhere.");
  m.def("acos", &acos, "x"_a);
  m.def("asin", &at_each<asin>, "x"_a, "out"_a, "Arc sine, the same bits everywhere.");
  m.def("asin", &asin, "x"_a);
  m.def("sin_in_loops", &at_each<loops::sin>, "x"_a, "out"_a, "Sine without branches, the same bits.");
  m.def("exp_in_loops", &at_each<loops::exp>, "x"_a, "out"_a, "Exponential without branches, the same bits.");
  m.def("erfc_scaled", &at_each<loops::erfc_scaled>, "x"_a, "out"_a, "exp(x^2) erfc(x) for 0 <= x <= 6.");
  m.def("atan2", &atan2, "y"_a, "x"_a);
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

// Elementary functions whose results are the same bits on every processor and with every compiler and C library.
//
// glibc's differ between processors with and without FMA, and libraries differ from each other. These use only + - * / and
// sqrt, which IEEE 754 defines to the bit, so they hold wherever contraction is off. Errors are about one unit in the last
// place; coefficients are interpolations at Chebyshev nodes, computed with 50 digits, with errors below 3e-16.
#pragma once

#include <bit>
#include <cmath>
#include <cstdint>
#include <limits>

namespace cabinpose {

inline constexpr double pi = 3.14159265358979323846;

namespace detail {

/// x - k pi / 2 and k, for the whole number k nearest to 2 x / pi; |x| < 1e6 (Cody and Waite 1980: pi / 2 in three parts).
struct Quadrant {
  double rest;
  std::int64_t number;
};

inline Quadrant quadrant(double x) {
  constexpr double round = 0x1.8p52;  // added and taken away, leaves a whole number
  const double k = (x * (2.0 / pi) + round) - round;
  const double rest = ((x - k * 0x1.921fb544p+0) - k * 0x1.0b4611a6p-34) - k * 0x1.3198a2e037073p-69;
  return {rest, static_cast<std::int64_t>(k)};
}

/// sin on |x| <= pi / 4.
inline double sin_near_zero(double x) {
  const double t = x * x;
  const double p = -2.5051131845003624e-08 + t * 1.5918129294866608e-10;
  const double s = 0.008333333333330948 + t * (-0.00019841269836758574 + t * (2.755731610255244e-06 + t * p));
  return x + x * t * (-0.16666666666666666 + t * s);
}

/// cos on |x| <= pi / 4.
inline double cos_near_zero(double x) {
  const double t = x * x;
  const double p = -2.7557317271729793e-07 + t * (2.08761462684032e-09 + t * -1.1382632425521717e-11);
  const double c = 0.041666666666666664 + t * (-0.0013888888888887398 + t * (2.480158729876569e-05 + t * p));
  const double half = 0.5 * t, one = 1.0 - half;
  return one + (((1.0 - one) - half) + t * t * c);
}

/// atan on |x| <= tan(pi / 8).
inline double atan_near_zero(double x) {
  const double t = x * x;
  const double p = 0.0585814891280221 + t * (-0.0508544973794026 + t * (0.03923165829558719 + t * -0.01917688711906226));
  const double q = -0.09090904578123903 + t * (0.07692183190826087 + t * (-0.06664511447381948 + t * p));
  const double a = 0.1999999999999552 + t * (-0.14285714284666542 + t * (0.11111111015256361 + t * q));
  return x + x * t * (-0.3333333333333333 + t * a);
}

/// exp(x) - 1 on |x| <= log(2) / 2.
inline double expm1_near_zero(double r) {
  const double p = 2.75572736431103e-07 + r * (2.5105217004720745e-08 + r * 2.0914686968086876e-09);
  const double q = 0.00019841269874820627 + r * (2.4801587325547743e-05 + r * (2.7557255400206422e-06 + r * p));
  const double e =
      0.1666666666666667 + r * (0.04166666666666667 + r * (0.008333333333326136 + r * (0.0013888888888883748 + r * q)));
  return r + r * r * (0.5 + r * e);
}

}  // namespace detail

/// Sine of x (rad), |x| < 1e6.
inline double sin(double x) {
  const detail::Quadrant q = detail::quadrant(x);
  const double s = q.number & 1 ? detail::cos_near_zero(q.rest) : detail::sin_near_zero(q.rest);
  return q.number & 2 ? -s : s;
}

/// Cosine of x (rad), |x| < 1e6.
inline double cos(double x) {
  const detail::Quadrant q = detail::quadrant(x);
  const double c = q.number & 1 ? detail::sin_near_zero(q.rest) : detail::cos_near_zero(q.rest);
  return (q.number + 1) & 2 ? -c : c;
}

/// Angle (rad) of the point (x, y), -pi .. pi; 0 or pi with the sign of y where y is zero.
inline double atan2(double y, double x) {
  const double ax = std::fabs(x), ay = std::fabs(y);
  const double low = ax < ay ? ax : ay, high = ax < ay ? ay : ax;
  double angle = 0.0;
  if (high > 0.0) {
    const double q = low / high;
    // atan(q) = pi / 4 + atan((q - 1) / (q + 1)): keeps the argument below tan(pi / 8).
    angle = q > 0.41421356237309503 ? pi / 4 + detail::atan_near_zero((low - high) / (low + high)) : detail::atan_near_zero(q);
  }
  if (ay > ax) angle = pi / 2 - angle;
  if (std::copysign(1.0, x) < 0.0) angle = pi - angle;  // loops with it can be vectorised, unlike with signbit
  return std::isnan(x) || std::isnan(y) ? x + y : std::copysign(angle, y);
}

inline double atan(double x) { return atan2(x, 1.0); }

inline double acos(double x) { return atan2(std::sqrt((1.0 - x) * (1.0 + x)), x); }

inline double asin(double x) { return atan2(x, std::sqrt((1.0 - x) * (1.0 + x))); }

/// e to the power of x; 0 below -708 and infinite above 709.
inline double exp(double x) {
  if (!(x > -708.0)) return std::isnan(x) ? x : 0.0;
  if (x > 709.0) return std::numeric_limits<double>::infinity();
  constexpr double round = 0x1.8p52;
  const double k = (x * 1.4426950408889634 + round) - round;
  const double r = (x - k * 0x1.62e42feep-1) - k * 0x1.a39ef35793c76p-33;
  const double value = 1.0 + detail::expm1_near_zero(r);
  return value * std::bit_cast<double>((static_cast<std::int64_t>(k) + 1023) << 52);
}

/// Natural logarithm of x > 0; -infinite at 0, NaN below.
inline double log(double x) {
  if (!(x > 0.0)) return x == 0.0 ? -std::numeric_limits<double>::infinity() : std::numeric_limits<double>::quiet_NaN();
  if (x == std::numeric_limits<double>::infinity()) return x;
  double scale = 0.0;
  if (x < std::numeric_limits<double>::min()) {
    x *= 0x1p54;
    scale = -54.0;
  }
  const std::uint64_t bits = std::bit_cast<std::uint64_t>(x);
  double k = static_cast<double>(static_cast<std::int64_t>(bits >> 52) - 1023) + scale;
  double m = std::bit_cast<double>((bits & 0xFFFFFFFFFFFFFu) | 0x3FF0000000000000u);
  if (m > 1.4142135623730951) {
    m *= 0.5;
    k += 1.0;
  }
  const double f = m - 1.0, s = f / (m + 1.0), t = s * s;
  const double p = 0.18182889455674947 + t * (0.15331710618210773 + t * 0.14616585424888623);
  const double l = 0.39999999999899444 + t * (0.2857142862600327 + t * (0.22222211130259878 + t * p));
  return k * 0x1.62e42feep-1 + (s * (2.0 + t * (0.666666666666667 + t * l)) + k * 0x1.a39ef35793c76p-33);
}

/// Hyperbolic tangent.
inline double tanh(double x) {
  const double a = std::fabs(x);
  const double less = a < 0.17 ? detail::expm1_near_zero(-2.0 * a) : exp(-2.0 * a) - 1.0;
  return std::copysign(-less / (2.0 + less), x);
}

}  // namespace cabinpose

// Elementary functions without branches, for loops that the compiler runs through several numbers at once.
//
// The results are those of `core/math.hpp`, to the bit; alone, those are faster. AVX2 has no conversion from double to 64-bit
// integers: a whole number is read from the last bits of what it was rounded with.
#pragma once

#include <bit>
#include <cstdint>
#include <limits>

#include "core/math.hpp"

namespace cabinpose::loops {

/// Where a mask has ones, the bits of `a`, elsewhere those of `b`.
inline double select(std::uint64_t mask, double a, double b) {
  return std::bit_cast<double>((std::bit_cast<std::uint64_t>(a) & mask) | (std::bit_cast<std::uint64_t>(b) & ~mask));
}

/// Sine of x (rad), |x| < 1e6.
inline double sin(double x) {
  const double shifted = x * (2.0 / pi) + 0x1.8p52, k = shifted - 0x1.8p52;
  const double rest = ((x - k * 0x1.921fb544p+0) - k * 0x1.0b4611a6p-34) - k * 0x1.3198a2e037073p-69;
  const std::uint64_t quadrant = std::bit_cast<std::uint64_t>(shifted);
  const double value = select(0 - (quadrant & 1), detail::cos_near_zero(rest), detail::sin_near_zero(rest));
  return std::bit_cast<double>(std::bit_cast<std::uint64_t>(value) ^ (quadrant & 2) << 62);
}

/// e to the power of x; 0 below -708 and infinite above 709.
inline double exp(double x) {
  const double shifted = x * 1.4426950408889634 + 0x1.8p52, k = shifted - 0x1.8p52;
  const double r = (x - k * 0x1.62e42feep-1) - k * 0x1.a39ef35793c76p-33;
  const double scale = std::bit_cast<double>((std::bit_cast<std::uint64_t>(shifted) + 1023) << 52);
  const double value = (1.0 + detail::expm1_near_zero(r)) * scale;
  const double below = x <= -708.0 ? 0.0 : value;
  return x > 709.0 ? std::numeric_limits<double>::infinity() : below;
}

/// exp(x^2) erfc(x) for 0 <= x <= 6, to four units in the last place (after Shepherd & Laframboise 1981).
inline double erfc_scaled(double x) {
  const double s = (2.0 * x - 3.0) / (x + 3.0);
  const double p15 = -3.434042619358101e-09 + s * (7.562454288496405e-10 + s * 2.5147678317102673e-10);
  const double p12 = 3.4526052940324975e-07 + s * (2.765631285105697e-08 + s * (-1.881179751720316e-08 + s * p15));
  const double p9 = 3.735762789291505e-06 + s * (-6.216318646414217e-06 + s * (-1.6840652427120672e-07 + s * p12));
  const double p6 = -0.0019191155859923149 + s * (-0.00027558771169872555 + s * (0.00011950141368617739 + s * p9));
  const double p3 = 0.11341004764039063 + s * (-0.054129044084755364 + s * (0.015381524493407506 + s * p6));
  const double p0 = 1.28634166581727 + s * (-0.025471885548611996 + s * (-0.12735942774303985 + s * p3));
  return p0 / (1.0 + 2.0 * x);
}

}  // namespace cabinpose::loops

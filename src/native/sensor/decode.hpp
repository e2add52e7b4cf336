// From light to what the camera delivers: samples of the correlation, phases, ranges. The second half of the continuous-wave
// principle, by rows; one float operation after the other, as in light.hpp.
#pragma once

#include "core/array.hpp"

namespace cabinpose {

/// The pixels of a sensor, electrons.
struct Taps {
  float contrast;       // of the demodulation
  float shot;           // 1, or 0 without shot noise
  float read_variance;  // of one tap difference
  float full_well;      // of one tap
};

/// Range from the phases (turns) of two frequencies in the ratio p : q.
struct Unwrapping {
  int p, q;          // coprime
  float wavelength;  // c / 2 f of the first frequency (m)
  float weight;      // of the first frequency
  float tolerance;   // of p t2 - q t1 from a whole number (turns)
};

/// What a pixel needs to be valid, and how its noise is judged.
struct Limits {
  float min_amplitude;  // electrons
  float near, far;      // m along the axis
  float sigma_scale;    // sigma of the range = sigma_scale x sqrt(variance of one sample) / amplitude (m)
};

/// Light in both taps of a sample of a row: signal, `stray` light and ambient light (electrons).
void light_of_pixels(const float* signal, float stray, const float* ambient, Index n, float* total);

/// Phase (turns, 0 <= t < 1) of a row, from noisy samples of the correlation.
///
/// C0 - C2 and C3 - C1 are drawn as one normal number each, with the variance of the four taps, two of each content:
/// E_A,B = (total +- K signal) / 2, clipped at the full well. A full tap has no shot noise left.
/// total, in_phase, quadrature: electrons; `stray` (2,) is added to the last two. ranks: of the normal numbers `quantiles`, those
/// of pixel u at 4 u and 4 u + 1.
/// Over frequencies, `amplitude` adds up the phasors' lengths times a weight, and `peak` is twice the most in any tap
/// (electrons).
void phases_of_row(const float* total, const float* in_phase, const float* quadrature, const float* stray, const Taps& taps,
                   const std::uint16_t* ranks, const float* quantiles, float weight, Index n, float* turns, float* amplitude,
                   float* peak);

/// Range (m) of a row from the phases of two frequencies in the ratio p : q, by the Chinese remainder theorem.
///
/// With range = (t1 + n1) w1 = (t2 + n2) w2: q n1 - p n2 = round(p t2 - q t1), which gives n1 modulo p and then n2.
/// The mean of both is weighted by the square of the frequency, the inverse of its variance. NaN where p t2 - q t1 is
/// farther than the tolerance from a whole number: no single surface has such phases.
void unwrap_row(const float* turns_1, const float* turns_2, const Unwrapping& unwrapping, Index n, float* range);

/// Adds the whole periods that bring each range of a row next to a known one, NaN where there is none.
void unwrap_perfectly(const float* known, float period, Index n, float* range);

/// Depth (m, NaN where invalid), amplitude (electrons), confidence and noise (see `Delivered`) of a row. `gain` is 0 outside the
/// field.
///
/// scratch: n floats.
void deliver_row(const float* range, const float* amplitude, const float* total, const float* peak, const float* gain,
                 const float* range_over_depth, const Taps& taps, const Limits& limits, Index n, float* scratch, float* depth_out,
                 std::uint16_t* amplitude_out, std::uint8_t* confidence_out, float* noise_out);

}  // namespace cabinpose

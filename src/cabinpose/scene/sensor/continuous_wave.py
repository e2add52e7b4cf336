"""Kernels of the continuous-wave principle: phasors of the geometry, samples of the correlation, decoding.

One float32 operation after the other and no fast-math, so that results are the same bytes on every machine.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from cabinpose.scene.sensor.buffers import CONFIDENCE_SIGMA_M

F32 = np.float32

# sin(2 pi a) / a in powers of a^2 for |a| <= 1/4, least squares on Chebyshev nodes: error below 1e-8.
_S1, _S3, _S5, _S7, _S9 = (F32(c) for c in (6.283185295, -41.341685009, 81.602766802, -76.587869912, 39.809924751))
# atan(q) / (2 pi q) in powers of q^2 for q <= 1, same fit: error below 1.6e-8 turns.
_A = tuple(
    F32(c)
    for c in (
        0.15915493643847153, -0.05305000759666022, 0.031789101207354314, -0.022345575062319295,
        0.015864443163189378, -0.00958417188834041, 0.003940164021947287, -0.0007689043297667616,
    )
)  # fmt: skip
_A0, _A1, _A2, _A3, _A4, _A5, _A6, _A7 = _A
# The triangle's first harmonic has 8 / pi^2 of its peak.
_TRIANGLE_PEAK = F32(np.pi**2 / 8)
_CONFIDENCE_SIGMA = F32(CONFIDENCE_SIGMA_M)


@njit(inline="always")
def _sine_of_quarter(a):  # type: ignore[no-untyped-def]
    """sin(2 pi a) for |a| <= 1/4."""
    b = a * a
    return a * (_S1 + b * (_S3 + b * (_S5 + b * (_S7 + b * _S9))))


@njit(inline="always")
def turns_of(y, x):  # type: ignore[no-untyped-def]
    """atan2(y, x) in turns, 0 <= t < 1."""
    ax, ay = abs(x), abs(y)
    big, small = max(ax, ay), min(ax, ay)
    if big == F32(0.0):
        return F32(0.0)
    q = small / big
    b = q * q
    t = q * (_A0 + b * (_A1 + b * (_A2 + b * (_A3 + b * (_A4 + b * (_A5 + b * (_A6 + b * _A7)))))))
    if ay > ax:
        t = F32(0.25) - t
    if x < F32(0.0):
        t = F32(0.5) - t
    if y < F32(0.0):
        t = F32(1.0) - t
        if t >= F32(1.0):
            t = F32(0.0)
    return t


@njit(cache=True, nogil=True)
def collect_phasors(
    depth: NDArray[np.float32],
    cos_incidence: NDArray[np.float32],
    material: NDArray[np.uint8],
    range_over_depth: NDArray[np.float32],
    supersample: int,
    mix: bool,
    lambert: bool,
    table: NDArray[np.float32],
    gloss_width: float,
    turns_per_m: NDArray[np.float32],
    triangle: float,
    energy: NDArray[np.float32],
    moment: NDArray[np.float32],
    ambient: NDArray[np.float32],
    phasor: NDArray[np.float32],
) -> None:
    """Averages energy and phasors of every pixel's samples.

    In: sub-pixel geometry (H * s, W * s), material `table` (256, 4), `turns_per_m` (F,) = 2 f / c, `triangle` 0..1 the
    share of a triangular correlation. Out, all (H, W), relative to a white surface facing the camera at 1 m: `energy`
    (mean of rho cos / r^2), `moment` (mean of energy x range), `ambient` (mean of its return), `phasor` (2 F, H, W): mean
    of energy x (cos, sin) of the phase. `mix` False takes one sample a pixel instead of the mean.
    """
    s = supersample
    height, width = energy.shape
    wide = width * s
    n_frequencies = turns_per_m.size
    row_energy = np.empty(wide, np.float32)
    row_range = np.empty(wide, np.float32)
    row_ambient = np.empty(wide, np.float32)
    row_cos = np.empty(wide, np.float32)
    row_sin = np.empty(wide, np.float32)
    first, last = (0, s) if mix else (s // 2, s // 2 + 1)
    scale = F32(1.0 / ((last - first) * (last - first)))
    inverse_width = F32(1.0 / gloss_width)
    share, keep = F32(triangle) * _TRIANGLE_PEAK, F32(1.0 - triangle)
    quarter, half, one, four, zero = F32(0.25), F32(0.5), F32(1.0), F32(4.0), F32(0.0)
    for v in range(height):
        for u in range(width):
            energy[v, u] = zero
            moment[v, u] = zero
            ambient[v, u] = zero
        for k in range(2 * n_frequencies):
            for u in range(width):
                phasor[k, v, u] = zero
        for i in range(first, last):
            y = v * s + i
            for x in range(wide):
                z = depth[y, x]
                m = material[y, x]
                r = z * range_over_depth[y, x] + table[m, 2]
                c = cos_incidence[y, x]
                gloss = max(zero, one - (one - c) * inverse_width)
                rho = table[m, 0] * (c if lambert else one) + table[m, 1] * gloss * gloss
                hit = z > zero
                row_range[x] = r if hit else zero
                row_energy[x] = rho / (r * r) if hit else zero
                row_ambient[x] = table[m, 3] if hit else table[0, 3]
            for u in range(width):
                for j in range(first, last):
                    x = u * s + j
                    energy[v, u] += row_energy[x] * scale
                    moment[v, u] += row_energy[x] * row_range[x] * scale
                    ambient[v, u] += row_ambient[x] * scale
            for k in range(n_frequencies):
                per_m = turns_per_m[k]
                for x in range(wide):
                    t = row_range[x] * per_m
                    t = t - np.floor(t + half)  # -1/2 .. 1/2
                    magnitude = abs(t)
                    fold = quarter - abs(magnitude - quarter)
                    sine = _sine_of_quarter(fold)
                    sine = -sine if t < zero else sine
                    cosine = _sine_of_quarter(quarter - magnitude)
                    if share > zero:
                        cosine = keep * cosine + share * (one - four * magnitude)
                        sine = keep * sine + share * (four * fold if t >= zero else -four * fold)
                    row_cos[x] = row_energy[x] * cosine
                    row_sin[x] = row_energy[x] * sine
                for u in range(width):
                    for j in range(first, last):
                        x = u * s + j
                        phasor[2 * k, v, u] += row_cos[x] * scale
                        phasor[2 * k + 1, v, u] += row_sin[x] * scale


@njit(cache=True, nogil=True)
def mean_light(
    energy: NDArray[np.float32],
    phasor: NDArray[np.float32],
    gain: NDArray[np.float32],
    field: NDArray[np.bool_],
    mean: NDArray[np.float64],
) -> None:
    """Mean over the image circle of the light (electrons) and its phasors: `mean` (1 + 2 F,)."""
    height, width = energy.shape
    mean[:] = 0.0
    count = 0
    for v in range(height):
        for u in range(width):
            if field[v, u]:
                g = gain[v, u]
                mean[0] += g * energy[v, u]
                for k in range(phasor.shape[0]):
                    mean[1 + k] += g * phasor[k, v, u]
                count += 1
    mean /= max(count, 1)


@njit(cache=True, nogil=True)
def decode(
    energy: NDArray[np.float32],
    moment: NDArray[np.float32],
    ambient: NDArray[np.float32],
    phasor: NDArray[np.float32],
    gain: NDArray[np.float32],
    ambient_gain: NDArray[np.float32],
    field: NDArray[np.bool_],
    range_over_depth: NDArray[np.float32],
    words: NDArray[np.uint64],
    quantiles: NDArray[np.float32],
    stray: NDArray[np.float32],
    frequencies: NDArray[np.float64],
    ratio: tuple[int, int],
    speed_of_light: float,
    contrast: float,
    shot: bool,
    read_noise: float,
    full_well: float,
    min_amplitude: float,
    near: float,
    far: float,
    wrapping: bool,
    depth_out: NDArray[np.float32],
    amplitude_out: NDArray[np.uint16],
    confidence_out: NDArray[np.uint8],
) -> None:
    """Four samples of the correlation per frequency, with noise and clipping, decoded to depth, amplitude, confidence.

    Taps of sample i: E_A,B = E / 2 (1 +- K cos(phase + i pi / 2)) + ambient / 2. Of the samples C_i = E_A - E_B only
    C0 - C2 and C3 - C1 are used; each is drawn as one normal number with the variance of its four taps, which is
    the same distribution. `gain` (H, W) turns relative energy into electrons; `stray` (1 + 2 F,) is light that
    reaches every pixel (electrons). Wells are clipped at their mean content.
    """
    height, width = energy.shape
    n_frequencies = frequencies.size
    p, q = ratio
    inverse_q = 1  # of q modulo p
    for candidate in range(p):
        if (candidate * q) % p == 1 % p:
            inverse_q = candidate
    wavelength_1 = F32(speed_of_light / (2.0 * frequencies[0]))
    wavelength_2 = F32(speed_of_light / (2.0 * frequencies[n_frequencies - 1]))
    squares = 0.0
    for k in range(n_frequencies):
        squares += frequencies[k] ** 2
    weight_1 = F32(frequencies[0] ** 2 / squares)
    period = wavelength_1 * F32(p)
    # sigma of the range = sigma_scale * sqrt(variance of one sample) / amplitude
    sigma_scale = F32(speed_of_light / (4.0 * np.pi * np.sqrt(2.0 * squares)))
    half, one, two, zero = F32(0.5), F32(1.0), F32(2.0), F32(0.0)
    k_contrast, well = F32(contrast), F32(full_well)
    read_variance = F32(read_noise * read_noise)
    shot_weight = one if shot else zero
    turns = np.zeros(2, np.float32)
    for v in range(height):
        for u in range(width):
            if not field[v, u]:
                depth_out[v, u] = np.nan
                amplitude_out[v, u] = 0
                confidence_out[v, u] = 0
                continue
            g = gain[v, u]
            light = g * energy[v, u] + stray[0]
            total = light + ambient_gain[v, u] * ambient[v, u]
            word = words[v, u]
            amplitude = zero
            clipped = False
            for k in range(n_frequencies):
                in_phase = k_contrast * (g * phasor[2 * k, v, u] + stray[1 + 2 * k])
                quadrature = k_contrast * (g * phasor[2 * k + 1, v, u] + stray[2 + 2 * k])
                a0, b0 = half * (total + in_phase), half * (total - in_phase)
                a3, b3 = half * (total + quadrature), half * (total - quadrature)
                variance_x, variance_y = shot_weight * total, shot_weight * total
                if max(a0, b0, a3, b3) >= well:
                    clipped = True
                    variance_x = shot_weight * ((a0 if a0 < well else zero) + (b0 if b0 < well else zero))
                    variance_y = shot_weight * ((a3 if a3 < well else zero) + (b3 if b3 < well else zero))
                    a0, b0, a3, b3 = min(a0, well), min(b0, well), min(a3, well), min(b3, well)
                noise_x = quantiles[word & np.uint64(0xFFFF)]
                noise_y = quantiles[(word >> np.uint64(16)) & np.uint64(0xFFFF)]
                word >>= np.uint64(32)
                x = two * (a0 - b0) + np.sqrt(two * (variance_x + read_variance)) * noise_x
                y = two * (a3 - b3) + np.sqrt(two * (variance_y + read_variance)) * noise_y
                turns[k] = turns_of(y, x)
                amplitude += half * np.sqrt(x * x + y * y)
            amplitude /= F32(n_frequencies)
            if n_frequencies == 1:
                r = turns[0] * wavelength_1
            else:
                # Whole turns n1, n2 from q n1 - p n2 = round(p t2 - q t1) modulo p (Chinese remainder).
                remainder = int(np.floor(F32(p) * turns[1] - F32(q) * turns[0] + half))
                n1 = (remainder * inverse_q) % p
                n2 = (q * n1 - remainder) // p
                r = weight_1 * (turns[0] + F32(n1)) * wavelength_1 + (one - weight_1) * (turns[1] + F32(n2)) * wavelength_2
            if not wrapping and energy[v, u] > zero:
                r += period * np.floor((moment[v, u] / energy[v, u] - r) / period + half)
            z = r / range_over_depth[v, u]
            amplitude_out[v, u] = np.uint16(min(amplitude, F32(65535.0)) + half) if amplitude < F32(65535.0) else np.uint16(65535)
            if clipped or amplitude < min_amplitude or amplitude == zero or z < near or z > far:
                depth_out[v, u] = np.nan
                confidence_out[v, u] = 0
                continue
            sigma = sigma_scale * np.sqrt(shot_weight * total + read_variance) / amplitude
            depth_out[v, u] = z
            confidence_out[v, u] = np.uint8(F32(255.0) * _CONFIDENCE_SIGMA / (_CONFIDENCE_SIGMA + sigma))

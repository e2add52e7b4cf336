"""Kernels of the continuous-wave principle: phasors of the geometry, samples of the correlation, decoding.

One float32 operation after the other and no fast-math, so that results are the same bytes on every machine.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from cabinpose.scene.sensor.buffers import CONFIDENCE_SIGMA_M

F32 = np.float32
Row = NDArray[np.float32]  # (W,), or (n,) of samples
Image = NDArray[np.float32]

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
_SAMPLES = 1024  # of parts at a time: what is computed of them stays in the cache


@njit(inline="always")
def _sine_of_quarter(a):  # type: ignore[no-untyped-def]
    """sin(2 pi a) for |a| <= 1/4."""
    b = a * a
    return a * (_S1 + b * (_S3 + b * (_S5 + b * (_S7 + b * _S9))))


@njit(cache=True, nogil=True)
def _light_of_row(
    depth: Row,
    cos_incidence: Row,
    material: NDArray[np.uint8],
    range_over_depth: Row,
    table: NDArray[np.float32],
    lambert: bool,
    inverse_gloss: np.float32,
    ranges: Row,
    energy: Row,
    moment: Row,
    ambient: Row,
) -> None:
    """Range, energy, energy x range and ambient light of a row of samples."""
    zero, one = F32(0.0), F32(1.0)
    for x in range(depth.size):
        m = material[x]
        r = depth[x] * range_over_depth[x]  # NaN outside the lens model
        c = cos_incidence[x]
        if r > zero:
            gloss = max(zero, one - (one - c) * inverse_gloss)
            e = (table[m, 0] * (c if lambert else one) + table[m, 1] * gloss * gloss) / (r * r)
            light = table[m, 2]
        else:
            r, e, light = zero, zero, table[0, 2]
        ranges[x] = r
        energy[x] = e
        moment[x] = e * r
        ambient[x] = light


@njit(cache=True, nogil=True)
def _phasors_of_row(energy: Row, ranges: Row, per_m: np.float32, triangle: float, in_phase: Row, quadrature: Row) -> None:
    """Energy x (cos, sin) of the phase, of a correlation that is part cosine, part triangle."""
    share, keep = F32(triangle) * _TRIANGLE_PEAK, F32(1.0 - triangle)
    zero, quarter, half, one, four = F32(0.0), F32(0.25), F32(0.5), F32(1.0), F32(4.0)
    for x in range(energy.size):
        t = ranges[x] * per_m
        t = t - np.floor(t + half)  # -1/2 .. 1/2
        magnitude = abs(t)
        fold = quarter - abs(magnitude - quarter)
        fold = fold if t >= zero else -fold
        cosine = keep * _sine_of_quarter(quarter - magnitude) + share * (one - four * magnitude)
        sine = keep * _sine_of_quarter(fold) + share * (four * fold)
        in_phase[x] = energy[x] * cosine
        quadrature[x] = energy[x] * sine


@njit(cache=True, nogil=True)
def _mean_of_parts(samples: Row, mixed: NDArray[np.int32], count: int, image: Row) -> None:
    """Sets the pixels `mixed` of a flat image to the mean of their `count` samples."""
    scale = F32(1.0 / count)
    for k in range(mixed.size):
        if count == 4:
            total = (samples[4 * k] + samples[4 * k + 1]) + (samples[4 * k + 2] + samples[4 * k + 3])
        else:
            total = F32(0.0)
            for j in range(count):
                total += samples[count * k + j]
        image[mixed[k]] = total * scale


@njit(cache=True, nogil=True)
def collect_phasors(
    depth: Image,
    cos_incidence: Image,
    material: NDArray[np.uint8],
    range_over_depth: Image,
    lambert: bool,
    table: NDArray[np.float32],
    gloss_width: float,
    turns_per_m: NDArray[np.float32],
    triangle: float,
    energy: Image,
    moment: Image,
    ambient: Image,
    phasor: Image,
) -> None:
    """Light and phasors of every pixel, seen as one surface.

    In, (H, W): geometry; material `table` (256, 3), `turns_per_m` (F,) = 2 f / c, `triangle` 0..1 the share of a triangular
    correlation. Out, all (H, W), relative to a white surface facing the camera at 1 m: `energy` (rho cos / r^2), `moment`
    (energy x range), `ambient` (its return), `phasor` (2 F, H, W): energy x (cos, sin) of the phase.
    """
    ranges = np.empty(depth.shape[1], np.float32)
    inverse_gloss = F32(1.0 / gloss_width)
    for v in range(depth.shape[0]):
        _light_of_row(
            depth[v], cos_incidence[v], material[v], range_over_depth[v], table, lambert, inverse_gloss, ranges, energy[v],
            moment[v], ambient[v],
        )  # fmt: skip
        for k in range(turns_per_m.size):
            _phasors_of_row(energy[v], ranges, turns_per_m[k], triangle, phasor[2 * k, v], phasor[2 * k + 1, v])


@njit(cache=True, nogil=True)
def average_parts(
    mixed: NDArray[np.int32],
    depth: Image,
    cos_incidence: Image,
    material: NDArray[np.uint8],
    range_over_depth: Image,
    lambert: bool,
    table: NDArray[np.float32],
    gloss_width: float,
    turns_per_m: NDArray[np.float32],
    triangle: float,
    energy: Image,
    moment: Image,
    ambient: Image,
    phasor: Image,
) -> None:
    """Sets light and phasors of the pixels `mixed` (M,), as of `collect_phasors`, to the means of their parts'.

    In: geometry of the parts (M, n); `range_over_depth` (H * W, n) of the parts of all pixels.
    """
    count = depth.shape[1]
    most = max(1, _SAMPLES // count)
    factor = np.empty(most * count, np.float32)
    light = np.empty((4, most * count), np.float32)
    phase = np.empty((2, most * count), np.float32)
    inverse_gloss = F32(1.0 / gloss_width)
    means = (energy.reshape(-1), moment.reshape(-1), ambient.reshape(-1))
    phasors = phasor.reshape(phasor.shape[0], -1)
    flat_depth, flat_cosine, flat_material = depth.reshape(-1), cos_incidence.reshape(-1), material.reshape(-1)
    for first in range(0, mixed.size, most):
        pixels = mixed[first : first + most]
        n = pixels.size * count
        for k in range(pixels.size):
            for j in range(count):
                factor[k * count + j] = range_over_depth[pixels[k], j]
        here = slice(first * count, first * count + n)
        _light_of_row(
            flat_depth[here], flat_cosine[here], flat_material[here], factor[:n], table, lambert, inverse_gloss, light[0, :n],
            light[1, :n], light[2, :n], light[3, :n],
        )  # fmt: skip
        for k in range(3):
            _mean_of_parts(light[1 + k, :n], pixels, count, means[k])
        for k in range(turns_per_m.size):
            _phasors_of_row(light[1, :n], light[0, :n], turns_per_m[k], triangle, phase[0, :n], phase[1, :n])
            _mean_of_parts(phase[0, :n], pixels, count, phasors[2 * k])
            _mean_of_parts(phase[1, :n], pixels, count, phasors[2 * k + 1])


@njit(cache=True, nogil=True)
def _spread_row(row: Row, share: np.float32, out: Row) -> None:
    keep = F32(1.0) - share - share
    last = row.size - 1
    for u in range(1, last):
        out[u] = keep * row[u] + share * (row[u - 1] + row[u + 1])
    out[0] = (keep + share) * row[0] + share * row[min(1, last)]
    out[last] = (keep + share) * row[last] + share * row[max(last - 1, 0)]


@njit(cache=True, nogil=True)
def _spread_column(above: Row, here: Row, below: Row, share: np.float32, out: Row) -> None:
    keep = F32(1.0) - share - share
    for u in range(out.size):
        out[u] = keep * here[u] + share * (above[u] + below[u])


@njit(cache=True, nogil=True)
def spread(image: Image, share: float) -> None:
    """Blurs an image in place: each pixel gives `share` of its light to the neighbour on each side, rows and columns."""
    height, width = image.shape
    part = F32(share)
    above, here, below = np.empty(width, np.float32), np.empty(width, np.float32), np.empty(width, np.float32)
    _spread_row(image[0], part, here)
    above[:] = here
    for v in range(height):
        if v + 1 < height:
            _spread_row(image[v + 1], part, below)
        else:
            below[:] = here
        _spread_column(above, here, below, part, image[v])
        above, here, below = here, below, above


@njit(cache=True, nogil=True)
def mean_light(energy: Image, phasor: Image, gain: Image, mean: NDArray[np.float64]) -> None:
    """Mean over the image of the light (electrons) and its phasors: `mean` (1 + 2 F,). `gain` is 0 outside the lens."""
    height, width = energy.shape
    row = np.empty(width, np.float32)
    for k in range(mean.size):
        total = 0.0
        for v in range(height):
            values = energy[v] if k == 0 else phasor[k - 1, v]
            for u in range(width):
                row[u] = gain[v, u] * values[u]
            total += _sum(row)
        mean[k] = total / (height * width)


@njit(cache=True, nogil=True)
def _sum(row: Row) -> float:
    """Sum in eight fixed lanes: fast, and in the same order on every machine."""
    lanes = np.zeros(8, np.float32)
    whole = row.size // 8 * 8
    for x in range(0, whole, 8):
        for lane in range(8):
            lanes[lane] += row[x + lane]
    total = 0.0
    for lane in range(8):
        total += lanes[lane]
    for x in range(whole, row.size):
        total += row[x]
    return total


@njit(cache=True, nogil=True)
def _light_of_pixels(energy: Row, gain: Row, ambient: Row, ambient_gain: Row, stray: np.float32, total: Row) -> None:
    for u in range(total.size):
        total[u] = gain[u] * energy[u] + stray + ambient_gain[u] * ambient[u]


@njit(cache=True, nogil=True)
def _sample_row(
    total: Row, signal: Row, gain: Row, stray: np.float32, contrast: np.float32, shot: np.float32, read_variance: np.float32,
    well: np.float32, mean: Row, sigma: Row, full: NDArray[np.bool_],
) -> None:  # fmt: skip
    """Mean and sigma of C0 - C2 (or C3 - C1) of a row: four taps, two of each content; `full` where a tap is full.

    Taps E_A,B = (total +- K signal) / 2, clipped at the full well. A full tap has no shot noise left.
    """
    half, two, zero = F32(0.5), F32(2.0), F32(0.0)
    for u in range(total.size):
        difference = contrast * (gain[u] * signal[u] + stray)
        a, b = half * (total[u] + difference), half * (total[u] - difference)
        full[u] |= max(a, b) >= well
        noisy = (a if a < well else zero) + (b if b < well else zero)
        mean[u] = two * (min(a, well) - min(b, well))
        sigma[u] = np.sqrt(two * (shot * noisy + read_variance))


@njit(cache=True, nogil=True)
def _add_noise(value: Row, sigma: Row, ranks: NDArray[np.uint16], lane: int, quantiles: NDArray[np.float32]) -> None:
    for u in range(value.size):
        value[u] += sigma[u] * quantiles[ranks[4 * u + lane]]


@njit(cache=True, nogil=True)
def phases_of_row(x: Row, y: Row, turns: Row, amplitude: Row) -> None:
    """Phase atan2(y, x) in turns, 0 <= t < 1, and half of the phasor's length, added to `amplitude`."""
    zero, quarter, half, one, tiny = F32(0.0), F32(0.25), F32(0.5), F32(1.0), F32(1e-30)
    for u in range(x.size):
        ax, ay = abs(x[u]), abs(y[u])
        q = min(ax, ay) / max(ax, ay, tiny)
        b = q * q
        t = q * (_A0 + b * (_A1 + b * (_A2 + b * (_A3 + b * (_A4 + b * (_A5 + b * (_A6 + b * _A7)))))))
        t = quarter - t if ay > ax else t
        t = half - t if x[u] < zero else t
        t = one - t if y[u] < zero else t
        turns[u] = zero if t >= one else t
        amplitude[u] += half * np.sqrt(ax * ax + ay * ay)


@njit(cache=True, nogil=True)
def _unwrap_row(
    turns_1: Row, turns_2: Row, p: int, q: int, wavelength_1: np.float32, weight_1: np.float32, tolerance: np.float32, out: Row
) -> None:  # fmt: skip
    """Range from the phases of two frequencies in the ratio p : q, by the Chinese remainder theorem.

    With range = (t1 + n1) w1 = (t2 + n2) w2: q n1 - p n2 = round(p t2 - q t1), which gives n1 modulo p and then n2.
    The mean of both is weighted by the square of the frequency, the inverse of its variance. NaN where p t2 - q t1 is
    farther than `tolerance` from a whole number: no single surface has such phases.
    """
    inverse_q = 0
    for candidate in range(p):
        if candidate * q % p == 1:
            inverse_q = candidate
    fp, fq, inverse = F32(p), F32(q), F32(inverse_q)
    first = weight_1 * wavelength_1
    second = (F32(1.0) - weight_1) * wavelength_1 * fp / fq
    half, invalid = F32(0.5), F32(np.nan)
    for u in range(out.size):
        difference = fp * turns_2[u] - fq * turns_1[u]
        remainder = np.floor(difference + half)
        n1 = remainder * inverse
        n1 -= fp * np.floor(n1 / fp)
        n2 = (fq * n1 - remainder) / fp
        r = first * (turns_1[u] + n1) + second * (turns_2[u] + n2)
        out[u] = r if abs(difference - remainder) <= tolerance else invalid


@njit(cache=True, nogil=True)
def _deliver_row(
    ranges: Row, amplitude: Row, total: Row, full: NDArray[np.bool_], field: NDArray[np.bool_], range_over_depth: Row,
    sigma_scale: np.float32, shot: np.float32, read_variance: np.float32, min_amplitude: np.float32, near: np.float32,
    far: np.float32, depth_out: Row, amplitude_out: NDArray[np.uint16], confidence_out: NDArray[np.uint8],
) -> None:  # fmt: skip
    zero, half, scale, most = F32(0.0), F32(0.5), F32(255.0) * _CONFIDENCE_SIGMA, F32(65535.0)
    tiny, invalid = F32(1e-30), F32(np.nan)
    for u in range(ranges.size):
        a = amplitude[u]
        z = ranges[u] / range_over_depth[u]
        valid = field[u] & (full[u] == 0) & (a >= min_amplitude) & (a > zero) & (z >= near) & (z <= far)
        sigma = sigma_scale * np.sqrt(shot * total[u] + read_variance)
        confidence = scale * a / (_CONFIDENCE_SIGMA * a + sigma + tiny)
        depth_out[u] = z if valid else invalid
        # Through int32, which the processor converts eight at a time.
        amplitude_out[u] = np.uint16(np.int32(min(a + half, most) if field[u] else zero))
        confidence_out[u] = np.uint8(np.int32(confidence if valid else zero))


@njit(cache=True, nogil=True)
def decode(
    energy: Image,
    moment: Image,
    ambient: Image,
    phasor: Image,
    gain: Image,
    ambient_gain: Image,
    field: NDArray[np.bool_],
    range_over_depth: Image,
    ranks: NDArray[np.uint16],
    quantiles: NDArray[np.float32],
    stray: NDArray[np.float32],
    frequencies: NDArray[np.float64],
    ratio: tuple[int, int],
    speed_of_light: float,
    contrast: float,
    shot_noise: bool,
    read_noise: float,
    full_well: float,
    min_amplitude: float,
    near: float,
    far: float,
    wrapping: bool,
    tolerance: float,
    depth_out: Image,
    amplitude_out: NDArray[np.uint16],
    confidence_out: NDArray[np.uint8],
) -> None:
    """Four samples of the correlation per frequency, with noise and clipping, decoded to depth, amplitude, confidence.

    Taps of sample i: E_A,B = E / 2 (1 +- K cos(phase + i pi / 2)) + ambient / 2. Of the samples C_i = E_A - E_B only
    C0 - C2 and C3 - C1 are used; each is drawn as one normal number with the variance of its four taps, which is
    the same distribution. `gain` (H, W) turns relative energy into electrons; `stray` (1 + 2 F,) is light that
    reaches every pixel (electrons); `ranks` (H, 4 W) are random 16-bit numbers. Wells clip at their mean content.
    """
    height, width = energy.shape
    n_frequencies = frequencies.size
    squares = np.sum(frequencies**2)
    weight_1 = F32(frequencies[0] ** 2 / squares)
    wavelength_1 = F32(speed_of_light / (2.0 * frequencies[0]))
    period = wavelength_1 * F32(ratio[0])
    # sigma of the range = sigma_scale x sqrt(variance of one sample) / amplitude
    sigma_scale = F32(speed_of_light / (4.0 * np.pi * np.sqrt(2.0 * squares)))
    read_variance, shot, well = F32(read_noise * read_noise), F32(1.0 if shot_noise else 0.0), F32(full_well)
    k_contrast = F32(contrast)
    total = np.empty(width, np.float32)
    x = np.empty(width, np.float32)
    y = np.empty(width, np.float32)
    sigma_x = np.empty(width, np.float32)
    sigma_y = np.empty(width, np.float32)
    amplitude = np.empty(width, np.float32)
    ranges = np.empty(width, np.float32)
    turns = np.empty((2, width), np.float32)
    full = np.empty(width, np.bool_)
    for v in range(height):
        _light_of_pixels(energy[v], gain[v], ambient[v], ambient_gain[v], stray[0], total)
        amplitude[:] = 0.0
        full[:] = False
        for k in range(n_frequencies):
            in_phase, quadrature = phasor[2 * k, v], phasor[2 * k + 1, v]
            _sample_row(total, in_phase, gain[v], stray[1 + 2 * k], k_contrast, shot, read_variance, well, x, sigma_x, full)
            _sample_row(total, quadrature, gain[v], stray[2 + 2 * k], k_contrast, shot, read_variance, well, y, sigma_y, full)
            _add_noise(x, sigma_x, ranks[v], 2 * k, quantiles)
            _add_noise(y, sigma_y, ranks[v], 2 * k + 1, quantiles)
            phases_of_row(x, y, turns[k], amplitude)
        if n_frequencies == 2:
            amplitude *= F32(0.5)
            _unwrap_row(turns[0], turns[1], ratio[0], ratio[1], wavelength_1, weight_1, F32(tolerance), ranges)
        else:
            for u in range(width):
                ranges[u] = turns[0, u] * wavelength_1
        if not wrapping:
            for u in range(width):
                if energy[v, u] > F32(0.0):
                    ranges[u] += period * np.floor((moment[v, u] / energy[v, u] - ranges[u]) / period + F32(0.5))
        _deliver_row(
            ranges, amplitude, total, full, field[v], range_over_depth[v], sigma_scale, shot, read_variance,
            F32(min_amplitude), F32(near), F32(far), depth_out[v], amplitude_out[v], confidence_out[v],
        )  # fmt: skip

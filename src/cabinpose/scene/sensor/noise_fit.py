"""Coefficients of the noise models from the wall experiment: the measured law sigma(z), and the figures of a sensor's pixels.

With N electrons of signal in both taps of a sample, V = N_ambient + s^2 (s: read noise of a tap difference) and contrast K,

    sigma_range = c / (4 pi f) rho,    rho^2 = (N + V) / (2 N^2 K^2),    f = sqrt(f1^2 + f2^2) of two frequencies

(Lange, Siegen, 2000). The phase of a phasor that noisy has the variance v = rho^2 (1 + rho^2). Let x = g N K be the amplitude,
in units of the camera of which g make an electron. Then

    2 x^2 rho^2 = (g / K) x + g^2 V

is linear in x. Its slope and intercept are all that noise over amplitude says: K and g by their ratio alone, so K is held at the
sensor's; ambient light and read noise by their sum alone, so one of them has to be known. Without amplitudes x is the light
that the geometry returns, relative to a white surface at 1 m, and g K the inverse of the electrons from there.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import nnls
from scipy.special import stdtrit

from cabinpose.core import ConfigError
from cabinpose.scene.sensor.empirical import EmpiricalNoise
from cabinpose.scene.sensor.physical import PhysicalNoise
from cabinpose.scene.sensor.presets import SPEED_OF_LIGHT, Sensor
from cabinpose.scene.sensor.walls import F64, Wall, spread

LEAST_DISTANCES = 3
_BINS = 24  # of the signal, for each wall
_SAME_DISTANCE = 0.03  # share
_OUTLYING = 5.0  # robust standard deviations of the logarithm
_LINEAR = 0.1  # rad^2: the most variance of a phase for which rho^2 = v - v^2
_PROFILE = 0.02  # least spread of log cos over the image for which a light profile can be told


@dataclass(frozen=True)
class Estimate:
    """A fitted number with its 95 % interval."""

    value: float
    low: float
    high: float


@dataclass(frozen=True)
class EmpiricalFit:
    """The law sigma(z) = a + b z + c z^2: keys of `EmpiricalNoise`, z and sigma (m) of each wall, and what the law says there."""

    parameters: Mapping[str, Estimate]
    z_m: F64
    sigma_m: F64
    fitted_m: F64

    @property
    def noise(self) -> EmpiricalNoise:
        """The noise model with these coefficients."""
        return EmpiricalNoise(**{name: round(found.value, 4) for name, found in self.parameters.items()})


@dataclass(frozen=True)
class PhysicalFit:
    """The figures of a sensor's pixels.

    parameters: fields of `Sensor`, `ambient` of `PhysicalNoise`, and, where amplitudes were recorded, `amplitude_per_electron` ·
    sensor, noise: with these figures · z_m, sigma_m, fitted_m: mean depth and sigma (m) of each wall, measured and as the model
    says · signal_e, sigma_range_m, fitted_range_m: (B,) electrons, sigma of the range (m) of bins of pixels, and the model's.
    """

    parameters: Mapping[str, Estimate]
    sensor: Sensor
    noise: PhysicalNoise
    z_m: F64
    sigma_m: F64
    fitted_m: F64
    signal_e: F64
    sigma_range_m: F64
    fitted_range_m: F64


def check_distances(walls: Sequence[Wall]) -> None:
    """ConfigError unless the walls stand at enough distances for a law over distance."""
    distances = sorted(wall.distance_m for wall in walls)
    different = sum(b > a * (1 + _SAME_DISTANCE) for a, b in pairwise([0.0, *distances]))
    if different < LEAST_DISTANCES:
        told = ", ".join(f"{d:.2f}" for d in distances) or "none"
        raise ConfigError(
            f"walls at {different} distance{'s' * (different != 1)} ({told} m), at least {LEAST_DISTANCES} are needed",
            hint="record the wall at five or more distances that span the range in which people will sit",
        )


def fit_empirical(walls: Sequence[Wall]) -> EmpiricalFit:
    """The law sigma(z) = a + b z + c z^2 with a, b, c >= 0 through the mean sigma of each wall (thesis, equation 5.12).

    Parameters
    ----------
    walls
        At three distances or more.

    Returns
    -------
    EmpiricalFit
        Least squares of relative residuals. The intervals come from the residuals where there are more walls than
        coefficients, and from the spread over pixels where that is more.

    Raises
    ------
    ConfigError
        For fewer distances.
    """
    check_distances(walls)
    means = np.array([_mean_sigma(wall) for wall in walls])
    z, sigma, error = means.T
    rows = np.stack((np.ones_like(z), z, z * z), axis=1) / sigma[:, None]
    found, _ = nnls(rows, np.ones_like(z))
    freedom = len(z) - len(found)  # those that are held at 0 are in the covariance below as well
    scale = float(np.mean((error / sigma) ** 2))
    if freedom:
        scale = max(scale, float(np.sum((rows @ found - 1) ** 2)) / freedom)
    deviation = np.sqrt(np.diag(np.linalg.inv(rows.T @ rows)) * scale)  # of what is held at 0 as well: it may be more
    reach = deviation * (stdtrit(freedom, 0.975) if freedom else 1.96)
    names = ("a_mm", "b_mm_per_m", "c_mm_per_m2")
    parameters = {
        name: Estimate(1e3 * value, 1e3 * max(value - half, 0.0), 1e3 * (value + half))
        for name, value, half in zip(names, found.tolist(), reach.tolist(), strict=True)
    }
    return EmpiricalFit(parameters, z, sigma, found[0] + found[1] * z + found[2] * z * z)


def fit_physical(walls: Sequence[Wall], sensor: Sensor, *, reflectance: float = 0.75, dark: bool = False) -> PhysicalFit:
    """The figures of a continuous-wave sensor's pixels from the noise of walls.

    Parameters
    ----------
    walls
        At three distances or more, seen by this sensor.
    sensor
        What is known of it: modulation frequencies, integration time, contrast, the vignetting of its lens; without
        amplitudes also its light profile, and in the light its read noise.
    reflectance
        Of the wall, at the camera's wavelength.
    dark
        The walls were recorded without any other light: what does not come of the signal is read noise. Otherwise it is ambient
        light beside the sensor's read noise.

    Returns
    -------
    PhysicalFit
        `signal_e_per_s`, `illumination_exponent` (from amplitudes), `read_noise_e` or `ambient`, and the sensor with them. It has
        no spatial filter: a camera's own is in the noise that was measured.

    Raises
    ------
    ConfigError
        For fewer distances, a reflectance beyond 0..1, a sensor that is not a Time-of-Flight camera, and walls whose noise is
        not that of one.
    """
    check_distances(walls)
    if not 0 < reflectance <= 1:
        raise ConfigError(f"a wall that reflects {reflectance:g}", hint="give reflectance as 0..1, 0.75 for white paint")
    if sensor.principle != "time_of_flight":
        raise ConfigError(
            f"sensor '{sensor.name}' is not a Time-of-Flight camera, its noise has no such figures",
            hint="the empirical law alone describes it",
        )
    by_amplitude = all(wall.amplitude is not None for wall in walls)
    seen = [_Seen.of(wall, sensor, reflectance, by_amplitude=by_amplitude) for wall in walls]
    bins = np.concatenate([each.bins() for each in seen])
    bins = bins[(bins[:, 4] > 0) & (bins[:, 4] < _LINEAR)]
    line, line_covariance = _line(bins, sensor, dark=dark) if len(bins) > 4 else (np.zeros(2), np.zeros((2, 2)))
    if line[0] <= 0:
        raise ConfigError(
            "the noise does not fall with the light as that of a Time-of-Flight camera does",
            hint="check that the walls were recorded in one mode of the camera, with its temporal filter off",
        )
    profile, profile_covariance = _light_profile(seen, sensor) if by_amplitude else (np.zeros(2), np.zeros((2, 2)))
    at = np.concatenate((line, profile))
    covariance = np.zeros((4, 4))
    covariance[:2, :2], covariance[2:, 2:] = line_covariance, profile_covariance

    def figures(of: F64) -> dict[str, float]:
        slope, rest, log_x, exponent = of.tolist()
        unit = slope * sensor.contrast  # g
        electrons = float(np.exp(log_x)) / (unit * sensor.contrast)  # from a white surface at 1 m, on the axis
        others = max(rest, 0.0) / unit**2
        found = {"signal_e_per_s": electrons / sensor.integration_s}
        found |= {"read_noise_e": others**0.5} if dark else {"ambient": others / (reflectance * electrons)}
        return found | ({"illumination_exponent": exponent, "amplitude_per_electron": unit} if by_amplitude else {})

    parameters = _with_intervals(figures, at, covariance)
    values = {name: found.value for name, found in parameters.items()}
    fields = {name: float(f"{value:.6g}") for name, value in values.items() if name in Sensor.model_fields}
    fitted = Sensor.model_validate(sensor.unfiltered().model_dump() | fields)
    noise = PhysicalNoise() if dark else PhysicalNoise(ambient=float(f"{values['ambient']:.6g}"))

    def sigma(x: F64, vignetting: F64) -> F64:
        """Sigma of the range (m)."""
        unit = line[0] * sensor.contrast
        electrons = x / (unit * sensor.contrast)
        others = line[1] / unit**2 + 0.0 * x if dark else line[1] / unit**2 * vignetting + sensor.read_noise_e**2
        rho2 = (electrons + np.maximum(others, 0.0)) / (2 * (electrons * sensor.contrast) ** 2)
        return np.asarray(_per_phase(sensor) * np.sqrt(rho2 * (1 + rho2)))

    means = np.array([_mean_sigma(wall) for wall in walls])
    of_walls = [float(np.mean(sigma(each.x, each.vignetting) / each.range_over_depth)) for each in seen]
    variance = bins[:, 4] * (1 + bins[:, 4])
    return PhysicalFit(
        parameters, fitted, noise, means[:, 0], means[:, 1], np.array(of_walls),
        bins[:, 0] / (line[0] * sensor.contrast**2), _per_phase(sensor) * np.sqrt(variance), sigma(bins[:, 0], bins[:, 1]),
    )  # fmt: skip


def _per_phase(sensor: Sensor) -> float:
    """Range per phase (m / rad), of two frequencies that of their weighted mean."""
    return SPEED_OF_LIGHT / (4 * np.pi * float(np.linalg.norm(sensor.frequencies_hz)))


@dataclass(frozen=True)
class _Seen:
    """Pixels (P,) of a wall: signal x, its vignetting, geometry, and the variance of the phase (rad^2)."""

    x: F64
    vignetting: F64
    geometry: F64  # light returned by the geometry without lens and light profile, relative to a white surface at 1 m
    range_over_depth: F64
    variance: F64

    @classmethod
    def of(cls, wall: Wall, sensor: Sensor, reflectance: float, *, by_amplitude: bool) -> _Seen:
        ratio = wall.camera.range_over_depth[wall.used]
        vignetting = ratio**-sensor.vignetting_exponent
        geometry = reflectance * wall.cos_incidence[wall.used] / (wall.depth_m[wall.used] * ratio) ** 2
        if by_amplitude and wall.amplitude is not None and wall.amplitude_variance is not None:
            # The mean length of a noisy phasor is too long; that of two is the mean of two lengths.
            squared = wall.amplitude[wall.used] ** 2 - len(sensor.frequencies_hz) * wall.amplitude_variance[wall.used]
            x = np.sqrt(np.maximum(squared, 1e-12))
        else:
            x = geometry * vignetting * ratio**-sensor.illumination_exponent
        variance = (wall.sigma_m[wall.used] * ratio / _per_phase(sensor)) ** 2
        return cls(x, vignetting, geometry, ratio, variance)

    def bins(self) -> F64:
        """(B, 5): means of x, of vignetting, of 2 x^2 rho^2, its standard error, and rho^2, of pixels of like signal."""
        rows = []
        for some in np.array_split(np.argsort(self.x), _BINS):
            some = some[self.variance[some] > 0]
            if len(some) < 8:
                continue
            y = 2 * self.x[some] ** 2 * self.variance[some]
            kept = _usual(y)
            linear = 1 - float(np.mean(self.variance[some][kept]))  # rho^2 = v - v^2
            error = linear * float(np.std(y[kept])) / len(kept) ** 0.5
            rho2 = linear * float(np.mean(self.variance[some][kept]))
            rows.append((np.mean(self.x[some]), np.mean(self.vignetting[some]), linear * np.mean(y[kept]), error, rho2))
        return np.array(rows).reshape(-1, 5)


def _line(bins: F64, sensor: Sensor, *, dark: bool) -> tuple[F64, F64]:
    """(2,) slope over x, and what is left at no signal (dark) or the part of it that ambient light has, on the axis; (2, 2)."""
    x, vignetting, y, error, _ = bins.T
    rows = np.stack((x, np.ones_like(x) if dark else vignetting), axis=1)
    found = np.zeros(2)
    for _ in range(1 if dark else 30):  # the read noise is known in electrons, whose unit the slope tells
        known = 0.0 if dark else (found[0] * sensor.contrast * sensor.read_noise_e) ** 2
        found = np.linalg.lstsq(rows / error[:, None], (y - known) / error, rcond=None)[0]
    residual = (rows @ found + known - y) / error
    scale = max(1.0, float(residual @ residual) / (len(x) - 2))
    weighted = rows / error[:, None]
    return found, np.linalg.inv(weighted.T @ weighted) * scale


def _light_profile(seen: Sequence[_Seen], sensor: Sensor) -> tuple[F64, F64]:
    """(2,) log of x of a white surface at 1 m on the axis, exponent of the light's cosine; and their covariance."""
    rows = []
    for each in seen:
        log_cos = -np.log(each.range_over_depth)
        level = np.log(each.x / each.geometry)
        rows += [(np.mean(log_cos[some]), np.median(level[some])) for some in np.array_split(np.argsort(log_cos), _BINS)]
    log_cos, level = np.array(rows).T
    if np.ptp(log_cos) < _PROFILE:
        held = sensor.vignetting_exponent + sensor.illumination_exponent
        rest = level - held * log_cos
        return np.array((rest.mean(), sensor.illumination_exponent)), np.diag((float(np.var(rest)) / len(rest), 0.0))
    columns = np.stack((np.ones_like(log_cos), log_cos), axis=1)
    found, squares = np.linalg.lstsq(columns, level, rcond=None)[:2]
    scale = float(squares[0]) / (len(level) - 2) if len(squares) else 0.0
    return found - (0.0, sensor.vignetting_exponent), np.linalg.inv(columns.T @ columns) * scale


def _with_intervals(figures: Callable[[F64], Mapping[str, float]], at: F64, covariance: F64) -> dict[str, Estimate]:
    """Figures that follow from fitted numbers (P,), with intervals by their derivatives."""
    values = figures(at)
    steps = np.maximum(np.sqrt(np.diag(covariance)) * 0.1, 1e-12)
    result = dict.fromkeys(values, 0.0)
    gradients = []
    for k, step in enumerate(steps.tolist()):
        shift = np.zeros_like(at)
        shift[k] = step
        high, low = figures(at + shift), figures(at - shift)
        gradients.append({name: (high[name] - low[name]) / (2 * step) for name in values})
    for name in result:
        gradient = np.array([each[name] for each in gradients])
        result[name] = 1.96 * float(np.sqrt(max(gradient @ covariance @ gradient, 0.0)))
    return {name: Estimate(value, value - result[name], value + result[name]) for name, value in values.items()}


def _usual(values: F64) -> NDArray[np.intp]:
    """Indices of values > 0 that are not far from the others by their logarithm."""
    logs = np.log(values)
    off = np.abs(logs - np.median(logs))
    return np.flatnonzero(off <= _OUTLYING * max(spread(logs), 1e-9))


def _mean_sigma(wall: Wall) -> tuple[float, float, float]:
    """Mean depth and sigma (m) of the wall's pixels, and the standard error of that."""
    sigma = wall.sigma_m[wall.used]
    z = wall.depth_m[wall.used][sigma > 0]
    if not len(z):
        raise ConfigError(
            f"{wall.name} at {wall.distance_m:.2f} m has no noise beyond the steps of the recorded depth",
            hint="record what the camera delivers in its finest unit, with its temporal filter off",
        )
    sigma = sigma[sigma > 0]
    kept = _usual(sigma)
    unbiased = (4 * wall.frames - 3) / (4 * wall.frames - 4)  # of a deviation over n frames: 1 / c4(n)
    return float(np.mean(z[kept])), float(np.mean(sigma[kept])) * unbiased, float(np.std(sigma[kept]) / len(kept) ** 0.5)

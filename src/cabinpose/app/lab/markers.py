"""What the optical system says of markers: noise, moments in which it loses one, labels that it takes for one another."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray

from cabinpose.app.lab.rig import VirtualRig
from cabinpose.app.lab.writing import samples
from cabinpose.signals import Markers, Sample

F64 = NDArray[np.float64]

_LOST_PER_S, _LOST_FOR_S = 0.04, (0.03, 0.4)  # how often a marker is lost, and for how long
_SWAPPED_PER_S, _SWAPPED_FOR_S = 0.03, (0.2, 1.5)


def spells(time_s: F64, per_s: float, for_s: tuple[float, float], *, rng: Generator) -> NDArray[np.bool_]:
    """(T,) which of the rising times lie in spells that begin `per_s` times a second at random and last `for_s` (least, most)."""
    inside = np.zeros(len(time_s), np.bool_)
    if len(time_s):
        for _ in range(rng.poisson(per_s * (time_s[-1] - time_s[0]))):
            begin, length = rng.uniform(time_s[0], time_s[-1]), rng.uniform(*for_s)
            inside |= (time_s >= begin) & (time_s < begin + length)
    return inside


def observed(rig: VirtualRig, true_ns: NDArray[np.int64], positions: F64, *, rng: Generator) -> F64:
    """(T, M, 3) what the optical system says of markers at `positions` (T, M, 3), world, m; NaN = lost."""
    time_s = (true_ns - rig.start_ns) / 1e9
    said = positions + rig.optical_noise_m * rng.standard_normal(positions.shape)
    if rig.optical_swaps and positions.shape[1] > 1:
        swapped = spells(time_s, _SWAPPED_PER_S, _SWAPPED_FOR_S, rng=rng)
        first, second = rng.choice(positions.shape[1], 2, replace=False)
        said[np.ix_(swapped, (first, second))] = said[np.ix_(swapped, (second, first))]
    if rig.optical_occlusion:
        for marker in range(positions.shape[1]):
            said[spells(time_s, _LOST_PER_S, _LOST_FOR_S, rng=rng), marker] = np.nan
    return said


def marker_samples(
    rig: VirtualRig, true_ns: NDArray[np.int64], subject: str, names: Sequence[str], positions: F64, *, rng: Generator
) -> Iterator[Sample]:
    """The optical system's samples of markers at `positions` (T, M, 3) at the true times (T,).

    Their time stamps are corrected for the cameras' latency, as the system itself does: they name the moment of exposure.
    """
    clock = rig.clock("optical")
    said, arrivals = observed(rig, true_ns, positions, rng=rng), clock.arrivals(true_ns, rng=rng)
    unknown = np.full(len(names), np.nan)
    return samples(clock, true_ns, arrivals, lambda k: (Markers(subject, tuple(names), said[k], unknown),))

"""Errors over time under named conditions, and the numbers about them with their bootstrap intervals."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass
from types import MappingProxyType
from typing import Any, Literal, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from cabinpose.core import ConfigError
from cabinpose.evaluate.bootstrap import Weights, frame_weights, interval, weighted_quantiles, weighted_sums

F64 = NDArray[np.float64]
Unit = Literal["rad", "m", "m/s"]
ALL = "All"
REPORTED = MappingProxyType({"rad": ("°", 180 / np.pi), "m": ("mm", 1e3), "m/s": ("µm/s", 1e6)})  # unit of reports, in an SI unit
_BOX = np.array([0.05, 0.25, 0.5, 0.75, 0.95])
_FEWEST_BLOCKS = 5  # below, an interval would say more about the blocks than about the errors


@dataclass(frozen=True)
class Errors:
    """Errors (T, N) of N named things (segments, joints, axes) over one run, in an SI unit, NaN where one is not known.

    measure: what was compared and how · condition: under which circumstances (a plane of motion, a drive): runs of the same
    condition are pooled · time_s (T,): rising.
    """

    measure: str
    unit: Unit
    condition: str
    names: tuple[str, ...]
    time_s: F64
    values: F64


@dataclass(frozen=True)
class Summary:
    """Numbers about one thing's errors under one condition ("All": all things, all conditions), in `unit` of reports.

    samples: errors known · sd: with N - 1, as the thesis' equations have it · box: 5, 25, 50, 75, 95 % quantiles · mean_low to
    median_high: 95 % intervals by the block bootstrap, NaN where there are too few blocks · block_s: their length, NaN with it.
    """

    measure: str
    unit: str
    condition: str
    name: str
    samples: int
    mean: float
    sd: float
    median: float
    p95: float
    maximum: float
    mean_low: float
    mean_high: float
    median_low: float
    median_high: float
    block_s: float
    box: tuple[float, ...]


@dataclass(frozen=True)
class Judgement:
    """The outcome of one of the evaluations: the errors, the numbers about them, settings in words, and what was left out."""

    kind: str
    errors: tuple[Errors, ...]
    summaries: tuple[Summary, ...]
    settings: Mapping[str, Any]
    notes: tuple[str, ...] = ()

    def summary(self, measure: str | None = None, condition: str = ALL, name: str = ALL) -> Summary:
        """The numbers of that measure (None: the first), condition and name. Raises KeyError where there are none."""
        for row in self.summaries:
            if measure in (None, row.measure) and (row.condition, row.name) == (condition, name):
                return row
        raise KeyError((measure, condition, name))

    def to_dict(self) -> dict[str, Any]:
        """Plain data, without the errors over time."""
        rows = [asdict(row) for row in self.summaries]
        return {"evaluation": self.kind, "settings": dict(self.settings), "notes": list(self.notes), "summaries": rows}


class Run(Protocol):
    """One run of an evaluation."""

    def errors(self) -> tuple[Errors, ...]:
        """What it compared, measure by measure."""


def judgement(
    kind: str, runs: Sequence[Run], notes: Iterable[str], *, rng: np.random.Generator, resamples: int, block_s: float | None
) -> Judgement:
    """The errors of runs, and the numbers about them; see `summarise`."""
    errors = tuple(e for run in runs for e in run.errors())
    rows = summarise(errors, rng=rng, resamples=resamples, block_s=block_s)
    return Judgement(kind, errors, rows, {"resamples": resamples}, tuple(notes))


def correlation_time(values: F64, step_s: float) -> float:
    """Seconds in which the autocorrelation of the columns of (T, N) falls below 1/e: their median; half a step for white noise.

    Linear between lags. Columns with missing values go by the others' frames; constant ones are left out.
    """
    times = []
    for column in values.T:
        x = column[np.isfinite(column)]
        if len(x) < 4 or np.ptp(x) == 0:
            continue
        x = x - x.mean()
        spectrum = np.abs(np.fft.rfft(x, 2 * len(x))) ** 2
        correlation = np.fft.irfft(spectrum)[: len(x)] / (x @ x)
        below = int(np.argmax(correlation < np.exp(-1)))  # the last lags are below: the sum over all lags is zero
        over = (correlation[below - 1] - np.exp(-1)) / (correlation[below - 1] - correlation[below])
        times.append((below - 1 + float(over)) * step_s)
    return float(np.median(times)) if times else step_s


def block_length(run: Errors) -> float:
    """Seconds of a block, τ^(2/3) T^(1/3) for errors that forget with τ over a run of T (Carlstein 1986, for first order)."""
    step = _step(run)
    span = step * max(len(run.time_s), 1)
    return max(correlation_time(run.values, step) ** (2 / 3) * span ** (1 / 3), step)


def summarise(
    runs: Sequence[Errors], *, rng: np.random.Generator, resamples: int = 1000, block_s: float | None = None
) -> tuple[Summary, ...]:
    """Every measure's numbers: over all conditions and by condition where there are several, over all names and by name
    where there are several.

    Intervals: blocks of consecutive frames of all runs are drawn with replacement, since neighbouring frames' errors resemble
    each other; no block spans two runs. block_s: their length; None: `block_length` of each run. resamples: 0 = no intervals.
    """
    if resamples < 0 or (block_s is not None and not block_s > 0):
        raise ConfigError("a bootstrap needs a positive block and at least 0 resamples", hint="leave both as they are")
    result: list[Summary] = []
    for measure in dict.fromkeys(run.measure for run in runs):
        mine = [run for run in runs if run.measure == measure]
        several = len({name for run in mine for name in run.names}) > 1
        conditions = tuple(dict.fromkeys(run.condition for run in mine))
        for condition in (ALL, *conditions) if len(conditions) > 1 else (ALL,):
            chosen = [run for run in mine if condition in (ALL, run.condition)]
            result += _summaries(chosen, condition, rng, resamples, block_s, several=several)
    return tuple(result)


def _summaries(
    runs: Sequence[Errors], condition: str, rng: np.random.Generator, resamples: int, block_s: float | None, *, several: bool
) -> Iterable[Summary]:
    """The numbers of one measure under one condition: over all names, then of each where there are several."""
    names = tuple(dict.fromkeys(name for run in runs for name in run.names))
    label, scale = REPORTED[runs[0].unit]
    values = np.full((sum(len(run.time_s) for run in runs), len(names)), np.nan)
    block = np.empty(len(values), np.int64)
    start = blocks = 0
    lengths = []
    for run in runs:
        rows = slice(start, start + len(run.time_s))
        values[rows, [names.index(name) for name in run.names]] = run.values * scale
        length = block_length(run) if block_s is None else block_s
        frames = max(round(length / _step(run)), 1)
        block[rows] = blocks + np.arange(len(run.time_s)) // frames
        start, blocks = rows.stop, blocks + -(-len(run.time_s) // frames)
        lengths.append(length)
    enough = resamples and blocks >= _FEWEST_BLOCKS
    told = float(np.median(lengths)) if enough else float("nan")
    drawn = _Blocks(block, frame_weights(np.arange(blocks), resamples if enough else 0, rng=rng), told)
    for name, column in [(ALL, slice(None)), *((name, slice(i, i + 1)) for i, name in enumerate(names) if several)]:
        yield _summary(runs[0].measure, label, condition, name, values[:, column], drawn)


class _Blocks(NamedTuple):
    """What the bootstrap draws: the block of each frame (T,), draws of each (B, blocks), and their length (NaN without draws)."""

    of_frame: NDArray[np.int64]
    weights: Weights
    length_s: float


def _summary(measure: str, unit: str, condition: str, name: str, values: F64, blocks: _Blocks) -> Summary:
    rows, _ = known = np.nonzero(np.isfinite(values))
    flat, at, weights = values[known], blocks.of_frame[rows], blocks.weights
    if not flat.size:
        no = float("nan")
        return Summary(measure, unit, condition, name, 0, no, no, no, no, no, no, no, no, no, no, (no,) * 5)
    box = np.quantile(flat, _BOX)
    low, high = np.full(2, np.nan), np.full(2, np.nan)  # of mean and median
    if len(weights):
        sums = np.stack([np.bincount(at, w, weights.shape[1]).astype(np.float64) for w in (flat, np.ones_like(flat))], axis=1)
        drawn = weighted_sums(weights, sums)
        with np.errstate(invalid="ignore"):
            means = drawn[:, 0] / drawn[:, 1]
        medians = weighted_quantiles(flat, at, weights, np.array([0.5]))[:, 0]
        low, high = interval(np.stack((means, medians), axis=1))
    return Summary(
        measure, unit, condition, name, len(flat), float(flat.mean()), float(flat.std(ddof=1)) if len(flat) > 1 else float("nan"),
        float(box[2]), float(box[4]), float(flat.max()), float(low[0]), float(high[0]), float(low[1]), float(high[1]),
        blocks.length_s, tuple(float(b) for b in box),
    )  # fmt: skip


def _step(run: Errors) -> float:
    """Seconds from frame to frame: the median, not the mean, since runs have holes."""
    return float(np.median(np.diff(run.time_s))) if len(run.time_s) > 1 else 1.0

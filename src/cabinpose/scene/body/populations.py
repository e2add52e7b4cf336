"""How tall, heavy and proportioned people are: published populations, a team's own, and people drawn from them.

A population says how stature and mass are distributed, by sex and age. The other dimensions follow by how they go with both among
soldiers (ANSUR II) and children (Snyder 1977), whatever the population.
"""

from __future__ import annotations

import csv
import itertools
import math
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from importlib.resources import files
from importlib.resources.abc import Traversable
from pathlib import Path
from typing import Any, NamedTuple, TypeAlias, cast, get_args

import numpy as np

from cabinpose.core import ConfigError, Floats, unknown_name
from cabinpose.core import reproducible as rp
from cabinpose.scene.body.proportions import DIMENSIONS, Sex, proportions

POPULATIONS = ("nhanes", "ansur", "cdc")
_PERCENTILES = (1, 5, 10, 25, 50, 75, 90, 95, 99)
# Normal scores of those percentiles.
_SCORES = np.array([-2.3263479, -1.6448536, -1.2815516, -0.6744898, 0.0, 0.6744898, 1.2815516, 1.6448536, 2.3263479])
_MEDIAN = _PERCENTILES.index(50)
_FARTHEST = 3.0  # normal score of the most unusual person: one in 740 is as far or farther
_ADULT_YEARS = 20.0  # from which on people of a percentile are adults of all ages
_UNITS = {"stature": {"m": 1.0, "cm": 1e-2, "mm": 1e-3}, "mass": {"kg": 1.0, "lb": 0.45359237}}
_END_LENGTHS = (0.3, 3.0)  # factors by which a distribution's ends are made shorter or longer for its SD
# Draws of one person, of which the first within the ranges counts, or that which is least beyond them (as a share of the limit).
_TRIES, _NEARLY = 256, 0.05
STATURE_LIMITS_M, BMI_LIMITS = (0.42, 2.3), (11.0, 55.0)  # of what bodies can be made (docs/populations.md)
Limits: TypeAlias = tuple[float, float]


@dataclass(frozen=True)
class Anthropometry:
    """The size of a person: what a body is made to.

    years: age · dimensions_m: in the order of `DIMENSIONS` · population: by name, "" for nobody's · stature_percentile,
    mass_percentile: 0 to 100, among people of the population of the same sex and age band.
    """

    sex: Sex
    years: float
    stature_m: float
    mass_kg: float
    dimensions_m: tuple[float, ...]
    population: str = ""
    stature_percentile: float = 50.0
    mass_percentile: float = 50.0

    @property
    def bmi(self) -> float:
        """Body mass index, kg/m2."""
        return self.mass_kg / (self.stature_m * self.stature_m)

    def with_size(self, stature_m: float, mass_kg: float) -> Anthropometry:
        """Somebody of the same sex and age of another stature (m) and mass (kg), with the dimensions that are usual for both."""
        sizes = _as_bodies_are(stature_m, mass_kg)
        dimensions = proportions().dimensions_m(self.sex, self.years, sizes, np.zeros(len(DIMENSIONS)))
        return Anthropometry(self.sex, self.years, *sizes, dimensions)

    def __getitem__(self, dimension: str) -> float:
        """One of the dimensions, m."""
        return self.dimensions_m[tuple(DIMENSIONS).index(dimension)]


@dataclass(frozen=True)
class _Band:
    """People of a sex between two ages: their share of all, stature and mass at `_SCORES`, and the correlation of both."""

    sex: Sex
    years: Limits
    share: float
    stature_m: Floats
    mass_kg: Floats
    r: float

    def sizes(self, first: float, second: float) -> tuple[tuple[float, float], tuple[float, float]]:
        """Stature and mass (m, kg) by two independent normal scores, and their own scores."""
        scores = first, self.r * first + math.sqrt(1.0 - self.r * self.r) * second
        return (_at_score(self.stature_m, scores[0]), _at_score(self.mass_kg, scores[1])), scores


@dataclass(frozen=True)
class Population:
    """A named population: bands of age, or a curve of growth whose bands are points between which everything is interpolated."""

    name: str
    bands: tuple[_Band, ...]
    is_curve: bool

    def draw(
        self,
        *,
        rng: np.random.Generator,
        sex: Sex | None = None,
        years: Limits | None = None,
        stature_m: Limits | None = None,
        mass_kg: Limits | None = None,
    ) -> Anthropometry:
        """Somebody of this population, of a sex and within ranges where they are given; as many draws whatever comes out.

        Who is beyond `STATURE_LIMITS_M` or `BMI_LIMITS` is brought to the limit.

        Raises ConfigError where the population has nobody of these years, or hardly anybody of this size.
        """
        u, z = rng.random((_TRIES, 2)), np.clip(rng.standard_normal((_TRIES, 2)), -_FARTHEST, _FARTHEST)
        others = np.clip(rng.standard_normal(len(DIMENSIONS)), -_FARTHEST, _FARTHEST)
        nearest: tuple[float, Anthropometry | None] = (_NEARLY, None)
        for of_band, scores in zip(u, z, strict=True):
            band, age = self._at(sex, years, of_band)
            drawn, both_scores = band.sizes(*scores.tolist())
            stature, mass = _as_bodies_are(*drawn)
            beyond = max(_beyond(stature, stature_m), _beyond(mass, mass_kg))
            if beyond < nearest[0]:
                sizes = (_within(stature, stature_m), _within(mass, mass_kg))
                nearest = beyond, self._person(band, age, sizes, both_scores, others)
            if beyond == 0.0:
                break
        if nearest[1] is None:
            raise ConfigError(
                f"hardly anybody of population {self.name} is within the ranges of stature and mass", hint="widen the ranges"
            )
        return nearest[1]

    def beyond_bodies(self, *, rng: np.random.Generator, sex: Sex, years: Limits, draws: int = 10_000) -> float:
        """Share of the people of a sex and ages who are beyond what bodies can be, and brought to the limit, of some draws."""
        u, z = rng.random((draws, 2)), np.clip(rng.standard_normal((draws, 2)), -_FARTHEST, _FARTHEST)
        people = (self._at(sex, years, of_band)[0].sizes(*scores.tolist())[0] for of_band, scores in zip(u, z, strict=True))
        return sum(_as_bodies_are(*sizes) != sizes for sizes in people) / draws

    def of_percentile(self, sex: Sex, percentile: float, years: float | None = None) -> Anthropometry:
        """The person whose stature and mass are both this percentile (1 to 99) of a sex, and whose dimensions are usual for both.

        years: of people of this age; of all adults where it is left out.
        """
        if not 1.0 <= percentile <= 99.0:
            raise ConfigError(f"the {percentile:g}th percentile", hint="percentiles from 1 to 99")
        if years is not None:
            band, age = self._at(sex, (years, years), np.zeros(2))
            bands: tuple[_Band, ...] = (band,)
        else:
            bands = tuple(b for b in self.bands if b.sex == sex and b.years[0] >= _ADULT_YEARS) or self._of(sex)[-1:]
            age = sum(b.share * (b.years[0] + b.years[1]) / 2 for b in bands) / sum(b.share for b in bands)
            band, _ = self._at(sex, (age, age), np.zeros(2))
        sizes = tuple(_mixed_percentile(bands, values, percentile / 100.0) for values in ("stature_m", "mass_kg"))
        person = self._person(band, age, cast("tuple[float, float]", sizes), (0.0, 0.0), np.zeros(len(DIMENSIONS)))
        return Anthropometry(**{**vars(person), "stature_percentile": percentile, "mass_percentile": percentile})

    def percentiles(self, sex: Sex, years: float, stature_m: float, mass_kg: float) -> tuple[float, float]:
        """Of a stature and a mass among those of a sex and age, 0 to 100. Raises ConfigError for an age that nobody has."""
        band, _ = self._at(sex, (years, years), np.zeros(2))
        scores = _score_of(band.stature_m, stature_m), _score_of(band.mass_kg, mass_kg)
        return 100.0 * _normal_share(scores[0]), 100.0 * _normal_share(scores[1])

    def stature_m(self, sex: Sex, years: float) -> tuple[float, float]:
        """Median and standard deviation (half of what is between the 16th and 84th percentiles) of stature at an age, m."""
        band, _ = self._at(sex, (years, years), np.zeros(2))
        return _at_score(band.stature_m, 0.0), (_at_score(band.stature_m, 1.0) - _at_score(band.stature_m, -1.0)) / 2

    def _of(self, sex: Sex | None) -> tuple[_Band, ...]:
        return tuple(band for band in self.bands if sex is None or band.sex == sex)

    def years(self, sex: Sex | None = None) -> Limits:
        """The least and the greatest age, years; (inf, -inf) where there is nobody of the sex."""
        bands = self._of(sex)
        if not bands:
            return math.inf, -math.inf
        return min(band.years[0] for band in bands), max(band.years[1] for band in bands)

    def has(self, years: float) -> bool:
        """Whether there are people of both sexes of this age."""
        return all(low <= years <= high for low, high in (self.years("male"), self.years("female")))

    def _at(self, sex: Sex | None, years: Limits | None, u: Floats) -> tuple[_Band, float]:
        """A band and an age in it, by two numbers from 0 to 1."""
        low, high = years or self.years(sex)
        of_sex = self._of(sex)
        if not of_sex:
            raise ConfigError(f"population {self.name} has no {sex} people", hint="it has those of the other sex alone")
        first, last = self.years(sex)
        if high < first or low > last:
            raise ConfigError(
                f"population {self.name} has nobody of {low:g} to {high:g} years", hint=f"it goes from {first:g} to {last:g}"
            )
        low, high = max(low, first), min(high, last)
        if self.is_curve:
            sexes: tuple[Sex, ...] = tuple(dict.fromkeys(band.sex for band in reversed(of_sex)))  # male before female
            chosen = sexes[int(u[0] * len(sexes))]
            age = low + float(u[1]) * (high - low)
            return _between([b for b in of_sex if b.sex == chosen], age), age
        # A band's share falls on its years evenly; that of a single age on the last band which holds it.
        width = [max(0.0, min(high, b.years[1]) - max(low, b.years[0])) / (b.years[1] - b.years[0]) * b.share for b in of_sex]
        if high - low < 1e-9:
            width = [b.share * (b.years[0] <= low < b.years[1] or low == last == b.years[1]) for b in of_sex]
        bounds = np.cumsum(width)
        if not bounds[-1] > 0.0:
            raise ConfigError(f"population {self.name} has nobody of {low:g} to {high:g} years", hint="its bands leave them out")
        band = of_sex[min(int(np.searchsorted(bounds, u[0] * bounds[-1], side="right")), len(of_sex) - 1)]
        start, end = max(low, band.years[0]), min(high, band.years[1])
        return band, start + float(u[1]) * (end - start)

    def _person(
        self, band: _Band, age: float, sizes: tuple[float, float], scores: tuple[float, float], others: Floats
    ) -> Anthropometry:
        dimensions = proportions().dimensions_m(band.sex, age, sizes, others)
        percentiles = (100.0 * _normal_share(float(score)) for score in scores)
        return Anthropometry(band.sex, age, *sizes, dimensions, self.name, *percentiles)


def _within(value: float, limits: Limits | None) -> float:
    return value if limits is None else min(max(value, limits[0]), limits[1])


def _beyond(value: float, limits: Limits | None) -> float:
    """How far a value is beyond limits, as a share of itself."""
    return abs(value - _within(value, limits)) / value


def _as_bodies_are(stature_m: float, mass_kg: float) -> tuple[float, float]:
    """Stature and mass within what bodies can be."""
    stature = _within(stature_m, STATURE_LIMITS_M)
    low, high = (bmi * stature * stature for bmi in BMI_LIMITS)
    return stature, min(max(mass_kg, low), high)


def _at_score(values: Floats, score: Any) -> Any:
    """Of values at `_SCORES` those at a normal score, or at (N,): straight lines between, and beyond both ends as before them."""
    k = np.clip(np.searchsorted(_SCORES, score), 1, len(_SCORES) - 1)
    share = (score - _SCORES[k - 1]) / (_SCORES[k] - _SCORES[k - 1])
    found = values[k - 1] + share * (values[k] - values[k - 1])
    return found if np.ndim(found) else float(found)


def _score_of(values: Floats, value: float) -> float:
    """The inverse of `_at_score`."""
    k = min(max(int(np.searchsorted(values, value)), 1), len(values) - 1)
    return float(_SCORES[k - 1] + (value - values[k - 1]) / (values[k] - values[k - 1]) * (_SCORES[k] - _SCORES[k - 1]))


def _normal_share(score: float) -> float:
    """Share of a normal distribution below a score, to 1e-7 (Abramowitz & Stegun 26.2.17)."""
    t = 1.0 / (1.0 + 0.2316419 * abs(score))
    tail = t * (0.31938153 + t * (-0.356563782 + t * (1.781477937 + t * (-1.821255978 + t * 1.330274429))))
    tail *= 0.3989422804 * float(rp.exp(-0.5 * score * score))
    return 1.0 - tail if score > 0.0 else tail


def _mixed_percentile(bands: Sequence[_Band], name: str, share: float) -> float:
    """The stature or mass below which a share of the people of several bands is."""
    values, whole = [getattr(band, name) for band in bands], sum(band.share for band in bands)
    low, high = min(_at_score(v, -4.0) for v in values), max(_at_score(v, 4.0) for v in values)
    for _ in range(50):
        middle = (low + high) / 2
        below = sum(b.share * _normal_share(_score_of(v, middle)) for b, v in zip(bands, values, strict=True)) / whole
        low, high = (middle, high) if below < share else (low, middle)
    return (low + high) / 2


def _between(bands: Sequence[_Band], age: float) -> _Band:
    """The band of a curve of growth at an age."""
    ages = np.array([band.years[0] for band in bands])
    k = min(max(int(np.searchsorted(ages, age)), 1), len(ages) - 1)
    before, after = bands[k - 1], bands[k]
    share = min(max((age - ages[k - 1]) / (ages[k] - ages[k - 1]), 0.0), 1.0)
    stature, mass = (
        (1.0 - share) * a + share * b for a, b in ((before.stature_m, after.stature_m), (before.mass_kg, after.mass_kg))
    )
    return _Band(before.sex, (age, age), 1.0, stature, mass, (1.0 - share) * before.r + share * after.r)


def load_population(name: str) -> Population:
    """A packaged population by its name, or a team's own by the path of its CSV (docs/populations.md). Read once per process."""
    return _loaded(name)


@cache
def _loaded(name: str) -> Population:
    if name in POPULATIONS:
        return read_population(name, files("cabinpose.scene.body") / "assets" / "populations" / f"{name}.csv")
    if not name.lower().endswith(".csv"):
        raise ConfigError(
            str(unknown_name("population", name, ())), hint=f"known: {', '.join(POPULATIONS)}, or the path of a CSV"
        )
    return read_population(Path(name).stem, Path(name))


def read_population(name: str, path: Path | Traversable) -> Population:
    """A population of a CSV: with columns years_from and years_to one of bands, with L, M and S a curve of growth.

    Raises ConfigError that names the line for anything that is no population.
    """
    try:
        reader = csv.DictReader(path.read_text(encoding="utf-8-sig").splitlines())
        rows = [(reader.line_num, row) for row in reader]
        columns = tuple(reader.fieldnames or ())
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise ConfigError(
            f"population {path}: {error}", hint="give the path of a CSV; docs/populations.md has the columns"
        ) from error
    is_curve = "L" in columns
    needed = _CURVE_COLUMNS if is_curve else _BAND_COLUMNS
    if missing := [column for column in needed if column not in columns]:
        raise ConfigError(f"population {path} has no column {', '.join(missing)}", hint=f"needed: {', '.join(needed)}")
    taken = [f"p{percent}" for percent in _PERCENTILES]
    if not is_curve and (
        lost := [each for each in columns if re.fullmatch(r"[pP]\d+(\.\d+)?", each or "") and each not in taken]
    ):
        raise ConfigError(f"population {path}: column {', '.join(lost)} is not taken", hint=f"percentiles: {', '.join(taken)}")
    found: dict[tuple[str, float, float], dict[str, _Row]] = {}
    for line, row in rows:
        try:
            read = _row(row, is_curve=is_curve)
        except ConfigError as error:
            raise ConfigError(f"population {path}, line {line}: {error}", hint=error.hint) from None
        if read.measure in found.setdefault(read.key, {}):
            raise ConfigError(
                f"population {path}, line {line}: a second {read.measure} of the same people", hint="leave one of both"
            )
        found[read.key][read.measure] = read
    bands = []
    for (sex, start, end), measures in found.items():
        if missing := [measure for measure in _UNITS if measure not in measures]:
            raise ConfigError(
                f"population {path} has no {missing[0]} of {sex} people of {start:g} to {end:g} years",
                hint="each band needs a row of stature and one of mass",
            )
        stature, mass = measures["stature"], measures["mass"]
        whose = f"population {path}: {sex} people of {start:g} to {end:g} years"
        names = "share", "r_with_stature"
        told = {name: {v for m in measures.values() if (v := getattr(m, name)) is not None} for name in names}
        if several := [name for name, values in told.items() if len(values) > 1]:
            raise ConfigError(f"{whose} have two values of {several[0]}", hint="give it once, or the same in both rows")
        middle = stature.values[_MEDIAN], mass.values[_MEDIAN]
        if _as_bodies_are(*middle) != middle:
            raise ConfigError(
                f"{whose} are {middle[0]:.3g} m tall and weigh {middle[1]:.3g} kg in the median",
                hint="stature is in m, cm or mm, mass in kg or lb, as `unit` says",
            )
        r = told["r_with_stature"].pop() if told["r_with_stature"] else float(proportions().correlation[cast("Sex", sex)][0, 1])
        share = told["share"].pop() if told["share"] else 1.0
        bands.append(_Band(cast("Sex", sex), (start, end), share, stature.values, mass.values, r))
    if not bands or not sum(band.share for band in bands) > 0.0:
        raise ConfigError(f"population {path} has nobody", hint="docs/populations.md has an example")
    bands.sort(key=lambda band: (band.sex, band.years))
    if alone := [sex for sex in get_args(Sex) if is_curve and sum(band.sex == sex for band in bands) == 1]:
        raise ConfigError(f"population {path} has one age of {alone[0]} people", hint="a curve of growth goes over two or more")
    for one, other in itertools.pairwise(bands):
        if one.sex == other.sex and other.years[0] < one.years[1]:
            raise ConfigError(
                f"population {path}: the bands of {one.sex} people from {one.years[0]:g} and {other.years[0]:g} years overlap",
                hint="years_to is where the next band may begin",
            )
    return Population(name, tuple(bands), is_curve)


_BAND_COLUMNS = ("sex", "years_from", "years_to", "measure", "unit", "mean", "sd")
_CURVE_COLUMNS = ("sex", "years", "measure", "unit", "L", "M", "S")


class _Row(NamedTuple):
    """A row of a population's file: whose, what, and the values (m, kg) at `_SCORES`."""

    key: tuple[str, float, float]
    measure: str
    share: float | None
    values: Floats
    r_with_stature: float | None


def _row(row: Mapping[str, str | None], *, is_curve: bool) -> _Row:
    def number(column: str, default: float | None = None) -> float:
        text = (row.get(column) or "").strip()
        if not text and default is not None:
            return default
        try:
            value = float(text)
        except ValueError:
            value = math.nan
        if not math.isfinite(value):
            raise ConfigError(f"{column} is '{text}', which is no number", hint="numbers with a decimal point")
        return value

    sex, measure, unit = ((row.get(column) or "").strip() for column in ("sex", "measure", "unit"))
    if sex not in get_args(Sex):
        raise unknown_name("sex", sex, get_args(Sex))
    if measure not in _UNITS:
        raise unknown_name("measure", measure, tuple(_UNITS))
    if unit not in _UNITS[measure]:
        raise unknown_name(f"unit of {measure}", unit, tuple(_UNITS[measure]))
    start = number("years" if is_curve else "years_from")
    end = start if is_curve else number("years_to")
    if start < 0.0 or (end <= start and not is_curve):
        raise ConfigError(f"people of {start:g} to {end:g} years", hint="0 <= years_from < years_to")
    share, r = number("share", math.inf), number("r_with_stature", math.inf)
    if share < 0.0 or (math.isfinite(r) and not -1.0 < r < 1.0):
        raise ConfigError("share or r_with_stature is out of range", hint="share is 0 or more, r_with_stature between -1 and 1")
    if is_curve:
        power, median, spread = number("L"), number("M"), number("S")
        spread_ok = spread > 0.0 and all(1.0 + power * spread * score > 0.0 for score in (-3.0, 3.0))
        if not (median > 0.0 and spread_ok):
            raise ConfigError("L, M and S make no distribution", hint="M and S are above 0, S is a share of M")
        base = 1.0 + power * spread * _SCORES
        values = median * (rp.exp(rp.log(base) / power) if abs(power) > 1e-9 else rp.exp(spread * _SCORES))
    else:
        values = _distribution(measure, number)
    metric = values * _UNITS[measure][unit]
    return _Row((sex, start, end), measure, share if math.isfinite(share) else None, metric, r if math.isfinite(r) else None)


def _distribution(measure: str, number: Callable[..., float]) -> Floats:
    """Values at `_SCORES`: percentiles given, the others by mean and SD: stature's normal, mass' lognormal."""
    mean, sd = number("mean"), number("sd")
    if not (mean > 0.0 and 0.0 < sd < mean / 3.0 * (2.0 if measure == "mass" else 1.0)):
        raise ConfigError(f"{measure} of {mean:g} with an SD of {sd:g}", hint="both are above 0, and the SD is no typing error")
    if measure == "mass":
        variance = float(rp.log(1.0 + (sd / mean) * (sd / mean)))
        usual = mean * rp.exp(math.sqrt(variance) * _SCORES - variance / 2)
    else:
        usual = mean + sd * _SCORES
    values = np.array([number(f"p{p}", float(u)) for p, u in zip(_PERCENTILES, usual, strict=True)])
    if not (np.diff(values) > 0.0).all():
        raise ConfigError(f"percentiles of {measure} do not rise", hint="p1 < p5 < ... < p99; leave out those that are not known")
    return _with_sd(values, sd)


def _with_sd(values: Floats, sd: float) -> Floats:
    """Values at `_SCORES` with the ends, beyond the 5th and 95th percentiles, so long that the standard deviation is `sd`."""
    scores = np.clip(np.linspace(-4.0, 4.0, 321), -_FARTHEST, _FARTHEST)
    weight = rp.exp(-0.5 * np.square(np.linspace(-4.0, 4.0, 321)))
    weight = weight / rp.matmul(weight, np.ones(len(weight)))
    ends = np.array([values[0] - values[1], *np.zeros(len(values) - 2), values[-1] - values[-2]])
    parts = [part - rp.matmul(weight, part) for part in (_at_score(v, scores) for v in (values - ends, ends))]
    # sd^2 = a + 2 b t + c t^2, of ends t times as long
    a, b, c = (rp.matmul(weight, x * y) for x, y in ((parts[0], parts[0]), (parts[0], parts[1]), (parts[1], parts[1])))
    root = b * b - c * (a - sd * sd)
    longer = (math.sqrt(root) - b) / c if root > 0.0 else 0.0
    return np.asarray(values + (min(max(longer, _END_LENGTHS[0]), _END_LENGTHS[1]) - 1.0) * ends)

"""How the dimensions of people go with stature and mass: means, deviations and correlations of soldiers and children.

Sources: ANSUR II (2012) from 17 years, Snyder et al. (1977) before.
"""

from __future__ import annotations

import csv
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache, cached_property
from importlib.resources import files
from types import MappingProxyType
from typing import Literal, TypeAlias, get_args

import numpy as np

from cabinpose.core import Floats
from cabinpose.core import reproducible as rp

# What is measured, and how: names and definitions of ANSUR II, with what stands for its landmarks on a mesh.
DIMENSIONS = MappingProxyType(
    {
        "sitting_height": "sitting, the pelvis 15° back: from the lowest skin of buttocks and thighs to the top of the head,"
        " less 2 % of the stature",
        "buttock_knee_length": "sitting: from the rearmost skin of the buttocks to the foremost of the knee",
        "knee_height_sitting": "sitting: from the sole to the highest skin above the kneecap",
        "biacromial_breadth": "sitting: between the skin over the two acromia",
        "bideltoid_breadth": "sitting: across the upper arms, which hang as near to the trunk as flesh lets them",
        "hip_breadth_sitting": "sitting: across hips and thighs, at their broadest",
        "acromion_radiale_length": "standing: from the skin over the acromion to 15.5 mm below the elbow joint, arm down",
        "radiale_stylion_length": "from the elbow joint to the wrist joint",
        "hand_length": "from the wrist joint to the tip of the middle finger, hand flat",
        "foot_length": "from the heel to the foremost toe",
        "head_breadth": "above the ears, at its broadest",
        "head_circumference": "above the brows, as a tape lies around the head: the hull's",
    }
)
Sex: TypeAlias = Literal["male", "female"]


@dataclass(frozen=True)
class Proportions:
    """How other dimensions go with stature and mass, by sex: means and standard deviations (m, kg) by age, and correlations.

    The names are stature, mass and `DIMENSIONS`. The correlations are those of adults.
    """

    years: Mapping[Sex, Floats]  # (A,)
    mean: Mapping[Sex, Floats]  # (A, 14)
    sd: Mapping[Sex, Floats]  # (A, 14)
    correlation: Mapping[Sex, Floats]  # (14, 14)

    @cached_property
    def _conditional(self) -> Mapping[Sex, tuple[Floats, Floats]]:
        """Of the dimensions' scores: regression on those of stature and mass (12, 2), and what mixes the rest (12, 12)."""
        result = {}
        for sex, r in self.correlation.items():
            slope = rp.solve(r[:2, :2], r[:2, 2:]).T
            result[sex] = slope, _cholesky(r[2:, 2:] - rp.matmul(slope, r[:2, 2:]))
        return result

    def dimensions_m(self, sex: Sex, years: float, sizes: tuple[float, float], scores: Floats) -> tuple[float, ...]:
        """Dimensions (m) of somebody of a stature (m) and mass (kg); scores (12,): how unusual they are for both."""
        mean, sd = (np.array([np.interp(years, self.years[sex], v) for v in table[sex].T]) for table in (self.mean, self.sd))
        slope, triangle = self._conditional[sex]
        size = np.clip((np.array(sizes) - mean[:2]) / sd[:2], -4.5, 4.5)
        return tuple((mean[2:] + sd[2:] * (rp.matmul(slope, size) + rp.matmul(triangle, scores))).tolist())


def _cholesky(a: Floats) -> Floats:
    """The lower triangle whose product with its transpose is a (N, N)."""
    out = np.zeros_like(a)
    for i in range(len(a)):
        for j in range(i + 1):
            rest = a[i, j] - rp.matmul(out[i], out[j])
            out[i, j] = math.sqrt(rest) if i == j else rest / out[j, j]
    return out


@cache
def proportions() -> Proportions:
    """The packaged proportions, read once per process."""
    names = ("stature", "mass", *DIMENSIONS)
    folder = files("cabinpose.scene.body") / "assets" / "populations"
    texts = ((folder / f"{name}.csv").read_text(encoding="utf-8") for name in ("proportions", "correlations"))
    tables = [list(csv.DictReader(text.splitlines())) for text in texts]
    units = np.array([1.0 if name == "mass" else 1e-3 for name in names])

    def numbers(table: int, sex: str, columns: Sequence[str]) -> Floats:
        return np.array([[float(row[column]) for column in columns] for row in tables[table] if row["sex"] == sex])

    sexes: tuple[Sex, ...] = get_args(Sex)
    return Proportions(
        {sex: numbers(0, sex, ["years"])[:, 0] for sex in sexes},
        {sex: numbers(0, sex, [f"{name}_mean" for name in names]) * units for sex in sexes},
        {sex: numbers(0, sex, [f"{name}_sd" for name in names]) * units for sex in sexes},
        {sex: numbers(1, sex, names) for sex in sexes},
    )

"""Write the packaged populations from the published tables: `python tools/make_populations.py DATA [--out DIR]`.

DATA is a folder with the tables as their README there describes them: ANSUR II (persons), NHANES 2017-2018 (persons with survey
weights), CDC 2000 (L, M, S) and Snyder 1977 (statistics). Written are, into `src/cabinpose/scene/body/assets/populations`:

 ansur.csv, nhanes.csv   stature and mass by sex and age band: share, mean, SD, percentiles, correlation (docs/populations.md)
 cdc.csv                 L, M, S of length or stature and mass from birth to 20 years, every half year, in the first more often
 proportions.csv         mean and SD of every dimension by sex and age: `infants`, Snyder 1977 to 17 years, ANSUR II from then on
 correlations.csv        of stature, mass and the dimensions within the age bands of ANSUR II, by sex

and beside that folder `volumes.npy`, how heavy which phenotype is: anew after `tools/export_body.py`.
"""

from __future__ import annotations

import argparse
import csv
import gzip
import io
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from cabinpose.scene.body.fitting import VOLUMES, tabulate_volumes

Array = NDArray[np.float64]
ROOT = Path(__file__).resolve().parents[1]
PERCENTILES = (1, 5, 10, 25, 50, 75, 90, 95, 99)
CELL_HEADER = (
    "sex", "years_from", "years_to", "share", "measure", "unit", "mean", "sd", *(f"p{p}" for p in PERCENTILES), "r_with_stature",
)  # fmt: skip
SEXES = {"M": "male", "F": "female"}
# Ours, ANSUR II's and Snyder's name of each measure.
MEASURES = (
    ("stature", "stature", "stature"),
    ("mass", "mass_kg", "mass"),
    ("sitting_height", "sittingheight", "sitting_height_erect"),
    ("buttock_knee_length", "buttockkneelength", "buttock_knee_length"),
    ("knee_height_sitting", "kneeheightsitting", "knee_height_sitting"),
    ("biacromial_breadth", "biacromialbreadth", "biacromial_breadth"),
    ("bideltoid_breadth", "bideltoidbreadth", "shoulder_breadth"),
    ("hip_breadth_sitting", "hipbreadthsitting", "hip_breadth_seated"),
    ("acromion_radiale_length", "acromionradialelength", "acromion_radiale_length"),
    ("radiale_stylion_length", "radialestylionlength", "radiale_stylion_length"),
    ("hand_length", "handlength", "hand_length"),
    ("foot_length", "footlength", "foot_length"),
    ("head_breadth", "headbreadth", "head_breadth"),
    ("head_circumference", "headcircumference", "head_circumference"),
)
ANSUR_BANDS = ((17, 20), (20, 30), (30, 40), (40, 50), (50, 59))
NHANES_BANDS = (*((year, year + 1) for year in range(2, 20)), *((year, year + 10) for year in range(20, 80, 10)), (80, 81))
CDC_YEARS = np.sort(np.append(np.arange(0.0, 20.01, 0.5), np.array([1, 2, 3, 4, 5, 9]) / 12))
INFANT_GROUPS = {"0-2": 1.5, "3-5": 4.5, "6-8": 7.5, "9-11": 10.5, "12-15": 14.0, "16-19": 18.0, "20-23": 22.0}  # months
# Of what is measured of infants, what ours is as in the youngest children: our measure, theirs; None: a share of the stature.
OF_INFANTS = {
    "sitting_height": None, "buttock_knee_length": "rump_knee_length", "knee_height_sitting": "knee_sole_length",
    "biacromial_breadth": None, "bideltoid_breadth": None, "hip_breadth_sitting": "hip_breadth",
    "acromion_radiale_length": "shoulder_elbow_length", "radiale_stylion_length": "elbow_hand_length",
    "hand_length": "hand_length", "foot_length": "foot_length", "head_breadth": "head_circumference",
    "head_circumference": "head_circumference",
}  # fmt: skip
# Sitting height over length: medians of the Dutch growth study at 0, 0.5, 1, 2 years.
SITTING_RATIO = ((0.0, 0.5, 1.0, 2.0), (0.69, 0.67, 0.65, 0.60))
LAST_SNYDER_YEAR = 16  # completed; ANSUR II begins with 17


def rows_of(path: Path) -> list[dict[str, str]]:
    """The rows of a CSV, compressed or not."""
    data = path.read_bytes()
    return list(csv.DictReader(io.StringIO((gzip.decompress(data) if path.suffix == ".gz" else data).decode("utf-8"))))


def column(rows: Sequence[dict[str, str]], name: str) -> Array:
    """Numbers of a column; NaN where a cell is empty."""
    return np.array([float(row[name] or "nan") for row in rows])


def weighted(values: Array, weights: Array) -> tuple[float, float, Array]:
    """Mean, standard deviation and `PERCENTILES` of a sample with weights; a percentile lies between the middles of two ranks."""
    mean = float(np.average(values, weights=weights))
    sd = float(np.sqrt(np.average((values - mean) ** 2, weights=weights) * len(values) / (len(values) - 1)))
    order = np.argsort(values, kind="stable")
    middle = (np.cumsum(weights[order]) - weights[order] / 2) / weights.sum()
    return mean, sd, np.interp(np.array(PERCENTILES) / 100, middle, values[order])


def cells(
    rows: Sequence[dict[str, str]], bands: Sequence[tuple[int, int]], stature_cm: Array, weights: Array
) -> Iterator[list[str]]:
    """Rows of a population by sex and band of completed years."""
    sex, years, mass = np.array([row["sex"] for row in rows]), column(rows, "age_y"), column(rows, "mass_kg")
    both = np.isfinite(stature_cm) & np.isfinite(mass)
    total = weights[(years >= bands[0][0]) & (years < bands[-1][1])].sum()
    for letter, name in SEXES.items():
        for first, end in bands:
            band = (sex == letter) & (years >= first) & (years < end)
            pair = np.stack([stature_cm[both & band], np.log(mass[both & band])])
            cov = np.cov(pair, aweights=weights[both & band])
            r = cov[0, 1] / np.sqrt(cov[0, 0] * cov[1, 1])
            for measure, unit, values in (("stature", "cm", stature_cm), ("mass", "kg", mass)):
                known = band & np.isfinite(values)
                mean, sd, percentiles = weighted(values[known], weights[known])
                yield [
                    name, str(first), str(end), f"{weights[band].sum() / total:.5f}", measure, unit, f"{mean:.2f}", f"{sd:.3f}",
                    *(f"{p:.2f}" for p in percentiles), f"{r:.3f}" if measure == "mass" else "",
                ]  # fmt: skip


def growth(data: Path, snyder: Sequence[dict[str, str]]) -> Iterator[list[str]]:
    """Rows of CDC 2000: length to two years, stature from then on, and mass; its correlation with stature is Snyder's."""
    tables = (
        ("stature", "cm", "length_0_36m", 0, 23),
        ("stature", "cm", "stature_24_240m", 24, 240),
        ("mass", "kg", "weight_0_240m", 0, 240),
    )
    for letter, name in SEXES.items():
        mass = [row for row in snyder if row["sex"] == letter and row["measure"] == "mass" and row["r_with_stature"]]
        for measure, unit, table, first, last in tables:
            rows = [row for row in rows_of(data / f"cdc2000_{table}.csv") if row["sex"] == letter]
            month = column(rows, "age_months")
            for year in CDC_YEARS:
                if first <= year * 12 <= last:
                    lms = (np.interp(year * 12, month, column(rows, key)) for key in "LMS")
                    r = np.interp(year, column(mass, "mean_age"), column(mass, "r_with_stature"))
                    yield [name, f"{year:g}", measure, unit, *(f"{x:.6g}" for x in lms), f"{r:.3f}" if measure == "mass" else ""]


def local_parabola(at: float, x: Array, y: Array, n: Array) -> float:
    """The value at `at` of the parabola through the five nearest points, each with the weight of its n."""
    near = np.argsort(np.abs(x - at), kind="stable")[:5]
    return float(np.polyval(np.polyfit(x[near] - at, y[near], 2, w=np.sqrt(n[near])), 0.0))


def infants(data: Path, letter: str, two: Sequence[float]) -> Iterator[tuple[float, list[float]]]:
    """Years, and means and SDs (mm, kg) of every measure, from birth to 22 months; two: those of the children of two years.

    Stature and mass are CDC's. Lengths are Snyder's of both sexes, in proportion to CDC's length of this one; what the measures
    call otherwise is taken in the proportion that it has at two years (`OF_INFANTS`), what infants lack in proportion to stature,
    as has the SD. At birth lengths have the proportions of the first group. Head circumference is CDC's.
    """
    snyder = rows_of(data / "snyder1977_infants_0_23m.csv")
    children = {
        r["measure"]: float(r["mean"])
        for r in rows_of(data / "snyder1977_stats_2_18y.csv")
        if r["sex"] == letter and r["age_years_completed"] == "2"
    }
    children |= {"rump_knee_length": children["buttock_knee_length"], "knee_sole_length": children["knee_height_sitting"]}
    children["hip_breadth"] = children["hip_breadth_trochanter"]

    def cdc(table: str, sex: str, month: float) -> tuple[float, float]:
        rows = [
            row for row in rows_of(data / f"cdc2000_{table}_{'240' if table == 'weight_0' else '36'}m.csv") if row["sex"] == sex
        ]
        median, spread = (float(np.interp(month, column(rows, "age_months"), column(rows, key))) for key in "MS")
        return median, median * spread

    names = [name for name, _, _ in MEASURES]
    spread = {name: two[2 * i + 1] / two[2 * i] for i, name in enumerate(names)}
    for month in (0.0, *INFANT_GROUPS.values()):
        length, length_sd = cdc("length_0", letter, month)
        mass, mass_sd = cdc("weight_0", letter, month)
        head, head_sd = cdc("head_circumference_0", letter, month)
        group = max(month, INFANT_GROUPS["0-2"])
        both = 0.5 * (cdc("length_0", "M", group)[0] + cdc("length_0", "F", group)[0])
        means = {"stature": 10.0 * length, "mass": mass, "head_circumference": 10.0 * head}
        for name, theirs in OF_INFANTS.items():
            if theirs is None:
                share = two[2 * names.index(name)] / two[0]
                means[name] = 10.0 * length * (np.interp(month / 12, *SITTING_RATIO) if name == "sitting_height" else share)
            elif theirs == "head_circumference":
                means[name] = 10.0 * head * two[2 * names.index(name)] / two[2 * names.index(theirs)]
            else:
                rows = [row for row in snyder if row["measure"] == theirs]
                at = [INFANT_GROUPS[row["age_months_group"]] for row in rows]
                mean = float(np.interp(group, at, column(rows, "mean_cm")))
                means[name] = 10.0 * mean * length / both * children[names_in_children(name)] / children[theirs]
        sds = {"stature": 10.0 * length_sd, "mass": mass_sd, "head_circumference": 10.0 * head_sd}
        yield month / 12, [x for name in names for x in (means[name], sds.get(name, means[name] * spread[name]))]


def names_in_children(name: str) -> str:
    """Snyder's name, in the table of children, of one of our measures."""
    return next(theirs for ours, _, theirs in MEASURES if ours == name)


def proportions(data: Path, ansur: Sequence[dict[str, str]], snyder: Sequence[dict[str, str]]) -> Iterator[list[str]]:
    """Rows of means and SDs (mm, kg) by sex and age: infants, Snyder's smoothed over five years of age, ANSUR II's bands."""
    sex, years = np.array([row["sex"] for row in ansur]), column(ansur, "age_y")
    for letter, name in SEXES.items():
        table = []
        for _, _, measure in MEASURES:
            rows = [r for r in snyder if (r["sex"], r["measure"]) == (letter, measure) and r["age_years_completed"] != "18+"]
            rows.sort(key=lambda row: int(row["age_years_completed"]))
            table.append(tuple(column(rows, key) for key in ("mean_age", "n", "mean", "sd")))
        for year in range(2, LAST_SNYDER_YEAR + 1):
            pairs = [local_parabola(year + 0.5, age, values, n) for age, n, *both in table for values in both]
            if year == 2:
                for age, values in infants(data, letter, pairs):
                    yield [name, f"{age:.4g}", *(f"{x:.2f}" for x in values)]
            yield [name, f"{year + 0.5:g}", *(f"{x:.2f}" for x in pairs)]
        for first, end in ANSUR_BANDS:
            rows = [row for row, use in zip(ansur, (sex == letter) & (years >= first) & (years < end), strict=True) if use]
            pairs = []
            for _, measure, _ in MEASURES:
                values = column(rows, measure if measure == "mass_kg" else measure + "_mm")
                pairs += [values.mean(), values.std(ddof=1)]
            yield [name, f"{column(rows, 'age_y').mean() + 0.5:.2f}", *(f"{x:.2f}" for x in pairs)]


def correlations(ansur: Sequence[dict[str, str]]) -> Iterator[list[str]]:
    """Rows of correlations within the age bands."""
    sex, years = np.array([row["sex"] for row in ansur]), column(ansur, "age_y")
    values = np.stack([column(ansur, m if m == "mass_kg" else m + "_mm") for _, m, _ in MEASURES], axis=1)
    for letter, name in SEXES.items():
        parts = [values[(sex == letter) & (years >= first) & (years < end)] for first, end in ANSUR_BANDS]
        matrix = np.corrcoef(np.concatenate([part - part.mean(axis=0) for part in parts]).T)
        for (measure, _, _), row in zip(MEASURES, matrix, strict=True):
            yield [name, measure, *(f"{r:.4f}" for r in row)]


def main() -> None:
    """Write the five files."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("data", type=Path)
    parser.add_argument("--out", type=Path, default=ROOT / "src/cabinpose/scene/body/assets/populations")
    args = parser.parse_args()
    ansur, snyder = rows_of(args.data / "ansur2_reduced.csv.gz"), rows_of(args.data / "snyder1977_stats_2_18y.csv")
    nhanes = [row for row in rows_of(args.data / "nhanes_2017_2018_reduced.csv.gz") if row["pregnant"] != "1"]
    names = [name for name, _, _ in MEASURES]
    written = {
        "ansur": (CELL_HEADER, cells(ansur, ANSUR_BANDS, column(ansur, "stature_mm") / 10, np.ones(len(ansur)))),
        "nhanes": (CELL_HEADER, cells(nhanes, NHANES_BANDS, column(nhanes, "stature_cm"), column(nhanes, "weight_mec2yr"))),
        "cdc": (("sex", "years", "measure", "unit", "L", "M", "S", "r_with_stature"), growth(args.data, snyder)),
        "proportions": (
            ("sex", "years", *(f"{n}_{what}" for n in names for what in ("mean", "sd"))),
            proportions(args.data, ansur, snyder),
        ),
        "correlations": (("sex", "measure", *names), correlations(ansur)),
    }
    args.out.mkdir(parents=True, exist_ok=True)
    for name, (header, rows) in written.items():
        with (args.out / f"{name}.csv").open("w", encoding="utf-8", newline="") as stream:
            csv.writer(stream, lineterminator="\n").writerows([header, *rows])
        print(f"{args.out / name}.csv")
    np.save(args.out.parent / VOLUMES, tabulate_volumes())


if __name__ == "__main__":
    main()

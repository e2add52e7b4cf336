"""What smoothing over time does to a detector's joints: how much they shake, lag and are off, beside the truth's own.

    cabinpose predict SEQUENCES --model in_car --out found.jsonl
    python tools/smoothing_table.py SEQUENCES found.jsonl > smoothing.json

Of joints in the image that were found, in 3D, of all frames that have two before them in their sequence: median and mean length
of the second difference (mm per frame²). Of all frames: the lag (ms) by which joints follow the truth, the slope of their errors
over its velocities, both about their means over a sequence, where joints are less than 20 cm off; median error (cm); share within
10 cm (%); PCKh@0.5 in 2D (%) as `cabinpose evaluate` has it. A JSON object on stdout, a table on stderr.
"""

from __future__ import annotations

import argparse
import json
import sys
import time

import numpy as np
import xarray as xr
from numpy.typing import NDArray

import cabinpose
from cabinpose.core import Visibility
from cabinpose.estimate import make_smoother, smoothed
from cabinpose.evaluate import EvaluationOptions
from cabinpose.store import Predictions

PRESENT, FAR_M = 0.5, 0.2
ROWS = (("one-euro", None), ("fixed-lag", 1), ("fixed-lag", 2), ("fixed-lag", 3), ("fixed-lag", 4), ("fixed-lag", 6))

Array = NDArray[np.float64]


def figures(found: Array, true: Array, counts: NDArray[np.bool_], sequence: NDArray[np.int64], at_s: Array) -> dict[str, float]:
    """found, true: (F, P, J, 3) m · counts: (F, P, J) which joints are judged · sequence, at_s: (F,)."""
    inside = counts[2:] & counts[1:-1] & counts[:-2] & (sequence[2:] == sequence[:-2])[:, None, None]
    shakes = 1e3 * np.linalg.norm(np.diff(found, 2, axis=0), axis=-1)[inside]
    off = np.linalg.norm(found - true, axis=-1)[counts]
    covariance = variance = 0.0
    for each in np.unique(sequence):
        rows = np.flatnonzero(sequence == each)
        velocity, error = np.gradient(true[rows], at_s[rows], axis=0), found[rows] - true[rows]
        near = counts[rows] & (np.linalg.norm(error, axis=-1) < FAR_M)
        count = np.maximum(near.sum(axis=0), 1)[..., None]
        about = [
            np.where(near[..., None], x - np.where(near[..., None], x, 0.0).sum(axis=0) / count, 0.0) for x in (velocity, error)
        ]
        covariance, variance = covariance + (about[0] * about[1]).sum(), variance + (about[0] ** 2).sum()
    return {
        "median_mm_per_frame2": float(np.median(shakes)),
        "mean_mm_per_frame2": float(shakes.mean()),
        "lag_ms": -1e3 * covariance / variance,
        "median_cm": 1e2 * float(np.median(off)),
        "within_10cm": 1e2 * float((off < 0.1).mean()),
    }


def pckh(dataset: xr.Dataset, found: Predictions) -> dict[str, float]:
    """Of the places that the detector answers for."""
    options = EvaluationOptions(resamples=0)
    value = cabinpose.evaluate_predictions(dataset, found, persons=found.persons, options=options).value(
        "PCKh", "2d", threshold=0.5
    )
    return {} if value is None else {"pckh_2d": value.value}


def main() -> None:
    """Measure every smoother on one dataset and its predictions."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("dataset")
    parser.add_argument("predictions")
    arguments = parser.parse_args()
    dataset, found = cabinpose.open_dataset(arguments.dataset), cabinpose.open_predictions(arguments.predictions)
    truth = dataset.sel(person=list(found.persons), joint=list(found.joints))
    sync_ns, sequence = (dataset[name].values.astype(np.int64) for name in ("sync_ns", "sequence"))
    true = truth["joints_3d"].values.astype(np.float64)
    counts = (truth["visibility"].values > Visibility.OUTSIDE_IMAGE) & (found.presence >= PRESENT)
    counts &= np.isfinite(true).all(axis=-1) & np.isfinite(found.joints_3d).all(axis=-1)
    result = {"truth": figures(true, true, counts, sequence, 1e-9 * sync_ns)}
    as_found = figures(found.joints_3d.astype(np.float64), true, counts, sequence, 1e-9 * sync_ns)
    result["as found"] = as_found | pckh(dataset, found)
    for name, lag in ROWS:
        smoother, began = make_smoother(name, lag), time.process_time()
        smooth = smoothed(found, sync_ns, sequence, smoother)
        took = 1e3 * (time.process_time() - began) / max(len(sequence), 1)
        now = figures(smooth.joints_3d.astype(np.float64), true, counts, sequence, 1e-9 * sync_ns)
        result[smoother.name] = now | pckh(dataset, smooth) | {"later_frames": smoother.lag, "cpu_ms": took}
    for name, row in result.items():
        print(f"{name:12}", *(f"{key} {value:.2f}" for key, value in row.items()), file=sys.stderr)
    json.dump(result, sys.stdout)


if __name__ == "__main__":
    main()

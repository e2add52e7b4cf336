"""ITOP's protocol: the 15 joints of every valid frame, the share within 10 cm, and the mean error.

What the literature calls "mAP at 10 cm" is the share of all joints of valid frames within 10 cm: a PCK. Nothing of
the truth goes into a prediction here: no true body centre, no true depth.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from cabinpose.core import ITOP, PoseBatch, PredictionsError, Visibility
from cabinpose.evaluate.errors import finite
from cabinpose.evaluate.options import EvaluationOptions
from cabinpose.evaluate.report import Report, make_report
from cabinpose.evaluate.samples import TruthChunk, collect
from cabinpose.store import ItopReference, project


def evaluate_itop(
    reference: ItopReference, joints_3d: NDArray[np.floating], options: EvaluationOptions, *,
    joints_2d: NDArray[np.floating] | None = None, model: str = "", name: str = "ITOP",
) -> Report:  # fmt: skip
    """The report of predictions on ITOP. Every joint of a valid frame counts: ITOP labels hidden ones too.

    A joint without a label (NaN) is absent, and one that is found there is a false positive.

    Parameters
    ----------
    reference
        ITOP's labels. Frames that are not valid are left out and counted in the notes.
    joints_3d
        (F, 15, 3) m in our camera frame, NaN where a joint was not found.
    options
        Thresholds and intervals.
    joints_2d
        (F, 15, 2) px in ITOP's 320x240 frame; None: projected from joints_3d.
    model, name
        What the report calls the model and the dataset.

    Returns
    -------
    Report
        `itop_summary` picks the numbers that the literature compares.

    Raises
    ------
    PredictionsError
        Where the shapes do not fit.
    """
    if joints_3d.shape != reference.joints_3d.shape:
        raise PredictionsError(
            f"predictions of the shape {joints_3d.shape} for a reference of {reference.joints_3d.shape}",
            hint="give 15 joints of 3 coordinates for every frame of the reference, in its order",
        )
    valid = reference.valid
    true, predicted = reference.joints_3d[valid], joints_3d[valid].astype(np.float64)
    predicted_2d = project(predicted) if joints_2d is None else joints_2d[valid]
    found = finite(predicted)[:, None].astype(np.float32)
    labelled = finite(true)[:, None]
    truth = TruthChunk(
        reference.frame[valid],
        project(true)[:, None].astype(np.float32),
        true[:, None].astype(np.float32),
        np.where(labelled, Visibility.VISIBLE, Visibility.ABSENT).astype(np.uint8),
        np.arange(len(true)),  # valid frames are no unbroken sequence: no jitter
        np.zeros(len(true), np.int64),
    )
    batch = PoseBatch(predicted_2d[:, None].astype(np.float32), predicted[:, None].astype(np.float32), found, found)
    person = ("person",)
    samples = collect([(truth, batch)], ITOP, person, person, replace(options, match="slot"))
    which = "all 15 joints" if labelled.all() else "the labelled joints"
    notes = (f"{int(valid.sum())} valid of {len(valid)} frames; {which} of each count, hidden ones too",)
    return make_report(samples, options, model, name, notes)


def itop_summary(report: Report) -> dict[str, float | int]:
    """The numbers that the literature compares: per cent of all joints, cm, px."""

    def number(metric: str, space: str, threshold: float | None = None) -> float:
        found = report.value(metric, space, threshold=threshold)
        return float("nan") if found is None else found.value

    return {
        "frames": report.frames,
        "within_10cm": number("PCK", "3d", 10.0),
        "mean_cm": number("MPJPE", "3d"),
        "pck_2d_26px": number("PCK", "2d", 26.0),
        "mean_2d_px": number("mean error", "2d"),
    }

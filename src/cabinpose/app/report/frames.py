"""Typical and worst frames: truth and prediction drawn over the depth image."""

from __future__ import annotations

import base64
from collections.abc import Sequence
from html import escape

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from cabinpose.app.view.draw import depth_image, jpeg
from cabinpose.app.view.sheet import caption
from cabinpose.core.ports import PoseBatch, Predictor
from cabinpose.core.pose import Visibility
from cabinpose.evaluate.offline import frame_batch
from cabinpose.evaluate.options import EvaluationOptions
from cabinpose.evaluate.report import ALL, Report
from cabinpose.evaluate.skeletons import EvaluatedSkeleton, evaluated_skeleton
from cabinpose.store.predictions import Predictions

TRUTH, PREDICTION, ERROR = "#ffffff", "#ff9f1c", "#ff3b3b"
_HALF = 0.5  # a pixel's centre is a whole number for us, half of one for SVG


def _answer(dataset: xr.Dataset, model: Predictions | Predictor, number: int) -> PoseBatch:
    """What a model says of the frame of this number."""
    if isinstance(model, Predictions):
        return model.take(np.array([number]))
    return model.predict(frame_batch(dataset.sel(frame=[number]), slice(0, 1)))


def frame_figures(
    dataset: xr.Dataset, report: Report, model: Predictions | Predictor, options: EvaluationOptions, numbers: Sequence[int]
) -> list[str]:
    """Figures of the frames of these numbers; none where the dataset has no depth."""
    if "depth" not in dataset:
        return []
    skeleton = evaluated_skeleton(report.joint_sets[ALL])
    columns = [model.joints.index(name) for name in skeleton.joints]
    small = [str(n) for n in dataset.data_vars if "y" not in dataset[n].dims]
    wanted = dataset[[*small, "depth"]].sel(joint=list(skeleton.joints))
    figures = []
    for number in numbers:
        batch = _answer(dataset, model, number)
        uv = np.where(batch.presence[..., None] >= options.presence, batch.joints_2d, np.nan)[0][:, columns]
        if options.match == "slot":  # in the order of the dataset's people, so that each joint has its true one
            uv = uv[[model.persons.index(p) for p in dataset["person"].values.tolist() if p in model.persons]]
        figures.append(overlay(wanted.sel(frame=number).load(), skeleton, uv, model.persons, options.match == "slot"))
    return figures


def overlay(
    frame: xr.Dataset, skeleton: EvaluatedSkeleton, predicted: NDArray[np.float32], persons: Sequence[str], matched: bool
) -> str:
    """One frame as a figure: joints of truth (white) and prediction (orange), in px.

    frame: in memory, with the joints of `skeleton` · predicted: (P, J, 2), NaN where not found · matched: the predicted
    people are those of `persons`, in the dataset's order; then a red line goes from each joint to where it was put.
    """
    height, width = frame["depth"].shape
    true = np.where(frame["visibility"].values[..., None] > Visibility.OUTSIDE_IMAGE, frame["joints_2d"].values, np.nan)
    parts = [f'<image href="{_picture(frame["depth"].values)}" width="{width}" height="{height}"/>']
    if matched:
        mine = true[[i for i, name in enumerate(frame["person"].values.tolist()) if name in persons]]
        ends = zip(mine.reshape(-1, 2), predicted.reshape(-1, 2), strict=True)
        parts += [_segment(a, b, ERROR, 1.2) for a, b in ends if np.isfinite(a + b).all()]
    for people, colour in ((true, TRUTH), (predicted, PREDICTION)):
        for uv in people:
            parts += [_segment(uv[a], uv[b], colour, 1.9) for a, b in skeleton.limbs if np.isfinite(uv[a] + uv[b]).all()]
            dots = uv[np.isfinite(uv).all(axis=1)] + _HALF
            parts += [f'<circle cx="{u:.1f}" cy="{v:.1f}" r="2.6" fill="{colour}"/>' for u, v in dots]
    drawing = f'<svg viewBox="0 0 {width} {height}" class="frame">{"".join(parts)}</svg>'
    return f"<figure>{drawing}<figcaption>{escape(caption(frame))}</figcaption></figure>"


def _picture(depth_m: NDArray[np.float32]) -> str:
    """The depth in colours as a data URI."""
    valid = depth_m[np.isfinite(depth_m)]
    near, far = np.quantile(valid, (0.01, 0.99)).tolist() if valid.size else (0.0, 1.0)
    image = depth_image(depth_m, near, far)
    return "data:image/jpeg;base64," + base64.b64encode(jpeg(image, 85)).decode("ascii")


def _segment(a: NDArray[np.float32], b: NDArray[np.float32], colour: str, width: float) -> str:
    (u1, v1), (u2, v2) = a + _HALF, b + _HALF
    return f'<line x1="{u1:.1f}" y1="{v1:.1f}" x2="{u2:.1f}" y2="{v2:.1f}" stroke="{colour}" stroke-width="{width}"/>'

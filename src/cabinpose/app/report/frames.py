"""Typical and worst frames: truth and prediction drawn over the depth image."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from cabinpose.app.report.charts import line, svg
from cabinpose.app.report.cloud_views import cloud_views
from cabinpose.app.report.html import Html, el, figure, picture_uri
from cabinpose.app.view.draw import INVALID, depth_image, depth_range
from cabinpose.app.view.sheet import caption
from cabinpose.core import SKELETONS, PoseBatch, Predictor, Skeleton, Visibility, images_of, skeleton_with
from cabinpose.evaluate import ALL, EvaluationOptions, Report, frame_batch, truth_of
from cabinpose.store import Predictions, joint_dimension

TRUTH, PREDICTION, ERROR = "#ffffff", "#ff9f1c", "#ff3b3b"
_HALF = 0.5  # pixel centres are whole numbers in this package, halves in SVG


def frame_figures(
    dataset: xr.Dataset, report: Report, model: Predictions | Predictor, options: EvaluationOptions, numbers: Sequence[int]
) -> list[Html]:
    """Figures of the frames of these numbers, of a model in 3D in their clouds as well; none where the dataset has no depth."""
    if "depth" not in dataset:
        return []
    skeleton, figures = skeleton_with(report.joint_sets[ALL], report.skeleton), []
    for number in numbers:
        shown = shown_frame(dataset, skeleton, model, options, number)
        frame, found = shown.frame, shown.found
        figures.append(
            overlay(frame, skeleton, shown.uv, model.persons, options.match == "slot", points=None if shown.flat else found)
        )
        if np.isfinite(found).any():
            views = cloud_views(frame, skeleton.limbs, [(frame["joints_3d"].values, TRUTH), (found, PREDICTION)])
            figures.append(figure(views, f"frame {number} in its cloud"))
    return figures


class ShownFrame(NamedTuple):
    """A frame in memory with the joints of a skeleton, and those found: uv (P, J, 2) px, found (P, J, 3) m, NaN where not.

    flat: whether any joint is found in the image; a model of 3D joints alone shows from the side.
    """

    frame: xr.Dataset
    uv: NDArray[np.float32]
    found: NDArray[np.float32]
    flat: bool


def shown_frame(
    dataset: xr.Dataset, skeleton: Skeleton, model: Predictions | Predictor, options: EvaluationOptions, number: int
) -> ShownFrame:
    """The frame of a number, as `overlay` draws it, with what a model finds in it; matched by slot in the dataset's order."""
    columns = [model.joints.index(name) for name in skeleton.joints]
    away = {"y", *map(joint_dimension, SKELETONS)}
    rest = dataset.drop_vars([n for n, v in dataset.variables.items() if n != "depth" and away & set(v.dims)])
    batch = _poses(dataset, model, number)
    uv, found = (
        np.where(batch.presence[..., None] >= options.presence, joints, np.nan)[0][:, columns]
        for joints in (batch.joints_2d, batch.joints_3d)
    )
    if options.match == "slot":  # in the order of the dataset's people, so that joints correspond
        uv = uv[[model.persons.index(p) for p in dataset["person"].values.tolist() if p in model.persons]]
    truth = truth_of(dataset.sel(frame=[number]), skeleton)
    frame = rest.sel(frame=[number]).assign(truth).isel(frame=0).load()
    return ShownFrame(frame, uv, found, bool(np.isfinite(batch.joints_2d).any()))


def _poses(dataset: xr.Dataset, model: Predictions | Predictor, number: int) -> PoseBatch:
    """The poses that a model finds in the frame of this number."""
    if isinstance(model, Predictions):
        return model.take(np.array([number]))
    return model.predict(frame_batch(dataset.sel(frame=[number]), slice(0, 1), images_of(model)))


def overlay(
    frame: xr.Dataset, skeleton: Skeleton, predicted: NDArray[np.float32], persons: Sequence[str], matched: bool,
    points: NDArray[np.float32] | None = None,
) -> Html:  # fmt: skip
    """One frame as a figure, see `drawing`."""
    return figure(drawing(frame, skeleton, predicted, persons, matched, points), caption(frame))


def drawing(
    frame: xr.Dataset, skeleton: Skeleton, predicted: NDArray[np.float32], persons: Sequence[str], matched: bool,
    points: NDArray[np.float32] | None = None,
) -> Html:  # fmt: skip
    """One frame as SVG: joints of truth (white) and prediction (orange), in px.

    Parameters
    ----------
    frame
        In memory, with the joints of `skeleton`.
    skeleton
        Joints and limbs to draw.
    predicted
        (P, J, 2) px, NaN where not found.
    persons
        Slots that the model predicts.
    matched
        The predicted people are those of `persons`, in the dataset's order; a red line then joins each joint with its truth.
    points
        (P, J, 3) m, camera frame: drawn beside the image as seen from its right, the camera on the left.
    """
    depth = frame["depth"].values
    height, width = depth.shape
    true = np.where(frame["visibility"].values[..., None] > Visibility.OUTSIDE_IMAGE, frame["joints_2d"].values, np.nan)
    parts = [el("image", href=picture_uri(depth_image(depth, *depth_range(depth))), width=width, height=height)]
    if matched:
        mine = true[[i for i, name in enumerate(frame["person"].values.tolist()) if name in persons]]
        ends = zip(mine.reshape(-1, 2), predicted.reshape(-1, 2), strict=True)
        parts += [_segment(a, b, ERROR, 1.2) for a, b in ends if np.isfinite(a + b).all()]
    drawn = [(true, TRUTH), (predicted, PREDICTION)]
    wide = width
    if points is not None:
        joints = np.where(np.isfinite(true[..., :1]), frame["joints_3d"].values, np.nan)
        drawn += zip(_from_the_side(joints, points, width, height), (TRUTH, PREDICTION), strict=True)
        wide *= 2
        dark = f"rgb{INVALID}"  # truth is white
        parts.append(el("rect", x=width, y=0, width=width, height=height, fill=dark, stroke=dark))
    for people, colour in drawn:
        for uv in people:
            parts += [_segment(uv[a], uv[b], colour, 1.9) for a, b in skeleton.limbs if np.isfinite(uv[a] + uv[b]).all()]
            dots = uv[np.isfinite(uv).all(axis=1)] + _HALF
            parts += [el("circle", cx=f"{u:.1f}", cy=f"{v:.1f}", r=2.6, fill=colour) for u, v in dots]
    return svg(wide, height, parts, kind="frame")


def _from_the_side(
    true: NDArray[np.float32], predicted: NDArray[np.float32], width: int, height: int
) -> list[NDArray[np.float64]]:
    """Where joints (P, J, 3) of both are drawn, (P, J, 2) px: depth to the right, in the panel right of the image."""
    both = [points[..., [2, 1]].astype(np.float64) for points in (true, predicted)]
    known = np.concatenate([points[np.isfinite(points).all(axis=-1)] for points in both])
    if not len(known):
        return both
    low, high = known.min(axis=0), known.max(axis=0)
    scale = 0.9 * min(np.array([width, height]) / np.maximum(high - low, 0.1))
    return [(points - (low + high) / 2) * scale + (1.5 * width, 0.5 * height) for points in both]


def _segment(a: NDArray[np.float32], b: NDArray[np.float32], colour: str, width: float) -> Html:
    (u1, v1), (u2, v2) = a + _HALF, b + _HALF
    return line(u1, v1, u2, v2, stroke=colour, stroke_width=width)

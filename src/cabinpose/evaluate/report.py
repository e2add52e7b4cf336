"""The report of one model: every number with its unit, threshold, denominator, joints, sample count and interval."""

from __future__ import annotations

import warnings
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from functools import partial
from itertools import groupby
from typing import Any

import numpy as np

from cabinpose.core import CABINPOSE
from cabinpose.evaluate.bootstrap import clusters_of
from cabinpose.evaluate.boxes import Boxes, boxes_by_range
from cabinpose.evaluate.caveats import Caveats
from cabinpose.evaluate.groups import Grouping
from cabinpose.evaluate.metrics import METRICS, Metric, Value, value_among
from cabinpose.evaluate.options import EvaluationOptions
from cabinpose.evaluate.sample_view import ALL, ANY, IMAGE, SampleView, by_frames, sample_views
from cabinpose.evaluate.samples import Samples

_PCKH_GRID = np.linspace(0, 1, 51)
_ERROR_GRID = {"2d": np.linspace(0, 50, 51), "3d": np.linspace(0, 30, 61)}  # px, cm
_SHOWN = 12
_MISS = 3.0  # head sizes that a missed joint, and at most a found one, counts in the ranking of frames


@dataclass(frozen=True)
class Report:
    """Everything about one model on one dataset.

    joint_sets: joints by name of the set · curves: by space and set, the share in per cent at each point of `grid`, for PCKh
    (of the head size) and for the error (px, cm) · calibration: see `_calibration` · boxes: by space, range of the error and
    joint (px, cm) · worst: numbers of the worst frames, worst first · typical: of those nearest to the median frame, best
    first · settings: the options in words · caveats: what is to be known before all that · skeleton: the joints' set · groupings:
    the people by labels, see `groups`.
    """

    model: str
    dataset: str
    frames: int
    people: int
    joint_sets: Mapping[str, tuple[str, ...]]
    values: tuple[Value, ...]
    curves: Mapping[str, Any]
    calibration: Mapping[str, Any]
    boxes: Mapping[str, Boxes]
    worst: tuple[int, ...]
    typical: tuple[int, ...]
    settings: Mapping[str, Any]
    caveats: Caveats
    skeleton: str = CABINPOSE.name
    groupings: tuple[Grouping, ...] = ()

    @property
    def notes(self) -> tuple[str, ...]:
        """What stands out in the answers, and what the dataset's joints are where they are others than usual."""
        return self.caveats.notes

    def value(
        self, metric: str, space: str = "3d", joints: str = ALL, threshold: float | None = None, visibility: str = "any"
    ) -> Value | None:
        """The number of that name; with `threshold` left out, the first one. None if there is none."""
        return value_among(self.values, metric, space, joints, threshold, visibility)

    def to_dict(self) -> dict[str, Any]:
        """Plain data, with the notes by themselves; the set of joints is left out where it is the standard's own."""
        told = {name: value for name, value in asdict(self).items() if (name, value) != ("skeleton", CABINPOSE.name)}
        return told | {"notes": told["caveats"].pop("notes")}


def make_report(
    samples: Samples, options: EvaluationOptions, model: str, dataset: str, caveats: Caveats | tuple[str, ...] = (),
    groupings: tuple[Grouping, ...] = (),
) -> Report:  # fmt: skip
    """All numbers of one model's samples. Equal samples, options and seed give equal numbers.

    caveats: what is to be known before them, or notes alone · groupings: of these samples, see `groups.groupings`.

    A metric of another package that cannot be loaded, or that raises, is left out with a warning that names the package.
    """
    skeleton = samples.skeleton
    views = sample_views(samples, options)
    spaces = {view.space: view for view in views if view.visibility == ANY and view.space != IMAGE}
    ranked = _ranked(samples)
    clusters = len(np.unique(clusters_of(samples.sequence, samples.sync_ns)))
    middle = (len(ranked) - _SHOWN) // 2
    return Report(
        model=model,
        dataset=dataset,
        frames=len(samples.frames),
        people=int(samples.true.sum()),
        joint_sets={name: tuple(skeleton.joints[i] for i in members) for name, members in views[-1].groups.items()},
        values=tuple(_values(views)),
        calibration=_calibration(views[-1], spaces),
        curves={name: _curves(view) for name, view in spaces.items()},
        boxes={
            name: boxes_by_range(view.found_errors * view.per_unit, skeleton.joints, view.hit_shown, view.unit)
            for name, view in spaces.items()
        },
        worst=ranked[:_SHOWN],
        typical=ranked[middle : middle + _SHOWN][::-1] if middle > 0 else (),  # few frames are all among the worst
        settings={**asdict(options), "min_visibility": options.min_visibility.name.lower(), "clusters": clusters},
        caveats=caveats if isinstance(caveats, Caveats) else Caveats(len(samples.frames), len(samples.frames), notes=caveats),
        skeleton=skeleton.name,
        groupings=groupings,
    )


def _values(views: Sequence[SampleView]) -> Iterator[Value]:
    """What all metrics measure in all views; see `Metric.listed_by` for the order."""
    order = {
        "space": [view.space for view in views],
        "visibility": [view.visibility for view in views],
        "joints": list(views[-1].sets),
    }
    for fields, rows in groupby(METRICS.items(), key=lambda row: row[1].listed_by):
        values = [value for name, metric in rows for value in _measured(name, metric, views)]
        known = {field: order[field] for field in fields}
        yield from sorted(values, key=partial(_place, known))


def _place(order: Mapping[str, Sequence[str]], value: Value) -> list[int]:
    """Where a value stands by its fields; last with a name that is not in their order."""
    names = {field: getattr(value, field) for field in order}
    return [known.index(names[field]) if names[field] in known else len(known) for field, known in order.items()]


def _measured(name: str, metric: Metric, views: Sequence[SampleView]) -> list[Value]:
    """What one metric measures in all views; of another package's that raises nothing."""
    try:
        return [value for view in views for value in metric.values(view)]
    except Exception as error:
        if name in METRICS.names(own=True):
            raise
        what = f"the metric '{name}' of {METRICS.package(name)} is left out of the report"
        warnings.warn(f"{what}: {type(error).__name__}: {error}", stacklevel=1)
        return []


def _curves(view: SampleView) -> dict[str, Any]:
    """The share of the true joints, in per cent, that lie within each distance, by kind of distance and set of joints."""
    errors = view.found_errors * view.per_unit
    shares = errors / (view.head * view.per_unit)
    sized = view.counts & np.isfinite(view.head)
    result: dict[str, Any] = {}
    for kind, values, counts, grid in (
        ("pckh", shares, sized, _PCKH_GRID),
        ("error", errors, view.counts, _ERROR_GRID[view.space]),
    ):
        lines = {}
        for joints, members in view.groups.items():
            columns = list(members)
            known = np.sort(values[:, columns][np.isfinite(values[:, columns])])
            total = max(int(counts[:, columns].sum()), 1)
            lines[joints] = (100 * np.searchsorted(known, grid, side="right") / total).round(3).tolist()
        result[kind] = {"grid": grid.round(4).tolist(), "lines": lines}
    return result


def _calibration(image: SampleView, spaces: Mapping[str, SampleView]) -> dict[str, Any]:
    """How far a model's confidence can be trusted, by set of joints.

    presence: bins of presence with the share that is `in_image`, and `within` d too · surest: by space, the errors of the surest
    joints · expected_error: bins of the expected error with the mean error (cm), for each joint as well. See `calibration`.
    """
    told = {
        joints: {"in_image": in_image.to_dict(), "within": within.to_dict()}
        for joints, (in_image, within) in image.presence.items()
    }
    surest = {
        name: {joints: view.confidence[joints].of_surest(view.hit_shown) for joints in view.groups}
        for name, view in spaces.items()
    }
    expected = {joints: sure.of_expected() for joints, sure in spaces["3d"].confidence.items()} if "3d" in spaces else {}
    said = {joints: bins.to_dict() for joints, bins in expected.items() if bins.samples.any()}
    return {"presence": told, "surest": surest, "expected_error": said}


def _ranked(samples: Samples) -> tuple[int, ...]:
    """Frames that are not perfect, worst first, by the mean error of their joints in head sizes; a missed joint counts 3."""
    space = next(iter(samples.spaces().values()))
    judged = samples.counts & space.known & np.isfinite(space.head)[:, None]
    shares = np.where(judged & space.found, space.error, np.inf) / space.head[:, None]
    counted = np.where(judged, np.fmin(np.nan_to_num(shares, nan=np.inf), _MISS), 0.0)
    top, bottom = (by_frames(x.astype(np.float64), samples).sum(axis=1) for x in (counted, judged))
    mean = np.divide(top, bottom, out=np.zeros_like(top), where=bottom > 0)
    order = np.argsort(-mean, kind="stable")
    return tuple(int(samples.frames[i]) for i in order if mean[i] > 0)

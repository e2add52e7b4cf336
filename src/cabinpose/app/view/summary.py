"""What a dataset holds, in numbers."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from cabinpose.core import Visibility
from cabinpose.store import Manifest

SAMPLED_FRAMES = 60  # images read for the depth histogram
BIN_M = 0.05


@dataclass(frozen=True)
class DatasetSummary:
    """A dataset in numbers; counts are frames, except `rejections` and `proposals` (poses) and `visibility` (joints).

    The `by_…` counts, `visibility` and the depths are those of the `selected` frames, all else is of the whole dataset.
    proposals: 0 of what was not generated · acceptance: share of the poses that hold; None there, and for sequences, of which the
    file does not say how many ways were judged ·
    depth_histogram: share of the valid pixels of a sample of frames in bins of 50 mm from 0 m.
    """

    folder: str
    generator: str
    seed: int
    licence: str
    frames: int
    selected: int
    planned_frames: int
    parts: int
    planned_parts: int
    bytes_on_disk: int
    width: int
    height: int
    variables: tuple[str, ...]
    by_car: Mapping[str, int]
    by_pov: Mapping[str, int]
    by_subject: Mapping[str, int]
    by_action: Mapping[str, int]
    by_seat: Mapping[str, int]
    by_people: Mapping[str, int]
    visibility: Mapping[str, int]
    proposals: int
    rejections: Mapping[str, int]
    acceptance: float | None
    valid_pixels: float
    depth_histogram: tuple[float, ...]


def summarise(whole: xr.Dataset, manifest: Manifest, folder: Path, dataset: xr.Dataset | None = None) -> DatasetSummary:
    """Count what is in an open dataset, or in a selection of its frames, `dataset`."""
    dataset = whole if dataset is None else dataset
    subjects = dataset["subject"].values
    present = subjects != ""
    visibility = np.bincount(dataset["visibility"].values.ravel(), minlength=len(Visibility))
    rejections = dataset.attrs["rejections"]
    proposals = dataset.attrs["proposals"]
    valid, histogram = _depths(dataset)
    unknown = bool(not proposals or manifest.selection or (manifest.config.get("scene") or {}).get("sequence"))
    return DatasetSummary(
        folder=str(folder),
        generator=f"{manifest.generator} {manifest.generator_version}",
        seed=manifest.seed,
        licence=manifest.licence,
        frames=whole.sizes["frame"],
        selected=dataset.sizes["frame"],
        planned_frames=manifest.frames,
        parts=len(manifest.parts_in(folder)),
        planned_parts=len(manifest.parts),
        bytes_on_disk=sum(path.stat().st_size for path in folder.rglob("*") if path.is_file()),
        width=manifest.width,
        height=manifest.height,
        variables=tuple(v.name for v in manifest.stored if not v.coordinate),
        by_car=_counts(dataset["car"].values),
        by_pov=_counts(dataset["pov"].values),
        by_subject=_counts(subjects[present]),
        by_action=_counts(dataset["action"].values[present]),
        by_seat={slot: int(present[:, i].sum()) for i, slot in enumerate(manifest.persons)},
        by_people={str(n): int(c) for n, c in enumerate(np.bincount(present.sum(axis=1))) if c},
        visibility={state.name.lower(): int(visibility[state]) for state in Visibility if state != Visibility.ABSENT},
        proposals=proposals,
        rejections=rejections,
        acceptance=None if unknown else 1 - sum(rejections.values()) / proposals,
        valid_pixels=valid,
        depth_histogram=histogram,
    )


def spread(total: int, count: int) -> NDArray[np.int64]:
    """At most `count` of the numbers 0 .. total - 1, evenly spread, first and last among them."""
    return np.unique(np.linspace(0, total - 1, min(total, count)).round().astype(np.int64))


def _counts(values: NDArray[np.object_]) -> dict[str, int]:
    """Frames by value, most frequent first, then by name."""
    counter = Counter(values.ravel().tolist())
    return {str(name): count for name, count in sorted(counter.items(), key=lambda item: (-item[1], item[0]))}


def _depths(dataset: xr.Dataset) -> tuple[float, tuple[float, ...]]:
    if "depth" not in dataset:
        return float("nan"), ()
    depth = dataset["depth"].isel(frame=spread(dataset.sizes["frame"], SAMPLED_FRAMES)).values
    valid = depth[np.isfinite(depth)]
    if not valid.size:
        return 0.0, ()
    counts = np.bincount((valid / BIN_M).astype(np.int64))
    return float(valid.size / depth.size), tuple((counts / valid.size).round(6).tolist())

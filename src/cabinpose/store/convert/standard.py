"""Chosen frames of a dataset as a dataset of their own, which says where they are from."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from cabinpose.core import DatasetError
from cabinpose.store.convert.format import DatasetFormat, NoOptions
from cabinpose.store.schema import SELECTION, Manifest, dataset_id, read_manifest
from cabinpose.store.source import Report, Source, fill_dataset
from cabinpose.store.split import frame_ranges
from cabinpose.store.upgrade import upgraded_frames, upgraded_manifest

if TYPE_CHECKING:
    import xarray as xr

CHOSEN_BY = "chosen_by"  # the attribute that says in words how the frames of a dataset were chosen


class Standard(DatasetFormat):
    """The chosen frames as a dataset of its own, numbered anew; `dataset.yaml` says which frames of which dataset they are."""

    tells_splits = True

    def write(self, parts: Mapping[str, xr.Dataset], folder: Path, _: NoOptions, report: Report, /) -> None:
        """As `DatasetFormat.write`: a dataset, or one a split. Raises DatasetError for frames that are of no folder."""
        done = 0
        for name, chosen in parts.items():
            target = folder / name if name else folder
            fill_dataset(selection_source(chosen, name), target, target, lambda frames, before=done: report(before + frames))  # type: ignore[misc]
            done += chosen.sizes["frame"]


def selection_source(chosen: xr.Dataset, split: str = "") -> Source:
    """Frames that were chosen of a dataset that `open_dataset` gave; split: the name of theirs, where they are one.

    Raises DatasetError for frames that are of no folder, or not in the order of their numbers.
    """
    folder = chosen.encoding.get("source")
    if folder is None:
        raise DatasetError("these frames are of no dataset's folder", hint="choose them of what `open_dataset` gives, by `isel`")
    old, numbers = read_manifest(folder), chosen["frame"].values
    if not len(numbers) or (np.diff(numbers) <= 0).any():
        raise DatasetError("a dataset's frames stand in the order of their numbers", hint="choose some, by rising numbers")
    told: dict[str, Any] = {"of": dataset_id(old), "name": Path(folder).resolve().name, "frames": frame_ranges(numbers)}
    told |= {key: value for key, value in (("by", chosen.attrs.get(CHOSEN_BY, "")), ("split", split)) if value}
    told |= {"before": old.selection} if old.selection else {}
    values = upgraded_manifest(old).model_dump(mode="json", by_alias=True, exclude={"upgraded_from"})
    manifest = Manifest.model_validate(values | {"frames": len(numbers), "config": old.own_config | {SELECTION: told}})
    return Source(Path(folder), manifest, lambda: upgraded_frames(chosen, old, manifest))


STANDARD = Standard()

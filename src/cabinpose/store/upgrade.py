"""Datasets of version 1 of the standard in version 2: what their values say is written anew, what they do not know stays missing.

Frames keep their numbers and parts, images their bytes. Predictions and labels of the dataset stay its own.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from cabinpose.core import DatasetError, Visibility, refuse_other_writer
from cabinpose.store.dataset import write_manifest
from cabinpose.store.part import PartWriter
from cabinpose.store.part_facts import check_parts
from cabinpose.store.schema import Manifest, dataset_id, read_manifest
from cabinpose.store.source import Report, blank_frame, new_folder, refuse_others, visible_boxes
from cabinpose.store.variables import SCHEMA_VERSION, VARIABLE, VARIABLES

if TYPE_CHECKING:
    import xarray as xr

_GENERATED = "cabinpose.synth"  # whose datasets have no things where they do not tell of any
_FACING = {"infant": "rearward", "toddler": "forward", "booster": "forward", "booster_cushion": "forward"}
_AT_ONCE = 20  # frames read together: each reading opens a file of each image


def missing_variables(manifest: Manifest) -> list[str]:
    """What every dataset has today and this one has not, in the standard's order."""
    stored = {variable.name for variable in manifest.stored}
    return [each.name for each in VARIABLES if each.stored(SCHEMA_VERSION) and each.name not in stored]


def upgraded_manifest(old: Manifest) -> Manifest:
    """What `dataset.yaml` says of a dataset of any version in today's."""
    if old.schema_version == SCHEMA_VERSION:
        return old
    names = [name for name in old.variables if VARIABLE[name].named(SCHEMA_VERSION)]
    values = old.model_dump(mode="json", by_alias=True) | {"schema_version": SCHEMA_VERSION, "variables": names}
    return Manifest.model_validate(values)


def upgraded_frames(dataset: xr.Dataset, old: Manifest, new: Manifest) -> Iterator[dict[str, Any]]:
    """The frames of a dataset, or a selection of it, as the new manifest has them; old: that of its folder."""
    kept = [each.name for each in new.stored if each.name in dataset]
    of_frames = {str(name): each.dims for name, each in dataset.variables.items() if "frame" in each.dims}
    small = {name: dataset[name].values for name, dims in of_frames.items() if "y" not in dims}
    images = [name for name in kept if name not in small]
    count = dataset.sizes["frame"]
    for begin in range(0, count, _AT_ONCE):
        read = {name: dataset[name][begin : begin + _AT_ONCE].values for name in images}
        for row in range(begin, min(begin + _AT_ONCE, count)):
            values = {name: each[row] for name, each in small.items()} | {name: each[row - begin] for name, each in read.items()}
            if old.schema_version == new.schema_version:
                yield {name: values[name] for name in kept}
            else:
                yield blank_frame(new) | {name: values[name] for name in kept} | _told(values, old)


def _told(values: Mapping[str, Any], old: Manifest) -> dict[str, Any]:
    """What the values of a frame of version 1 say in the words of version 2."""
    told: dict[str, Any] = {}
    generated = old.generator == _GENERATED
    people = np.asarray(values["subject"]) != ""
    there = people | (values["visibility"] > Visibility.ABSENT).any(axis=1)
    if "things" in values or generated:
        brought = [set(filter(None, text.split(","))) for text in values.get("things", [""] * len(people))]
        seats = [next((kind for kind in _FACING if kind in kinds), "") for kinds in brought]
        told["child_seat_kind"], told["child_seat_facing"] = seats, [_FACING.get(kind, "") for kind in seats]
        child = values.get("child", [None] * len(people))
        told["occupancy"] = [_occupancy(*place) for place in zip(there, child, brought, seats, strict=True)]
    if generated:
        states = {"": "", "sleep": "asleep"}
        told["alertness"] = [states.get(action, "awake") for action in values["action"]]
    if "instance" in values:
        told["box_2d"] = visible_boxes(values.get("labels"), values["instance"], len(people))
    return told


def _occupancy(there: bool, child: int | None, brought: set[str], seat: str) -> str:
    """The state of a place; child: None where it is not known whether somebody is one."""
    if not there:
        return "child_seat_empty" if seat else "object" if brought else "empty"
    if child is None:
        return ""
    return ("child_in_child_seat" if seat else "child") if child else "adult"


def upgrade_dataset(folder: Path | str, *, report: Report | None = None) -> Manifest:
    """Write a dataset in today's version of the standard, in place of itself: whole, or not at all.

    Parameters
    ----------
    folder
        The folder of the dataset. What was written meanwhile is removed where it ends early.
    report
        Called with the number of frames done.

    Returns
    -------
    Manifest
        What its `dataset.yaml` says now.

    Raises
    ------
    DatasetError
        For a dataset that is damaged or of today's version, where its folder holds anything else, and where the disk is full;
        then it stays as it is.
    """
    from cabinpose.store.lazy import dataset_of_parts  # noqa: PLC0415 - xarray, which writers do without

    path = Path(folder)
    old = read_manifest(path)
    if old.schema_version == SCHEMA_VERSION:
        raise DatasetError(f"{path} is of version {SCHEMA_VERSION} already", hint="there is nothing to upgrade")
    refuse_others(path)
    plans, done, after = old.parts_in(path), 0, None
    if not plans:
        raise DatasetError(f"{path} has no complete part yet", hint="generate it with `cabinpose synth --resume`")
    facts = check_parts(path, plans, old)
    new = upgraded_manifest(old).model_copy(update={"upgraded_from": dataset_id(old)})
    frames = upgraded_frames(dataset_of_parts(path, old, plans, facts), old, new)
    refuse_other_writer(path, DatasetError)
    with new_folder(path, overwrite=True) as temporary:
        temporary.mkdir()
        for plan, fact in zip(plans, facts, strict=True):
            with PartWriter(temporary, plan, new, after=after if fact.after is not None else None, told=path) as part:
                for index in range(plan.first, plan.first + plan.frames):
                    if index in fact.skipped:
                        part.skip()
                        continue
                    part.append(next(frames))
                    done += 1
                    if report is not None:
                        report(done)
                if fact.proposals is not None:
                    part.attrs |= {"proposals": fact.proposals, "rejections": dict(fact.rejections)}
            after = part.checksum
        if old.content is not None and after is not None:
            new = new.with_content(after)
        write_manifest(temporary, new, path)
    return new

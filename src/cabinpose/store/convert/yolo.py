"""Ultralytics' pose format: `data.yaml`, `images/<split>/` and, for every image, `labels/<split>/<name>.txt`.

A line of a label is a person: class 0, the box about the visible pixels (centre and size), and u, v and COCO's visibility of each
joint. All of it is in shares of the image, whose left edge is 0 and right edge 1: our pixel u is at (u + 1/2) / width.

`data.yaml` has no `path`: Ultralytics then takes the folder that the file is in, wherever that is moved to.
"""

from __future__ import annotations

import warnings
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, get_args

import numpy as np
import yaml

from cabinpose.core import ConfigError
from cabinpose.store.convert.coco import frame_annotations
from cabinpose.store.convert.format import DatasetFormat
from cabinpose.store.convert.pictures import PICTURES, check_kind, pictured
from cabinpose.store.frames import dataset_skeleton, file_stem, require_variables
from cabinpose.store.source import Report
from cabinpose.store.split import Splits, held_out

if TYPE_CHECKING:
    import xarray as xr

YoloImages = Literal["depth8", "amplitude8", "rgb"]


@dataclass(frozen=True, kw_only=True)
class YoloExport:
    """How a dataset for Ultralytics is written."""

    images: YoloImages = "depth8"
    """What the pictures show, in 8 bits of grey or in colour."""

    def __post_init__(self) -> None:
        check_kind(self.images, get_args(YoloImages))


class YoloFormat(DatasetFormat):
    """Poses for Ultralytics, with pictures."""

    export_options = YoloExport
    tells_splits = True

    def parts(self, dataset: xr.Dataset, splits: Splits) -> dict[str, xr.Dataset]:
        """Always train and val: without splits, some of the subjects are held out as in training."""
        if splits:
            return super().parts(dataset, splits)
        cut = held_out(dataset)
        if cut.words:
            warnings.warn(cut.words, stacklevel=2)
        return {"train": cut.train, "val": cut.validate}

    def write(self, parts: Mapping[str, xr.Dataset], folder: Path, options: YoloExport, report: Report) -> None:
        """Write the frames of every split; `ConfigError` where train or val is none of them, `DatasetError` without instances."""
        keys = ["val" if name == "validate" else name for name in parts]
        if not {"train", "val"} <= set(keys) or len(set(keys)) < len(keys):
            raise ConfigError(
                f"yolo needs the splits train and val, not {', '.join(parts)}",
                hint="name them train and val (or validate) in the file of --splits, and leave out --split",
            )
        done = 0
        for name, dataset in parts.items():
            require_variables(dataset, "YOLO", ("instance", PICTURES[options.images].variable))
            (folder / "labels" / name).mkdir(parents=True)
            for frame in pictured(dataset, folder / "images" / name, options.images):
                lines = [label(person, *frame["instance"].shape) + "\n" for person in frame_annotations(frame)]
                (folder / "labels" / name / f"{file_stem(frame)}.txt").write_text("".join(lines), encoding="utf-8")
                done += 1
                report(done)
        skeleton = dataset_skeleton(dataset)
        content = {key: f"images/{name}" for key, name in zip(keys, parts, strict=True)} | {
            "names": {0: "person"},
            "kpt_shape": [len(skeleton.joints), 3],
            "flip_idx": list(skeleton.mirror),
            "kpt_names": {0: list(skeleton.joints)},
        }
        text = yaml.safe_dump(content, sort_keys=False, default_flow_style=None, width=120)
        (folder / "data.yaml").write_text(text, encoding="utf-8")


YOLO = YoloFormat()


def label(person: Mapping[str, Any], height: int, width: int) -> str:
    """The line of a person, of whom a COCO annotation tells, in an image of a size."""
    left, top, wide, high = person["bbox"]
    box = np.array([left + wide / 2, top + high / 2, wide, high]) / (width, height, width, height)
    u, v, flag = np.reshape(person["keypoints"], (-1, 3)).T
    u, v = (np.where(flag > 0, (x + 0.5) / size, 0.0) for x, size in ((u, width), (v, height)))
    joints = (f"{a:.6f} {b:.6f} {c:.0f}" for a, b, c in zip(u, v, flag, strict=True))
    return " ".join(["0", *(f"{x:.6f}" for x in box), *joints])

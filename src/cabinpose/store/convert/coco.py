"""COCO keypoints: `annotations/person_keypoints.json` beside `images/`; of splits, `person_keypoints_<split>.json` and
`images/<split>/` each.

Visibility (COCO data format): v = 0 not labelled (absent, or outside the image; x = y = 0), 1 labelled but occluded, by
something else or by the person's own body, 2 labelled and visible. The box, area and segmentation are those of the
person's visible pixels; a person without any is left out. Keypoints keep our pixels: an integer is a pixel's centre.
Beyond COCO's keys, an image has its camera, car and view, a person its slot, subject and action, the category the OKS sigmas of
its joints, `info` the list of slots and the scale of the images.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from cabinpose.core.pose import Visibility
from cabinpose.core.skeleton import LIMBS, oks_sigma
from cabinpose.store.convert.pictures import PICTURES, pictured
from cabinpose.store.frames import PersonInFrame, file_stem, people, require_variables
from cabinpose.store.source import Report

_FLAG = np.zeros(256, np.int64)
_FLAG[[Visibility.OCCLUDED, Visibility.SELF_OCCLUDED]] = 1
_FLAG[Visibility.VISIBLE] = 2


def export(parts: Mapping[str, xr.Dataset], folder: Path, report: Report, images: str) -> None:
    """Write the frames of every split (or of "", all of them) into `folder`; `DatasetError` without instances or images."""
    (folder / "annotations").mkdir()
    done = 0
    for name, dataset in parts.items():
        require_variables(dataset, "COCO", ("instance", PICTURES[images].variable))
        content = _head(dataset, images)
        for frame in pictured(dataset, folder / "images" / name, images):
            height, width = frame["instance"].shape
            image = {"id": int(frame["frame"]), "file_name": f"{file_stem(frame)}.png", "width": width, "height": height}
            content["images"].append({**image, **_place(frame), "license": 1})
            for person in frame_annotations(frame):
                number = len(content["annotations"]) + 1
                content["annotations"].append({"id": number, "image_id": image["id"], **person})
            done += 1
            report(done)
        file = "_".join(filter(None, ("person_keypoints", name))) + ".json"
        (folder / "annotations" / file).write_text(json.dumps(content), encoding="utf-8")


def _head(dataset: xr.Dataset, images: str) -> dict[str, Any]:
    """What a file says of all its frames, with none in it yet."""
    joints = [str(name) for name in dataset["joint"].values]
    return {
        "info": {
            "description": f"made with {dataset.attrs['generator']} {dataset.attrs['generator_version']}",
            "version": "1.0",
            "slots": [str(name) for name in dataset["person"].values],
            "images": {"kind": images, **PICTURES[images].scale},
        },
        "licenses": [{"id": 1, "name": dataset.attrs["licence"], "url": ""}],
        "categories": [
            {
                "id": 1,
                "name": "person",
                "supercategory": "person",
                "keypoints": joints,
                "skeleton": [[joints.index(a) + 1, joints.index(b) + 1] for a, b in LIMBS if a in joints and b in joints],
                "sigmas": [oks_sigma(joint) for joint in joints],
            }
        ],
        "images": [],
        "annotations": [],
    }


def _place(frame: xr.Dataset) -> dict[str, Any]:
    """What an image says beyond COCO; the camera is left out where it is not known."""
    cameras = {name: frame[name].values for name in ("camera_k", "camera_dist", "vehicle_from_camera")}
    known = {name: values.tolist() for name, values in cameras.items() if np.isfinite(values).all()}
    words = {name: str(frame[name].values) for name in ("car", "pov", "light", "renderer") if name in frame}
    return {**words, **known}


def frame_annotations(frame: xr.Dataset) -> list[dict[str, Any]]:
    """The COCO annotations of a frame, without their numbers: everybody of whom a pixel is visible."""
    masks = [(person, frame["instance"].values == person.position + 1) for person in people(frame)]
    return [annotation(person, mask) for person, mask in masks if mask.any()]


def annotation(person: PersonInFrame, mask: NDArray[np.bool_]) -> dict[str, Any]:
    """The COCO annotation of a person whose visible pixels are `mask` (H, W)."""
    flags = _FLAG[person.visibility]
    uv = np.where(flags[:, None] > 0, person.joints_2d, 0.0)
    keypoints = [x for (u, v), flag in zip(uv.tolist(), flags.tolist(), strict=True) for x in (round(u, 3), round(v, 3), flag)]
    rows, columns = np.flatnonzero(mask.any(axis=1)), np.flatnonzero(mask.any(axis=0))
    left, top = int(columns[0]), int(rows[0])
    return {
        "category_id": 1,
        "iscrowd": 0,
        "bbox": [left, top, int(columns[-1]) - left + 1, int(rows[-1]) - top + 1],
        "area": int(mask.sum()),
        "segmentation": {"size": list(mask.shape), "counts": run_lengths(mask)},
        "num_keypoints": int((flags > 0).sum()),
        "keypoints": keypoints,
        "subject": person.subject,
        "slot": person.slot,
        "action": person.action,
    }


def run_lengths(mask: NDArray[np.bool_]) -> list[int]:
    """COCO's uncompressed run lengths of a mask (H, W): column by column, beginning with a run of zeros."""
    flat = mask.ravel(order="F")
    changes = np.flatnonzero(flat[1:] != flat[:-1]) + 1
    edges = [0, *changes.tolist(), flat.size]
    lengths = [b - a for a, b in pairwise(edges)]
    return [0, *lengths] if flat[0] else lengths

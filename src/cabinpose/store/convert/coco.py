"""COCO keypoints: `annotations/person_keypoints.json` beside `images/`; of splits, `person_keypoints_<split>.json` and
`images/<split>/` each.

Visibility (COCO data format): v = 0 not labelled (absent, or outside the image; x = y = 0), 1 labelled but occluded, by
something else or by the person's own body, 2 labelled and visible. The box, area and segmentation are those of the
person's visible pixels; a person without any is left out. Where nobody's pixels are known, as in recordings, the box is that
about the labelled keypoints, and a person without any is left out. Keypoints keep our pixels: an integer is a pixel's centre.
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

from cabinpose.core import Visibility
from cabinpose.store.convert.pictures import PICTURES, pictured
from cabinpose.store.frames import PersonInFrame, dataset_skeleton, file_stem, people, require_variables
from cabinpose.store.source import Report

FLAG = np.zeros(256, np.int64)  # COCO's visibility by ours
FLAG[[Visibility.OCCLUDED, Visibility.SELF_OCCLUDED]] = 1
FLAG[Visibility.VISIBLE] = 2


def export(parts: Mapping[str, xr.Dataset], folder: Path, report: Report, images: str) -> None:
    """Write the frames of every split (or of "", all of them) into `folder`; `DatasetError` without images."""
    (folder / "annotations").mkdir()
    done = 0
    for name, dataset in parts.items():
        require_variables(dataset, "COCO", (PICTURES[images].variable,))
        content = _head(dataset, images)
        for frame in pictured(dataset, folder / "images" / name, images):
            height, width = dataset.sizes["y"], dataset.sizes["x"]
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
    skeleton = dataset_skeleton(dataset)
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
                "keypoints": list(skeleton.joints),
                "skeleton": [[a + 1, b + 1] for a, b in skeleton.limbs],
                "sigmas": list(skeleton.sigma.values()),
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
    """The COCO annotations of a frame, without their numbers: everybody of whom a pixel, or else a keypoint, is labelled."""
    if "instance" not in frame:
        keypoints = [(person, _keypoints(person)) for person in people(frame)]
        return [_annotation(person, points, _box_of(points)) for person, points in keypoints if points[:, 2].any()]
    masks = [(person, frame["instance"].values == person.position + 1) for person in people(frame)]
    return [annotation(person, mask) for person, mask in masks if mask.any()]


def annotation(person: PersonInFrame, mask: NDArray[np.bool_]) -> dict[str, Any]:
    """The COCO annotation of a person whose visible pixels are `mask` (H, W)."""
    rows, columns = np.flatnonzero(mask.any(axis=1)), np.flatnonzero(mask.any(axis=0))
    left, top = int(columns[0]), int(rows[0])
    box = {
        "bbox": [left, top, int(columns[-1]) - left + 1, int(rows[-1]) - top + 1],
        "area": int(mask.sum()),
        "segmentation": {"size": list(mask.shape), "counts": run_lengths(mask)},
    }
    return _annotation(person, _keypoints(person), box)


def _keypoints(person: PersonInFrame) -> NDArray[np.float64]:
    """(J, 3) u, v and COCO's visibility; 0 where a joint is not labelled."""
    flags = FLAG[person.visibility]
    return np.column_stack((np.where(flags[:, None] > 0, person.joints_2d, 0.0), flags))


def _box_of(points: NDArray[np.float64]) -> dict[str, Any]:
    """What COCO asks for beside the keypoints (J, 3), of somebody whose pixels are not known."""
    known = points[points[:, 2] > 0, :2]
    (left, top), (width, height) = known.min(axis=0).tolist(), np.ptp(known, axis=0).tolist()
    return {"bbox": [round(x, 3) for x in (left, top, width, height)], "area": round(width * height, 3), "segmentation": []}


def _annotation(person: PersonInFrame, points: NDArray[np.float64], box: Mapping[str, Any]) -> dict[str, Any]:
    return {
        "category_id": 1,
        "iscrowd": 0,
        **box,
        "num_keypoints": int((points[:, 2] > 0).sum()),
        "keypoints": [x for u, v, flag in points.tolist() for x in (round(u, 3), round(v, 3), int(flag))],
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

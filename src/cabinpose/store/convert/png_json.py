"""16-bit PNG images and one JSON of 2D and 3D poses per frame: the layout of the thesis' own exports (2020, ch. 5.1.3).

`depth/`, `depth_clean/` in millimetres (0 = invalid), `amplitude/`, `labels/` in their colours, `instance/`, `rgb/`, and
`pose/`; a file's name is the frame's index. `labels.json` is the table of classes.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr

from cabinpose.core.pose import Visibility
from cabinpose.store.convert import Report
from cabinpose.store.convert.frames import depth_mm, file_stem, frames, label_colours, label_table, people, write_png

_IMAGES = ("depth", "depth_clean", "depth_styled", "amplitude", "labels", "instance", "rgb")


def export(dataset: xr.Dataset, folder: Path, report: Report) -> None:
    """Write every frame of `dataset` into `folder`."""
    images = [name for name in _IMAGES if name in dataset]
    for name in [*images, "pose"]:
        (folder / name).mkdir()
    colours = label_colours(dataset) if "labels" in dataset else None
    if colours is not None:
        rows = [{**row, "rgb": f"#{row['rgb']:06x}"} for row in label_table(dataset)]
        (folder / "labels.json").write_text(json.dumps(rows, indent=1), encoding="utf-8")
    for done, frame in enumerate(frames(dataset, images), 1):
        stem = file_stem(frame)
        for name in images:
            pixels = frame[name].values
            if name.startswith("depth"):
                pixels = depth_mm(pixels)
            elif name == "labels" and colours is not None:
                pixels = colours[pixels]
            write_png(folder / name / f"{stem}.png", pixels)
        (folder / "pose" / f"{stem}.json").write_text(json.dumps(pose_record(frame), indent=1), encoding="utf-8")
        report(done)


def pose_record(frame: xr.Dataset) -> dict[str, Any]:
    """The JSON of one frame: camera, place, and everybody's joints in pixels and metres (camera frame)."""
    joints = [str(name) for name in frame["joint"].values]
    return {
        "frame": int(frame["frame"]),
        "car": str(frame["car"].values),
        "pov": str(frame["pov"].values),
        "camera": {
            "k_px": frame["camera_k"].values.tolist(),
            "dist": frame["camera_dist"].values.tolist(),
            "vehicle_from_camera": frame["vehicle_from_camera"].values.tolist(),
        },
        "people": [
            {
                "slot": person.slot,
                "subject": person.subject,
                "action": person.action,
                "joints": {
                    name: {
                        "uv_px": _numbers(person.joints_2d[i], 3),
                        "xyz_m": _numbers(person.joints_3d[i], 5),
                        "visibility": Visibility(int(person.visibility[i])).name.lower(),
                    }
                    for i, name in enumerate(joints)
                },
            }
            for person in people(frame)
        ],
    }


def _numbers(values: Any, digits: int) -> list[float] | None:
    """Rounded numbers; None where one is missing, which JSON has no number for."""
    return [round(float(v), digits) for v in values] if np.isfinite(values).all() else None

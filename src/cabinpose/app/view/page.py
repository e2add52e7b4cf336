"""The page to browse a dataset: one HTML file that needs no other file and no network.

Frames travel as deflated bytes in base64 (depths in whole millimetres, amplitude with gamma in 8 bits) and are unpacked by
the browser. The script draws the point cloud by itself, on a 2D canvas, so it works where WebGL does not.
"""

from __future__ import annotations

import base64
import dataclasses
import json
import zlib
from collections.abc import Callable
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from cabinpose.app.finite import finite
from cabinpose.app.report.html import style
from cabinpose.app.view.draw import (
    VISIBILITY_COLOUR,
    amplitude_image,
    colour_map,
    completed,
    depth_image,
    infrared_image,
    jpeg,
    resized,
)
from cabinpose.app.view.sheet import VIEW_FILES, contact_sheet, ranges
from cabinpose.app.view.summary import BIN_M, spread, summarise
from cabinpose.core import Visibility, write_together
from cabinpose.store import PERSON_COLOUR, Manifest, camera_of, dataset_skeleton, depth_mm, label_table, people, png

_RAY_STEP = 8  # pixels between the rays that the page is given


def write_view(
    dataset: xr.Dataset, manifest: Manifest, folder: Path, out: Path, *, frames: int, rows: int, report: Callable[[int], None]
) -> None:
    """Write the contact sheet of `rows` frames and the page of `frames` frames, evenly spread: `VIEW_FILES` in the folder `out`.

    `report` is called with the number of frames drawn for both, those that there are at most. Raises `DatasetError` without depth
    to show.
    """
    dataset = completed(dataset)
    count = dataset.sizes["frame"]
    title = f"{folder.resolve().name}: {count} frames, {manifest.generator} {manifest.generator_version}, seed {manifest.seed}"
    on_sheet = spread(count, rows)
    sheet = png(contact_sheet(dataset, on_sheet, title, report))
    data = page_data(dataset, manifest, folder, spread(count, frames), lambda done: report(len(on_sheet) + done))
    sheet_name, page_name = VIEW_FILES
    write_together(out, {page_name: page_html(data), sheet_name: sheet})


def page_html(data: dict[str, Any]) -> str:
    """The page that shows `data`."""
    assets = files("cabinpose.app.view") / "assets"
    html, script = ((assets / name).read_text(encoding="utf-8") for name in ("page.html", "page.js"))
    # "</" could end the script element early, whatever names the dataset holds
    text = json.dumps(finite(data), allow_nan=False, separators=(",", ":")).replace("</", "<\\/")
    return html.replace("/*STYLE*/", style("browse")).replace("/*SCRIPT*/", script).replace("/*DATA*/", text)


def page_data(
    dataset: xr.Dataset, manifest: Manifest, folder: Path, indices: NDArray[np.int64], report: Callable[[int], None]
) -> dict[str, Any]:
    """Everything that the page's script reads, as plain data."""
    near, far, white = ranges(dataset, indices)
    skeleton = dataset_skeleton(dataset)
    cameras: list[dict[str, Any]] = []
    known: dict[bytes, int] = {}
    frames = []
    for done, index in enumerate(indices.tolist(), 1):
        frame = dataset.isel(frame=index).load()
        key = frame["camera_k"].values.tobytes() + frame["camera_dist"].values.tobytes()
        if key not in known:
            known[key] = len(cameras)
            cameras.append(_rays(frame, manifest.width, manifest.height))
        frames.append({**_frame(frame, near, far, white), "camera": known[key]})
        report(done)
    return {
        "title": folder.resolve().name,
        "width": manifest.width,
        "height": manifest.height,
        "near": near,
        "far": far,
        "white": white,
        "bin_m": BIN_M,
        "colour_map": _base64(colour_map().tobytes()),
        "person_colours": PERSON_COLOUR,
        "visibility_colours": [VISIBILITY_COLOUR.get(state) for state in Visibility],
        "visibility_names": ["absent", "outside the image", "hidden by something else", "hidden by the own body", "visible"],
        "joints": skeleton.joints,
        "limbs": skeleton.limbs,
        "labels": label_table(dataset),
        "cameras": cameras,
        "frames": frames,
        "summary": dataclasses.asdict(summarise(dataset, manifest, folder)),
    }


def _frame(frame: xr.Dataset, near: float, far: float, white: float) -> dict[str, Any]:
    depth = frame["depth"].values
    record: dict[str, Any] = {
        "index": int(frame["frame"]),
        "car": str(frame["car"].values),
        "pov": str(frame["pov"].values),
        "valid": float(np.isfinite(depth).mean()),
        "vehicle_from_camera": frame["vehicle_from_camera"].values.ravel().round(6).tolist(),
        "thumbnail": _thumbnail(depth_image(depth, near, far)),
        "people": [
            {
                "position": person.position,
                "slot": person.slot,
                "subject": person.subject,
                "action": person.action,
                "uv": _points(person.joints_2d, 2),
                "xyz": _points(person.joints_3d, 4),
                "visibility": person.visibility.tolist(),
            }
            for person in people(frame)
        ],
    }
    for name in ("depth", "depth_clean"):
        if name in frame:
            millimetres = depth_mm(frame[name].values)
            record[name] = _packed((millimetres >> 8).astype(np.uint8).tobytes() + millimetres.astype(np.uint8).tobytes())
    if "amplitude" in frame:
        record["amplitude"] = _packed(amplitude_image(frame["amplitude"].values, white)[..., 0].tobytes())
    if "nir" in frame:
        record["nir"] = _packed(infrared_image(frame["nir"].values)[..., 0].tobytes())
    if "renderer" in frame:
        record["renderer"] = str(frame["renderer"].values)
    for name in ("labels", "instance", "rgb"):
        if name in frame:
            record[name] = _packed(frame[name].values.tobytes())
    return record


def _rays(frame: xr.Dataset, width: int, height: int) -> dict[str, Any]:
    """Normalised coordinates of a grid of pixels; the last row and column are among them."""
    us = sorted({*range(0, width, _RAY_STEP), width - 1})
    vs = sorted({*range(0, height, _RAY_STEP), height - 1})
    return {"us": us, "vs": vs, "rays": camera_of(frame, width, height).rays[np.ix_(vs, us)].ravel().round(6).tolist()}


def _points(values: NDArray[np.float32], digits: int) -> list[list[float] | None]:
    return [[round(float(x), digits) for x in row] if np.isfinite(row).all() else None for row in values]


def _packed(data: bytes) -> str:
    return _base64(zlib.compress(data, 6))


def _base64(data: bytes) -> str:
    return base64.b64encode(data).decode("ascii")


def _thumbnail(image: NDArray[np.uint8]) -> str:
    size = (120, round(120 * image.shape[0] / image.shape[1]))
    return _base64(jpeg(resized(image, size), 80))

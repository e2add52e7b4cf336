"""The contact sheet: a row a frame, a column a way to look at it."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from types import MappingProxyType
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from cabinpose.app.view.draw import (
    VISIBILITY_COLOUR,
    amplitude_image,
    cloud_colours,
    colour_map,
    depth_image,
    depth_range,
    draw_skeleton,
    infrared_image,
    orthographic,
    to_view,
)
from cabinpose.core import Visibility, apply
from cabinpose.store import Image, label_colours, people, points_m, text

_PAPER, _INK, _GREY = (247, 248, 250), (32, 36, 44), (104, 112, 124)
_PANEL_WIDTH = 240  # smaller frames are enlarged by a whole factor
VIEW_FILES = "contact_sheet.png", "index.html"  # of a dataset or a recording
_GAP, _MARGIN, _HEAD, _FOOT, _CAPTION = 10, 24, 96, 72, 24
# right, up, towards the eye, in the vehicle frame (x forward, y left, z up)
_AXES = MappingProxyType(
    {
        "point cloud from the left": np.array([[-1.0, 0, 0], [0, 0, 1], [0, 1, 0]]),
        "point cloud from above": np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]]),
    }
)
_COLUMNS = ("depth", "amplitude and skeleton", "labels", *_AXES)
_PICTURES: Mapping[str, tuple[str, Callable[[NDArray[Any]], Image]]] = MappingProxyType(
    {"rgb": ("colour", np.asarray), "nir": ("near infrared", infrared_image)}
)


def contact_sheet(dataset: xr.Dataset, indices: NDArray[np.int64], title: str, report: Callable[[int], None]) -> Image:
    """The sheet of the frames at `indices` of a dataset, RGB; `report` is called with the number of rows drawn."""
    zoom = max(1, -(-_PANEL_WIDTH // dataset.sizes["x"]))
    height, width = dataset.sizes["y"] * zoom, dataset.sizes["x"] * zoom
    rows = len(indices)
    names = (*_COLUMNS, *(title for name, (title, _) in _PICTURES.items() if name in dataset))
    columns = len(names)
    sheet = np.full(
        (_HEAD + rows * (height + _CAPTION + _GAP) + _FOOT, 2 * _MARGIN + columns * (width + _GAP) - _GAP, 3), _PAPER, np.uint8
    )
    text(sheet, title, (_MARGIN, 40), size=22, weight=600)
    for column, name in enumerate(names):
        text(sheet, name, (_MARGIN + column * (width + _GAP), _HEAD - 16), _GREY, 15)
    near, far, white = ranges(dataset, indices)
    colours = label_colours(dataset)
    for row, index in enumerate(indices.tolist()):
        frame = dataset.isel(frame=index).load()
        top = _HEAD + row * (height + _CAPTION + _GAP)
        text(sheet, caption(frame), (_MARGIN, top + 15), size=14)
        for column, panel in enumerate(panels(frame, near, far, white, colours, zoom)):
            left = _MARGIN + column * (width + _GAP)
            sheet[top + _CAPTION : top + _CAPTION + height, left : left + width] = panel
        report(row + 1)
    _legend(sheet, near, far)
    return sheet


def ranges(dataset: xr.Dataset, indices: NDArray[np.int64]) -> tuple[float, float, float]:
    """Depths (m) for the ends of the colours, and the amplitude of white, from some frames of a dataset."""
    near, far = depth_range(dataset["depth"].isel(frame=indices[:16]).values)
    amplitude = dataset["amplitude"].isel(frame=indices[:16]).values if "amplitude" in dataset else np.zeros(1)
    return np.floor(near * 20) / 20, np.ceil(far * 20) / 20, float(np.quantile(amplitude, 0.995))


def caption(frame: xr.Dataset) -> str:
    """One line on a frame: its index, car, view and people, and what made its pictures."""
    places = zip(frame["person"].values, frame["subject"].values, frame["action"].values, strict=True)
    who = "; ".join(f"{slot.replace('_', ' ')} {subject}, {action}" for slot, subject, action in places if subject) or "nobody"
    pictures = f"   {frame['renderer'].item()}" if "renderer" in frame else ""
    return f"frame {int(frame['frame'])}   {frame['car'].item()}, {frame['pov'].item()} view   {who}{pictures}"


def panels(frame: xr.Dataset, near: float, far: float, white: float, colours: NDArray[np.uint8], zoom: int) -> list[Image]:
    """The pictures of one frame in the order of the columns, each `zoom` times as large as the frame."""
    depth = frame["depth"].values
    amplitude = frame["amplitude"].values if "amplitude" in frame else np.full(depth.shape, white, np.uint16)
    persons = people(frame)
    images = (depth_image(depth, near, far), amplitude_image(amplitude, white), colours[frame["labels"].values])
    pictures = [image.repeat(zoom, axis=0).repeat(zoom, axis=1) for image in images]
    for person in persons:
        draw_skeleton(pictures[1], person.joints_2d, person.visibility, zoom)
    size = (depth.shape[1] * zoom, depth.shape[0] * zoom)
    valid = np.isfinite(depth)
    vehicle_from_camera = frame["vehicle_from_camera"].values
    cloud = apply(vehicle_from_camera, points_m(frame).values[valid])
    tints = cloud_colours(frame["instance"].values, amplitude, white)[valid]
    shown = [p.joints_3d[(p.visibility > Visibility.OUTSIDE_IMAGE) & np.isfinite(p.joints_3d).all(axis=1)] for p in persons]
    joints = np.concatenate(shown) if shown else np.empty((0, 3), np.float32)
    box = _box(cloud, apply(vehicle_from_camera, joints))
    for axes in _AXES.values():
        picture = orthographic(cloud, tints, axes, box, size)
        for person in persons:
            p_vehicle = apply(vehicle_from_camera, person.joints_3d)
            uv = to_view(p_vehicle, axes, box, size)
            draw_skeleton(picture, uv.astype(np.float32), person.visibility)
        pictures.append(picture)
    shots = [pixels(frame[name].values) for name, (_, pixels) in _PICTURES.items() if name in frame]
    return pictures + [shot.repeat(zoom, axis=0).repeat(zoom, axis=1) for shot in shots]


def _box(cloud: NDArray[np.float64], joints: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """The box about the joints (n, 3) of people and some of what is around them; about all points where there are none."""
    if len(joints):
        return joints.min(axis=0) - (0.25, 0.35, 0.2), joints.max(axis=0) + (0.25, 0.35, 0.35)
    if not len(cloud):
        return np.full(3, -1.0), np.full(3, 1.0)
    low, high = np.quantile(cloud, (0.002, 0.998), axis=0)
    return low - 0.05, high + 0.05


def _legend(sheet: Image, near: float, far: float) -> None:
    """The scale of the depths in metres, and the colours of the joints."""
    top = sheet.shape[0] - _FOOT + 12
    bar = np.repeat(colour_map()[None, np.linspace(0, 255, 400).astype(int)], 14, axis=0)
    sheet[top : top + 14, _MARGIN : _MARGIN + 400] = bar
    for i in range(5):
        text(sheet, f"{near + (far - near) * i / 4:.2f} m", (_MARGIN + 100 * i - (0, 20, 20, 20, 46)[i], top + 34), _GREY, 13)
    left = _MARGIN + 480
    text(sheet, "joints", (left, top + 12), _INK, 14, 600)
    left += 60
    for state in sorted(VISIBILITY_COLOUR, reverse=True):
        name = {Visibility.OCCLUDED: "hidden by something else", Visibility.SELF_OCCLUDED: "hidden by the own body"}.get(
            state, state.name.lower().replace("_", " ")
        )
        sheet[top + 1 : top + 13, left : left + 12] = VISIBILITY_COLOUR[state]
        text(sheet, name, (left + 18, top + 12), _INK, 14)
        left += 44 + 8 * len(name)

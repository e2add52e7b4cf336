"""Point clouds for the browser's 3D view: of frames packed, of scenes as binary glTF."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
import xarray as xr
from fastapi import APIRouter, HTTPException, Response
from numpy.typing import NDArray

from cabinpose.app.studio.pictures import packed_response, row_of
from cabinpose.app.view.draw import cloud_colours
from cabinpose.core import FORWARD_FROM_CAMERA, CabinposeError, FrameBatch, apply, camera_from, transform
from cabinpose.store import PERSON_COLOUR, camera_of

MOST_POINTS = 60_000  # of a cloud in the browser: more cost frames a second and show nothing new
_EVERY = 7  # pixel tells how bright white is
_FAR_MM = 32_767  # 16 bits
MOST_LIVE = 12_000  # of a live cloud, which comes several times a second


def cloud_glb(points: NDArray[np.floating], colours: NDArray[np.uint8]) -> bytes:
    """Points (n, 3) m with colours (n, 3) as binary glTF, at most `MOST_POINTS`, evenly taken."""
    import trimesh  # noqa: PLC0415 - half a second, which a studio without 3D views of scenes does without

    step = max(-(-len(points) // MOST_POINTS), 1)
    cloud = trimesh.PointCloud(points[::step].astype(np.float32), colors=colours[::step])
    data: bytes = trimesh.Scene(cloud).export(file_type="glb")
    return data


def frame_cloud(frame: xr.Dataset, variable: str = "depth") -> tuple[NDArray[np.float64], NDArray[np.uint8]]:
    """Points (n, 3) m in the vehicle's frame of a frame of a dataset, at most `MOST_POINTS`, evenly taken; and their colours."""
    depth = frame[variable].values
    height, width = depth.shape
    amplitude = frame["amplitude"].values if "amplitude" in frame else None
    there = np.flatnonzero(np.isfinite(depth))
    there = there[:: max(-(-len(there) // MOST_POINTS), 1)]
    z = depth.ravel()[there].astype(np.float64)
    xy = camera_of(frame, width, height).rays.reshape(-1, 2)[there]
    shade, white = _shades(depth, amplitude)
    colours = cloud_colours(frame["instance"].values.ravel()[there], shade.ravel()[there], white)
    return apply(frame["vehicle_from_camera"].values, np.column_stack((xy * z[:, None], z))), colours


def _shades(z: NDArray[np.floating], amplitude: NDArray[Any] | None) -> tuple[NDArray[Any], float]:
    """What points are shaded by, amplitudes or else nearness, and that of white."""
    if amplitude is None:  # nearer is brighter
        amplitude = np.nan_to_num(1000 / np.maximum(z, 0.1)).astype(np.uint16)
    return amplitude, float(np.quantile(amplitude.ravel()[::_EVERY], 0.99))


def live_cloud(frame: FrameBatch) -> tuple[NDArray[np.float64], NDArray[np.uint8]]:
    """Points (n, 3) m of a live frame, x forward and z up from a camera that is held level, and their colours (n, 3).

    At most about `MOST_LIVE`, of every so manieth row and column.
    """
    depth = frame["depth"][0]
    height, width = depth.shape
    step = math.ceil(math.sqrt(depth.size / MOST_LIVE))
    points = camera_from(frame["camera_k"][0], frame["camera_dist"][0], width, height).points(depth)[::step, ::step]
    amplitude = frame["amplitude"][0][::step, ::step] if "amplitude" in frame else None
    return _coloured(points, amplitude, np.zeros(points.shape[:2], np.uint8), transform(FORWARD_FROM_CAMERA))


def _coloured(
    points: NDArray[np.floating], amplitude: NDArray[Any] | None, instance: NDArray[np.uint8], to_from_camera: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.uint8]]:
    """The valid ones of points (H, W, 3) of the camera's frame in another frame, and their colours."""
    valid = np.isfinite(points).all(axis=-1)
    colours = cloud_colours(instance, *_shades(points[..., 2], amplitude))
    return apply(to_from_camera, points[valid].astype(np.float64)), colours[valid]


def cloud_routes(dataset: Callable[[str], xr.Dataset | None]) -> APIRouter:
    """`/clouds/{key}/{number}/{variable}`: a cloud of the dataset that is open and has this key, in the vehicle's frame.

    x, y, z in mm, then red, green, blue, all points of each one after the other, see `packed`.
    """
    router = APIRouter()

    @router.get("/clouds/{key}/{number}/{variable}")
    def cloud(key: str, number: int, variable: str) -> Response:
        opened = dataset(key)
        if opened is None or not variable.startswith("depth") or variable not in opened:
            raise HTTPException(404, "there is no such cloud")
        try:
            points, colours = frame_cloud(opened[_needed(opened, variable)].isel(frame=row_of(opened, number)).load(), variable)
        except (CabinposeError, OSError) as error:  # the dataset vanished, or is damaged
            raise HTTPException(404, str(error)) from error
        mm = np.clip(np.rint(1000 * points), -_FAR_MM, _FAR_MM).astype(np.int16)
        return packed_response([*mm.T, *colours.T], {"x-points": str(len(mm))})

    return router


def _needed(dataset: xr.Dataset, depth: str) -> list[str]:
    """What a cloud is made of."""
    return [
        depth,
        "instance",
        "camera_k",
        "camera_dist",
        "vehicle_from_camera",
        *(["amplitude"] if "amplitude" in dataset else []),
    ]


def person_colour(index: int) -> str:
    """The colour of the person in a slot, as #rrggbb."""
    return "#{:02x}{:02x}{:02x}".format(*PERSON_COLOUR[index % len(PERSON_COLOUR)])

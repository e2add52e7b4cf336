"""Point clouds and skeletons for the browser's 3D view, as binary glTF."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
import trimesh
import xarray as xr
from fastapi import APIRouter, HTTPException, Response
from numpy.typing import NDArray

from cabinpose.app.studio.pictures import row_of
from cabinpose.app.view.draw import cloud_colours
from cabinpose.core import FORWARD_FROM_CAMERA, CabinposeError, FrameBatch, apply, camera_from, transform
from cabinpose.store import PERSON_COLOUR, points_m

MOST_POINTS = 60_000  # of a cloud in the browser: more cost frames a second and show nothing new
MOST_LIVE = 12_000  # of a live cloud, which comes several times a second


def cloud_glb(points: NDArray[np.floating], colours: NDArray[np.uint8]) -> bytes:
    """Points (n, 3) m with colours (n, 3) as binary glTF, at most `MOST_POINTS`, evenly taken."""
    step = max(-(-len(points) // MOST_POINTS), 1)
    cloud = trimesh.PointCloud(points[::step].astype(np.float32), colors=colours[::step])
    data: bytes = trimesh.Scene(cloud).export(file_type="glb")
    return data


def frame_cloud(frame: xr.Dataset, variable: str = "depth") -> tuple[NDArray[np.float64], NDArray[np.uint8]]:
    """Points (n, 3) m in the vehicle's frame of one frame of a dataset in memory, and their colours."""
    amplitude = frame["amplitude"].values if "amplitude" in frame else None
    points = points_m(frame, variable).values
    return _coloured(points, amplitude, frame["instance"].values, frame["vehicle_from_camera"].values)


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
    if amplitude is None:  # nearer is brighter
        amplitude = np.nan_to_num(1000 / np.maximum(points[..., 2], 0.1)).astype(np.uint16)
    colours = cloud_colours(instance, amplitude, float(np.quantile(amplitude, 0.99)))
    return apply(to_from_camera, points[valid].astype(np.float64)), colours[valid]


def cloud_routes(dataset: Callable[[str], xr.Dataset | None]) -> APIRouter:
    """`/clouds/{key}/{number}/{variable}.glb`: a cloud of the dataset that is open and has this key, in the vehicle's frame."""
    router = APIRouter()

    @router.get("/clouds/{key}/{number}/{variable}.glb")
    def cloud(key: str, number: int, variable: str) -> Response:
        opened = dataset(key)
        if opened is None or not variable.startswith("depth") or variable not in opened:
            raise HTTPException(404, "there is no such cloud")
        try:
            frame = opened.isel(frame=row_of(opened, number)).load()
        except (CabinposeError, OSError) as error:  # the dataset vanished, or is damaged
            raise HTTPException(404, str(error)) from error
        return Response(cloud_glb(*frame_cloud(frame, variable)), media_type="model/gltf-binary")

    return router


def person_colour(index: int) -> str:
    """The colour of the person in a slot, as #rrggbb."""
    return "#{:02x}{:02x}{:02x}".format(*PERSON_COLOUR[index % len(PERSON_COLOUR)])

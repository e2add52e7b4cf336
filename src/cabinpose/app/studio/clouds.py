"""Point clouds and skeletons for the browser's 3D view, as binary glTF."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import trimesh
import xarray as xr
from fastapi import APIRouter, HTTPException, Response
from numpy.typing import NDArray

from cabinpose.app.studio.pictures import row_of
from cabinpose.app.view.draw import PERSON_COLOUR, cloud_colours
from cabinpose.core.errors import CabinposeError
from cabinpose.core.frames import apply
from cabinpose.store.lazy import points_m

MOST_POINTS = 60_000  # of a cloud in the browser: more cost frames a second and show nothing new


def cloud_glb(points: NDArray[np.floating], colours: NDArray[np.uint8]) -> bytes:
    """Points (n, 3) m with colours (n, 3) as binary glTF, at most `MOST_POINTS`, evenly taken."""
    step = max(-(-len(points) // MOST_POINTS), 1)
    cloud = trimesh.PointCloud(points[::step].astype(np.float32), colors=colours[::step])
    data: bytes = trimesh.Scene(cloud).export(file_type="glb")
    return data


def frame_cloud(frame: xr.Dataset, variable: str = "depth") -> tuple[NDArray[np.float64], NDArray[np.uint8]]:
    """Points (n, 3) m in the vehicle's frame of one frame of a dataset in memory, and their colours."""
    points = points_m(frame, variable).values.reshape(-1, 3)
    valid = np.isfinite(points).all(axis=1)
    if "amplitude" in frame:
        amplitude = frame["amplitude"].values
    else:  # nearer is brighter
        amplitude = np.nan_to_num(1000 / np.maximum(frame[variable].values, 0.1)).astype(np.uint16)
    colours = cloud_colours(frame["instance"].values, amplitude, float(np.quantile(amplitude, 0.99)))
    return apply(frame["vehicle_from_camera"].values, points[valid].astype(np.float64)), colours.reshape(-1, 3)[valid]


def cloud_routes(dataset: Callable[[], xr.Dataset | None]) -> APIRouter:
    """`/clouds/{number}/{variable}.glb`: the cloud of a frame of the dataset that is open, in the vehicle's frame."""
    router = APIRouter()

    @router.get("/clouds/{number}/{variable}.glb")
    def cloud(number: int, variable: str) -> Response:
        opened = dataset()
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

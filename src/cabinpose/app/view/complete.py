"""Fill in what a view needs and an imported dataset may lack."""

from __future__ import annotations

import numpy as np
import xarray as xr

from cabinpose.core import FORWARD_FROM_CAMERA, DatasetError, transform


def completed(dataset: xr.Dataset) -> xr.Dataset:
    """The dataset with all that its pictures show: background and nobody where it has no classes or instances, and a level
    camera where its extrinsics are not known (the cloud is then seen from beside and above that camera).

    Raises `DatasetError` where there is no depth to show, or no intrinsics to make a cloud of it.
    """
    if "depth" not in dataset:
        raise DatasetError("the dataset has no depth to show", hint="it holds joints only; `cabinpose info` says what of them")
    if not np.isfinite(dataset["camera_k"].values).all():
        raise DatasetError("the dataset does not know its camera's intrinsics", hint="import it again with --intrinsics")
    depth = dataset["depth"]
    missing = [name for name in ("labels", "instance") if name not in dataset]
    empty = xr.Variable(depth.dims, np.broadcast_to(np.uint8(0), depth.shape))  # no memory, however many frames
    poses = dataset["vehicle_from_camera"].values
    known = np.isfinite(poses).all(axis=(1, 2), keepdims=True)
    level = xr.Variable(dataset["vehicle_from_camera"].dims, np.where(known, poses, transform(FORWARD_FROM_CAMERA)))
    return dataset.assign(dict.fromkeys(missing, empty) | {"vehicle_from_camera": level})

"""Reading ITOP's own files: references of its test frames, and predictions in its image coordinates, in our camera frame.

ITOP (Haque et al. 2016): 320x240 frames of a Kinect-class camera, y up: x = (u - 160) z 0.0035, y = (120 - v) z 0.0035.
Everything here is turned to our axes (y down) on the way in.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import h5py
import numpy as np
from numpy.typing import NDArray
from scipy.io import loadmat

from cabinpose.core.errors import DatasetError
from cabinpose.core.ports import FrameBatch
from cabinpose.core.skeleton import ITOP_JOINTS

K = np.array([[1 / 0.0035, 0.0, 160.0], [0.0, 1 / 0.0035, 120.0], [0.0, 0.0, 1.0]])
NOMINAL_SCALE_M = 4.24  # metres that a depth of 1 stands for in the frames scaled to 0 .. 1 (their source's figure)
_CROP_PX = 100
_UP_TO_DOWN = np.array([1.0, -1.0, 1.0])


@dataclass(frozen=True)
class ItopReference:
    """The reference of F frames: joints_3d (F, 15, 3) m in our camera frame · valid: (F,) `is_valid`."""

    frame: NDArray[np.int64]
    joints_3d: NDArray[np.float64]
    valid: NDArray[np.bool_]


def read_itop_reference(path: Path | str) -> ItopReference:
    """The reference of a `*_labels.h5`, of a `.mat` with `keypoints3D`, or of a `.npz` with `joints_3d` and `frame`.

    Only the first says which frames are valid; the others hold valid ones alone. Raises `DatasetError` for other files.
    """
    file = Path(path)
    try:
        if file.suffix == ".h5":
            with h5py.File(file) as labels:
                joints = np.asarray(labels["real_world_coordinates"], np.float64)
                valid = np.asarray(labels["is_valid"]).astype(bool)
            frame = np.arange(len(joints))
        elif file.suffix == ".npz":
            with np.load(file) as arrays:
                joints, frame = arrays["joints_3d"].astype(np.float64), arrays["frame"].astype(np.int64)
            valid = np.ones(len(joints), bool)
        else:
            joints = np.asarray(loadmat(file)["keypoints3D"], np.float64)
            valid, frame = np.ones(len(joints), bool), np.arange(len(joints))
    except (OSError, KeyError, ValueError, NotImplementedError) as error:
        raise DatasetError(
            f"{file} holds no ITOP reference ({error})", hint="give ITOP's labels.h5, a .mat with keypoints3D, or a .npz"
        ) from error
    if joints.ndim != 3 or joints.shape[1:] != (len(ITOP_JOINTS), 3):
        raise DatasetError(f"{file}: joints of the shape {joints.shape}", hint="ITOP has 15 joints of 3 coordinates a frame")
    return ItopReference(frame.astype(np.int64), joints * _UP_TO_DOWN, valid)


def read_itop_frames(path: Path | str) -> FrameBatch:
    """The frames of a `.npz` with `depth01` (F, 100, 100): ITOP's columns 40 .. 279 at 2.4 px each, scaled to 0 .. 1 each.

    The metric scale of a frame is lost: `NOMINAL_SCALE_M` stands for all of them. Raises `DatasetError` for other files.
    """
    file = Path(path)
    try:
        with np.load(file) as arrays:
            scaled = arrays["depth01"].astype(np.float32)
    except (OSError, KeyError, ValueError) as error:
        raise DatasetError(
            f"{file} holds no ITOP frames ({error})", hint="give a .npz with depth01, joints_3d and frame"
        ) from error
    if scaled.ndim != 3 or scaled.shape[1:] != (_CROP_PX, _CROP_PX):
        raise DatasetError(f"{file}: frames of the shape {scaled.shape}", hint=f"depth01 is (frames, {_CROP_PX}, {_CROP_PX})")
    step = 240 / _CROP_PX
    k = np.array([[K[0, 0] / step, 0.0, (K[0, 2] - 40) / step], [0.0, K[1, 1] / step, K[1, 2] / step], [0.0, 0.0, 1.0]])
    depth = np.where(scaled > 0, scaled * np.float32(NOMINAL_SCALE_M), np.float32(np.nan))
    return {"depth": depth, "camera_k": k, "camera_dist": np.zeros(5)}


def project(joints_3d: NDArray[np.float64]) -> NDArray[np.float64]:
    """(..., 2) px of points (..., 3) in our camera frame, in ITOP's 320x240 frame; NaN where they are not before the camera."""
    z = np.where(joints_3d[..., 2:] > 0, joints_3d[..., 2:], np.nan)
    return joints_3d[..., :2] / z * (K[0, 0], K[1, 1]) + (K[0, 2], K[1, 2])


def unproject(uvd: NDArray[np.float64]) -> NDArray[np.float64]:
    """(..., 3) points in our camera frame of (u, v) in px of ITOP's frame and depth in m."""
    xy = (uvd[..., :2] - (K[0, 2], K[1, 2])) / (K[0, 0], K[1, 1])
    return np.concatenate((xy * uvd[..., 2:], uvd[..., 2:]), axis=-1)

"""Reading ITOP's own files: references of its test frames, and predictions in its image coordinates, in our camera frame.

ITOP (Haque et al. 2016): 320x240 frames of a Kinect-class camera, y up: x = (u - 160) z 0.0035, y = (120 - v) z 0.0035.
Everything here is turned to our axes (y down) on the way in.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from cabinpose.core import ITOP, DatasetError, FrameBatch, axis_rotation, check_claim, optional_module, read_arrays

K = np.array([[1 / 0.0035, 0.0, 160.0], [0.0, 1 / 0.0035, 120.0], [0.0, 0.0, 1.0]])
NOMINAL_SCALE_M = 4.24  # metres that a depth of 1 stands for in the frames scaled to 0 .. 1 (their source's figure)
_CROP_PX = 100
# The camera measures disparity in eighths of a pixel at 640 px of width, its projector 75 mm beside it (Khoshelham and
# Elberink 2012), so that its depths lie on a lattice: 1/z comes in steps of 1 / (8 f b), per m.
_STEP = 1.0 / (8 * 2 * K[0, 0] * 0.075)
_SCALES_M = np.arange(2.0, 10.0, 0.001)
_CLEAR = 0.7  # strength of the lattice, of at most 1, from which on it is believed
_ALIAS = 0.9  # share of the greatest strength that the true scale has too: half and third of it fit as well
_MOST_LEVELS = 1000  # the camera has 650 between 0.5 m and 10 m: frames of more were smoothed
_NEAR = 2.5  # 1 / scaled depth; nearer than that the levels are finer than the numbers of the file
# ITOP's labels lie nearer to the camera than the joints of a body: those of arms on the skin that the camera sees, those of
# the trunk half as deep as its middle, the head's in its middle. How much nearer, in round numbers, per joint.
_NEARER_M = np.array(
    [{"head": 0.0, "hand": 0.04, "knee": 0.04, "foot": 0.04}.get(name.lstrip("rl"), 0.08) for name in ITOP.joints]
)
_UP_TO_DOWN = np.array([1.0, -1.0, 1.0])
# The labels of the top view are those of the side view, turned by 90 degrees and shifted, in the side view's scale. Scale and
# tilt are measured on the depth of both views; the shift is read off floor, heads and their labels (docs/itop-comparison.md).
_SIDE_SCALE = 1.147
_TOP_TILT = axis_rotation("x", np.radians(3.3))
_TOP_SHIFT_M = np.array([0.0, 0.09, -0.16])


UNREADABLE = (
    OSError, LookupError, ValueError, TypeError, AttributeError, RuntimeError, ArithmeticError, MemoryError, struct.error,
)  # fmt: skip
"""What h5py and scipy raise for damaged files, which is more than they say."""


@dataclass(frozen=True)
class ItopReference:
    """The reference of F frames: joints_3d (F, 15, 3) m in our camera frame · valid: (F,) `is_valid`."""

    frame: NDArray[np.int64]
    joints_3d: NDArray[np.float64]
    valid: NDArray[np.bool_]


def hdf5() -> Any:
    """The library that ITOP's files are read and written with; DependencyError where it is not installed."""
    return optional_module("h5py", purpose="ITOP's HDF5", hint="pip install 'cabinpose[itop]'")


def read_itop_reference(path: Path | str) -> ItopReference:
    """The reference of a `*_labels.h5`, of a `.mat` with `keypoints3D`, or of a `.npz` with `joints_3d` and `frame`.

    Only the first says which frames are valid; the others hold valid ones alone. Raises `DatasetError` for other files.
    """
    from scipy.io import loadmat  # noqa: PLC0415 - half a second of imports, for MATLAB files alone

    file = Path(path)
    try:
        if file.suffix == ".h5":
            with hdf5().File(file) as labels:
                check_claim(file, 4 * sum(labels[name].nbytes for name in ("real_world_coordinates", "is_valid")))
                joints = np.asarray(labels["real_world_coordinates"], np.float64)
                valid = np.asarray(labels["is_valid"]).astype(bool)
            frame = np.arange(len(joints))
        elif file.suffix == ".npz":
            arrays = read_arrays(file, ("joints_3d", "frame"))
            joints, frame = arrays["joints_3d"].astype(np.float64), arrays["frame"].astype(np.int64)
            valid = np.ones(len(joints), bool)
        else:
            joints = np.asarray(loadmat(file)["keypoints3D"], np.float64)
            valid, frame = np.ones(len(joints), bool), np.arange(len(joints))
    except UNREADABLE as error:
        raise DatasetError(
            f"{file} holds no ITOP reference ({error})", hint="give ITOP's labels.h5, a .mat with keypoints3D, or a .npz"
        ) from error
    if joints.ndim != 3 or joints.shape[1:] != (len(ITOP.joints), 3):
        raise DatasetError(f"{file}: joints of the shape {joints.shape}", hint="ITOP has 15 joints of 3 coordinates a frame")
    return ItopReference(frame.astype(np.int64), joints * _UP_TO_DOWN, valid)


def read_itop_frames(path: Path | str) -> FrameBatch:
    """The frames of a `.npz` with `depth01` (F, 100, 100): ITOP's columns 40 .. 279 at 2.4 px each, scaled to 0 .. 1 each.

    The metric scale of a frame is lost, and recovered by `recovered_scale`. Raises `DatasetError` for other files.
    """
    file = Path(path)
    try:
        scaled = read_arrays(file, ("depth01",))["depth01"].astype(np.float32)
    except (OSError, KeyError, ValueError) as error:
        raise DatasetError(
            f"{file} holds no ITOP frames ({error})", hint="give a .npz with depth01, joints_3d and frame"
        ) from error
    if scaled.ndim != 3 or scaled.shape[1:] != (_CROP_PX, _CROP_PX):
        raise DatasetError(f"{file}: frames of the shape {scaled.shape}", hint=f"depth01 is (frames, {_CROP_PX}, {_CROP_PX})")
    step = 240 / _CROP_PX
    k = np.array([[K[0, 0] / step, 0.0, (K[0, 2] - 40) / step], [0.0, K[1, 1] / step, K[1, 2] / step], [0.0, 0.0, 1.0]])
    scale = np.array([recovered_scale(frame) for frame in scaled], np.float32)[:, None, None]
    depth = np.where(scaled > 0, scaled * scale, np.float32(np.nan))
    return {"depth": depth, "camera_k": k, "camera_dist": np.zeros(5)}


def as_labelled(joints_3d: NDArray[np.floating], view: Literal["side", "top"] = "side") -> NDArray[np.float64]:
    """(..., 15, 3) m where ITOP's annotators would have put the joints of a body at joints_3d: nearer, on the same ray.

    Read off the labels of the side view (docs/itop-comparison.md): no published text says what they mark. Those of the top
    view are the same points as the side view measures them. So there joints come into its scale and upright axes, and then
    move towards its camera, down in the image.
    """
    if view == "top":
        in_side_view = _SIDE_SCALE * (joints_3d @ _TOP_TILT.T) + _TOP_SHIFT_M
        return np.asarray(in_side_view + _NEARER_M[:, None] * (0.0, 1.0, 0.0), np.float64)
    distance = np.linalg.norm(joints_3d, axis=-1, keepdims=True)
    return np.asarray(joints_3d * (1.0 - _NEARER_M[:, None] / distance), np.float64)


def recovered_scale(scaled: NDArray[np.floating]) -> float:
    """Metres that a depth of 1 stands for in a frame (H, W) scaled to 0 .. 1, from the steps of the camera's disparity.

    For the right scale s all s / depth lie on the camera's lattice of 1/z; how well they do is the length of the mean of
    exp(2 pi i / (s step depth)) over the levels of the frame. `NOMINAL_SCALE_M` where no scale fits, as in frames whose depths
    were smoothed.
    """
    inverse = 1.0 / np.unique(scaled[scaled > 0].astype(np.float64))
    inverse = inverse[inverse < _NEAR]
    if not 0 < inverse.size <= _MOST_LEVELS:
        return NOMINAL_SCALE_M
    strength = np.abs(np.exp(2j * np.pi * np.outer(1.0 / (_SCALES_M * _STEP), inverse)).mean(axis=1))
    if strength.max() < _CLEAR:
        return NOMINAL_SCALE_M
    # Where s fits, s / 2 does: of scales that fit about as well the greatest is the true one, at the top of its own peak.
    last = _SCALES_M[np.flatnonzero(strength >= _ALIAS * strength.max())[-1]]
    peak = np.abs(_SCALES_M - last) <= 0.02 * last
    return float(_SCALES_M[peak][strength[peak].argmax()])


def project(joints_3d: NDArray[np.float64]) -> NDArray[np.float64]:
    """(..., 2) px of points (..., 3) in our camera frame, in ITOP's 320x240 frame; NaN where they are not before the camera."""
    z = np.where(joints_3d[..., 2:] > 0, joints_3d[..., 2:], np.nan)
    return joints_3d[..., :2] / z * (K[0, 0], K[1, 1]) + (K[0, 2], K[1, 2])


def unproject(uvd: NDArray[np.float64]) -> NDArray[np.float64]:
    """(..., 3) points in our camera frame of (u, v) in px of ITOP's frame and depth in m."""
    xy = (uvd[..., :2] - (K[0, 2], K[1, 2])) / (K[0, 0], K[1, 1])
    return np.concatenate((xy * uvd[..., 2:], uvd[..., 2:]), axis=-1)

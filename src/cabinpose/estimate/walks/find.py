"""Joints by random tree walks. Needs numpy and the compiled kernels only."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from cabinpose._native import walks as native
from cabinpose.estimate.found import Found
from cabinpose.estimate.walks.config import WalksConfig


class Forest(NamedTuple):
    """Trees of J joints as one, as `native.walk` takes it; `check` says what each array holds."""

    roots: NDArray[np.int32]
    offsets: NDArray[np.float32]
    thresholds: NDArray[np.int32]
    children: NDArray[np.int32]
    directions: NDArray[np.float32]
    shares: NDArray[np.float32]


def view_of(settings: WalksConfig) -> NDArray[np.float32]:
    """(3,) focal length and principal point of the view (px)."""
    camera = settings.view.camera
    return np.array((camera.fx, camera.cx, camera.cy), np.float32)


def find(arrays: Mapping[str, NDArray[Any]], settings: WalksConfig, seen: Mapping[str, NDArray[Any]]) -> Found:
    """The joints of N frames: means of walks, which begin at the mean place of the root in the training frames.

    Whether somebody is there is not looked at: the presence of joints in the view is the share of training frames in which
    somebody was. The score falls with the spread of the walk about its mean.
    """
    places, means = walks(arrays, settings, seen["depth"])
    spread = np.square(places[..., settings.skipped :, :] - means[..., None, :]).sum(-1).mean(-1)
    joints = means.astype(np.float64)
    uv = settings.view.camera.project(joints)
    presence = arrays["presence"][:, None] * settings.view.camera.contains(uv)
    return Found(uv, joints, presence / (1.0 + np.sqrt(spread) / settings.step_m), presence)


def walks(
    arrays: Mapping[str, NDArray[Any]], settings: WalksConfig, depth: NDArray[np.float32]
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Places (N, P, J, steps, 3) of the walks in depth images (N, h, w) of the view, and joints (N, P, J, 3): m, camera frame."""
    count = len(depth), len(settings.slots), len(settings.joints)
    places, joints = np.empty((*count, settings.steps, 3), np.float32), np.empty((*count, 3), np.float32)
    forest = Forest(*(arrays[name] for name in Forest._fields))
    native.walk(
        np.ascontiguousarray(depth, np.float32), view_of(settings), arrays["starts"], np.array(settings.order, np.int32), forest,
        step=settings.step_m, skipped=settings.skipped, places=places, joints=joints,
    )  # fmt: skip
    return places, joints


def check(arrays: Mapping[str, NDArray[Any]], settings: WalksConfig) -> None:
    """Raises ValueError or KeyError for arrays that are no forest of these settings.

    starts: (P, 3) float32 m, camera frame · presence: (P,) float32 · roots: (J,) int32, first nodes of the trees · offsets:
    (M, 4) float32 m, thresholds, children: (M,) int32, of the nodes · directions: (L, K, 3), shares: (L, K) float32, of the
    leaves; see `src/native/walks/forest.hpp`.
    """
    nodes, leaves = len(arrays["children"]), len(arrays["shares"])
    wanted = {
        "starts": ((len(settings.slots), 3), np.float32),
        "presence": ((len(settings.slots),), np.float32),
        "roots": ((len(settings.joints),), np.int32),
        "offsets": ((nodes, 4), np.float32),
        "thresholds": ((nodes,), np.int32),
        "children": ((nodes,), np.int32),
        "directions": ((leaves, settings.clusters, 3), np.float32),
        "shares": ((leaves, settings.clusters), np.float32),
    }
    for name, (shape, dtype) in wanted.items():
        array = arrays[name]
        if array.shape != shape or array.dtype != dtype or not array.flags.c_contiguous:
            raise ValueError(f"{name} is {array.dtype} {array.shape}, not {np.dtype(dtype)} {shape}")
        if not np.isfinite(array).all():
            raise ValueError(f"{name} has numbers that are none")
    children, roots = arrays["children"], arrays["roots"]
    inner = children >= 0
    # A child is numbered after its node, so that no walk down a tree goes round for ever.
    if not (
        ((roots >= 0) & (roots < nodes)).all()
        and (children[inner] > np.flatnonzero(inner)).all()
        and (children[inner] < nodes - 1).all()
        and (children[~inner] >= -leaves).all()
    ):
        raise ValueError("the nodes of its trees lead nowhere")
    if not ((arrays["presence"] >= 0) & (arrays["presence"] <= 1)).all():
        raise ValueError("its presences are no probabilities")
    if not (arrays["starts"][:, 2] > 0).all():
        raise ValueError("walks begin behind the camera")

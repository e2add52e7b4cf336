"""Truth and inference in the point cloud of a frame, seen from the front, from both sides and from above."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from cabinpose.app.report.charts import line, svg, text
from cabinpose.app.report.html import Html, el, picture_uri
from cabinpose.app.view.draw import orthographic, to_view
from cabinpose.core import FORWARD_FROM_CAMERA, apply, transform
from cabinpose.store import points_m

_SIDE, _GAP = 200, 4  # px of a view, and between two
_ROOM_M, _LEAST_M = 0.25, 0.9  # around the joints, and what a view shows at least
_NEAR, _FAR = np.array([150.0, 160.0, 178.0]), np.array([52.0, 57.0, 66.0])  # colours of points: near and far from the camera
# Right, up and towards the eye, by x forward, y left, z up.
_VIEWS = {
    "from the front": np.array([[0.0, 1, 0], [0, 0, 1], [1, 0, 0]]),
    "from the right": np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]]),
    "from the left": np.array([[-1.0, 0, 0], [0, 0, 1], [0, 1, 0]]),
    "from above": np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]]),
}
People = Sequence[tuple[NDArray[np.floating], str]]  # joints (P, J, 3) m in the camera frame, and their colour


def cloud_views(frame: xr.Dataset, limbs: Sequence[tuple[int, int]], people: People) -> Html:
    """Four views of a frame's cloud with skeletons in it, two by two.

    Parameters
    ----------
    frame
        In memory, with depth and its camera.
    limbs
        Pairs of joints that are joined.
    people
        Truth and inference, NaN where there is no joint; somebody has one.
    """
    upright = _upright(frame["vehicle_from_camera"].values)
    placed = [(apply(upright, joints.astype(np.float64)), colour) for joints, colour in people]
    every = np.concatenate([joints.reshape(-1, 3) for joints, _ in placed])
    known = every[np.isfinite(every).all(axis=1)]
    middle = (known.min(axis=0) + known.max(axis=0)) / 2
    half = max(float((known.max(axis=0) - known.min(axis=0)).max()) / 2 + _ROOM_M, _LEAST_M / 2)
    bounds = middle - half, middle + half
    cloud = points_m(frame).values.reshape(-1, 3)
    cloud = cloud[np.isfinite(cloud).all(axis=1)].astype(np.float64)
    points = apply(upright, cloud)
    reach = np.clip((cloud[:, 2] - cloud[:, 2].min(initial=0.3)) / 1.5, 0, 1)[:, None]
    colours = (_NEAR + (_FAR - _NEAR) * reach).astype(np.uint8)
    parts: list[Html] = []
    for number, (name, axes) in enumerate(_VIEWS.items()):
        left, top = (at * (_SIDE + _GAP) for at in (number % 2, number // 2))
        picture = orthographic(points, colours, axes, bounds, (_SIDE, _SIDE))
        parts.append(el("image", href=picture_uri(picture), x=left, y=top, width=_SIDE, height=_SIDE))
        for joints, colour in placed:
            for person in joints:
                uv = to_view(person, axes, bounds, (_SIDE, _SIDE)) + (left, top)
                parts += [
                    line(*uv[a], *uv[b], stroke=colour, stroke_width=1.8) for a, b in limbs if np.isfinite(uv[[a, b]]).all()
                ]  # fmt: skip
                dots = uv[np.isfinite(uv).all(axis=1)]
                parts += [el("circle", cx=float(u), cy=float(v), r=2.2, fill=colour) for u, v in dots]
        parts.append(text(left + 6, top + 14, name, "view"))
    return svg(2 * _SIDE + _GAP, 2 * _SIDE + _GAP, parts, kind="frame cloud")


def _upright(vehicle_from_camera: NDArray[np.float64]) -> NDArray[np.float64]:
    """(4, 4) x forward, y left, z up from the camera frame: the vehicle's, else of somebody who faces a level camera."""
    known = np.isfinite(vehicle_from_camera).all() and not np.array_equal(vehicle_from_camera, np.eye(4))
    return vehicle_from_camera if known else transform(np.diag((-1.0, -1.0, 1.0)) @ FORWARD_FROM_CAMERA)

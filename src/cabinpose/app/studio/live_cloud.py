"""The cloud of the live frame with the joints found in it, as often as the browser can draw it."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from nicegui import ui
from numpy.typing import NDArray

from cabinpose.app.studio.clouds import live_cloud, person_colour
from cabinpose.app.studio.live_session import PRESENT, Shown
from cabinpose.app.studio.view3d import view_3d
from cabinpose.core import FORWARD_FROM_CAMERA, skeleton_of

_PERIOD_S = 0.2
_ANSWER_S = 5.0  # a browser that has not drawn a cloud by then is sent the next one all the same
_ALONG = np.linspace(0.0, 1.0, 25)[:, None]  # points of a limb
_CAMERA = (-0.9, 0.0, 0.45, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0)  # eye, target, up: from a little behind the camera
_GAMMA = 2.2  # the colours of the view are linear


class LiveCloud:
    """A 3D view; x forward and z up from the camera, as if that were held level."""

    def __init__(self, shown: Callable[[], Shown | None]) -> None:
        """shown: gives the frame to draw."""
        self._shown = shown
        self._drawn: Shown | None = None
        self._scene = view_3d()
        self._scene.move_camera(*_CAMERA, duration=0)
        self._points: Any = None
        self._joints: Any = None
        ui.timer(_PERIOD_S, self._draw)

    async def _draw(self) -> None:
        """Draw the newest frame, and wait until the browser has."""
        shown = self._shown()
        if shown is self._drawn:
            return
        self._drawn = shown
        if shown is None:
            for cloud in filter(None, (self._points, self._joints)):
                cloud.delete()
            self._points = self._joints = None
            return
        points, colours = live_cloud(shown.frame.batch)
        self._points = self._put(self._points, points, colours / 255, 0.008)
        self._joints = self._put(self._joints, *skeletons(shown), 0.03)
        try:
            await self._scene.client.run_javascript("return 1", timeout=_ANSWER_S)
        except TimeoutError:
            return

    def _put(self, cloud: Any, points: NDArray[np.floating], colours: NDArray[np.floating], size: float) -> Any:
        """Give a cloud of the view other points, or make it."""
        # A view takes the bounds of a cloud from its first points: there is no use in one without any.
        if cloud is None and not len(points):
            return None
        rows, shades = np.round(points, 3).tolist(), np.round(colours, 2).tolist()
        if cloud is not None:
            return cloud.set_points(rows, shades)
        with self._scene:
            return self._scene.point_cloud(rows, shades, size)


def skeletons(shown: Shown) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Points (n, 3) m along all limbs that were found, in the cloud's frame, and their colours (n, 3) within 0..1."""
    points, colours = [np.empty((0, 3))], [np.empty((0, 3))]
    for number, (model, answer) in enumerate(shown.found):
        for p in range(len(model.persons)):
            joints = answer.poses.joints_3d[0, p].astype(np.float64)
            there = (answer.poses.presence[0, p] >= PRESENT) & np.isfinite(joints).all(axis=1)
            colour = person_colour(p + 2 * number)
            for a, b in skeleton_of(model).limbs:
                if there[a] and there[b]:
                    points.append(joints[a] + _ALONG * (joints[b] - joints[a]))
                    colours.append(np.full((len(_ALONG), 3), [(int(colour[i : i + 2], 16) / 255) ** _GAMMA for i in (1, 3, 5)]))
    return np.concatenate(points) @ FORWARD_FROM_CAMERA.T, np.concatenate(colours)

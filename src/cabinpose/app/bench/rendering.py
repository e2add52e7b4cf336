"""Our rendering alone, on all the cores that the bench was given: the other side of the comparison with Blender."""

from __future__ import annotations

import statistics
import threading
import time
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Any

from cabinpose.core.camera import Camera
from cabinpose.core.frames import invert
from cabinpose.synth.render import Rasteriser
from cabinpose.synth.sample import Scene

_ROUNDS = 4  # through all scenes in a run, so that no worker waits long for the last one


def pinhole(camera: Camera) -> Camera:
    """The camera without its lens distortion, which Blender's camera lacks."""
    return Camera(camera.width, camera.height, camera.fx, camera.fy, camera.cx, camera.cy)


def rendering_speed(scenes: Sequence[Scene], camera: Camera, *, workers: int, repeats: int) -> dict[str, Any]:
    """Wall time of our rendering, with as many scenes side by side as there are workers.

    One frame is everything from the surface in the vehicle frame to images: projecting, rasterising the pixels and the 2 x 2
    parts of mixed ones, shading and classifying. Threads render, each with a rasteriser of its own; the kernels hold no lock.
    Assembling the surfaces is not counted, as Blender's import of meshes is not.

    Keys: seconds_per_frame (median over the runs of wall time over the frames of a run), runs (the same of each run), frames
    (of a run), workers.
    """
    surfaces = [(scene.surface(), invert(scene.world_from_camera), scene.closed) for scene in scenes]
    local = threading.local()
    together = threading.Barrier(workers)

    def prepare() -> None:
        local.rasteriser = Rasteriser(pinhole(camera))
        for surface, camera_from_world, closed in surfaces:  # memory of the greatest surface, and compiled kernels
            local.rasteriser.render(surface, camera_from_world, closed=closed)

    def render(number: int) -> None:
        surface, camera_from_world, closed = surfaces[number % len(surfaces)]
        local.rasteriser.render(surface, camera_from_world, closed=closed)

    frames = _ROUNDS * len(surfaces)
    runs = []
    with ThreadPoolExecutor(workers, initializer=prepare) as pool:
        list(pool.map(lambda _: together.wait(), range(workers)))  # all have started
        for _ in range(repeats):
            start = time.perf_counter()
            list(pool.map(render, range(frames)))
            runs.append((time.perf_counter() - start) / frames)
    return {"seconds_per_frame": statistics.median(runs), "runs": runs, "frames": frames, "workers": workers}

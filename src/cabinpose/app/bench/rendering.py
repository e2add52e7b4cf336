"""Our rendering alone, on all the cores that the bench was given: the other side of the comparison with Blender."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager

from cabinpose.core.camera import Camera
from cabinpose.core.frames import invert
from cabinpose.synth.render import Rasteriser
from cabinpose.synth.sample import Scene

ROUNDS = 4  # through all scenes in a run, so that no thread waits long for the last one


def pinhole(camera: Camera) -> Camera:
    """The camera without its lens distortion, which Blender's camera lacks."""
    return Camera(camera.width, camera.height, camera.fx, camera.fy, camera.cx, camera.cy)


@contextmanager
def rendering(scenes: Sequence[Scene], camera: Camera, *, threads: int) -> Iterator[Callable[[], float]]:
    """A function that renders all scenes a few times and gives the wall time a frame, s.

    As many scenes are rendered side by side as there are threads, each with a rasteriser of its own. One frame is everything
    from the surface in the vehicle frame to images: projecting, rasterising the pixels and the 2 x 2 parts of mixed ones,
    shading and classifying. Assembling the surfaces is not counted, as Blender's import of meshes is not.
    """
    surfaces = [(scene.surface(), invert(scene.world_from_camera), scene.closed) for scene in scenes]
    local = threading.local()
    together = threading.Barrier(threads)

    def prepare() -> None:
        local.rasteriser = Rasteriser(pinhole(camera))
        for surface, camera_from_world, closed in surfaces:  # memory of the greatest surface
            local.rasteriser.render(surface, camera_from_world, closed=closed)

    def render(number: int) -> None:
        surface, camera_from_world, closed = surfaces[number % len(surfaces)]
        local.rasteriser.render(surface, camera_from_world, closed=closed)

    with ThreadPoolExecutor(threads, initializer=prepare) as pool:
        list(pool.map(lambda _: together.wait(), range(threads)))  # all have started

        def measure() -> float:
            frames = ROUNDS * len(surfaces)
            start = time.perf_counter()
            list(pool.map(render, range(frames)))
            return (time.perf_counter() - start) / frames

        yield measure

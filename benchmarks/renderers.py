"""Rendering of the same scenes by this package and by Blender, for `bench synth`."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from pathlib import Path
from typing import Self

import numpy as np

from cabinpose.core.camera import Camera
from cabinpose.core.errors import ConfigError
from cabinpose.core.frames import invert
from cabinpose.synth.render import Rasteriser, RenderedFrame
from cabinpose.synth.scene import Scene

REQUIREMENT = "bpy==4.5.*"  # the last version with wheels for Python 3.11; it pins numpy 1.26
ROUNDS = 4  # through all scenes in a run, so that no thread waits long for the last one
_PEER = Path(__file__).with_name("blender_peer.py")
_AGREE_M = 1e-4


def pinhole(camera: Camera) -> Camera:
    """The camera without its lens distortion, which Blender's camera lacks."""
    return Camera(camera.width, camera.height, camera.fx, camera.fy, camera.cx, camera.cy)


@contextmanager
def rendering(scenes: Sequence[Scene], camera: Camera, *, threads: int) -> Iterator[Callable[[], float]]:
    """A function that renders all scenes `ROUNDS` times with this package and returns the wall time per frame, s.

    Each thread has its own rasteriser. A frame is everything from the surface in the vehicle frame to images: projection,
    rasterising pixels and the 2 x 2 parts of mixed ones, shading and classifying. Assembling the surfaces is not counted, as
    Blender's import of meshes is not.
    """
    surfaces = [(scene.surface(), invert(scene.world_from_camera), scene.closed) for scene in scenes]
    local = threading.local()
    together = threading.Barrier(threads)

    def render(number: int) -> None:
        surface, camera_from_world, closed = surfaces[number % len(surfaces)]
        local.rasteriser.render(surface, camera_from_world, closed=closed)

    def prepare() -> None:
        local.rasteriser = Rasteriser(pinhole(camera))
        for number in range(len(surfaces)):  # allocates memory for the largest surface
            render(number)

    with ThreadPoolExecutor(threads, initializer=prepare) as pool:
        list(pool.map(lambda _: together.wait(), range(threads)))  # all threads have started

        def measure() -> float:
            frames = ROUNDS * len(surfaces)
            start = time.perf_counter()
            list(pool.map(render, range(frames)))
            return (time.perf_counter() - start) / frames

        yield measure


def cache_folder() -> Path:
    """Where the bench keeps Blender's environment: $XDG_CACHE_HOME or ~/.cache, under cabinpose."""
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "cabinpose"


def blender_python(folder: Path) -> tuple[Path | None, str | None]:
    """The interpreter of an environment with Blender under `folder`, made at first use; or None, and why there is none."""
    environment = folder / "blender-4.5"
    python = environment / ("Scripts/python.exe" if os.name == "nt" else "bin/python")
    if _runs(python):
        return python, None
    if sys.version_info[:2] != (3, 11):
        return None, f"bpy 4.5 needs Python 3.11, this is {sys.version_info[0]}.{sys.version_info[1]}"
    for command in (
        [sys.executable, "-m", "venv", "--clear", str(environment)],
        [str(python), "-m", "pip", "install", "--quiet", "--disable-pip-version-check", REQUIREMENT],
    ):
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        if done.returncode != 0:
            return None, f"`{' '.join(command[1:])}` failed: {last_line(done.stderr)}"
    return (python, None) if _runs(python) else (None, "bpy is installed but does not start without a display")


class BlenderPeer:
    """Blender on the same scenes, without lens distortion. Use as a context: exported scenes are in a temporary folder.

    reason: why Blender does not run here, or None.
    """

    def __init__(self, scenes: Sequence[Scene], camera: Camera, *, threads: int, folder: Path | None = None) -> None:
        self._scenes, self._camera, self._threads = scenes, camera, threads
        self._python, self.reason = blender_python(folder or cache_folder())
        self._work = tempfile.TemporaryDirectory()
        self._ours: list[RenderedFrame] = []
        self.version = ""

    def __enter__(self) -> Self:
        camera, scenes = self._camera, self._scenes if self.reason is None else ()
        for number, scene in enumerate(scenes):
            surface = scene.surface()
            rasteriser = Rasteriser(pinhole(camera))
            self._ours.append(rasteriser.render(surface, invert(scene.world_from_camera), closed=scene.closed))
            np.savez(
                self._path(f"scene-{number:03d}.npz"),
                vertices=surface.vertices, faces=surface.faces, instance=surface.instance,
                world_from_camera=scene.world_from_camera,
                pinhole=np.array([camera.width, camera.height, camera.fx, camera.fy, camera.cx, camera.cy]),
            )  # fmt: skip
        return self

    def __exit__(self, *_: object) -> None:
        self._work.cleanup()

    def render(self) -> tuple[list[float], list[float]]:
        """Seconds per scene: of the render call (which builds the search tree, renders and writes), and with making the meshes.

        Raises ConfigError where Blender fails.
        """
        command = [str(self._python), str(_PEER), self._work.name, str(self._threads)]
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        answers = [line for line in done.stdout.splitlines() if line.startswith('{"blender"')]
        if done.returncode != 0 or not answers:
            raise ConfigError(f"Blender failed: {last_line(done.stderr)}", hint="measure without it: --skip-blender")
        answer = json.loads(answers[-1])
        self.version = answer["blender"]
        return answer["seconds"], answer["seconds_with_import"]

    def agreement(self) -> tuple[float, float]:
        """Shares of the pixels of Blender's last rendering that have our depth within 0.1 mm, and our instance."""
        depth, instance = [], []
        for number, frame in enumerate(self._ours):
            peer = np.load(self._path(f"peer-{number:03d}.npz"))
            seen = np.where(peer["depth"] < 1e3, peer["depth"], 0.0)  # Blender writes 1e10 where it hits nothing
            depth.append(np.mean(np.abs(seen - frame.depth_clean) <= _AGREE_M))
            instance.append(np.mean(np.maximum(peer["index"] - 1, 0) == frame.instance))
        return float(np.mean(depth)), float(np.mean(instance))

    def _path(self, name: str) -> Path:
        return Path(self._work.name) / name


def _runs(python: Path) -> bool:
    """Whether an interpreter exists and imports Blender 4.5."""
    code = "import bpy; assert bpy.app.version[:2] == (4, 5)"
    return python.exists() and subprocess.run([str(python), "-c", code], capture_output=True, check=False).returncode == 0


def last_line(text: str) -> str:
    """The last line of a program's output that is not empty."""
    lines = [line.strip() for line in text.splitlines() if line.strip()]
    return lines[-1] if lines else "no message"

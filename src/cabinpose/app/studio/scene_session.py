"""The scene of a studio: drawn on a thread of its own, generated from on another, looked at by browsers."""

from __future__ import annotations

import asyncio
import hashlib
import threading
from collections import OrderedDict
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np
from fastapi import APIRouter, HTTPException, Response

from cabinpose.app.studio.clouds import cloud_glb
from cabinpose.app.studio.pictures import CLASSES, IMAGES, picture
from cabinpose.app.studio.scene_bodies import FINE_WITHIN_M, bodies
from cabinpose.app.studio.scene_edit import SceneEditor, read_state
from cabinpose.app.studio.scene_preview import Posed, Preview, Shown, own_cars
from cabinpose.app.view.draw import cloud_colours
from cabinpose.core import CabinposeError, ConfigError, MeshError, apply
from cabinpose.synth import Progress, Scene, SynthConfig, generate

_RECENT = 8  # scenes kept for browsers that have been told of them and come for their images
_KEPT = 120  # shapes and places of bodies, for the same reason
_SETTLED_S = 0.03  # without another change before the camera looks: a slider that is dragged moves people meanwhile
KEEP = "private, max-age=3600"


class Generation:
    """A dataset that is being made, by the function of `cabinpose synth`, on a thread of its own."""

    def __init__(self, config: SynthConfig, seed: int, frames: int, out: Path, *, resume: bool = False) -> None:
        self.out, self.frames = out, frames
        self.done, self.words = 0, "starting"
        self.error = ""
        self._cancelled = threading.Event()
        self._thread = threading.Thread(target=self._run, args=(config, seed, resume), name="generation", daemon=True)
        self._thread.start()

    @property
    def running(self) -> bool:
        """Whether frames are still made."""
        return self._thread.is_alive()

    def cancel(self) -> None:
        """End it after the frame that is being written; what is there can be gone on with (`synth --resume`)."""
        self._cancelled.set()

    def wait(self, seconds: float) -> None:
        """Wait for the end."""
        self._thread.join(seconds)

    def _run(self, config: SynthConfig, seed: int, resume: bool) -> None:
        try:
            report = generate(
                config, self.frames, self.out, seed=seed, existing="resume" if resume else "refuse", progress=self._told
            )
            self.words = f"{report.frames_total} frames in {self.out.name}, {report.frames_per_s:.1f} a second"
        except _CancelledError:
            self.words = f"cancelled; `cabinpose synth --resume` goes on with {self.out.name}"
        except CabinposeError as error:
            self.error = error.in_one_line()
        except Exception as error:  # noqa: BLE001 - a thread's end would otherwise be seen by nobody
            self.error = f"the run failed: {error!r}"

    def _told(self, state: Progress) -> None:
        self.done, self.words = state.frames_done, f"{state.phase}: {state.frames_done} of {state.frames_total}"
        if self._cancelled.is_set():
            raise _CancelledError


class _CancelledError(Exception):
    """The user wants no more frames."""


class SceneRoom:
    """The one scene of a studio, shared by all browsers; `listeners` are told of what is new."""

    def __init__(self, scene: Path | None) -> None:
        """Raises ConfigError for a file that is no configuration; where keys of it are wrong, `editor.errors` says which."""
        folder = (Path() if scene is None else scene.parent).resolve()
        self.editor = SceneEditor(folder, None if scene is None else read_state(scene))
        self.editor.file = "" if scene is None else scene.name
        self.error = ""
        self.generation: Generation | None = None
        self.listeners: list[Callable[[], None]] = []
        self._preview = Preview()
        self._worker = ThreadPoolExecutor(1, "scene")
        self._wanted = self._drawn = 0
        self._drawing = False
        self._recent: OrderedDict[int, Shown] = OrderedDict()
        self.posed: Posed | None = None
        self._of: Scene | None = None
        self._bodies: dict[str, dict[str, Any]] = {}
        self._made: OrderedDict[str, Callable[[], bytes]] = OrderedDict()

    @property
    def shown(self) -> Shown | None:
        """What was drawn last, images and all."""
        return next(reversed(self._recent.values()), None)

    async def redraw(self) -> None:
        """Draw what is edited now: first where everything is, then what the camera sees of it; the listeners are told of both.

        Of changes that come meanwhile only the last is drawn, and images are made of that one alone.
        """
        self._wanted += 1
        if self._drawing:
            return
        self._drawing = True
        try:
            while self._drawn != self._wanted:
                self._drawn = self._wanted
                await self._draw(self.editor.config)
        finally:
            self._drawing = False

    async def _draw(self, config: SynthConfig) -> None:
        state, loop = self.editor.state, asyncio.get_running_loop()
        try:
            posed = await loop.run_in_executor(self._worker, self._preview.pose, config, state.seed, state.index)
            self.error, self.posed = posed.error, posed
            self._tell()
            await asyncio.sleep(_SETTLED_S)
            if self._drawn != self._wanted:
                return
            shown = await loop.run_in_executor(self._worker, self._preview.see, posed)
            self._recent[shown.number] = self.posed = shown
            while len(self._recent) > _RECENT:
                self._recent.popitem(last=False)
        except CabinposeError as error:
            self.error = error.in_one_line()
            of_car = isinstance(error, (ConfigError, MeshError)) and own_cars(config)
            if of_car and self.editor.config is config:
                self.editor.errors.setdefault(("scene", "cars"), self.error)
                self.error = ""
        except Exception as error:  # noqa: BLE001 - the studio goes on with the scene before
            self.error = f"the scene cannot be drawn: {error!r}"
        self._tell()

    def _tell(self) -> None:
        for told in tuple(self.listeners):
            told()

    def bodies(self, posed: Posed) -> dict[str, dict[str, Any]]:
        """What is drawn of a scene, by name: addresses of shape and points, the same for what is the same, and looks."""
        if posed.scene is not self._of:
            self._of, self._bodies = posed.scene, {}
            for name, body in bodies(posed.scene).items():
                of_shape = body.surface.faces.tobytes() + body.kinds.tobytes() + bytes([body.cabin])
                self._bodies[name] = {
                    "shape": self._kept(of_shape, lambda body=body: body.shape),  # type: ignore[misc]
                    "points": self._kept(body.surface.vertices.tobytes(), lambda body=body: body.points),  # type: ignore[misc]
                    "looks": [list(look) for look in body.looks],
                    "far": FINE_WITHIN_M,
                }
        return self._bodies

    def _kept(self, of: bytes, make: Callable[[], bytes]) -> str:
        name = hashlib.sha256(of).hexdigest()[:24]
        self._made[name] = make
        self._made.move_to_end(name)
        while len(self._made) > _KEPT:
            self._made.popitem(last=False)
        return f"/scene/bodies/{name}"

    def generate(self, name: str, frames: int, *, resume: bool = False) -> None:
        """Begin to make a dataset in a folder beside the scene.

        Raises ConfigError for a configuration that is not valid, a name that leads elsewhere, and while another dataset is made.
        """
        self.editor.require_valid("nothing is made of what is wrong")
        out = self.editor.place(name, ("",))
        if self.generation is not None and self.generation.running:
            raise ConfigError(f"{self.generation.out.name} is being made", hint="wait until it is there, or cancel it first")
        self.generation = Generation(self.editor.config, self.editor.state.seed, frames, out, resume=resume)

    def stop(self) -> None:
        """End what runs."""
        if self.generation is not None:
            self.generation.cancel()
            self.generation.wait(10.0)
        self._worker.shutdown(wait=False, cancel_futures=True)

    def image(self, number: int, name: str) -> Response:
        """An image of a scene that was drawn lately, or its cloud in the vehicle's frame as `cloud.glb`."""
        shown = self._recent.get(number)
        if shown is None or (name not in IMAGES and name != "cloud.glb") or name == CLASSES[1]:
            raise HTTPException(404, "there is no such image")
        if name == "cloud.glb":
            return Response(_cloud(shown), media_type="model/gltf-binary", headers={"cache-control": KEEP})
        if name not in shown.frame:
            raise HTTPException(404, "there is no such image")
        return picture(name, shown.frame[name]).response(keep=False)

    def body(self, name: str) -> Response:
        """A shape of a cabin, a person or a thing, or where its points are."""
        make = self._made.get(name)
        if make is None:
            raise HTTPException(404, "there is no such body")
        return Response(make(), media_type="application/octet-stream", headers={"cache-control": KEEP})


class OpenedScene:
    """The scene of a studio, which is opened when somebody looks at it first; None: a new one."""

    def __init__(self, scene: Path | None) -> None:
        self._scene = scene
        self._room: SceneRoom | None = None

    def room(self) -> SceneRoom:
        """The scene. Raises ConfigError for a file that is no configuration."""
        if self._room is None:
            self._room = SceneRoom(self._scene)
        return self._room

    def routes(self) -> APIRouter:
        """`/scene/bodies/{name}`, `/scene/{number}/{image}` of the scene that is open."""
        router = APIRouter()

        def opened() -> SceneRoom:
            if self._room is None:
                raise HTTPException(404, "no scene is open")
            return self._room

        @router.get("/scene/bodies/{name}")
        async def body(name: str) -> Response:
            return opened().body(name)

        @router.get("/scene/{number}/{name}")
        async def image(number: int, name: str) -> Response:
            return opened().image(number, name)

        return router

    def stop(self) -> None:
        """End what runs."""
        if self._room is not None:
            self._room.stop()


def _cloud(shown: Shown) -> bytes:
    """The point cloud of a scene, in the vehicle's frame."""
    depth = shown.frame["depth"]
    points = shown.config.camera.sensor_model.camera.points(depth)
    valid = np.isfinite(depth) & (depth > 0)
    amplitude = shown.frame["amplitude"]
    colours = cloud_colours(shown.frame["instance"], amplitude, float(np.quantile(amplitude, 0.99)) or 1.0)
    return cloud_glb(apply(shown.scene.world_from_camera, points[valid].astype(np.float64)), colours[valid])

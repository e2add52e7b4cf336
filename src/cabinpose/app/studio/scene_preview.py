"""Scenes that are being edited as they look: posed first, and then seen by their camera. Without any UI."""

from __future__ import annotations

import dataclasses
import math
import sys
import time
from collections.abc import Mapping
from contextlib import AbstractContextManager
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from threadpoolctl import ThreadpoolController

from cabinpose.core import CabinposeError, SceneError
from cabinpose.synth import (
    CabinScene,
    CameraPose,
    Frame,
    FrameMaker,
    Scene,
    SceneSampler,
    SynthConfig,
    Verdict,
    frame_rng,
    is_car_file,
    judge_place,
    noise_rng,
)

_ROUND_M = 3  # digits of the camera's place: a millimetre


@dataclass(frozen=True)
class Posed:
    """A scene as it was posed, before its camera has looked at it.

    number: tells it from every other · verdicts: why it does not hold, () where it does · error: why none was found; then it is
    the scene before · depth_m: what the middle of the image shows, as far as it is known · seconds: what that took, by stage.
    """

    number: int
    config: SynthConfig
    scene: Scene
    verdicts: tuple[Verdict, ...] = ()
    error: str = ""
    depth_m: float = 1.0
    seconds: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True, kw_only=True)
class Shown(Posed):
    """A scene as it was drawn, with the frame that its camera delivers. doubts: what speaks against the camera's place."""

    frame: Frame
    doubts: tuple[str, ...] = ()


class Preview:
    """Draws scenes, with the people and cars of the scene before. Belongs to one thread at a time."""

    def __init__(self) -> None:
        self._sampler: SceneSampler | None = None
        self._written: dict[Path, int] = {}
        self.shown: Shown | None = None
        self._number, self._noise = 0, (0, 0)
        self._pools, self._loaded = ThreadpoolController(), len(sys.modules)

    def pose(self, config: SynthConfig, seed: int, index: int) -> Posed:
        """Where everything is in a scene, before its camera looks at it. Raises CabinposeError where there is nothing to show."""
        started = time.perf_counter()
        with self._one_thread():
            written = {car: car.stat().st_mtime_ns for car in own_cars(config) if car.exists()}  # one that changed is loaded anew
            sampler = SceneSampler(config, seed, like=self._sampler if self._written == written else None)
            self._written = written
            self._sampler, self._noise = sampler, (seed, index)
            scene, verdicts, error = self._scene(sampler, config, seed, index)
        self._number += 1
        before = self.shown
        same = before is not None and np.array_equal(before.scene.world_from_camera, scene.world_from_camera)
        depth = before.depth_m if before is not None and same else 1.0
        return Posed(self._number, config, scene, verdicts, error, depth, {"pose": time.perf_counter() - started})

    def see(self, posed: Posed) -> Shown:
        """The scene that was posed last, with what its camera delivers."""
        started = time.perf_counter()
        assert self._sampler is not None
        with self._one_thread():
            maker = FrameMaker(posed.config, self._noise[0], self._sampler, pictures=False)
            frame = maker.see(posed.scene, rng=noise_rng(*self._noise), index=self._noise[1])
            doubts = _place_doubts(posed.config, posed.scene)
        depth = frame["depth_clean"]
        middle = float(depth[depth.shape[0] // 2, depth.shape[1] // 2])
        told = {each.name: getattr(posed, each.name) for each in dataclasses.fields(posed)}
        told["depth_m"] = middle if 0.3 < middle < 3.0 else 1.0
        told["seconds"] = {**posed.seconds, "see": time.perf_counter() - started}
        self.shown = Shown(**told, frame=frame, doubts=doubts)
        return self.shown

    def draw(self, config: SynthConfig, seed: int, index: int) -> Shown:
        """What a configuration looks like, at once. Raises CabinposeError where there is nothing to show."""
        return self.see(self.pose(config, seed, index))

    def _one_thread(self) -> AbstractContextManager[object]:
        """As in `synth`: the bytes may depend on the libraries' number of threads. They are sought (5 ms) after imports."""
        if self._loaded != len(sys.modules):
            self._pools, self._loaded = ThreadpoolController(), len(sys.modules)
        limited: AbstractContextManager[object] = self._pools.limit(limits=1)
        return limited

    def _scene(self, sampler: SceneSampler, config: SynthConfig, seed: int, index: int) -> tuple[Scene, tuple[Verdict, ...], str]:
        scene = config.scene
        occupants = scene.occupants.values() if isinstance(scene, CabinScene) else ()
        given = any(occupant.pose is not None for occupant in occupants)
        if given and all(o.pose for o in occupants) and isinstance(scene, CabinScene) and not any(scene.occupancy.values()):
            return *sampler.as_given(index, rng=frame_rng(seed, index)), ""
        try:
            return sampler.sample(index, rng=frame_rng(seed, index)), (), ""
        except CabinposeError as error:
            if given:
                return *sampler.as_given(index, rng=frame_rng(seed, index)), error.in_one_line()
            if self.shown is None or not isinstance(error, SceneError):
                raise
            return self.shown.scene, (), error.in_one_line()


def _place_doubts(config: SynthConfig, scene: Scene) -> tuple[str, ...]:
    """What speaks against the camera's place in a car."""
    if scene.cabin is None:
        return ()
    camera = config.camera.sensor_model
    return judge_place(scene.cabin, scene.pov, scene.world_from_camera, camera, config.noise, scene.settings).doubts


def words_of(verdict: Verdict) -> str:
    """Why a scene does not hold, how deep something is in another, and where."""
    where = "" if verdict.where is None else " at " + ", ".join(f"{x:.2f}" for x in verdict.where) + " m"
    depth = f", {1000 * verdict.depth_m:.0f} mm deep" if verdict.depth_m else ""
    return f"{verdict.rejection}{depth}{where}"


def own_cars(config: SynthConfig) -> list[Path]:
    """The YAMLs of the user's own cars."""
    cars = config.scene.cars if isinstance(config.scene, CabinScene) else ()
    return [Path(car) for car in cars if isinstance(car, str) and is_car_file(car)]


def camera_of(shown: Posed) -> tuple[list[float], list[float], float]:
    """Where the camera is, a point before it that it looks at (m), and its roll (deg)."""
    own = shown.config.camera.views.get(shown.scene.pov)
    if isinstance(own, CameraPose):
        return list(own.position_m), list(own.look_at_m), own.roll_deg
    camera = shown.scene.world_from_camera
    eye, forward, right = camera[:3, 3], camera[:3, 2], camera[:3, 0]
    target = eye + forward * shown.depth_m
    level = np.cross(forward, (0.0, 0.0, 1.0))
    roll = 0.0
    if np.linalg.norm(level) > 1e-3:
        level /= np.linalg.norm(level)
        roll = math.degrees(math.atan2(float(np.cross(level, right) @ forward), float(level @ right)))
    return eye.round(_ROUND_M).tolist(), target.round(_ROUND_M).tolist(), round(roll, 2) + 0.0

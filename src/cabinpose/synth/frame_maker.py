"""A frame of a dataset by its number: its scene, drawn, rendered and seen by the sensor, and the variables that tell of it."""

from __future__ import annotations

import time
from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

import numpy as np

from cabinpose.core import invert
from cabinpose.scene.sensor import GeometryBuffers, PhysicalNoise, median_of_valid, sample_times, simulate
from cabinpose.synth.config import SynthConfig, person_slots
from cabinpose.synth.render import Rasteriser
from cabinpose.synth.sample import SceneSampler
from cabinpose.synth.scene import Scene
from cabinpose.synth.streams import frame_rng, noise_rng
from cabinpose.synth.variables import Frame, FrameFacts, joints_in_camera, make_variables, rows_of

if TYPE_CHECKING:
    from cabinpose.synth.pictures.maker import PictureMaker
    from cabinpose.synth.style.stage import FrameStyler


class FrameMaker:
    """Makes any frame of a dataset from its number, in one thread."""

    def __init__(self, config: SynthConfig, seed: int, sampler: SceneSampler | None = None, *, pictures: bool = True) -> None:
        """sampler: of the same configuration and seed, to share people and cars with; its own by default · pictures: False
        leaves out those that the configuration asks for, and styled depth, which nobody looks at.
        """
        self._config = config if pictures else config.model_copy(update={"images": None, "style": None})
        self._seed = seed
        self.seconds: defaultdict[str, float] = defaultdict(float)
        self._sampler = sampler or SceneSampler(config, seed)
        self._sensor = config.camera.sensor_model
        self._rasteriser = Rasteriser(self._sensor.camera, supersample=config.camera.supersample)
        self._sequence = config.scene.sequence
        moving = self._sequence is not None and self._sequence.exposure_motion
        physical = config.noise if isinstance(config.noise, PhysicalNoise) else None
        self._sample_times = sample_times(self._sensor, physical) if moving and physical else np.zeros(0)
        self._delivered: dict[int, np.ndarray] = {}  # depths of the frames before, where they are filtered over time
        self._pictures: PictureMaker | None = None
        if self._config.images is not None:
            from cabinpose.synth.pictures.maker import PictureMaker  # noqa: PLC0415 - loaded where there are pictures

            self._pictures = PictureMaker(self._config.images, self._sensor, seed)
        self._styler: FrameStyler | None = None
        if self._config.style is not None:
            from cabinpose.synth.style.stage import FrameStyler  # noqa: PLC0415 - loaded where depth is styled

            self._styler = FrameStyler(self._config.style)
        self._slots = person_slots(config)
        self._instances = np.arange(1, len(self._slots) + 1, dtype=np.uint8)
        self._rows = rows_of(self._config)

    @contextmanager
    def stage(self, name: str) -> Iterator[None]:
        """Counts this thread's CPU time spent inside under `name`."""
        start = time.thread_time()
        yield
        self.seconds[name] += time.thread_time() - start

    def make(self, index: int) -> tuple[Frame, Scene]:
        """Frame `index`: every variable of the dataset standard, and the scene it shows."""
        frame, scene = self._make_alone(index)
        if self._sensor.temporal_median > 1:
            self._delivered[index] = frame["depth"]
            frame["depth"] = self._over_time(index)
        return frame, scene

    def _make_alone(self, index: int) -> tuple[Frame, Scene]:
        """A frame as it is before a filter over time."""
        rng = frame_rng(self._seed, index)
        with self.stage("sample_and_validate"):
            scene = self._sampler.sample(index, rng=rng)
            exposures = self._sampler.exposed(index, scene, self._sample_times) if self._sample_times.size else []
        return self.see(scene, rng=noise_rng(self._seed, index), exposures=exposures), scene

    def _over_time(self, index: int) -> np.ndarray:
        """The median depth (H, W) m of a frame and those before it in its sequence; what other threads made is made again."""
        assert self._sequence is not None
        first = max(index - self._sensor.temporal_median + 1, index // self._sequence.frames * self._sequence.frames)
        self._delivered = {
            i: self._delivered[i] if i in self._delivered else self._make_alone(i)[0]["depth"] for i in range(first, index + 1)
        }
        return median_of_valid(np.stack(list(self._delivered.values())))

    def see(self, scene: Scene, *, rng: np.random.Generator, exposures: Sequence[Scene] = ()) -> Frame:
        """A scene as the camera delivers it: every variable of the dataset standard.

        exposures: what there is to see at each of the sensor's samples, where people move in between.
        """
        with self.stage("render"):
            views = {id(moment): self._view(moment) for moment in {id(m): m for m in exposures if m is not scene}.values()}
        with self.stage("assemble"):
            surface = scene.surface()
        camera_from_world = invert(scene.world_from_camera)
        with self.stage("render"):
            joints_3d = joints_in_camera(scene, self._slots)
            rendered = self._rasteriser.render(
                surface, camera_from_world, closed=scene.closed, joints=joints_3d, instances=self._instances
            )
        with self.stage("sensor"):
            taken = [views.get(id(moment), rendered.buffers) for moment in exposures]
            sensed = simulate(rendered.buffers, self._sensor, self._config.noise, rng=rng, exposures=taken)
        pictures: Mapping[str, Any] = {}
        if self._pictures is not None:
            with self.stage("pictures"):
                pictures = self._pictures.take(scene, surface, rng=rng)
        styled: Mapping[str, Any] = {}
        if self._styler is not None:
            with self.stage("style"):
                styled = self._styler.take(sensed.depth_m, rendered.depth_clean, rendered.labels, rendered.instance, rng=rng)
        facts = FrameFacts(self._config, self._seed, self._slots, scene, joints_3d, rendered, sensed, pictures, styled)
        return make_variables(self._rows, facts)

    def _view(self, scene: Scene) -> GeometryBuffers:
        """What the camera sees of a scene."""
        rendered = self._rasteriser.render(scene.surface(), invert(scene.world_from_camera), closed=scene.closed)
        return rendered.buffers.copy()

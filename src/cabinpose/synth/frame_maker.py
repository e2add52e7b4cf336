"""A frame of a dataset by its number: its scene, drawn, rendered and seen by the sensor, and the variables that tell of it."""

from __future__ import annotations

import time
from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from cabinpose.core import CABINPOSE, apply, invert
from cabinpose.scene.sensor import GeometryBuffers, PhysicalNoise, material_table, median_of_valid, sample_times, simulate
from cabinpose.synth.config import SynthConfig, person_slots
from cabinpose.synth.pictures.look import near_infrared
from cabinpose.synth.reflectances import Reflectances
from cabinpose.synth.render import Rasteriser
from cabinpose.synth.sample import SceneSampler
from cabinpose.synth.scene import Scene
from cabinpose.synth.streams import frame_rng, light_rng, noise_rng
from cabinpose.synth.sunlight import SunView
from cabinpose.synth.variables import TABLE, Frame, FrameFacts

if TYPE_CHECKING:
    from cabinpose.synth.pictures.maker import PictureMaker
    from cabinpose.synth.style.stage import FrameStyler


class FrameMaker:
    """Makes any frame of a dataset from its number, in one thread."""

    def __init__(self, config: SynthConfig, seed: int, sampler: SceneSampler | None = None, *, pictures: bool = True) -> None:
        """sampler: of the same configuration and seed, to share people and cars with; its own by default · pictures: False
        leaves out those that the configuration asks for, and styled depth, which nobody looks at.
        """
        self.config = config if pictures else config.model_copy(update={"images": None, "style": None})
        self._seed = seed
        self.seconds: defaultdict[str, float] = defaultdict(float)
        self.sampler = sampler or SceneSampler(config, seed)
        self._sensor = config.camera.sensor_model
        self._reflectances = Reflectances(seed, self._sensor.wavelength_nm)
        self._rasteriser = Rasteriser(self._sensor.camera, supersample=config.camera.supersample)
        self._sequence = config.scene.sequence
        moving = self._sequence is not None and self._sequence.exposure_motion
        physical = config.noise if isinstance(config.noise, PhysicalNoise) else None
        self._sample_times = sample_times(self._sensor, physical) if moving and physical else np.zeros(0)
        self._sun_view = None if config.sunlight is None else SunView(seed, self._sensor.wavelength_nm)
        self._delivered: dict[int, np.ndarray] = {}  # depths of the frames before, where they are filtered over time
        self._pictures: PictureMaker | None = None
        if self.config.images is not None:
            from cabinpose.synth.pictures.maker import PictureMaker  # noqa: PLC0415 - loaded where there are pictures

            self._pictures = PictureMaker(self.config.images, self._sensor, seed)
        self._styler: FrameStyler | None = None
        if self.config.style is not None:
            from cabinpose.synth.style.stage import FrameStyler  # noqa: PLC0415 - loaded where depth is styled

            self._styler = FrameStyler(self.config.style)
        self._slots = person_slots(config)
        self._instances = np.arange(1, len(self._slots) + 1, dtype=np.uint8)
        self._rows = [row for row in TABLE if list(row.names(self.config))]

    def beside(self) -> FrameMaker:
        """Another one for another thread, with the same people and cars."""
        return FrameMaker(self.config, self._seed, self.sampler)

    @contextmanager
    def stage(self, name: str) -> Iterator[None]:
        """Counts this thread's CPU time spent inside under `name`."""
        start = time.thread_time()
        yield
        self.seconds[name] += time.thread_time() - start

    def make(self, index: int) -> tuple[Frame, Scene]:
        """Frame `index`: every variable of the dataset standard, and the scene it shows."""
        depths = {}
        for i in self._filtered_over(index):
            if i < index and i in self._delivered:  # what other threads made is made again
                depths[i] = self._delivered[i]
                continue
            frame, scene = self._make_alone(i)
            depths[i] = frame["depth"]
        self._delivered = depths
        if len(depths) > 1:
            frame["depth"] = median_of_valid(np.stack(list(depths.values())))
        return frame, scene

    def _filtered_over(self, index: int) -> range:
        """The frames whose median depth the camera delivers as that of a frame: the last ones of its sequence."""
        return range(max(index - self._sensor.temporal_median + 1, self._first(index)), index + 1)

    def _first(self, index: int) -> int:
        """The frame with which the sequence of a frame begins; itself where there are none."""
        return index if self._sequence is None else self._sequence.first_of(index)

    def _make_alone(self, index: int) -> tuple[Frame, Scene]:
        """A frame as it is before a filter over time."""
        rng = frame_rng(self._seed, index)
        with self.stage("sample_and_validate"):
            scene = self.sampler.sample(index, rng=rng)
            exposures = self.sampler.exposed(index, scene, self._sample_times) if self._sample_times.size else []
        return self.see(scene, rng=noise_rng(self._seed, index), exposures=exposures, index=index), scene

    def see(self, scene: Scene, *, rng: np.random.Generator, exposures: Sequence[Scene] = (), index: int = 0) -> Frame:
        """A scene as the camera delivers it: every variable of the dataset standard.

        exposures: what there is to see at each of the sensor's samples, where people move in between · index: the frame whose sun
        and light there are.
        """
        with self.stage("render"):
            views = {id(moment): self._view(moment) for moment in {id(m): m for m in exposures if m is not scene}.values()}
        with self.stage("assemble"):
            surface = scene.surface()
            found = self._reflectances.of(scene, surface)
        camera_from_world = invert(scene.world_from_camera)
        with self.stage("render"):
            joints_3d = np.full((len(self._slots), len(CABINPOSE.joints), 3), np.nan)
            for person in scene.people:
                joints_3d[self._slots.index(person.slot)] = apply(camera_from_world, person.posed.joints)
            rendered = self._rasteriser.render(
                found.plain, camera_from_world, closed=scene.closed, joints=joints_3d, instances=self._instances
            )
            buffers = found.printed(rendered, self._sensor.camera, scene.world_from_camera)
        sun = None if self.config.sunlight is None else self.config.sunlight.draw(self._seed, index, self._sequence)
        if sun is not None and self._sun_view is not None:
            with self.stage("sunlight"):
                light = self._sun_view.light(scene, surface, sun, self._sensor.camera, rendered)
                buffers = replace(buffers, sunlight=light)
        with self.stage("sensor"):
            taken = [views.get(id(moment), buffers) for moment in exposures]
            sensed = simulate(buffers, self._sensor, self.config.noise, rng=rng, exposures=taken)
        pictures: Mapping[str, Any] = {}
        if self._pictures is not None:
            with self.stage("pictures"):
                table = material_table(True, False, 0.0, 0.0, self._sensor.wavelength_nm, found.coats)
                lit = light_rng(self._seed, self._first(index))
                pictures = self._pictures.take(scene, surface, near_infrared(found.surface, table), rng=rng, lit=lit, sun=sun)
        styled: Mapping[str, Any] = {}
        if self._styler is not None:
            with self.stage("style"):
                styled = self._styler.take(sensed.depth_m, rendered.depth_clean, rendered.labels, rendered.instance, rng=rng)
        facts = FrameFacts(self.config, self._seed, self._slots, scene, joints_3d, found.worn, rendered, sensed, pictures, styled)
        return {name: value for row in self._rows for name, value in row.make(facts).items()}

    def _view(self, scene: Scene) -> GeometryBuffers:
        """What the camera sees of a scene."""
        found = self._reflectances.of(scene, scene.surface())
        rendered = self._rasteriser.render(found.plain, invert(scene.world_from_camera), closed=scene.closed)
        return found.printed(rendered, self._sensor.camera, scene.world_from_camera).copy()

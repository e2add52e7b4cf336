"""From scenes to a part of a dataset: place, render, simulate the sensor, look which joints are seen, write."""

from __future__ import annotations

import time
from collections import Counter, defaultdict
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from threadpoolctl import threadpool_limits

from cabinpose.core.frames import apply, invert
from cabinpose.core.skeleton import ITOP_JOINTS, JOINTS
from cabinpose.scene.sensor import simulate
from cabinpose.store import Manifest, PartPlan, PartWriter
from cabinpose.synth.config import SynthConfig, frame_rng
from cabinpose.synth.profiles import IncrementalProfile
from cabinpose.synth.render import Rasteriser, joint_visibility
from cabinpose.synth.sample import ImpossibleSceneError, Scene, SceneSampler, person_slots

Frame = dict[str, Any]


@dataclass(frozen=True)
class PartReport:
    """What making one part took. frames: written, without those skipped · proposals, rejections: poses of people."""

    frames: int
    proposals: int
    rejections: Mapping[str, int]
    stage_seconds: Mapping[str, float]


class FrameMaker:
    """Makes any frame of a dataset from its number."""

    def __init__(self, config: SynthConfig, seed: int) -> None:
        self.seconds: defaultdict[str, float] = defaultdict(float)
        self._config = config
        self._seed = seed
        self._sampler = SceneSampler(config, seed)
        self._sensor = config.camera.sensor_model
        self._rasteriser = Rasteriser(self._sensor.camera, supersample=config.camera.supersample)
        self._slots = person_slots(config)
        self._instances = np.arange(1, len(self._slots) + 1, dtype=np.uint8)

    @contextmanager
    def stage(self, name: str) -> Iterator[None]:
        """Counts the time spent inside under `name`."""
        start = time.perf_counter()
        yield
        self.seconds[name] += time.perf_counter() - start

    def make(self, index: int) -> tuple[Frame, Scene]:
        """Frame `index`: every variable of the dataset standard, and the scene it shows."""
        rng = frame_rng(self._seed, index)
        with self.stage("sample_and_validate"):
            scene = self._sampler.sample(index, rng=rng)
        return self.see(scene, rng=rng), scene

    def see(self, scene: Scene, *, rng: np.random.Generator) -> Frame:
        """A scene as the camera delivers it: every variable of the dataset standard."""
        with self.stage("assemble"):
            surface = scene.surface()
        camera_from_world = invert(scene.world_from_camera)
        with self.stage("render"):
            rendered = self._rasteriser.render(surface, camera_from_world, closed=scene.closed)
        with self.stage("sensor"):
            seen = simulate(rendered.buffers, self._sensor, self._config.noise, rng=rng)
        with self.stage("joints"):
            joints = self._joints(scene, camera_from_world)
            visibility = joint_visibility(joints["joints_3d"], self._instances, surface, camera_from_world, self._sensor.camera)
        camera = self._sensor.camera
        return {
            "depth": seen.depth_m,
            "depth_clean": rendered.depth_clean,
            "amplitude": seen.amplitude,
            "confidence": seen.confidence,
            "labels": rendered.labels,
            "instance": rendered.instance,
            **joints,
            "visibility": visibility,
            "camera_k": camera.k,
            "camera_dist": np.array(camera.dist),
            "vehicle_from_camera": scene.world_from_camera,
            "sync_ns": 0,
            "sequence": 0,
            "seed": self._seed,
            "subject": self._per_slot(scene, "subject"),
            "action": self._per_slot(scene, "action"),
            "car": scene.place,
            "pov": scene.pov,
        }

    def _per_slot(self, scene: Scene, attribute: str) -> list[str]:
        names = {person.slot: getattr(person, attribute) for person in scene.people}
        return [names.get(slot, "") for slot in self._slots]

    def _joints(self, scene: Scene, camera_from_world: np.ndarray) -> Frame:
        """joints_3d (P, 20, 3) m and joints_2d (P, 20, 2) px in the camera, NaN for empty slots; ITOP's in a room."""
        count = len(self._slots)
        joints_3d = np.full((count, len(JOINTS), 3), np.nan)
        itop = np.full((count, len(ITOP_JOINTS), 3), np.nan)
        for person in scene.people:
            row = self._slots.index(person.slot)
            joints_3d[row] = apply(camera_from_world, person.posed.joints)
            if self._config.scene.kind == "room":
                itop[row] = apply(camera_from_world, person.itop_joints())
        result: Frame = {"joints_3d": joints_3d, "joints_2d": self._sensor.camera.project(joints_3d)}
        if self._config.scene.kind == "room":
            result["itop_joints_3d"] = itop
        return result


def frame_maker(config: SynthConfig, seed: int) -> FrameMaker:
    """One `FrameMaker` a process and configuration: parts that follow each other share its bodies and cabins."""
    return _maker(config.model_dump_json(), seed)


@lru_cache(maxsize=2)
def _maker(config_json: str, seed: int) -> FrameMaker:
    return FrameMaker(SynthConfig.model_validate_json(config_json), seed)


def make_part(folder: Path, plan: PartPlan, config: SynthConfig, manifest: Manifest) -> PartReport:
    """Make the frames of one part and write them, whole or not at all."""
    # One thread: the libraries' results, and with them the bytes on disk, may depend on their number of threads.
    with threadpool_limits(1):
        maker = frame_maker(config, manifest.seed)
        maker.seconds.clear()
        proposals = 0
        rejections: Counter[str] = Counter()
        frames = 0
        # A combination of an incremental profile that no scene allows is left out; any other frame must be found.
        may_skip = isinstance(config.scene.profile, IncrementalProfile)
        with PartWriter(folder, plan, manifest) as part:
            for index in range(plan.first, plan.first + plan.frames):
                try:
                    frame, scene = maker.make(index)
                except ImpossibleSceneError as error:
                    if not may_skip:
                        raise
                    proposals += error.proposals
                    rejections.update(error.rejections)
                    part.skip()
                    continue
                proposals += scene.proposals
                rejections.update(scene.rejections)
                with maker.stage("write"):
                    part.append(frame)
                frames += 1
            part.attrs["proposals"] = proposals
            part.attrs["rejections"] = dict(sorted(rejections.items()))
    return PartReport(frames, proposals, dict(rejections), dict(maker.seconds))

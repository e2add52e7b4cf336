"""Scenes drawn at random and kept only when they are possible.

A scene is drawn in two rings. The inner one poses a person, again and again until the pose holds against the body
itself, the people already seated and the car. Where that fails for too long the outer ring draws everything anew
(car, seats, people); where that fails too the run ends with an error that names the cause. `posing` keeps the inner ring.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from cabinpose.core import ConfigError, Floats
from cabinpose.synth.car_scenes import CarScenes
from cabinpose.synth.cars import is_car_file
from cabinpose.synth.config import RoomScene, SynthConfig
from cabinpose.synth.motion.film import Film, Films
from cabinpose.synth.plan import Plan
from cabinpose.synth.room_scenes import RoomScenes
from cabinpose.synth.scene import Attempts, ImpossibleSceneError, Scene
from cabinpose.synth.validate import Verdict


class SceneSampler:
    """Draws the scenes of one dataset. Holds the bodies, cabins and rooms used last, a bounded number of each."""

    def __init__(self, config: SynthConfig, seed: int, *, like: SceneSampler | None = None) -> None:
        """like: a sampler whose people, cars and rooms are taken over as far as configuration and seed make the same ones."""
        self._limit = config.limits.scenes_per_frame
        self._plan: Plan = Plan(config, seed, like=None if like is None else like._plan)
        self._scenes: CarScenes | RoomScenes
        self._films: Films | None = None
        if isinstance(config.scene, RoomScene):
            self._scenes = RoomScenes(config.scene, config, self._plan)
        else:
            self._scenes = cars = CarScenes(config.scene, config, self._plan)
            self._films = None if config.scene.sequence is None else Films(cars, config.scene.sequence, seed)

    def sample(self, index: int, *, rng: np.random.Generator) -> Scene:
        """The scene of frame `index`. Raises SceneError where none is found within the configured limits."""
        if self._films is not None:
            return self._films.scene(index)
        attempts = Attempts()
        for _ in range(self._limit):
            found = self._scenes.draw(index, attempts, rng=rng)
            if found is not None:
                return replace(found, proposals=attempts.proposals, judged=attempts.judged, rejections=attempts.rejections)
        raise ImpossibleSceneError(index, attempts, next(filter(is_car_file, self._plan.cabins.names), ""))

    def plan_sequence(self, number: int) -> Film:
        """Plan a sequence before its first frame is asked for, once. Raises SceneError where nobody has a free way."""
        assert self._films is not None
        return self._films.film(number)

    def exposed(self, index: int, scene: Scene, times_s: Floats) -> Sequence[Scene]:
        """The scene of frame `index` of a sequence at some times (S,) s before and after its own: see `Films.exposed`."""
        assert self._films is not None
        return self._films.exposed(index, scene, times_s)

    def as_given(self, index: int, *, rng: np.random.Generator) -> tuple[Scene, tuple[Verdict, ...]]:
        """The people who have whole poses in frame `index`, and why it does not hold, the first reason for each of them.

        Where it holds, and everybody has a pose, it is the scene of `sample`. Raises ConfigError for scenes in rooms.
        """
        if not isinstance(self._scenes, CarScenes):
            raise ConfigError("only scenes in cars have given poses", hint="give a scene of people in a car")
        return self._scenes.as_given(index, rng=rng)

"""Scenes of one person who stands in a room."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from cabinpose.core import STANDING_SLOT, axis_rotation, transform
from cabinpose.core import reproducible as rp
from cabinpose.scene import ROOM_VIEWS, place_room_camera
from cabinpose.synth.config import RoomScene, SynthConfig
from cabinpose.synth.faces import with_faces
from cabinpose.synth.plan import Plan
from cabinpose.synth.scene import Attempts, Scene, ScenePerson
from cabinpose.synth.standing import sample_standing
from cabinpose.synth.streams import weighted
from cabinpose.synth.validate import Validator


class RoomScenes:
    """Draws scenes in the rooms of one dataset."""

    def __init__(self, scene: RoomScene, config: SynthConfig, plan: Plan) -> None:
        """scene: that of the configuration."""
        self._scene, self._plan, self._limits = scene, plan, config.limits
        views = {name: weight for name, weight in config.camera.weights.items() if name in ROOM_VIEWS}
        self._views = views or {"room": 1.0}
        self._bodies = Validator(None)

    def draw(self, index: int, attempts: Attempts, *, rng: np.random.Generator) -> Scene | None:
        """A scene of frame `index`; None where the person finds no valid pose."""
        number = int(rng.integers(self._scene.rooms))
        room = self._plan.room(number)
        (subject,) = self._plan.people(index, 1, rng=rng)
        person = self._plan.subjects.person(subject, self._plan.outfit(index, subject))
        attempts.scenes.append(f"room {number} ({subject})")
        view = weighted(self._views, rng=rng)
        camera, spot = place_room_camera(view, room, rng=rng)
        # People face the camera of the view `room`, which in its other views stands for whatever they look at.
        heading = rp.arctan2(-spot[1], -spot[0]) + np.radians(self._scene.facing_deg) * rng.standard_normal()
        for _ in range(self._limits.poses_per_person):
            attempts.proposals += 1
            pose = sample_standing(person, self._scene.profile, index=index, rng=rng)
            world_from_root = rp.matmul(transform(axis_rotation("z", heading), spot), pose.floor_from_root)
            posed = person.pose(pose.q, world_from_root)
            verdict = self._bodies.check([(STANDING_SLOT, person, posed)], {})
            attempts.judge(verdict.rejection)
            if verdict.rejection is None:
                somebody = ScenePerson(STANDING_SLOT, subject, pose.action, person, posed)
                (somebody,) = with_faces([somebody], {}, None, seed=self._plan.seed, number=index)
                somebody = replace(somebody, surfaces=(posed.surface(1, somebody.face),))
                return Scene(room.surface, (somebody,), camera, f"room_{number:03d}", view)
        return None

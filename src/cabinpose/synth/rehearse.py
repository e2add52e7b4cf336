"""The first frame of a fresh installation compiles every kernel, minutes of work: two processes share it.

Kernels are compiled when they are first called, and kept on disk. Workers that start together would each compile all of
them; so one of them makes a frame from its beginning, the other one goes through contact and the camera, and each then
finds on disk what the other has compiled. With everything on disk already a rehearsal takes about a second.
"""

from __future__ import annotations

from contextlib import suppress

import numpy as np

from cabinpose.core.errors import CabinposeError
from cabinpose.core.frames import transform
from cabinpose.scene.body import DOFS, SUBJECTS, BodyModel
from cabinpose.scene.cabin import PRESETS
from cabinpose.scene.sensor import place_camera
from cabinpose.synth.config import CabinScene, SynthConfig, frame_rng
from cabinpose.synth.sample import Scene, ScenePerson, judged_cabin, person_slots
from cabinpose.synth.validate import Validator
from cabinpose.synth.write import frame_maker

SHARES = 2
_ALOFT_M = 5.0  # above the cabin, where nothing is touched and so every test of contact is gone through


def rehearse(config: SynthConfig, seed: int, share: int) -> None:
    """Compile one of the `SHARES` shares. What is wrong with a configuration the frames themselves will say."""
    maker = frame_maker(config, seed)
    with suppress(CabinposeError):
        if share == 0:
            maker.make(0)
        else:
            maker.see(_aloft(config), rng=frame_rng(seed, 0))


def _aloft(config: SynthConfig) -> Scene:
    """Somebody high above an empty cabin, tested for contact, before a camera."""
    named = next(iter(SUBJECTS.values()))
    person = BodyModel.load().person(named.phenotype, named.outfit)
    posed = person.pose(np.zeros(len(DOFS)), transform(None, (0.0, 0.0, _ALOFT_M)))
    slot = person_slots(config)[0]
    cabin, settings, validator = None, {}, Validator(None)
    if isinstance(config.scene, CabinScene):
        cabin, validator = judged_cabin(next(iter(config.scene.cars), PRESETS[0]), "left")
        settings = {name: seat.default for name, seat in cabin.seats.items()}
    validator.admit(validator.empty(settings), (slot, person, posed), None)
    camera = place_camera((2.0, 0.0, _ALOFT_M), (0.0, 0.0, _ALOFT_M), rng=frame_rng(0, 0))
    somebody = ScenePerson(slot, "", "", person, posed, (posed.surface(1),))
    backdrop = cabin.surface(settings) if cabin is not None else somebody.surfaces[0]
    return Scene(backdrop, (somebody,), camera, "", "", cabin, settings, 0.0)

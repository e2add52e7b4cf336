"""Where the camera is: a view drawn by its weight, jittered, and before whose lens nobody is."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from typing import NamedTuple

import numpy as np

from cabinpose._native import cabin as native
from cabinpose.core import Matrix, axis_rotation, transform
from cabinpose.core import reproducible as rp
from cabinpose.scene.cabin import Cabin
from cabinpose.scene.sensor import jittered, place_camera
from cabinpose.synth.camera import Camera, CameraPose, ExactCameraPose
from cabinpose.synth.scene import ScenePerson
from cabinpose.synth.streams import weighted
from cabinpose.synth.validate import Seated

LENS_M = 0.01  # free space a lens needs around it
_FACE_M = 0.08  # nothing alive is nearer to a lens than this
_DRAWS = 5  # until a scene is given up in which somebody is before the lens


class Viewpoint(NamedTuple):
    """A camera's place: the view's name and vehicle_from_camera (4, 4), of a room world_from_camera."""

    view: str
    vehicle_from_camera: Matrix

    def blocked(self, people: Iterable[ScenePerson], seated: Seated) -> bool:
        """Whether it lies inside the cabin's parts, or nearer to a person than a lens can be."""
        eye = self.vehicle_from_camera[:3, 3]
        if seated.placed is not None and seated.placed.clearance(eye[None])[0] < LENS_M:
            return True
        return any(native.any_nearer(p.posed.skin, eye.astype(np.float32), _FACE_M) for p in people)


def draw_viewpoint(camera: Camera, cabin: Cabin, view: str | None = None, *, rng: np.random.Generator) -> Viewpoint:
    """A view of a car, jittered; view: which one, in place of one drawn by its weight."""
    name = view or weighted(camera.weights, rng=rng)
    jitter = {"translation_jitter": camera.jitter_m, "rotation_jitter": np.radians(camera.jitter_deg)}
    own = camera.views[name]
    if isinstance(own, ExactCameraPose):
        return Viewpoint(name, jittered(np.array(own.vehicle_from_camera), **jitter, rng=rng))
    if isinstance(own, CameraPose):
        upright = place_camera(own.position_m, own.look_at_m, rng=rng)
        rolled = rp.matmul(upright, transform(axis_rotation("z", math.radians(own.roll_deg))))
        return Viewpoint(name, jittered(rolled, **jitter, rng=rng))
    anchor = cabin.view(name)
    return Viewpoint(name, place_camera(anchor.eye, anchor.target, **jitter, rng=rng))


def free_viewpoint(
    draw: Callable[[], Viewpoint], people: Callable[[], Iterable[ScenePerson]], seated: Seated
) -> Viewpoint | None:
    """The first of a few drawn viewpoints that nobody comes before; None where there is none."""
    drawn = (draw() for _ in range(_DRAWS))
    return next((viewpoint for viewpoint in drawn if not viewpoint.blocked(people(), seated)), None)

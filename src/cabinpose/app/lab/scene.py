"""What the ToF camera sees of a person who moves, through the generator's own renderer and sensor model, with the truth."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from cabinpose.app.lab.motion import KeyedMotion
from cabinpose.app.lab.rig import VirtualRig
from cabinpose.core import Matrix, invert, transform
from cabinpose.scene import Room
from cabinpose.scene.cabin import Wearer
from cabinpose.scene.sensor import Sensor
from cabinpose.signals import ToFFrame
from cabinpose.synth import CabinScene, FrameMaker, RoomScene, Scene, ScenePerson, SynthConfig, person_slots
from cabinpose.synth import Camera as CameraConfig

DEPTH_UNIT_M = 1e-4
VIEW = "driver"


def world_from_vehicle(rig: VirtualRig, motion: KeyedMotion, view: str = VIEW) -> Matrix:
    """Where the car stands: so that the rig's camera is at a view's place in it and looks that way, with its own pitch and roll.

    A rotation about the vertical and a translation: both frames have z up.
    """
    if motion.cabin is None:
        raise ValueError("a motion in a room has no vehicle")
    anchor = motion.cabin.view(view)
    world_from_camera = invert(rig.camera_from_world)
    wanted = np.asarray(anchor.target) - anchor.eye
    return _placed(world_from_camera, np.asarray(anchor.eye), float(np.arctan2(wanted[1], wanted[0])))


def world_from_room(rig: VirtualRig) -> Matrix:
    """Where a room stands: its origin on the floor under the rig's camera, 1.4 m below it, x the way it looks."""
    return _placed(invert(rig.camera_from_world), np.array((0.0, 0.0, 1.4)), 0.0)


def _placed(world_from_camera: Matrix, eye: NDArray[np.float64], heading: float) -> Matrix:
    """world_from_scene, upright, in which the camera is at `eye` and looks along a heading of the scene."""
    axis = world_from_camera[:3, 2]
    turn = Rotation.from_euler("z", np.arctan2(axis[1], axis[0]) - heading)
    return transform(turn, world_from_camera[:3, 3] - turn.apply(eye))


class SceneCamera:
    """Makes the camera's frames of people who move in one car or room."""

    def __init__(
        self, rig: VirtualRig, motions: Sequence[KeyedMotion], world_from_scene: Matrix, room: Room | None = None, *,
        sensor: Sensor | None = None,
    ) -> None:  # fmt: skip
        """motions: of one car, or without one · room: what stands around people outside a car · sensor: in place of the rig's."""
        self._motions = tuple(motions)
        self._scene_from_camera = invert(world_from_scene) @ invert(rig.camera_from_world)
        scene = CabinScene() if motions[0].cabin is not None else RoomScene()
        config = SynthConfig(scene=scene, camera=CameraConfig(sensor=sensor or rig.tof_sensor), noise=rig.noise)
        self._maker = FrameMaker(config, 0)
        self._rows = [person_slots(config).index(motion.slot) for motion in motions]
        self._room = room

    def frame(self, time_s: float, *, rng: np.random.Generator) -> dict[str, Any]:
        """The frame at a time: variables of the dataset standard, as `FrameMaker.see` has them.

        joints_3d (P, 20, 3) m, camera frame, joints_2d (P, 20, 2) px and visibility (P, 20) are of the motions' people.
        """
        frame = dict(self._maker.see(self._scene(time_s), rng=rng))
        for name in ("joints_3d", "joints_2d", "visibility"):
            frame[name] = frame[name][self._rows]
        return frame

    def _scene(self, time_s: float) -> Scene:
        first = self._motions[0]
        # Each knows of their own seat alone how it is set.
        settings = {**first.settings, **{m.slot: m.settings[m.slot] for m in self._motions if m.cabin is not None}}
        people = tuple(self._person(m, row, time_s) for m, row in zip(self._motions, self._rows, strict=True))
        if first.cabin is None:
            if self._room is None:
                raise ValueError("a person outside a car needs a room to be seen in")
            return Scene(self._room.surface, people, self._scene_from_camera, "room", "room")
        wheel = sum(float(m.pose_at(time_s)[2][0]) for m in self._motions)  # the driver's: others leave it as it is
        backdrop = first.cabin.surface(settings, wheel_angle=wheel)
        return Scene(backdrop, people, self._scene_from_camera, first.cabin.name, VIEW, first.cabin, settings, wheel)

    @staticmethod
    def _person(motion: KeyedMotion, row: int, time_s: float) -> ScenePerson:
        """Somebody at a time, belted in a car."""
        body = motion.body(time_s)
        clothed = body.surface(1 + row)
        surfaces = [clothed]
        if motion.cabin is not None and (seat := motion.cabin.seats[motion.slot]).belt is not None:
            setting = motion.settings[motion.slot]
            surfaces.append(Wearer.of(clothed, body.joints).belt(seat, setting, motion.cabin))
        return ScenePerson(motion.slot, "", motion.key_at(time_s), motion.person, body, tuple(surfaces))


def message_of(frame: dict[str, Any]) -> ToFFrame:
    """A frame as a camera delivers it: depth in steps of 0.1 mm."""
    depth = np.nan_to_num(np.rint(frame["depth"] / DEPTH_UNIT_M), nan=0.0)
    return ToFFrame(
        np.minimum(depth, 65535).astype(np.uint16), DEPTH_UNIT_M, np.asarray(frame["amplitude"], np.uint16),
        np.asarray(frame["confidence"], np.uint8), frame["camera_k"], frame["camera_dist"], frame["camera_dist"],
    )  # fmt: skip

"""What the views of a car see of people: shares of heads, hands and seats over drawn scenes."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from cabinpose.core import JOINTS, Bools, ConfigError, Visibility, apply, invert
from cabinpose.scene.cabin import SEATS_OF_ALL, Cabin, ViewAnchor
from cabinpose.scene.sensor import PhysicalNoise, Sensor, place_camera
from cabinpose.synth.cabins import open_cabin
from cabinpose.synth.config import SynthConfig
from cabinpose.synth.place import PlaceReport, judge_place, reduced
from cabinpose.synth.render import Rasteriser
from cabinpose.synth.sample import SceneSampler
from cabinpose.synth.scene import Scene
from cabinpose.synth.streams import frame_rng

_HEAD = [JOINTS.index("head")]
_HANDS = [JOINTS.index(name) for name in ("lhand", "rhand")]
_SEATED = [JOINTS.index(name) for name in ("head", "neck", "lshoulder", "rshoulder")]


@dataclass(frozen=True)
class ViewReport:
    """What a view of a car sees. anchor: where it is · place: of the empty car · people: how many were looked at · heads, hands:
    share of theirs that are seen, in range and hidden by nothing · seats: by seat the share of those who sat there of whom
    head, neck or a shoulder is seen; NaN where nobody sat.
    """

    anchor: ViewAnchor
    place: PlaceReport
    people: int
    heads: float
    hands: float
    seats: dict[str, float]


def views_seen(
    car: str, sensor: Sensor, *, frames: int, seed: int = 0, progress: Callable[[int], None] = lambda _: None
) -> list[ViewReport]:
    """What each view of a car sees of the people of drawn scenes: the driver in each, everybody else in about half of them.

    Parameters
    ----------
    car
        A preset, or the YAML of an own mesh; with the wheel on the left where it can be on both sides.
    sensor
        The camera.
    frames
        How many scenes are drawn; all views see the same.
    seed
        Of the scenes.
    progress
        Called with the number of scenes that were drawn.

    Raises
    ------
    ConfigError, MeshError
        For a car that is not there, or has no view.
    SceneError
        Where no scene can be drawn.
    """
    occupancy = dict.fromkeys(("rear_center", *SEATS_OF_ALL), 0.5) | {"driver": 1.0}
    scene = {"kind": "cabin", "cars": [car], "right_hand_drive": 0.0, "occupancy": occupancy}
    SynthConfig.parse({"scene": scene})  # ConfigError for a car that is not there
    views = dict.fromkeys(open_cabin(car, "left").views, 1.0)
    if not views:
        raise ConfigError(f"{car} has no views", hint="give them in its file: views: {NAME: {eye: [x, y, z], target: [x, y, z]}}")
    sampler = SceneSampler(SynthConfig.parse({"scene": scene, "camera": {"views": views}}), seed)
    scenes = []
    for index in range(frames):
        scenes.append(sampler.sample(index, rng=frame_rng(seed, index)))
        progress(index + 1)
    cabin = scenes[0].cabin
    assert cabin is not None
    return [_seen(cabin, name, sensor, scenes) for name in cabin.views]


def _seen(cabin: Cabin, name: str, sensor: Sensor, scenes: list[Scene]) -> ViewReport:
    anchor = cabin.views[name]
    pose = place_camera(anchor.eye, anchor.target, rng=frame_rng(0, 0))
    camera_from_vehicle, rasteriser = invert(pose), Rasteriser(reduced(sensor).camera, supersample=1)
    slots: list[str] = []
    rows: list[Bools] = []
    for scene in scenes:
        joints = np.stack([apply(camera_from_vehicle, person.posed.joints) for person in scene.people])
        instances = [int(person.surfaces[0].instance[0]) for person in scene.people]
        rendered = rasteriser.render(
            scene.surface(), camera_from_vehicle, closed=scene.closed, joints=joints, instances=instances
        )
        in_range = (joints[..., 2] >= sensor.range_m[0]) & (joints[..., 2] <= sensor.range_m[1])  # of depth, as the sensor has it
        rows += list(np.logical_and(rendered.visibility == Visibility.VISIBLE, in_range))
        slots += [person.slot for person in scene.people]
    seen = np.array(rows)
    somebody = np.asarray(seen[:, _SEATED].any(axis=1))
    taken = {slot: np.array([each == slot for each in slots]) for slot in cabin.seats}
    seats = {slot: float(somebody[who].mean()) if who.any() else float("nan") for slot, who in taken.items()}
    place = judge_place(cabin, name, pose, sensor, PhysicalNoise())
    return ViewReport(anchor, place, len(seen), float(seen[:, _HEAD].mean()), float(seen[:, _HANDS].mean()), seats)

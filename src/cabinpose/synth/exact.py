"""A scene that was drawn, as a configuration that says all of it: to keep one, to change one by hand, to make it again."""

from __future__ import annotations

import math
from typing import Any

from cabinpose.core import ConfigError, Floats, Matrix
from cabinpose.scene.body import DOFS
from cabinpose.scene.cabin import SeatSetting
from cabinpose.synth.camera import ExactCameraPose
from cabinpose.synth.cars import place_name
from cabinpose.synth.config import CabinScene, SynthConfig
from cabinpose.synth.occupant import ExactFace, ExactPose, ExactSetting, ExactThing, ExactTongue, Matrix4, Occupant
from cabinpose.synth.sample import SceneSampler
from cabinpose.synth.scene import Scene, ScenePerson
from cabinpose.synth.streams import frame_rng


def exact_config(config: SynthConfig, seed: int, index: int) -> SynthConfig:
    """A configuration whose frames all show the scene of frame `index` of a dataset.

    Made with the same seed, its frame `index` has the same bytes as that one, but for depth that is a median over time; its other
    frames differ in their noise.

    Parameters
    ----------
    config, seed
        Of the dataset.
    index
        Number of the frame.

    Raises
    ------
    ConfigError
        For scenes in rooms.
    SceneError
        Where the frame has none.
    """
    found = exact_scene(config, SceneSampler(config, seed).sample(index, rng=frame_rng(seed, index)))
    if config.sunlight is None:
        return found
    return found.model_copy(update={"sunlight": config.sunlight.fixed(seed, index, config.scene.sequence)})


def exact_scene(config: SynthConfig, scene: Scene) -> SynthConfig:
    """The configuration whose frames all show a scene that was drawn from `config`. Raises ConfigError for one in a room."""
    if scene.cabin is None:
        raise ConfigError("only scenes in cars are written out", hint="give a dataset of people in cars")
    occupants = {}
    for person in scene.people:
        pose = ExactPose(
            **_exact_setting(scene.settings[person.slot]).model_dump(),
            vehicle_from_root=_rows(person.posed.vehicle_from_root),
            angles_rad={dof.name: float(angle) for dof, angle in zip(DOFS, person.posed.q, strict=True)},
            wheel_angle_rad=scene.wheel_angle if person.slot == "driver" else None,
            fingers=None if (fingers := person.posed.fingers) is None else _curls(fingers),
            face=ExactFace(
                gaze=person.face.gaze, lids=person.face.lids, expression=person.face.expression, units=dict(person.face.units)
            ),
            tongue=_exact_tongue(person),
        )
        worn = {"none": {"belted": False}, "worn": {"belted": True}, "harness": {"belted": True}}.get(
            person.belt, {"belt": person.belt}
        )
        occupants[person.slot] = Occupant(
            subject=person.subject, outfit=person.person.outfit.number, action=person.action, pose=pose, **worn
        )
    seats = {
        slot: _exact_setting(setting)
        for slot, setting in scene.settings.items()
        if slot not in occupants and setting != scene.cabin.seats[slot].default
    }
    things = tuple(
        ExactThing(
            kind=thing.thing.kind, variant=thing.thing.variant, slot=thing.slot, where=thing.at,
            vehicle_from_thing=_rows(thing.vehicle_from_thing), attachment=thing.attachment,
        )
        for thing in scene.things
    )  # fmt: skip
    drawn = config.scene if isinstance(config.scene, CabinScene) else CabinScene()
    car = next((car for car in drawn.cars if place_name(car) == scene.place), scene.place)
    camera = {scene.pov: ExactCameraPose(vehicle_from_camera=_rows(scene.world_from_camera))}
    model = config.camera.sensor_model
    # Its frames show one moment, not a sequence over which a median could be taken.
    sensor = model.model_copy(update={"temporal_median": 1}) if model.temporal_median > 1 else config.camera.sensor
    return SynthConfig(
        scene=CabinScene(
            cars=(car,),
            right_hand_drive=1.0 if scene.cabin.drive_side == "right" else 0.0,
            occupants=occupants,
            occupancy={},
            seats=seats,
            things=things,
            clutter=0.0,
            children=drawn.children,
            infants=drawn.infants,
            toddlers=drawn.toddlers,
            belt_misuse=drawn.belt_misuse,
            attachments=drawn.attachments,
        ),
        people=config.people,
        camera=config.camera.model_copy(update={"sensor": sensor, "views": camera, "jitter_m": 0.0, "jitter_deg": 0.0}),
        noise=config.noise,
        images=config.images,
        style=config.style,
        output=config.output,
        limits=config.limits,
    )


def without_defaults(config: SynthConfig) -> dict[str, Any]:
    """The configuration as plain data, of the keys of the top those that are not as by default; of the scene's likewise."""
    defaults = SynthConfig().model_dump(mode="json")
    told = {key: value for key, value in config.model_dump(mode="json").items() if value != defaults.get(key)}
    told["scene"] = config.scene.model_dump(mode="json", exclude_defaults=True)
    return told


def _exact_setting(setting: SeatSetting) -> ExactSetting:
    return ExactSetting(fore_aft_m=setting.fore_aft_m, height_m=setting.height_m, torso_angle_rad=setting.torso_angle)


def _exact_tongue(person: ScenePerson) -> ExactTongue | None:
    """Where a tongue is that is not in its buckle; a belt that is plugged in is worn as any other."""
    tongue = person.tongue
    if tongue is None or tongue.how == "plugged" or person.belt != "none":
        return None
    x, y, z = tongue.at.tolist()
    return ExactTongue(at_m=(x, y, z), how=tongue.how)


def _curls(fingers: Floats) -> tuple[tuple[float | None, ...], ...]:
    return tuple(tuple(None if math.isnan(curl) else curl for curl in hand) for hand in fingers.tolist())


def _rows(matrix: Matrix) -> Matrix4:
    return tuple((a, b, c, d) for a, b, c, d in matrix.tolist())

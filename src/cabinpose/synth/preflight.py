"""What would fail in the middle of a run, found before it begins: meshes, views, actions, recordings, counts."""

from __future__ import annotations

import warnings
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from cabinpose.core.errors import ConfigError
from cabinpose.scene.cabin import PRESETS, SEATS_OF_ALL, VIEWS_OF_ALL, Cabin, build_cabin
from cabinpose.scene.contact import ContactField
from cabinpose.synth.config import CabinScene, CameraPose, RoomScene, SynthConfig, is_car_file
from cabinpose.synth.plan import DriveSide, car_dimensions
from cabinpose.synth.posture import actions_for

LENS_M = 0.01  # free space a lens needs around it


def preflight(config: SynthConfig, *, frames: int) -> None:
    """Raises ConfigError, MocapError or SceneError for what a run of `frames` frames would fail of; warns of open meshes."""
    scene = config.scene
    if scene.profile is not None:
        scene.profile.preflight(frames)
    if isinstance(scene, RoomScene):
        return
    unusual = not _every_car_has(config, scene)
    for car in scene.cars:
        if unusual or is_car_file(car):
            cabin = open_cabin(car, "left")
            for warning in cabin.warnings:
                warnings.warn(f"{Path(car).name}: {warning}", stacklevel=2)
            _check_car(config, scene, car, cabin, tuple(cabin.seats))
    if scene.random_cars and unusual:  # their seats' actions and their views are the same in all of them: one stands for all
        dimensions = car_dimensions(0, "C0000").model_copy(update={"rear_places": 3})
        cabin = build_cabin(dimensions, drive_side="left")
        _check_car(config, scene, "a random car", cabin, tuple(slot for slot in cabin.seats if slot != "rear_center"))


def _every_car_has(config: SynthConfig, scene: CabinScene) -> bool:
    """Whether all that is asked of a car is in every one that we build, so that none is built to find out."""
    taken = any(scene.occupancy.get(slot, 0.0) > 0 for slot in SEATS_OF_ALL)
    views = config.camera.views.items()
    ours = all(name in VIEWS_OF_ALL and not isinstance(view, CameraPose) for name, view in views if view != 0)
    return taken and ours and not scene.motion


def _check_car(config: SynthConfig, scene: CabinScene, car: str, cabin: Cabin, sure: tuple[str, ...]) -> None:
    """Refuses what cannot be done in a car of this kind, of which every one has the seats `sure`."""
    if not any(scene.occupancy.get(slot, 0.0) > 0 for slot in sure):
        raise ConfigError(f"{car}: no seat of it is ever taken", hint=f"give one of {', '.join(sure)} an occupancy")
    for slot, weights in scene.motion.items():
        if slot in cabin.seats:
            known = actions_for(cabin.seats[slot], cabin)
            wrong = [name for name, weight in weights.items() if weight > 0 and name not in known]
            if wrong:
                raise ConfigError(
                    f"{car}: {', '.join(wrong)} makes no sense in the {slot} seat", hint=f"there: {', '.join(known)}"
                )
    _check_views(config, car, cabin)


def _check_views(config: SynthConfig, car: str, cabin: Cabin) -> None:
    """Refuses a camera that stands inside a part of the car. The own views of cars that we build are known to be free."""
    eyes: dict[str, NDArray[np.float64]] = {}
    for name, view in config.camera.views.items():
        if isinstance(view, CameraPose):
            eyes[name] = np.asarray(view.position_m, dtype=np.float64)
        elif view > 0:
            if any(note.startswith(f"view {name}:") for note in cabin.notes):
                raise ConfigError(
                    f"{car}: no free place was found for the automatic view '{name}'",
                    hint=f"give one in that file, as views: {{{name}: {{eye: [x, y, z], target: [x, y, z]}}}}",
                )
            anchor = cabin.view(name)  # ConfigError for a view that this cabin lacks
            if is_car_file(car):
                eyes[name] = np.asarray(anchor.eye, dtype=np.float64)
    if not eyes:
        return
    clearance = ContactField(cabin).clearance(
        np.stack(list(eyes.values())), {slot: s.default for slot, s in cabin.seats.items()}, 0.0
    )
    for (name, eye), free in zip(eyes.items(), clearance, strict=True):
        if free < LENS_M:
            raise ConfigError(
                f"{car}: the camera of view '{name}' at {eye.round(3).tolist()} m stands inside the car's parts",
                hint="move it into the free space of the cabin",
            )


def open_cabin(car: str, drive_side: DriveSide) -> Cabin:
    """A preset by its name, or a user's own cabin by the path of its YAML file."""
    if car in PRESETS:
        return build_cabin(car, drive_side=drive_side)
    from cabinpose.scene.cabin import load_cabin  # noqa: PLC0415 - trimesh, for a user's own mesh alone

    return load_cabin(car)

"""What would fail in the middle of a run, found before it begins: meshes, views, actions, recordings, counts."""

from __future__ import annotations

import dataclasses
import math
import warnings
from collections.abc import Iterator, Sequence
from contextlib import suppress
from pathlib import Path
from typing import NamedTuple

import numpy as np

from cabinpose.core import ConfigError, DriveSide, Floats, unknown_name
from cabinpose.scene import ROOM_VIEWS
from cabinpose.scene.body import SUBJECTS
from cabinpose.scene.cabin import SEATS_OF_ALL, VIEWS_OF_ALL, Cabin
from cabinpose.scene.contact import ContactField
from cabinpose.synth.cabins import car_dimensions, open_cabin
from cabinpose.synth.camera import Camera
from cabinpose.synth.cars import ChangedPreset, is_car_file, is_random_car
from cabinpose.synth.clutter import DASHBOARD
from cabinpose.synth.config import CabinScene, RoomScene, SynthConfig
from cabinpose.synth.motion.activities import ACTIVITIES, activities_for
from cabinpose.synth.people import People
from cabinpose.synth.pictures.path_tracing import mitsuba
from cabinpose.synth.place import PlaceReport, judge_place
from cabinpose.synth.plan import Plan
from cabinpose.synth.posture import ACTIONS, actions_for
from cabinpose.synth.posture.actions import suits
from cabinpose.synth.streams import frame_rng
from cabinpose.synth.subjects import Subjects
from cabinpose.synth.things import check_size, weights_of
from cabinpose.synth.viewpoint import LENS_M, draw_viewpoint

# Bytes that a run takes: people and cars; for each sample (a part of a pixel) once, and for each worker; for each pixel of one.
_BASE_BYTES, _SAMPLE_BYTES, _WORKER_SAMPLE_BYTES, _PIXEL_BYTES = 200e6, 43, 7, 105


def preflight(config: SynthConfig, *, frames: int, workers: int = 1) -> tuple[PlaceReport, ...]:
    """What would fail in a run of `frames` frames by some threads, and what its cameras see from places of the user's own.

    Returns
    -------
    tuple of PlaceReport
        Of each view of the user's own in each car that is named, and of all views of own meshes; of the package's views in the
        first car where the sensor is the user's own. Their doubts have been warned of, as open meshes are.

    Raises
    ------
    ConfigError, MocapError, ModelError, SceneError
        For what would fail.
    DependencyError
        Where Mitsuba or torch is needed and missing.
    """
    scene = config.scene
    _check_memory(config, workers)
    if config.images is not None and config.images.renderer == "path_traced":
        mitsuba()
    if config.style is not None:
        from cabinpose.synth.style.stage import FrameStyler  # noqa: PLC0415 - ONNX Runtime, where depth is styled

        FrameStyler(config.style)
    if config.frames is not None and frames > config.frames:
        raise ConfigError(
            f"{frames} frames are asked for, but all combinations are {config.frames}",
            hint=f"ask for at most {config.frames} frames, or leave out their number",
        )
    for profile in config.profiles:
        profile.preflight()
    occupants = scene.occupants if isinstance(scene, CabinScene) else {}
    known = {slot: who for slot, o in occupants.items() if (who := o.subject) and (who in SUBJECTS or who in config.people.own)}
    plan = Plan(config, 0)
    bodies = {who: plan.subjects.body(who)[0] for who in (*config.people.own, *known.values())}
    if isinstance(scene, RoomScene):
        for name in config.camera.weights if config.camera.views != Camera().views else ():
            if name not in ROOM_VIEWS:
                raise unknown_name("view of a room", name, ROOM_VIEWS)
        return ()
    for slot, who in known.items():
        for kind in weights_of(scene.child_seats.get(slot, {}), ()):
            check_size(who, bodies[who].stature_m or 0.0, kind)
    if scene.factorial is not None and scene.factorial.seat == "driver":
        _check_drivers(config.people, plan.subjects)
    reports: list[PlaceReport] = []
    side: DriveSide = "right" if scene.right_hand_drive == 1.0 else "left"
    for car in _cars_in_doubt(config, scene, plan, side):
        _check_seats(scene, car)
        _check_actions(scene, car)
        _check_activities(scene, car)
        _doubt_clutter(scene, car)
        _check_views(config, car)
        reports += _judged_views(config, car)
    if not reports and not isinstance(config.camera.sensor, str) and scene.cars:
        first = scene.cars[0]
        cabin = open_cabin(first.dimensions if isinstance(first, ChangedPreset) else first, side)
        reports += _judged_views(config, _Car(cabin.name, cabin, (), ours=False))
    _refuse_blind(config, scene, plan, reports)
    for report in reports:
        if report.doubts:
            warnings.warn(f"view '{report.view}' in {report.car}: {'; '.join(report.doubts)}", stacklevel=2)
    return tuple(reports)


def _refuse_blind(config: SynthConfig, scene: CabinScene, plan: Plan, reports: Sequence[PlaceReport]) -> None:
    """Refuses a view that is blind in every car, on whichever side the wheel may be."""
    cars = len(scene.cars) + bool(scene.random_cars)
    for name in config.camera.weights:
        of_view = [report for report in reports if report.view == name]
        if len(of_view) < cars or not all(report.blind for report in of_view):
            continue
        if 0.0 < scene.right_hand_drive < 1.0:
            mirrored = [one for car in _cars_in_doubt(config, scene, plan, "right") for one in _judged_views(config, car)]
            if not all(report.blind for report in mirrored if report.view == name):
                continue
        raise ConfigError(
            f"view '{name}' sees nobody in {of_view[0].car}: {'; '.join(of_view[0].doubts)}",
            hint="x is forward, y left, z up, seats are at negative x (m); `cabinpose config views CAR` prints good places",
        )


def _check_memory(config: SynthConfig, workers: int) -> None:
    """Refuse images that need more memory than there is: measured within 10 % from 0.1 to 12 megapixels, without pictures."""
    camera, samples = config.camera.sensor_model.camera, config.camera.supersample**2
    pixels = camera.width * camera.height
    need = _BASE_BYTES + pixels * samples * _SAMPLE_BYTES + workers * pixels * (_PIXEL_BYTES + samples * _WORKER_SAMPLE_BYTES)
    free = available_memory()
    if need > free:
        raise ConfigError(
            f"frames of {camera.width}x{camera.height} px, with {samples} samples in each and {workers} at a time, need about"
            f" {need / 1e9:.1f} GB of memory; {free / 1e9:.1f} GB are free",
            hint="take fewer pixels, a smaller camera.supersample or fewer --workers",
        )


def available_memory() -> float:
    """Bytes that a program may still take, by what the kernel says and the limit of its group of processes; else infinite."""
    free = math.inf
    with suppress(OSError, ValueError, IndexError):
        free = 1024.0 * int(Path("/proc/meminfo").read_text("ascii").split("MemAvailable:")[1].split()[0])
    with suppress(OSError, ValueError, IndexError):
        group = Path("/sys/fs/cgroup")
        cached = int((group / "memory.stat").read_text("ascii").split("inactive_file ")[1].split()[0])
        used = int((group / "memory.current").read_text("ascii")) - cached
        free = min(free, int((group / "memory.max").read_text("ascii")) - used)
    return free


class _Car(NamedTuple):
    """A car to be checked, which may stand for others of its kind, of which every one has the seats `sure`.

    ours: with our dimensions, whose views are known to be free.
    """

    name: str
    cabin: Cabin
    sure: tuple[str, ...]
    ours: bool


def _check_drivers(people: People, subjects: Subjects) -> None:
    """Refuses people of a factorial dataset who do not drive."""
    young = [name for name in (*people.subjects, *people.own) if not subjects.drives(name)]
    if people.random is not None and people.random.youngest_years < people.driver_years:
        young.append("some of those drawn at random")
    if young:
        raise ConfigError(
            f"too young for the driver's seat of a factorial dataset: {', '.join(young)} (people.driver_years is"
            f" {people.driver_years:g})",
            hint="set people.driver_years to 0, leave them out of the people, or give factorial.seat another seat",
        )


def _every_car_has(config: SynthConfig, scene: CabinScene) -> bool:
    """Whether all that is asked of a car is in every one that we build, so that none is built to find out."""
    always = scene.always_taken
    taken = bool(always) or any(scene.occupancy.get(slot, 0.0) > 0 for slot in SEATS_OF_ALL)
    ours = all(name in VIEWS_OF_ALL and isinstance(config.camera.views[name], float) for name in config.camera.weights)
    acting = (
        scene.motion
        or (scene.sequence is not None and scene.sequence.activities)
        or any(occupant.action for occupant in scene.occupants.values())
    )
    return taken and ours and not acting and not scene.seats and set(always) <= set(SEATS_OF_ALL)


def _cars_in_doubt(config: SynthConfig, scene: CabinScene, plan: Plan, side: DriveSide) -> Iterator[_Car]:
    """The cars that are built beforehand; warns of open meshes."""
    unusual = not _every_car_has(config, scene)
    for car in scene.cars:
        if isinstance(car, ChangedPreset):
            cabin = open_cabin(car.dimensions, side)
            yield _Car(car.name, cabin, tuple(cabin.seats), ours=False)
        elif is_car_file(car) or (unusual and not is_random_car(car)):
            cabin = open_cabin(car, side)
            for warning in cabin.warnings:
                warnings.warn(f"{Path(car).name}: {warning}", stacklevel=3)
            yield _Car(car, cabin, tuple(cabin.seats), ours=not is_car_file(car))
    # The seats, actions and views of random cars are the same in all of them: one stands for all.
    if unusual and any(is_random_car(car) for car in plan.cabins.names):
        cabin = open_cabin(car_dimensions(0, "C0000").model_copy(update={"rear_places": 3}), side)
        yield _Car("a random car", cabin, tuple(slot for slot in cabin.seats if slot != "rear_center"), ours=True)


def _check_seats(scene: CabinScene, car: _Car) -> None:
    """Refuses people in seats that the car lacks, or in none, and seats that cannot be set as asked for."""
    lacking = [slot for slot in scene.always_taken if slot not in car.sure]
    if lacking:
        raise ConfigError(
            f"{car.name} has no {' and no '.join(lacking)} seat, where somebody is to sit in every frame",
            hint=f"its seats: {', '.join(car.sure)}; name the cars with scene.cars",
        )
    if not scene.always_taken and not any(scene.occupancy.get(slot, 0.0) > 0 for slot in car.sure):
        raise ConfigError(f"{car.name}: no seat of it is ever taken", hint=f"give one of {', '.join(car.sure)} an occupancy")
    for slot, asked in scene.seats.items():
        if slot in car.cabin.seats:
            try:
                car.cabin.seats[slot].check(asked.setting)
            except ConfigError as error:
                raise ConfigError(f"{car.name}: {error}", hint=f"{error.hint}, or name other cars with scene.cars") from error


def _check_actions(scene: CabinScene, car: _Car) -> None:
    """Refuses actions that make no sense in their seats."""
    actions = {slot: [name for name, weight in weights.items() if weight > 0] for slot, weights in scene.motion.items()}
    actions |= {slot: [o.action] for slot, o in scene.occupants.items() if o.action is not None and o.pose is None}
    for slot, names in actions.items():
        if slot in car.cabin.seats:
            seat = car.cabin.seats[slot]
            wrong = [name for name in names if not suits(ACTIONS[name], seat, car.cabin)]
            if wrong:
                known = ", ".join(actions_for(seat, car.cabin))
                raise ConfigError(f"{car.name}: {', '.join(wrong)} makes no sense in the {slot} seat", hint=f"there: {known}")


def _check_activities(scene: CabinScene, car: _Car) -> None:
    """Refuses activities of sequences none of which makes sense in any seat that is ever taken; one that does is enough."""
    asked = scene.sequence.activities if scene.sequence is not None else None
    if not asked:
        return
    taken = [slot for slot in car.sure if slot in scene.always_taken or scene.occupancy.get(slot, 0.0) > 0]
    able = {name for s in taken for name in activities_for(car.cabin.seats[s], car.cabin, None, taken, asked_for=asked)}
    if taken and not able & set(asked):
        raise ConfigError(
            f"{car.name}: {', '.join(asked)} makes no sense for anybody; the seats that are taken: {', '.join(taken)}",
            hint=f"there: {', '.join(name for name in ACTIVITIES if name in able)}",
        )


def _doubt_clutter(scene: CabinScene, car: _Car) -> None:
    """Warns of a car in which nothing can lie about where that is asked for."""
    if "clutter" in scene.model_fields_set and scene.lies_about and all(part.name != DASHBOARD for part in car.cabin.parts):
        warnings.warn(f"{Path(car.name).name}: nothing lies about, as no part of it is called {DASHBOARD}", stacklevel=3)


def _check_views(config: SynthConfig, car: _Car) -> None:
    """Refuses a camera that stands inside a part of the car. The own views of cars with our dimensions are known to be free."""
    cabin = car.cabin
    eyes: dict[str, Floats] = {}
    for name in config.camera.weights:
        view = config.camera.views[name]
        if not isinstance(view, float):
            eyes[name] = np.asarray(view.position_m, dtype=np.float64)
        else:
            if any(note.startswith(f"view {name}:") for note in cabin.notes):
                raise ConfigError(
                    f"{car.name}: no free place was found for the automatic view '{name}'",
                    hint=f"give one in that file, as views: {{{name}: {{eye: [x, y, z], target: [x, y, z]}}}}",
                )
            if name not in cabin.views:
                raise ConfigError(
                    f"{car.name} has no view '{name}'",
                    hint=f"its views: {', '.join(cabin.views)}; name the cars that have it with scene.cars",
                )
            anchor = cabin.view(name)
            if not car.ours:
                eyes[name] = np.asarray(anchor.eye, dtype=np.float64)
    if not eyes:
        return
    clearance = ContactField(cabin).clearance(
        np.stack(list(eyes.values())), {slot: s.default for slot, s in cabin.seats.items()}, 0.0
    )
    for (name, eye), free in zip(eyes.items(), clearance, strict=True):
        if free < LENS_M:
            raise ConfigError(
                f"{car.name}: the camera of view '{name}' at {eye.round(3).tolist()} m stands inside the car's parts",
                hint="move it into the free space of the cabin",
            )


def _judged_views(config: SynthConfig, car: _Car) -> Iterator[PlaceReport]:
    """What the camera sees of a car from each view that is not the package's own."""
    camera = config.camera.model_copy(update={"jitter_m": 0.0, "jitter_deg": 0.0})
    for name in camera.weights:
        if not (car.ours and isinstance(camera.views[name], float)):
            pose = draw_viewpoint(camera, car.cabin, name, rng=frame_rng(0, 0)).vehicle_from_camera
            yield dataclasses.replace(judge_place(car.cabin, name, pose, camera.sensor_model, config.noise), car=car.name)

"""`cabinpose car`: a first YAML for a car mesh, and the check of one."""

from __future__ import annotations

import sys
from collections import Counter
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import yaml

from cabinpose.app.cli.car_commands import Car, CarCheck, CarInit
from cabinpose.app.cli.output import print_json, print_rows, printable, progress
from cabinpose.core.errors import ConfigError, SceneError
from cabinpose.store.part import disk_errors

if TYPE_CHECKING:
    from cabinpose.app.car_check import CarReport
    from cabinpose.scene.cabin import Cabin
    from cabinpose.scene.cabin.car_file import Rule
    from cabinpose.synth.config import SynthConfig
    from cabinpose.synth.seat_trial import SeatTrial

_PICTURE = "car.png"
_VIEWS = ("front_row", "driver", "rear")  # the first that a car has is drawn from
_NAMED = 4  # meshes of one kind that are named


def run(command: Car) -> None:
    """Do what the chosen action says."""
    if isinstance(command.action, CarInit):
        _init(command.action)
    else:
        _check(command.action)


def _init(action: CarInit) -> None:
    from cabinpose.scene.cabin.car_draft import draft_car_file

    _refuse_existing(action.out, action.overwrite)
    with progress() as told:
        told.phase("looking for seats")
        draft = draft_car_file(action.mesh, action.out, up_axis=action.up_axis, front_axis=action.front_axis, unit=action.unit)
    with disk_errors(action.out):
        action.out.parent.mkdir(parents=True, exist_ok=True)
        action.out.write_text(draft.text, encoding="utf-8")
    if action.as_json:
        seats = {slot: {"h_point": seat.h_point.tolist(), "score": seat.score} for slot, seat in draft.seats.items()}
        wheel = None if draft.wheel is None else {"centre": draft.wheel.centre.tolist(), "diameter_m": draft.wheel.diameter_m}
        print_json({"file": str(action.out), "notes": draft.notes, "seats": seats, "steering_wheel": wheel})
        return
    print_rows(
        [
            ("file", str(action.out)),
            *(("found", note) for note in draft.notes),
            *(("seat", f"{slot}, H-point {_point(seat.h_point)} m") for slot, seat in draft.seats.items()),
            ("wheel", f"{_point(draft.wheel.centre)} m, by {draft.wheel.how}" if draft.wheel is not None else "not found"),
        ]
    )
    print(f"look at it with: cabinpose car check {action.out} --out {action.out.stem}-check", file=sys.stderr)


def _check(action: CarCheck) -> None:
    from cabinpose.app.car_check import check_car

    picture = None if action.out is None else action.out / _PICTURE
    if picture is not None:
        _refuse_existing(picture, action.overwrite)
    with progress() as told:
        told.phase("trying people in every seat")
        report = check_car(action.file)
        if picture is not None:
            _draw(action.file, report, picture)
    for warning in report.warnings:
        print(f"warning: {printable(warning)}", file=sys.stderr)
    if action.as_json:
        print_json(_as_data(action.file, report, picture))
        return
    print_rows(_rows(report))
    if report.mended is not None:
        print("\nrules to add before the others:\n\nrules:")
        for rule in report.rules:
            print(_as_yaml(rule))
        print("\nwith them:")
        print_rows((slot, _verdict(trial)) for slot, trial in report.mended.items())
    if picture is not None:
        print(f"\n{picture}")


def _refuse_existing(path: Path, overwrite: bool) -> None:
    if path.exists() and not overwrite:
        raise ConfigError(f"{path} exists", hint="--overwrite replaces it")


def _rows(report: CarReport) -> Iterator[tuple[str, str]]:
    cabin = report.cabin
    size = np.ptp(cabin.bounds, axis=0)
    triangles = sum(len(part.surface.faces) for part in cabin.parts)
    yield "car", f"{cabin.name}: {size[0]:.2f} m long, {size[1]:.2f} m wide, {size[2]:.2f} m high, {triangles} triangles"
    yield from (("found", note) for note in cabin.notes)
    for slot, seat in cabin.seats.items():
        heel = seat.heel_point(seat.default)
        torso = f"back {np.degrees(seat.default.torso_angle):.0f} deg"
        yield "seat", f"{slot}: H-point {_point(seat.h_point(seat.default))}, heels {_point(heel)}, {torso}"
    wheel = cabin.steering_wheel
    if wheel is not None:
        diameter = 2000 * (wheel.rim_radius_m + wheel.rim_section_m)
        yield "wheel", f"{_point(wheel.vehicle_from_wheel[:3, 3])}, {diameter:.0f} mm, on the {cabin.drive_side}"
    else:
        yield "wheel", "none: nobody steers"
    pedals = ", ".join(f"{name} {_point(pad[:3, 3])}" for name, pad in cabin.pedals.items())
    yield "pedals", pedals or "none: the driver's feet are on the floor"
    yield from (("view", f"{name}: from {_point(v.eye)} to {_point(v.target)}") for name, v in cabin.views.items())
    yield from (("meshes", line) for line in _kinds(cabin))
    if report.unnamed:
        yield "unnamed", f"no rule but the last ('*') names {_some(report.unnamed)}"
    for slot, trial in report.trials.items():
        yield "poses", f"{slot}: {_verdict(trial)}"
    yield from (("advice", line) for line in report.advice)


def _kinds(cabin: Cabin) -> Iterator[str]:
    """Meshes by what they are taken for."""
    from cabinpose.app.car_check import kind_of

    kinds: dict[str, list[str]] = {}
    for part in cabin.parts:
        kinds.setdefault(kind_of(part), []).append(part.name)
    yield from (f"{kind}: {_some(tuple(names))}" for kind, names in sorted(kinds.items()))


def _some(names: tuple[str, ...]) -> str:
    short = tuple(dict.fromkeys(_short(name) for name in names))
    more = f" and {len(short) - _NAMED} more" if len(short) > _NAMED else ""
    return ", ".join(short[:_NAMED]) + more


def _short(mesh: str) -> str:
    """A mesh's name "node/geometry/material" without what is empty or said twice, and without the group it was cut out for."""
    return "/".join(dict.fromkeys(filter(None, mesh.partition(" (")[0].split("/"))))


def _verdict(trial: SeatTrial) -> str:
    """How many poses held, and what was in the way of the others."""
    causes = "; ".join(f"{_cause(str(r))} ({n})" for r, n in trial.rejections.most_common(3))
    pushed = f", {len(trial.pushed_m)} of them pushed up to {1000 * max(trial.pushed_m):.0f} mm off" if trial.pushed_m else ""
    return f"{trial.held} of {trial.tried} poses hold{pushed}" + (f"; in the way: {causes}" if causes else "")


def _cause(words: str) -> str:
    """A rejection without the seat that the line begins with."""
    return words.partition(": ")[2]


def _short_verdict(trial: SeatTrial) -> str:
    """The same for a drawing."""
    pushed = f", pushed {1000 * max(trial.pushed_m):.0f} mm" if trial.pushed_m else ""
    return f"{trial.held}/{trial.tried} hold{pushed}"


def _as_yaml(rule: Rule) -> str:
    data = rule.model_dump(mode="json", exclude_defaults=True)
    return "  - " + yaml.safe_dump(data, default_flow_style=True, width=10_000, sort_keys=False).strip()


def _as_data(file: Path, report: CarReport, picture: Path | None) -> dict[str, Any]:
    cabin = report.cabin
    return {
        "file": str(file),
        "notes": cabin.notes,
        "warnings": report.warnings,
        "advice": report.advice,
        "seats": {s: {"h_point": v.h_point(v.default).tolist()} for s, v in cabin.seats.items()},
        "views": {name: {"eye": v.eye.tolist(), "target": v.target.tolist()} for name, v in cabin.views.items()},
        "meshes": dict(Counter(part.name for part in cabin.parts)),
        "unnamed": report.unnamed,
        "poses": _trials(report.trials),
        "rules": [rule.model_dump(mode="json", exclude_defaults=True) for rule in report.rules],
        "poses_with_rules": None if report.mended is None else _trials(report.mended),
        "picture": None if picture is None else str(picture),
    }


def _trials(trials: Mapping[str, SeatTrial]) -> dict[str, Any]:
    return {
        slot: {
            "tried": t.tried,
            "held": t.held,
            "pushed_m": t.pushed_m,
            "rejections": {str(r): n for r, n in t.rejections.most_common()},
        }
        for slot, t in trials.items()
    }


def _draw(file: Path, report: CarReport, picture: Path) -> None:
    """Write the picture."""
    from PIL import Image as PilImage

    from cabinpose.app.view.car import draw_car
    from cabinpose.synth.config import SynthConfig

    held = {slot: float(trial.held > 0) for slot, trial in report.trials.items()}
    view = next((name for name in _VIEWS if name in report.cabin.views), None)
    config = SynthConfig()
    frame = None
    if any(held.values()) and view is not None:
        config = SynthConfig.parse(
            {
                "scene": {"cars": [str(file.resolve())], "occupancy": held},
                "camera": {"views": {view: 1.0}},
                "limits": {"scenes_per_frame": 10},
            }
        )
        frame = _frame(config)
    verdicts = {slot: _short_verdict(trial) for slot, trial in report.trials.items()}
    wrong = [where for trial in report.trials.values() for where in trial.where]
    image = draw_car(report.cabin, config.camera.sensor_model.camera, verdicts, wrong, frame)
    with disk_errors(picture.parent):
        picture.parent.mkdir(parents=True, exist_ok=True)
        PilImage.fromarray(image).save(picture)


def _frame(config: SynthConfig) -> dict[str, Any] | None:
    """The first frame in which people hold, of those that a few draws find."""
    from cabinpose.synth.write import FrameMaker

    try:
        return FrameMaker(config, 0).make(0)[0]
    except SceneError:
        return None


def _point(p: Any) -> str:
    return "[" + ", ".join(f"{round(float(v), 2) + 0.0:.2f}" for v in p) + "]"

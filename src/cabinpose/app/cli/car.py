"""`cabinpose car`: describe your own car mesh in a YAML file, and check it."""

from __future__ import annotations

import math
import sys
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from tyro.conf import Positional, arg

from cabinpose.app.cli.arguments import Maybe, PrintsJson, one_of
from cabinpose.app.cli.output import print_json, print_rows, printable, progress
from cabinpose.core import ConfigError, SceneError, make_folder, whole_file, write_whole

if TYPE_CHECKING:
    from cabinpose.app.car_check import CarReport
    from cabinpose.scene.cabin import Measure, Rule
    from cabinpose.synth import SeatTrial

_PICTURE = "car.png"
_VIEWS = ("front_row", "driver", "rear")  # the picture shows a frame from the first of these that the car has
_NAMED = 4  # meshes of one kind that are listed by name


@dataclass(frozen=True, kw_only=True)
class CarInit(PrintsJson):
    """Write a first YAML for a car mesh: axes, unit, origin, and the seats and steering wheel that are found."""

    mesh: Annotated[Positional[Path], arg(metavar="MESH")]
    """Mesh file: .glb, .gltf, .obj, .stl or .ply."""
    out: Path
    """YAML file to write."""
    up_axis: str = "auto"
    """Axis of the mesh that points up, such as z or -y."""
    front_axis: str = "auto"
    """Axis of the mesh that points to the car's front."""
    unit: str = "auto"
    """Unit of the mesh: m, cm, mm or inch."""
    overwrite: bool = False
    """Replace the YAML file."""


@dataclass(frozen=True, kw_only=True)
class CarCheck(PrintsJson):
    """Check the YAML of your car: what was loaded, poses tried in every seat, what they collide with, rules to add."""

    file: Annotated[Positional[Path], arg(metavar="YAML")]
    """YAML file of the car."""
    out: Maybe[Path] = None
    """Folder for car.png: side view, top view, and a frame with people in the car."""
    overwrite: bool = False
    """Replace the picture in the folder."""


COMMAND = one_of(init=CarInit, check=CarCheck)


def run(command: CarInit | CarCheck) -> None:
    """Write a first YAML, or check one."""
    if isinstance(command, CarInit):
        _init(command)
    else:
        _check(command)


def _init(command: CarInit) -> None:
    from cabinpose.app.car_check import point_text
    from cabinpose.scene.cabin import draft_car_file

    if command.out.suffix not in (".yaml", ".yml"):  # a mesh, with --overwrite, would be gone
        raise ConfigError(f"{command.out} is no name of a YAML file", hint="let --out end in .yaml")
    _refuse_existing(command.out, command.overwrite)
    with progress() as report:
        report.phase("looking for seats")
        draft = draft_car_file(
            command.mesh, command.out, up_axis=command.up_axis, front_axis=command.front_axis, unit=command.unit
        )
    make_folder(command.out.parent)
    write_whole(command.out, draft.text)
    for warning in draft.warnings:
        print(f"warning: {printable(warning)}", file=sys.stderr)
    wheel = draft.wheel
    if command.as_json:
        seats = {slot: {"h_point": seat.h_point.tolist(), "score": seat.score} for slot, seat in draft.seats.items()}
        found = None if wheel is None else {"centre": wheel.centre.tolist(), "diameter_m": wheel.diameter_m}
        sizes = _sizes(draft.sizes)
        told = {"notes": draft.notes, "warnings": draft.warnings, "seats": seats, "steering_wheel": found, "sizes": sizes}
        print_json({"file": str(command.out), **told})
        return
    print_rows(
        [
            ("file", str(command.out)),
            *(("found", note) for note in draft.notes),
            *(("seat", f"{slot}, H-point {point_text(seat.h_point)} m") for slot, seat in draft.seats.items()),
            ("wheel", "not found" if wheel is None else f"{point_text(wheel.centre)} m, by {wheel.how}"),
        ]
    )
    print(f"look at it with: cabinpose car check {command.out} --out {command.out.stem}-check", file=sys.stderr)


def _check(command: CarCheck) -> None:
    from cabinpose.app.car_check import check_car

    picture = None if command.out is None else command.out / _PICTURE
    if picture is not None:
        _refuse_existing(picture, command.overwrite)
    with progress() as told:
        told.phase("trying people in every seat")
        report = check_car(command.file)
        if picture is not None:
            _draw(command.file, report, picture)
    if report.refused is not None:
        if picture is not None:
            print(picture)
        raise report.refused
    for warning in report.warnings:
        print(f"warning: {printable(warning)}", file=sys.stderr)
    if command.as_json:
        print_json({"file": str(command.file), **_as_data(report), "picture": None if picture is None else str(picture)})
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
    from cabinpose.app.car_check import kind_of, point_text

    cabin = report.cabin
    low, high = cabin.bounds
    size = " m {}, ".join(f"{extent:.2f}" for extent in high - low).format("long", "wide")
    triangles = sum(len(part.surface.faces) for part in cabin.parts)
    yield "car", f"{cabin.name}: {size} m high, {triangles} triangles"
    yield from (("found", note) for note in cabin.notes)
    for slot, seat in cabin.seats.items():
        h_point, heels = (point_text(p) for p in (seat.h_point(seat.default), seat.heel_point(seat.default)))
        yield "seat", f"{slot}: H-point {h_point}, heels {heels}, back {math.degrees(seat.default.torso_angle):.0f} deg"
    if (wheel := cabin.steering_wheel) is not None:
        diameter = 2000 * (wheel.rim_radius_m + wheel.rim_section_m)
        yield "wheel", f"{point_text(wheel.vehicle_from_wheel[:3, 3])}, {diameter:.0f} mm, on the {cabin.drive_side}"
    else:
        yield "wheel", "none: nobody steers"
    pedals = ", ".join(f"{name} {point_text(pad[:3, 3])}" for name, pad in cabin.pedals.items())
    yield "pedals", pedals or "none: the driver's feet are on the floor"
    for name, view in cabin.views.items():
        yield "view", f"{name}: from {point_text(view.eye)} to {point_text(view.target)}"
    kinds: dict[str, list[str]] = {}
    for part in cabin.parts:
        kinds.setdefault(kind_of(part), []).append(part.mesh or part.name)
    yield from (("meshes", f"{kind}: {_some(names)}") for kind, names in sorted(kinds.items()))
    if report.unnamed:
        yield "unnamed", f"no rule but the last ('*') names {_some(report.unnamed)}"
    yield from (("poses", f"{slot}: {_verdict(trial)}") for slot, trial in report.trials.items())
    yield from (("advice", line) for line in report.advice)


def _some(meshes: Sequence[str]) -> str:
    """The first few names, each "node/geometry/material" without empty or repeated words."""
    short = list(dict.fromkeys("/".join(dict.fromkeys(filter(None, m.split("/")))) for m in meshes))
    more = f" and {len(short) - _NAMED} more" if len(short) > _NAMED else ""
    return ", ".join(short[:_NAMED]) + more


def _verdict(trial: SeatTrial) -> str:
    """How many poses hold, and what the others collide with; the seat that each rejection begins with is left out."""
    causes = "; ".join(f"{str(r).partition(': ')[2]} ({n})" for r, n in trial.rejections.most_common(3))
    pushed = f", {len(trial.pushed_m)} of them pushed up to {1000 * max(trial.pushed_m):.0f} mm off" if trial.pushed_m else ""
    return f"{trial.held} of {trial.tried} poses hold{pushed}" + (f"; in the way: {causes}" if causes else "")


def _as_yaml(rule: Rule) -> str:
    import yaml

    data = rule.model_dump(mode="json", exclude_defaults=True)
    return "  - " + yaml.safe_dump(data, default_flow_style=True, width=10_000, sort_keys=False).strip()


def _as_data(report: CarReport) -> dict[str, Any]:
    cabin = report.cabin
    return {
        "notes": cabin.notes,
        "warnings": report.warnings,
        "advice": report.advice,
        "seats": {s: {"h_point": v.h_point(v.default).tolist()} for s, v in cabin.seats.items()},
        "views": {name: {"eye": v.eye.tolist(), "target": v.target.tolist()} for name, v in cabin.views.items()},
        "sizes": _sizes(report.sizes),
        "meshes": dict(Counter(part.name for part in cabin.parts)),
        "unnamed": report.unnamed,
        "poses": _trials(report.trials),
        "rules": [rule.model_dump(mode="json", exclude_defaults=True) for rule in report.rules],
        "poses_with_rules": None if report.mended is None else _trials(report.mended),
    }


def _sizes(found: Sequence[Measure]) -> list[dict[str, Any]]:
    from cabinpose.scene.cabin import SIZES

    return [
        {
            "size": m.name,
            "slot": m.slot or None,
            "m": m.metres,
            "usual_m": SIZES[m.name].usual,
            "possible_m": SIZES[m.name].possible,
        }
        for m in found
    ]


def _trials(trials: Mapping[str, SeatTrial]) -> dict[str, Any]:
    causes = {slot: {str(rejection): count for rejection, count in t.rejections.most_common()} for slot, t in trials.items()}
    return {
        slot: {"tried": t.tried, "held": t.held, "pushed_m": t.pushed_m, "rejections": causes[slot]} for slot, t in trials.items()
    }


def _draw(file: Path, report: CarReport, picture: Path) -> None:
    """Write the picture, with a frame of the first view if any pose holds."""
    from PIL import Image as PilImage

    from cabinpose.app.view.car import draw_car
    from cabinpose.synth import FrameMaker, SynthConfig

    held = {slot: float(trial.held > 0) for slot, trial in report.trials.items()}
    view = next((name for name in _VIEWS if name in report.cabin.views), None)
    config, frame = SynthConfig(), None
    if any(held.values()) and view is not None:
        scene = {"cars": [str(file.resolve())], "occupancy": held}
        config = SynthConfig.parse({"scene": scene, "camera": {"views": {view: 1.0}}, "limits": {"scenes_per_frame": 10}})
        try:
            frame = FrameMaker(config, 0).make(0)[0]
        except SceneError:  # no pose held in a few scenes: the picture states it
            frame = None
    pushed = {slot: f", pushed {1000 * max(t.pushed_m):.0f} mm" if t.pushed_m else "" for slot, t in report.trials.items()}
    verdicts = {slot: f"{t.held}/{t.tried} hold{pushed[slot]}" for slot, t in report.trials.items()}
    wrong = [where for trial in report.trials.values() for where in trial.where]
    image = draw_car(report.cabin, report.sizes, config.camera.sensor_model.camera, verdicts, wrong, frame)
    make_folder(picture.parent)
    with whole_file(picture) as partial:
        PilImage.fromarray(image).save(partial)

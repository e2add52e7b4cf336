"""`cabinpose config`: write, check or describe the configuration of `synth`."""

from __future__ import annotations

import json
import sys
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from math import isnan
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

from tyro.conf import Positional, arg

from cabinpose.app.cli.arguments import DatasetArgument, PrintsJson, one_of, several
from cabinpose.app.cli.output import print_json, print_rows, print_table, progress
from cabinpose.core import ConfigError, check_output, write_whole

if TYPE_CHECKING:
    from pydantic import BaseModel

    from cabinpose.scene.sensor import Sensor
    from cabinpose.synth import CabinScene, PlaceReport, RoomScene, SynthConfig

_TRIED_FRAMES = 3  # scenes that `config check` draws
_NewFile = Annotated[Positional[Path | None], several("FILE")]


@dataclass(frozen=True)
class ConfigInit:
    """Write a configuration to start from: every key with its default and what it means."""

    file: _NewFile = None
    """File to write; default: stdout."""
    scene: Literal["cabin", "room"] = "cabin"
    """People in cars, or one person who stands in a room, with the geometry of the ITOP dataset."""


@dataclass(frozen=True, kw_only=True)
class ConfigCheck(PrintsJson):
    """Check a configuration as `synth` would, meshes, recordings and a few scenes included, and summarise it."""

    file: Annotated[Positional[Path], arg(metavar="FILE")]
    """Configuration (YAML)."""
    overrides: Annotated[Positional[tuple[str, ...]], several("[KEY=VALUE ...]")] = ()
    """Changes to it, as of `synth`."""


@dataclass(frozen=True)
class ConfigFrame:
    """Write the scene of one frame of a generated dataset as a configuration, exact to the last bit."""

    dataset: DatasetArgument
    frame: Annotated[Positional[int], arg(metavar="FRAME")]
    """Number of the frame."""
    file: _NewFile = None
    """File to write; default: stdout."""


@dataclass(frozen=True, kw_only=True)
class ConfigViews(PrintsJson):
    """Print the places for cameras that a car has, and what each sees of people: shares of heads, hands and seats."""

    car: Annotated[Positional[str], arg(metavar="CAR")]
    """A preset, or the YAML of a car of your own."""
    sensor: str = "pico_monstar_105/5"
    """The camera: a preset, or a configuration (YAML) with one."""
    frames: int = 20
    """Scenes that are drawn; all places see the same."""
    seed: int = 0
    """Seed of the scenes."""


@dataclass(frozen=True)
class ConfigSchema:
    """Print the JSON Schema of the configuration, for editors and validators."""


COMMAND = one_of(init=ConfigInit, check=ConfigCheck, frame=ConfigFrame, views=ConfigViews, schema=ConfigSchema)


def run(command: ConfigInit | ConfigCheck | ConfigFrame | ConfigViews | ConfigSchema) -> None:
    """Write, check or describe a configuration."""
    from cabinpose.synth import SynthConfig, room_preset

    if isinstance(command, ConfigInit):
        _write(commented_yaml(room_preset() if command.scene == "room" else SynthConfig()), command.file)
    elif isinstance(command, ConfigCheck):
        _check(command, SynthConfig.load(command.file, command.overrides))
    elif isinstance(command, ConfigFrame):
        _write(_frame_yaml(command), command.file)
    elif isinstance(command, ConfigViews):
        _views(command)
    else:
        print(json.dumps(SynthConfig.model_json_schema(), indent=2))


def _frame_yaml(command: ConfigFrame) -> str:
    """The scene of a frame as YAML, without the keys that have their defaults."""
    import yaml

    import cabinpose
    from cabinpose.store import number_at_first, read_manifest
    from cabinpose.synth import SynthConfig, exact_config, without_defaults

    folder, number, manifest = command.dataset, command.frame, read_manifest(command.dataset)
    if manifest.generator != "cabinpose.synth":
        raise ConfigError(f"{folder} was not generated", hint="give a dataset that `cabinpose synth` wrote")
    if not 0 <= number < manifest.frames:
        raise ConfigError(f"{folder} has no frame {number}", hint=f"its frames are numbered from 0 to {manifest.frames - 1}")
    if manifest.generator_version != cabinpose.__version__:
        print(f"warning: {folder} is of version {manifest.generator_version}: the scene may be another", file=sys.stderr)
    generated = number_at_first(manifest.selection, number)
    config = SynthConfig.parse(manifest.own_config)
    told = without_defaults(exact_config(config, manifest.seed, generated))
    text = yaml.safe_dump(told, sort_keys=False, default_flow_style=None, width=130, allow_unicode=True)
    still = ", without temporal_median: of one moment" if config.camera.sensor_model.temporal_median > 1 else ""
    return f"# frame {number} of a dataset with seed {manifest.seed}{still}\n{text}"


def _write(text: str, file: Path | None) -> None:
    """Write a new file, or to stdout."""
    if file is None:
        print(text, end="")
        return
    check_output(file, ConfigError, parents=False)
    if file.exists():
        raise ConfigError(f"{file} exists", hint="give another name; nothing is overwritten")
    write_whole(file, text, kind=ConfigError)
    print(f"wrote {file}", file=sys.stderr)


def _check(command: ConfigCheck, config: SynthConfig) -> None:
    """Draw a few scenes, as `synth` would, and summarise the configuration."""
    from cabinpose.synth import SceneSampler, frame_rng, preflight

    with progress() as report:
        report.phase("trying scenes")
        places = preflight(config, frames=1)
        sampler = SceneSampler(config, 0)
        tried = sum(sampler.sample(index, rng=frame_rng(0, index)).proposals for index in range(_TRIED_FRAMES))
    if command.as_json:
        told = {"file": str(command.file), "valid": True, "poses_tried": tried, "places": [asdict(place) for place in places]}
        print_json(told | {"taken": config.camera.taken, "config": config.model_dump(mode="json")})
        return
    print(f"{command.file} is valid: {_TRIED_FRAMES} frames found their scene in {tried} poses")
    scene, people = config.scene, config.people
    named = scene.cars if scene.kind == "cabin" else ()
    cars = ", ".join(Path(car).name if isinstance(car, str) else f"{car.name} ({car.preset} changed)" for car in named)
    drawn = f"{scene.random_cars} drawn at random" if scene.kind == "cabin" and scene.random_cars else ""
    kinds = ((len(people.subjects), "named"), (len(people.own), "own"), (people.random.count if people.random else 0, "random"))
    rows = [("frames", f"{config.frames} combinations")] if config.frames is not None else []
    in_cars = f"cabin, cars {' and '.join(filter(None, (cars, drawn)))}"
    rows += [
        ("scene", in_cars if scene.kind == "cabin" else f"room, {scene.rooms} of them"),
        ("camera", f"{_sensor_words(config.camera.sensor)}, views {', '.join(config.camera.views)}"),
        *([("not given", f"{config.camera.taken} (as a Pico Monstar with even light)")] if config.camera.taken else ()),
        *((f"view {p.view}", f"{Path(p.car).name}: {100 * p.valid:.0f} % of the pixels valid, {_seats(p)}") for p in places),
        ("people", ", ".join(f"{count} {kind}" for count, kind in kinds if count)),
        ("noise", config.noise.kind),
        *([("clutter", "nothing lies about in sequences, nor beside scene.things")] if _left_tidy(scene) else ()),
    ]
    print_rows(rows)


def _left_tidy(scene: CabinScene | RoomScene) -> bool:
    """Whether something would lie about in cars, but for what else is asked for."""
    return scene.kind == "cabin" and scene.clutter > 0.0 and not scene.lies_about


def _views(command: ConfigViews) -> None:
    """Draw scenes in a car and look at them from its places."""
    from cabinpose.scene.sensor import sensor_by_name
    from cabinpose.synth import SynthConfig, check_seed, views_seen

    if command.frames < 1:
        raise ConfigError(f"cannot look at {command.frames} scenes", hint="give --frames of 1 or more")
    check_seed(command.seed)
    own = command.sensor.endswith((".yaml", ".yml"))
    sensor = SynthConfig.load(Path(command.sensor)).camera.sensor_model if own else sensor_by_name(command.sensor)
    with progress(command.frames, "scenes") as report:
        views = views_seen(command.car, sensor, frames=command.frames, seed=command.seed, progress=report)
    if command.as_json:
        told = [
            {
                "view": view.place.view, "position_m": view.anchor.eye.tolist(), "look_at_m": view.anchor.target.tolist(),
                "valid": view.place.valid, "people": view.people, "heads": view.heads, "hands": view.hands, "seats": view.seats,
            }
            for view in views
        ]  # fmt: skip
        print_json({"car": command.car, "sensor": sensor.name, "frames": command.frames, "seed": command.seed, "views": told})
        return
    slots = list(views[0].seats) if views else []
    table = [["view", "position_m", "look_at_m", "pixels", "heads", "hands", *slots]]
    for view in views:
        shares = (view.place.valid, view.heads, view.hands, *view.seats.values())
        places = (f"[{', '.join(f'{x:.2f}' for x in place)}]" for place in (view.anchor.eye, view.anchor.target))
        table.append([view.place.view, *places, *("–" if isnan(share) else f"{100 * share:.0f} %" for share in shares)])
    print_table(table, words=(0, 1, 2))


def _sensor_words(sensor: str | Sensor) -> str:
    """A sensor's name, of an own one its lens as well."""
    if isinstance(sensor, str):
        return sensor
    lens = sensor.camera
    across, down = lens.fields_deg
    dist = f" dist {' '.join(f'{x:g}' for x in lens.dist)}" if lens.is_distorted else ""
    numbers = f"fx {lens.fx:.5g} fy {lens.fy:.5g} cx {lens.cx:.5g} cy {lens.cy:.5g}{dist}"
    return f"{sensor.name} ({lens.width}x{lens.height} px, {across:.3g}° x {down:.3g}°, {numbers})"


def _seats(place: PlaceReport) -> str:
    return f"seats seen: {', '.join(place.seen)}" if place.seen else "no seat seen"


def commented_yaml(model: BaseModel) -> str:
    """A model as YAML with the descriptions of its fields as comments; parsing it gives the same model again."""
    return "".join(f"{line}\n" for line in _lines(model, ""))


def _lines(model: BaseModel, indent: str) -> Iterator[str]:
    import yaml
    from pydantic import BaseModel
    from pydantic_core import to_jsonable_python

    plain = model.model_dump(mode="json")
    for name, field in type(model).model_fields.items():
        value = getattr(model, name)
        comment = f"  # {field.description}" if field.description else ""
        if isinstance(value, BaseModel):
            yield f"{indent}{name}:{comment}"
            yield from _lines(value, indent + "  ")
        else:
            told = plain[name] if name in plain else to_jsonable_python(value)  # a dump leaves some keys out where they are empty
            text = yaml.safe_dump(told, default_flow_style=True, width=10_000, allow_unicode=True)
            text = text.removesuffix("...\n").strip()  # PyYAML ends the document of a bare scalar
            yield f"{indent}{name}: {text}{comment}"

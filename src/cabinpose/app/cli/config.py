"""`cabinpose config`: write a first configuration, check one, print its JSON Schema."""

from __future__ import annotations

import json
import sys
from collections.abc import Iterator
from pathlib import Path

import yaml
from pydantic import BaseModel

import cabinpose
from cabinpose.app.cli.commands import Config, ConfigCheck, ConfigFrame, ConfigInit
from cabinpose.app.cli.output import progress
from cabinpose.core.errors import ConfigError
from cabinpose.synth.config import SynthConfig, room_preset


def run(command: Config) -> None:
    """Do what the chosen action says."""
    if isinstance(command.action, ConfigInit):
        _init(command.action)
    elif isinstance(command.action, ConfigCheck):
        _check(command.action)
    elif isinstance(command.action, ConfigFrame):
        _frame(command.action)
    else:
        print(json.dumps(SynthConfig.model_json_schema(), indent=2))


def _init(action: ConfigInit) -> None:
    _write(commented_yaml(room_preset() if action.scene == "room" else SynthConfig()), action.file)


def _frame(action: ConfigFrame) -> None:
    """Write what `exact_config` says of a frame, without what is as by default."""
    from cabinpose.store import read_manifest
    from cabinpose.synth.exact import exact_config, without_defaults

    manifest = read_manifest(action.dataset)
    if manifest.generator != "cabinpose.synth":
        raise ConfigError(f"{action.dataset} was not generated", hint="give a dataset that `cabinpose synth` wrote")
    if not 0 <= action.frame < manifest.frames:
        raise ConfigError(
            f"{action.dataset} has no frame {action.frame}", hint=f"its frames are numbered from 0 to {manifest.frames - 1}"
        )
    if manifest.generator_version != cabinpose.__version__:
        print(f"warning: {action.dataset} is of version {manifest.generator_version}: the scene may be another", file=sys.stderr)
    told = without_defaults(exact_config(SynthConfig.parse(manifest.config), manifest.seed, action.frame))
    text = f"# frame {action.frame} of a dataset with seed {manifest.seed}\n"
    _write(text + yaml.safe_dump(told, sort_keys=False, default_flow_style=None, width=130, allow_unicode=True), action.file)


def _write(text: str, to: Path | None) -> None:
    """Write a new file, or to stdout."""
    if to is None:
        print(text, end="")
        return
    try:
        with to.open("x", encoding="utf-8") as file:
            file.write(text)
    except FileExistsError:
        raise ConfigError(f"{to} exists", hint="give another name; nothing is overwritten") from None
    except OSError as error:
        raise ConfigError(f"cannot write {to}: {error.strerror}", hint="give a file in a folder that exists") from error
    print(f"wrote {to}", file=sys.stderr)


def _check(action: ConfigCheck) -> None:
    config = SynthConfig.load(action.file)
    with progress() as report:
        report.phase("trying scenes")
        tried = _try(config)
    if action.as_json:
        print(
            json.dumps({"file": str(action.file), "valid": True, "poses_tried": tried, "config": config.model_dump(mode="json")})
        )
        return
    print(f"{action.file} is valid: {_FRAMES} frames found their scene in {tried} poses")
    if config.frames is not None:
        print(f"frames   {config.frames} combinations")
    print(f"scene    {_scene(config)}")
    print(f"camera   {config.camera.sensor}, views {', '.join(config.camera.views)}")
    people = config.people
    kinds = ((len(people.subjects), "named"), (len(people.own), "own"), (people.random.count if people.random else 0, "random"))
    print(f"people   {', '.join(f'{count} {kind}' for count, kind in kinds if count)}")
    print(f"noise    {config.noise.kind}")


_FRAMES = 3  # whose scenes a check draws


def _try(config: SynthConfig) -> int:
    """Load what the configuration names, draw a few scenes, and return the number of poses that took; raises as `synth` would."""
    from cabinpose.synth.preflight import preflight
    from cabinpose.synth.sample import SceneSampler
    from cabinpose.synth.streams import frame_rng

    preflight(config, frames=1)
    sampler = SceneSampler(config, 0)
    return sum(sampler.sample(index, rng=frame_rng(0, index)).proposals for index in range(_FRAMES))


def _scene(config: SynthConfig) -> str:
    if config.scene.kind == "cabin":
        named = ", ".join(Path(car).name for car in config.scene.cars)
        random = f"{config.scene.random_cars} drawn at random" if config.scene.random_cars else ""
        return f"cabin, cars {' and '.join(filter(None, (named, random)))}"
    return f"room, {config.scene.rooms} of them"


def commented_yaml(model: BaseModel) -> str:
    """A model as YAML with the descriptions of its fields as comments; reading it gives the model back."""
    return "".join(f"{line}\n" for line in _lines(model, ""))


def _lines(model: BaseModel, indent: str) -> Iterator[str]:
    plain = model.model_dump(mode="json")
    for name, field in type(model).model_fields.items():
        value = getattr(model, name)
        comment = f"  # {field.description}" if field.description else ""
        if isinstance(value, BaseModel):
            yield f"{indent}{name}:{comment}"
            yield from _lines(value, indent + "  ")
        else:
            text = yaml.safe_dump(plain[name], default_flow_style=True, width=10_000, allow_unicode=True)
            value_text = text.removesuffix("...\n").strip()  # PyYAML ends a bare scalar's document
            yield f"{indent}{name}: {value_text}{comment}"

"""`cabinpose models`: list the trained models of the package, or describe one model."""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

from tyro.conf import Positional

from cabinpose.app.cli.arguments import PrintsJson, several
from cabinpose.app.cli.output import print_json, print_rows


@dataclass(frozen=True, kw_only=True)
class Models(PrintsJson):
    """List the trained models that come with the package, or print the card of one model."""

    model: Annotated[Positional[str | None], several("MODEL")] = None
    """Name of a packaged model, or an ONNX or .npz file."""
    reads: Annotated[tuple[str, ...], several("IMAGE [IMAGE ...]")] = ()
    """Only models that do with these images: depth, amplitude."""


COMMAND = Models


def run(command: Models) -> None:
    """Print one model's description and card, or a line for each packaged model."""
    import yaml

    from cabinpose.core import IMAGES, ConfigError, unknown_name
    from cabinpose.estimate import describe_model, packaged_models

    packaged = packaged_models()
    named = command.model
    if named in ("list", "ls"):
        print("`cabinpose models` alone lists them", file=sys.stderr)
        named = None
    if command.reads and named is not None:
        raise ConfigError("--reads chooses among the packaged models, and one is named", hint="leave one of them out")
    for image in command.reads:
        if image not in IMAGES:
            raise unknown_name("image", image, IMAGES)
    chosen = packaged if named is None else {"": packaged.get(named, Path(named))}
    described = {name: describe_model(path) for name, path in chosen.items()}
    if command.reads:
        described = {name: each for name, each in described.items() if set(each["inputs"]) <= {*command.reads}}
    if command.reads and not described:
        print(f"no packaged model does with {', '.join(command.reads)} alone", file=sys.stderr)
    if command.as_json:
        print_json(described.get("", described))
    elif named is None:
        print_rows((name, str(each["card"].get("summary", ""))) for name, each in described.items())
    else:
        print_rows(_rows(described[""]))
        print()
        print(yaml.safe_dump(described[""]["card"], sort_keys=False, allow_unicode=True, width=110).rstrip())


def _rows(described: dict[str, Any]) -> list[tuple[str, str]]:
    view = described["view"]
    return [
        ("model", described["name"]),
        ("file", f"{described['file']}, {described['bytes'] / 1e6:.2f} MB"),
        ("method", described["method"] + (", mean over the frame and its mirror image" if described["mirrored"] else "")),
        *(
            [("reads", "2D joints of a person, of any camera")]
            if described["task"] == "lift"
            else [
                ("reads", f"{', '.join(described['inputs'])}, up to {view['max_depth_m']:g} m"),
                (
                    "view",
                    f"{view['width']}x{view['height']} px, focal length {view['focal']:g} px; frames of any camera are resampled",
                ),
            ]
        ),
        ("places", ", ".join(described["persons"]) or "any"),
        *([("expected error", _calibrated(described["expected_error"]))] if described["expected_error"] else []),
        *([("trained on", f"frames of {', '.join(described['trained_on'])}")] if described["trained_on"] else []),
        ("parts", ", ".join(described["parts"])) if described["parts"] else ("joints", ", ".join(described["joints"])),
    ]


def _calibrated(said: dict[str, Any]) -> str:
    return f"of {len(said['joints'])} joints, from {said['frames']} frames of {said['data']}"

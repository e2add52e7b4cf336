"""`cabinpose models`: the trained models that come with the package, and what is known of a model."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import yaml

from cabinpose.app.cli.commands import Models
from cabinpose.app.cli.output import print_json, print_rows
from cabinpose.estimate.onnx_model import describe_model, packaged_models


def run(command: Models) -> None:
    """Print one model's description and card, or a line for each packaged model."""
    packaged = packaged_models()
    if command.model is not None:
        described = describe_model(packaged.get(command.model, Path(command.model)))
        if command.as_json:
            print_json(described)
            return
        print_rows(_rows(described))
        print()
        print(yaml.safe_dump(described["card"], sort_keys=False, allow_unicode=True, width=110).rstrip())
        return
    listed = {name: describe_model(path) for name, path in packaged.items()}
    if command.as_json:
        print_json(listed)
        return
    print_rows((name, str(described["card"].get("summary", ""))) for name, described in listed.items())


def _rows(described: dict[str, Any]) -> list[tuple[str, str]]:
    view = described["view"]
    return [
        ("model", described["name"]),
        ("file", f"{described['file']}, {described['bytes'] / 1e6:.2f} MB"),
        ("method", described["method"] + (", mean over the frame and its mirror image" if described["mirrored"] else "")),
        ("reads", f"{', '.join(described['inputs'])}, up to {view['max_depth_m']:g} m"),
        ("view", f"{view['width']}x{view['height']} px, focal length {view['focal']:g} px; frames of any camera are resampled"),
        ("places", ", ".join(described["persons"]) or "any"),
        ("joints", ", ".join(described["joints"])),
    ]

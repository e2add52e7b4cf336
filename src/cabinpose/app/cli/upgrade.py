"""`cabinpose upgrade`: write a dataset of an earlier version of the standard in today's."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from tyro.conf import Positional, arg

from cabinpose.app.cli.arguments import PrintsJson
from cabinpose.app.cli.output import print_json, print_rows, progress


@dataclass(frozen=True, kw_only=True)
class Upgrade(PrintsJson):
    """Write a dataset of an earlier version of the standard in today's, in place of itself: whole, or not at all.

    Frames, images, parts and numbers stay, and so do predictions and labels; what the dataset does not know is missing in it.
    """

    dataset: Annotated[Positional[Path], arg(metavar="DATASET")]
    """Folder of the dataset."""


COMMAND = Upgrade


def run(command: Upgrade) -> None:
    """Upgrade a dataset and say what it gained."""
    from cabinpose.store import missing_variables, read_manifest, upgrade_dataset

    before = read_manifest(command.dataset)
    with progress(before.frames, "frames") as report:
        after = upgrade_dataset(command.dataset, report=report)
    told = {"dataset": str(command.dataset), "from": before.schema_version, "version": after.schema_version}
    gained = missing_variables(before)
    if command.as_json:
        print_json(told | {"variables": gained})
        return
    versions = f"{before.schema_version} to {after.schema_version}"
    print_rows([("dataset", str(command.dataset)), ("version", versions), ("new variables", ", ".join(gained))])

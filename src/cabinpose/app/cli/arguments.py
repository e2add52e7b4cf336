"""Arguments that several commands have."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from tyro.conf import Positional, arg

ThingArgument = Annotated[Positional[Path], arg(metavar="DATASET|RECORDING")]
RecordingArgument = Annotated[Positional[Path], arg(metavar="RECORDING")]
JsonFlag = Annotated[bool, arg(name="json", help="Print one JSON object on stdout.")]

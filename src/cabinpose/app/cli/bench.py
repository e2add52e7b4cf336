"""`cabinpose bench synth`: the figures of generation on this machine."""

from __future__ import annotations

import sys
from collections.abc import Iterator, Mapping
from typing import Any

from cabinpose.app.bench import run_bench
from cabinpose.app.cli.commands import Bench
from cabinpose.app.cli.output import print_json, print_rows


def run(command: Bench) -> None:
    """Measure, saying on stderr what is under way."""
    result = run_bench(
        frames=command.frames,
        repeats=command.repeats,
        workers=command.workers,
        blender=not command.skip_blender,
        memory_frames=command.memory_frames,
        say=lambda words: print(words, file=sys.stderr),
    )
    if command.as_json:
        print_json(result)
    else:
        print_rows(_rows(result))


def _rows(values: Mapping[str, Any], path: str = "") -> Iterator[tuple[str, str]]:
    for name, value in values.items():
        if isinstance(value, Mapping):
            yield from _rows(value, f"{path}{name}.")
        else:
            yield f"{path}{name}", str(value)

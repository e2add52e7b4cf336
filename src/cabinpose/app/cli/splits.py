"""The flags --splits FILE and --split NAME, which belong together."""

from __future__ import annotations

from pathlib import Path

from cabinpose.core.errors import ConfigError
from cabinpose.store.split import Splits, read_named_splits


def chosen_split(file: Path | None, name: str | None) -> Splits:
    """The split asked for, by its name; none where neither flag is given. Raises ConfigError where one is missing."""
    if file is None and name is None:
        return {}
    if file is None or name is None:
        raise ConfigError("a split needs its file and its name", hint="give both --splits FILE and --split NAME")
    return read_named_splits(file, [name])

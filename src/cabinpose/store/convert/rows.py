"""What the formats of recordings share: messages with their time stamps, and files that appear when they are whole."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from datetime import UTC, datetime
from pathlib import Path
from typing import IO, Any, TypeAlias

from cabinpose.core import ConfigError, RecordingError, whole_file
from cabinpose.signals import Message, Sample

Row: TypeAlias = tuple[int, int | None, Message]  # host_ns, device_ns, message
Entry: TypeAlias = tuple[str, int, int | None, Message]  # source, then as in a row


@contextmanager
def new_file(path: Path, *, overwrite: bool, binary: bool = False) -> Iterator[IO[Any]]:
    """A file to write to that gets its name when all is written. Raises RecordingError where it exists or cannot be written."""
    if path.exists() and not overwrite:
        raise RecordingError(f"{path} exists", hint="--overwrite replaces it, or give another file")
    how: dict[str, Any] = {"mode": "wb"} if binary else {"mode": "w", "encoding": "utf-8", "newline": "\n"}
    with whole_file(path, kind=RecordingError) as partial, partial.open(**how) as file:
        yield file


def rows_of(samples: Iterable[tuple[str, Sample]]) -> Iterator[Row]:
    """The messages of samples, whose sources are left out."""
    for _, sample in samples:
        for message in sample.messages:
            yield sample.host_ns, sample.device_ns, message


def begun_ns(begun: str | None) -> int:
    """Nanoseconds since the Unix epoch of the option `begun` of formats that know no time of day; 0 where it is not given."""
    try:
        return 0 if begun is None else epoch_ns(begun)
    except ValueError as error:
        raise ConfigError(f"--begun {begun}: {error}", hint="as in 2026-11-21T14:30:00+01:00") from error


def epoch_ns(moment: str) -> int:
    """Nanoseconds since the Unix epoch of a moment in ISO 8601; without a zone it is UTC. Raises ValueError where it is none."""
    found = datetime.fromisoformat(moment)
    since = (found if found.tzinfo else found.replace(tzinfo=UTC)) - datetime(1970, 1, 1, tzinfo=UTC)
    return (since.days * 86_400 + since.seconds) * 1_000_000_000 + since.microseconds * 1000

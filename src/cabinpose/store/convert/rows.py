"""What the formats of recordings share: messages with their time stamps, and files that appear when they are whole."""

from __future__ import annotations

import warnings
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from datetime import UTC, datetime
from pathlib import Path
from typing import IO, Any, TypeAlias

from cabinpose.core import ConfigError, RecordingError, whole_file
from cabinpose.signals import F64, Doubt, Message, Sample, TakeCheck, rotation_doubt

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


def checked(path: Path, entries: Iterable[Entry], check: TakeCheck | None = None) -> Iterator[Entry]:
    """The entries of a file; at its end it is judged whether they can be those of people (`signals.body_check`).

    check: what looks at them, to be asked afterwards.

    Warns
    -----
    UserWarning
        Of what hardly can be.

    Raises
    ------
    RecordingError
        Of what cannot be.
    """
    check = TakeCheck() if check is None else check
    for entry in entries:
        source, host_ns, device_ns, message = entry
        check.add(source, host_ns if device_ns is None else device_ns, message)
        yield entry
    say_doubts(path, [*((b.subject or b.source, doubt) for b in check.bodies() for doubt in b.doubts), *check.streams()])


def say_doubts(path: Path, doubts: Iterable[tuple[str, Doubt]]) -> None:
    """Raise RecordingError for the first of a file's doubts, each with whose it is, that cannot be; warn of the others."""
    for whose, doubt in sorted(doubts, key=lambda each: not each[1].impossible):
        if doubt.impossible:
            raise RecordingError(f"{path}: {whose}: {doubt.words}", hint=doubt.hint)
        warnings.warn(f"{path}: {whose}: {doubt.words} ({doubt.hint})", stacklevel=3)


def check_rotations(whose: str, orientation_wxyz: F64) -> None:
    """Raise RecordingError where quaternions (..., 4) are no rotations; those that are not known (NaN) are passed over."""
    if (doubt := rotation_doubt(orientation_wxyz)) is not None:
        raise RecordingError(f"{whose}: {doubt.words}", hint=doubt.hint)

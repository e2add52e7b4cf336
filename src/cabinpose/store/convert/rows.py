"""What the formats of recordings share: messages with their time stamps, and files that appear when they are whole."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import IO, Any, TypeAlias

from cabinpose.core.errors import RecordingError
from cabinpose.core.recorded import Message

Row: TypeAlias = tuple[int, int | None, Message]  # host_ns, device_ns, message


@contextmanager
def whole_file(path: Path, *, overwrite: bool, binary: bool = False) -> Iterator[IO[Any]]:
    """A file to write to that gets its name when all is written. Raises RecordingError where it exists or cannot be written."""
    if path.exists() and not overwrite:
        raise RecordingError(f"{path} exists", hint="--overwrite replaces it, or give another file")
    temporary = path.with_name(f".{path.name}.tmp")
    try:
        with temporary.open("wb") if binary else temporary.open("w", encoding="utf-8", newline="\n") as file:
            yield file
        temporary.replace(path)
    except OSError as error:
        raise RecordingError(f"cannot write {path} ({error.strerror or error})", hint="check the folder and its space") from error
    finally:
        with suppress(OSError):
            temporary.unlink()

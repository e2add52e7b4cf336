"""The files of a take, and what each says of itself: one file, or several (take.mcap, take-001.mcap, take-002.mcap)."""

from __future__ import annotations

import re
import warnings
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

from mcap.records import Attachment, Metadata

from cabinpose.core import RecordingError
from cabinpose.store.recording.scan import Chunk, Scanner, messages_in
from cabinpose.store.recording.schemas import FORMAT, HOST_METADATA, RIG_ATTACHMENT, TAKE_METADATA
from cabinpose.store.recording.take import Take


@dataclass(frozen=True)
class Head:
    """What a file says of itself before its first chunk.

    part: its number where it is one of several of a take, from 0 · host: facts of the computer that recorded it.
    """

    take: Take
    rig: str
    started_ns: int
    format: str
    part: int | None = None
    host: dict[str, str] = field(default_factory=dict)


def part_path(first: Path, part: int) -> Path:
    """The file of a part of a take, of which `first` is part 0."""
    return first.with_name(f"{first.stem}-{part:03d}{first.suffix}") if part else first


def parts_beside(first: Path) -> dict[int, Path]:
    """By their numbers, the files in the folder of `first` whose names say that they go on from it."""
    name = re.compile(rf"{re.escape(first.stem)}-(\d{{3,}}){re.escape(first.suffix)}")
    beside = first.parent.iterdir() if first.parent.is_dir() else ()
    return {int(match[1]): path for path in beside if (match := name.fullmatch(path.name)) and int(match[1]) > 0}


def files_of_take(path: Path, *, damaged: Literal["raise", "skip"] = "raise") -> list[Path]:
    """The files of the take that begins with a file, in their order; the file alone where it is a later part.

    Parameters
    ----------
    path
        The first file of a take, one of its later files, or a folder that holds one take.
    damaged
        What to do where a file between others is missing: raise, or warn and leave a gap.

    Raises
    ------
    RecordingError
        For a folder without a take or with several, a file that cannot be read, and one that is missing between others. Others
        that cannot be read are left out, with a warning.
    """
    first = _first_in(path) if path.is_dir() else path
    head = _head(first)
    if head.part != 0:
        return [first]
    beside = dict(sorted(parts_beside(first).items()))
    heads = {part: _head_beside(file) for part, file in beside.items()}
    found = {part: beside[part] for part, said in heads.items() if _goes_on(head, part, said)}
    broken = {part: said for part, said in heads.items() if isinstance(said, RecordingError)}
    gaps = [part for part in range(1, max(found, default=0)) if part not in found]
    for part in sorted(broken.keys() - set(gaps)):
        _left_out(broken[part])
    if gaps:
        why = {part: f"cannot be read ({broken[part]})" if part in broken else "is missing" for part in gaps}
        problem = f"of the take {first}, {', '.join(f'{part_path(first, part).name} {said}' for part, said in why.items())}"
        if damaged == "raise":
            remedy = "put a copy that can be read in its place" if broken.keys() & set(gaps) else "put it beside the others"
            raise RecordingError(problem, hint=f"{remedy}; without it, each file can be read by itself")
        warnings.warn(problem, stacklevel=3)
    return [first, *found.values()]


def _first_in(folder: Path) -> Path:
    """The first file of the only take in a folder."""
    heads = {file: _head_beside(file) for file in sorted(folder.glob("*.mcap"))}
    firsts = [file for file, head in heads.items() if isinstance(head, Head) and not head.part]
    if not firsts and (errors := [head for head in heads.values() if isinstance(head, RecordingError)]):
        raise errors[0]
    if len(firsts) != 1:
        names = ", ".join(file.name for file in firsts)
        raise RecordingError(
            f"{folder} holds {len(firsts)} takes, not one" if firsts else f"{folder} holds no first file of a take",
            hint=f"name one of {names}" if firsts else "name the file that is to be read",
        )
    for file in sorted(heads.keys() - set(parts_beside(firsts[0]).values())):  # of those it is told where they are looked at
        if isinstance(error := heads[file], RecordingError):
            _left_out(error)
    return firsts[0]


def _head(file: Path) -> Head:
    with Scanner(file) as scanner:
        return read_head(scanner)


def _goes_on(first: Head, part: int, head: Head | RecordingError) -> bool:
    """Whether a file is a part of the take that begins with `first`: not one of another take with the same name."""
    return isinstance(head, Head) and (head.part, head.started_ns) == (part, first.started_ns)


def _head_beside(file: Path) -> Head | RecordingError:
    """What a file beside others says of itself, or why it says nothing: a crash may have cut it at its start."""
    try:
        return _head(file)
    except RecordingError as error:
        return error


def _left_out(error: RecordingError) -> None:
    warnings.warn(f"{error}; it is left out", stacklevel=3)


def read_head(scanner: Scanner) -> Head:
    """The take and the rig of a file, which may be without its end. Raises RecordingError where it has none."""
    values: dict[str, str] | None = None
    take: Take | None = None
    host: dict[str, str] = {}
    rig, chunks = "", 0
    for found in scanner.walk():
        if isinstance(found, Metadata) and found.name == TAKE_METADATA and values is None:
            values = found.metadata
        elif isinstance(found, Metadata) and found.name == HOST_METADATA:
            host = found.metadata
        elif isinstance(found, Attachment) and found.name == RIG_ATTACHMENT:
            rig = found.data.decode("utf-8", "replace")
        elif isinstance(found, Chunk):
            take = take or _take_in(found)
            chunks += 1
            if values is not None or chunks > _HEAD_CHUNKS:
                break
    if values is None and take is None:
        raise RecordingError(f"{scanner.path} is no recording of cabinpose", hint="give a file of `cabinpose record`")
    values = values or {}
    version = values.get("format", FORMAT)
    if version != FORMAT:
        raise RecordingError(f"{scanner.path} has format {version}, this program reads format {FORMAT}", hint="upgrade cabinpose")
    started = values.get("started_ns", "0")
    try:
        take = take or Take.from_metadata(values)
    except ValueError as error:
        raise RecordingError(f"{scanner.path}: its take cannot be read: {error}", hint="check the file by hand") from error
    part = values.get("part", "")
    return Head(take, rig, int(started) if started.isdigit() else 0, version, int(part) if part.isdigit() else None, host)


_HEAD_CHUNKS = 8  # in which the take is looked for where its metadata record is lost


def _take_in(chunk: Chunk) -> Take | None:
    """The take that the first messages of a verified chunk state: unlike the metadata record, they are under a checksum."""
    if not chunk.verified:
        return None
    for message in messages_in(chunk.records):
        try:
            return Take.model_validate_json(bytes(message.data))
        except ValueError:
            return None
    return None

"""Recordings from the files of other tools, and back. What is written gets its name when it is whole."""

from __future__ import annotations

import math
import re
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import chain, groupby
from pathlib import Path
from typing import Any

from cabinpose.core import ConfigError, RecordingError
from cabinpose.signals import Facts, Message, Sample, TakeCheck, TakenBody
from cabinpose.store.convert.format import RecordingFormat, format_of, made_options
from cabinpose.store.convert.rows import Entry, checked
from cabinpose.store.recording import Chunking, Recording, RecordingWriter, Take, whole_recording

_NO_NAME = re.compile(r"[^a-z0-9_-]+")
_NAME_LENGTH = 32


@dataclass(frozen=True)
class Imported:
    """What came of an import: the file, samples by source, and messages that could not be kept, with the reason of the last.

    bodies: whose positions are in it, how large they are, and by what unit.
    """

    path: Path
    samples: Mapping[str, int]
    refused: int
    reason: str
    bodies: tuple[TakenBody, ...] = ()


def import_recording(
    path: Path, name: str, out: Path, /, *, take: Take | None = None, overwrite: bool = False, **options: Any
) -> Imported:
    """Make a recording of a file. Same file, same bytes.

    Parameters
    ----------
    path
        The file.
    name
        Its format, one of `FORMATS` that reads recordings.
    out
        The recording to make; it appears when it is whole.
    take
        Who did what, where.
    overwrite
        Replace `out`.
    **options
        The format's own, such as `unit_m=0.01` of bvh.

    Raises
    ------
    ConfigError
        For an unknown format, or an option that it does not have.
    RecordingError, MocapError
        Where the file cannot be read to its end, `out` exists, or its bodies or time stamps cannot be; then nothing is left
        behind, and what was in `out` stays.
    DependencyError
        Where a package is missing.
    """
    found = read_entries(path, name, take.codes if take is not None else (), **options)
    if out.exists() and not overwrite:
        raise RecordingError(f"{out} exists", hint="--overwrite replaces it, or give another file with --out")
    refused: list[str] = []
    check = TakeCheck()
    with whole_recording(out) as temporary:
        entries = checked(path, _named(found), check)
        first = next(entries, None)
        if first is None:
            raise RecordingError(f"{path} holds nothing that is recorded", hint="give another file")
        chunking = Chunking(sync_s=0, flush_s=math.inf, definitions_s=math.inf)
        samples: Counter[str] = Counter()
        with RecordingWriter(temporary, take, started_ns=max(first[1], 0), chunking=chunking) as writer:
            for source, sample in _samples(chain([first], entries)):
                refused += writer.write(source, sample)
                samples[source] += 1
    return Imported(out, dict(samples), len(refused), refused[-1] if refused else "", check.bodies())


def export_recording(
    path: Path,
    name: str,
    out: Path,
    /,
    *,
    sources: tuple[str, ...] = (),
    span_s: tuple[float, float] | None = None,
    overwrite: bool = False,
    **options: Any,
) -> list[Path]:
    """Write a recording, or part of it, in another format.

    Parameters
    ----------
    path
        The recording.
    name
        The format, one of `FORMATS` that writes recordings.
    out
        The file to write (csv: folder); it appears when it is whole.
    sources
        Those that are written; none named: all that the format takes.
    span_s
        Seconds since the start of the take.
    overwrite
        Replace `out`.
    **options
        The format's own, such as `angles=True` of sto.

    Returns
    -------
    list of Path
        The files.

    Raises
    ------
    ConfigError
        For an unknown format, or an option that it does not have.
    RecordingError, MocapError
        Where the recording lacks what the format needs or has more than it can hold; then nothing is left behind.
    """
    form = format_of(name, RecordingFormat, "write")
    chosen = made_options(name, form.options("write"), options)
    if span_s is not None and not span_s[0] < span_s[1]:
        raise ConfigError(
            f"{span_s[0]:g} to {span_s[1]:g} s is no span", hint="seconds of the take, from the earlier to the later"
        )
    with Recording(path) as recording:
        named = _sources(recording, name, form.topics(chosen), sources)
        start_ns, end_ns = 0, 1 << 64
        if span_s is not None:
            start_ns, end_ns = (recording.head.started_ns + round(seconds * 1e9) for seconds in span_s)
        samples = recording.samples(named, start_ns=max(start_ns, 0), end_ns=max(end_ns, 0))
        return form.write(out, samples, chosen, overwrite=overwrite)


# ------------------------------------------------------------------------------------------------------------- reading


def read_entries(path: Path, name: str, subjects: Sequence[str] = (), /, **options: Any) -> Iterator[Entry]:
    """What a file in the format `name` holds, with the names of sources as the file has them; raises as `import_recording`."""
    form = format_of(name, RecordingFormat, "read")
    chosen = made_options(name, form.options("read"), options)
    if not path.exists():
        raise RecordingError(f"{path} does not exist", hint="give the file to import")
    return form.read(path, chosen, subjects)


def _named(entries: Iterator[Entry]) -> Iterator[Entry]:
    """The entries with names of sources that a rig's file allows, a different one for each source."""
    names: dict[str, str] = {}
    for source, host_ns, device_ns, message in entries:
        if source not in names:
            base = _NO_NAME.sub("-", source.lower()).strip("-_")[:_NAME_LENGTH] or "source"
            name, number = base if base != "take" else "take-1", 1
            while name in names.values():
                number += 1
                name = f"{base[: _NAME_LENGTH - 4]}-{number}"
            names[source] = name
        yield names[source], host_ns, device_ns, message


def _samples(entries: Iterable[Entry]) -> Iterator[tuple[str, Sample]]:
    """Entries in a row with the same source and times are one sample, until one of them comes again: frames of equal stamps are
    as many samples.
    """
    for (source, host_ns, device_ns), group in groupby(entries, key=lambda entry: entry[:3]):
        messages: list[Message] = []
        there: set[tuple[object, ...]] = set()
        for *_, message in group:
            what = type(message), getattr(message, "subject", ""), getattr(message, "names", ())
            if what in there and not isinstance(message, Facts):
                yield source, Sample(None, host_ns, device_ns, b"", tuple(messages))
                messages, there = [], set()
            messages.append(message)
            there.add(what)
        yield source, Sample(None, host_ns, device_ns, b"", tuple(messages))


# ------------------------------------------------------------------------------------------------------------- writing


def _sources(recording: Recording, name: str, topics: tuple[str, ...], named: tuple[str, ...]) -> tuple[str, ...]:
    """The sources to export. Raises RecordingError where those that are named are not there, or it is not clear which."""
    there = recording.sources
    for source in named:
        if source not in there:
            raise RecordingError(f"{recording.path} has no source '{source}'", hint=f"it has: {', '.join(there) or 'none'}")
    if not topics:
        return named or there
    given = recording.topics
    able = [source for source in there if any(f"{source}/{topic}" in given for topic in topics)]
    fit = [source for source in able if not named or source in named]
    if not fit:
        raise RecordingError(
            f"{name} needs {' or '.join(topics)}, of which {' or '.join(named) or recording.path} has none",
            hint=f"sources that have some: {', '.join(able) or 'none'}",
        )
    if len(fit) > 1:
        raise RecordingError(f"{name} holds one source, and {', '.join(fit)} could be meant", hint="name one with --source")
    return tuple(fit)

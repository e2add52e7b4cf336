"""Recordings from the files of other tools, and back: see `RECORDING_FORMATS`. What is written gets its name when it is whole."""

from __future__ import annotations

import math
import re
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass
from importlib import import_module
from itertools import chain, groupby
from pathlib import Path
from typing import Any

from cabinpose.core import ConfigError, RecordingError, unknown_name
from cabinpose.signals import Sample
from cabinpose.store.convert import RECORDING_EXPORTS, RECORDING_FORMATS, RECORDING_IMPORTS
from cabinpose.store.convert.c3d_up import Axis
from cabinpose.store.convert.rows import Entry, Row
from cabinpose.store.recording import Recording, RecordingWriter, Take

_NO_NAME = re.compile(r"[^a-z0-9_-]+")
_NAME_LENGTH = 32


@dataclass(frozen=True)
class RecordingOptions:
    """How a file becomes a recording. None of it is needed.

    subjects: codes of the file's subjects, in its order · name: of the source, in formats that hold one · start_ns: host time of
    the beginning, in formats that know no time of day · unit_m: unit of length of a BVH file · up: vertical axis of a BVH file
    (default: y), or of a C3D file in place of what is found · whole_frames: take those of a C3D file that is cut off · topics: of
    depth, and infrared, in a bag of ROS 2.
    """

    subjects: tuple[str, ...] = ()
    name: str | None = None
    start_ns: int = 0
    unit_m: float | None = None
    up: Axis | None = None
    whole_frames: bool = False
    topics: tuple[str, ...] = ()


@dataclass(frozen=True)
class Imported:
    """What came of an import: the file, samples by source, and messages that could not be kept, with the reason of the last."""

    path: Path
    samples: Mapping[str, int]
    refused: int
    reason: str


@dataclass(frozen=True)
class Selection:
    """What of a recording is exported: sources (none named: all that the format takes), a subject, a span of seconds since the
    start of the take. rate_hz: of the frames, where nothing tells it · angles: joint angles in place of orientations (sto).
    """

    sources: tuple[str, ...] = ()
    subject: str | None = None
    span_s: tuple[float, float] | None = None
    rate_hz: float | None = None
    angles: bool = False


_FLAGS = {
    "name": "--name", "start_ns": "--begun", "unit_m": "--unit-m", "up": "--up", "whole_frames": "--keep-whole-frames",
    "topics": "--topic", "subject": "--subject", "rate_hz": "--rate", "angles": "--angles",
}  # fmt: skip
"""Options that some formats have no use for, and their flags."""


def import_recording(
    path: Path,
    name: str,
    out: Path,
    *,
    take: Take | None = None,
    options: RecordingOptions | None = None,
    overwrite: bool = False,
) -> Imported:
    """Make a recording of a file. Same file, same bytes.

    Parameters
    ----------
    path
        The file.
    name
        Its format, one of `RECORDING_IMPORTS`.
    out
        The recording to make; it appears when it is whole.
    take
        Who did what, where.
    options
        How the file is read.
    overwrite
        Replace `out`.

    Raises
    ------
    ConfigError
        For an unknown format, or an option that it has no use for.
    RecordingError, MocapError
        Where the file cannot be read to its end or `out` exists; then nothing is left behind, and what was in `out` stays.
    DependencyError
        Where a package is missing.
    """
    if name not in RECORDING_IMPORTS:
        raise unknown_name("format", name, RECORDING_IMPORTS)
    found = read_entries(path, name, options or RecordingOptions())
    if out.exists() and not overwrite:
        raise RecordingError(f"{out} exists", hint="--overwrite replaces it, or give another file with --out")
    temporary = out.with_name(f".{out.name}.import.tmp")
    refused: list[str] = []
    try:
        temporary.unlink(missing_ok=True)
        entries = _named(found)
        first = next(entries, None)
        if first is None:
            raise RecordingError(f"{path} holds nothing that is recorded", hint="give another file")
        with RecordingWriter(
            temporary, take, started_ns=max(first[1], 0), sync_s=0, flush_s=math.inf, definitions_s=math.inf
        ) as writer:
            samples: Counter[str] = Counter()
            for source, sample in _samples(chain([first], entries)):
                refused += writer.write(source, sample)
                samples[source] += 1
        temporary.replace(out)
    except OSError as error:
        raise RecordingError(f"cannot write {out} ({error.strerror or error})", hint="check the folder and its space") from error
    finally:
        with suppress(OSError):
            temporary.unlink()
    return Imported(out, dict(samples), len(refused), refused[-1] if refused else "")


def export_recording(
    path: Path, name: str, out: Path, *, selection: Selection | None = None, overwrite: bool = False
) -> list[Path]:
    """Write a recording, or part of it, in another format.

    Parameters
    ----------
    path
        The recording.
    name
        The format, one of `RECORDING_EXPORTS`.
    out
        The file to write (csv: folder); it appears when it is whole.
    selection
        What of the recording is written.
    overwrite
        Replace `out`.

    Returns
    -------
    list of Path
        The files.

    Raises
    ------
    ConfigError
        For an unknown format, or a selection that it has no use for.
    RecordingError, MocapError
        Where the recording lacks what the format needs or has more than it can hold; then nothing is left behind.
    """
    if name not in RECORDING_EXPORTS:
        raise unknown_name("format", name, RECORDING_EXPORTS)
    form, chosen = RECORDING_FORMATS[name], selection or Selection()
    given = _given(name, chosen, form.write_options)
    write = _function(form.writes)
    with Recording(path) as recording:
        sources = _sources(recording, name, ("joint_angles",) if chosen.angles else form.topics, chosen.sources)
        start_ns, end_ns = 0, 1 << 64
        if chosen.span_s is not None:
            start_ns, end_ns = (recording.head.started_ns + round(seconds * 1e9) for seconds in chosen.span_s)
        samples = recording.samples(sources, start_ns=max(start_ns, 0), end_ns=max(end_ns, 0))
        if form.topics:
            return [write(out, _rows(samples), overwrite=overwrite, **given)]
        files: list[Path] = write(out, samples, overwrite=overwrite, **given)
        return files


def _function(place: str) -> Any:
    """A function of a format, by its module and name."""
    module, name = place.split(".")
    return getattr(import_module(f"cabinpose.store.convert.{module}"), name)


def _given(name: str, options: RecordingOptions | Selection, used: tuple[str, ...]) -> dict[str, Any]:
    """The options that a format uses. Raises ConfigError where another one is given."""
    for option, flag in _FLAGS.items():
        if option not in used and getattr(options, option, None):
            having = [n for n, form in RECORDING_FORMATS.items() if option in (*form.read_options, *form.write_options)]
            raise ConfigError(f"{flag} is of {', '.join(having)}, not of {name}", hint=f"leave out {flag}")
    return {option: getattr(options, option) for option in used}


# ------------------------------------------------------------------------------------------------------------- reading


def read_entries(path: Path, name: str, options: RecordingOptions) -> Iterator[Entry]:
    """What a file in the format `name` holds, with the names of sources as the file has them; raises as `import_recording`."""
    form = RECORDING_FORMATS[name]
    given = _given(name, options, form.read_options)
    if not path.exists():
        raise RecordingError(f"{path} does not exist", hint="give the file to import")
    source = given.pop("name", None) or form.source
    found = _function(form.reads)(path, **given)
    return ((source, *row) for row in found) if form.source else found


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
    """Entries in a row with the same source and times are one sample."""
    for (source, host_ns, device_ns), group in groupby(entries, key=lambda entry: entry[:3]):
        yield source, Sample(None, host_ns, device_ns, b"", tuple(entry[3] for entry in group))


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


def _rows(samples: Iterable[tuple[str, Sample]]) -> Iterator[Row]:
    for _, sample in samples:
        for message in sample.messages:
            yield sample.host_ns, sample.device_ns, message

"""Recordings from the files of other tools, and back: which formats there are, and what each gives or needs.

A recording gives its samples to the writers of the formats; readers give entries, which become samples. What is written gets
its name when it is whole.
"""

from __future__ import annotations

import heapq
import math
import re
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass, replace
from itertools import groupby
from pathlib import Path
from types import MappingProxyType
from urllib.parse import unquote

from cabinpose.core.errors import ConfigError, RecordingError, unknown_name
from cabinpose.core.ports import Sample
from cabinpose.core.recorded import Facts, Message
from cabinpose.store.convert.adtfdat import read_adtfdat, write_adtfdat
from cabinpose.store.convert.azure_mkv import read_azure_mkv
from cabinpose.store.convert.bvh import CMU_UNIT_M, UpAxis, read_bvh_rows
from cabinpose.store.convert.bvh_write import write_bvh
from cabinpose.store.convert.c3d import read_c3d
from cabinpose.store.convert.c3d_up import Axis
from cabinpose.store.convert.c3d_write import write_c3d
from cabinpose.store.convert.csv_ import read_csv, write_csv
from cabinpose.store.convert.mvnx import read_mvnx
from cabinpose.store.convert.mvnx_write import of_one_subject, write_mvnx
from cabinpose.store.convert.rows import Row
from cabinpose.store.convert.sto import read_sto, write_sto
from cabinpose.store.convert.trc import read_trc, write_trc
from cabinpose.store.convert.xdf import read_xdf, streams_of_samples, write_xdf
from cabinpose.store.recording import Recording, RecordingWriter, Take

Entry = tuple[str, int, int | None, int | None, Message]  # source, host_ns, device_ns, sequence, message
_NO_NAME = re.compile(r"[^a-z0-9_-]+")
_NAME_LENGTH = 32


@dataclass(frozen=True)
class RecordingOptions:
    """How a file becomes a recording. None of it is needed.

    subjects: codes of the file's subjects, in its order · name: of the source, in formats that hold one · start_ns: host time of
    the beginning, in formats that know no time of day · unit_m: unit of length of a BVH file · up: vertical axis of a BVH file
    (default: y), or of a C3D file in place of what is found · whole_frames: take those of a C3D file that is cut off.
    """

    subjects: tuple[str, ...] = ()
    name: str | None = None
    start_ns: int = 0
    unit_m: float | None = None
    up: Axis | None = None
    whole_frames: bool = False


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


def import_recording(
    path: Path,
    name: str,
    out: Path,
    *,
    take: Take | None = None,
    options: RecordingOptions | None = None,
    overwrite: bool = False,
) -> Imported:
    """Make the recording `out` of a file (CSV: of the tables in a folder) in the format `name`. Same file, same bytes.

    Raises ConfigError for an unknown format, RecordingError or MocapError where the file cannot be read to its end or `out`
    exists, DependencyError where a package is missing; then nothing is left behind, and what was in `out` stays.
    """
    if name not in READERS:
        raise unknown_name("format", name, list(READERS))
    if not path.exists():
        raise RecordingError(f"{path} does not exist", hint="give the file to import")
    if out.exists() and not overwrite:
        raise RecordingError(f"{out} exists", hint="--overwrite replaces it, or give another file with --out")
    temporary = out.with_name(f".{out.name}.import.tmp")
    refused: list[str] = []
    try:
        temporary.unlink(missing_ok=True)
        entries = _named(READERS[name](path, options or RecordingOptions()))
        first = next(entries, None)
        if first is None:
            raise RecordingError(f"{path} holds nothing that is recorded", hint="give another file")
        with RecordingWriter(
            temporary, take, started_ns=max(first[1], 0), sync_s=0, flush_s=math.inf, definitions_s=math.inf
        ) as writer:
            samples: Counter[str] = Counter()
            for source, sample in _samples(_chained(first, entries)):
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
    """Write a recording, or part of it, in the format `name` to the file `out` (CSV: folder), and return the files.

    Raises ConfigError for an unknown format or a selection that it has no use for, RecordingError or MocapError where the
    recording lacks what the format needs or has more than it can hold; then nothing is left behind.
    """
    if name not in WRITERS:
        raise unknown_name("format", name, list(WRITERS))
    writer, chosen = WRITERS[name], selection or Selection()
    if chosen.subject is not None and not writer.of_subject:
        raise ConfigError(f"a subject cannot be told apart in {name}", hint="leave out --subject: sources are exported whole")
    if chosen.angles and name != "sto":
        raise ConfigError(f"joint angles are chosen in sto, not in {name}", hint="leave out --angles")
    with Recording(path) as recording:
        sources = _sources(recording, name, writer, chosen)
        start_ns, end_ns = 0, 1 << 64
        if chosen.span_s is not None:
            start_ns, end_ns = (recording.head.started_ns + round(seconds * 1e9) for seconds in chosen.span_s)
        samples = recording.samples(sources, start_ns=max(start_ns, 0), end_ns=max(end_ns, 0))
        return writer.write(out, samples, replace(chosen, sources=sources), overwrite)


# ------------------------------------------------------------------------------------------------------------- reading


def _named(entries: Iterator[Entry]) -> Iterator[Entry]:
    """Sources by names that a rig could give them, two never by one."""
    names: dict[str, str] = {}
    for source, host_ns, device_ns, sequence, message in entries:
        if source not in names:
            base = _NO_NAME.sub("-", source.lower()).strip("-_")[:_NAME_LENGTH] or "source"
            name, number = base if base != "take" else "take-1", 1
            while name in names.values():
                number += 1
                name = f"{base[: _NAME_LENGTH - 4]}-{number}"
            names[source] = name
        yield names[source], host_ns, device_ns, sequence, message


def _samples(entries: Iterable[Entry]) -> Iterator[tuple[str, Sample]]:
    """What follows on one another with the same source, times and number is one sample."""
    for (source, host_ns, device_ns, sequence), group in groupby(entries, key=lambda entry: entry[:4]):
        yield source, Sample(sequence, host_ns, device_ns, b"", tuple(entry[4] for entry in group))


def _chained(first: Entry, rest: Iterator[Entry]) -> Iterator[Entry]:
    yield first
    yield from rest


def _of_rows(source: str, rows: Iterator[Row], options: RecordingOptions) -> Iterator[Entry]:
    name = options.name or source
    return ((name, host_ns, device_ns, None, message) for host_ns, device_ns, message in rows)


def _read_mvnx(path: Path, options: RecordingOptions) -> Iterator[Entry]:
    return _of_rows("suit", read_mvnx(path, subjects=options.subjects), options)


def _read_c3d(path: Path, options: RecordingOptions) -> Iterator[Entry]:
    rows = read_c3d(path, subjects=options.subjects, start_ns=options.start_ns, up=options.up, whole_frames=options.whole_frames)
    return _of_rows("optical", rows, options)


def _read_bvh(path: Path, options: RecordingOptions) -> Iterator[Entry]:
    subject = (*options.subjects, "subject")[0]
    if options.up not in (None, "y", "z"):
        raise ConfigError(f"a BVH file has y or z up, not {options.up}", hint="give --up y or --up z")
    up: UpAxis = "z" if options.up == "z" else "y"
    rows = read_bvh_rows(path, unit_m=options.unit_m or CMU_UNIT_M, up=up, subject=subject, start_ns=options.start_ns)
    return _of_rows("motion", rows, options)


def _read_trc(path: Path, options: RecordingOptions) -> Iterator[Entry]:
    return _of_rows("optical", read_trc(path, subject=(*options.subjects, "")[0], start_ns=options.start_ns), options)


def _read_sto(path: Path, options: RecordingOptions) -> Iterator[Entry]:
    return _of_rows("suit", read_sto(path, subject=(*options.subjects, "")[0], start_ns=options.start_ns), options)


def _read_azure(path: Path, options: RecordingOptions) -> Iterator[Entry]:
    return _of_rows("tof", read_azure_mkv(path), options)


def _read_adtfdat(path: Path, _: RecordingOptions) -> Iterator[Entry]:
    """The streams of others begin with facts on them, without a time: that of what follows."""
    facts: list[tuple[str, Facts]] = []
    host_ns = 0
    for stream, host_ns, device_ns, sequence, message in read_adtfdat(path):
        if isinstance(message, Facts) and message.about == "adtf stream":
            properties = message.values.get("properties")
            if not (isinstance(properties, Mapping) and "cabinpose_source" in properties):
                facts.append((stream, message))
            continue
        yield from ((source, host_ns, None, None, about) for source, about in facts)
        facts.clear()
        yield stream, host_ns, device_ns, sequence, message
    yield from ((source, host_ns, None, None, about) for source, about in facts)


def _read_xdf(path: Path, options: RecordingOptions) -> Iterator[Entry]:
    streams = read_xdf(path)
    each = [_of_rows(name, stream.rows(), replace(options, name=None)) for name, stream in streams.items()]
    return heapq.merge(*each, key=lambda entry: entry[1])


def _read_csv(path: Path, _: RecordingOptions) -> Iterator[Entry]:
    """The tables of a folder, or one, together by their times."""
    paths = sorted(path.glob("*.csv")) if path.is_dir() else [path]
    tables = [p for p in paths if not p.stem.rpartition(".")[2].startswith("frames")]
    if not tables:
        raise RecordingError(f"{path} holds no table of messages", hint="as in suit.poses.csv, written by cabinpose export")

    def entries(table: Path) -> Iterator[Entry]:
        source = unquote(table.stem.rpartition(".")[0])
        return ((source, *row) for row in read_csv(table))

    def order(entry: Entry) -> tuple[int, str, int, int]:
        source, host_ns, device_ns, sequence, _ = entry
        return host_ns, source, -1 if sequence is None else sequence, -1 if device_ns is None else device_ns

    return heapq.merge(*map(entries, tables), key=order)


READERS: Mapping[str, Callable[[Path, RecordingOptions], Iterator[Entry]]] = MappingProxyType(
    {
        "mvnx": _read_mvnx, "c3d": _read_c3d, "bvh": _read_bvh, "adtfdat": _read_adtfdat, "xdf": _read_xdf,
        "azure-mkv": _read_azure, "trc": _read_trc, "sto": _read_sto, "csv": _read_csv,
    }
)  # fmt: skip

# ------------------------------------------------------------------------------------------------------------- writing

_Samples = Iterator[tuple[str, Sample]]


@dataclass(frozen=True)
class _Writer:
    """write: file, samples, selection, whether to overwrite · topics: one of these a source must have, and there may be only one
    such source, since clocks of devices differ (empty: any number of any) · of_subject: whether it holds one subject at a time.
    """

    write: Callable[[Path, _Samples, Selection, bool], list[Path]]
    topics: tuple[str, ...] = ()
    of_subject: bool = True


def _sources(recording: Recording, name: str, writer: _Writer, chosen: Selection) -> tuple[str, ...]:
    """The sources to export. Raises RecordingError where those that are named are not there, or it is not clear which."""
    there = recording.sources
    for source in chosen.sources:
        if source not in there:
            raise RecordingError(f"{recording.path} has no source '{source}'", hint=f"it has: {', '.join(there) or 'none'}")
    if not writer.topics:
        return chosen.sources or there
    topics = ("joint_angles",) if chosen.angles else writer.topics
    given = recording.topics
    able = [source for source in there if any(f"{source}/{topic}" in given for topic in topics)]
    fit = [source for source in able if not chosen.sources or source in chosen.sources]
    if not fit:
        which = " or ".join(chosen.sources) or str(recording.path)
        raise RecordingError(
            f"{name} needs {' or '.join(topics)}, of which {which} has none",
            hint=f"sources that have some: {', '.join(able) or 'none'}",
        )
    if len(fit) > 1:
        raise RecordingError(f"{name} holds one source, and {', '.join(fit)} could be meant", hint="name one with --source")
    return tuple(fit)


def _rows(samples: _Samples) -> Iterator[Row]:
    for _, sample in samples:
        for message in sample.messages:
            yield sample.host_ns, sample.device_ns, message


def _write_c3d(out: Path, samples: _Samples, chosen: Selection, overwrite: bool) -> list[Path]:
    return [write_c3d(out, _rows(samples), subject=chosen.subject, rate_hz=chosen.rate_hz, overwrite=overwrite)]


def _write_bvh(out: Path, samples: _Samples, chosen: Selection, overwrite: bool) -> list[Path]:
    return [write_bvh(out, _rows(samples), subject=chosen.subject, overwrite=overwrite)]


def _write_trc(out: Path, samples: _Samples, chosen: Selection, overwrite: bool) -> list[Path]:
    return [write_trc(out, _rows(samples), subject=chosen.subject, rate_hz=chosen.rate_hz, overwrite=overwrite)]


def _write_sto(out: Path, samples: _Samples, chosen: Selection, overwrite: bool) -> list[Path]:
    rows = _rows(samples)
    return [write_sto(out, rows, angles=chosen.angles, subject=chosen.subject, rate_hz=chosen.rate_hz, overwrite=overwrite)]


def _write_mvnx(out: Path, samples: _Samples, chosen: Selection, overwrite: bool) -> list[Path]:
    rows = of_one_subject(_rows(samples), chosen.subject)
    return [write_mvnx(out, rows, frame_rate_hz=chosen.rate_hz, overwrite=overwrite)]


def _write_xdf(out: Path, samples: _Samples, _: Selection, overwrite: bool) -> list[Path]:
    return [write_xdf(out, streams_of_samples(samples), overwrite=overwrite)]


def _write_adtfdat(out: Path, samples: _Samples, _: Selection, overwrite: bool) -> list[Path]:
    return [write_adtfdat(out, samples, overwrite=overwrite)]


def _write_csv(out: Path, samples: _Samples, _: Selection, overwrite: bool) -> list[Path]:
    if out.is_dir() and any(out.iterdir()) and not overwrite:
        raise RecordingError(f"{out} is not empty", hint="--overwrite replaces tables in it, or give another folder with --out")
    new = not out.exists()
    try:
        return write_csv(out, samples, overwrite=overwrite)
    finally:
        if new and out.is_dir() and not any(out.iterdir()):
            out.rmdir()


WRITERS: Mapping[str, _Writer] = MappingProxyType(
    {
        "c3d": _Writer(_write_c3d, ("markers",)),
        "bvh": _Writer(_write_bvh, ("poses",)),
        "trc": _Writer(_write_trc, ("markers",)),
        "sto": _Writer(_write_sto, ("poses",)),
        "mvnx": _Writer(_write_mvnx, ("poses",)),
        "csv": _Writer(_write_csv, of_subject=False),
        "adtfdat": _Writer(_write_adtfdat, of_subject=False),
        "xdf": _Writer(_write_xdf, of_subject=False),
    }
)

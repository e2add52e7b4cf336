"""ADTF files (`.adtfdat`) as messages, through the vendor's package (`adtf`, module `adtf_file`).

The numbers of every sample that its media description decodes become channels, named by their place in it; samples without a
description are left out. A layout of the user's (`adtf_layout`) says what images and poses are in a stream. The package
tells times in microseconds, since the recording began.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from cabinpose.core import RecordingError, optional_module
from cabinpose.signals import Channels, Facts, Message
from cabinpose.store.convert.adtf_layout import AdtfLayout, LayoutStream
from cabinpose.store.convert.apart import CrashedError, items_apart
from cabinpose.store.convert.format import RecordingFormat
from cabinpose.store.convert.rows import Entry

_MOST_LEAVES = 10_000  # numbers of one array


@dataclass(frozen=True, kw_only=True)
class AdtfdatImport:
    """How an ADTF file is read."""

    layout: Path | None = None
    """YAML file that says what is in its streams: depth, amplitude, poses; default: their media descriptions alone."""


def read_adtfdat(path: Path, layout: AdtfLayout | None = None) -> Iterator[Entry]:
    """The described samples of all streams in the order of the file, after facts on each stream; a stream is a source.

    Both times are the file's, unless the layout names a field with the device's. Facts have the time of the first sample.

    Raises
    ------
    DependencyError
        Without the package `adtf`.
    RecordingError
        Where the file cannot be read, lacks a stream of the layout, or has samples that are not as the layout says.
    """
    _adtf_file()  # an error of its own where it is missing
    if not path.is_file():
        raise RecordingError(f"{path} does not exist", hint="check the path")
    try:
        yield from items_apart(partial(_read, layout=layout), path)
    except (CrashedError, RuntimeError) as error:
        raise RecordingError(f"{path} is no whole ADTF file: {error}", hint="copy or record it again") from error


class AdtfdatFormat(RecordingFormat):
    """ADTF files."""

    import_options = AdtfdatImport

    def read(self, path: Path, options: AdtfdatImport, _subjects: Sequence[str]) -> Iterator[Entry]:
        """As `read_adtfdat`."""
        return read_adtfdat(path, None if options.layout is None else AdtfLayout.load(options.layout))


ADTFDAT = AdtfdatFormat()


def _adtf_file() -> Any:
    return optional_module("adtf_file", purpose="an ADTF file", hint="pip install adtf (Linux and Windows, 64 bits)")


def _read(path: Path, layout: AdtfLayout | None = None) -> Iterator[Entry]:
    """As `read_adtfdat`. The package trusts the file: to be called in a process of its own."""
    adtf_file = _adtf_file()
    reader = adtf_file.create_reader(str(path))
    described = {each.stream: each for each in layout.streams} if layout is not None else {}
    streams, decoders, facts = {}, {}, []
    for stream in reader.streams:
        kind, name = stream.initial_type, str(stream.name)
        streams[stream.stream_id] = name
        if name not in described:
            decoders[stream.stream_id] = adtf_file.SampleDecoder(kind)
        properties = {name: value.value for name, value in kind.properties.items()}
        about = {"stream": name, "meta_type": str(kind.meta_type), "samples": int(stream.item_count)}
        facts.append((_source(described, name), Facts("adtf stream", about | {"properties": properties})))
    if lacking := [name for name in described if name not in streams.values()]:
        raise RecordingError(
            f"{path} has no stream '{lacking[0]}'", hint=f"it has: {', '.join(streams.values()) or 'none'}; see the layout"
        )
    time_ns = 0
    seen: Counter[int] = Counter()
    while (item := reader.get_next_item()) is not None:
        seen[item.stream_id] += 1
        if item.type != adtf_file.ItemType.Sample or item.stream_id not in streams:
            continue
        name = streams[item.stream_id]
        time_ns = round(item.sample.time_stamp.total_seconds() * 1e6) * 1000
        device_ns: int | None = None
        messages: tuple[Message, ...] = ()
        if name in described:
            device_ns, messages = described[name].messages(bytes(item.sample.buffer))
        elif leaves := dict(_leaves(decoders[item.stream_id].decode(item.sample))):
            messages = (Channels(tuple(leaves), np.array(list(leaves.values()), np.float64)),)
        if messages:
            yield from ((source, time_ns, None, each) for source, each in facts)
            facts.clear()
        for message in messages:
            yield _source(described, name), time_ns, time_ns if device_ns is None else device_ns, message
    yield from ((source, time_ns, None, each) for source, each in facts)
    for stream in reader.streams:
        if str(stream.name) in described and seen[stream.stream_id] < stream.item_count:
            raise RecordingError(
                f"{path}: stream '{stream.name}' ends after {seen[stream.stream_id]} of {stream.item_count} samples",
                hint="the file is damaged: copy or record it again",
            )


def _source(described: Mapping[str, LayoutStream], stream: str) -> str:
    return (described[stream].source or stream) if stream in described else stream


def _leaves(value: Any, name: str = "") -> Iterator[tuple[str, float]]:
    """The numbers of a decoded sample by their place: structures by names, arrays by indices."""
    if isinstance(value, (bool, int, float)):
        yield name or "value", float(value)
        return
    parts: Iterable[tuple[str, Any]] = ()
    if isinstance(value, (list, tuple)):
        parts = ((f"{name}[{i}]", each) for i, each in enumerate(value[:_MOST_LEAVES]))
    elif hasattr(value, "__dict__"):
        parts = ((f"{name}.{key}" if name else key, each) for key, each in vars(value).items())
    for key, each in parts:
        yield from _leaves(each, key)

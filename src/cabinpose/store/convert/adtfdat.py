"""ADTF files (`.adtfdat`) as messages, through the vendor's package (`adtf`, module `adtf_file`).

The numbers of every sample that its media description decodes become channels, named by their place in it; samples without a
description are left out. The package tells times in microseconds, since the recording began.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from cabinpose.core import RecordingError, optional_module
from cabinpose.signals import Channels, Facts
from cabinpose.store.convert.apart import CrashedError, items_apart
from cabinpose.store.convert.format import NoOptions, RecordingFormat
from cabinpose.store.convert.rows import Entry

_MOST_LEAVES = 10_000  # numbers of one array


def read_adtfdat(path: Path) -> Iterator[Entry]:
    """The described samples of all streams in the order of the file, after facts on each stream; a stream is a source.

    Both times are the file's. Facts have the time of the first sample.

    Raises
    ------
    DependencyError
        Without the package `adtf`.
    RecordingError
        Where the file cannot be read.
    """
    _adtf_file()  # an error of its own where it is missing
    if not path.is_file():
        raise RecordingError(f"{path} does not exist", hint="check the path")
    try:
        yield from items_apart(_read, path)
    except (CrashedError, RuntimeError) as error:
        raise RecordingError(f"{path} is no whole ADTF file: {error}", hint="copy or record it again") from error


class AdtfdatFormat(RecordingFormat):
    """ADTF files."""

    def read(self, path: Path, _options: NoOptions, _subjects: Sequence[str]) -> Iterator[Entry]:
        """As `read_adtfdat`."""
        return read_adtfdat(path)


ADTFDAT = AdtfdatFormat()


def _adtf_file() -> Any:
    return optional_module("adtf_file", purpose="an ADTF file", hint="pip install adtf (Linux and Windows, 64 bits)")


def _read(path: Path) -> Iterator[Entry]:
    """As `read_adtfdat`. The package trusts the file: to be called in a process of its own."""
    adtf_file = _adtf_file()
    reader = adtf_file.create_reader(str(path))
    names, decoders, facts = {}, {}, []
    for stream in reader.streams:
        kind = stream.initial_type
        names[stream.stream_id], decoders[stream.stream_id] = str(stream.name), adtf_file.SampleDecoder(kind)
        properties = {name: value.value for name, value in kind.properties.items()}
        about = {"stream": str(stream.name), "meta_type": str(kind.meta_type), "samples": int(stream.item_count)}
        facts.append((str(stream.name), Facts("adtf stream", about | {"properties": properties})))
    time_ns = 0
    while (item := reader.get_next_item()) is not None:
        if item.type != adtf_file.ItemType.Sample or item.stream_id not in names:
            continue
        leaves = dict(_leaves(decoders[item.stream_id].decode(item.sample)))
        if leaves:
            time_ns = round(item.sample.time_stamp.total_seconds() * 1e6) * 1000
            yield from ((name, time_ns, None, each) for name, each in facts)
            facts.clear()
            yield names[item.stream_id], time_ns, time_ns, Channels(tuple(leaves), np.array(list(leaves.values()), np.float64))
    yield from ((name, time_ns, None, each) for name, each in facts)


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

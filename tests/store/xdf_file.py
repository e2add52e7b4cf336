"""XDF files for the tests, written after the XDF specification 1.0 (SCCN)."""

from __future__ import annotations

import struct
from collections.abc import Sequence
from dataclasses import dataclass, field
from datetime import UTC, datetime
from pathlib import Path
from typing import IO, Any
from xml.sax.saxutils import escape

import numpy as np

_HEADER, _STREAM, _SAMPLES, _OFFSET, _FOOTER = 1, 2, 3, 4, 6
_AT_ONCE = 1000  # samples a chunk


@dataclass(frozen=True)
class XdfStream:
    """A stream: samples (N, C), or lists of strings, with stamps (N,) s.

    offsets: (M, 2), when the clock was measured and what to add to it.
    """

    name: str
    type: str
    rate_hz: float
    labels: tuple[str, ...]
    stamps_s: np.ndarray
    values: Any
    offsets: np.ndarray = field(default_factory=lambda: np.zeros((0, 2)))


def write_xdf(path: Path, streams: Sequence[XdfStream], *, begun_ns: int = 0) -> Path:
    """Write streams to a file that was begun at a moment, and return the path."""
    with path.open("wb") as file:
        file.write(b"XDF:")
        begun = datetime.fromtimestamp(begun_ns / 1e9, UTC).isoformat()
        _chunk(file, _HEADER, f"<info><version>1.0</version><datetime>{begun}</datetime></info>".encode())
        for number, stream in enumerate(streams, 1):
            identity = struct.pack("<I", number)
            _chunk(file, _STREAM, identity, _description(stream))
            for first in range(0, len(stream.stamps_s), _AT_ONCE):
                part = slice(first, first + _AT_ONCE)
                _chunk(file, _SAMPLES, identity, _samples(stream.stamps_s[part], stream.values[part]))
            for at, offset in stream.offsets:
                _chunk(file, _OFFSET, identity, struct.pack("<dd", at, offset))
            footer = f"<info><sample_count>{len(stream.stamps_s)}</sample_count></info>"
            _chunk(file, _FOOTER, identity, footer.encode())
    return path


def _chunk(file: IO[bytes], tag: int, *parts: bytes) -> None:
    file.write(struct.pack("<BIH", 4, 2 + sum(map(len, parts)), tag) + b"".join(parts))


def _description(stream: XdfStream) -> bytes:
    kind = "double64" if isinstance(stream.values, np.ndarray) else "string"
    labels = "".join(f"<channel><label>{escape(label)}</label></channel>" for label in stream.labels)
    return (
        f"<info><name>{escape(stream.name)}</name><type>{escape(stream.type)}</type><channel_count>{len(stream.labels)}"
        f"</channel_count><nominal_srate>{stream.rate_hz}</nominal_srate><channel_format>{kind}</channel_format>"
        f"<desc><channels>{labels}</channels></desc></info>"
    ).encode()


def _samples(stamps: np.ndarray, values: Any) -> bytes:
    """The content of a chunk of samples, each with its time stamp."""
    parts = [struct.pack("<BI", 4, len(stamps))]
    for stamp, value in zip(stamps, values, strict=True):
        parts.append(struct.pack("<Bd", 8, stamp))
        if isinstance(value, np.ndarray):
            parts.append(value.astype("<f8").tobytes())
        else:
            for data in (str(cell).encode() for cell in value):
                parts += [struct.pack("<BI", 4, len(data)), data]
    return b"".join(parts)
